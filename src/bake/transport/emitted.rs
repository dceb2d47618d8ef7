//! Indirect light of emitters: one image for each, made while the rows of Φ are gathered.
//!
//! Emitters may be small and bright, so their light on view samples and on gather samples is estimated from both sides:
//! by points on the emitters, and by directions that surfaces reflect. The balance heuristic weighs them [Veach 1995,
//! Eq. 9]. Light that comes from an emitter by mirrors is left to [`Caustics`], except in narrow lobes. What gather
//! samples reflect then takes the way of all direct light, but for [`BrightSpots`], which are sources like emitters; in
//! mirrors they are found by directions alone.

use std::borrow::Cow;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::LightTransport;
use super::bright_spots::BrightSpots;
use super::caustics::Caustics;
use super::directions::Lobe;
use super::fan::Fan;
use super::level::{Level, local};
use super::paths::{Arrival, Encounter, Paths};
use super::rows::TASK;
use crate::bake::DeepFramebuffer;
use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::gather_samples::GatherPoint;
use crate::physics::brdf::{Lobes, Reflected, cosine_direction};
use crate::physics::octahedral;
use crate::physics::sequence::{Points, SharedPoints};
use crate::scene::Emitters;
use crate::shared::{NARROW_ALPHA, NO_BRDF};
use crate::storage::pods;
use crate::trace::bvh::{Hit, TracedScene};
use crate::trace::emitting_triangles::{EmittingTriangles, Receiver};
use crate::trace::photon_map::Photon;

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
    /// Of each emitter: what the rows of Φ are multiplied by for light that was reflected before, bright spots left
    /// out.
    operands: Vec<Vec<DVec3>>,
}

/// [`Emitted`] in a file: photons of each emitter, operands, and bright spots: their emitter, whether they are of the
/// fine level, and their coefficients.
#[derive(Default, Serialize, Deserialize)]
pub struct StoredEmitted<'a> {
    photons: Vec<StoredPhotons>,
    operands: Cow<'a, [Vec<DVec3>]>,
    spots: Vec<(usize, bool, Cow<'a, [DVec3]>)>,
}

#[derive(Serialize, Deserialize)]
struct StoredPhotons(#[serde(with = "pods")] Vec<Photon>);

/// What view samples see.
struct View<'a> {
    framebuffer: &'a DeepFramebuffer,
    lobe: Lobe,
    seed: u64,
    /// Directions that samples reflect.
    points: SharedPoints,
    aims: Aims<'a>,
}

/// Rays towards emitters and bright spots.
struct Aims<'a> {
    paths: Paths<'a>,
    /// The emitters in order, then bright spots.
    sources: Vec<Source<'a>>,
    /// Of each emitter.
    caustics: Vec<Caustics>,
}

/// A surface that sends light of one emitter.
struct Source<'a> {
    emitter: usize,
    surface: Surface<'a>,
}

enum Surface<'a> {
    /// The emitter itself.
    Emitting(EmittingTriangles),
    /// What reflects its light.
    Bright(BrightSpots<'a>),
}

/// How sources are looked for from a surface.
struct Search<'a> {
    sources: &'a [Source<'a>],
    receiver: Receiver,
    /// Rays to points on each source.
    points: usize,
    /// Rays in directions that the surface reflects.
    directions: usize,
    random: Points,
}

/// Rays from a view sample to points of each source: this number divided by that of emitters, within bounds; and rays
/// in directions that it reflects.
const AIMED_RAYS: usize = 256;
const AIMED_RAYS_EACH: [usize; 2] = [16, 64];
const LOBE_RAYS: usize = 256;
/// Rays from a point of a gather sample to each source, and in other directions.
const GATHER_RAYS: usize = 4;

/// A direction in which light of an emitter arrives.
struct Arriving {
    /// Unit, towards the light.
    wi: DVec3,
    /// RGB radiance, divided by the density of such directions: their sum estimates the integral.
    weight: DVec3,
    emitter: usize,
    /// Whether [`Caustics`] have it: it comes from the emitter by a mirror.
    is_thrown: bool,
}

