//! Lights whose radiance a pass adds to their images.

use glam::Vec4;

use super::visibility::Visibility;
use crate::gpu::{Buffer, Pass};
use crate::shared::gpu_struct::Write;
use crate::shared::{LIGHTS_A_PASS, PackedLight};

/// A light, its visibility, and the buffers to which its radiance is added.
pub struct Lit<'a> {
    pub light: PackedLight,
    pub visibility: &'a Visibility,
    pub image: &'a Buffer<Vec4>,
    pub extras: &'a Buffer<f32>,
}

/// One to [`LIGHTS_A_PASS`] lights that share one read of the factors.
pub struct Targets<'a> {
    pub lights: &'a [Lit<'a>],
    pub pixel_stride: u32,
    pub extra_stride: u32,
}

impl Targets<'_> {
    /// Missing lights reuse the first light's address.
    fn addresses<T: Copy>(&self, mut of: impl FnMut(&Lit) -> T) -> [T; LIGHTS_A_PASS as usize] {
        let first = of(&self.lights[0]);
        std::array::from_fn(|i| if i == 0 { first } else { self.lights.get(i).map_or(first, &mut of) })
    }

    pub fn images(&self, pass: &mut Pass) -> [Write<f32>; LIGHTS_A_PASS as usize] {
        self.addresses(|lit| pass.write_as(lit.image))
    }

    pub fn extras(&self, pass: &mut Pass) -> [Write<f32>; LIGHTS_A_PASS as usize] {
        self.addresses(|lit| pass.write(lit.extras))
    }
}
