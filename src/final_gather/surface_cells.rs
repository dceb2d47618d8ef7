//! Cells of surface: places of an object in one leaf of an octree that face the same way [Binder 2019].

use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::width_of_strip;
use crate::bake::gather_samples::{Place, is_from_behind};
use crate::bake::transport::importance::Visible;
use crate::scene::{Camera, Projection};
use crate::trace::bvh::{TracedScene, coverage};
use crate::trace::surface::SurfacePoint;

/// All surfaces of a scene in cells whose width grows with the distance from the eye.
///
/// Leaves of the octree follow from their place alone, so that a lookup needs no tree.
pub struct SurfaceCells {
    /// Mesh space.
    eye: Vec3,
    /// Width that cells have at most: fixed, and by distance from the eye.
    width: [f32; 2],
    /// Lowest corner and width of the root.
    low: Vec3,
    root: f32,
    /// Hash table with linear probing: key and cell; a power of two of slots.
    slots: Vec<(u64, u32)>,
    /// Area of each cell that light can reach, mesh space.
    areas: Vec<f32>,
    /// Cells with layers of surface, of which one hides another.
    layered: Vec<bool>,
    /// How much of the picture comes from each cell, by area.
    importance: Vec<f32>,
}

/// The part of a triangle that lies in a cell.
struct Piece {
    key: u64,
    triangle: u32,
    /// Area that stops rays.
    area: f32,
    /// Area of its projection onto a face of the cube.
    projected: f32,
}

/// A triangle that is to be cut, in mesh space.
struct Facet {
    triangle: u32,
    object: usize,
    corners: [DVec3; 3],
    /// Unit normals of the sides that have cells.
    sides: [Option<Vec3>; 2],
}

/// A cube of the octree.
#[derive(Clone, Copy)]
struct Cube {
    level: u32,
    at: [u32; 3],
}

/// Cells along the height of the picture.
const CELLS_ALONG: f64 = 64.0;
/// Least width: as a share of the distance from the eye, or of the scene's radius. Bounds the number of cells.
const LEAST_WIDTH: f64 = 0.008;
/// Greatest width as a share of the distance from the eye, for wide angles.
const MOST_WIDTH: f64 = 0.03;
const MAX_LEVEL: u32 = 12;
/// Area of the smallest cells, relative to a face of their cube.
const SLIVER: f64 = 0.25;
/// Where a few points find holes alone, some rays are stopped nevertheless.
const LEAST_COVERAGE: f32 = 1.0 / 64.0;
/// Photons that land in the smallest cells, about.
const LEAST_LANDINGS: f64 = 4.0;
/// Level of the cubes in which pilot photons are counted.
const PILOT_LEVEL: u32 = 5;
/// Surface in a cube that covers more than a face of it lies in layers, of which one may hide another.
const ONE_LAYER: f64 = 1.01;
/// A gap between two layers that is narrower than this share of a cube, and has surface on all sides within the other,
/// gets no light.
const NARROW: [f32; 2] = [0.5, 2.0];
const EMPTY: u64 = u64::MAX;
/// The part of a key that tells the cube.
const CUBE: u64 = (1 << 40) - 1;

