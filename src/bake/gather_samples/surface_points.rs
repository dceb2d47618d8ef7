//! Points spread evenly over the surfaces of a scene, as many as their areas ask for.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::bake::bvh::{Bvh, Hit, is_hole};
use crate::bake::surface::SurfacePoint;
use crate::brdf::cosine_direction;
use crate::scene::{AlphaMode, Scene};
use crate::sequence::Points;

/// A place on one side of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Weights of the second and third corner.
    pub barycentric: Vec2,
    /// The side that its corners run clockwise around: only of double-sided materials.
    pub back: bool,
}

/// The sides of triangles that reflect light, with the sum of their areas up to each.
pub struct Sides {
    sides: Vec<(u32, bool)>,
    cumulative: Vec<f64>,
}

impl Sides {
    /// Sides lie in the order of the BVH's leaves: neighbours are near each other.
    pub fn new(scene: &Scene, bvh: &Bvh) -> Self {
        let mut total = 0.0;
        let (mut sides, mut cumulative) = (Vec::new(), Vec::new());
        for triangle in bvh.triangle_order() {
            let [a, b, c] =
                scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize].as_dvec3());
            let area = 0.5 * (b - a).cross(c - a).length();
            let material = &scene.materials[scene.mesh.triangle_materials[triangle as usize] as usize];
            for back in [false, true] {
                if !back || material.double_sided {
                    total += area;
                    sides.push((triangle, back));
                    cumulative.push(total);
                }
            }
        }
        Self { sides, cumulative }
    }

    /// Square metres, double-sided triangles counted twice.
    pub fn area(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }

    /// The place at a share of the whole area, and at a point of the unit square over the triangle that is there.
    fn place(&self, share: f64, [u, v]: [f64; 2]) -> Place {
        let at = share * self.area();
        let side = self.cumulative.partition_point(|&sum| sum <= at).min(self.sides.len() - 1);
        let (triangle, back) = self.sides[side];
        // Folding the square along its diagonal keeps neighbours together.
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        Place { triangle, barycentric: Vec2::new(u as f32, v as f32), back }
    }

    /// `count` random points, each on its own [Yang 2007, Section 4.1].
    pub fn random(&self, points: Points, count: usize) -> Vec<Place> {
        let place = |i: usize| {
            let [share, u, v, _] = points.at(0, i as u32);
            self.place(share, [u, v])
        };
        if self.area() > 0.0 { (0..count).into_par_iter().map(place).collect() } else { Vec::new() }
    }

    /// `count` points, one in each of as many equal shares of the area.
    pub fn stratified(&self, points: Points, count: usize) -> Vec<Place> {
        let place = |i: usize| {
            let [jitter, u, v, _] = points.at(i as u32, 0);
            self.place((i as f64 + jitter) / count as f64, [u, v])
        };
        if self.area() > 0.0 { (0..count).into_par_iter().map(place).collect() } else { Vec::new() }
    }
}

impl Place {
    /// What the scene is there; a texel is averaged over `footprint` metres.
    pub fn surface(&self, scene: &Scene, footprint: f32) -> SurfacePoint {
        let [a, b, c] = scene.mesh.triangles[self.triangle as usize].map(|v| scene.mesh.positions[v as usize]);
        let normal = (b - a).cross(c - a);
        let seen_along = if self.back { normal } else { -normal };
        let hit = Hit { triangle: self.triangle, barycentric: self.barycentric, distance: 0.0 };
        SurfacePoint::new(scene, &hit, seen_along, footprint)
    }

    /// Whether the surface has a hole there.
    pub fn is_hole(&self, scene: &Scene) -> bool {
        let material = scene.mesh.triangle_materials[self.triangle as usize];
        scene.materials[material as usize].alpha_mode != AlphaMode::Opaque
            && is_hole(scene, self.triangle, self.barycentric)
    }
}

/// Whether most of what a point sees are the backs of single-sided faces: it lies within a solid, where no light is.
///
/// Four rays mostly tell; where any of them meets a back, twelve more do.
pub fn is_enclosed(scene: &Scene, bvh: &Bvh, point: &SurfacePoint, points: Points) -> bool {
    let origin = point.position + point.geometric_normal * bvh.shadow_offset(0.0);
    let (s, t) = point.geometric_normal.any_orthonormal_pair();
    let backs = |rays: std::ops::Range<u32>| {
        let meets_back = |&i: &u32| {
            let [u, v, ..] = points.at(i, 0);
            let d = cosine_direction(u, v).as_vec3();
            let direction = s * d.x + t * d.y + point.geometric_normal * d.z;
            bvh.closest_hit(scene, origin, direction, f32::INFINITY).is_some_and(|hit| is_back(scene, &hit, direction))
        };
        rays.filter(meets_back).count()
    };
    match backs(0..4) {
        0 => false,
        some => some + backs(4..16) > 8,
    }
}

/// Whether a ray met the back of a single-sided face: black, and nothing reflects there.
pub fn is_back(scene: &Scene, hit: &Hit, direction: Vec3) -> bool {
    let material = scene.mesh.triangle_materials[hit.triangle as usize];
    !scene.materials[material as usize].double_sided && is_from_behind(scene, hit.triangle, direction)
}

/// Whether a direction runs along a triangle's geometric normal rather than against it.
pub fn is_from_behind(scene: &Scene, triangle: u32, direction: Vec3) -> bool {
    let [a, b, c] = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize]);
    (b - a).cross(c - a).dot(direction) > 0.0
}
