//! Tables and chairs, standing round the origin; a chair faces +Z.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DVec2, DVec3, dvec2, dvec3};

use super::looks::{BEECH, OAK, PLASTIC, SCREEN, WALNUT};
use super::shapes::{Rounding, board, push_grid, rod, rounded_box};
use super::soft::displace;
use super::{Piece, piece};
use crate::mesh::{Mesh, joined, quad};

pub const DINING_HEIGHT: f64 = 0.745;
pub const COFFEE_HEIGHT: f64 = 0.42;

/// Open; its screen faces +Z and leans back.
pub fn laptop() -> Vec<Piece> {
    const SIZE: [f64; 2] = [0.33, 0.22];
    let (across, back) = (SIZE[0] * DVec3::X, dvec3(0.0, SIZE[1] * 0.96, -SIZE[1] * 0.28));
    let hinge = dvec3(-SIZE[0] / 2.0, 0.016, -SIZE[1] / 2.0);
    let ahead = across.cross(back).normalize();
    let base = board(dvec3(-SIZE[0] / 2.0, 0.0, -SIZE[1] / 2.0), dvec3(SIZE[0] / 2.0, 0.014, SIZE[1] / 2.0));
    let lid = quad(hinge, across, back);
    let behind = quad(hinge + across - 0.004 * ahead, -across, back);
    let screen = quad(hinge + 0.03 * across + 0.05 * back + 0.001 * ahead, 0.94 * across, 0.9 * back);
    vec![piece("body", joined([base, lid, behind]), PLASTIC), piece("screen", screen, SCREEN)]
}

/// 0.85 m along x, 1.15 m along z.
pub fn dining_table() -> Vec<Piece> {
    let top = slab(dvec2(0.425, 0.575), 0.12, 0.030).moved(DVec3::Y * (DINING_HEIGHT - 0.030));
    let (x, z) = (0.335, 0.475);
    let low = DINING_HEIGHT - 0.030 - 0.085;
    let apron = joined([
        board(dvec3(-x, low, z - 0.012), dvec3(x, DINING_HEIGHT - 0.030, z + 0.012)),
        board(dvec3(-x, low, -z - 0.012), dvec3(x, DINING_HEIGHT - 0.030, -z + 0.012)),
        board(dvec3(x - 0.012, low, -z), dvec3(x + 0.012, DINING_HEIGHT - 0.030, z)),
        board(dvec3(-x - 0.012, low, -z), dvec3(-x + 0.012, DINING_HEIGHT - 0.030, z)),
    ]);
    let legs = corners(x, z).map(|(x, z)| leg(dvec3(x * 1.04, 0.0, z * 1.03), dvec3(x, low + 0.08, z), [0.019, 0.033]));
    vec![piece("wood", joined([top, apron].into_iter().chain(legs)), OAK)]
}

/// 1.05 m along x, 0.55 m along z, with a shelf below.
pub fn coffee_table() -> Vec<Piece> {
    let top = slab(dvec2(0.525, 0.275), 0.09, 0.026).moved(DVec3::Y * (COFFEE_HEIGHT - 0.026));
    let shelf = slab(dvec2(0.44, 0.20), 0.05, 0.016).moved(DVec3::Y * 0.14);
    let legs = corners(0.43, 0.19)
        .map(|(x, z)| leg(dvec3(x * 1.06, 0.0, z * 1.1), dvec3(x, COFFEE_HEIGHT - 0.026, z), [0.014, 0.021]));
    vec![piece("wood", joined([top, shelf].into_iter().chain(legs)), WALNUT)]
}

pub fn chair() -> Vec<Piece> {
    const SEAT: f64 = 0.455;
    let seat = slab(dvec2(0.215, 0.205), 0.06, 0.026).moved(dvec3(0.0, SEAT - 0.026, 0.01));
    let front = [-1.0, 1.0]
        .map(|side| leg(dvec3(0.190 * side, 0.0, 0.185), dvec3(0.170 * side, SEAT - 0.026, 0.165), [0.012, 0.017]));
    let [foot, seat_back, head] = [dvec2(-0.215, 0.0), dvec2(-0.170, SEAT), dvec2(-0.245, 0.84)];
    let posts = [-1.0, 1.0].map(|side| {
        let at = |p: DVec2| dvec3(0.178 * side, p.y, p.x);
        joined([leg(at(foot), at(seat_back), [0.012, 0.016]), leg(at(seat_back), at(head), [0.016, 0.011])])
    });
    let rails = [0.80, 0.68, 0.58].map(|y| {
        let back = seat_back.x + (head.x - seat_back.x) * (y - SEAT) / (head.y - SEAT);
        rail(if y > 0.75 { 0.085 } else { 0.035 }).moved(dvec3(0.0, y, back))
    });
    let apron = joined([
        board(dvec3(-0.165, SEAT - 0.075, 0.150), dvec3(0.165, SEAT - 0.026, 0.168)),
        board(dvec3(-0.165, SEAT - 0.075, -0.175), dvec3(0.165, SEAT - 0.026, -0.160)),
        board(dvec3(-0.178, SEAT - 0.075, -0.165), dvec3(-0.162, SEAT - 0.026, 0.160)),
        board(dvec3(0.162, SEAT - 0.075, -0.165), dvec3(0.178, SEAT - 0.026, 0.160)),
    ]);
    vec![piece("wood", joined([seat, apron].into_iter().chain(front).chain(posts).chain(rails)), BEECH)]
}

