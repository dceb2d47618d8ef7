//! Importance of surfaces for the picture's indirect light, from eye paths in the direction opposite to light
//! [Christensen 2003].

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::paths::{Arrival, Encounter, Paths};
use crate::bake::DeepFramebuffer;
use crate::bake::gather_samples::{Patch, Place, Surfaces, Visited, narrow_lobe_as_mirror, sides};
use crate::physics::brdf::Lobes;
use crate::physics::octahedral;
use crate::physics::sequence::Points;
use crate::scene::Scene;
use crate::shared::Brdf;
use crate::trace::bvh::{Hit, TracedScene};
use crate::trace::surface::SurfacePoint;

/// Statistics of eye paths over a scene's surfaces.
pub struct Importance {
    /// Surfaces from which light can reach the eye through other surfaces, with the density of gather samples.
    pub surfaces: Surfaces,
    /// Share of the indirect light that each material reflects, if all surfaces are lit equally.
    pub shares: Vec<f32>,
    /// Share of all surface area that no path has hit.
    pub unseen: f64,
    /// Share of the paths' rays that leave the scene, straight or by mirrors. `None` if no surface that the eye sees
    /// reflects.
    pub escaped: Option<f64>,
}

/// What a path meets.
#[derive(Default)]
struct Path {
    visits: Vec<Visit>,
    rays: usize,
    escapes: usize,
}

/// A hit of a path on a surface.
struct Visit {
    side: u32,
    barycentric: Vec2,
    /// Share of the pixel's light that comes from there.
    light: f32,
    /// Distance from the previous surface.
    distance: f32,
}

impl Visit {
    fn place(&self) -> Place {
        Place { triangle: self.side / 2, barycentric: self.barycentric, back: self.side % 2 == 1 }
    }
}

/// A surface from which a path continues.
struct ScatterVertex {
    position: Vec3,
    geometric_normal: Vec3,
    normal: DVec3,
    wo: DVec3,
    brdf: Brdf,
}

/// Maximum number of bounces of a path.
const BOUNCES: u32 = 6;
/// A path ends when its share of the pixel's light is below this.
const MIN_LIGHT: f32 = 0.01;
/// Visits to a patch above which it is subdivided, and to neighbouring patches above which these get separate
/// densities.
const VISITS: usize = 64;
/// Maximum ratio of the needs of four quarters that are merged.
const ALIKE: f64 = 4.0;
/// Maximum deviation of visits to patches of one density from the number expected by area, in standard deviations.
const DEVIATIONS: f64 = 4.0;
/// Share of the total need that is added uniformly over the area, so that rarely visited patches get samples too.
const EVENLY: f64 = 0.1;

impl Importance {
    /// Importance for the view of `framebuffer`, by `paths` paths through at most `layers` mirrors.
    pub fn new(scene: &TracedScene, framebuffer: &DeepFramebuffer, layers: u32, paths: usize, seed: u64) -> Self {
        let traced = Tracer { paths: Paths::new(scene, layers), framebuffer, seed }.trace(paths);
        let [rays, escapes] = [|p: &Path| p.rays, |p: &Path| p.escapes].map(|n| traced.iter().map(n).sum::<usize>());
        let visits: Vec<Visit> = traced.into_iter().flat_map(|path| path.visits).collect();
        let mut shares = vec![0.0; scene.materials.len()];
        for visit in &visits {
            shares[scene.mesh.triangle_materials[visit.side as usize / 2] as usize] += visit.light;
        }
        let all: f32 = shares.iter().sum();
        shares.iter_mut().for_each(|share| *share /= all.max(f32::MIN_POSITIVE));
        let (surfaces, unseen) = spread(scene, visits);
        Self { surfaces, shares, unseen, escaped: (rays > 0).then(|| escapes as f64 / rays as f64) }
    }
}

/// What eye paths tell of surfaces.
pub struct Visible {
    /// Of the front and back of each triangle whether it is hidden, as the inside of a closed mesh.
    pub hidden: Vec<bool>,
    /// Places that paths met, and the share of a pixel's light that comes from there.
    pub places: Vec<(Place, f32)>,
}

