//! Lookup of the gather samples that a surface point reads. Every side of every triangle is divided into cells that are
//! small compared with the distance of samples; each cell stores its samples and their weights.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::bake::gather_samples::{GatherSample, GatherSamples, Place, carries_light};
use crate::scene::Scene;
use crate::storage::pods;
use crate::trace::point_tree::{Point, PointTree, point};

/// Number of samples that a cell reads.
pub const NEIGHBOURS: usize = 4;
/// Number of candidates for these samples.
const LOOKED_AT: usize = 16;
/// Weight of distances perpendicular to the surface's plane, relative to distances along it.
const OFF_PLANE: f32 = 4.0;
/// Cells per width of a gather sample.
const CELLS_A_SAMPLE: f32 = 4.0;
/// Maximum number of cells along an edge.
const MAX_CELLS_ALONG: f32 = 4096.0;
/// Minimum cosine between the normals of a point and of a sample that it reads: 45 degrees.
const MIN_NORMAL_COSINE: f32 = 0.7;

/// Gather samples that a piece of surface reads. Weights sum to 1, or are all 0 if the surface neither reflects nor
/// emits light.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Cell {
    /// Indices of gather samples, the nearest one first; some can have weight 0.
    pub samples: [u32; NEIGHBOURS],
    pub weights: [f32; NEIGHBOURS],
}

/// The cells of one side of a triangle: a parallelogram, half of which the triangle covers.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
struct Grid {
    first: u32,
    /// 0 if the side is black: the back of a single-sided face.
    columns: u16,
    rows: u16,
    /// The vertex at the origin of the parallelogram: that opposite to the longest edge.
    corner: u32,
}

/// The cells of all triangles of a scene.
#[derive(Clone, Serialize, Deserialize)]
pub struct Cells {
    /// Front and back of each triangle.
    #[serde(with = "pods")]
    grids: Vec<Grid>,
    #[serde(with = "pods")]
    cells: Vec<Cell>,
}

impl Cells {
    pub fn new(scene: &Scene, samples: &GatherSamples) -> Self {
        let neighbours = Neighbours::new(samples);
        let widths = widths(scene, samples, &neighbours);
        let mut first = 0;
        let grids: Vec<Grid> = (0..2 * scene.mesh.triangles.len() as u32)
            .map(|side| {
                let material = scene.mesh.triangle_materials[side as usize / 2] as usize;
                if samples.is_empty() || (side % 2 == 1 && !scene.materials[material].double_sided) {
                    return Grid::default();
                }
                let grid = Grid { first, ..Grid::new(scene, side / 2, widths[side as usize / 2]) };
                first += u32::from(grid.columns) * u32::from(grid.rows);
                grid
            })
            .collect();
        let cells_of = |(side, grid): (usize, &Grid)| {
            let (grid, neighbours, width) = (*grid, &neighbours, widths[side / 2]);
            (0..grid.rows).flat_map(move |row| (0..grid.columns).map(move |column| (column, row))).map(
                move |(column, row)| {
                    let place = Place {
                        triangle: side as u32 / 2,
                        barycentric: grid.centre(column, row)?,
                        back: side % 2 == 1,
                    };
                    let surface = place.surface(scene, width);
                    carries_light(&surface).then(|| neighbours.cell(surface.position, surface.normal, surface.material))
                },
            )
        };
        let cells = grids.par_iter().enumerate().flat_map_iter(cells_of).map(Option::unwrap_or_default).collect();
        Self { grids, cells }
    }

    /// Index of the cell of a surface point; `None` on the back of a single-sided face.
    #[inline(always)]
    pub fn index(&self, place: &Place) -> Option<u32> {
        let grid = &self.grids[2 * place.triangle as usize + usize::from(place.back)];
        grid.cell(place.barycentric)
    }

    /// Indices of the cells of a side: the front of triangle `side / 2` if even, else its back.
    pub fn of_side(&self, side: u32) -> Range<u32> {
        let grid = &self.grids[side as usize];
        grid.first..grid.first + u32::from(grid.columns) * u32::from(grid.rows)
    }

