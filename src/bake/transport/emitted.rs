//! Indirect light of emitters: one image for each, made while the rows of Φ are gathered.
//!
//! Emitters may be small and bright, so their light on view samples and on gather samples is estimated from both sides:
//! by points on the emitters, and by directions that surfaces reflect. The balance heuristic weighs them [Veach 1995,
//! Eq. 9]. What mirrors throw is left to [`Caustics`], except into narrow lobes. What gather samples reflect then takes
//! the way of all direct light.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::LightTransport;
use super::caustics::Caustics;
use super::directions::Lobe;
use super::level::local;
use super::paths::{Encounter, Paths};
use crate::bake::DeepFramebuffer;
use crate::bake::brdf_factors::Projection;
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::gather_samples::GatherPoint;
use crate::physics::brdf::{Lobes, Reflected, cosine_direction};
use crate::physics::octahedral;
use crate::physics::sequence::Points;
use crate::scene::Emitters;
use crate::shared::{NARROW_ALPHA, NO_BRDF};
use crate::trace::emitting_triangles::{EmittingTriangles, Receiver};

/// Indirect light of one emitter.
#[derive(Clone, Debug, PartialEq)]
pub struct EmitterLight {
    /// Index into the scene's [`Emitters`].
    pub emitter: u32,
    /// By view sample.
    pub radiance: Vec<Vec3>,
}

/// Computes the light of each emitter.
#[derive(Default)]
pub struct Emitted<'a> {
    /// `None` if nothing emits light.
    view: Option<View<'a>>,
    /// Of each emitter: what the rows of Φ are multiplied by for light that was reflected before.
    operands: Vec<Vec<DVec3>>,
}

/// What view samples see.
struct View<'a> {
    framebuffer: &'a DeepFramebuffer,
    lobe: Lobe,
    seed: u64,
    aims: Aims<'a>,
}

/// Rays to the emitters of a scene.
struct Aims<'a> {
    paths: Paths<'a>,
    emitters: Emitters,
    /// Of each emitter.
    triangles: Vec<EmittingTriangles>,
    caustics: Vec<Caustics>,
}

/// Rays from a view sample to all emitters, and bounds of those to each; and rays in directions that it reflects.
const AIMED_RAYS: usize = 256;
const AIMED_RAYS_EACH: [usize; 2] = [16, 64];
const LOBE_RAYS: usize = 256;
/// Rays from a point of a gather sample to each emitter, and in other directions.
const GATHER_RAYS: usize = 4;

/// A direction in which light of an emitter arrives.
struct Arriving {
    /// Unit, towards the light.
    wi: DVec3,
    /// RGB radiance, divided by the density of such directions: their sum estimates the integral.
    weight: DVec3,
    emitter: usize,
    is_thrown: bool,
}

impl<'a> Emitted<'a> {
    pub(super) fn new(transport: &'a LightTransport, framebuffer: &'a DeepFramebuffer, lobe: Lobe) -> Self {
        let scene = transport.scene();
        let emitters = Emitters::of(scene);
        if emitters.is_empty() || transport.bounces() == Some(0) {
            return Self::default();
        }
        let radiance = |emitter: u32, material: u32| match emitters.index(material) == Some(emitter) {
            true => scene.materials[material as usize].emissive.max_element().into(),
            false => 0.0,
        };
        let of_emitter = |emitter: u32| EmittingTriangles::new(scene, |material| radiance(emitter, material));
        let triangles: Vec<_> = (0..emitters.len() as u32).map(of_emitter).collect();
        let (paths, seed) = (Paths::new(scene, transport.settings.layers), transport.settings.seed);
        let mirrors = EmittingTriangles::new(scene, |material| f64::from(u8::from(paths.is_mirror(material))));
        let caustics = |(emitter, triangles): (usize, &EmittingTriangles)| {
            Caustics::new(&paths, triangles, &mirrors, &Points::new(seed ^ 8 << 32, emitter as u64))
        };
        let caustics = triangles.iter().enumerate().map(caustics).collect();
        let aims = Aims { paths, emitters, triangles, caustics };
        let bounces = transport.bounces().map(|bounces| bounces - 1);
        let reflected = aims.reflected(transport, seed ^ 7 << 32);
        let operands = reflected.iter().map(|light| transport.bounce_times(light, bounces).0).collect();
        Self { view: Some(View { framebuffer, lobe, seed: seed ^ 6 << 32, aims }), operands }
    }