impl Visible {
    /// By `paths` paths through at most `layers` mirrors, from the view of `framebuffer`.
    pub fn new(scene: &TracedScene, framebuffer: &DeepFramebuffer, layers: u32, paths: usize, seed: u64) -> Self {
        let traced = Tracer { paths: Paths::new(scene, layers), framebuffer, seed }.trace(paths);
        let visits: Vec<Visit> = traced.into_iter().flat_map(|path| path.visits).collect();
        let mut counts = vec![0; 2 * scene.mesh.triangles.len()];
        visits.iter().for_each(|visit| counts[visit.side as usize] += 1);
        let hidden = hidden_sides(scene, &sides_by_facing(scene), |side| counts[side as usize]);
        Self { hidden, places: visits.iter().map(|visit| (visit.place(), visit.light)).collect() }
    }
}

struct Tracer<'a> {
    paths: Paths<'a>,
    framebuffer: &'a DeepFramebuffer,
    seed: u64,
}

impl Tracer<'_> {
    fn trace(&self, count: usize) -> Vec<Path> {
        let seen = self.framebuffer.reflecting();
        if seen.is_empty() {
            return Vec::new();
        }
        let path = |i: usize| self.path(seen[i * seen.len() / count], i as u64);
        (0..count).into_par_iter().map(path).collect()
    }

    fn path(&self, sample: u32, stream: u64) -> Path {
        let points = Points::new(self.seed, stream);
        let mut path = Path::default();
        let mut arrivals = Vec::new();
        let mut vertex = Some(self.eye_sees(sample));
        let mut light = Vec3::ONE;
        for bounce in 0..BOUNCES {
            let numbers = |layer: u32| points.at(layer, bounce);
            let [u, v, w, which] = numbers(0);
            let Some(from) = vertex.take() else { break };
            let Some(lobes) = Lobes::new(&from.brdf, from.normal, from.wo) else { break };
            let Some(direction) = lobes.sample([u, v, w]) else { break };
            let reflected = lobes.at(direction);
            light *= (reflected.sum() / reflected.density).as_vec3();
            let random = |layer: u32| {
                let [u, v, w, _] = numbers(1 + layer);
                [u, v, w]
            };
            arrivals.clear();
            path.rays += 1;
            let meet = |met: Encounter| match met {
                Encounter::Surface(arrival) => arrivals.push(arrival),
                Encounter::Sky(_) => path.escapes += 1,
            };
            self.paths.follow(from.position, from.geometric_normal, direction.as_vec3(), random, meet);
            path.visits.extend(arrivals.iter().map(|arrival| Visit {
                side: 2 * arrival.place.triangle + u32::from(arrival.place.back),
                barycentric: arrival.place.barycentric,
                light: (light * arrival.tint).element_sum() / 3.0,
                distance: arrival.distance,
            }));
            // Mirrors reflect diffusely and continue the ray; one of these arrivals is chosen.
            let Some(arrival) = arrivals.get((which * arrivals.len() as f64) as usize) else { break };
            light *= arrival.tint * arrivals.len() as f32;
            vertex = (light.max_element() > MIN_LIGHT).then(|| self.goes_on(arrival));
        }
        path
    }

    fn eye_sees(&self, sample: u32) -> ScatterVertex {
        let view = &self.framebuffer.samples[sample as usize];
        ScatterVertex {
            position: view.position,
            geometric_normal: self.framebuffer.geometric_normals[sample as usize],
            normal: octahedral::decode(view.normal).as_dvec3().normalize(),
            wo: octahedral::decode(view.wo).as_dvec3().normalize(),
            brdf: self.framebuffer.brdfs[view.brdf as usize],
        }
    }

    fn goes_on(&self, arrival: &Arrival) -> ScatterVertex {
        let place = arrival.place;
        let hit = Hit { triangle: place.triangle, barycentric: place.barycentric, distance: 0.0 };
        let surface = SurfacePoint::new(self.paths.scene, &hit, -arrival.wo, 0.0).facing(arrival.wo);
        ScatterVertex {
            position: surface.position,
            geometric_normal: surface.geometric_normal,
            normal: surface.normal.as_dvec3().normalize(),
            wo: arrival.wo.as_dvec3().normalize(),
            brdf: narrow_lobe_as_mirror(&surface.brdf),
        }
    }
}

