//! Factors on the light of filtered lights: what the filters let through towards each view sample and each point of a
//! gather sample. Computed on the host, as shadow rays are, so that no kernel knows any filter.

use std::sync::Arc;

use glam::UVec2;
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context};
use crate::scene::light_filter::PosedFilter;
use crate::shared::{PackedLight, ViewSample};

/// RGB factors of one light in half precision.
pub struct LightFactors {
    pub view_samples: Buffer<UVec2>,
    pub gather_points: Buffer<UVec2>,
}

/// Samples of one task.
const SAMPLES_A_TASK: usize = 1024;

impl LightFactors {
    /// Room for all samples; without `filtered` for none, since kernels do not read them.
    pub fn new(
        context: &Arc<Context>,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
        filtered: bool,
    ) -> Result<Self> {
        let room = |samples: usize| -> Result<Buffer<UVec2>> {
            let count = if filtered { samples } else { 0 };
            let mut factors = Buffer::new(context, "light filters", Access::HostWrites, count)?;
            factors.host_mut().fill(UVec2::ZERO);
            Ok(factors)
        };
        Ok(Self {
            view_samples: room(framebuffer.samples.len())?,
            gather_points: room(transfer.map_or(0, |transfer| transfer.points.len()))?,
        })
    }
}

/// Computes the factor on the light that reaches each of `samples`, on all cores.
pub fn compute(factors: &mut Buffer<UVec2>, filter: &PosedFilter, light: &PackedLight, samples: &[ViewSample]) {
    let halves: &mut [f16] = bytemuck::cast_slice_mut(factors.host_mut());
    halves.par_chunks_mut(4 * SAMPLES_A_TASK).zip(samples.par_chunks(SAMPLES_A_TASK)).for_each(|(halves, samples)| {
        let mut rgb = [[0.0; 4]; SAMPLES_A_TASK];
        for (rgb, sample) in rgb.iter_mut().zip(samples) {
            let direction = (sample.position - light.position).normalize_or_zero();
            *rgb = filter.factor(direction).extend(0.0).to_array();
        }
        halves.convert_from_f32_slice(&rgb.as_flattened()[..halves.len()]);
    });
}