    /// Number of emitters.
    pub fn count(&self) -> usize {
        self.operands.len()
    }

    /// Radiance at `view_samples`, whose rows are `rows`: for each that of all emitters.
    pub fn radiance(&self, rows: &CsrMatrix, view_samples: &[u32]) -> Vec<Vec3> {
        let Some(view) = &self.view else { return Vec::new() };
        let further: Vec<Vec<DVec3>> = self.operands.iter().map(|operand| rows.multiply(operand)).collect();
        let of_sample = |(row, &sample): (usize, &u32)| {
            let mut radiance = view.reflected(sample);
            radiance.iter_mut().zip(&further).for_each(|(sum, further)| *sum += further[row]);
            radiance.into_iter().map(DVec3::as_vec3)
        };
        view_samples.par_iter().enumerate().flat_map_iter(of_sample).collect()
    }

    /// Dark images of all emitters.
    pub fn images(&self, view_samples: usize) -> Vec<EmitterLight> {
        let image = |emitter| EmitterLight { emitter, radiance: vec![Vec3::ZERO; view_samples] };
        (0..self.count() as u32).map(image).collect()
    }
}

impl View<'_> {
    /// Light that comes from each emitter, straight or by mirrors, and is reflected to the eye.
    fn reflected(&self, sample: u32) -> Vec<DVec3> {
        let count = self.aims.triangles.len();
        let mut sums = vec![DVec3::ZERO; count];
        let view = &self.framebuffer.samples[sample as usize];
        if view.brdf == NO_BRDF {
            return sums;
        }
        let [normal, wo] = [view.normal, view.wo].map(|v| octahedral::decode(v).as_dvec3().normalize());
        let Some(lobes) = Lobes::new(&self.framebuffer.brdfs[view.brdf as usize], normal, wo) else { return sums };
        let receiver = Receiver {
            position: view.position,
            normal: normal.as_vec3(),
            geometric_normal: self.framebuffer.geometric_normals[sample as usize],
        };
        let is_narrow = self.framebuffer.brdfs[view.brdf as usize].alpha < NARROW_ALPHA;
        let [fewest, most] = AIMED_RAYS_EACH;
        let rays = [(AIMED_RAYS / count).clamp(fewest, most), LOBE_RAYS];
        let draw = |u| lobes.sample(u).map(|wi| (wi, lobes.at(wi).density));
        let points = Points::new(self.seed, sample.into());
        self.aims.look(
            &receiver,
            rays,
            &points,
            draw,
            |wi| lobes.at(wi).density,
            |Arriving { wi, weight, emitter, is_thrown }| {
                let at = lobes.at(wi);
                let part = match is_thrown {
                    true if is_narrow => at.specular,
                    true => DVec3::ZERO,
                    false if self.lobe == Lobe::All => at.sum(),
                    false => at.specular,
                };
                sums[emitter] += weight * part;
            },
        );
        let of_caustics = |wi: DVec3| {
            let Reflected { diffuse, specular, .. } = lobes.at(wi);
            let diffuse = if self.lobe == Lobe::All { diffuse } else { DVec3::ZERO };
            if is_narrow { diffuse } else { diffuse + specular }
        };
        for (sum, caustics) in sums.iter_mut().zip(&self.aims.caustics) {
            *sum += caustics.reflected(receiver.position, receiver.geometric_normal, of_caustics);
        }
        sums
    }
}

