//! What the eye sees of area lights themselves: directly, in mirrors, and in glossy surfaces that are almost
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
use crate::scene::{Light, LightKind, Rig, SkyMap};
use crate::shared::{AddSightsPush, Brdf, DIRECTIONS_PER_POINT, NARROW_ALPHA, NO_BRDF};
use crate::trace::bvh::TracedScene;
use crate::trace::light_surface::{ArrivingLight, LightInScene};

/// Where the eye may see a light itself, and the light of some lights.
pub struct LightSights {
    /// For lights that are no domes.
    segments: ByPixel<PathSegment>,
    /// For domes.
    skies: ByPixel<SkySight>,
    lobes: ByPixel<NarrowLobe>,
    /// Those in the lists, in tile order.
    pixels: Buffer<u32>,
    /// Light in these pixels, of each light of a frame.
    values: [Buffer<Vec3>; LIGHTS_A_FRAME],
    used: usize,
    needs: Needs,
    kernel: Kernel<AddSightsPush>,
}

/// Which lists the lights of a rig need.
#[derive(Clone, Copy, PartialEq)]
struct Needs {
    /// The eye's own segments, not only those from mirrors: a light is visible.
    from_eye: bool,
    segments: bool,
    skies: bool,
}

/// Items of each pixel of a list.
struct ByPixel<T> {
    items: Vec<T>,
    /// First item of each pixel, and their number at the end.
    first: Vec<u32>,
}

/// Where a segment of an eye path leaves the scene.
struct SkySight {
    /// Where maps of domes are read; see [`SkyMap::place`].
    place: [f32; 2],
    weight: Vec3,
    layer: u32,
    /// Triangle at the origin; `None` if the eye looks directly.
    mirror: Option<u32>,
}

/// A view sample whose lobe may show lights.
struct NarrowLobe {
    sample: u32,
    layer: u32,
    weight: Vec3,
}

/// Number of area lights whose images one frame renders.
const LIGHTS_A_FRAME: usize = 2;
/// Directions drawn from a narrow lobe if the light's points are interleaved.
const INTERLEAVED_DIRECTIONS: u32 = 4;
/// Pixels of one task.
const PIXELS_A_TASK: usize = 256;
/// Brightest light in a pixel, from a light of unit intensity: it remains finite times any intensity up to 1e8.
const MAX_VALUE: f64 = 1e30;

impl LightSights {
    /// Follows the eye paths of a baked view as far as `rig` needs it; `None` if its lights have no size.
    pub fn find(
        context: &Arc<Context>,
        scene: &TracedScene,
        framebuffer: &DeepFramebuffer,
        rig: &Rig,
    ) -> Result<Option<Self>> {
        if !rig.has_sizes() {
            return Ok(None);
        }
        let needs = Needs::of(rig);
        let lobes = narrow_lobes(framebuffer);
        let leaves = |segment: &PathSegment| segment.range[1].is_infinite();
        let wanted =
            |segment: &PathSegment| (needs.from_eye || segment.mirror.is_some()) && (needs.segments || leaves(segment));
        let mut all = match needs.from_eye || scene.has_mirrors() {
            true => segments(scene, framebuffer, wanted),
            false => Vec::new(),
        };
        let to_sky = all.iter().filter(|(_, segment)| needs.skies && leaves(segment));
        let skies: Vec<_> = to_sky.map(|(pixel, segment)| (*pixel, SkySight::new(segment))).collect();
        if !needs.segments {
            all.clear();
        }
        let mut pixels: Vec<u32> = lobes.iter().map(|(pixel, _)| *pixel).collect();
        pixels.extend(all.iter().map(|(pixel, _)| *pixel));
        pixels.extend(skies.iter().map(|(pixel, _)| *pixel));
        pixels.sort_unstable();
        pixels.dedup();
        let values = || Buffer::new(context, "seen lights", Access::HostWrites, pixels.len());
        Ok(Some(Self {
            segments: ByPixel::new(&pixels, all),
            skies: ByPixel::new(&pixels, skies),
            lobes: ByPixel::new(&pixels, lobes),
            values: [values()?, values()?],
            pixels: Buffer::from_slice(context, "seen lights (pixels)", &pixels)?,
            used: 0,
            needs,
            kernel: Kernel::new(context, ())?,
        }))
    }

    /// Whether the lists suffice for the lights of `rig`.
    pub fn suffice(&self, rig: &Rig) -> bool {
        let needs = Needs::of(rig);
        (self.needs.from_eye || !needs.from_eye)
            && (self.needs.segments || !needs.segments)
            && (self.needs.skies || !needs.skies)
    }

    /// Begins a new frame: all buffers are free.
    pub fn restart(&mut self) {
        self.used = 0;
    }

    /// Whether a buffer is free.
    pub fn has_room(&self) -> bool {
        self.used < self.values.len()
    }