impl<'a> Emitted<'a> {
    pub(super) fn new(transport: &'a LightTransport, framebuffer: &'a DeepFramebuffer, lobe: Lobe) -> Self {
        let emitters = Emitters::of(transport.scene());
        if emitters.is_empty() || transport.bounces() == Some(0) {
            return Self::default();
        }
        let mut aims = Aims::new(transport, &emitters, None);
        let operands = aims.take_bright_spots(transport);
        Self { view: Some(View::new(transport, framebuffer, lobe, aims)), operands }
    }

    /// As [`Emitted::stored`] of the same transport.
    pub(super) fn restore(
        transport: &'a LightTransport,
        framebuffer: &'a DeepFramebuffer,
        lobe: Lobe,
        StoredEmitted { photons, operands, spots }: StoredEmitted,
    ) -> Self {
        if operands.is_empty() {
            return Self::default();
        }
        let scene = transport.scene();
        let mut aims = Aims::new(transport, &Emitters::of(scene), Some(photons));
        aims.sources.extend(spots.into_iter().map(|(emitter, is_fine, radiance)| {
            let level = if is_fine { &transport.fine } else { transport.bouncing() };
            Source { emitter, surface: Surface::Bright(BrightSpots::new(radiance.into_owned(), level, scene)) }
        }));
        Self { view: Some(View::new(transport, framebuffer, lobe, aims)), operands: operands.into_owned() }
    }

    /// What takes long to compute, for [`Emitted::restore`].
    pub fn stored(&self, transport: &LightTransport) -> StoredEmitted<'_> {
        let Some(View { aims, .. }) = &self.view else { return StoredEmitted::default() };
        let spots = aims.sources.iter().filter_map(|source| match &source.surface {
            Surface::Emitting(_) => None,
            Surface::Bright(spots) => Some((source.emitter, spots.is_of(&transport.fine), spots.radiance().into())),
        });
        StoredEmitted {
            photons: aims.caustics.iter().map(|caustics| StoredPhotons(caustics.photons().to_vec())).collect(),
            operands: Cow::Borrowed(&self.operands),
            spots: spots.collect(),
        }
    }

    /// Number of emitters.
    pub fn count(&self) -> usize {
        self.operands.len()
    }

    /// Radiance at `view_samples`, whose rows are `rows`: for each that of all emitters.
    pub fn radiance(&self, rows: &CsrMatrix, view_samples: &[u32]) -> Vec<Vec3> {
        let Some(view) = &self.view else { return Vec::new() };
        let further: Vec<Vec<DVec3>> = self.operands.iter().map(|operand| rows.multiply(operand)).collect();
        let of_samples = |fan: &mut Fan, (task, samples): (usize, &[u32])| {
            let of_sample = |(row, &sample): (usize, &u32)| {
                let mut radiance = view.reflected(sample, fan);
                radiance.iter_mut().zip(&further).for_each(|(sum, further)| *sum += further[TASK * task + row]);
                radiance.into_iter().map(DVec3::as_vec3)
            };
            samples.iter().enumerate().flat_map(of_sample).collect::<Vec<_>>()
        };
        view_samples.par_chunks(TASK).enumerate().map_init(Fan::default, of_samples).flatten_iter().collect()
    }

    /// Dark images of all emitters.
    pub fn images(&self, view_samples: usize) -> Vec<EmitterLight> {
        let image = |emitter| EmitterLight { emitter, radiance: vec![Vec3::ZERO; view_samples] };
        (0..self.count() as u32).map(image).collect()
    }
}

impl<'a> View<'a> {
    fn new(transport: &LightTransport, framebuffer: &'a DeepFramebuffer, lobe: Lobe, aims: Aims<'a>) -> Self {
        let seed = transport.settings.seed ^ 6 << 32;
        Self { framebuffer, lobe, seed, points: SharedPoints::new(seed, LOBE_RAYS as u32), aims }
    }