impl SurfaceCells {
    /// Cells of which each has a 2^-`halvings`th of the width; `None` if `stop` returns true. It gets a number of cells
    /// that there may be. Sides of triangles that are [hidden](Visible::hidden) get no cells: within a thin closed mesh
    /// they would share those of its outside.
    pub fn new(
        scene: &TracedScene,
        camera: &Camera,
        Visible { hidden, places }: &Visible,
        halvings: u32,
        stop: &(dyn Fn(usize) -> bool + Sync),
    ) -> Option<Self> {
        let (eye, _) = camera.ray(0.5, 0.5, 1.0);
        let radius = scene.bvh.radius;
        let [fixed, growing] = width_of_strip(camera, scene, CELLS_ALONG);
        let [fixed, growing] = match camera.projection {
            Projection::Perspective { .. } => [0.0, growing.clamp(LEAST_WIDTH, MOST_WIDTH)],
            Projection::Orthographic { .. } => [fixed.max(LEAST_WIDTH * f64::from(radius)), 0.0],
        };
        let mut cells = Self {
            eye: scene.space.from_world(eye).as_vec3(),
            width: [fixed, growing].map(|width| width as f32 / (1 << halvings) as f32),
            low: -radius * Vec3::new(1.013, 1.007, 1.019),
            root: 2.04 * radius,
            slots: vec![(EMPTY, 0); 1 << 16],
            areas: Vec::new(),
            layered: Vec::new(),
            importance: Vec::new(),
        };
        let count = AtomicUsize::new(0);
        let pieces = |triangle: usize| {
            if stop(count.load(Ordering::Relaxed)) {
                return Vec::new();
            }
            let facet = Facet::new(scene, hidden, triangle);
            let mut pieces = Vec::new();
            cells.cut_facet(&facet, &mut |cube, normal, polygon| {
                let parts = facet.parts(polygon).map(|(at, area)| [area, area * facet.coverage(scene, at)]);
                let [all, area] = parts.fold([0.0; 2], |sum, part| [0, 1].map(|i| sum[i] + part[i]));
                let projected = all * normal.abs().max_element();
                pieces.push(Piece { key: key(cube, normal, facet.object), triangle: facet.triangle, area, projected });
            });
            // Triangles with more than a cell make cells, all others share them.
            count.fetch_add(pieces.len().saturating_sub(1), Ordering::Relaxed);
            pieces
        };
        let triangles = 0..scene.mesh.triangles.len();
        let pieces: Vec<Piece> = triangles.clone().into_par_iter().flat_map_iter(pieces).collect();
        if stop(count.into_inner()) {
            return None;
        }
        // Of each cell: area, and that of its projection onto a face of the cube.
        let mut areas: Vec<[f64; 2]> = Vec::new();
        for &Piece { key, area, projected, .. } in &pieces {
            let cell = cells.insert(key, areas.len() as u32) as usize;
            areas.resize(areas.len().max(cell + 1), [0.0; 2]);
            areas[cell][0] += f64::from(area);
            areas[cell][1] += f64::from(projected);
        }
        // Where surface may lie on another one: cells with more than a layer, and cubes with more than a cell.
        let mut keys: Vec<(u64, u32)> = cells.slots.iter().copied().filter(|(key, _)| *key != EMPTY).collect();
        keys.par_sort_unstable_by_key(|(key, _)| key & CUBE);
        let mut may_hide = vec![false; areas.len()];
        for of_cube in keys.chunk_by(|a, b| a.0 & CUBE == b.0 & CUBE) {
            for &(key, cell) in of_cube {
                let face = f64::from(cells.width_of(level_of(key))).powi(2);
                may_hide[cell as usize] = of_cube.len() > 1 || areas[cell as usize][1] > ONE_LAYER * face;
            }
        }
        let mut is_looked_at = vec![false; triangles.len()];
        for Piece { key, triangle, .. } in &pieces {
            is_looked_at[*triangle as usize] |= may_hide[cells.cell(*key).expect("each piece has one") as usize];
        }
        drop(pieces);
        let covered = |triangle: usize| {
            let mut covered = Vec::new();
            if stop(0) {
                return covered;
            }
            let facet = Facet::new(scene, hidden, triangle);
            cells.cut_facet(&facet, &mut |cube, normal, polygon| {
                let cell = cells.cell(key(cube, normal, facet.object)).expect("each piece has one");
                if !may_hide[cell as usize] {
                    return;
                }
                let width = cells.width_of(cube.level);
                for (at, area) in facet.parts(polygon) {
                    let Some(covering) = covering(scene, facet.position(at), normal, width) else { continue };
                    // Of two triangles in one place one counts.
                    let by_other = covering.triangle != facet.triangle;
                    if by_other || covering.is_narrow {
                        // Rays may find either.
                        let other = (by_other && !covering.is_above).then(|| {
                            let other = Facet::new(scene, hidden, covering.triangle as usize);
                            let side = other.sides.into_iter().flatten().find(|side| side.dot(normal) > 0.0)?;
                            cells.cell(key(cube, side, other.object))
                        });
                        covered.push((cell, area * facet.coverage(scene, at), other.flatten()));
                    }
                }
            });
            covered
        };
        let looked_at = triangles.into_par_iter().filter(|triangle| is_looked_at[*triangle]);
        let covered: Vec<(u32, f32, Option<u32>)> = looked_at.flat_map_iter(covered).collect();
        if stop(0) {
            return None;
        }
        let mut into: Vec<u32> = (0..areas.len() as u32).collect();
        for (cell, other) in covered.iter().filter_map(|(cell, _, other)| Some((*cell, (*other)?))) {
            let [from, to] = [cell, other].map(|cell| root(&into, cell));
            into[from as usize] = to;
        }
        let into = cells.redirect(&into);
        (0..areas.len()).filter(|cell| into[*cell] != *cell as u32).for_each(|cell| {
            let of_cell = std::mem::take(&mut areas[cell]);
            let all = &mut areas[into[cell] as usize];
            *all = [0, 1].map(|i| all[i] + of_cell[i]);
        });
        let mut open: Vec<f64> = areas.iter().map(|[area, _]| *area).collect();
        cells.layered = vec![false; areas.len()];
        for (cell, area, _) in covered {
            let cell = into[cell as usize] as usize;
            open[cell] -= f64::from(area);
            cells.layered[cell] = true;
        }
        // Where all is hidden no ray looks.
        let area = |(open, [all, _]): (f64, &[f64; 2])| if open > 1e-3 * all { open as f32 } else { *all as f32 };
        cells.areas = open.into_iter().zip(&areas).map(area).collect();
        cells.importance = cells.importance_of(scene, places);
        Some(cells)
    }

