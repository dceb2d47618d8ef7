//! Triangle meshes and the ways in which this project makes them.

use std::f64::consts::TAU;

use glam::{DAffine3, DVec2, DVec3, UVec3, dvec2, uvec3};
use rayon::prelude::*;

/// Counter-clockwise from outside, one unit normal a vertex.
#[derive(Clone, Default)]
pub struct Mesh {
    pub positions: Vec<DVec3>,
    pub normals: Vec<DVec3>,
    /// Texture coordinates in metres, v downwards; empty where no texture can be put on.
    pub uvs: Vec<DVec2>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    pub fn push_quad(&mut self, corner: DVec3, u: DVec3, v: DVec3) {
        let first = self.positions.len() as u32;
        self.positions.extend([corner, corner + u, corner + u + v, corner + v]);
        self.normals.extend([u.cross(v).normalize(); 4]);
        let (width, height) = (u.length(), v.length());
        self.uvs.extend([dvec2(0.0, height), dvec2(width, height), dvec2(width, 0.0), DVec2::ZERO]);
        self.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }

    pub fn append(&mut self, other: Mesh) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.normals.extend(other.normals);
        self.uvs.extend(other.uvs);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
    }

    /// Moved and turned; `placement` has no scale.
    pub fn placed(mut self, placement: DAffine3) -> Self {
        self.positions.iter_mut().for_each(|p| *p = placement.transform_point3(*p));
        self.normals.iter_mut().for_each(|n| *n = placement.transform_vector3(*n).normalize());
        self
    }

    pub fn moved(self, by: DVec3) -> Self {
        self.placed(DAffine3::from_translation(by))
    }

    /// Turned about +Y, then moved.
    pub fn turned(self, yaw_deg: f64, by: DVec3) -> Self {
        self.placed(DAffine3::from_translation(by) * DAffine3::from_rotation_y(yaw_deg.to_radians()))
    }

    /// With all texture coordinates moved, so that equal pieces look unlike.
    pub fn slid(mut self, by: DVec2) -> Self {
        self.uvs.iter_mut().for_each(|uv| *uv += by);
        self
    }
}

/// All pieces as one.
pub fn joined(pieces: impl IntoIterator<Item = Mesh>) -> Mesh {
    let mut all = Mesh::default();
    pieces.into_iter().for_each(|piece| all.append(piece));
    all
}

/// A parallelogram facing `u x v`.
pub fn quad(corner: DVec3, u: DVec3, v: DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    mesh.push_quad(corner, u, v);
    mesh
}

/// An axis-aligned box, flat-shaded.
pub fn cuboid(min: DVec3, max: DVec3) -> Mesh {
    let size = max - min;
    let (x, y, z) = (DVec3::X * size, DVec3::Y * size, DVec3::Z * size);
    let mut mesh = Mesh::default();
    for (u, v) in [(y, x), (z, y), (x, z)] {
        mesh.push_quad(min, u, v);
        mesh.push_quad(max, -v, -u);
    }
    mesh
}

/// Latitudes and longitudes about +Y: `2 slices (stacks - 1)` triangles.
pub fn sphere(radius: f64, slices: u32, stacks: u32) -> Mesh {
    let mut normals = vec![DVec3::Y];
    for stack in 1..stacks {
        let (ring_radius, y) = (TAU / 2.0 * f64::from(stack) / f64::from(stacks)).sin_cos();
        normals.extend((0..slices).map(|slice| {
            let (sin, cos) = (TAU * f64::from(slice) / f64::from(slices)).sin_cos();
            DVec3::new(ring_radius * sin, y, ring_radius * cos)
        }));
    }
    normals.push(DVec3::NEG_Y);

    let at = |stack: u32, slice: u32| 1 + (stack - 1) * slices + slice % slices;
    let south = normals.len() as u32 - 1;
    let mut triangles = Vec::new();
    for slice in 0..slices {
        triangles.push([0, at(1, slice), at(1, slice + 1)]);
        for stack in 1..stacks - 1 {
            let [a, b] = [at(stack, slice), at(stack, slice + 1)];
            let [c, d] = [at(stack + 1, slice), at(stack + 1, slice + 1)];
            triangles.extend([[a, c, d], [a, d, b]]);
        }
        triangles.push([south, at(stacks - 1, slice + 1), at(stacks - 1, slice)]);
    }
    Mesh { positions: normals.iter().map(|n| *n * radius).collect(), normals, uvs: Vec::new(), triangles }
}

/// A closed tube: `surface(u, v)` has period 1 in both, and `d/du x d/dv` points outwards.
pub fn torus(rings: u32, sides: u32, surface: impl Fn(f64, f64) -> DVec3 + Sync) -> Mesh {
    let vertex = |index: u32| {
        let u = f64::from(index / sides) / f64::from(rings);
        let v = f64::from(index % sides) / f64::from(sides);
        const STEP: f64 = 1e-5;
        let du = surface(u + STEP, v) - surface(u - STEP, v);
        let dv = surface(u, v + STEP) - surface(u, v - STEP);
        (surface(u, v), du.cross(dv).normalize())
    };
    let (positions, normals) = (0..rings * sides).into_par_iter().map(vertex).unzip();
    let mut mesh = Mesh { positions, normals, ..Mesh::default() };
    for ring in 0..rings {
        for side in 0..sides {
            let at = |ring: u32, side: u32| ring % rings * sides + side % sides;
            let quad = [at(ring, side), at(ring + 1, side), at(ring + 1, side + 1), at(ring, side + 1)];
            mesh.push_split(quad);
        }
    }
    mesh
}

