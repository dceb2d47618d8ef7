//! Surfaces of lights with a size, for rays that hit them.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::physics::light::{cone, facet, off_axis, window};
use crate::scene::{Light, LightKind, MeshSpace};
use crate::shared::{LIGHT_SPOT, PackedLight};

/// Surface of a light with a size, at unit intensity; mesh space.
pub(super) struct LightSurface {
    shape: Shape,
    /// Middle of the light as a light without size.
    packed: PackedLight,
    /// cd/m², straight ahead.
    radiance: f64,
    /// Density of sampling points, per area or, for suns, per solid angle.
    density: f64,
}

enum Shape {
    Sphere { radius: f64 },
    Disk { radius: f64 },
    Rect { axes: [DVec3; 2], half_size: [f64; 2] },
    Sun { versine: f64 },
}

/// A point of a light's surface, as a ray sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct LightHit {
    /// In units of the unit direction.
    pub distance: f64,
    /// cd/m² from a light of unit intensity.
    pub radiance: f64,
    /// Density with which sampling the light finds the direction, 1/sr.
    pub density: f64,
}

impl LightSurface {
    /// `None` if the light has no size.
    pub fn new(light: &Light, space: MeshSpace) -> Option<Self> {
        if light.is_punctual() {
            return None;
        }
        let radius = light.radius / space.unit;
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
        };
        let projected = match light.kind {
            LightKind::Spot => PI * light.radius * light.radius,
            _ => light.projected_area().unwrap_or(0.0),
        };
        Some(Self { shape, packed: light.pack(space), radiance: projected.recip(), density: area.recip() })
    }

    /// What a ray in unit `direction` sees of the light.
    pub fn hit(&self, origin: DVec3, direction: DVec3) -> Option<LightHit> {
        let axis = self.packed.direction.as_dvec3().normalize();
        let to_middle = self.packed.position.as_dvec3() - origin;
        let on_plane = || {
            let distance = to_middle.dot(axis) / direction.dot(axis);
            (distance > 0.0 && distance.is_finite()).then(|| (distance, distance * direction - to_middle))
        };
        match &self.shape {
            Shape::Sun { versine } => {
                let chord = 0.5 * (direction + axis).length_squared();
                (chord <= *versine).then_some(LightHit {
                    distance: f64::INFINITY,
                    radiance: self.radiance,
                    density: self.density,
                })
            }
            Shape::Sphere { radius } => {
                let along = to_middle.dot(direction);
                let off = (to_middle - along * direction).length_squared();
                let half_chord = (radius * radius - off).max(0.0).sqrt();
                let distance = along - half_chord;
                // From inside it is dark.
                (half_chord > 0.0 && distance > 0.0).then(|| self.seen(distance, half_chord / radius, 1.0))
            }
            Shape::Disk { radius } => {
                let (distance, at) = on_plane()?;
                (at.length_squared() <= radius * radius).then(|| self.flat(distance, direction, axis))?
            }
            Shape::Rect { axes, half_size } => {
                let (distance, at) = on_plane()?;
                let is_inside = axes.iter().zip(half_size).all(|(axis, half)| at.dot(*axis).abs() <= *half);
                is_inside.then(|| self.flat(distance, direction, axis))?
            }
        }
    }

    fn flat(&self, distance: f64, direction: DVec3, axis: DVec3) -> Option<LightHit> {
        let cosine = -direction.dot(axis);
        let emission = match self.packed.kind {
            LIGHT_SPOT => cone(&self.packed, off_axis(&self.packed, direction)),
            _ => facet(&self.packed, cosine),
        };
        (emission > 0.0).then(|| self.seen(distance, cosine.abs(), emission / cosine.abs()))
    }

    /// `relative`: radiance relative to that straight ahead.
    fn seen(&self, distance: f64, cosine: f64, relative: f64) -> LightHit {
        LightHit {
            distance,
            radiance: self.radiance * relative * window(&self.packed, distance),
            density: self.density * distance * distance / cosine,
        }
    }

    /// Density with which sampling finds `point` of the light from unit `wi` at `distance`, 1/sr.
    pub fn density(&self, point: &PackedLight, wi: DVec3, distance: f64) -> f64 {
        match self.shape {
            Shape::Sun { .. } => self.density,
            _ => self.density * distance * distance / wi.dot(point.direction.as_dvec3()).abs().max(f64::MIN_POSITIVE),
        }
    }
}
