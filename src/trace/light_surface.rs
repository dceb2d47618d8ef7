//! Surfaces of area lights, for rays that hit them.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec2, DVec3, Vec3};

use super::linked::LinkedScene;
use crate::physics::distribution::GridDistribution;
use crate::physics::light::{cone, facet, off_axis, window};
use crate::scene::light_filter::PosedFilter;
use crate::scene::{DomeMap, Light, LightKind, MeshSpace, SkyMap, WideLight};
use crate::shared::{LIGHT_SPOT, PackedLight};

/// An area light and what lies between it and a ray's origin.
#[derive(Clone, Copy)]
pub struct LightInScene<'a> {
    pub light: &'a Light,
    pub surface: &'a LightSurface,
    pub filter: Option<&'a PosedFilter>,
    /// With the links of the light.
    pub scene: LinkedScene<'a>,
}

/// Surface of an area light, at unit intensity; mesh space.
pub struct LightSurface {
    shape: Shape,
    /// Middle of the light as a punctual light.
    packed: PackedLight,
    /// cd/m², straight ahead.
    radiance: f64,
    /// Density of sampling points, per area or, for suns, per solid angle; the mean one of wide lights.
    density: f64,
    /// Density of the points of a wide light, and its axes.
    wide: Option<(WideLight, [DVec3; 2])>,
    /// Metres.
    unit: f64,
}

enum Shape {
    Sphere { radius: f64 },
    Disk { radius: f64 },
    Rect { axes: [DVec3; 2], half_size: [f64; 2] },
    Sun { versine: f64 },
    Sky { map: Option<DomeMap>, to_map: DQuat, warp: Option<GridDistribution> },
}

/// A point of a light's surface, as a ray sees it.
#[derive(Clone, Copy, Debug)]
struct LightHit {
    /// In units of the unit direction.
    distance: f64,
    /// RGB, cd/m², from a light of unit intensity without filter.
    radiance: DVec3,
    /// Density with which sampling the light finds the direction, 1/sr. 0 for domes: see [`LightSurface::sky_density`].
    density: f64,
}

/// Light that arrives along a ray from a light of unit intensity.
#[derive(Clone, Copy, Debug)]
pub struct ArrivingLight {
    /// RGB, cd/m².
    pub radiance: DVec3,
    /// Density with which sampling the light's surface finds the direction, 1/sr.
    pub density: f64,
}

impl LightInScene<'_> {
    /// Light along a ray from the surface of `triangle`, given by origin and unit direction. `end`: where the next
    /// surface stops the ray, if that is known.
    pub fn arriving(&self, triangle: u32, [origin, direction]: [Vec3; 2], end: Option<f32>) -> Option<ArrivingLight> {
        let mut arriving =
            self.between(triangle, [origin, direction], [0.0, end.unwrap_or(f32::INFINITY)], end.is_some())?;
        if self.light.kind == LightKind::Dome {
            arriving.density = self.surface.sky_density(direction.as_dvec3());
        }
        Some(arriving)
    }

    /// Light along a part of an eye path, between two distances from the origin. `mirror`: triangle at the origin;
    /// `None` if the eye looks directly.
    pub fn seen(&self, mirror: Option<u32>, [origin, direction]: [Vec3; 2], range: [f32; 2]) -> Option<DVec3> {
        if self.light.kind == LightKind::Dome {
            let radiance = || self.seen_sky(mirror, SkyMap::place(direction));
            return range[1].is_infinite().then(radiance).filter(|radiance| *radiance != DVec3::ZERO);
        }
        if let Some(mirror) = mirror {
            // A light that surfaces do not stop is seen along the whole ray, by its first segment alone.
            let was_seen = range[0] > 0.0 && !self.is_stopped();
            let arriving = if was_seen { None } else { self.between(mirror, [origin, direction], range, true) };
            return arriving.map(|arriving| arriving.radiance);
        }
        if !self.light.visible {
            return None;
        }
        let hit = self.surface.hit(origin.as_dvec3(), direction.as_dvec3(), range.map(f64::from))?;
        let radiance = self.filtered(-direction) * hit.radiance;
        (radiance != DVec3::ZERO).then_some(radiance)
    }

    /// What an eye path shows of a dome where it leaves the scene; see [`Self::seen`]. `place`: of its direction in a
    /// map that is not turned.
    pub fn seen_sky(&self, mirror: Option<u32>, [u, v]: [f32; 2]) -> DVec3 {
        let factor = match mirror {
            Some(triangle) => self.scene.factor(triangle),
            None => f32::from(u8::from(self.light.visible)),
        };
        let radiance = || self.light.sky().radiance_at([u + self.light.turns() as f32, v]);
        if factor > 0.0 { (factor * radiance()).as_dvec3() } else { DVec3::ZERO }
    }

    /// `is_free`: whether nothing stops the ray within `range`.
    fn between(
        &self,
        triangle: u32,
        [origin, direction]: [Vec3; 2],
        [begin, end]: [f32; 2],
        is_free: bool,
    ) -> Option<ArrivingLight> {
        let is_free = is_free && self.is_stopped();
        let reach = if is_free { end } else { f32::INFINITY };
        let LightHit { distance, radiance, density } =
            self.surface.hit(origin.as_dvec3(), direction.as_dvec3(), [begin, reach].map(f64::from))?;
        let factor = f64::from(self.scene.factor(triangle)) * self.filtered(-direction);
        if factor == DVec3::ZERO {
            return None;
        }
        let passes = if is_free || !self.light.shadows {
            1.0
        } else {
            self.scene.transmittance(origin, direction, distance as f32)
        };
        let falloff = if distance.is_finite() { window(&self.surface.packed, distance) } else { 1.0 };
        let radiance = f64::from(passes) * factor * radiance * falloff;
        (radiance != DVec3::ZERO).then_some(ArrivingLight { radiance, density })
    }

    /// Whether every surface stops the light, as far as it covers what is behind it.
    fn is_stopped(&self) -> bool {
        self.light.shadows && self.scene.everything_casts_shadow()
    }

    /// Factor of the light's filter in a unit direction of emission.
    fn filtered(&self, direction: Vec3) -> DVec3 {
        self.filter.map_or(DVec3::ONE, |filter| filter.factor(direction).as_dvec3())
    }
}

