//! A tiled fireplace before the chimney breast, round x = 0; z = 0 is the breast's front.

use glam::{DVec3, dvec2, dvec3};

use super::lathe::lathe;
use super::looks::{BLACK_IRON, GILT, MIRROR, SOOT, TILES, WALNUT, WHITE_PAINT};
use super::shapes::{Rounding, board, moulding, rod, rounded_box, upright_along};
use super::shell::MOUTH;
use super::soft::displace;
use super::{Piece, piece};
use crate::mesh::{Mesh, joined, quad};
use crate::noise::noise;

pub const MANTEL_HEIGHT: f64 = 1.14;

pub fn fireplace() -> Vec<Piece> {
    let half = (MOUTH[1].x - MOUTH[0].x) / 2.0;
    let top = MOUTH[1].y;
    vec![
        piece("tiles", joined([surround(half, top), hearth()]), TILES),
        piece("firebox", firebox(half, top), SOOT),
        piece("mantel", mantel(), WHITE_PAINT),
        piece("logs", logs(), WALNUT),
        piece("grate", grate(), BLACK_IRON),
    ]
}

/// A slab of tiles whose joints meet its edges: whole tiles of 15 cm from `min`.
fn tiled(min: DVec3, max: DVec3) -> Mesh {
    let mut mesh = rounded_box(max - min, Rounding::EDGE).moved((min + max) / 2.0);
    for ((uv, p), normal) in mesh.uvs.iter_mut().zip(&mesh.positions).zip(&mesh.normals) {
        let p = *p - min;
        *uv = if normal.z.abs() > 0.7 {
            dvec2(p.x, -p.y)
        } else if normal.y.abs() > 0.7 {
            dvec2(p.x, p.z)
        } else {
            dvec2(p.z, -p.y)
        };
    }
    mesh
}

fn surround(half: f64, top: f64) -> Mesh {
    let depth = 0.022;
    joined([
        tiled(dvec3(-half - 0.15, 0.03, 0.0), dvec3(-half, top, depth)),
        tiled(dvec3(half, 0.03, 0.0), dvec3(half + 0.15, top, depth)),
        tiled(dvec3(-half - 0.15, top, 0.0), dvec3(half + 0.15, top + 0.30, depth)),
    ])
}

fn hearth() -> Mesh {
    tiled(dvec3(-0.75, 0.0, 0.0), dvec3(0.75, 0.03, 0.375))
}

/// Open in front; its floor is as high as the hearth.
fn firebox(half: f64, top: f64) -> Mesh {
    let depth = 0.28;
    let (low, back) = (0.03, 0.6 * half);
    let slant = dvec3(half - back, 0.0, -depth);
    let y = (top - low) * DVec3::Y;
    joined([
        quad(dvec3(-back, low, -depth), 2.0 * back * DVec3::X, y),
        quad(dvec3(-half, low, 0.0), slant, y),
        quad(dvec3(back, low, -depth), slant * dvec3(1.0, 1.0, -1.0), y),
        quad(dvec3(-half, top, -depth), 2.0 * half * DVec3::X, depth * DVec3::Z),
        quad(dvec3(-half, low, -depth), depth * DVec3::Z, 2.0 * half * DVec3::X),
    ])
}

/// Pilasters, a frieze, mouldings and the shelf.
fn mantel() -> Mesh {
    let pilaster = |x: f64| {
        joined([
            board(dvec3(x - 0.11, 0.03, 0.0), dvec3(x + 0.11, 0.19, 0.055)),
            board(dvec3(x - 0.095, 0.19, 0.0), dvec3(x + 0.095, 0.97, 0.040)),
            board(dvec3(x - 0.035, 0.27, 0.040), dvec3(x + 0.035, 0.91, 0.047)),
        ])
    };
    let frieze = board(dvec3(-0.65, 0.96, 0.0), dvec3(0.65, 1.07, 0.045));
    let shelf =
        rounded_box(dvec3(1.48, 0.035, 0.23), Rounding::of(0.012, 3)).moved(dvec3(0.0, MANTEL_HEIGHT - 0.0175, 0.115));
    // Under the shelf, stepping out; the path keeps the room to its left.
    let under =
        [dvec3(0.655, 1.105, 0.0), dvec3(0.655, 1.105, 0.045), dvec3(-0.655, 1.105, 0.045), dvec3(-0.655, 1.105, 0.0)];
    const PROFILE: [(f64, f64); 5] = [(0.055, 0.0), (0.050, -0.012), (0.020, -0.024), (0.012, -0.040), (0.0, -0.044)];
    joined([pilaster(-0.545), pilaster(0.545), frieze, shelf, moulding(&under, false, DVec3::Y, &PROFILE)])
}

fn logs() -> Mesh {
    let log = |from: DVec3, to: DVec3, radius: f64, seed: f64| {
        let length = from.distance(to);
        let section: [&[(f64, f64)]; 3] =
            [&[(0.0, 0.0), (radius, 0.0)], &[(radius, 0.0), (radius, length)], &[(radius, length), (0.0, length)]];
        let mut mesh = lathe(&section, 16, 6);
        displace(&mut mesh, |p, _| {
            let bark = 0.3 * noise(p * 20.0 + seed) + 0.14 * noise(p * dvec3(90.0, 18.0, 90.0) + seed);
            dvec3(p.x, 0.0, p.z) * bark
        });
        mesh.placed(upright_along(from, to))
    };
    joined([
        log(dvec3(-0.19, 0.125, -0.10), dvec3(0.18, 0.125, -0.08), 0.045, 1.0),
        log(dvec3(-0.15, 0.125, -0.19), dvec3(0.14, 0.125, -0.20), 0.045, 5.0),
        log(dvec3(-0.16, 0.198, -0.17), dvec3(0.17, 0.203, -0.11), 0.040, 9.0),
    ])
}

fn grate() -> Mesh {
    let bars = (0..7).map(|i| {
        let x = -0.18 + 0.06 * f64::from(i);
        rod(dvec3(x, 0.07, -0.24), dvec3(x, 0.07, -0.04), [0.007; 2], 10)
    });
    let rails = [-0.24, -0.04].map(|z| rod(dvec3(-0.22, 0.07, z), dvec3(0.22, 0.07, z), [0.008; 2], 10));
    let feet = [(-0.2, -0.24), (0.2, -0.24), (-0.2, -0.04), (0.2, -0.04)]
        .map(|(x, z)| rod(dvec3(x, 0.03, z), dvec3(x, if z > -0.1 { 0.14 } else { 0.07 }, z), [0.008; 2], 10));
    joined(bars.chain(rails).chain(feet))
}

/// Hangs before z = 0 round the origin.
pub fn mirror() -> Vec<Piece> {
    const PROFILE: [(f64, f64); 9] = [
        (-0.004, 0.012),
        (-0.002, 0.020),
        (0.010, 0.026),
        (0.016, 0.022),
        (0.030, 0.034),
        (0.044, 0.036),
        (0.056, 0.026),
        (0.060, 0.014),
        (0.060, 0.0),
    ];
    let half = dvec2(0.46, 0.36);
    let corners = [-half, dvec2(-half.x, half.y), half, dvec2(half.x, -half.y)];
    vec![
        piece("frame", moulding(&corners.map(|c| c.extend(0.0)), true, DVec3::Z, &PROFILE), GILT),
        piece("glass", quad((-half).extend(0.014), 2.0 * half.x * DVec3::X, 2.0 * half.y * DVec3::Y), MIRROR),
    ]
}
