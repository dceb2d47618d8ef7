//! What sends light: lights of a rig and emitters, as points on them; and the photons that leave these points.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};

use crate::bake::gather_samples::Place;
use crate::bake::gather_samples::light_rays::versine;
use crate::physics::brdf::basis;
use crate::physics::light::{color, incident};
use crate::scene::light_filter::PosedFilter;
use crate::scene::{Emitters, Light, LightKind, ResolvedLinks, Rig};
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_FACET, LIGHT_TWO_SIDED_FACET, PackedLight};
use crate::trace::bvh::{Hit, TracedScene, passes_by_chance};
use crate::trace::emitting_triangles::EmittingTriangles;
use crate::trace::light_surface::{ArrivingLight, LightInScene, LightSurface};
use crate::trace::linked::LinkedScene;
use crate::trace::surface::SurfacePoint;

/// One light of a rig that is not off.
pub struct Source {
    /// Index into the rig's lights.
    pub light: usize,
    /// Greatest channel of colour times intensity: how much this light matters.
    pub scale: f64,
    /// What surfaces get is computed at unit strength.
    settings: Light,
    links: Option<ResolvedLinks>,
    filter: Option<PosedFilter>,
    /// Of an area light.
    surface: Option<LightSurface>,
    /// Of an emitter.
    triangles: Option<EmittingTriangles>,
}

/// A point of a source that stands for all of it.
#[derive(Clone, Copy)]
pub struct SourcePoint {
    /// White.
    pub packed: PackedLight,
    /// What its light is multiplied by.
    color: DVec3,
    /// Of emitters.
    pub emitting: Option<EmittingPoint>,
}

/// A point of an emitter.
#[derive(Clone, Copy)]
pub struct EmittingPoint {
    pub surface: SurfacePoint,
    /// Density with which this side of the surface is drawn, 1 / area in mesh space.
    pub density: f64,
}

impl EmittingPoint {
    /// Solid angle that each drawn point stands for, as seen from a place; 0 from behind.
    fn solid_angle(&self, place: Vec3) -> f64 {
        let between = place.as_dvec3() - self.surface.position.as_dvec3();
        let distance2 = between.length_squared();
        let cosine = self.surface.geometric_normal.as_dvec3().dot(between) / distance2.sqrt();
        cosine.max(0.0) / (distance2 * self.density)
    }
}

/// Light that reaches a surface without shadows.
#[derive(Clone, Copy)]
pub struct Arriving {
    /// Unit, towards the source.
    pub wi: DVec3,
    /// RGB, on a plane that faces the source, from a source of unit strength.
    pub irradiance: DVec3,
}

/// A ray on which light leaves a point of a source.
pub struct Emission {
    pub origin: Vec3,
    /// Unit.
    pub direction: Vec3,
}

impl Source {
    /// The `wanted` lights of a complete rig whose strength is not zero, by index. Panics if links name what the scene
    /// lacks: see [`Rig::resolve_links`].
    pub fn of(scene: &TracedScene, rig: &Rig, wanted: impl Fn(usize) -> bool) -> Vec<Self> {
        let rig = &*rig.with_solo_applied();
        let mut links = rig.resolve_links(scene).unwrap_or_else(|reason| panic!("{reason}"));
        let emitters = Emitters::of(scene);
        let source = |i: usize| {
            let settings = rig.lights[i].clone();
            let triangles = (settings.kind == LightKind::Emitter).then(|| {
                let is_meant = |material: u32| {
                    let emitter = emitters.index(material).map(|emitter| &emitters.names[emitter as usize]);
                    emitter.is_some() && emitter == settings.material.as_ref()
                };
                let radiance = |material: u32| scene.materials[material as usize].emissive.max_element();
                EmittingTriangles::new(scene, |m| if is_meant(m) { radiance(m).into() } else { 0.0 })
            });
            Self {
                light: i,
                scale: rig.scale(i).max_element().into(),
                filter: PosedFilter::new(&settings),
                surface: LightSurface::new(&settings, scene.space, None),
                // All that emitters shine on gets their light.
                links: if triangles.is_some() { None } else { links.remove(&i) },
                triangles,
                settings,
            }
        };
        let is_on = |i: &usize| rig.scale(*i) != Vec3::ZERO && wanted(*i);
        let shines = |source: &Self| source.triangles.as_ref().is_none_or(|triangles| !triangles.is_empty());
        (0..rig.lights.len()).filter(is_on).map(source).filter(shines).collect()
    }