    /// Light that comes from each emitter, straight or by mirrors, and is reflected to the eye.
    fn reflected(&self, sample: u32, fan: &mut Fan) -> Vec<DVec3> {
        let count = self.aims.caustics.len();
        let mut sums = vec![DVec3::ZERO; count];
        let view = &self.framebuffer.samples[sample as usize];
        if view.brdf == NO_BRDF {
            return sums;
        }
        let [normal, wo] = [view.normal, view.wo].map(|v| octahedral::decode(v).as_dvec3().normalize());
        let brdf = &self.framebuffer.brdfs[view.brdf as usize];
        let Some(lobes) = Lobes::new(brdf, normal, wo) else { return sums };
        let receiver = Receiver {
            position: view.position,
            normal: normal.as_vec3(),
            geometric_normal: self.framebuffer.geometric_normals[sample as usize],
        };
        let is_narrow = brdf.alpha < NARROW_ALPHA;
        let [fewest, most] = AIMED_RAYS_EACH;
        let search = Search {
            sources: &self.aims.sources,
            receiver,
            points: (AIMED_RAYS / count).clamp(fewest, most),
            directions: LOBE_RAYS,
            random: Points::new(self.seed, sample.into()),
        };
        // Narrow lobes find thrown light by directions, all others by photons.
        let parts = |wi: DVec3| {
            let Reflected { diffuse, specular, .. } = lobes.at(wi);
            [if self.lobe == Lobe::All { diffuse } else { DVec3::ZERO }, specular]
        };
        let by_directions = |wi| if is_narrow { parts(wi)[1] } else { DVec3::ZERO };
        let by_photons = |wi| parts(wi)[0] + parts(wi)[1] - by_directions(wi);
        let mut found = |Arriving { wi, weight, emitter, is_thrown }| {
            let [diffuse, specular] = parts(wi);
            sums[emitter] += weight * if is_thrown { by_directions(wi) } else { diffuse + specular };
        };
        let density = |wi| lobes.at(wi).density;
        self.aims.look_at_points(&search, density, &mut found);
        let eye = (receiver.normal, wo.as_vec3(), lobes.specular_share() as f32);
        fan.draw(brdf, eye, self.lobe, &self.points, sample);
        fan.trace(&self.aims.paths, receiver.position, receiver.geometric_normal);
        for (i, _, wi, hit) in fan.rays_from(&self.aims.paths, receiver.position, receiver.geometric_normal) {
            let wi = wi.as_dvec3().normalize();
            self.aims.look_along(&search, (i as usize, wi, hit), density, &mut found);
        }
        for (sum, caustics) in sums.iter_mut().zip(&self.aims.caustics) {
            let arrive = |wi, light| *sum += light * by_photons(wi);
            caustics.arriving(receiver.position, receiver.geometric_normal, arrive);
        }
        sums
    }
}

impl Search<'_> {
    /// Three numbers for ray `i`. Each source has a set, directions have one, and each mirror.
    fn numbers(&self, i: usize, set: usize) -> [f64; 3] {
        let [u, v, w, _] = self.random.at(i as u32, set as u32);
        [u, v, w]
    }
}

impl Source<'_> {
    /// Draws a point: the unit direction to it, its RGB radiance, and the density per solid angle. `None` if the
    /// receiver does not see it. `u`: uniform in 0..1.
    fn draw(&self, scene: &TracedScene, receiver: &Receiver, u: [f64; 3]) -> Option<(DVec3, DVec3, f64)> {
        match &self.surface {
            Surface::Emitting(triangles) => {
                triangles.draw(scene, receiver, u).map(|drawn| (drawn.wi, drawn.emission, drawn.density))
            }
            Surface::Bright(spots) => {
                spots.draw(scene, receiver, u).map(|(wi, r, density)| (wi.as_dvec3(), r, density))
            }
        }
    }

    /// What a ray finds: RGB radiance, and the density per solid angle with which [`Self::draw`] finds it.
    fn found(&self, scene: &TracedScene, arrival: &Arrival) -> Option<(DVec3, f64)> {
        match &self.surface {
            Surface::Emitting(triangles) => {
                let material = scene.mesh.triangle_materials[arrival.place.triangle as usize];
                (triangles.area_density(material) > 0.0).then(|| {
                    let seen = arrival.place.surface(scene, 0.0);
                    (seen.emission.as_dvec3(), triangles.density(&seen, -arrival.wo, arrival.distance))
                })
            }
            Surface::Bright(spots) => spots.found(scene, arrival),
        }
    }
}

