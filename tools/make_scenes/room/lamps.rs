//! What the lights seem to come from.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3, dvec2, dvec3};

use super::lathe::lathe;
use super::looks::{BLACK_IRON, BRASS, BULB, CEILING_GLOW, Look, WHITE_PAINT};
use super::shapes::{rod, sheet, upright_along};
use super::{Piece, piece};
use crate::mesh::{Mesh, joined, sphere};

/// Where the reading lamp's light leaves it, just below its bell.
pub fn reading_light(yaw_deg: f64) -> DVec3 {
    DQuat::from_rotation_y(yaw_deg.to_radians()) * dvec3(0.178, 1.332, 0.0)
}

/// Stands on the origin; its bulb would be 1.5 m up.
pub fn floor_lamp(shade_look: Look) -> Vec<Piece> {
    let foot = lathe(
        &[&[(0.0, 0.0), (0.135, 0.0)], &[(0.135, 0.0), (0.136, 0.012), (0.12, 0.022), (0.03, 0.028), (0.012, 0.05)]],
        36,
        3,
    );
    let pole = rod(dvec3(0.0, 0.03, 0.0), dvec3(0.0, 1.42, 0.0), [0.011, 0.009], 20);
    // The shade hangs by three wires from its upper ring.
    let wires = (0..3).map(|i| {
        let (sin, cos) = (TAU * f64::from(i) / 3.0).sin_cos();
        rod(dvec3(0.0, 1.60, 0.0), dvec3(0.138 * sin, 1.625, 0.138 * cos), [0.0025; 2], 6)
    });
    let harp = [-1.0, 1.0].map(|side: f64| {
        joined([
            rod(dvec3(0.0, 1.42, 0.0), dvec3(0.045 * side, 1.50, 0.0), [0.0022; 2], 6),
            rod(dvec3(0.045 * side, 1.50, 0.0), dvec3(0.0, 1.60, 0.0), [0.0022; 2], 6),
        ])
    });
    vec![
        piece("stand", joined([foot, pole].into_iter().chain(wires).chain(harp)), BRASS),
        piece("shade", shade(), shade_look),
    ]
}

/// One sheet, open above and below.
fn shade() -> Mesh {
    sheet([72, 8], dvec2(1.10, 0.30), |t| {
        let (sin, cos) = (TAU * t.x).sin_cos();
        let radius = 0.205 - 0.067 * t.y - 0.008 * (1.0 - (2.0 * t.y - 1.0).powi(2));
        dvec3(radius * sin, 1.34 + 0.29 * t.y, radius * cos)
    })
}

/// A slender stand with a bell at its end, which points along +X and down.
pub fn reading_lamp() -> Vec<Piece> {
    let foot =
        lathe(&[&[(0.0, 0.0), (0.11, 0.0)], &[(0.11, 0.0), (0.108, 0.014), (0.02, 0.020), (0.008, 0.03)]], 30, 2);
    let pole = rod(dvec3(0.0, 0.02, 0.0), dvec3(0.0, 1.40, 0.0), [0.007; 2], 14);
    let (neck, mouth) = (dvec3(0.10, 1.455, 0.0), dvec3(0.17, 1.345, 0.0));
    let arm = rod(dvec3(0.0, 1.395, 0.0), neck, [0.006; 2], 12);
    let length = neck.distance(mouth);
    let bell = lathe(
        &[
            &[(0.065, length), (0.052, 0.55 * length), (0.026, 0.12 * length), (0.0, 0.0)],
            &[(0.0, -0.012), (0.024, 0.0), (0.055, 0.55 * length), (0.067, length)],
        ],
        26,
        3,
    );
    vec![piece("iron", joined([foot, pole, arm, bell.placed(upright_along(neck, mouth))]), BLACK_IRON)]
}

/// In the bell of the reading lamp.
pub fn reading_bulb() -> Vec<Piece> {
    vec![piece("bulb", sphere(0.024, 24, 16).moved(dvec3(0.15, 1.375, 0.0)), BULB)]
}

/// Discs in the cans under the ceiling; they face down.
pub fn ceiling_glow(mouths: &[DVec3]) -> Vec<Piece> {
    let disc = lathe(&[&[(0.0, 0.02), (0.038, 0.02)]], 26, 1);
    vec![piece("glow", joined(mouths.iter().map(|&mouth| disc.clone().moved(mouth))), CEILING_GLOW)]
}

/// Cans under the ceiling, open below; light leaves them at `mouths`.
pub fn ceiling_spots(mouths: &[DVec3]) -> Vec<Piece> {
    const TOP: f64 = 0.041;
    let can = lathe(
        &[
            &[(0.040, 0.034), (0.040, 0.008)],
            &[(0.040, 0.008), (0.048, 0.004)],
            &[(0.048, 0.004), (0.050, 0.012), (0.050, TOP)],
        ],
        26,
        2,
    );
    let lid = lathe(&[&[(0.0, 0.034), (0.040, 0.034)]], 26, 1);
    let cans = mouths.iter().map(|&mouth| joined([can.clone(), lid.clone()]).moved(mouth));
    vec![piece("cans", joined(cans), WHITE_PAINT)]
}
