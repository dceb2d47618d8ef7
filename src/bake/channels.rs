//! The deep framebuffer as images: the content of each of its layers at every pixel.

use glam::Vec3;

use super::DeepFramebuffer;
use crate::physics::octahedral;
use crate::scene::MeshSpace;
use crate::shared::{Brdf, NO_BRDF};

/// One attribute of view samples or of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Straight-line distance from the camera, metres, also for surfaces seen in mirrors.
    Distance,
    /// World space, metres.
    Position,
    /// Unit shading normal, world space: interpolated, normal map included.
    Normal,
    /// Unit normal of the triangle, world space.
    GeometricNormal,
    /// Linear Rec. 709.
    BaseColor,
    Metallic,
    /// As in glTF: the square root of GGX's alpha.
    Roughness,
    /// Product of BRDFs and cosines along the path through mirrors.
    Weight,
    /// Number of surfaces along the pixel's path through mirrors.
    Layers,
    /// Number of view samples of the pixel: more than one per layer only on edges.
    Samples,
}

impl Channel {
    pub const ALL: [Self; 10] = [
        Self::Distance,
        Self::Position,
        Self::Normal,
        Self::GeometricNormal,
        Self::BaseColor,
        Self::Metallic,
        Self::Roughness,
        Self::Weight,
        Self::Layers,
        Self::Samples,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Distance => "distance",
            Self::Position => "position",
            Self::Normal => "normal",
            Self::GeometricNormal => "geometric normal",
            Self::BaseColor => "base colour",
            Self::Metallic => "metallic",
            Self::Roughness => "roughness",
            Self::Weight => "weight",
            Self::Layers => "layers",
            Self::Samples => "samples",
        }
    }

    /// Whether each layer has its own value.
    pub fn has_layers(self) -> bool {
        !matches!(self, Self::Layers | Self::Samples)
    }
}

impl DeepFramebuffer {
    /// One value per pixel, row by row: that of the pixel's first sample in `layer`, counted from 0. `None` if there is
    /// no such sample, or if the surface reflects no direct light and the channel is a material property.
    pub fn channel(&self, channel: Channel, layer: u32, space: MeshSpace) -> Vec<Option<Vec3>> {
        let places = self.places(layer);
        let pixels = |y: u32| (0..self.tiling.width).map(move |x| self.tiling.index(x, y));
        let all = (0..self.tiling.height).flat_map(pixels);
        match channel {
            Channel::Layers | Channel::Samples => {
                let counts = self.counts(channel == Channel::Layers);
                all.map(|pixel| Some(Vec3::splat(counts[pixel] as f32))).collect()
            }
            _ => all
                .map(|pixel| {
                    let (sample, weight) = places[pixel]?;
                    self.value(channel, sample as usize, weight, space)
                })
                .collect(),
        }
    }

    /// View sample and weight of each pixel in `layer`, in tile order.
    fn places(&self, layer: u32) -> Vec<Option<(u32, Vec3)>> {
        let pixels = self.pixel_stride();
        if layer == 0 {
            let is_there = |i: &u32| self.geometric_normals[*i as usize] != Vec3::ZERO;
            return (0..pixels as u32).map(|i| Some(i).filter(is_there).map(|i| (i, Vec3::ONE))).collect();
        }
        let mut places = vec![None; pixels];
        for pixel in &self.extra_pixels {
            let list = &self.extra_indices[pixel.first as usize..(pixel.first + pixel.count) as usize];
            let first = list.iter().find(|&&i| self.extra_samples[i as usize].layer == layer);
            places[pixel.pixel as usize] =
                first.map(|&i| (pixels as u32 + i, self.extra_samples[i as usize].weight / pixel.first_weight));
        }
        places
    }