    /// Area of each cell of a side, mesh space, with what lies outside of the triangle.
    pub fn area(&self, scene: &Scene, side: u32) -> f64 {
        let [a, b, c] = scene.mesh.triangles[side as usize / 2].map(|v| scene.mesh.positions[v as usize]);
        let grid = &self.grids[side as usize];
        f64::from((b - a).cross(c - a).length()) / (f64::from(grid.columns) * f64::from(grid.rows))
    }

    /// A point of a cell of a side, uniform for `u` in 0..1; `None` outside of the triangle.
    pub fn point_in(&self, side: u32, cell: u32, u: [f64; 2]) -> Option<Place> {
        let grid = &self.grids[side as usize];
        let (columns, rows) = (u32::from(grid.columns), u32::from(grid.rows));
        let (row, column) = ((cell - grid.first) / columns, (cell - grid.first) % columns);
        let along = |from: u32, u: f64, count: u32| ((f64::from(from) + u) / f64::from(count)) as f32;
        let on_grid = Vec2::new(along(column, u[0], columns), along(row, u[1], rows));
        let barycentric = (on_grid.element_sum() <= 1.0).then(|| grid.barycentric(on_grid))?;
        Some(Place { triangle: side / 2, barycentric, back: side % 2 == 1 })
    }

    /// The cell at an index from [`Self::index`].
    #[inline(always)]
    pub fn get(&self, index: u32) -> &Cell {
        &self.cells[index as usize]
    }
}

/// Width of the cells of each triangle, in mesh space: a fraction of the width of its smallest sample, but limited by
/// [`MAX_UNEVENNESS`].
fn widths(scene: &Scene, samples: &GatherSamples, neighbours: &Neighbours) -> Vec<f32> {
    let triangle_count = scene.mesh.triangles.len();
    if samples.is_empty() {
        return vec![0.0; triangle_count];
    }
    let mut counts = vec![0u32; triangle_count];
    let mut least = vec![f32::INFINITY; triangle_count];
    for sample in &samples.samples {
        counts[sample.triangle as usize] += 1;
        least[sample.triangle as usize] = least[sample.triangle as usize].min(sample.area);
    }
    let width = |triangle: usize| {
        let [a, b, c] = scene.mesh.triangles[triangle].map(|v| scene.mesh.positions[v as usize]);
        let even = |count: u32| 0.5 * (b - a).cross(c - a).length() / (MAX_UNEVENNESS * count as f32);
        let sample_area = match counts[triangle] {
            0 => neighbours.nearest((a + b + c) / 3.0).area.max(even(1)),
            count => least[triangle].max(even(count)),
        };
        sample_area.sqrt() / CELLS_A_SAMPLE
    };
    (0..triangle_count).into_par_iter().map(width).collect()
}

/// Maximum reduction of the area that determines the cell width, relative to samples of equal area.
const MAX_UNEVENNESS: f32 = 2.0;

/// Finds the samples near a point.
pub struct Neighbours<'a> {
    samples: &'a GatherSamples,
    /// By position only; normals are compared separately.
    tree: PointTree,
    /// By position, and a distance [`Self::apart`] between groups.
    by_group: PointTree,
    /// Twice the diagonal of the samples' bounds.
    apart: f32,
    bounds: [Vec3; 2],
}

impl<'a> Neighbours<'a> {
    pub fn new(samples: &'a GatherSamples) -> Self {
        let positions = || samples.samples.iter().map(|s| s.position);
        let tree = |place: &dyn Fn(&GatherSample) -> Point| {
            PointTree::new(&samples.samples.iter().map(place).collect::<Vec<_>>())
        };
        let low = positions().fold(Vec3::INFINITY, Vec3::min);
        let high = positions().fold(Vec3::NEG_INFINITY, Vec3::max);
        let apart = (2.0 * low.distance(high)).max(f32::MIN_POSITIVE.sqrt());
        let of_group = |s: &GatherSample| in_group(s.position, samples.group(s.material), apart);
        Self {
            samples,
            tree: tree(&|s| point(s.position, Vec3::ZERO, 0.0)),
            by_group: tree(&of_group),
            apart,
            bounds: [low, high],
        }
    }

    /// The nearest sample, regardless of its normal. There must be at least one.
    fn nearest(&self, position: Vec3) -> &GatherSample {
        let found = self.tree.nearest::<1>(&point(position, Vec3::ZERO, 0.0), |_| true);
        &self.samples.samples[found.items()[0].1 as usize]
    }

