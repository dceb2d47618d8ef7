//! Surfaces of revolution: crockery, vases, lamp parts.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, dvec2};

use crate::mesh::Mesh;

/// Turned about +Y. Each run of points (radius, y) is one smooth curve; between runs lies an edge. A run that rises
/// faces away from the axis. Every span between two points has `steps`.
pub fn lathe(runs: &[&[(f64, f64)]], sides: u32, steps: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for run in runs {
        let points: Vec<DVec2> = run.iter().map(|&(radius, y)| dvec2(radius, y)).collect();
        let last = (points.len() as u32 - 1) * steps;
        let widest = points.iter().map(|p| p.x).fold(0.0, f64::max);
        let first = mesh.positions.len() as u32;
        let mut length = 0.0;
        for i in 0..=last {
            let t = f64::from(i) / f64::from(steps);
            let p = curve(&points, t);
            if i > 0 {
                length += p.distance(curve(&points, t - 1.0 / f64::from(steps)));
            }
            let tangent = (curve(&points, t + 1e-4) - curve(&points, t - 1e-4)).normalize();
            for side in 0..=sides {
                let turn = f64::from(side) / f64::from(sides);
                let (sin, cos) = (TAU * turn).sin_cos();
                let round = |radius: f64, y: f64| DVec3::new(radius * sin, y, radius * cos);
                mesh.positions.push(round(p.x, p.y));
                mesh.normals.push(round(tangent.y, -tangent.x));
                mesh.uvs.push(dvec2(turn * TAU * widest, -length));
            }
        }
        push_rings(&mut mesh, first, sides, last);
    }
    mesh
}

/// Quads between rings, triangles where one end is a point on the axis.
fn push_rings(mesh: &mut Mesh, first: u32, sides: u32, rows: u32) {
    let on_axis = |mesh: &Mesh, i: u32| mesh.positions[i as usize].x.hypot(mesh.positions[i as usize].z) < 1e-9;
    for row in 0..rows {
        for side in 0..sides {
            let a = first + row * (sides + 1) + side;
            let (b, c, d) = (a + 1, a + sides + 2, a + sides + 1);
            if !on_axis(mesh, a) {
                mesh.triangles.push([a, b, c]);
            }
            if !on_axis(mesh, c) {
                mesh.triangles.push([a, c, d]);
            }
        }
    }
}

/// Catmull-Rom through the points, straight beyond the ends; on the axis the radius stays 0.
fn curve(points: &[DVec2], t: f64) -> DVec2 {
    let last = points.len() - 1;
    let i = (t.floor().max(0.0) as usize).min(last - 1);
    let point = |i: isize| match i {
        -1 => 2.0 * points[0] - points[1],
        i if i as usize > last => 2.0 * points[last] - points[last - 1],
        i => points[i as usize],
    };
    let i = i as isize;
    let [a, b, c, d] = [point(i - 1), point(i), point(i + 1), point(i + 2)];
    let t = t - i as f64;
    0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t + (3.0 * (b - c) + d - a) * t * t * t)
}
