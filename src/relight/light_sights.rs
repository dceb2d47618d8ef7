//! What the eye sees of lights with a size themselves: directly, in mirrors, and in glossy surfaces that are almost
//! mirrors, whose highlights have the shape of the light. Computed on the host, as shadow rays are.
//!
//! Directly and in mirrors a light is met by the segments of the eye paths, which no edit of the lights changes. In a
//! narrow lobe it is found twice: by its points, in shade_light.comp, and here by directions that are drawn from the
//! lobe. The power heuristic [Veach 1995, Eq. 15] weighs both.

use std::ops::Range;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Layers;
use super::light_cache::LightPoints;
use crate::bake::DeepFramebuffer;
use crate::bake::framebuffer::view_samples::{PathSegment, segments};
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::physics::brdf::Lobes;
use crate::physics::octahedral::decode;
use crate::physics::sequence::{Points, fibonacci_lattice};
use crate::scene::Rig;
use crate::shared::{AddSightsPush, Brdf, DIRECTIONS_PER_POINT, NARROW_ALPHA, NO_BRDF};
use crate::trace::bvh::TracedScene;
use crate::trace::light_surface::{ArrivingLight, LightInScene};

/// Where the eye may see a light itself, and the light of some lights.
pub struct LightSights {
    /// By pixel.
    sights: Vec<(u32, Sight)>,
    /// First sight of each pixel that has any, and their number at the end.
    first: Vec<u32>,
    /// In tile order.
    pixels: Buffer<u32>,
    /// Light in these pixels, of each light of a frame.
    values: [Buffer<Vec3>; LIGHTS_A_FRAME],
    used: usize,
    /// Whether the eye's own segments are among the sights: a light is visible.
    from_eye: bool,
    kernel: Kernel<AddSightsPush>,
}

/// A place in a pixel where the eye may see a light itself.
enum Sight {
    Segment(PathSegment),
    NarrowLobe { sample: u32, layer: u32, weight: Vec3 },
}

/// Number of lights with a size whose images one frame renders.
const LIGHTS_A_FRAME: usize = 2;
/// Directions drawn from a narrow lobe if the light's points are interleaved.
const INTERLEAVED_DIRECTIONS: u32 = 4;
/// Pixels of one task.
const PIXELS_A_TASK: usize = 256;
/// Brightest light in a pixel, from a light of unit intensity: it remains finite times any intensity up to 1e8.
const MAX_VALUE: f64 = 1e30;

impl LightSights {
    /// Follows the eye paths of a baked view as far as `rig` needs it; `None` if its lights have no size or cannot be seen.
    pub fn find(
        context: &Arc<Context>,
        scene: &TracedScene,
        framebuffer: &DeepFramebuffer,
        rig: &Rig,
    ) -> Result<Option<Self>> {
        if !rig.has_sizes() {
            return Ok(None);
        }
        let from_eye = has_visible(rig);
        let mut sights = narrow_lobes(framebuffer);
        if from_eye || scene.has_mirrors() {
            let wanted = |segment: &PathSegment| from_eye || segment.mirror.is_some();
            let segments = segments(scene, framebuffer, wanted);
            sights.extend(segments.into_iter().map(|(pixel, segment)| (pixel, Sight::Segment(segment))));
        }
        sights.sort_by_key(|(pixel, _)| *pixel);
        let is_first = |i: &u32| *i == 0 || sights[*i as usize - 1].0 != sights[*i as usize].0;
        let mut first: Vec<u32> = (0..sights.len() as u32).filter(is_first).collect();
        let pixels: Vec<u32> = first.iter().map(|&i| sights[i as usize].0).collect();
        first.push(sights.len() as u32);
        if pixels.is_empty() {
            return Ok(None);
        }
        let values = || Buffer::new(context, "seen lights", Access::HostWrites, pixels.len());
        Ok(Some(Self {
            sights,
            first,
            values: [values()?, values()?],
            pixels: Buffer::from_slice(context, "seen lights (pixels)", &pixels)?,
            used: 0,
            from_eye,
            kernel: Kernel::new(context, ())?,
        }))
    }