    /// How much of the picture comes from each cell, by area: the mean of a large cube.
    fn importance_of(&self, scene: &TracedScene, places: &[(Place, f32)]) -> Vec<f32> {
        // Of each large cube and side: light and area.
        let mut around: HashMap<u64, [f32; 2]> = HashMap::new();
        let keys: Vec<u64> =
            places.par_iter().map(|(place, _)| self.key_of(scene, &place.surface(scene, 0.0)).0).collect();
        for (key, (_, light)) in keys.into_iter().zip(places) {
            around.entry(ancestor(key)).or_default()[0] += light;
        }
        let cells = || self.slots.iter().filter(|(key, _)| *key != EMPTY);
        cells().for_each(|&(key, cell)| around.entry(ancestor(key)).or_default()[1] += self.areas[cell as usize]);
        let mut importance = vec![0.0; self.areas.len()];
        for &(key, cell) in cells() {
            let [light, area] = around[&ancestor(key)];
            importance[cell as usize] = light / area.max(f32::MIN_POSITIVE);
        }
        importance
    }

    /// Joins cells that are too small for photons to tell their light with larger ones beside them. `landed`: cells of
    /// pilot photons, of which there will be `ratio` times as many. Returns the new cell of each.
    pub fn join(&mut self, landed: impl Iterator<Item = u32>, ratio: f64) -> Vec<u32> {
        let mut areas: Vec<f64> = self.areas.iter().copied().map(f64::from).collect();
        let mut into: Vec<u32> = (0..areas.len() as u32).collect();
        let mut cells: Vec<(u64, u32)> = self.slots.iter().copied().filter(|(key, _)| *key != EMPTY).collect();
        let mut landings = vec![0.0; areas.len()];
        landed.for_each(|cell| landings[cell as usize] += ratio);
        // Of each large cube and side: area, and photons of a pass.
        let mut around: HashMap<u64, [f64; 2]> = HashMap::new();
        for &(key, cell) in &cells {
            let [area, photons] = around.entry(ancestor(key)).or_insert([0.0, 0.5 * ratio]);
            *area += areas[cell as usize];
            *photons += landings[cell as usize];
        }
        let mut least = vec![0.0; areas.len()];
        for &(key, cell) in &cells {
            let [area, photons] = around[&ancestor(key)];
            let sliver = SLIVER * f64::from(self.width_of(level_of(key))).powi(2);
            least[cell as usize] = sliver.max(LEAST_LANDINGS * area / photons);
        }
        for level in (1..=MAX_LEVEL).rev() {
            // Cells of one family lie in one cube of the next level and face the same way.
            cells.iter_mut().filter(|(key, _)| level_of(*key) == level).for_each(|(key, _)| *key = parent(*key));
            cells.sort_unstable();
            for family in cells.chunk_by(|a, b| a.0 == b.0) {
                let members = family.iter().map(|member| member.1 as usize);
                let largest = members.clone().max_by(|a, b| areas[*a].total_cmp(&areas[*b])).expect("it has members");
                for cell in members.filter(|cell| *cell != largest) {
                    if areas[cell] < least[cell] && into[cell] as usize == cell {
                        areas[largest] += areas[cell];
                        self.layered[largest] |= self.layered[cell];
                        into[cell] = largest as u32;
                    }
                }
            }
            cells.retain(|(_, cell)| into[*cell as usize] == *cell);
        }
        let joined = self.redirect(&into);
        self.areas = areas.into_iter().map(|area| area as f32).collect();
        joined
    }