/// A slat between the posts, bent backwards to fit a back.
fn rail(height: f64) -> Mesh {
    let mut mesh = rounded_box(dvec3(0.37, height, 0.015), Rounding { radius: 0.006, steps: 2, cells: [12, 1, 1] });
    displace(&mut mesh, |p, _| DVec3::Z * (1.1 * (p.x * p.x - 0.178 * 0.178)));
    mesh
}

/// A round leg, its grain along it.
pub fn leg(from: DVec3, to: DVec3, radii: [f64; 2]) -> Mesh {
    let mut mesh = rod(from, to, radii, 20);
    mesh.uvs.iter_mut().for_each(|uv| *uv = dvec2(uv.y, uv.x));
    mesh.slid(dvec2(from.x * 3.1, from.z * 2.3))
}

fn corners(x: f64, z: f64) -> [(f64, f64); 4] {
    [(x, z), (x, -z), (-x, -z), (-x, z)]
}

/// A plate with rounded corners and edges; its underside is y = 0. Grain runs along the longer side.
fn slab(half: DVec2, corner: f64, thickness: f64) -> Mesh {
    const ROUND: u32 = 4;
    const CORNER: u32 = 8;
    let edge = thickness * 0.35;
    // The section from the underside's rim outwards and up: (inset, y).
    let arc = |middle: f64, start: f64| {
        (0..=ROUND).map(move |i| {
            let (sin, cos) = (start + FRAC_PI_2 * f64::from(i) / f64::from(ROUND)).sin_cos();
            (edge - edge * cos, middle + edge * sin, dvec2(cos, sin))
        })
    };
    let section: Vec<_> = arc(edge, -FRAC_PI_2).chain(arc(thickness - edge, 0.0)).collect();
    // Counter-clockwise seen from above: around x up points outwards.
    let outline: Vec<(DVec2, DVec2)> = (0..=4 * (CORNER + 1))
        .map(|i| {
            let i = i % (4 * (CORNER + 1));
            let (quarter, step) = (i / (CORNER + 1), i % (CORNER + 1));
            let angle = TAU / 4.0 * (f64::from(quarter) + f64::from(step) / f64::from(CORNER));
            let out = dvec2(angle.sin(), angle.cos());
            let middle = TAU / 4.0 * (f64::from(quarter) + 0.5);
            (dvec2(middle.sin(), middle.cos()).signum() * (half - corner), out)
        })
        .collect();
    let along_x = half.x >= half.y;
    let uv = |p: DVec3| if along_x { dvec2(p.x, p.z + p.y) } else { dvec2(p.z, p.x + p.y) };
    let mut mesh = Mesh::default();
    let mut push = |p: DVec3, normal: DVec3| {
        mesh.positions.push(p);
        mesh.normals.push(normal);
        mesh.uvs.push(uv(p));
    };
    for &(inset, y, tilt) in &section {
        for &(centre, out) in &outline {
            let p = centre + out * (corner - inset);
            push(dvec3(p.x, y, p.y), dvec3(out.x * tilt.x, tilt.y, out.y * tilt.x));
        }
    }
    let columns = outline.len() as u32 - 1;
    let rows = section.len() as u32 - 1;
    // The flat faces: fans round their middles.
    for (y, normal) in [(0.0, DVec3::NEG_Y), (thickness, DVec3::Y)] {
        push(DVec3::Y * y, normal);
        for &(centre, out) in &outline {
            let p = centre + out * (corner - edge);
            push(dvec3(p.x, y, p.y), normal);
        }
    }
    push_grid(&mut mesh, 0, [columns, rows]);
    let below = (rows + 1) * (columns + 1);
    let above = below + columns + 2;
    for i in 1..=columns {
        mesh.triangles.extend([[below, below + i + 1, below + i], [above, above + i, above + i + 1]]);
    }
    mesh
}
