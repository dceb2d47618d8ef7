//! What final gathering adds to the images of lights. It belongs to a light as it stands: recoloured or undone, a light
//! finds its change again.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;

use super::light_cache::same_image;
use crate::bake::DeepFramebuffer;
use crate::error::Result;
use crate::gpu::{Buffer, Context};
use crate::scene::{Light, Links, ObjectSet, Rig};

/// Changes of lights, on the device; copies share them.
#[derive(Clone, Default)]
pub struct LightChanges {
    /// Latest last.
    list: Vec<Arc<LightChange>>,
}

/// A light as it stands: all that its image at unit strength depends on.
pub struct StandingLight {
    light: Light,
    /// Those of its rig.
    sets: Vec<ObjectSet>,
}

/// What is added to the image of a light of unit strength.
struct LightChange {
    light: StandingLight,
    /// Unique.
    number: u64,
    /// Planes R, G, B.
    image: Buffer<f32>,
}

impl LightChanges {
    /// Sets the change of a light of a rig, row by row; forgets the oldest changes beyond `most`.
    pub fn set(
        &mut self,
        context: &Arc<Context>,
        framebuffer: &DeepFramebuffer,
        (rig, light): (&Rig, usize),
        change: &[Vec3],
        most: usize,
    ) -> Result<()> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let (tiling, stride) = (&framebuffer.tiling, framebuffer.pixel_stride());
        let mut planes = vec![0.0; 3 * stride];
        for (i, pixel) in change.iter().enumerate() {
            let at = tiling.index(i as u32 % tiling.width, i as u32 / tiling.width);
            (0..3).for_each(|plane| planes[plane * stride + at] = pixel[plane]);
        }
        let change = LightChange {
            light: StandingLight::new(rig, light),
            number: COUNT.fetch_add(1, Ordering::Relaxed),
            image: Buffer::from_slice(context, "light images (final gathering)", &planes)?,
        };
        self.list.retain(|other| !other.light.is(rig, light));
        self.list.push(Arc::new(change));
        self.list.drain(..self.list.len().saturating_sub(most));
        Ok(())
    }

    /// Number of the change of a light.
    pub(super) fn of(&self, rig: &Rig, light: usize) -> Option<u64> {
        self.list.iter().find(|change| change.light.is(rig, light)).map(|change| change.number)
    }

    pub(super) fn image(&self, number: u64) -> &Buffer<f32> {
        &self.list.iter().find(|change| change.number == number).expect("images have changes that are there").image
    }

    pub(super) fn len(&self) -> usize {
        self.list.len()
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Whether both have the same changes.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.list.iter().map(|change| change.number).eq(other.list.iter().map(|change| change.number))
    }
}

impl StandingLight {
    pub fn new(rig: &Rig, light: usize) -> Self {
        Self { light: rig.lights[light].clone(), sets: rig.sets.clone() }
    }

    /// Whether a light of a rig has the same image at unit strength.
    pub fn is(&self, rig: &Rig, light: usize) -> bool {
        let links_alike = || self.light.links == Links::default() || self.sets == rig.sets;
        same_image(&self.light, &rig.lights[light], true) && links_alike()
    }
}
