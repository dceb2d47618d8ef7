//! A map in two parts that add up to it: suns, and a glow that the [cells](sky_cells) of the sky can carry.

use std::f64::consts::{PI, TAU};
use std::ops::Range;
use std::sync::LazyLock;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{SkyMap, Texels, reduced, row_solid_angle};
use crate::image::luminance;
use crate::physics::sky_cells;

/// The parts of a map.
pub struct SkyParts {
    glow: Texels,
    suns: Vec<Sun>,
}

/// A small bright spot of a map.
#[derive(Clone, Copy, Debug)]
pub struct Sun {
    /// Unit, towards it, in the frame of the map.
    pub direction: DVec3,
    /// Of a surface that faces it: linear Rec. 709.
    pub irradiance: DVec3,
    /// That it would fill if it were evenly bright, sr.
    pub solid_angle: f64,
}

/// Texels across the glow at most.
const GLOW_WIDTH: usize = 512;
/// Number of suns at most: each is traced.
const MAX_SUNS: usize = 4;
/// Radius of what becomes a sun, and of the ring around it that tells what it stands out from; cosines of angles.
const SUN_COSINE: f64 = 0.998_63; // 3 degrees
const RING_COSINE: f64 = 0.994_52; // 6 degrees
/// Least share of a map's light that becomes a sun: less is not too bright for a cell.
const LEAST_SHARE: f64 = 0.02;
/// Rows and columns of places in a cell where the glow is read.
const PLACES: usize = 4;

impl Sun {
    /// Whether it fills at least a cell of the sky.
    pub fn is_large(&self) -> bool {
        self.solid_angle >= sky_cells::SOLID_ANGLE
    }

    /// A direction in the cone that it would fill, evenly spread while `[u, v]` is so over the unit square.
    pub fn direction_at(&self, [u, v]: [f64; 2]) -> DVec3 {
        let versine = u * self.solid_angle / TAU;
        let (sin, cos) = (TAU * v).sin_cos();
        let (s, t) = self.direction.any_orthonormal_pair();
        self.direction * (1.0 - versine) + (s * cos + t * sin) * (versine * (2.0 - versine)).sqrt()
    }
}

impl SkyParts {
    pub(super) fn new(texels: &Texels) -> Self {
        let mut glow = reduced(texels.clone(), GLOW_WIDTH);
        let mut suns = Vec::new();
        if glow.values.len() > 1 {
            while suns.len() < MAX_SUNS {
                let Some(sun) = glow.take_sun() else { break };
                suns.push(sun);
            }
        }
        Self { glow, suns }
    }

    /// What is too bright for cells of the sky.
    pub fn suns(&self) -> &[Sun] {
        &self.suns
    }

    /// Mean radiance of the glow in each cell of the sky, while the map is turned by `turns` as
    /// [`Light::turns`](crate::scene::Light::turns) says.
    pub fn glow(&self, turns: f64) -> Vec<Vec3> {
        static READ_AT: LazyLock<Vec<[f32; 2]>> = LazyLock::new(|| {
            let along = |i: usize| (i as f64 + 0.5) / PLACES as f64;
            let at = |i: usize| [along(i % PLACES), along(i / PLACES)];
            let of_cell =
                |cell| (0..PLACES * PLACES).map(move |i| SkyMap::place(sky_cells::direction(cell, at(i)).as_vec3()));
            (0..sky_cells::COUNT).flat_map(of_cell).collect()
        });
        let [width, height] = [self.glow.width, self.glow.height].map(|side| side as f32);
        let mean = |places: &[[f32; 2]]| {
            let read = |&[u, v]: &[f32; 2]| self.glow.interpolated((u + turns as f32) * width, v * height);
            places.iter().map(read).sum::<Vec3>() / places.len() as f32
        };
        READ_AT.par_chunks(PLACES * PLACES).map(mean).collect()
    }
}

impl Texels {
    /// Takes out the brightest spot if it is a sun; what remains there is as bright as the ring around it.
    fn take_sun(&mut self) -> Option<Sun> {
        let brightness = |value: &Vec3| f64::from(luminance(value.to_array()));
        let flux = |(i, value): (usize, &Vec3)| brightness(value) * self.solid_angle(i);
        let of_row =
            |(y, row): (usize, &[Vec3])| row.iter().map(brightness).sum::<f64>() * self.solid_angle(y * self.width);
        let all: f64 = self.values.chunks(self.width).enumerate().map(of_row).sum();
        let brightest = |a: &usize, b: &usize| brightness(&self.values[*a]).total_cmp(&brightness(&self.values[*b]));
        let brightest = self.direction((0..self.values.len()).max_by(brightest)?);
        // Of a spot of several texels, some at its edge may be as bright.
        let ring = RING_COSINE.acos();
        let weighted = |i| self.direction(i) * flux((i, &self.values[i]));
        let near = self.near(brightest, ring).filter(|i| self.direction(*i).dot(brightest) >= RING_COSINE);
        let middle = near.map(weighted).sum::<DVec3>().normalize_or(brightest);
        let [mut around, mut around_angle] = [DVec3::ZERO; 2];
        let mut inside = Vec::new();
        for i in self.near(middle, ring) {
            let cosine = self.direction(i).dot(middle);
            if cosine >= SUN_COSINE {
                inside.push(i);
            } else if cosine >= RING_COSINE {
                around += self.values[i].as_dvec3() * self.solid_angle(i);
                around_angle += self.solid_angle(i);
            }
        }
        if around_angle == DVec3::ZERO {
            return None;
        }
        let around = (around / around_angle).as_vec3();
        let [mut irradiance, mut toward] = [DVec3::ZERO; 2];
        let mut squares = 0.0;
        for &i in &inside {
            let excess = (self.values[i] - around).as_dvec3() * self.solid_angle(i);
            let bright = f64::from(luminance(excess.as_vec3().to_array())).max(0.0);
            irradiance += excess;
            toward += self.direction(i) * bright;
            squares += bright * bright / self.solid_angle(i);
        }
        let bright = f64::from(luminance(irradiance.as_vec3().to_array()));
        let share = bright / all;
        if !(share >= LEAST_SHARE && irradiance.min_element() >= 0.0) {
            return None;
        }
        inside.iter().for_each(|&i| self.values[i] = around);
        Some(Sun { direction: toward.normalize_or(middle), irradiance, solid_angle: bright * bright / squares })
    }