    /// The scene with the links of the light.
    pub fn linked<'a>(&'a self, scene: &'a TracedScene) -> LinkedScene<'a> {
        scene.linked(self.links.as_ref())
    }

    pub fn casts_shadows(&self) -> bool {
        self.settings.shadows || self.triangles.is_some()
    }

    /// Whether all of it is one point or one direction.
    pub fn is_punctual(&self) -> bool {
        self.settings.is_punctual() && self.triangles.is_none()
    }

    /// Whether photons, not rays, find it in mirrors: rays would do so seldom or never.
    pub fn is_small(&self, scene: &TracedScene) -> bool {
        let extent = match self.settings.kind {
            LightKind::Dome | LightKind::Emitter => return false,
            LightKind::Directional => 1.0,
            _ => f64::from(scene.bvh.radius) * scene.space.unit,
        };
        self.settings.projected_area().unwrap_or(0.0) <= PI * (SMALL * extent).powi(2)
    }

    /// Whether this emitter is what a material emits.
    pub fn emits(&self, material: u32) -> bool {
        self.triangles.as_ref().is_some_and(|triangles| triangles.area_density(material) > 0.0)
    }

    /// Draws a point; the mean over `u` in the unit cube is the light.
    pub fn point(&self, scene: &TracedScene, [u, v, w, side]: [f64; 4]) -> SourcePoint {
        let Some(triangles) = &self.triangles else {
            let packed = self.settings.pack_point(scene.space, [u, v], None);
            return SourcePoint { color: color(&packed), packed, emitting: None };
        };
        let (triangle, barycentric) = triangles.place([u, v, w]).expect("a source has triangles");
        let material = scene.mesh.triangle_materials[triangle as usize];
        let is_double = scene.materials[material as usize].double_sided;
        let place = Place { triangle, barycentric, back: is_double && side < 0.5 };
        let surface = SurfacePoint { coverage: place.coverage(scene), ..place.surface(scene, 0.0) };
        // Of two triangles in one place one shines.
        let (position, normal, offset) = (surface.position, surface.geometric_normal, scene.bvh.shadow_offset(0.0));
        let top = scene.closest_hit(position + 2.0 * offset * normal, -normal, 4.0 * offset);
        let is_top = top.is_none_or(|top| top.triangle == triangle);
        let density = self.point_density(scene, material);
        let radiance = if is_top { (surface.coverage * surface.emission).as_dvec3() } else { DVec3::ZERO };
        let packed = PackedLight {
            // Off the surface, which would stop its own light.
            position: position + normal * offset,
            kind: LIGHT_FACET,
            direction: surface.geometric_normal,
            strength: 1.0,
            ..bytemuck::Zeroable::zeroed()
        };
        let emitting = is_top.then_some(EmittingPoint { surface, density });
        SourcePoint { packed, color: radiance / density, emitting }
    }

    /// Density with which points of an emitter are drawn on a side of a material, 1 / area in mesh space.
    pub fn point_density(&self, scene: &TracedScene, material: u32) -> f64 {
        let sides = if scene.materials[material as usize].double_sided { 2.0 } else { 1.0 };
        self.triangles.as_ref().map_or(0.0, |triangles| triangles.area_density(material) / sides)
    }

    /// Light that would reach a surface point if nothing was between; `None` if it faces away or gets none.
    pub fn arriving(&self, scene: &TracedScene, point: &SourcePoint, at: &SurfacePoint) -> Option<Arriving> {
        let arriving = incident(&point.packed, at.position.as_dvec3())?;
        if arriving.irradiance <= 0.0 || at.normal.as_dvec3().dot(arriving.wi) <= 0.0 {
            return None;
        }
        let filtered = self.filter.as_ref().map_or(Vec3::ONE, |filter| filter.factor(-arriving.wi.as_vec3()));
        let factor = self.linked(scene).factor(at.triangle) * filtered;
        let irradiance = arriving.irradiance * point.color * factor.as_dvec3();
        (irradiance != DVec3::ZERO).then_some(Arriving { wi: arriving.wi, irradiance })
    }