    /// Whether the sights suffice for the lights of `rig`.
    pub fn suffice(&self, rig: &Rig) -> bool {
        self.from_eye || !has_visible(rig)
    }

    /// Begins a new frame: all buffers are free.
    pub fn restart(&mut self) {
        self.used = 0;
    }

    /// Whether a buffer is free.
    pub fn has_room(&self) -> bool {
        self.used < self.values.len()
    }

    /// Looks for a light of unit intensity in all sights, on all cores; directions are those that go with `points` of it.
    /// Returns the index of a buffer for [`Self::add`], or `None` if the eye sees nothing of the light. `triangles`: of the
    /// view samples; needed if links scale the light.
    pub fn look(
        &mut self,
        framebuffer: &DeepFramebuffer,
        light: LightInScene,
        points: LightPoints,
        layers: Layers,
        triangles: Option<&[u32]>,
    ) -> Option<usize> {
        let index = self.used;
        let Self { sights, first, values, .. } = self;
        let look = Look { framebuffer, light, points, triangles };
        let values = values[index].host_mut();
        let is_seen = values
            .par_chunks_mut(PIXELS_A_TASK)
            .zip(first.par_chunks(PIXELS_A_TASK))
            .enumerate()
            .map(|(task, (values, starts))| {
                let ends = &first[task * PIXELS_A_TASK + 1..];
                let mut is_seen = false;
                for ((value, &start), &end) in values.iter_mut().zip(starts).zip(ends) {
                    let sights = sights[start as usize..end as usize].iter();
                    let sum: DVec3 = sights.filter_map(|(_, sight)| look.at(sight, layers)).sum();
                    *value = sum.min(DVec3::splat(MAX_VALUE)).as_vec3();
                    is_seen |= sum != DVec3::ZERO;
                }
                is_seen
            })
            .reduce(|| false, |a, b| a | b);
        self.used += usize::from(is_seen);
        is_seen.then_some(index)
    }

    /// Adds what [`Self::look`] found to the image of the light: planes R, G, B of `pixel_stride` floats.
    pub fn add<T: crate::shared::gpu_struct::Glsl>(
        &self,
        frame: &mut Frame,
        index: usize,
        image: &Buffer<T>,
        pixel_stride: u32,
    ) {
        let mut pass = frame.pass("add seen lights");
        let push = AddSightsPush {
            pixels: pass.read(&self.pixels),
            values: pass.read(&self.values[index]),
            image: pass.write_as(image),
            count: self.pixels.len() as u32,
            pixel_stride,
        };
        pass.dispatch(&self.kernel, &push, push.count);
    }
}

/// What [`LightSights::look`] looks for.
struct Look<'a> {
    framebuffer: &'a DeepFramebuffer,
    light: LightInScene<'a>,
    points: LightPoints,
    triangles: Option<&'a [u32]>,
}

