//! A pot plant: stems in a glazed pot, leaves that are bent cards cut out by alpha.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, dvec3};

use super::lathe::lathe;
use super::looks::{CELADON, LEAF, SOIL, STEM};
use super::shapes::{sheet, tube};
use super::{Piece, piece};
use crate::mesh::{Mesh, joined};
use crate::noise::Chance;

const SOIL_HEIGHT: f64 = 0.27;

/// Stands on the origin, about 1.3 m high.
pub fn plant() -> Vec<Piece> {
    let mut chance = Chance::new(5);
    let stems: Vec<Stem> = (0..5).map(|i| Stem::new(i, &mut chance)).collect();
    let mut leaves = Vec::new();
    for stem in &stems {
        for i in 0..stem.leaf_count {
            let along = 0.22 + 0.78 * f64::from(i) / f64::from(stem.leaf_count - 1);
            // The golden angle keeps leaves out of each other's light.
            let azimuth = stem.azimuth + 2.399_963 * f64::from(i) + chance.within(-0.3, 0.3);
            let length = (0.27 - 0.09 * along) * chance.within(0.85, 1.15);
            let elevation = 0.15 + 0.75 * along + chance.within(-0.2, 0.2);
            leaves.push(leaf(stem.at(along), azimuth, elevation, length, chance.within(0.9, 1.7)));
        }
    }
    vec![
        piece("pot", pot(), CELADON),
        piece(
            "soil",
            lathe(&[&[(0.150, SOIL_HEIGHT), (0.08, SOIL_HEIGHT + 0.008), (0.0, SOIL_HEIGHT + 0.012)]], 22, 2),
            SOIL,
        ),
        piece("stems", joined(stems.iter().map(Stem::mesh)), STEM),
        piece("leaves", joined(leaves), LEAF),
    ]
}

fn pot() -> Mesh {
    let outside = [(0.105, 0.0), (0.118, 0.03), (0.150, 0.17), (0.166, 0.27), (0.168, 0.296)];
    let inside = [(0.154, 0.296), (0.150, 0.25), (0.140, 0.20)];
    lathe(&[&[(0.0, 0.0), (0.105, 0.0)], &outside, &[(0.168, 0.296), (0.161, 0.301), (0.154, 0.296)], &inside], 40, 3)
}

struct Stem {
    azimuth: f64,
    lean: f64,
    height: f64,
    leaf_count: u32,
}

impl Stem {
    fn new(index: u32, chance: &mut Chance) -> Self {
        Self {
            azimuth: TAU * f64::from(index) / 5.0 + chance.within(-0.3, 0.3),
            lean: if index == 0 { 0.04 } else { chance.within(0.10, 0.20) },
            height: if index == 0 { 0.95 } else { chance.within(0.45, 0.80) },
            leaf_count: if index == 0 { 15 } else { 11 },
        }
    }

    fn at(&self, t: f64) -> DVec3 {
        let (sin, cos) = self.azimuth.sin_cos();
        let out = 0.03 + self.lean * t * t;
        let sway = 0.012 * (5.0 * t + self.azimuth).sin();
        dvec3(out * sin + sway * cos, SOIL_HEIGHT - 0.01 + self.height * t, out * cos - sway * sin)
    }

    fn mesh(&self) -> Mesh {
        tube(16, 8, [0.010, 0.004], |t| self.at(t))
    }
}

/// Grows from `base` towards `azimuth`, rising by `elevation` at first and drooping by `bend`, radians.
fn leaf(base: DVec3, azimuth: f64, elevation: f64, length: f64, bend: f64) -> Mesh {
    let out = dvec3(azimuth.sin(), 0.0, azimuth.cos());
    let side = dvec3(out.z, 0.0, -out.x);
    let width = 0.42 * length;
    sheet([4, 10], DVec2::ONE, |t| {
        // The integral of (cos, sin) of an angle that falls evenly.
        let angle = |s: f64| elevation - bend * s;
        let run = (angle(0.0).sin() - angle(t.y).sin()) / bend;
        let rise = (angle(t.y).cos() - angle(0.0).cos()) / bend;
        let up = dvec3(0.0, angle(t.y).cos(), 0.0) - out * angle(t.y).sin();
        // Folded along the rib, softly.
        let across = t.x - 0.5;
        let fold = 0.35 * (across * across + 0.01).sqrt();
        base + length * (out * run + DVec3::Y * rise) + width * (side * across + up * fold)
    })
}
