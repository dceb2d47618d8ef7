//! Next-event estimation: all lights of a rig or one chosen at random, and emitting triangles.

use glam::{DVec3, Vec3};

use super::film::{EMISSION, Sample};
use crate::bake::framebuffer::view_samples::PathSegment;
use crate::physics::brdf::reflected;
use crate::physics::light::{Incident, color, incident};
use crate::scene::light_filter::PosedFilter;
use crate::scene::{Emitters, Light, LightKind, ResolvedLinks, Rig, Scene};
use crate::shared::PackedLight;
use crate::trace::bvh::TracedScene;
use crate::trace::emitting_triangles::EmittingTriangles;
use crate::trace::light_surface::{LightInScene, LightSurface};
use crate::trace::linked::LinkedScene;
use crate::trace::packet::shadow_ray;
use crate::trace::surface::SurfacePoint;

/// The lights of a rig, without emitters, whose scale is not zero.
pub(super) struct ActiveLights {
    pub all: Vec<ActiveLight>,
}

/// A light, ready for shading.
pub(super) struct ActiveLight {
    /// Index into the rig's lights.
    pub index: usize,
    light: Light,
    links: Option<ResolvedLinks>,
    /// The light, or the middle of an area light.
    pub packed: PackedLight,
    /// `None` if the light has no size.
    surface: Option<LightSurface>,
    filter: Option<PosedFilter>,
    /// Colour times intensity, including the group's.
    pub scale: DVec3,
}

impl ActiveLights {
    pub fn new(scene: &Scene, rig: &Rig) -> Self {
        let rig = &*rig.with_solo_applied();
        let mut links = rig.resolve_links(scene).unwrap_or_else(|reason| panic!("{reason}"));
        let light = |i: usize| ActiveLight {
            index: i,
            packed: rig.lights[i].pack(scene.space),
            surface: LightSurface::new(&rig.lights[i], scene.space, None),
            light: rig.lights[i].clone(),
            filter: PosedFilter::new(&rig.lights[i]),
            links: links.remove(&i),
            scale: rig.scale(i).as_dvec3(),
        };
        let arrives = |i: &usize| rig.lights[*i].kind != LightKind::Emitter && rig.scale(*i) != Vec3::ZERO;
        Self { all: (0..rig.lights.len()).filter(arrives).map(light).collect() }
    }

    /// Punctual lights.
    fn punctual(&self) -> impl Iterator<Item = &ActiveLight> {
        self.all.iter().filter(|light| light.surface.is_none())
    }

    /// Area lights.
    fn sized(&self) -> impl Iterator<Item = (&ActiveLight, &LightSurface)> {
        self.all.iter().filter_map(|light| Some((light, light.surface.as_ref()?)))
    }

    /// Whether any light has a size.
    pub fn have_sizes(&self) -> bool {
        self.sized().next().is_some()
    }

    /// For each punctual light, its index in the rig and the radiance of its direct light that `point` reflects
    /// towards `wo`.
    pub fn reflect_each(
        &self,
        scene: &TracedScene,
        point: &SurfacePoint,
        wo: DVec3,
    ) -> impl Iterator<Item = (usize, DVec3)> {
        self.punctual().filter_map(move |light| {
            let arriving = incident(&light.packed, point.position.as_dvec3())?;
            Some((light.index, light.reflect(scene, point, wo, &light.packed, &arriving)))
        })
    }

    /// For each area light, an estimate of the same from the point at `u` in the unit square. `density` is that
    /// of other directions which may find the light, for the balance heuristic.
    pub fn reflect_points(
        &self,
        scene: &TracedScene,
        point: &SurfacePoint,
        wo: DVec3,
        u: [f64; 2],
        density: impl Fn(DVec3) -> f64,
    ) -> impl Iterator<Item = (usize, DVec3)> {
        self.sized().filter_map(move |(light, surface)| {
            let packed = light.light.pack_point(scene.space, u, None);
            let position = point.position.as_dvec3();
            let arriving = incident(&packed, position)?;
            let reflected = light.reflect(scene, point, wo, &packed, &arriving);
            if reflected == DVec3::ZERO {
                return None;
            }
            let own = surface.density(&packed, arriving.wi, packed.position.as_dvec3().distance(position));
            Some((light.index, reflected * (own / (own + density(arriving.wi)))))
        })
    }

    /// Area lights that a ray from `point` meets, given by origin and unit direction, which no surface stops
    /// before `end`: index in the rig, radiance, and the density with which [`Self::reflect_points`] finds it, 1/sr.
    pub fn met(
        &self,
        scene: &TracedScene,
        point: &SurfacePoint,
        [origin, direction]: [Vec3; 2],
        end: f32,
    ) -> impl Iterator<Item = (usize, DVec3, f64)> {
        self.sized().filter_map(move |(light, surface)| {
            let arriving = light.in_scene(scene, surface).arriving(point.triangle, [origin, direction], Some(end))?;
            Some((light.index, light.scale * arriving.radiance, arriving.density))
        })
    }

