//! Where light that reaches a point comes from: rays, and what they meet on their way through mirrors.

use glam::{DVec3, Vec3};

use crate::bake::brdf_factors::NEAR_MIRROR_ALPHA;
use crate::bake::bvh::Bvh;
use crate::bake::gather_samples::{Place, is_from_behind};
use crate::bake::surface::SurfacePoint;
use crate::brdf::{self, Lobes};
use crate::scene::Scene;
use crate::shared::Brdf;

/// A path through mirrors is not followed below this share of its light.
const MIN_TINT: f32 = 1e-3;

/// Casts rays that go on through mirrors and near-mirrors.
pub struct Paths<'a> {
    scene: &'a Scene,
    bvh: &'a Bvh,
    /// Surfaces that a ray goes on to at most, the first not counted.
    layers: u32,
    /// By material: whether a ray may have to go on.
    goes_on: Vec<bool>,
}

/// A surface that a ray meets.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    pub place: Place,
    /// Unit, from the surface back along the ray.
    pub wo: Vec3,
    /// What the mirrors on the way leave of its light.
    pub tint: Vec3,
}

impl<'a> Paths<'a> {
    pub fn new(scene: &'a Scene, bvh: &'a Bvh, layers: u32) -> Self {
        let goes_on = |m: &crate::scene::Material| {
            m.metallic_roughness_texture.is_some() || m.roughness * m.roughness < NEAR_MIRROR_ALPHA
        };
        Self { scene, bvh, layers, goes_on: scene.materials.iter().map(goes_on).collect() }
    }

    /// Follows the ray from a surface point into a unit direction. `random` gives three numbers for each surface that
    /// it goes on from; `arrive` is called at each surface that it meets from its front.
    pub fn follow(
        &self,
        position: Vec3,
        geometric_normal: Vec3,
        direction: Vec3,
        random: impl Fn(u32) -> [f64; 3],
        mut arrive: impl FnMut(&Arrival),
    ) {
        let mut direction = direction;
        let mut origin = self.off(position, geometric_normal, direction, 0.0);
        let mut tint = Vec3::ONE;
        for layer in 0..=self.layers {
            let Some(hit) = self.bvh.closest_hit(self.scene, origin, direction, f32::INFINITY) else { return };
            let back = is_from_behind(self.scene, hit.triangle, direction);
            let place = Place { triangle: hit.triangle, barycentric: hit.barycentric, back };
            let material = self.scene.mesh.triangle_materials[hit.triangle as usize] as usize;
            if back && !self.scene.materials[material].double_sided {
                return;
            }
            arrive(&Arrival { place, wo: -direction, tint });
            if !self.goes_on[material] || layer == self.layers {
                return;
            }
            let surface = SurfacePoint::new(self.scene, &hit, direction, 0.0);
            let Some((next, share)) = bounce(&surface, -direction, random(layer)) else { return };
            tint *= share;
            if tint.max_element() < MIN_TINT {
                return;
            }
            direction = next;
            origin = self.off(surface.position, surface.geometric_normal, direction, hit.distance);
        }
    }

    /// Where a ray starts: off the surface, on the side that it leaves to.
    fn off(&self, position: Vec3, geometric_normal: Vec3, direction: Vec3, distance: f32) -> Vec3 {
        let side = 1f32.copysign(geometric_normal.dot(direction));
        position + geometric_normal * (side * self.bvh.shadow_offset(distance))
    }
}

/// The direction in which a mirror or near-mirror shows what lies behind it, and what it leaves of that light.
fn bounce(surface: &SurfacePoint, wo: Vec3, random: [f64; 3]) -> Option<(Vec3, Vec3)> {
    let cosine = surface.normal.dot(wo);
    if cosine <= 0.0 || surface.brdf.alpha >= NEAR_MIRROR_ALPHA {
        return None;
    }
    if !surface.brdf.has_lobe() {
        let direction = (2.0 * cosine * surface.normal - wo).normalize();
        return Some((direction, brdf::mirror(&surface.brdf, cosine.into()).as_vec3()));
    }
    let lobe = Brdf { diffuse: Vec3::ZERO, ..surface.brdf };
    let normal = surface.normal.as_dvec3().normalize();
    let lobes = Lobes::new(&lobe, normal, wo.as_dvec3().normalize())?;
    let wi: DVec3 = lobes.sample(random)?;
    let at = lobes.at(wi);
    Some((wi.as_vec3(), (at.specular / at.density).as_vec3()))
}
