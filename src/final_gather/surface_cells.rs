//! Cells of surface: places in one leaf of an octree that face the same way [Binder 2019].

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::scene::{Camera, Projection};
use crate::trace::bvh::TracedScene;

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
    /// Area of each cell, mesh space.
    areas: Vec<f32>,
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
const MAX_LEVEL: u32 = 12;
/// Area of the smallest cells, relative to a face of their cube.
const SLIVER: f64 = 0.25;
const EMPTY: u64 = u64::MAX;

impl SurfaceCells {
    pub fn new(scene: &TracedScene, camera: &Camera) -> Self {
        let (eye, _) = camera.ray(0.5, 0.5, 1.0);
        let radius = scene.bvh.radius;
        let [fixed, growing] = match camera.projection {
            Projection::Perspective { yfov } => [0.0, (2.0 * (yfov / 2.0).tan() / CELLS_ALONG).max(LEAST_WIDTH)],
            Projection::Orthographic { ymag } => {
                let width = 2.0 * ymag / scene.space.unit / CELLS_ALONG;
                [width.max(LEAST_WIDTH * f64::from(radius)), 0.0]
            }
        };
        let mut cells = Self {
            eye: scene.space.from_world(eye).as_vec3(),
            width: [fixed as f32, growing as f32],
            low: -radius * Vec3::new(1.013, 1.007, 1.019),
            root: 2.04 * radius,
            slots: vec![(EMPTY, 0); 1 << 16],
            areas: Vec::new(),
        };
        let pieces = |triangle: usize| {
            let corners = scene.mesh.triangles[triangle].map(|v| scene.mesh.positions[v as usize]);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let both = scene.materials[scene.mesh.triangle_materials[triangle] as usize].double_sided;
            let mut pieces = Vec::new();
            let mut add = |cube: Cube, area: f64| {
                pieces.push((key(cube, normal), area));
                if both {
                    pieces.push((key(cube, -normal), area));
                }
            };
            let normal = normal.normalize_or_zero();
            if normal != Vec3::ZERO {
                cells.cut(Cube { level: 0, at: [0; 3] }, &corners.map(Vec3::as_dvec3), &mut add);
            }
            pieces
        };
        let pieces: Vec<(u64, f64)> = (0..scene.mesh.triangles.len()).into_par_iter().flat_map_iter(pieces).collect();
        let mut areas: Vec<f64> = Vec::new();
        for (key, area) in pieces {
            let cell = cells.insert(key, areas.len() as u32) as usize;
            areas.resize(areas.len().max(cell + 1), 0.0);
            areas[cell] += area;
        }
        cells.join_slivers(areas);
        cells
    }

    /// Joins cells that are too small for photons to tell their light with larger ones beside them.
    fn join_slivers(&mut self, mut areas: Vec<f64>) {
        let mut into: Vec<u32> = (0..areas.len() as u32).collect();
        let mut least = vec![0.0; areas.len()];
        let mut cells: Vec<(u64, u32)> = self.slots.iter().copied().filter(|(key, _)| *key != EMPTY).collect();
        for &(key, cell) in &cells {
            least[cell as usize] = SLIVER * f64::from(self.width_of(level_of(key))).powi(2);
        }
        for level in (1..=MAX_LEVEL).rev() {
            // Cells of one family lie in one cube of the next level and face the same way.
            cells.iter_mut().filter(|(key, _)| level_of(*key) == level).for_each(|(key, _)| *key = parent(*key));
            cells.sort_unstable();
            for family in cells.chunk_by(|a, b| a.0 == b.0) {
                let members = family.iter().map(|member| member.1 as usize);
                let largest = members.clone().max_by(|a, b| areas[*a].total_cmp(&areas[*b])).expect("it has members");
                for cell in members.filter(|cell| *cell != largest) {
                    if areas[cell] < least[cell] {
                        areas[largest] += areas[cell];
                        into[cell] = largest as u32;
                    }
                }
            }
            cells.retain(|(_, cell)| into[*cell as usize] == *cell);
        }
        let root = |mut cell: u32| {
            while into[cell as usize] != cell {
                cell = into[cell as usize];
            }
            cell
        };
        self.slots.iter_mut().filter(|(key, _)| *key != EMPTY).for_each(|(_, cell)| *cell = root(*cell));
        self.areas = areas.into_iter().map(|area| area as f32).collect();
    }

    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Mesh space.
    pub fn area(&self, cell: u32) -> f32 {
        self.areas[cell as usize]
    }

    /// The cell of a place on the side of a surface that `geometric_normal` points to; `None` by rounding on seams.
    pub fn of_place(&self, position: Vec3, geometric_normal: Vec3) -> Option<u32> {
        let place = (position - self.low) * ((1 << MAX_LEVEL) as f32 / self.root);
        let place = place.as_uvec3().min(glam::UVec3::splat((1 << MAX_LEVEL) - 1));
        let mut cube = Cube { level: 0, at: [0; 3] };
        while self.is_split(cube) {
            let level = cube.level + 1;
            cube = Cube { level, at: (place >> (MAX_LEVEL - level)).to_array() };
        }
        let key = key(cube, geometric_normal);
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

    /// Cuts a polygon into the leaves below a cube that holds it; `add` gets their areas.
    fn cut(&self, cube: Cube, polygon: &[DVec3], add: &mut impl FnMut(Cube, f64)) {
        if !self.is_split(cube) {
            let fan = polygon.windows(2).skip(1).map(|edge| (edge[0] - polygon[0]).cross(edge[1] - polygon[0]));
            return add(cube, 0.5 * fan.sum::<DVec3>().length());
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

/// Of surfaces in a cube that face along the same axis.
fn key(Cube { level, at }: Cube, normal: Vec3) -> u64 {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
    let side = (2 * axis + usize::from(normal[axis] < 0.0)) as u64;
    let [x, y, z] = at.map(u64::from);
    x | y << 12 | z << 24 | u64::from(level) << 36 | side << 40
}

fn level_of(key: u64) -> u32 {
    (key >> 36) as u32 & 15
}

/// The key of the same side in the next larger cube.
fn parent(key: u64) -> u64 {
    let [x, y, z] = [0, 12, 24].map(|shift| (key >> shift & 0xfff) >> 1 << shift);
    x | y | z | u64::from(level_of(key) - 1) << 36 | key >> 40 << 40
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
