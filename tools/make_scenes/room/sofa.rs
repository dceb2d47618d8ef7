//! A two-seater and its cushions, facing +Z, standing round the origin.

use glam::{DAffine3, DVec3, dvec3};

use super::furniture::leg;
use super::looks::{CREAM, MUSTARD, SOFA, WALNUT};
use super::soft::{Stuffing, cushion, pillow};
use super::{Piece, piece};
use crate::mesh::{Mesh, joined};

const FIRM: Stuffing = Stuffing { radius: 0.035, bulge: 0.006, creases: 0.002, cell: 0.095 };
const PLUMP: Stuffing = Stuffing { radius: 0.045, bulge: 0.035, creases: 0.004, cell: 0.050 };

pub fn sofa() -> Vec<Piece> {
    let frame = [
        cushion(dvec3(1.60, 0.22, 0.80), FIRM, 1.0).moved(dvec3(0.0, 0.22, 0.02)),
        cushion(dvec3(0.21, 0.52, 0.88), FIRM, 2.0).moved(dvec3(-0.86, 0.37, 0.0)),
        cushion(dvec3(0.21, 0.52, 0.88), FIRM, 3.0).moved(dvec3(0.86, 0.37, 0.0)),
        leaning(cushion(dvec3(1.56, 0.70, 0.20), FIRM, 4.0), 8.0, dvec3(0.0, 0.46, -0.33)),
    ];
    let seats = [-1.0, 1.0]
        .map(|side| cushion(dvec3(0.745, 0.16, 0.64), PLUMP, 5.0 + side).moved(dvec3(0.376 * side, 0.395, 0.105)));
    let backs = [-1.0, 1.0].map(|side| {
        leaning(cushion(dvec3(0.73, 0.42, 0.17), PLUMP, 9.0 + side), 14.0, dvec3(0.374 * side, 0.68, -0.135))
    });
    let legs = [(-0.84, 0.34), (0.84, 0.34), (-0.84, -0.36), (0.84, -0.36)]
        .map(|(x, z)| leg(dvec3(x, 0.0, z), dvec3(x, 0.14, z), [0.018, 0.026]));
    vec![
        piece("frame", joined(frame), SOFA),
        piece("cushions", joined(seats.into_iter().chain(backs)), SOFA),
        piece("legs", joined(legs), WALNUT),
        piece(
            "pillow_mustard",
            thrown(pillow(0.44, 0.44, 0.15, 1.0), [24.0, 18.0], dvec3(-0.50, 0.665, 0.055)),
            MUSTARD,
        ),
        piece("pillow_cream", thrown(pillow(0.42, 0.42, 0.15, 5.0), [26.0, -16.0], dvec3(0.53, 0.655, 0.05)), CREAM),
        piece("pillow_front", thrown(pillow(0.36, 0.36, 0.13, 9.0), [34.0, -30.0], dvec3(0.36, 0.630, 0.20)), MUSTARD),
    ]
}

/// Tilted backwards.
fn leaning(mesh: Mesh, degrees: f64, to: DVec3) -> Mesh {
    mesh.placed(DAffine3::from_translation(to) * DAffine3::from_rotation_x(-degrees.to_radians()))
}

/// Leaning, then turned about +Y.
fn thrown(mesh: Mesh, [lean_deg, yaw_deg]: [f64; 2], to: DVec3) -> Mesh {
    leaning(mesh, lean_deg, DVec3::ZERO).turned(yaw_deg, to)
}