    /// Looks for a light of unit intensity in all sights, on all cores; directions are those that go with `points` of
    /// it. Returns the index of a buffer for [`Self::add`], or `None` if the eye sees nothing of the light.
    /// `triangles`: of the view samples; needed if links scale the light.
    pub fn look(
        &mut self,
        framebuffer: &DeepFramebuffer,
        light: LightInScene,
        points: LightPoints,
        layers: Layers,
        triangles: Option<&[u32]>,
    ) -> Option<usize> {
        let index = self.used;
        let Self { segments, skies, lobes, values, .. } = self;
        let is_dome = light.light.kind == LightKind::Dome;
        let look = Look { framebuffer, light, points, triangles };
        let is_shown = |layer: u32| layers.mask() >> layer.min(31) & 1 != 0;
        let light_in = |pixel: usize| {
            let mut sum = DVec3::ZERO;
            if is_dome {
                let shown = skies.of(pixel).iter().filter(|sight| is_shown(sight.layer));
                sum += shown.map(|sight| look.to_sky(sight)).sum::<DVec3>();
            } else {
                let shown = segments.of(pixel).iter().filter(|segment| is_shown(segment.layer));
                sum += shown.map(|segment| look.along(segment)).sum::<DVec3>();
            }
            let shown = lobes.of(pixel).iter().filter(|lobe| is_shown(lobe.layer));
            sum + shown.map(|lobe| lobe.weight.as_dvec3() * look.in_lobe(lobe.sample as usize)).sum::<DVec3>()
        };
        let values = values[index].host_mut();
        let is_seen = values
            .par_chunks_mut(PIXELS_A_TASK)
            .enumerate()
            .map(|(task, values)| {
                let mut is_seen = false;
                for (pixel, value) in (task * PIXELS_A_TASK..).zip(values) {
                    let sum = light_in(pixel);
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
    fn along(&self, &PathSegment { origin, direction, range, weight, mirror, .. }: &PathSegment) -> DVec3 {
        let seen = self.light.seen(mirror, [origin, direction], range);
        seen.map_or(DVec3::ZERO, |seen| weight.as_dvec3() * seen)
    }

    fn to_sky(&self, sight: &SkySight) -> DVec3 {
        sight.weight.as_dvec3() * self.light.seen_sky(sight.mirror, sight.place)
    }

    /// Light that a view sample reflects from the drawn directions.
    fn in_lobe(&self, index: usize) -> DVec3 {
        let (drawn, of) = drawn_directions(self.points);
        if drawn.is_empty() {
            return DVec3::ZERO;
        }
        let sample = &self.framebuffer.samples[index];
        let [normal, wo] = [sample.normal, sample.wo].map(|v| decode(v).as_dvec3().normalize());
        let brdf: &Brdf = &self.framebuffer.brdfs[sample.brdf as usize];
        let Some(lobe) = Lobes::of_specular_lobe(brdf, normal, wo) else { return DVec3::ZERO };
        let geometric_normal = self.framebuffer.geometric_normals[index];
        let offset = self.light.scene.bvh.shadow_offset(0.0);
        let triangle = self.triangles.map_or(0, |triangles| triangles[index]);
        let [shift_u, shift_v, ..] = Points::new(0, index as u64).at(0, 0);
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

impl Needs {
    fn of(rig: &Rig) -> Self {
        let any = |is: fn(&Light) -> bool| rig.lights.iter().any(|light| !light.is_punctual() && is(light));
        Self {
            from_eye: any(|light| light.visible),
            segments: any(|light| light.kind != LightKind::Dome),
            skies: any(|light| light.kind == LightKind::Dome),
        }
    }
}

impl SkySight {
    fn new(&PathSegment { direction, weight, layer, mirror, .. }: &PathSegment) -> Self {
        Self { place: SkyMap::place(direction), weight, layer, mirror }
    }
}

impl<T> ByPixel<T> {
    /// `pixels`: ascending, with all of `listed`.
    fn new(pixels: &[u32], mut listed: Vec<(u32, T)>) -> Self {
        listed.sort_by_key(|(pixel, _)| *pixel);
        let mut first: Vec<u32> = Vec::with_capacity(pixels.len() + 1);
        let mut at = 0;
        for &pixel in pixels {
            first.push(at as u32);
            at += listed[at..].partition_point(|(of, _)| *of <= pixel);
        }
        first.push(at as u32);
        Self { items: listed.into_iter().map(|(_, item)| item).collect(), first }
    }

    /// Items of the pixel at `index` of the pixels.
    fn of(&self, index: usize) -> &[T] {
        &self.items[self.first[index] as usize..self.first[index + 1] as usize]
    }
}

/// The view samples with narrow lobes, each with its pixel.
fn narrow_lobes(framebuffer: &DeepFramebuffer) -> Vec<(u32, NarrowLobe)> {
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
        (pixel as u32, NarrowLobe { sample: pixel as u32, layer: 0, weight })
    });
    let extras = parts.iter().flat_map(|part| {
        let listed = &framebuffer.extra_indices[part.first as usize..][..part.count as usize];
        listed.iter().filter(|&&extra| is_narrow(pixel_count + extra as usize)).map(|&extra| {
            let of = &framebuffer.extra_samples[extra as usize];
            let sample = (pixel_count + extra as usize) as u32;
            (part.pixel, NarrowLobe { sample, layer: of.layer, weight: of.weight })
        })
    });
    first.chain(extras).collect()
}