    /// Gives the places of each cell to that which it leads to, and tells which that is.
    fn redirect(&mut self, into: &[u32]) -> Vec<u32> {
        let roots: Vec<u32> = (0..into.len() as u32).map(|cell| root(into, cell)).collect();
        self.slots.iter_mut().filter(|(key, _)| *key != EMPTY).for_each(|(_, cell)| *cell = roots[*cell as usize]);
        roots
    }

    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Mesh space.
    pub fn area(&self, cell: u32) -> f32 {
        self.areas[cell as usize]
    }

    /// Share of a pixel's light that comes from a cell if light arrives there, by area; in no unit.
    pub fn importance(&self, cell: u32) -> f32 {
        self.importance[cell as usize]
    }

    /// The cell in which light lands; `None` where its area does not count, and by rounding on seams. `hidden`: as of
    /// the cells.
    pub fn of_landing(&self, scene: &TracedScene, hidden: &[bool], surface: &SurfacePoint) -> Option<u32> {
        let is_back = is_from_behind(scene, surface.triangle, -surface.geometric_normal);
        if hidden[2 * surface.triangle as usize + usize::from(is_back)] {
            return None;
        }
        let (cell, level) = self.find(scene, surface)?;
        let hides = || {
            let width = self.width_of(level);
            let covering = covering(scene, surface.position, surface.geometric_normal, width);
            covering.is_some_and(|covering| covering.is_above || covering.is_narrow)
        };
        (!(self.layered[cell as usize] && hides())).then_some(cell)
    }

    /// The cell of a place on the side that the geometric normal points to; `None` by rounding on seams.
    pub fn of_place(&self, scene: &TracedScene, surface: &SurfacePoint) -> Option<u32> {
        Some(self.find(scene, surface)?.0)
    }

    /// The cell, and its level.
    fn find(&self, scene: &TracedScene, surface: &SurfacePoint) -> Option<(u32, u32)> {
        let (key, level) = self.key_of(scene, surface);
        Some((self.cell(key)?, level))
    }

    /// The key of a cell, and its level.
    fn key_of(&self, scene: &TracedScene, surface: &SurfacePoint) -> (u64, u32) {
        let place = (surface.position - self.low) * ((1 << MAX_LEVEL) as f32 / self.root);
        let place = place.as_uvec3().min(glam::UVec3::splat((1 << MAX_LEVEL) - 1));
        let mut cube = Cube { level: 0, at: [0; 3] };
        while self.is_split(cube) {
            let level = cube.level + 1;
            cube = Cube { level, at: (place >> (MAX_LEVEL - level)).to_array() };
        }
        (key(cube, surface.geometric_normal, scene.mesh.object(surface.triangle)), cube.level)
    }

    fn cell(&self, key: u64) -> Option<u32> {
        let (found, cell) = self.slots[self.slot(key)];
        (found == key).then_some(cell)
    }

    fn width_of(&self, level: u32) -> f32 {
        self.root / (1 << level) as f32
    }

