//! Rays from a receiving point to the surfaces that send light, also through mirrors.

use glam::{DVec3, Vec3};

use crate::bake::brdf_factors::NEAR_MIRROR_ALPHA;
use crate::bake::gather_samples::{Place, is_from_behind};
use crate::physics::brdf::{self, Lobes};
use crate::scene::Material;
use crate::shared::Brdf;
use crate::trace::bvh::{Hit, TracedScene, interpolate_attributes};
use crate::trace::surface::SurfacePoint;

/// A path through mirrors ends when its throughput is below this.
const MIN_TINT: f32 = 1e-3;

/// Casts rays that continue at mirrors and near-mirrors.
pub struct Paths<'a> {
    pub scene: &'a TracedScene,
    /// Maximum number of continuations of a ray.
    layers: u32,
    /// Indexed by material.
    sides: Vec<Sides>,
}

#[derive(Clone, Copy)]
struct Sides {
    /// Whether the back reflects.
    double: bool,
    /// Whether a ray can continue at some point of the material.
    goes_on: bool,
}

/// What a ray meets.
#[derive(Clone, Copy, Debug)]
pub enum Encounter {
    Surface(Arrival),
    /// The ray leaves the scene.
    Sky(Escape),
}

/// The end of a ray that leaves the scene.
#[derive(Clone, Copy, Debug)]
pub struct Escape {
    /// Unit, towards the sky.
    pub direction: Vec3,
    /// Product of the reflectances of the mirrors before it.
    pub tint: Vec3,
    pub by_mirrors: bool,
}

/// A hit of a ray.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    pub place: Place,
    /// Unit, from the surface back along the ray.
    pub wo: Vec3,
    /// Product of the reflectances of the mirrors before it.
    pub tint: Vec3,
    /// Length of the path.
    pub distance: f32,
}

impl<'a> Paths<'a> {
    pub fn new(scene: &'a TracedScene, layers: u32) -> Self {
        let sides = |m: &Material| Sides {
            double: m.double_sided,
            goes_on: m.least_roughness(&scene.textures).powi(2) < NEAR_MIRROR_ALPHA,
        };
        Self { scene, layers, sides: scene.materials.iter().map(sides).collect() }
    }

    /// Whether rays can continue at some point of a material.
    pub fn is_mirror(&self, material: u32) -> bool {
        self.layers > 0 && self.sides[material as usize].goes_on
    }

    /// Follows the ray from a surface point into a unit direction. `random` returns three numbers for each surface
    /// where the ray continues; `meet` is called at each hit, except on backs of single-sided faces, and where the ray
    /// leaves the scene.
    pub fn follow(
        &self,
        position: Vec3,
        geometric_normal: Vec3,
        direction: Vec3,
        random: impl Fn(u32) -> [f64; 3],
        meet: impl FnMut(Encounter),
    ) {
        self.go_on(self.first_hit(position, geometric_normal, direction), direction, random, meet);
    }

    /// The first hit of the ray from a surface point into a unit direction, and whether it is on the back.
    pub fn first_hit(&self, position: Vec3, geometric_normal: Vec3, direction: Vec3) -> Option<(Hit, bool)> {
        self.closest_hit(self.off(position, geometric_normal, direction, 0.0), direction)
    }

    /// [`Self::follow`] for a ray whose first hit is known, and whether that is on the back.
    #[inline(always)]
    pub fn go_on(
        &self,
        mut next: Option<(Hit, bool)>,
        mut direction: Vec3,
        random: impl Fn(u32) -> [f64; 3],
        mut meet: impl FnMut(Encounter),
    ) {
        let mut tint = Vec3::ONE;
        let mut distance = 0.0;
        for layer in 0..=self.layers {
            let Some((hit, back)) = next else {
                return meet(Encounter::Sky(Escape { direction, tint, by_mirrors: layer > 0 }));
            };
            let place = Place { triangle: hit.triangle, barycentric: hit.barycentric, back };
            let sides = self.sides[self.scene.mesh.triangle_materials[hit.triangle as usize] as usize];
            if back && !sides.double {
                return;
            }
            distance += hit.distance;
            meet(Encounter::Surface(Arrival { place, wo: -direction, tint, distance }));
            if !sides.goes_on || layer == self.layers || !self.is_narrow(&hit) {
                return;
            }
            let surface = SurfacePoint::new(self.scene, &hit, direction, 0.0).facing(-direction);
            let Some((mirrored, share)) = bounce(&surface, -direction, random(layer)) else { return };
            tint *= share;
            if tint.max_element() < MIN_TINT {
                return;
            }
            direction = mirrored;
            let origin = self.off(surface.position, surface.geometric_normal, direction, hit.distance);
            next = self.closest_hit(origin, direction);
        }
    }

    /// Whether the lobe at a hit is so narrow that rays continue.
    fn is_narrow(&self, hit: &Hit) -> bool {
        let material = self.scene.mesh.triangle_materials[hit.triangle as usize];
        let (uvs, _) = interpolate_attributes(self.scene, hit.triangle, hit.barycentric);
        self.scene.materials[material as usize].roughness_at(&self.scene.textures, uvs).powi(2) < NEAR_MIRROR_ALPHA
    }

    fn closest_hit(&self, origin: Vec3, direction: Vec3) -> Option<(Hit, bool)> {
        let hit = self.scene.closest_hit(origin, direction, f32::INFINITY)?;
        Some((hit, is_from_behind(self.scene, hit.triangle, direction)))
    }

    /// Origin of a ray: offset from the surface to the side of its direction.
    pub fn off(&self, position: Vec3, geometric_normal: Vec3, direction: Vec3, distance: f32) -> Vec3 {
        let side = 1f32.copysign(geometric_normal.dot(direction));
        position + geometric_normal * (side * self.scene.bvh.shadow_offset(distance))
    }
}

/// Samples the direction in which a ray continues at a mirror or near-mirror, and its weight.
fn bounce(surface: &SurfacePoint, wo: Vec3, random: [f64; 3]) -> Option<(Vec3, Vec3)> {
    let cosine = surface.normal.dot(wo);
    if cosine <= 0.0 || surface.brdf.alpha >= NEAR_MIRROR_ALPHA {
        return None;
    }
    if !surface.brdf.has_lobe() {
        return Some((surface.mirrored(wo), brdf::mirror(&surface.brdf, cosine.into()).as_vec3()));
    }
    let lobe = Brdf { diffuse: Vec3::ZERO, ..surface.brdf };
    let normal = surface.normal.as_dvec3().normalize();
    let lobes = Lobes::new(&lobe, normal, wo.as_dvec3().normalize())?;
    let wi: DVec3 = lobes.sample(random)?;
    let at = lobes.at(wi);
    Some((wi.as_vec3(), (at.specular / at.density).as_vec3()))
}
