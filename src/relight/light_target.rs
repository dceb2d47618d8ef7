//! Lights whose radiance a pass adds to their images.

use glam::Vec4;

use super::indirect::host_product::ViewSampleRadiance;
use super::visibility::Visibility;
use super::visibility::soft_light::{SoftLight, SoftLights};
use crate::gpu::{Buffer, HostPass, Pass, SharedFloat};
use crate::shared::gpu_struct::Write;
use crate::shared::{MAX_LIGHTS_PER_PASS, PackedLight};

/// A punctual light, a point of another one or its interleaved points, with its visibility, and the buffers to
/// which its radiance is added.
pub struct LightTarget<'a> {
    pub light: PackedLight,
    /// If its points are interleaved; they are in `visibility`, too.
    pub soft: Option<(&'a SoftLight, &'a SoftLights)>,
    pub visibility: &'a Visibility,
    /// Whether the factors of `visibility` multiply the light.
    pub has_factors: bool,
    /// See [`ShadeLightPush::drawn_area`](crate::shared::ShadeLightPush::drawn_area).
    pub drawn_area: f32,
    pub image: &'a Buffer<Vec4>,
    pub extras: &'a Buffer<f32>,
}

/// One to [`MAX_LIGHTS_PER_PASS`] lights that share one read of the factors.
pub struct LightTargets<'a> {
    /// Points of each light.
    pub lights: &'a [&'a [LightTarget<'a>]],
    pub pixel_stride: u32,
    pub extra_stride: u32,
}

impl<'a> LightTargets<'a> {
    /// Missing lights reuse the first light's address.
    fn addresses<T: Copy>(&self, mut of: impl FnMut(&'a LightTarget<'a>) -> T) -> [T; MAX_LIGHTS_PER_PASS as usize] {
        let first = of(&self.lights[0][0]);
        std::array::from_fn(|i| if i == 0 { first } else { self.lights.get(i).map_or(first, |light| of(&light[0])) })
    }

    pub fn images(&self, pass: &mut Pass) -> [Write<f32>; MAX_LIGHTS_PER_PASS as usize] {
        self.addresses(|target| pass.write_as(target.image))
    }

    /// For a pass on the host.
    pub fn view_samples<'p>(&self, pass: &'p HostPass) -> [ViewSampleRadiance<'p>; MAX_LIGHTS_PER_PASS as usize]
    where
        'a: 'p,
    {
        let [pixel_stride, extra_stride] = [self.pixel_stride, self.extra_stride].map(|stride| stride as usize);
        self.addresses(|target| ViewSampleRadiance {
            pixels: SharedFloat::of(pass.write(target.image)),
            extras: SharedFloat::of(pass.write(target.extras)),
            pixel_stride,
            extra_stride,
        })
    }

    pub fn extras(&self, pass: &mut Pass) -> [Write<f32>; MAX_LIGHTS_PER_PASS as usize] {
        self.addresses(|target| pass.write(target.extras))
    }
}
