//! A sparse matrix on the device, or some of its slices.

use std::sync::Arc;

use glam::{UVec4, Vec4};

use crate::bake::transfer::sparse::Piece;
use crate::error::Result;
use crate::gpu::{Buffer, Context, Frame};
use crate::relight::factor_budget::FactorBudget;
use crate::relight::light_target::LightTargets;
use crate::relight::visibility::interleaved::KernelVariants;
use crate::shared::{GROUP_SIZE, LightsConstants, MultiplySparsePush, Slice};

/// Product of a sparse matrix with λ0, added to view samples.
pub struct SparseProduct {
    slices: Buffer<Slice>,
    values: Buffer<UVec4>,
    outputs: Buffer<u32>,
    kernels: KernelVariants<MultiplySparsePush>,
}

impl SparseProduct {
    pub fn new(context: &Arc<Context>, matrix: &Piece, budget: &mut FactorBudget) -> Result<Self> {
        Ok(Self {
            slices: budget.upload(context, "transfer (slices)", &matrix.slices)?,
            values: budget.upload(context, "transfer (terms)", matrix.values)?,
            outputs: budget.upload(context, "transfer (outputs)", matrix.outputs)?,
            kernels: KernelVariants::new(context, |lights| LightsConstants { lights })?,
        })
    }

    pub fn run(&self, frame: &mut Frame, vector: &Buffer<Vec4>, targets: &LightTargets) {
        let mut pass = frame.pass("transfer to pixels");
        let push = MultiplySparsePush {
            slices: pass.read(&self.slices),
            values: pass.read(&self.values),
            outputs: pass.read(&self.outputs),
            vector: pass.read(vector),
            images: targets.images(&mut pass),
            extras: targets.extras(&mut pass),
            slice_count: self.slices.len() as u32,
            pixel_stride: targets.pixel_stride,
            extra_stride: targets.extra_stride,
            light_count: targets.lights.len() as u32,
        };
        pass.dispatch(self.kernels.get(targets.lights.len()), &push, push.slice_count * GROUP_SIZE);
    }
}
