//! Surfaces so bright that rays find their light too seldom: small ones beside a lamp, as the inside of its can.
//!
//! Rows find surfaces by chance. If one is small and much brighter than all others, few rows find it, and those get too
//! much: white dots. So the light of such gather samples is taken out of what rows multiply, and is estimated as that
//! of emitters is, also by points on the surfaces that read the samples.

use glam::{DVec3, Vec3};

use super::level::{CONSTANT, Level};
use super::paths::Arrival;
use crate::bake::gather_samples::Place;
use crate::scene::Scene;
use crate::trace::bvh::TracedScene;
use crate::trace::emitting_triangles::Receiver;

/// Bright gather samples of a level, and the surfaces that read them.
pub struct BrightSpots<'a> {
    level: &'a Level,
    /// By coefficient of the level; 0 but for the bright samples.
    radiance: Vec<DVec3>,
    /// Those that read them, in the order of their indices.
    cells: Vec<BrightCell>,
}

struct BrightCell {
    side: u32,
    index: u32,
    /// Brightness, divided by the sum of area times brightness of all: density of drawn points, 1 / area in mesh space.
    density: f64,
    /// Probability to draw a point of this cell or of one before it.
    running: f64,
}

/// Of a sample with these coefficients.
fn brightness(coefficients: &[DVec3]) -> f64 {
    f64::from(CONSTANT) * coefficients.iter().map(|k| k.length_squared()).sum::<f64>().sqrt()
}

/// A sample is bright if one ray that hits it adds more than this share of the light of an average row.
const BRIGHT: f64 = 0.05;

impl<'a> BrightSpots<'a> {
    /// Moves the coefficients of bright samples out of `radiance`, the level's. `rays`: number of rays of a row. `None`
    /// if no sample is bright.
    pub fn taken_from(radiance: &mut [DVec3], level: &'a Level, scene: &Scene, rays: u32) -> Option<Self> {
        let samples = &level.samples.samples;
        let bright: Vec<f64> = (0..samples.len()).map(|i| brightness(&radiance[level.coefficients(i)])).collect();
        let area: f64 = samples.iter().map(|s| f64::from(s.area)).sum();
        let mean = samples.iter().zip(&bright).map(|(s, b)| f64::from(s.area) * b).sum::<f64>() / area;
        let limit = BRIGHT * f64::from(rays) * mean;
        if bright.iter().all(|&b| b <= limit) {
            return None;
        }
        let mut taken = vec![DVec3::ZERO; radiance.len()];
        for i in (0..samples.len()).filter(|&i| bright[i] > limit) {
            let range = level.coefficients(i);
            taken[range.clone()].swap_with_slice(&mut radiance[range]);
        }
        Some(Self::new(taken, level, scene))
    }

    /// Of the coefficients of a level, which are 0 but for bright samples.
    pub fn new(radiance: Vec<DVec3>, level: &'a Level, scene: &Scene) -> Self {
        let of_sample = |i: usize| brightness(&radiance[level.coefficients(i)]);
        let bright: Vec<f64> = (0..level.samples.len()).map(of_sample).collect();
        let mut cells = Vec::new();
        let mut total = 0.0;
        for side in 0..2 * scene.mesh.triangles.len() as u32 {
            for index in level.cells.of_side(side) {
                let read = level.cells.get(index).read();
                let brightness: f64 = read.map(|(i, weight)| f64::from(weight) * bright[i]).sum();
                if brightness > 0.0 {
                    total += level.cells.area(scene, side) * brightness;
                    cells.push(BrightCell { side, index, density: brightness, running: total });
                }
            }
        }
        for cell in &mut cells {
            cell.density /= total;
            cell.running /= total;
        }
        Self { level, radiance, cells }
    }

    /// What [`BrightSpots::new`] takes.
    pub fn radiance(&self) -> &[DVec3] {
        &self.radiance
    }

    pub fn is_of(&self, level: &Level) -> bool {
        std::ptr::eq(self.level, level)
    }

    /// Draws a point: the unit direction to it, its RGB radiance, and the density per solid angle. `None` if the
    /// receiver does not see it. `u`: uniform in 0..1.
    pub fn draw(&self, scene: &TracedScene, receiver: &Receiver, u: [f64; 3]) -> Option<(Vec3, DVec3, f64)> {
        let at = self.cells.partition_point(|cell| cell.running <= u[0]);
        let cell = self.cells.get(at).or(self.cells.last())?;
        let place = self.level.cells.point_in(cell.side, cell.index, [u[1], u[2]])?;
        let (direction, hit) = receiver.sees(scene, place.triangle, place.barycentric)?;
        let (radiance, density) = self.seen(scene, cell, &place, -direction, hit.distance)?;
        Some((direction, radiance, density))
    }

    /// What a ray finds: RGB radiance, and the density per solid angle with which [`Self::draw`] finds it. `None`
    /// where nothing is bright.
    pub fn found(&self, scene: &Scene, arrival: &Arrival) -> Option<(DVec3, f64)> {
        let index = self.level.cells.index(&arrival.place)?;
        let cell = self.cells.binary_search_by_key(&index, |cell| cell.index).ok()?;
        self.seen(scene, &self.cells[cell], &arrival.place, arrival.wo, arrival.distance)
    }

    /// [`Self::found`] at a `place` in a bright `cell`.
    fn seen(&self, scene: &Scene, cell: &BrightCell, place: &Place, wo: Vec3, distance: f32) -> Option<(DVec3, f64)> {
        let cosine = f64::from(place.surface(scene, 0.0).geometric_normal.dot(wo));
        if cosine <= 0.0 {
            return None;
        }
        let mut radiance = DVec3::ZERO;
        self.level.read(self.level.cells.get(cell.index), wo, |_, weight, first, values| {
            for (k, &value) in self.radiance[first as usize..].iter().zip(values) {
                radiance += f64::from(weight * value) * k;
            }
        });
        let density = cell.density * f64::from(distance).powi(2) / cosine;
        (density > 0.0).then_some((radiance, density))
    }
}