/// Sides of a rectangle are not shorter than this, relative to the longer one.
const LEAST_SIDE: f64 = 1e-6;

impl LightSurface {
    /// `None` if the light has no size, or one too small for a finite radiance.
    ///
    /// `warp`: of the unit square from which directions of a dome are drawn.
    pub fn new(light: &Light, space: MeshSpace, warp: Option<GridDistribution>) -> Option<Self> {
        if light.is_punctual() {
            return None;
        }
        let radius = light.radius / space.unit;
        // A side of zero is a line: its radiance would be infinite.
        let least_side = LEAST_SIDE * light.size[0].max(light.size[1]);
        let light = &Light { size: light.size.map(|side| side.max(least_side)), ..light.clone() };
        let half_size = light.size.map(|x| 0.5 * x / space.unit);
        let quarter = (light.angle / 4.0).sin();
        let (shape, area) = match light.kind {
            LightKind::Point => (Shape::Sphere { radius }, 4.0 * PI * radius * radius),
            LightKind::Spot | LightKind::Disk => (Shape::Disk { radius }, PI * radius * radius),
            LightKind::Rect => (Shape::Rect { axes: light.axes(), half_size }, 4.0 * half_size[0] * half_size[1]),
            LightKind::Directional => {
                let versine = 2.0 * quarter * quarter;
                (Shape::Sun { versine }, TAU * versine)
            }
            LightKind::Dome => {
                (Shape::Sky { map: light.map.clone(), to_map: light.turn().conjugate(), warp }, 4.0 * PI)
            }
            LightKind::Emitter => return None,
        };
        let projected = match light.kind {
            LightKind::Spot => PI * light.radius * light.radius,
            _ => light.projected_area().unwrap_or(0.0),
        };
        let wide = WideLight::of(light, space).map(|wide| (wide, light.axes()));
        // Points of a wide disk are drawn in the square around it.
        let drawn_area = if wide.is_some() && light.kind != LightKind::Rect { area * 4.0 / PI } else { area };
        let (radiance, density) = (projected.recip(), drawn_area.recip());
        let surface = Self { shape, packed: light.pack(space), radiance, density, wide, unit: space.unit };
        (surface.radiance.is_finite() && surface.density.is_finite()).then_some(surface)
    }

    /// Area in mesh space, or solid angle of a sun or dome, for all of which `point` stands.
    pub fn size(&self, point: &PackedLight) -> f64 {
        match self.shape {
            Shape::Sky { .. } => point.squared_radius.into(),
            _ => self.density_at(point.position.as_dvec3() - self.packed.position.as_dvec3()).recip(),
        }
    }