    /// The nearest samples of the same material group and with similar normals; weights decrease to 0 at the distance
    /// of the next one. If the group has none, samples of any group are used. There must be at least one sample.
    pub fn cell(&self, position: Vec3, normal: Vec3, material: u32) -> Cell {
        let from = point(position, Vec3::ZERO, 0.0);
        let sample = |i: u32| &self.samples.samples[i as usize];
        let group = self.samples.group(material);
        let alike = |i: u32| sample(i).normal.dot(normal) > MIN_NORMAL_COSINE;
        let of_group = |i: u32| self.samples.group(sample(i).material) == group && alike(i);
        // Samples of other groups are farther than all of this group, unless the position is far from all samples.
        let [low, high] = self.bounds;
        let is_far = (low - position).max(position - high).max_element() > 0.25 * self.apart;
        let reach2 = if is_far { f32::INFINITY } else { self.apart * self.apart };
        let from_group = in_group(position, group, self.apart);
        let mut found = self.by_group.nearest_within::<LOOKED_AT>(&from_group, reach2, of_group);
        if found.items().is_empty() {
            found = self.tree.nearest::<LOOKED_AT>(&from, alike);
        }
        // Distances perpendicular to the surface's plane count more than distances along it.
        let distance2 = |&(distance2, i): &(f32, u32)| {
            let above = (sample(i).position - position).dot(normal);
            (distance2 + (OFF_PLANE * OFF_PLANE - 1.0) * above * above, i)
        };
        let mut found: Vec<(f32, u32)> = found.items().iter().map(distance2).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.truncate(NEIGHBOURS + 1);
        let mut cell = Cell::default();
        match &found[..] {
            [] => {
                cell.samples[0] = self.tree.nearest::<1>(&from, |_| true).items()[0].1;
                cell.weights[0] = 1.0;
            }
            found => {
                // With NEIGHBOURS + 1 samples found, the last one gets weight 0, so weights are continuous where
                // neighbours change. They fall fast with distance: wide kernels blur shadows and lose light at edges.
                let reach = found[found.len() - 1].0.sqrt() * if found.len() > NEIGHBOURS { 1.0 } else { 2.0 };
                for (i, &(distance2, sample)) in found.iter().take(NEIGHBOURS).enumerate() {
                    cell.samples[i] = sample;
                    cell.weights[i] = if reach > 0.0 { (1.0 - distance2.sqrt() / reach).powi(4) } else { 1.0 };
                }
                let sum: f32 = cell.weights.iter().sum();
                if sum > 0.0 {
                    cell.weights.iter_mut().for_each(|w| *w /= sum);
                } else {
                    cell.weights[0] = 1.0; // all at equal distance
                }
            }
        }
        cell
    }
}

/// A place in [`Neighbours::by_group`].
fn in_group(position: Vec3, group: u32, apart: f32) -> Point {
    point(position, group as f32 * Vec3::X, apart)
}

impl Cell {
    /// Whether the surface neither reflects nor emits light.
    pub fn is_black(&self) -> bool {
        self.weights[0] == 0.0
    }

    /// The nearest sample, whose area is roughly the surface that is nearest to it. `None` if the surface is black.
    #[inline(always)]
    pub fn nearest(&self) -> Option<usize> {
        (!self.is_black()).then_some(self.samples[0] as usize)
    }

    /// Samples and weights that are not 0.
    #[inline(always)]
    pub fn read(&self) -> impl Iterator<Item = (usize, f32)> {
        self.samples.iter().map(|&s| s as usize).zip(self.weights).filter(|&(_, weight)| weight > 0.0)
    }
}

