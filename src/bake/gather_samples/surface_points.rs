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

/// A side of a triangle, or a part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Patch {
    /// Twice the triangle, and 1 for its back.
    pub side: u32,
    /// 1: all of it. The four quarters of part p, cut between the middles of its edges, are 4p to 4p + 3; the last lies in
    /// the middle.
    pub part: u32,
}

impl Patch {
    /// How often a side can be cut.
    pub const DEEPEST: u32 = 14;

    /// The part of a side, `depth` cuts deep, in which a point lies.
    pub fn around(side: u32, barycentric: Vec2, depth: u32) -> Self {
        let (mut at, mut part) = (barycentric, 1);
        for _ in 0..depth {
            at *= 2.0;
            let quarter = match at {
                Vec2 { x, .. } if x >= 1.0 => 1,
                Vec2 { y, .. } if y >= 1.0 => 2,
                Vec2 { x, y } if x + y < 1.0 => 0,
                _ => 3,
            };
            at = match quarter {
                0 => at,
                1 => at - Vec2::X,
                2 => at - Vec2::Y,
                _ => 1.0 - at,
            };
            part = 4 * part + quarter;
        }
        Self { side, part }
    }

    /// A point of the patch, from barycentric coordinates within it.
    pub fn place(&self, barycentric: Vec2) -> Place {
        let (mut at, mut part) = (barycentric, self.part);
        while part > 1 {
            at = 0.5
                * match part % 4 {
                    0 => at,
                    1 => at + Vec2::X,
                    2 => at + Vec2::Y,
                    _ => 1.0 - at,
                };
            part /= 4;
        }
        Place { triangle: self.side / 2, barycentric: at, back: self.side % 2 == 1 }
    }
}

/// The sides of triangles that reflect light, in the order of the BVH's leaves: neighbours are near each other. Each comes
/// with its area in mesh space; double-sided triangles have two.
pub fn sides(scene: &Scene, bvh: &Bvh) -> Vec<(u32, f64)> {
    let of_triangle = |triangle: u32| {
        let [a, b, c] = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize].as_dvec3());
        let area = 0.5 * (b - a).cross(c - a).length();
        let material = &scene.materials[scene.mesh.triangle_materials[triangle as usize] as usize];
        (0..1 + u32::from(material.double_sided)).map(move |back| (2 * triangle + back, area))
    };
    bvh.triangle_order().flat_map(of_triangle).collect()
}

/// Surfaces that points are spread over, and how densely.
pub struct Surfaces {
    /// Patches with their areas, in mesh space.
    patches: Vec<(Patch, f64)>,
    /// Areas times densities up to and with each patch.
    cumulative: Vec<f64>,
}

impl Surfaces {
    /// Of patches with their areas and how densely they get points, relative to each other. Those of density 0
    /// are left out.
    pub fn new(patches: impl Iterator<Item = (Patch, f64, f32)>) -> Self {
        let mut surfaces = Self { patches: Vec::new(), cumulative: Vec::new() };
        let mut total = 0.0;
        for (patch, area, density) in patches.filter(|&(_, area, density)| area > 0.0 && density > 0.0) {
            total += area * f64::from(density);
            surfaces.patches.push((patch, area));
            surfaces.cumulative.push(total);
        }
        surfaces
    }

    /// All of a scene's, alike.
    pub fn even(scene: &Scene, bvh: &Bvh) -> Self {
        Self::new(sides(scene, bvh).into_iter().map(|(side, area)| (Patch { side, part: 1 }, area, 1.0)))
    }

    /// Mesh space, double-sided triangles counted twice.
    pub fn area(&self) -> f64 {
        self.patches.iter().map(|(_, area)| area).sum()
    }

    /// Index of the patch at a share of all points.
    fn at(&self, share: f64) -> usize {
        let at = share * self.cumulative[self.cumulative.len() - 1];
        self.cumulative.partition_point(|&sum| sum <= at).min(self.patches.len() - 1)
    }

    /// The place at a point of the unit square over a patch.
    fn place(&self, patch: usize, [u, v]: [f64; 2]) -> Place {
        // Folding the square along its diagonal keeps neighbours together.
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        self.patches[patch].0.place(Vec2::new(u as f32, v as f32))
    }

    /// `count` random points, each on its own, if there is any surface: where it is even [Yang 2007, Section 4.1].
    pub fn random(&self, points: Points, count: usize) -> Vec<Place> {
        let place = |i: usize| {
            let [share, u, v, _] = points.at(0, i as u32);
            self.place(self.at(share), [u, v])
        };
        if self.patches.is_empty() { Vec::new() } else { (0..count).into_par_iter().map(place).collect() }
    }

    /// `count` points, one in each of as many equal shares of all, if there is any surface; each with the area that
    /// it stands for: those of a patch are shared out evenly, those of one without points go to the next.
    pub fn stratified(&self, points: Points, count: usize) -> Vec<(Place, f64)> {
        if self.patches.is_empty() {
            return Vec::new();
        }
        let place = |i: usize| {
            let [jitter, u, v, _] = points.at(i as u32, 0);
            let patch = self.at((i as f64 + jitter) / count as f64);
            (patch, self.place(patch, [u, v]))
        };
        let places: Vec<(usize, Place)> = (0..count).into_par_iter().map(place).collect();
        let mut first = 0;
        let mut areas = Vec::with_capacity(count);
        for of_patch in places.chunk_by(|a, b| a.0 == b.0) {
            let last_of_all = areas.len() + of_patch.len() == count;
            let end = if last_of_all { self.patches.len() } else { of_patch[0].0 + 1 };
            let area: f64 = self.patches[first..end].iter().map(|(_, area)| area).sum();
            areas.extend(std::iter::repeat_n(area / of_patch.len() as f64, of_patch.len()));
            first = end;
        }
        places.into_iter().map(|(_, place)| place).zip(areas).collect()
    }
}

impl Place {
    /// What the scene is there; a texel is averaged over `footprint` of mesh space.
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