impl Aims<'_> {
    /// Looks for emitters: by `rays[0]` points on each, and by `rays[1]` directions that `draw` makes from three random
    /// numbers, with their `density`. `arrive` gets what they find, straight or by mirrors.
    fn look(
        &self,
        receiver: &Receiver,
        rays: [usize; 2],
        points: &Points,
        draw: impl Fn([f64; 3]) -> Option<(DVec3, f64)>,
        density: impl Fn(DVec3) -> f64,
        mut arrive: impl FnMut(Arriving),
    ) {
        let scene = self.paths.scene;
        let random = |i: usize, set: usize| {
            let [u, v, w, _] = points.at(i as u32, set as u32);
            [u, v, w]
        };
        let [aimed, drawn] = rays.map(|count| count as f64);
        for (emitter, triangles) in self.triangles.iter().enumerate() {
            for i in 0..rays[0] {
                let Some(found) = triangles.draw(scene, receiver, random(i, emitter)) else { continue };
                let weight = found.emission / (aimed * found.density + drawn * density(found.wi));
                arrive(Arriving { wi: found.wi, weight, emitter, is_thrown: false });
            }
        }
        for i in 0..rays[1] {
            let Some((wi, density)) = draw(random(i, self.triangles.len())) else { continue };
            let at_mirror = |layer: u32| random(i, self.triangles.len() + 1 + layer as usize);
            let mut is_straight = true;
            self.paths.follow(receiver.position, receiver.geometric_normal, wi.as_vec3(), at_mirror, |met| {
                let Encounter::Surface(arrival) = met else { return };
                // Points on emitters are not looked for in mirrors.
                let is_straight = std::mem::replace(&mut is_straight, false);
                let material = scene.mesh.triangle_materials[arrival.place.triangle as usize];
                let Some(emitter) = self.emitters.index(material) else { return };
                let seen = arrival.place.surface(scene, 0.0);
                let aimed_density = match is_straight {
                    true => aimed * self.triangles[emitter as usize].density(&seen, -arrival.wo, arrival.distance),
                    false => 0.0,
                };
                let emission = (arrival.tint * seen.emission).as_dvec3();
                let weight = emission / (drawn * density + aimed_density);
                arrive(Arriving { wi, weight, emitter: emitter as usize, is_thrown: !is_straight });
            });
        }
    }

    /// Coefficients of the fine level for light that comes from each emitter and is reflected once.
    fn reflected(&self, transport: &LightTransport, seed: u64) -> Vec<Vec<DVec3>> {
        let level = &transport.fine;
        let of_sample = |index: usize| {
            let sample = &level.samples.samples[index];
            let mut values = vec![Vec3::ZERO; level.coefficients(index).len()];
            let mut sums = vec![vec![DVec3::ZERO; values.len()]; self.triangles.len()];
            let share = 1.0 / level.samples.points_per_sample as f64;
            for (i, point) in level.samples.points_of(index).iter().enumerate() {
                let GatherPoint { position, normal, geometric_normal } = *point;
                let frame = point.frame(sample);
                let axes = frame.map(Vec3::as_dvec3);
                let draw = |[u, v, _]: [f64; 3]| {
                    let d = cosine_direction(u, v);
                    Some((axes[0] * d.x + axes[1] * d.y + axes[2] * d.z, d.z / std::f64::consts::PI))
                };
                let cosine = |wi: DVec3| axes[2].dot(wi).max(0.0);
                let density = |wi: DVec3| cosine(wi) / std::f64::consts::PI;
                let points = Points::new(seed, (index * level.samples.points_per_sample + i) as u64);
                let receiver = Receiver { position, normal, geometric_normal };
                let mut arrive = |emitter: usize, wi: DVec3, irradiance: DVec3| {
                    let at = local(&frame, wi.as_vec3());
                    if at.z > 0.0 {
                        Projection::get().project(&sample.brdf, at, &mut values);
                        for (sum, k) in sums[emitter].iter_mut().zip(&values) {
                            *sum += share * irradiance * k.as_dvec3();
                        }
                    }
                };
                self.look(&receiver, [GATHER_RAYS; 2], &points, draw, density, |arriving| {
                    let Arriving { wi, weight, emitter, is_thrown } = arriving;
                    if !is_thrown {
                        arrive(emitter, wi, weight * cosine(wi));
                    }
                });
                for (emitter, caustics) in self.caustics.iter().enumerate() {
                    caustics.arriving(position, geometric_normal, |wi, irradiance| arrive(emitter, wi, irradiance));
                }
            }
            sums
        };
        let by_sample: Vec<Vec<Vec<DVec3>>> = (0..level.samples.len()).into_par_iter().map(of_sample).collect();
        let of_emitter = |emitter: usize| by_sample.iter().flat_map(|sums| sums[emitter].iter().copied()).collect();
        (0..self.triangles.len()).map(of_emitter).collect()
    }
}

/// Writes [`Emitted::radiance`] of `samples` into `images`.
pub fn place(images: &mut [EmitterLight], samples: &[u32], radiance: &[Vec3]) {
    for (&sample, of_sample) in samples.iter().zip(radiance.chunks(images.len().max(1))) {
        images.iter_mut().zip(of_sample).for_each(|(image, value)| image.radiance[sample as usize] = *value);
    }
}
