//! Factors on the light of filtered and linked lights: what reaches each view sample and each point of a gather sample
//! besides visibility. Computed on the host, as shadow rays are, so that no kernel knows filters or links.

use std::sync::Arc;

use glam::{UVec2, Vec3};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context};
use crate::shared::ViewSample;
use crate::trace::bvh::TracedScene;
use crate::trace::linked::LinkedScene;
use crate::trace::packet::{PACKET_SIZE, SamplePacket};
use crate::trace::triangle_lookup::triangles_at;

/// RGB factors of one light in half precision.
pub struct LightFactors {
    pub view_samples: Buffer<UVec2>,
    pub gather_points: Buffer<UVec2>,
}

/// Samples of one task.
const SAMPLES_A_TASK: usize = 1024;

impl LightFactors {
    /// Room for all samples; without `wanted` for none, since kernels do not read them.
    pub fn new(
        context: &Arc<Context>,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
        wanted: bool,
    ) -> Result<Self> {
        let room = |samples: usize| -> Result<Buffer<UVec2>> {
            let count = if wanted { samples } else { 0 };
            let mut factors = Buffer::new(context, "light factors", Access::HostWrites, count)?;
            factors.host_mut().fill(UVec2::ZERO);
            Ok(factors)
        };
        Ok(Self {
            view_samples: room(framebuffer.samples.len())?,
            gather_points: room(transfer.map_or(0, |transfer| transfer.points.len()))?,
        })
    }
}

/// The triangle on which each view sample and each point of a gather sample lies.
pub struct SampleTriangles {
    pub view_samples: Vec<u32>,
    pub gather_points: Vec<u32>,
}

impl SampleTriangles {
    pub fn find(scene: &TracedScene, framebuffer: &DeepFramebuffer, transfer: Option<&Transfer>) -> Self {
        let of = |packets: &[SamplePacket], count: usize| {
            triangles_at(scene, (0..count).into_par_iter().map(|i| packets[i / PACKET_SIZE].lane(i % PACKET_SIZE)))
        };
        Self {
            view_samples: of(&framebuffer.packets, framebuffer.samples.len()),
            gather_points: transfer.map_or(Vec::new(), |transfer| of(&transfer.packets, transfer.points.len())),
        }
    }
}

/// Computes the factor on the light that reaches each of `samples` from a point of the light, on all cores. `color`: of
/// that light, by index and position of the sample. `triangles`: of the samples; needed if links scale the light.
pub fn compute(
    factors: &mut Buffer<UVec2>,
    color: Option<impl Fn(usize, Vec3) -> Vec3 + Sync>,
    scene: LinkedScene,
    samples: &[ViewSample],
    triangles: Option<&[u32]>,
) {
    let triangles = triangles.filter(|_| !scene.is_lit_evenly());
    let halves: &mut [f16] = bytemuck::cast_slice_mut(factors.host_mut());
    halves.par_chunks_mut(4 * SAMPLES_A_TASK).zip(samples.par_chunks(SAMPLES_A_TASK)).enumerate().for_each(
        |(task, (halves, samples))| {
            let mut rgb = [[1.0; 4]; SAMPLES_A_TASK];
            if let Some(color) = &color {
                for ((rgb, sample), index) in rgb.iter_mut().zip(samples).zip(task * SAMPLES_A_TASK..) {
                    *rgb = color(index, sample.position).extend(0.0).to_array();
                }
            }
            if let Some(triangles) = triangles {
                let triangles = &triangles[task * SAMPLES_A_TASK..];
                for (rgb, &triangle) in rgb.iter_mut().zip(triangles) {
                    *rgb = rgb.map(|x| x * scene.factor(triangle));
                }
            }
            halves.convert_from_f32_slice(&rgb.as_flattened()[..halves.len()]);
        },
    );
}
