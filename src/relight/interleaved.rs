//! The vectors of one or several lights, interleaved in one buffer, and kernels for them.

use std::sync::Arc;

use glam::Vec4;

use crate::error::Result;
use crate::gpu::{Buffer, Context, Kernel};
use crate::shared::MAX_LIGHTS_PER_PASS;
use crate::shared::gpu_struct::{Compute, Push};

/// A kernel for one light, and one for up to [`MAX_LIGHTS_PER_PASS`] lights.
pub struct KernelVariants<P: Push<Pipeline = Compute>>([Kernel<P>; 2]);

/// Number of interleaved vectors.
pub fn vectors(light_count: usize) -> u32 {
    if light_count > 1 { MAX_LIGHTS_PER_PASS } else { 1 }
}

impl<P: Push<Pipeline = Compute>> KernelVariants<P> {
    /// `constants` returns the specialization constants for a number of lights.
    pub fn new(context: &Arc<Context>, constants: impl Fn(u32) -> P::Constants) -> Result<Self> {
        let kernel = |lights| Kernel::new(context, constants(lights));
        Ok(Self([kernel(1)?, kernel(MAX_LIGHTS_PER_PASS)?]))
    }

    pub fn get(&self, light_count: usize) -> &Kernel<P> {
        &self.0[usize::from(vectors(light_count) > 1)]
    }
}

/// One light's vector in an interleaved buffer.
pub struct Strided<'a> {
    pub buffer: &'a Buffer<Vec4>,
    /// Distance between elements of one light.
    pub stride: u32,
    /// Index of the light's first element.
    pub offset: u32,
}