impl<'a> Aims<'a> {
    /// With the emitters as the only sources; `photons` are those of caustics that were stored.
    fn new(transport: &'a LightTransport, emitters: &Emitters, photons: Option<Vec<StoredPhotons>>) -> Self {
        let scene = transport.scene();
        let radiance = |emitter: u32, material: u32| match emitters.index(material) == Some(emitter) {
            true => scene.materials[material as usize].emissive.max_element().into(),
            false => 0.0,
        };
        let of_emitter = |emitter: u32| EmittingTriangles::new(scene, |material| radiance(emitter, material));
        let triangles: Vec<_> = (0..emitters.len() as u32).map(of_emitter).collect();
        let (paths, seed) = (Paths::new(scene, transport.settings.layers), transport.settings.seed);
        let mirrors = EmittingTriangles::new(scene, |material| if paths.is_mirror(material) { 1.0 } else { 0.0 });
        let caustics = |(emitter, triangles): (usize, &EmittingTriangles)| {
            let points = Points::new(seed ^ 8 << 32, emitter as u64);
            Caustics::new(&paths, triangles, emitters.len(), &mirrors, &points)
        };
        let caustics = match photons {
            Some(stored) => stored.into_iter().map(|StoredPhotons(photons)| Caustics::with(photons, scene)).collect(),
            None => triangles.iter().enumerate().map(caustics).collect(),
        };
        let source = |(emitter, triangles)| Source { emitter, surface: Surface::Emitting(triangles) };
        let sources = triangles.into_iter().enumerate().map(source).collect();
        Self { paths, sources, caustics }
    }