    /// Density of sampling points, at an offset from the middle.
    fn density_at(&self, offset: DVec3) -> f64 {
        let weight = |(wide, axes): &(WideLight, [DVec3; 2])| {
            wide.weight(self.unit * DVec2::new(offset.dot(axes[0]), offset.dot(axes[1])))
        };
        self.wide.as_ref().map_or(self.density, |wide| self.density / weight(wide))
    }

    /// What a ray in unit `direction` sees of the light beyond the distance `begin` and up to `end`.
    fn hit(&self, origin: DVec3, direction: DVec3, [begin, end]: [f64; 2]) -> Option<LightHit> {
        let at_infinity = |radiance: DVec3, density| LightHit { distance: f64::INFINITY, radiance, density };
        let axis = self.packed.direction.as_dvec3().normalize();
        let to_middle = self.packed.position.as_dvec3() - origin;
        let on_plane = || {
            let distance = to_middle.dot(axis) / direction.dot(axis);
            (distance > begin && distance <= end && distance.is_finite())
                .then(|| (distance, distance * direction - to_middle))
        };
        match &self.shape {
            Shape::Sun { .. } | Shape::Sky { .. } if end.is_finite() => None,
            Shape::Sun { versine } => {
                let chord = 0.5 * (direction + axis).length_squared();
                (chord <= *versine).then(|| at_infinity(DVec3::splat(self.radiance), self.density))
            }
            Shape::Sky { map, to_map, .. } => {
                let map = map.as_deref().unwrap_or(SkyMap::white());
                Some(at_infinity(map.radiance((*to_map * direction).as_vec3()).as_dvec3(), 0.0))
            }
            Shape::Sphere { radius } => {
                let along = to_middle.dot(direction);
                let off = (to_middle - along * direction).length_squared();
                let half_chord = (radius * radius - off).max(0.0).sqrt();
                let distance = along - half_chord;
                // From inside it is dark.
                (half_chord > 0.0 && distance > begin && distance <= end)
                    .then(|| self.seen(distance, half_chord / radius, 1.0, self.density))
            }
            Shape::Disk { radius } => {
                let (distance, at) = on_plane()?;
                (at.length_squared() <= radius * radius).then(|| self.flat(distance, at, direction, axis))?
            }
            Shape::Rect { axes, half_size } => {
                let (distance, at) = on_plane()?;
                let is_inside = axes.iter().zip(half_size).all(|(axis, half)| at.dot(*axis).abs() <= *half);
                is_inside.then(|| self.flat(distance, at, direction, axis))?
            }
        }
    }

    /// Density with which directions of a dome are drawn; 0 for other lights.
    fn sky_density(&self, direction: DVec3) -> f64 {
        let Shape::Sky { map, to_map, warp } = &self.shape else { return 0.0 };
        let (map, direction) = (map.as_deref().unwrap_or(SkyMap::white()), (*to_map * direction).as_vec3());
        map.density(direction) * warp.as_ref().map_or(1.0, |warp| warp.warp_density(map.drawn_at(direction)))
    }

    fn flat(&self, distance: f64, at: DVec3, direction: DVec3, axis: DVec3) -> Option<LightHit> {
        let cosine = -direction.dot(axis);
        let emission = match self.packed.kind {
            LIGHT_SPOT => cone(&self.packed, off_axis(&self.packed, direction)),
            _ => facet(&self.packed, cosine),
        };
        (emission > 0.0).then(|| self.seen(distance, cosine.abs(), emission / cosine.abs(), self.density_at(at)))
    }

    /// `relative`: radiance relative to that straight ahead.
    fn seen(&self, distance: f64, cosine: f64, relative: f64, density: f64) -> LightHit {
        LightHit {
            distance,
            radiance: DVec3::splat(self.radiance * relative),
            density: density * distance * distance / cosine,
        }
    }

    /// Density with which sampling finds `point` of the light from unit `wi` at `distance`, 1/sr.
    pub fn density(&self, point: &PackedLight, wi: DVec3, distance: f64) -> f64 {
        match &self.shape {
            Shape::Sun { .. } => self.density,
            Shape::Sky { .. } => self.sky_density(wi),
            _ => {
                let density = self.density_at(point.position.as_dvec3() - self.packed.position.as_dvec3());
                density * distance * distance / wi.dot(point.direction.as_dvec3()).abs().max(f64::MIN_POSITIVE)
            }
        }
    }
}
