//! What is stuffed: boxes blown up and creased.

use std::collections::HashMap;

use glam::{DVec3, dvec3};

use super::shapes::{Rounding, rounded_box};
use crate::mesh::Mesh;
use crate::noise::noise;

/// Stuffing of a cushion: metres.
#[derive(Clone, Copy)]
pub struct Stuffing {
    pub radius: f64,
    /// How far the middle of each face swells.
    pub bulge: f64,
    pub creases: f64,
    /// Length of a cell.
    pub cell: f64,
}

/// A cushion round the origin; `seed` makes its creases its own.
pub fn cushion(size: DVec3, stuffing: Stuffing, seed: f64) -> Mesh {
    let half = size / 2.0;
    let cells = ((size - 2.0 * stuffing.radius) / stuffing.cell).ceil().max(DVec3::ONE).as_uvec3().to_array();
    let mut mesh = rounded_box(size, Rounding { radius: stuffing.radius, steps: 3, cells });
    displace(&mut mesh, |p, normal| {
        let q = (p / half).clamp(DVec3::NEG_ONE, DVec3::ONE);
        let swell = DVec3::ONE - q * q;
        // Each face swells with the distance from its own edges.
        let along = normal * normal;
        let bulge = along.x * swell.y * swell.z + along.y * swell.x * swell.z + along.z * swell.x * swell.y;
        let at = p + dvec3(seed, 2.0 * seed, -seed);
        let crease = noise(at * 7.0) + 0.5 * noise(at * dvec3(19.0, 15.0, 17.0));
        normal * (stuffing.bulge * bulge + stuffing.creases * crease)
    });
    mesh
}

/// A pillow: thick in the middle, seamed all round, corners drawn out.
pub fn pillow(width: f64, height: f64, thickness: f64, seed: f64) -> Mesh {
    let half = dvec3(width, height, thickness) / 2.0;
    let rounding = Rounding { radius: 0.02, steps: 2, cells: [22, 22, 1] };
    let mut mesh = rounded_box(dvec3(width, height, 0.05), rounding);
    displace(&mut mesh, |p, _| {
        let (x, y) = ((p.x / half.x).clamp(-1.0, 1.0), (p.y / half.y).clamp(-1.0, 1.0));
        let fullness = ((1.0 - x.powi(2)) * (1.0 - y.powi(2))).max(0.0).powf(0.45);
        let depth = 0.004 + half.z * fullness;
        // Sides are drawn in between the corners.
        let pull = dvec3(-x * (1.0 - y * y), -y * (1.0 - x * x), 0.0) * 0.09 * half.x;
        let at = p + dvec3(seed, -seed, seed);
        let crease = 0.010 * fullness * noise(at * 9.0) + 0.004 * fullness.min(1.0) * noise(at * 23.0);
        pull + DVec3::Z * ((depth - 0.025) * p.z / 0.025 + crease * p.z.signum())
    });
    mesh
}

/// Moves each vertex by `offset(position, normal)` and makes the normals anew, smooth across the seams of the grid.
pub fn displace(mesh: &mut Mesh, offset: impl Fn(DVec3, DVec3) -> DVec3) {
    let key = |p: DVec3| (p * 1e7).round().as_i64vec3().to_array();
    // Vertices that were one before stay one.
    let seams: Vec<_> = mesh.positions.iter().map(|&p| key(p)).collect();
    for (position, normal) in mesh.positions.iter_mut().zip(&mesh.normals) {
        *position += offset(*position, *normal);
    }
    let mut sums: HashMap<[i64; 3], DVec3> = HashMap::new();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
        for &i in triangle {
            *sums.entry(seams[i as usize]).or_default() += (b - a).cross(c - a);
        }
    }
    for (normal, seam) in mesh.normals.iter_mut().zip(&seams) {
        *normal = sums[seam].normalize_or(*normal);
    }
}