    fn is_split(&self, cube: Cube) -> bool {
        let width = self.width_of(cube.level);
        let centre = (Vec3::from(cube.at.map(|at| at as f32)) + 0.5) * width + self.low;
        let [fixed, growing] = self.width;
        // The diagonal is that of the cube: the eye may be in it.
        cube.level < MAX_LEVEL && {
            let allowed = (width - fixed) / growing.max(f32::MIN_POSITIVE) - width;
            allowed > 0.0 && centre.distance_squared(self.eye) < allowed * allowed
        }
    }

    /// Cuts a polygon into the leaves below a cube that holds it; `add` gets what lies in each.
    fn cut(&self, cube: Cube, polygon: &[DVec3], add: &mut impl FnMut(Cube, &[DVec3])) {
        if !self.is_split(cube) {
            return add(cube, polygon);
        }
        let width = self.width_of(cube.level + 1);
        let middle = |axis: usize| f64::from((2 * cube.at[axis] + 1) as f32 * width + self.low[axis]);
        let mut parts = vec![([0; 3], polygon.to_vec())];
        for axis in 0..3 {
            let halves = |(half, polygon): ([u32; 3], Vec<DVec3>)| {
                [-1.0, 1.0].map(|side| {
                    let mut half = half;
                    half[axis] = u32::from(side > 0.0);
                    (half, clipped(&polygon, axis, middle(axis), side))
                })
            };
            parts = parts.into_iter().flat_map(halves).filter(|(_, polygon)| polygon.len() >= 3).collect();
        }
        for (half, polygon) in parts {
            let at = std::array::from_fn(|axis| 2 * cube.at[axis] + half[axis]);
            self.cut(Cube { level: cube.level + 1, at }, &polygon, add);
        }
    }

    /// Cuts a triangle; `add` gets the normal of each side of each piece.
    fn cut_facet(&self, facet: &Facet, add: &mut impl FnMut(Cube, Vec3, &[DVec3])) {
        if facet.sides.iter().any(Option::is_some) {
            self.cut(Cube { level: 0, at: [0; 3] }, &facet.corners, &mut |cube, polygon| {
                facet.sides.into_iter().flatten().for_each(|normal| add(cube, normal, polygon));
            });
        }
    }

    fn slot(&self, key: u64) -> usize {
        let mask = self.slots.len() - 1;
        let mut at = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & mask;
        while self.slots[at].0 != key && self.slots[at].0 != EMPTY {
            at = (at + 1) & mask;
        }
        at
    }

    /// The cell of a key; a new one is `next`.
    fn insert(&mut self, key: u64, next: u32) -> u32 {
        if 2 * next as usize > self.slots.len() {
            let old = std::mem::take(&mut self.slots);
            self.slots = vec![(EMPTY, 0); 2 * old.len()];
            for entry in old.into_iter().filter(|(key, _)| *key != EMPTY) {
                let at = self.slot(entry.0);
                self.slots[at] = entry;
            }
        }
        let at = self.slot(key);
        if self.slots[at].0 == EMPTY {
            self.slots[at] = (key, next);
        }
        self.slots[at].1
    }
}

impl Facet {
    fn new(scene: &TracedScene, hidden: &[bool], triangle: usize) -> Self {
        let corners = scene.mesh.triangles[triangle].map(|v| scene.mesh.positions[v as usize]);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        let both = scene.materials[scene.mesh.triangle_materials[triangle] as usize].double_sided;
        let is_seen = |back: usize| normal != Vec3::ZERO && !hidden[2 * triangle + back];
        let sides = [is_seen(0).then_some(normal), (both && is_seen(1)).then_some(-normal)];
        Self {
            triangle: triangle as u32,
            object: scene.mesh.object(triangle as u32),
            corners: corners.map(Vec3::as_dvec3),
            sides,
        }
    }

    fn position(&self, barycentric: Vec2) -> Vec3 {
        let [a, b, c] = self.corners.map(DVec3::as_vec3);
        a + (b - a) * barycentric.x + (c - a) * barycentric.y
    }

    /// Share of the rays that the surface stops.
    fn coverage(&self, scene: &TracedScene, barycentric: Vec2) -> f32 {
        coverage(scene, self.triangle, barycentric).max(LEAST_COVERAGE)
    }

