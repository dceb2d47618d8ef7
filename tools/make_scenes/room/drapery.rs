//! Curtains on their rod, and the rug.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, dvec2, dvec3};

use super::lathe::lathe;
use super::looks::{BRASS, CURTAIN, RUG};
use super::shapes::{Rounding, rod, rounded_box, sheet};
use super::shell::LEFT;
use super::soft::displace;
use super::{Piece, piece};
use crate::mesh::{Mesh, joined, torus};
use crate::noise::noise;

const ROD_X: f64 = LEFT + 0.10;
const ROD_Y: f64 = 2.30;

pub fn curtains() -> Vec<Piece> {
    let hanging = [curtain(-1.88, -1.36, 6.0, 1.0), curtain(0.17, 0.66, 6.0, 4.0)];
    let rings = [(-1.85, -1.40), (0.20, 0.63)]
        .into_iter()
        .flat_map(|(from, to)| (0..8).map(move |i| ring(from + (to - from) * f64::from(i) / 7.0)));
    vec![
        piece("cloth", joined(hanging), CURTAIN),
        piece("rod", joined(fittings()), BRASS),
        piece("rings", joined(rings), BRASS),
    ]
}

/// From `from` to `to` along z, in `folds` that open downwards.
fn curtain(from: f64, to: f64, folds: f64, seed: f64) -> Mesh {
    let height = ROD_Y - 0.03;
    // Cloth is twice as wide as it hangs.
    sheet([96, 26], dvec2(2.0 * (to - from), height), |uv: DVec2| {
        let down = 1.0 - uv.y;
        let wander = 0.35 * noise(dvec3(uv.x * 5.0, uv.y * 1.7, seed));
        let phase = TAU * (folds * uv.x + wander * down);
        let depth = 0.026 + 0.018 * down + 0.010 * noise(dvec3(uv.x * 4.0, 7.0, seed));
        let spread = 1.0 + 0.06 * down * (2.0 * uv.x - 1.0).powi(2);
        let middle = (from + to) / 2.0;
        let along = middle + (to - from) * spread * (uv.x - 0.5) + 0.004 * (2.0 * phase).sin() * (0.4 + 0.6 * down);
        dvec3(ROD_X + 0.012 * down + depth * phase.sin(), 0.015 + (height - 0.035) * uv.y, along)
    })
}

fn ring(z: f64) -> Mesh {
    torus(12, 5, |u, v| {
        let (around, across) = ((TAU * u).sin_cos(), (TAU * v).sin_cos());
        let out = dvec3(around.1, around.0, 0.0);
        dvec3(ROD_X, ROD_Y - 0.008, z) + out * (0.024 - 0.003 * across.1) + DVec3::Z * 0.003 * across.0
    })
}

fn fittings() -> Vec<Mesh> {
    let [from, to] = [-2.02, 0.82];
    let knob = lathe(&[&[(0.0, 0.0), (0.020, 0.006), (0.026, 0.024), (0.016, 0.044), (0.0, 0.052)]], 16, 3);
    let bracket = |z: f64| rod(dvec3(LEFT, ROD_Y, z), dvec3(ROD_X, ROD_Y, z), [0.010, 0.007], 12);
    let lying = |towards: f64, z: f64| {
        let turn = glam::DAffine3::from_rotation_x(towards * std::f64::consts::FRAC_PI_2);
        knob.clone().placed(glam::DAffine3::from_translation(dvec3(ROD_X, ROD_Y, z)) * turn)
    };
    vec![
        rod(dvec3(ROD_X, ROD_Y, from), dvec3(ROD_X, ROD_Y, to), [0.012; 2], 20),
        lying(-1.0, from),
        lying(1.0, to),
        bracket(from + 0.05),
        bracket(to - 0.05),
    ]
}

/// 2.3 m along x, 1.6 m along z, with a little swing in it.
pub fn rug() -> Vec<Piece> {
    let size = dvec3(2.3, 0.008, 1.6);
    let mut mesh = rounded_box(size, Rounding { radius: 0.003, steps: 1, cells: [24, 1, 16] });
    for (uv, p) in mesh.uvs.iter_mut().zip(&mesh.positions) {
        *uv = dvec2(p.x / size.x + 0.5, p.z / size.z + 0.5);
    }
    // Only upwards: below is the floor.
    displace(&mut mesh, |p, _| DVec3::Y * if p.y > 0.0 { 0.0015 * noise(p * 6.0) } else { 0.0 });
    vec![piece("pile", mesh.moved(DVec3::Y * 0.0042), RUG)]
}