    /// Solid angle that each drawn point stands for, as seen from a place in direction `wi`; 0 if rays do not find it.
    pub fn solid_angle(&self, point: &SourcePoint, place: Vec3, wi: DVec3) -> f64 {
        match (&point.emitting, &self.surface) {
            (Some(emitting), _) => emitting.solid_angle(place),
            (None, Some(surface)) => {
                let distance = point.packed.position.as_dvec3().distance(place.as_dvec3());
                surface.density(&point.packed, wi, distance).recip().min(MAX_SOLID_ANGLE)
            }
            (None, None) => 0.0,
        }
    }

    /// Light of an area light along a ray from the surface of a triangle, of which the next one is at `end`.
    pub fn seen(&self, scene: &TracedScene, triangle: u32, ray: [Vec3; 2], end: f32) -> Option<ArrivingLight> {
        let surface = self.surface.as_ref()?;
        let scene = self.linked(scene);
        let light = LightInScene { light: &self.settings, surface, filter: self.filter.as_ref(), scene };
        light.arriving(triangle, ray, Some(end))
    }

    /// The surfaces that the light on a ray meets: up to the first that stops it.
    pub fn lands(&self, scene: &TracedScene, emission: &Emission, mut land: impl FnMut(Hit)) {
        let Emission { origin, direction } = *emission;
        if self.casts_shadows() {
            return self.linked(scene).surfaces_met(origin, direction).take(MAX_LANDINGS).for_each(land);
        }
        let mut beyond = 0.0;
        for _ in 0..MAX_LANDINGS {
            let Some(hit) = scene.closest_hit_unless(origin, direction, |hit| {
                hit.distance <= beyond || passes_by_chance(scene, hit.triangle, hit.barycentric, [origin, direction])
            }) else {
                return;
            };
            beyond = hit.distance;
            land(hit);
        }
    }
}

/// Finite where a point is never drawn.
pub const MAX_SOLID_ANGLE: f64 = 1e30;
/// Radius of small lights, relative to the scene's; of suns half the angle, in radians.
const SMALL: f64 = 0.05;
/// Surfaces that light of one ray reaches, if none casts shadows.
const MAX_LANDINGS: usize = 16;

impl SourcePoint {
    /// Draws a ray on which light leaves, for `u` in the unit cube.
    pub fn emit(&self, scene: &TracedScene, [u, v, w]: [f64; 3]) -> Emission {
        let axis = self.packed.direction.as_dvec3().normalize_or(DVec3::NEG_Y);
        let (sin, cos) = (TAU * v).sin_cos();
        if self.packed.kind == LIGHT_DIRECTIONAL {
            // Through a disk that hides the scene.
            let radius = f64::from(scene.bvh.radius);
            let (s, t) = axis.any_orthonormal_pair();
            let across = (s * cos + t * sin) * (radius * u.sqrt());
            return Emission { origin: (across - 2.0 * radius * axis).as_vec3(), direction: axis.as_vec3() };
        }
        let versine = u * f64::from(versine(&self.packed));
        let sine = (versine * (2.0 - versine)).sqrt();
        let side = if self.packed.kind == LIGHT_TWO_SIDED_FACET && w < 0.5 { -1.0 } else { 1.0 };
        let direction = basis(side * axis) * DVec3::new(sine * cos, sine * sin, 1.0 - versine);
        let direction = direction.normalize().as_vec3();
        Emission { origin: self.packed.position, direction }
    }

    /// A ray on which light leaves towards a place, in mesh space; `None` if the point lies there.
    pub fn emit_towards(&self, scene: &TracedScene, place: Vec3) -> Option<Emission> {
        if self.packed.kind == LIGHT_DIRECTIONAL {
            let direction = self.packed.direction;
            return Some(Emission { origin: place - 4.0 * scene.bvh.radius * direction, direction });
        }
        let direction = (place - self.packed.position).try_normalize()?;
        Some(Emission { origin: self.packed.position, direction })
    }

    /// Density of [`Self::emit`]'s rays through an area that faces the point at a distance; 1 / area in mesh space.
    pub fn ray_density(&self, scene: &TracedScene, distance: f64) -> f64 {
        if self.packed.kind == LIGHT_DIRECTIONAL {
            return f64::from(scene.bvh.radius).powi(-2) / PI;
        }
        let sides = if self.packed.kind == LIGHT_TWO_SIDED_FACET { 2.0 } else { 1.0 };
        (sides * TAU * f64::from(versine(&self.packed)) * distance * distance).recip()
    }
}