impl Look<'_> {
    /// Light in the pixel.
    fn at(&self, sight: &Sight, layers: Layers) -> Option<DVec3> {
        let is_shown = |layer: u32| layers.mask() >> layer.min(31) & 1 != 0;
        match *sight {
            Sight::Segment(PathSegment { origin, direction, range, weight, layer, mirror }) if is_shown(layer) => {
                Some(weight.as_dvec3() * self.light.seen(mirror, [origin, direction], range)?)
            }
            Sight::NarrowLobe { sample, layer, weight } if is_shown(layer) => {
                Some(weight.as_dvec3() * self.in_lobe(sample as usize))
            }
            _ => None,
        }
    }

    /// Light that a view sample reflects from the drawn directions.
    fn in_lobe(&self, index: usize) -> DVec3 {
        let sample = &self.framebuffer.samples[index];
        let [normal, wo] = [sample.normal, sample.wo].map(|v| decode(v).as_dvec3().normalize());
        let brdf: &Brdf = &self.framebuffer.brdfs[sample.brdf as usize];
        let Some(lobe) = Lobes::of_specular_lobe(brdf, normal, wo) else { return DVec3::ZERO };
        let geometric_normal = self.framebuffer.geometric_normals[index];
        let offset = self.light.scene.bvh.shadow_offset(0.0);
        let triangle = self.triangles.map_or(0, |triangles| triangles[index]);
        let [shift_u, shift_v, ..] = Points::new(0, index as u64).at(0, 0);
        let (drawn, of) = drawn_directions(self.points);
        let count = f64::from(drawn.end - drawn.start);
        let points_per_direction = 1.0 / f64::from(directions_per_point(self.points));
        let mut sum = DVec3::ZERO;
        for i in drawn {
            let [u, v] = fibonacci_lattice(i, of);
            let Some(wi) = lobe.sample([(u + shift_u).fract(), (v + shift_v).fract(), 0.0]) else { continue };
            let direction = wi.as_vec3();
            let side = offset.copysign(geometric_normal.dot(direction));
            let origin = sample.position + geometric_normal * (self.framebuffer.lifts[index] + side);
            let Some(ArrivingLight { radiance, density }) = self.light.arriving(triangle, [origin, direction], None)
            else {
                continue;
            };
            let reflected = lobe.at(wi);
            // Power heuristic [Veach 1995, Eq. 15].
            let by_points = density * points_per_direction / reflected.density;
            sum += reflected.sum() * radiance / (count * reflected.density * (1.0 + by_points * by_points));
        }
        sum
    }
}

/// Directions to draw from a narrow lobe together with `points` of a light, of how many.
fn drawn_directions(points: LightPoints) -> (Range<u32>, u32) {
    match points {
        LightPoints::One => (0..0, 1),
        LightPoints::Interleaved => (0..INTERLEAVED_DIRECTIONS, INTERLEAVED_DIRECTIONS),
        LightPoints::Some { first, end, of } => (first..end, of),
    }
}

/// Directions drawn from a narrow lobe per point of the light that shades it.
pub fn directions_per_point(points: LightPoints) -> f32 {
    match points {
        LightPoints::Interleaved => DIRECTIONS_PER_POINT,
        _ => 1.0,
    }
}

fn has_visible(rig: &Rig) -> bool {
    rig.lights.iter().any(|light| light.visible && !light.is_punctual())
}

/// The view samples with narrow lobes, each with its pixel.
fn narrow_lobes(framebuffer: &DeepFramebuffer) -> Vec<(u32, Sight)> {
    let is_narrow = |index: usize| {
        let brdf = framebuffer.samples[index].brdf;
        brdf != NO_BRDF && {
            let brdf = &framebuffer.brdfs[brdf as usize];
            brdf.has_lobe() && brdf.alpha < NARROW_ALPHA
        }
    };
    let pixel_count = framebuffer.pixel_stride();
    let parts = &framebuffer.extra_pixels;
    let first_weight = |pixel: usize| {
        let part = parts.binary_search_by_key(&(pixel as u32), |part| part.pixel);
        part.map_or(1.0, |part| parts[part].first_weight)
    };
    let first = (0..pixel_count).filter(|&pixel| is_narrow(pixel)).map(|pixel| {
        let weight = Vec3::splat(first_weight(pixel));
        (pixel as u32, Sight::NarrowLobe { sample: pixel as u32, layer: 0, weight })
    });
    let extras = parts.iter().flat_map(|part| {
        let listed = &framebuffer.extra_indices[part.first as usize..][..part.count as usize];
        listed.iter().filter(|&&extra| is_narrow(pixel_count + extra as usize)).map(|&extra| {
            let of = &framebuffer.extra_samples[extra as usize];
            let sample = (pixel_count + extra as usize) as u32;
            (part.pixel, Sight::NarrowLobe { sample, layer: of.layer, weight: of.weight })
        })
    });
    first.chain(extras).collect()
}
