//! Sheets, rounded boxes, rods and mouldings, with texture coordinates in metres.

use std::f64::consts::{FRAC_PI_4, TAU};

use glam::{DAffine3, DMat3, DVec2, DVec3, dvec2, dvec3};

use super::lathe::lathe;
use crate::mesh::Mesh;

/// A grid over the unit square, `size` metres wide and high; `d/du x d/dv` points to the front.
pub fn sheet(cells: [u32; 2], size: DVec2, surface: impl Fn(DVec2) -> DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    for row in 0..=cells[1] {
        for column in 0..=cells[0] {
            let uv = dvec2(f64::from(column), f64::from(row)) / dvec2(f64::from(cells[0]), f64::from(cells[1]));
            const STEP: f64 = 1e-5;
            let slope = |axis: DVec2| surface(uv + axis * STEP) - surface(uv - axis * STEP);
            mesh.positions.push(surface(uv));
            mesh.normals.push(slope(DVec2::X).cross(slope(DVec2::Y)).normalize());
            mesh.uvs.push(dvec2(uv.x, 1.0 - uv.y) * size);
        }
    }
    push_grid(&mut mesh, 0, cells);
    mesh
}

/// The triangles of a grid of vertices that begins at `first`.
pub fn push_grid(mesh: &mut Mesh, first: u32, [columns, rows]: [u32; 2]) {
    for row in 0..rows {
        for column in 0..columns {
            let a = first + row * (columns + 1) + column;
            let (b, c, d) = (a + 1, a + columns + 2, a + columns + 1);
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
}

/// How a box is rounded: metres, and how finely.
#[derive(Clone, Copy)]
pub struct Rounding {
    pub radius: f64,
    /// Steps of half an edge.
    pub steps: u32,
    /// Cells of the flat part along each axis.
    pub cells: [u32; 3],
}

impl Rounding {
    /// An edge just blunt enough to catch the light.
    pub const EDGE: Self = Self { radius: 0.003, steps: 1, cells: [1; 3] };

    pub const fn of(radius: f64, steps: u32) -> Self {
        Self { radius, steps, cells: [1; 3] }
    }
}

/// A box round the origin with rounded edges. Texture u runs along the longer side of each face: the grain of wood.
pub fn rounded_box(size: DVec3, rounding: Rounding) -> Mesh {
    let half = size / 2.0;
    let inner = half - rounding.radius;
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let (u_axis, v_axis) = ((axis + 1) % 3, (axis + 2) % 3);
            let [us, vs] = [u_axis, v_axis].map(|a| ticks(half[a], rounding.radius, rounding.steps, rounding.cells[a]));
            let first = mesh.positions.len() as u32;
            for &v in &vs {
                for &u in &us {
                    let mut p = DVec3::ZERO;
                    // The other way round on the far side, so that the face still looks outwards.
                    (p[axis], p[u_axis], p[v_axis]) = (half[axis] * sign, u * sign, v);
                    let core = p.clamp(-inner, inner);
                    let normal = (p - core).normalize();
                    mesh.positions.push(core + normal * rounding.radius);
                    mesh.normals.push(normal);
                    let uv = if size[u_axis] >= size[v_axis] {
                        dvec2(p[u_axis], p[v_axis])
                    } else {
                        dvec2(p[v_axis], p[u_axis])
                    };
                    mesh.uvs.push(uv);
                }
            }
            push_grid(&mut mesh, first, [us.len() as u32 - 1, vs.len() as u32 - 1]);
        }
    }
    mesh
}

/// Where a face's grid lines cross one of its axes: equal angles round the edges, equal cells between.
fn ticks(half: f64, radius: f64, steps: u32, cells: u32) -> Vec<f64> {
    let inner = half - radius;
    let edge = |i: u32| inner + radius * (FRAC_PI_4 * f64::from(i) / f64::from(steps)).tan();
    let low = (1..=steps).rev().map(|i| if i == steps { -half } else { -edge(i) });
    let middle = (0..=cells).map(|i| inner * (2.0 * f64::from(i) / f64::from(cells) - 1.0));
    let high = (1..=steps).map(|i| if i == steps { half } else { edge(i) });
    low.chain(middle).chain(high).collect()
}