    /// Texels of the rows that come within `angle` radians of a unit direction.
    pub(super) fn near(&self, direction: DVec3, angle: f64) -> Range<usize> {
        let from_zenith = direction.y.clamp(-1.0, 1.0).acos();
        let row = |angle: f64| (angle / PI * self.height as f64).clamp(0.0, self.height as f64);
        let rows = row(from_zenith - angle) as usize..row(from_zenith + angle).ceil() as usize;
        rows.start * self.width..rows.end * self.width
    }

    /// Of the middle of a texel.
    pub(super) fn direction(&self, index: usize) -> DVec3 {
        self.direction_within(index, [0.5; 2])
    }

    /// Of a place in a texel, in the unit square.
    pub(super) fn direction_within(&self, index: usize, [right, down]: [f64; 2]) -> DVec3 {
        let (x, y) = ((index % self.width) as f64 + right, (index / self.width) as f64 + down);
        let (sin, cos) = (TAU * x / self.width as f64).sin_cos();
        let (sine, cosine) = (PI * y / self.height as f64).sin_cos();
        DVec3::new(sine * sin, cosine, -sine * cos)
    }

    pub(super) fn solid_angle(&self, index: usize) -> f64 {
        row_solid_angle(index / self.width, self.height) / self.width as f64
    }
}

#[cfg(test)]
mod tests {
    use super::super::SkyMap;
    use super::*;
    use glam::DQuat;

    /// A lamp at a place in the map, in a sky that is brighter above.
    fn map(lamp: f32) -> SkyMap {
        let radiance = |i: usize| {
            let (x, y) = (i % 256, i / 256);
            let sky = Vec3::new(1.0, 2.0, 3.0) * (1.0 - y as f32 / 128.0);
            if (40..43).contains(&x) && (30..33).contains(&y) { sky + lamp * Vec3::new(1.0, 0.5, 0.1) } else { sky }
        };
        SkyMap::new(Texels { width: 256, height: 128, values: (0..256 * 128).map(radiance).collect() })
    }

    fn flux(texels: &Texels) -> DVec3 {
        texels.values.iter().enumerate().map(|(i, value)| value.as_dvec3() * texels.solid_angle(i)).sum()
    }

    #[test]
    fn suns_and_glow_add_up_to_the_map() {
        for (lamp, suns) in [(0.0, 0), (10.0, 0), (1e3, 1), (1e7, 1)] {
            let map = map(lamp);
            let parts = map.parts();
            assert_eq!(parts.suns().len(), suns, "{lamp}");
            // Nine texels.
            let texels = 9.0 * map.texels.solid_angle(31 * 256);
            assert!(parts.suns().iter().all(|sun| (sun.solid_angle / texels - 1.0).abs() < 0.02));
            let all = flux(&map.texels);
            let suns: DVec3 = parts.suns().iter().map(|sun| sun.irradiance).sum();
            let off = (flux(&parts.glow) + suns - all) / all;
            assert!(off.abs().max_element() < 1e-5, "{lamp}: {off}");
            for turns in [0.0, 0.3] {
                let cells: DVec3 = parts.glow(turns).iter().map(|cell| cell.as_dvec3() * sky_cells::SOLID_ANGLE).sum();
                let off = (cells - flux(&parts.glow)) / all;
                assert!(off.abs().max_element() < 2e-3, "{lamp}, {turns}: {off}");
            }
        }
    }

    #[test]
    fn a_turned_glow_is_what_the_turned_map_shows() {
        let map = map(0.0);
        let turn = DQuat::from_rotation_y(0.3 * TAU).conjugate();
        for (cell, radiance) in map.parts().glow(0.3).into_iter().enumerate() {
            let seen = map.radiance((turn * sky_cells::direction(cell, [0.5; 2])).as_vec3());
            assert!((radiance - seen).abs().max_element() < 0.1, "{cell}: {radiance}, seen {seen}");
        }
        assert_eq!(map.parts().glow(0.0), map.parts().glow(0.0));
    }
}