    /// Number of layers or of samples of each pixel, in tile order.
    fn counts(&self, of_layers: bool) -> Vec<u32> {
        let mut counts: Vec<u32> =
            self.geometric_normals[..self.pixel_stride()].iter().map(|n| u32::from(*n != Vec3::ZERO)).collect();
        for pixel in &self.extra_pixels {
            let list = &self.extra_indices[pixel.first as usize..(pixel.first + pixel.count) as usize];
            let deepest = list.iter().map(|&i| self.extra_samples[i as usize].layer + 1).max();
            let count = &mut counts[pixel.pixel as usize];
            *count = if of_layers { (*count).max(deepest.unwrap_or(0)) } else { *count + pixel.count };
        }
        counts
    }

    fn value(&self, channel: Channel, i: usize, weight: Vec3, space: MeshSpace) -> Option<Vec3> {
        let sample = &self.samples[i];
        let position = space.to_world(sample.position);
        let brdf = || (sample.brdf != NO_BRDF).then(|| &self.brdfs[sample.brdf as usize]);
        Some(match channel {
            Channel::Distance => Vec3::splat((position - self.camera.position).length() as f32),
            Channel::Position => position.as_vec3(),
            Channel::Normal => octahedral::decode(sample.normal),
            Channel::GeometricNormal => self.geometric_normals[i],
            Channel::BaseColor => material(brdf()?).0,
            Channel::Metallic => Vec3::splat(material(brdf()?).1),
            Channel::Roughness => Vec3::splat(brdf()?.alpha.sqrt()),
            Channel::Weight => weight,
            Channel::Layers | Channel::Samples => unreachable!("they are of pixels"),
        })
    }
}

/// Base colour and metallic of a surface, recovered from the products of [`crate::trace::surface::brdf`]. With metallic
/// m and d = base (1 - m), f0 = dielectric + m (base - dielectric), hence 1 - m is a root of dielectric x² - (f0 + d) x
/// + d.
fn material(brdf: &Brdf) -> (Vec3, f32) {
    let dielectric = f64::from(brdf.dielectric_f0);
    // The brightest diffuse channel: the other channels have the same root up to rounding.
    let channel = (0..3).fold(0, |best, c| if brdf.diffuse[c] > brdf.diffuse[best] { c } else { best });
    let (d, f0) = (f64::from(brdf.diffuse[channel]), f64::from(brdf.f0[channel]));
    let sum = f0 + d;
    let root = (sum * sum - 4.0 * dielectric * d).max(0.0).sqrt();
    let is_black_dielectric = d == 0.0 && (brdf.f0 - brdf.dielectric_f0).abs().max_element() < 1e-6;
    let x = if is_black_dielectric {
        1.0
    } else if sum + root > 0.0 {
        2.0 * d / (sum + root)
    } else {
        1.0
    };
    let metallic = (1.0 - x).clamp(0.0, 1.0) as f32;
    let base = if x > 0.5 { brdf.diffuse / x as f32 } else { (brdf.f0 - (x * dielectric) as f32) / metallic };
    (base.max(Vec3::ZERO), metallic)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Surface;
    use crate::trace::surface;

    /// Base colour and metallic are recovered for dielectrics, metals and mixtures.
    #[test]
    fn base_colour_and_metallic_are_what_the_material_had() {
        for metallic in [0.0, 0.1, 0.5, 0.9, 1.0f32] {
            for base_color in [Vec3::new(0.8, 0.3, 0.05), Vec3::splat(0.5), Vec3::new(0.02, 0.9, 0.4), Vec3::ONE] {
                for ior in [1.5f32, 1.33] {
                    let surface = Surface {
                        base_color,
                        alpha: 1.0,
                        metallic,
                        roughness: 0.4,
                        specular: 1.0,
                        specular_color: Vec3::ONE,
                        ior,
                        emissive: Vec3::ZERO,
                        diffuse_weight: 1.0,
                        normal_t: Vec3::Z,
                    };
                    let (base, m) = material(&surface::brdf(&surface));
                    assert!((m - metallic).abs() < 1e-4, "{metallic}: {m}");
                    assert!((base - base_color).abs().max_element() < 1e-3, "{base_color} at {metallic}: {base}");
                }
            }
        }
    }
}
