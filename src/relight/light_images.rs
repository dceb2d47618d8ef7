//! Images of lights in device memory.

use std::sync::Arc;

use glam::Vec4;

use super::light_cache::LightCache;
use crate::bake::DeepFramebuffer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, is_out_of_memory};

/// Images of lights, one for each slot of the [`LightCache`].
pub(super) struct LightImages {
    images: Vec<Buffer<Vec4>>,
    /// Maximum number of images, if that is not less than the minimum.
    budget: usize,
}

/// Maximum number of images, whatever the budget. For 100,000 lights even small pictures would take gigabytes, and only
/// few lights are edited at a time.
const MAX_IMAGES: usize = 4_096;

impl LightImages {
    /// Whose memory the images of a picture are.
    pub const NAME: &str = "light images";

    /// `count` images; `name` tells whose memory they are.
    pub fn new(context: &Arc<Context>, framebuffer: &DeepFramebuffer, name: &str, count: usize) -> Result<Self> {
        let images = (0..count).map(|_| light_image(context, framebuffer, name)).collect::<Result<_>>()?;
        Ok(Self { images, budget: 0 })
    }

    /// `budget`: maximum number of images, if that is not less than the minimum.
    pub fn set_budget(&mut self, budget: usize) {
        self.budget = budget;
    }

    /// Adds images until there are as many as the budget allows for a rig of so many lights and for `more` images;
    /// fewer, but at least the minimum, if the device has no room.
    pub fn grow(
        &mut self,
        context: &Arc<Context>,
        framebuffer: &DeepFramebuffer,
        light_count: usize,
        more: usize,
    ) -> Result<()> {
        let (fewest, all) = LightCache::slot_range(light_count);
        let of_rig = self.budget.clamp(fewest, all.min(MAX_IMAGES.max(fewest)));
        let most = (of_rig + more).min(self.budget.max(of_rig));
        while self.images.len() < most {
            match light_image(context, framebuffer, Self::NAME) {
                Ok(image) => self.images.push(image),
                Err(error) if self.images.len() >= fewest && is_out_of_memory(&error) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    pub fn as_slice(&self) -> &[Buffer<Vec4>] {
        &self.images
    }

    pub fn len(&self) -> usize {
        self.images.len()
    }
}

/// Planes R, G, B of a light image.
pub(super) fn light_image(context: &Arc<Context>, framebuffer: &DeepFramebuffer, name: &str) -> Result<Buffer<Vec4>> {
    Buffer::new(context, name, Access::Device, 3 * framebuffer.pixel_stride() / 4)
}
