//! Area lights while they move, by interleaved sampling [Keller 2001]: a picture for about the cost of a light
//! without size.
//!
//! Each view sample is traced towards one of [`SOFT_POINTS`] points of the light, its neighbours towards others. The
//! fraction of the light that is seen is the mean over neighbours on the same surface; shade_soft.comp multiplies
//! smooth shading by it [Heitz 2018b]. Each point of a gather sample also sees one of these points; their sum needs no
//! filter.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Context, Kernel};
use crate::physics::distribution::GridDistribution;
use crate::physics::sequence::Points;
use crate::relight::indirect::sky_importance::point_of;
use crate::scene::{Light, LightKind, MeshSpace, Rig};
use crate::shared::*;
use crate::trace::packet::PACKET_SIZE;
use crate::trace::packet::interleaved::InterleavedPackets;

/// What interleaved samples need besides visibility.
pub struct SoftLights {
    pub view_samples: InterleavedPackets,
    pub gather_points: InterleavedPackets,
    /// Which samples in the [window](InterleavedPackets::window) of each are on the same smooth surface.
    pub similar: Vec<u64>,
    /// By shape, then whether the light has factors; `None` as long as no light needs it.
    kernels: [[Option<Kernel<ShadeSoftPush>>; 2]; SHAPES],
}

/// An area light, sampled by interleaved points.
pub struct SoftLight {
    /// [`SOFT_POINTS`] points, of which each sample sees one.
    pub points: [PackedLight; SOFT_POINTS as usize],
    /// The middle of the light.
    pub middle: PackedLight,
    /// [`ShadeSoftPush::across`]
    pub across: Vec3,
    /// [`ShadeSoftPush::half_height`]
    pub half_height: f32,
    shape: u32,
    has_factors: bool,
}

/// Number of `SHAPE_` constants.
const SHAPES: usize = SHAPE_DOME as usize + 1;
/// Points that bound the light of a point nearby; see [`Light::pack_point`].
const BOUNDING_POINTS: u32 = 16;

impl SoftLights {
    /// `None` if all lights of `rig` are without size.
    pub fn find(
        context: &Arc<Context>,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
        rig: &Rig,
    ) -> Result<Option<Self>> {
        if !rig.has_sizes() {
            return Ok(None);
        }
        let tiles = [framebuffer.tiling.width, framebuffer.tiling.height].map(|side| side.div_ceil(TILE_SIZE) as usize);
        let padded = framebuffer.packets.len() * PACKET_SIZE;
        let view_samples = InterleavedPackets::new(&framebuffer.packets, tiles);
        let similar = |index| similar_neighbours(framebuffer, &view_samples, index);
        let mut lights = Self {
            similar: (0..padded).into_par_iter().map(similar).collect(),
            view_samples,
            gather_points: interleaved_gather_points(transfer),
            kernels: Default::default(),
        };
        lights.allow(context, framebuffer, rig)?;
        Ok(Some(lights))
    }

    /// Makes the kernels that the lights of `rig` need.
    pub fn allow(&mut self, context: &Arc<Context>, framebuffer: &DeepFramebuffer, rig: &Rig) -> Result<()> {
        for light in rig.lights.iter().filter(|light| !light.is_punctual()) {
            let (shape, factors) = (shape(light), light.has_factors());
            let kernel = &mut self.kernels[shape as usize][usize::from(factors)];
            if kernel.is_none() {
                let constants = ShadeSoftConstants { specular: framebuffer.has_specular, shape, factors };
                *kernel = Some(Kernel::new(context, constants)?);
            }
        }
        Ok(())
    }

    /// After a change of the transfer.
    pub fn set_transfer(&mut self, transfer: &Transfer) {
        self.gather_points = interleaved_gather_points(Some(transfer));
    }

    pub fn kernel(&self, light: &SoftLight) -> &Kernel<ShadeSoftPush> {
        let kernel = &self.kernels[light.shape as usize][usize::from(light.has_factors)];
        kernel.as_ref().expect("the rig has such a light")
    }