impl Grid {
    fn new(scene: &Scene, triangle: u32, width: f32) -> Self {
        let corners = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize]);
        let edge = |a: usize, b: usize| corners[a % 3].distance(corners[b % 3]);
        let opposite = |c: &usize| edge(c + 1, c + 2);
        let corner = (0..3).max_by(|a, b| opposite(a).total_cmp(&opposite(b))).expect("there are three");
        let count = |length: f32| (length / width).ceil().clamp(1.0, MAX_CELLS_ALONG) as u16;
        let (columns, rows) = (count(edge(corner, corner + 1)), count(edge(corner, corner + 2)));
        Self { first: 0, columns, rows, corner: corner as u32 }
    }

    /// Barycentric coordinates of a cell's centre, moved onto the triangle; `None` if the cell lies completely outside.
    fn centre(&self, column: u16, row: u16) -> Option<Vec2> {
        let (columns, rows) = (f32::from(self.columns), f32::from(self.rows));
        if f32::from(column) / columns + f32::from(row) / rows >= 1.0 {
            return None;
        }
        let mut middle = Vec2::new((f32::from(column) + 0.5) / columns, (f32::from(row) + 0.5) / rows);
        let outside = middle.element_sum() - 1.0;
        if outside > 0.0 {
            middle = (middle - 0.5 * outside).max(Vec2::ZERO);
            middle /= middle.element_sum().max(1.0);
        }
        Some(self.barycentric(middle))
    }

    /// From weights of the two vertices after `corner` to those of the second and third vertex.
    fn barycentric(&self, on_grid: Vec2) -> Vec2 {
        let mut weights = [0.0; 3];
        weights[self.corner as usize] = 1.0 - on_grid.element_sum();
        weights[(self.corner as usize + 1) % 3] = on_grid.x;
        weights[(self.corner as usize + 2) % 3] = on_grid.y;
        Vec2::new(weights[1], weights[2])
    }

    #[inline(always)]
    fn cell(&self, barycentric: Vec2) -> Option<u32> {
        if self.columns == 0 {
            return None;
        }
        let weights = [1.0 - barycentric.element_sum(), barycentric.x, barycentric.y];
        let (u, v) = match self.corner {
            0 => (weights[1], weights[2]),
            1 => (weights[2], weights[0]),
            _ => (weights[0], weights[1]),
        };
        let (columns, rows) = (u32::from(self.columns), u32::from(self.rows));
        let column = ((u.max(0.0) * columns as f32) as u32).min(columns - 1);
        let mut row = ((v.max(0.0) * rows as f32) as u32).min(rows - 1);
        // Rounding can assign a hit on the longest edge to a cell that lies completely outside.
        if column * rows + row * columns >= columns * rows {
            row = row.saturating_sub(1);
        }
        Some(self.first + row * columns + column)
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;
    use crate::physics::sequence::Points;

    /// Compared with a search through all samples: in their midst, beside them, and far from all. The last group has
    /// only samples that face away, so those of any group serve.
    #[test]
    fn cells_read_the_nearest_of_their_group() {
        let random = Points::new(1, 0);
        let sample = |i: u32| {
            let [x, y, material, side] = random.at(i, 0);
            let material = (4.0 * material) as u32;
            let normal = if material == 3 || side < 0.3 { Vec3::NEG_Z } else { Vec3::Z };
            let position = Vec3::new(x as f32, y as f32, 0.0);
            GatherSample { position, normal, material, ..GatherSample::zeroed() }
        };
        let samples: Vec<GatherSample> = (0..400).map(sample).collect();
        let samples = GatherSamples { samples, points: Vec::new(), points_per_sample: 0, groups: vec![0, 1, 1, 2] };
        let neighbours = Neighbours::new(&samples);
        for (material, from) in (0..4).flat_map(|m| [0.1, 0.7, 1.3, 40.0].map(|x| (m, Vec3::new(x, 0.4, 0.0)))) {
            let alike = |group: Option<u32>| {
                let of_group = |s: &GatherSample| group.is_none_or(|group| samples.group(s.material) == group);
                let mut found: Vec<(f32, u32)> = (0..)
                    .zip(&samples.samples)
                    .filter(|(_, s)| s.normal == Vec3::Z && of_group(s))
                    .map(|(i, s)| (s.position.distance_squared(from), i))
                    .collect();
                found.sort_by(|a, b| a.0.total_cmp(&b.0));
                found.truncate(NEIGHBOURS);
                found.into_iter().map(|(_, i)| i).collect::<Vec<_>>()
            };
            let mut want = alike(Some(samples.group(material)));
            if want.is_empty() {
                want = alike(None);
            }
            let got = neighbours.cell(from, Vec3::Z, material).samples;
            assert_eq!(got[..], want[..], "material {material}, {from}");
        }
    }
}