/// Groups patches of similar density; also returns the share of all area without any.
///
/// The error of light from `distance` away is proportional to the angle that a sample's width subtends. The squared
/// error is the sum of squares of share times width over distance. For a fixed number of samples it is minimal if the
/// density is the square root of the sum of these squares without the width.
fn spread(scene: &TracedScene, visits: Vec<Visit>) -> (Surfaces, f64) {
    let sides = sides_by_facing(scene);
    let area: f64 = sides.iter().map(|(_, area)| area).sum();
    let least_distance = 0.25 * (area * VISITS as f64 / visits.len().max(1) as f64).sqrt() as f32;
    let need = |visit: &Visit| f64::from((visit.light / visit.distance.max(least_distance)).powi(2));

    let deepest = |visit: &Visit| Patch::around(visit.side, visit.barycentric, Patch::DEEPEST);
    let mut visits: Vec<Counted> = visits
        .par_iter()
        .map(|visit| Counted { patch: deepest(visit), place: visit.place(), light: visit.light, need: need(visit) })
        .collect();
    visits.par_sort_by_key(|visit| visit.patch);
    // Visits to each side: `first[side]..first[side + 1]`.
    let mut first = vec![0u32; 2 * scene.mesh.triangles.len() + 1];
    visits.iter().for_each(|visit| first[visit.patch.side as usize + 1] += 1);
    (1..first.len()).for_each(|i| first[i] += first[i - 1]);
    let hidden = hidden_sides(scene, &sides, |side| first[side as usize + 1] - first[side as usize]);
    let mut patches = Vec::new();
    let mut unseen = 0.0;
    for (side, area) in sides {
        if hidden[side as usize] {
            unseen += area;
            continue;
        }
        let here = &visits[first[side as usize] as usize..first[side as usize + 1] as usize];
        quarter(1, area, 0, here, &mut patches);
    }
    let evenly = EVENLY * patches.iter().map(|p| p.need).sum::<f64>() / area;
    let mut pieces = Vec::new();
    unseen += fill(&patches, evenly, &mut pieces);
    (Surfaces::visited(pieces), unseen / area.max(f64::MIN_POSITIVE))
}

/// Sides that are not visible although the other side of their triangle is: the inside of closed meshes with
/// double-sided materials, which hardly any path enters. In `sides` neighbours that face the same way are adjacent.
fn hidden_sides(scene: &Scene, sides: &[(u32, f64)], visits: impl Fn(u32) -> u32) -> Vec<bool> {
    let mut hidden = vec![false; 2 * scene.mesh.triangles.len()];
    let is_double = |side: u32| {
        let material = scene.mesh.triangle_materials[side as usize / 2];
        scene.materials[material as usize].double_sided
    };
    let fronts: Vec<u32> =
        sides.iter().map(|&(side, _)| side).filter(|&side| side % 2 == 0 && is_double(side)).collect();
    let (mut first, mut counts) = (0, [0, 0]);
    for (i, &front) in fronts.iter().enumerate() {
        counts = [counts[0] + visits(front), counts[1] + visits(front + 1)];
        if counts[0].max(counts[1]) < ENOUGH {
            continue;
        }
        for back in (0..2).filter(|back| counts[*back] * HARDLY_ANY < counts[1 - back]) {
            for front in &fronts[first..=i] {
                // Among closed meshes there may be a sheet.
                let [side, other] = [back, 1 - back].map(|back| front + back as u32);
                hidden[side as usize] = visits(side) * HARDLY_ANY <= visits(other);
            }
        }
        (first, counts) = (i + 1, [0, 0]);
    }
    hidden
}

/// Visits to one side of neighbouring triangles that suffice to decide whether the other is hidden.
const ENOUGH: u32 = 64;
/// A side is hidden if the other has more than this many times its visits: paths start slightly off surfaces and can
/// pass through cracks.
const HARDLY_ANY: u32 = 20;

/// A visit with its patch and its need of samples.
struct Counted {
    patch: Patch,
    place: Place,
    light: f32,
    need: f64,
}

/// A patch, part `part` of a side after `depth` subdivisions, and its visits.
struct Visits<'a> {
    part: u32,
    depth: u32,
    area: f64,
    visits: &'a [Counted],
    need: f64,
}

/// Subdivides part `part` of a side, at depth `depth`, until each patch has few visits. Merges similar quarters, as
/// points are distributed more regularly on large patches. `visits` are in the order of parts.
fn quarter<'a>(part: u32, area: f64, depth: u32, visits: &'a [Counted], patches: &mut Vec<Visits<'a>>) {
    let whole = || Visits { part, depth, area, visits, need: visits.iter().map(|visit| visit.need).sum() };
    if visits.len() <= VISITS || depth == Patch::DEEPEST {
        patches.push(whole());
        return;
    }
    let first = patches.len();
    for (part, here) in quarters(part, depth, visits) {
        quarter(part, 0.25 * area, depth + 1, here, patches);
    }
    let four = &patches[first..];
    let (low, high) = four.iter().fold((f64::MAX, 0.0f64), |(low, high), q| (low.min(q.need), high.max(q.need)));
    if four.len() == 4 && high <= ALIKE * low {
        patches.truncate(first);
        patches.push(whole());
    }
}