    /// Recompiles kernels whose source changed; returns whether any did.
    #[cfg(feature = "hot-reload")]
    pub fn reload_changed_kernels(&mut self) -> bool {
        self.kernels.as_flattened_mut().iter_mut().flatten().fold(false, |any, kernel| kernel.reload_if_changed() | any)
    }
}

impl SoftLight {
    /// `warp`: see [`point_of`].
    pub fn new(light: &Light, space: MeshSpace, warp: Option<&GridDistribution>) -> Self {
        // Each 16 points of the sequence are one in each of 4x4 cells; so are the middle 16 of any window.
        let sequence = Points::new(0, 0);
        let mut points = [light.pack(space); SOFT_POINTS as usize];
        for index in 0..SOFT_POINTS {
            let [u, v, w, _] = sequence.at(index, 0);
            let cell = (4.0 * u) as u32 + 4 * (4.0 * v) as u32;
            points[((index & !15) + cell) as usize] = match light.kind {
                LightKind::Point => light.pack_in_ball(space, [u, v, w]),
                _ => point_of(light, space, [u, v], BOUNDING_POINTS, warp),
            };
        }
        let (across, half_height) = match light.kind {
            LightKind::Rect => {
                let ([along_width, along_height], [width, height]) = (light.axes(), light.size);
                match width > 0.0 {
                    true => (along_width * (0.5 * width / space.unit), 0.5 * height / space.unit),
                    false => (along_height * (0.5 * height / space.unit), 0.0),
                }
            }
            kind => {
                let chord = || 2.0 * (light.angle / 4.0).sin();
                let radius = if kind == LightKind::Directional { chord() } else { light.radius / space.unit };
                (light.direction.any_orthonormal_vector() * radius, radius)
            }
        };
        Self {
            points,
            middle: match light.kind {
                // The same in all directions to a sun, which sends more than the middle alone would.
                LightKind::Directional => {
                    PackedLight { strength: light.pack_point(space, [0.0; 2], None).strength, ..light.pack(space) }
                }
                _ => light.pack(space),
            },
            across: across.as_vec3(),
            half_height: half_height as f32,
            shape: shape(light),
            has_factors: light.has_factors(),
        }
    }
}

fn interleaved_gather_points(transfer: Option<&Transfer>) -> InterleavedPackets {
    InterleavedPackets::new(transfer.map_or(&[], |transfer| &transfer.packets), [0, 0])
}

fn shape(light: &Light) -> u32 {
    match light.kind {
        LightKind::Point => SHAPE_BALL,
        LightKind::Spot => SHAPE_SPOT,
        LightKind::Directional => SHAPE_SUN,
        LightKind::Dome => SHAPE_DOME,
        LightKind::Disk => SHAPE_DISK,
        LightKind::Rect => SHAPE_RECT,
        LightKind::Emitter => unreachable!("{}: emitters are baked", light.name),
    }
}

/// Bit i: sample i of the window around another one reflects light and lies on the same smooth surface.
fn similar_neighbours(framebuffer: &DeepFramebuffer, packets: &InterleavedPackets, index: usize) -> u64 {
    if index >= framebuffer.samples.len() {
        return 0;
    }
    let is_similar = |other: usize| {
        let Some(sample) = framebuffer.samples.get(other) else { return false };
        let [normal, other_normal] = [index, other].map(|i| framebuffer.geometric_normals[i]);
        let between = sample.position - framebuffer.samples[index].position;
        let is_near = normal.dot(other_normal) > 0.5 && normal.dot(between).abs() <= 0.5 * between.length();
        sample.brdf != NO_BRDF && (other == index || is_near)
    };
    let window = packets.window(index).enumerate();
    window.map(|(i, other)| u64::from(other.is_some_and(is_similar)) << i).sum()
}
