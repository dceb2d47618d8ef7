//! Points on triangles that emit light, for rays towards them.

use glam::{DVec3, Vec2, Vec3};

use super::bvh::{Hit, TracedScene};
use super::surface::SurfacePoint;
use crate::scene::Scene;

/// Triangles of emissive materials, drawn with probability proportional to area times radiance.
pub struct EmittingTriangles {
    /// Triangles, with the cumulative sum of area times radiance.
    running: Vec<(u32, f64)>,
    /// By material: density of drawn points per area in mesh space.
    density: Vec<f64>,
}

/// A surface point that receives light; mesh space.
#[derive(Clone, Copy)]
pub struct Receiver {
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit.
    pub geometric_normal: Vec3,
}

/// A drawn point, as seen from a receiver.
pub struct DrawnEmitter {
    /// Unit, towards the emitter.
    pub wi: DVec3,
    pub material: u32,
    /// Radiance by the material.
    pub emission: DVec3,
    /// Density with which it is drawn, 1/sr.
    pub density: f64,
}

impl From<&SurfacePoint> for Receiver {
    fn from(point: &SurfacePoint) -> Self {
        let SurfacePoint { position, normal, geometric_normal, .. } = *point;
        Self { position, normal, geometric_normal }
    }
}

impl Receiver {
    /// The unit direction to a point of a triangle, and the hit there; `None` if the receiver does not see it.
    pub fn sees(&self, scene: &TracedScene, triangle: u32, barycentric: Vec2) -> Option<(Vec3, Hit)> {
        let [a, b, c] = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize]);
        let target = a + (b - a) * barycentric.x + (c - a) * barycentric.y;
        let direction = (target - self.position).try_normalize()?;
        if self.normal.dot(direction) <= 0.0 {
            return None;
        }
        let offset = scene.bvh.shadow_offset(self.position.distance(target));
        let side = offset.copysign(self.geometric_normal.dot(direction));
        let origin = self.position + self.geometric_normal * side;
        let hit = scene.closest_hit(origin, direction, f32::INFINITY).filter(|hit| hit.triangle == triangle)?;
        Some((direction, hit))
    }
}

impl EmittingTriangles {
    /// `radiance` of a material, in any unit; 0 leaves it out.
    pub fn new(scene: &Scene, radiance: impl Fn(u32) -> f64) -> Self {
        let mesh = &scene.mesh;
        let mut running = Vec::new();
        let mut total = 0.0;
        for (i, corners) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|v| mesh.positions[v as usize]);
            let power = radiance(mesh.triangle_materials[i]) * f64::from((b - a).cross(c - a).length());
            if power > 0.0 {
                total += power;
                running.push((i as u32, total));
            }
        }
        // Power here is twice the area times radiance; divided by area it is twice the radiance.
        let density = |material| if total > 0.0 { 2.0 * radiance(material) / total } else { 0.0 };
        Self { running, density: (0..scene.materials.len() as u32).map(density).collect() }
    }

    pub fn is_empty(&self) -> bool {
        self.running.is_empty()
    }

    /// Draws a point: a triangle, and the weights of its second and third vertex. `None` if there are no triangles.
    /// `u`: uniform in 0..1.
    pub fn place(&self, u: [f64; 3]) -> Option<(u32, Vec2)> {
        let (_, total) = self.running.last()?;
        let at = self.running.partition_point(|&(_, sum)| sum <= u[0] * total).min(self.running.len() - 1);
        // Uniform over the triangle.
        let root = u[1].sqrt();
        let barycentric = Vec2::new((root * (1.0 - u[2])) as f32, (root * u[2]) as f32);
        Some((self.running[at].0, barycentric))
    }

    /// Density of [`Self::place`] on a material, 1 / area in mesh space.
    pub fn area_density(&self, material: u32) -> f64 {
        self.density[material as usize]
    }

    /// Draws a point; `None` if the receiver does not see it. `u`: uniform in 0..1.
    pub fn draw(&self, scene: &TracedScene, receiver: &Receiver, u: [f64; 3]) -> Option<DrawnEmitter> {
        let (triangle, barycentric) = self.place(u)?;
        let (direction, hit) = receiver.sees(scene, triangle, barycentric)?;
        let seen = SurfacePoint::new(scene, &hit, direction, 0.0);
        let density = self.density(&seen, direction, hit.distance);
        (density > 0.0).then(|| DrawnEmitter {
            wi: direction.as_dvec3(),
            material: seen.material,
            emission: seen.emission.as_dvec3(),
            density,
        })
    }

    /// Density per solid angle with which [`Self::draw`] finds the point that a ray in unit `direction` hit; 0 if it
    /// cannot.
    pub fn density(&self, seen: &SurfacePoint, direction: Vec3, distance: f32) -> f64 {
        let cosine = f64::from(seen.geometric_normal.dot(direction).abs());
        self.density[seen.material as usize] * f64::from(distance).powi(2) / cosine.max(f64::MIN_POSITIVE)
    }
}