/// The four quarters of a part at depth `depth`, each with its visits.
fn quarters(part: u32, depth: u32, visits: &[Counted]) -> [(u32, &[Counted]); 4] {
    let mut rest = visits;
    [0, 1, 2, 3].map(|quarter| {
        let part = 4 * part + quarter;
        let below = 2 * (Patch::DEEPEST - depth - 1);
        let (here, others) = rest.split_at(rest.partition_point(|visit| visit.patch.part >> below <= part));
        rest = others;
        (part, here)
    })
}

/// Divides a part's area among its visits, with larger shares where visits are sparse. The area is divided evenly among
/// quarters with visits until few visits are left.
fn distribute_area(part: u32, area: f64, depth: u32, visits: &[Counted], visited: &mut Vec<Visited>) {
    if visits.len() <= FEW || depth == Patch::DEEPEST {
        return distribute_evenly(area, visits.iter(), visited);
    }
    let quarters = quarters(part, depth, visits);
    let seen = quarters.iter().filter(|(_, here)| !here.is_empty()).count();
    for (part, here) in quarters.into_iter().filter(|(_, here)| !here.is_empty()) {
        distribute_area(part, area / seen as f64, depth + 1, here, visited);
    }
}

/// Maximum number of visits that share an area evenly.
const FEW: usize = 16;

/// The light is averaged too, as that of single visits is noisy.
fn distribute_evenly<'a>(area: f64, visits: impl Iterator<Item = &'a Counted> + Clone, visited: &mut Vec<Visited>) {
    let (count, light) = visits.clone().fold((0.0, 0.0), |(n, sum), visit| (n + 1.0, sum + f64::from(visit.light)));
    // Never 0, as means are weighted by it.
    let light = (light / count).max(f32::MIN_POSITIVE.into());
    visited.extend(visits.map(|visit| Visited { place: visit.place, area: area / count, light }));
}

/// Creates pieces from neighbouring patches: patches with few visits form one piece if the visits are consistent with
/// their areas. Returns the area without visits.
fn fill(patches: &[Visits], evenly: f64, pieces: &mut Vec<(f64, f32, Vec<Visited>)>) -> f64 {
    let count = |patches: &[Visits]| -> (f64, f64) {
        patches.iter().fold((0.0, 0.0), |(visits, area), p| (visits + p.visits.len() as f64, area + p.area))
    };
    let (visits, area) = count(patches);
    if visits == 0.0 {
        return area;
    }
    let (left, right) = patches.split_at(patches.len() / 2);
    let alike = || {
        let (in_left, left_area) = count(left);
        let share = left_area / area;
        (in_left - share * visits).powi(2) <= DEVIATIONS.powi(2) * share * (1.0 - share) * visits
    };
    if patches.len() == 1 || (visits <= VISITS as f64 && alike()) {
        let need: f64 = patches.iter().map(|p| p.need).sum();
        let density = (need / area.max(f64::MIN_POSITIVE) + evenly).sqrt() as f32;
        let mut visited = Vec::with_capacity(visits as usize);
        match patches {
            [patch] => distribute_area(patch.part, patch.area, patch.depth, patch.visits, &mut visited),
            _ => distribute_evenly(area, patches.iter().flat_map(|p| p.visits), &mut visited),
        }
        pieces.push((area, density, visited));
        return 0.0;
    }
    fill(left, evenly, pieces) + fill(right, evenly, pieces)
}

/// [`sides`], with neighbours that face the same way together.
fn sides_by_facing(scene: &TracedScene) -> Vec<(u32, f64)> {
    let mut sides = sides(scene);
    sides.sort_by_cached_key(|&(side, _)| facing(scene, side));
    sides
}

/// The dominant axis and sign of a side's normal: one of six.
fn facing(scene: &Scene, side: u32) -> u8 {
    let [a, b, c] = scene.mesh.triangles[side as usize / 2].map(|v| scene.mesh.positions[v as usize]);
    let normal = (b - a).cross(c - a);
    let axis = normal.abs().max_position();
    2 * axis as u8 + u8::from((normal[axis] < 0.0) != (side % 2 == 1))
}