    /// Area lights that a segment of an eye path shows: index in the rig and radiance.
    pub fn seen(&self, scene: &TracedScene, segment: &PathSegment) -> impl Iterator<Item = (usize, DVec3)> {
        let PathSegment { origin, direction, range, mirror, .. } = *segment;
        self.sized().filter_map(move |(light, surface)| {
            let radiance = light.in_scene(scene, surface).seen(mirror, [origin, direction], range)?;
            Some((light.index, light.scale * radiance))
        })
    }

    /// Estimates the sum of punctual lights from one, chosen with probability proportional to its unshadowed
    /// irradiance. The mean over uniform `choice` in [0, 1) is the sum.
    pub fn reflect_one(
        &self,
        scene: &TracedScene,
        point: &SurfacePoint,
        wo: DVec3,
        choice: f64,
    ) -> Option<(usize, DVec3)> {
        if self.punctual().nth(1).is_none() {
            return self.reflect_each(scene, point, wo).next();
        }
        let (position, normal) = (point.position.as_dvec3(), point.normal.as_dvec3());
        let (mut total, mut left, mut picked) = (0.0, choice, None);
        for light in self.punctual() {
            let Some(arriving) = incident(&light.packed, position) else { continue };
            let factor = f64::from(light.linked(scene).factor(point.triangle));
            let power = factor * light.scale.max_element() * arriving.irradiance * normal.dot(arriving.wi);
            if power <= 0.0 {
                continue;
            }
            // Reservoir sampling: this light replaces the previous choice with probability power / total. In both cases
            // `left` is rescaled to be uniform in [0, 1) again.
            total += power;
            let share = power / total;
            if left < share {
                left /= share;
                picked = Some((light, power, arriving));
            } else {
                left = (left - share) / (1.0 - share);
            }
        }
        let (light, power, arriving) = picked?;
        Some((light.index, light.reflect(scene, point, wo, &light.packed, &arriving) * (total / power)))
    }
}

impl ActiveLight {
    /// Whether it shines from all directions, so that there is nothing to aim at.
    pub fn is_all_around(&self) -> bool {
        self.light.kind == LightKind::Dome
    }

    fn linked<'a>(&'a self, scene: &'a TracedScene) -> LinkedScene<'a> {
        scene.linked(self.links.as_ref())
    }

    fn in_scene<'a>(&'a self, scene: &'a TracedScene, surface: &'a LightSurface) -> LightInScene<'a> {
        LightInScene { light: &self.light, surface, filter: self.filter.as_ref(), scene: self.linked(scene) }
    }

    /// `packed`: the light, or a point of it.
    fn reflect(
        &self,
        scene: &TracedScene,
        point: &SurfacePoint,
        wo: DVec3,
        packed: &PackedLight,
        arriving: &Incident,
    ) -> DVec3 {
        let normal = point.normal.as_dvec3();
        if arriving.irradiance <= 0.0 || normal.dot(arriving.wi) <= 0.0 {
            return DVec3::ZERO;
        }
        let scene = self.linked(scene);
        let factor = f64::from(scene.factor(point.triangle)) * self.filtered(-arriving.wi);
        if factor == DVec3::ZERO {
            return DVec3::ZERO;
        }
        let seen = if self.light.shadows { share_seen(scene, point, packed) } else { 1.0 };
        if seen <= 0.0 {
            return DVec3::ZERO;
        }
        let scale = self.scale * color(packed);
        factor * seen * scale * arriving.irradiance * reflected(&point.brdf, normal, arriving.wi, wo)
    }

    /// Factor of the light's filter in a unit direction of emission.
    fn filtered(&self, direction: DVec3) -> DVec3 {
        self.filter.as_ref().map_or(DVec3::ONE, |filter| filter.factor(direction.as_vec3()).as_dvec3())
    }
}

/// Visible fraction of a light. Blended surfaces attenuate it by their exact transmittance instead of blocking at
/// random, since direct light at visible surfaces may be computed only once per pixel.
fn share_seen(scene: LinkedScene, point: &SurfacePoint, packed: &PackedLight) -> f64 {
    let ray = shadow_ray(&scene.bvh, packed, point.lifted(), point.normal, point.geometric_normal);
    ray.map_or(0.0, |ray| scene.transmittance(ray.origin, ray.direction, ray.length).into())
}

/// What emits light, and the lights of the rig that make it shine.
pub(super) struct ActiveEmitters {
    /// By material: lights, and their factors on its emission.
    lights: Vec<Vec<(usize, DVec3)>>,
    pub triangles: EmittingTriangles,
}

impl ActiveEmitters {
    /// `rig` has a light for each emitter.
    pub fn new(scene: &Scene, rig: &Rig) -> Self {
        let lights = Emitters::of(scene).lights(rig);
        let radiance = |material: u32| {
            let factor: DVec3 = lights[material as usize].iter().map(|(_, factor)| *factor).sum();
            (scene.materials[material as usize].emissive.as_dvec3() * factor).max_element()
        };
        Self { triangles: EmittingTriangles::new(scene, radiance), lights }
    }

    /// Adds light that a material emits.
    pub fn add(&self, sums: &mut Sample, material: u32, emission: DVec3) {
        for &(source, factor) in &self.lights[material as usize] {
            sums.add_light(EMISSION, source, emission * factor);
        }
    }
}