    /// Points of a convex part of the triangle in barycentric coordinates, each with the area that it stands for.
    fn parts<'a>(&'a self, polygon: &'a [DVec3]) -> impl Iterator<Item = (Vec2, f32)> {
        let [a, b, c] = self.corners;
        let normal = (b - a).cross(c - a);
        let barycentric = move |place: DVec3| {
            let weight = |edge: DVec3| edge.dot(normal) / normal.length_squared();
            DVec2::new(weight((place - a).cross(c - a)), weight((b - a).cross(place - a))).as_vec2()
        };
        polygon.windows(2).skip(1).flat_map(move |edge| {
            let corners = [polygon[0], edge[0], edge[1]];
            let area = 0.5 * (edge[0] - polygon[0]).cross(edge[1] - polygon[0]).length();
            let centre = corners.iter().sum::<DVec3>() / 3.0;
            // Centres of the four triangles between the middles of its edges.
            let places = [centre].into_iter().chain(corners.map(|corner| 0.5 * (centre + corner)));
            places.map(move |place| (barycentric(place), 0.25 * area as f32))
        })
    }
}

/// Where a chain of cells ends, of which each leads to another or to itself.
fn root(into: &[u32], mut cell: u32) -> u32 {
    while into[cell as usize] != cell {
        cell = into[cell as usize];
    }
    cell
}

/// Of surfaces of an object in a cube that face along the same axis. Objects have cells of their own since one can be
/// in the light and another one behind it in its shadow.
fn key(Cube { level, at }: Cube, normal: Vec3, object: usize) -> u64 {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
    let side = (2 * axis + usize::from(normal[axis] < 0.0)) as u64;
    let [x, y, z] = at.map(u64::from);
    x | y << 12 | z << 24 | u64::from(level) << 36 | side << 40 | (object as u64) << 43 & !(1 << 63)
}

fn level_of(key: u64) -> u32 {
    (key >> 36) as u32 & 15
}

/// The key of the same side in the next larger cube.
fn parent(key: u64) -> u64 {
    let [x, y, z] = [0, 12, 24].map(|shift| (key >> shift & 0xfff) >> 1 << shift);
    x | y | z | u64::from(level_of(key) - 1) << 36 | key >> 40 << 40
}

/// The key of the same side in a cube in which pilot photons are counted, or in the cell's own if that is larger.
fn ancestor(mut key: u64) -> u64 {
    while level_of(key) > PILOT_LEVEL {
        key = parent(key);
    }
    key
}

/// What is met from above a place.
struct Covering {
    triangle: u32,
    /// Whether it lies above the place by more than rounding.
    is_above: bool,
    /// Whether light can hardly get between the place and what faces it.
    is_narrow: bool,
}

/// What lies on a place of a cell that is `width` wide.
fn covering(scene: &TracedScene, place: Vec3, normal: Vec3, width: f32) -> Option<Covering> {
    let offset = scene.bvh.shadow_offset(0.0);
    let origin = place + normal * offset;
    let free = scene.closest_hit(origin, normal, width).map_or(width, |hit| hit.distance);
    let (s, t) = normal.any_orthonormal_pair();
    let tilted = [s, t, -s, -t].map(|side| (0.5 * normal + 0.75f32.sqrt() * side).normalize());
    let is_narrow = free < NARROW[0] * width
        && tilted.iter().all(|direction| scene.closest_hit(origin, *direction, NARROW[1] * width).is_some());
    // A skin may lie closer than rays can start.
    let height = offset + 0.5 * free;
    let hit = scene.closest_hit(place + normal * height, -normal, 2.0 * height)?;
    Some(Covering { triangle: hit.triangle, is_above: hit.distance < height - offset, is_narrow })
}

/// The part of a convex polygon on one side of a plane [Sutherland 1974].
fn clipped(polygon: &[DVec3], axis: usize, plane: f64, side: f64) -> Vec<DVec3> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    let mut last = polygon[polygon.len() - 1];
    for &next in polygon {
        let [from, to] = [last, next].map(|corner| side * (corner[axis] - plane));
        if (from < 0.0) != (to < 0.0) {
            kept.push(last + (next - last) * (from / (from - to)));
        }
        if to >= 0.0 {
            kept.push(next);
        }
        last = next;
    }
    kept
}
