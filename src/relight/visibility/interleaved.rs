//! The vectors of one or several lights, interleaved in one buffer, and kernels for them.

use std::sync::Arc;

use glam::{Vec3, Vec4};

use crate::error::Result;
use crate::gpu::{Buffer, Context, HostPass, Kernel, SharedFloat};
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

/// The vectors of one or several lights on the host: `[element][place][4]`, RGB and a float that is not used.
#[derive(Clone, Copy)]
pub struct LightVectors<'a> {
    pub floats: &'a [SharedFloat],
    /// Number of vectors that are interleaved.
    pub places: usize,
    /// The first `lights` of them are valid.
    pub lights: usize,
}

impl<'a> LightVectors<'a> {
    /// Those of `lights` lights in `buffer`, which `pass` writes.
    pub fn new(pass: &'a HostPass, buffer: &'a Buffer<Vec4>, lights: usize) -> Self {
        Self { floats: SharedFloat::of(pass.write(buffer)), places: vectors(lights) as usize, lights }
    }

    pub fn get(&self, element: usize, light: usize) -> Vec3 {
        let [r, g, b, _] = self.place(element, light);
        Vec3::new(r.get(), g.get(), b.get())
    }

    pub fn set(&self, element: usize, light: usize, rgb: Vec3) {
        let [r, g, b, _] = self.place(element, light);
        r.set(rgb.x);
        g.set(rgb.y);
        b.set(rgb.z);
    }

    fn place(&self, element: usize, light: usize) -> &'a [SharedFloat; 4] {
        self.floats[4 * (element * self.places + light)..].first_chunk().expect("elements have four floats")
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