/// A box between two corners with blunt edges, its grain slid by where it stands.
pub fn board(min: DVec3, max: DVec3) -> Mesh {
    let middle = (min + max) / 2.0;
    let slide = dvec2(middle.x * 3.7 + middle.z * 1.3, middle.y * 5.3 + middle.x * 0.9);
    rounded_box(max - min, Rounding::EDGE).slid(slide).moved(middle)
}

/// A closed cone stump between two points.
pub fn rod(from: DVec3, to: DVec3, radii: [f64; 2], sides: u32) -> Mesh {
    let length = from.distance(to);
    let mesh = lathe(
        &[&[(0.0, 0.0), (radii[0], 0.0)], &[(radii[0], 0.0), (radii[1], length)], &[(radii[1], length), (0.0, length)]],
        sides,
        1,
    );
    mesh.placed(upright_along(from, to))
}

/// Brings what stands on the origin to stand on `from`, pointing at `to`.
pub fn upright_along(from: DVec3, to: DVec3) -> DAffine3 {
    let along = (to - from).normalize();
    let side = along.any_orthonormal_vector();
    DAffine3::from_mat3_translation(DMat3::from_cols(side, along, side.cross(along)), from)
}

/// An open tube along a curve, thinning from one radius to the other.
pub fn tube(rows: u32, sides: u32, radii: [f64; 2], curve: impl Fn(f64) -> DVec3) -> Mesh {
    let length = curve(0.0).distance(curve(1.0));
    sheet([sides, rows], dvec2(TAU * radii[0], length), |uv| {
        let along = (curve(uv.y + 1e-4) - curve(uv.y - 1e-4)).normalize();
        // Curves here run upwards or sideways, never along this.
        let side = along.cross(dvec3(0.36, 0.48, 0.8)).normalize();
        let radius = radii[0] + (radii[1] - radii[0]) * uv.y;
        let (sin, cos) = (TAU * uv.x).sin_cos();
        curve(uv.y) + (side * cos + side.cross(along) * -sin) * radius
    })
}

/// A profile drawn along a path in a plane, mitred at its corners, flat-shaded. The profile's points are (to the left
/// of the path as seen against `up`, along `up`); it is followed so that its front lies to its left.
pub fn moulding(path: &[DVec3], closed: bool, up: DVec3, profile: &[(f64, f64)]) -> Mesh {
    let count = path.len();
    let segment_count = if closed { count } else { count - 1 };
    let left = |i: usize| up.cross((path[(i + 1) % count] - path[i]).normalize());
    let mitre = |i: usize| {
        let before = if i > 0 { Some(i - 1) } else { closed.then_some(count - 1) };
        let after = (i < segment_count).then_some(i);
        let (a, b) = (left(before.or(after).unwrap_or(0)), left(after.or(before).unwrap_or(0)));
        (a + b) / (1.0 + a.dot(b))
    };
    let mut mesh = Mesh::default();
    for i in 0..segment_count {
        let (start, end) = (path[i], path[(i + 1) % count]);
        let along = (end - start).normalize();
        let [start_side, end_side] = [mitre(i), mitre((i + 1) % count)];
        let mut across = 0.0;
        for pair in profile.windows(2) {
            let [[a, b], [c, d]] = [pair[0], pair[1]]
                .map(|(out, height)| [start + start_side * out + up * height, end + end_side * out + up * height]);
            let first = mesh.positions.len() as u32;
            let width = dvec2(pair[1].0 - pair[0].0, pair[1].1 - pair[0].1).length();
            mesh.positions.extend([a, b, d, c]);
            mesh.normals.extend([(b - a).cross(c - a).normalize(); 4]);
            let u = |p: DVec3| p.dot(along);
            let offset = i as f64 * 0.37;
            mesh.uvs.extend(
                [(u(a), across), (u(b), across), (u(d), across + width), (u(c), across + width)]
                    .map(|(u, v)| dvec2(u, v + offset)),
            );
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            across += width;
        }
    }
    mesh
}