    /// Adds the bright spots of each emitter's reflected light to the sources. Returns of each emitter the rest: the
    /// operand of Φ.
    fn take_bright_spots(&mut self, transport: &'a LightTransport) -> Vec<Vec<DVec3>> {
        let LightTransport { settings, fine, .. } = transport;
        // Bounces between the first gather sample and the pixel.
        let bounces = transport.bounces().map(|bounces| bounces - 1);
        let take = |emitter: usize, radiance: &mut [DVec3], level: &'a Level| {
            let taken = BrightSpots::taken_from(radiance, level, transport.scene(), settings.rays);
            taken.map(|spots| Source { emitter, surface: Surface::Bright(spots) })
        };
        let mut reflected = self.reflected(fine, &self.sources, &self.caustics, settings.seed ^ 7 << 32);
        if bounces == Some(0) {
            return reflected.iter().map(|light| transport.bounce_times(light, bounces).0).collect();
        }
        let lights = reflected.iter_mut().enumerate();
        let mut spots: Vec<Source> = lights.filter_map(|(emitter, light)| take(emitter, light, fine)).collect();
        let level = transport.bouncing();
        let by_spots = (!spots.is_empty()).then(|| self.reflected(level, &spots, &[], settings.seed ^ 9 << 32));
        let mut operands: Vec<_> = reflected.iter().map(|light| transport.bounce_times(light, bounces).0).collect();
        for (emitter, operand) in operands.iter_mut().enumerate() {
            if let Some(by_spots) = &by_spots {
                transport.add_reflected(operand, &by_spots[emitter], bounces.map(|bounces| bounces - 1));
            }
            let first = operand.len() - level.coefficient_count();
            spots.extend(take(emitter, &mut operand[first..], level));
        }
        self.sources.extend(spots);
        operands
    }

    /// Looks for sources by points on each. `density` is that of a direction; `arrive` gets what is seen.
    fn look_at_points(&self, search: &Search, density: impl Fn(DVec3) -> f64, mut arrive: impl FnMut(Arriving)) {
        for (set, source) in search.sources.iter().enumerate() {
            for i in 0..search.points {
                let drawn = source.draw(self.paths.scene, &search.receiver, search.numbers(i, set));
                let Some((wi, emission, point_density)) = drawn else { continue };
                let weight = emission / (search.points as f64 * point_density + search.directions as f64 * density(wi));
                arrive(Arriving { wi, weight, emitter: source.emitter, is_thrown: false });
            }
        }
    }

    /// Follows ray `i` in direction `wi`, whose first hit is `hit`, through mirrors. `density` is that of a direction;
    /// `arrive` gets the sources that the ray meets.
    fn look_along(
        &self,
        search: &Search,
        (i, wi, hit): (usize, DVec3, Option<(Hit, bool)>),
        density: impl Fn(DVec3) -> f64,
        mut arrive: impl FnMut(Arriving),
    ) {
        let at_mirror = |layer: u32| search.numbers(i, search.sources.len() + 1 + layer as usize);
        let mut is_straight = true;
        self.paths.go_on(hit, wi.as_vec3(), at_mirror, |met| {
            let Encounter::Surface(arrival) = met else { return };
            // Points on sources are not looked for in mirrors.
            let is_straight = std::mem::replace(&mut is_straight, false);
            for source in search.sources {
                let Some((emission, point_density)) = source.found(self.paths.scene, &arrival) else { continue };
                let of_directions = search.directions as f64 * density(wi);
                if of_directions <= 0.0 {
                    // Rounding has moved the direction to the horizon.
                    continue;
                }
                let of_points = if is_straight { search.points as f64 * point_density } else { 0.0 };
                let weight = arrival.tint.as_dvec3() * emission / (of_directions + of_points);
                let is_thrown = !is_straight && matches!(source.surface, Surface::Emitting(_));
                arrive(Arriving { wi, weight, emitter: source.emitter, is_thrown });
            }
        });
    }

    /// By emitter: coefficients of a level for light that comes from `sources` or by `caustics` and is reflected once.
    fn reflected(&self, level: &Level, sources: &[Source], caustics: &[Caustics], seed: u64) -> Vec<Vec<DVec3>> {
        let of_sample = |index: usize| {
            let sample = &level.samples.samples[index];
            let mut values = vec![Vec3::ZERO; level.coefficients(index).len()];
            let mut sums = vec![vec![DVec3::ZERO; values.len()]; self.caustics.len()];
            let share = 1.0 / level.samples.points_per_sample as f64;
            for (i, point) in level.samples.points_of(index).iter().enumerate() {
                let GatherPoint { position, normal, geometric_normal } = *point;
                let frame = point.frame(sample);
                let axes = frame.map(Vec3::as_dvec3);
                let direction = |[u, v, _]: [f64; 3]| {
                    let d = cosine_direction(u, v);
                    axes[0] * d.x + axes[1] * d.y + axes[2] * d.z
                };
                let cosine = |wi: DVec3| axes[2].dot(wi).max(0.0);
                let density = |wi: DVec3| cosine(wi) / std::f64::consts::PI;
                let random = Points::new(seed, (index * level.samples.points_per_sample + i) as u64);
                let receiver = Receiver { position, normal, geometric_normal };
                let mut arrive = |emitter: usize, wi: DVec3, irradiance: DVec3| {
                    let at = local(&frame, wi.as_vec3());
                    if at.z > 0.0 {
                        HarmonicProjection::get().project(&sample.brdf, at, &mut values);
                        for (sum, k) in sums[emitter].iter_mut().zip(&values) {
                            *sum += share * irradiance * k.as_dvec3();
                        }
                    }
                };
                let (points, directions) = (GATHER_RAYS, GATHER_RAYS);
                let search = Search { sources, receiver, points, directions, random };
                let mut found = |Arriving { wi, weight, emitter, is_thrown }| {
                    if !is_thrown {
                        arrive(emitter, wi, weight * cosine(wi));
                    }
                };
                self.look_at_points(&search, density, &mut found);
                for i in 0..directions {
                    let wi = direction(search.numbers(i, sources.len()));
                    let hit = self.paths.first_hit(position, geometric_normal, wi.as_vec3());
                    self.look_along(&search, (i, wi, hit), density, &mut found);
                }
                for (emitter, caustics) in caustics.iter().enumerate() {
                    caustics.arriving(position, geometric_normal, |wi, light| arrive(emitter, wi, light * cosine(wi)));
                }
            }
            sums
        };
        let by_sample: Vec<Vec<Vec<DVec3>>> = (0..level.samples.len()).into_par_iter().map(of_sample).collect();
        let of_emitter = |emitter: usize| by_sample.iter().flat_map(|sums| sums[emitter].iter().copied()).collect();
        (0..self.caustics.len()).map(of_emitter).collect()
    }
}

/// Writes [`Emitted::radiance`] of `samples` into `images`.
pub fn place(images: &mut [EmitterLight], samples: &[u32], radiance: &[Vec3]) {
    for (&sample, of_sample) in samples.iter().zip(radiance.chunks(images.len().max(1))) {
        images.iter_mut().zip(of_sample).for_each(|(image, value)| image.radiance[sample as usize] = *value);
    }
}