/// The surface where `field` is zero, negative inside: surface nets [Gibson 1998], then Newton steps along the
/// gradient inside each cell, so that flutes stay where the field puts them. Normals are the gradient.
pub fn surface_nets(field: impl Fn(DVec3) -> f64 + Sync, min: DVec3, max: DVec3, cell: f64) -> Mesh {
    let cells = ((max - min) / cell).ceil().as_uvec3();
    let points = cells + 1;
    let point = |i: UVec3| min + i.as_dvec3() * cell;
    let index = |i: UVec3| (i.x + points.x * (i.y + points.y * i.z)) as usize;
    let values: Vec<f64> = (0..points.element_product())
        .into_par_iter()
        .map(|i| field(point(uvec3(i % points.x, i / points.x % points.y, i / (points.x * points.y)))))
        .collect();
    let inside = |i: UVec3| values[index(i)] < 0.0;

    // One vertex in each cell that the surface crosses.
    let corners = |i: UVec3| (0..8).map(move |c| i + uvec3(c & 1, c >> 1 & 1, c >> 2));
    let crossed: Vec<UVec3> = (0..cells.z)
        .flat_map(|z| (0..cells.y).flat_map(move |y| (0..cells.x).map(move |x| uvec3(x, y, z))))
        .filter(|&i| {
            let inside_count = corners(i).filter(|&c| inside(c)).count();
            (1..8).contains(&inside_count)
        })
        .collect();
    let gradient = |p: DVec3, step: f64| {
        DVec3::AXES.map(|axis| (field(p + axis * step) - field(p - axis * step)) / (2.0 * step)).into()
    };
    let vertex = |&i: &UVec3| {
        // Distinct cells keep distinct vertices: none may reach its cell's faces.
        let (low, high) = (point(i) + cell * 0.05, point(i) + cell * 0.95);
        let mut position = mean_crossing(&corners(i).map(|c| (point(c), values[index(c)])).collect::<Vec<_>>());
        for _ in 0..4 {
            let slope: DVec3 = gradient(position, 0.1 * cell);
            position = (position - slope * (field(position) / slope.length_squared().max(1e-4))).clamp(low, high);
        }
        (position, gradient(position, 0.4 * cell).normalize())
    };
    let (positions, normals) = crossed.par_iter().map(vertex).unzip();
    let mut mesh = Mesh { positions, normals, ..Mesh::default() };

    // One quad across each crossed grid edge, between the four cells round it.
    let mut vertex_of_cell = vec![u32::MAX; values.len()];
    for (vertex, &i) in crossed.iter().enumerate() {
        vertex_of_cell[index(i)] = vertex as u32;
    }
    for &i in &crossed {
        for [along, u, v] in
            [[UVec3::X, UVec3::Y, UVec3::Z], [UVec3::Y, UVec3::Z, UVec3::X], [UVec3::Z, UVec3::X, UVec3::Y]]
        {
            let on_rim = i.dot(u) == 0 || i.dot(v) == 0;
            if on_rim || inside(i) == inside(i + along) {
                continue;
            }
            let quad = [i - u - v, i - v, i, i - u].map(|c| vertex_of_cell[index(c)]);
            let [a, b, c, d] = quad;
            mesh.push_split(if inside(i) { quad } else { [d, c, b, a] });
        }
    }
    mesh.mend_normals();
    mesh
}

/// Mean of the points where a cell's twelve edges change sign; corners in binary order.
fn mean_crossing(corners: &[(DVec3, f64)]) -> DVec3 {
    let mut sum = DVec3::ZERO;
    let mut count = 0.0;
    for a in 0..8 {
        for bit in [1, 2, 4].into_iter().filter(|bit| a & bit == 0) {
            let ((p, f), (q, g)) = (corners[a], corners[a | bit]);
            if (f < 0.0) != (g < 0.0) {
                sum += p.lerp(q, f / (f - g));
                count += 1.0;
            }
        }
    }
    sum / count
}

impl Mesh {
    /// In a sharp crease the gradient may belong to the wrong flank: there the mean of the faces is used.
    fn mend_normals(&mut self) {
        let mut means = vec![DVec3::ZERO; self.positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|i| self.positions[i as usize]);
            for &i in triangle {
                means[i as usize] += (b - a).cross(c - a);
            }
        }
        for (normal, mean) in self.normals.iter_mut().zip(means) {
            let mean = mean.normalize_or(*normal);
            if normal.dot(mean) < 0.5 {
                *normal = mean;
            }
        }
    }

    /// Two triangles, cut along the shorter diagonal.
    fn push_split(&mut self, [a, b, c, d]: [u32; 4]) {
        let distance = |i: u32, j: u32| self.positions[i as usize].distance_squared(self.positions[j as usize]);
        if distance(a, c) <= distance(b, d) {
            self.triangles.extend([[a, b, c], [a, c, d]]);
        } else {
            self.triangles.extend([[b, c, d], [b, d, a]]);
        }
    }
}
