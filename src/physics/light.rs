//! Punctual lights [KHR_lights_punctual], and facets. Twin of glsl/lib/light.glsl.

use glam::DVec3;

use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_FACET, LIGHT_SPOT, LIGHT_TWO_SIDED_FACET, PackedLight};

/// Light that is incident at a point.
#[derive(Clone, Copy, Debug)]
pub struct Incident {
    /// Unit, towards the light.
    pub wi: DVec3,
    /// At normal incidence, for unit intensity: 1/m², or 1 for directional lights.
    pub irradiance: f64,
}

/// Colour of the light at unit intensity.
pub fn color(light: &PackedLight) -> DVec3 {
    if light.kind == LIGHT_DIRECTIONAL { light.position.as_dvec3() } else { DVec3::ONE }
}

/// Unoccluded light at `position` (mesh space); `None` at the light itself.
pub fn incident(light: &PackedLight, position: DVec3) -> Option<Incident> {
    if light.kind == LIGHT_DIRECTIONAL {
        return Some(Incident { wi: -light.direction.as_dvec3().normalize(), irradiance: light.strength.into() });
    }
    let to_light = light.position.as_dvec3() - position;
    let distance = to_light.length();
    let inverse = 1.0 / distance;
    if !(inverse.is_finite() && inverse > 0.0) {
        return None;
    }
    let wi = to_light * inverse;
    let mut irradiance = f64::from(light.strength) * window(light, distance) * inverse * inverse;
    match light.kind {
        LIGHT_SPOT => irradiance *= smooth(light, 0.5 * chord(light, wi).length_squared()),
        LIGHT_FACET | LIGHT_TWO_SIDED_FACET => irradiance *= facet(light, -wi.dot(axis(light))),
        _ => {}
    }
    Some(Incident { wi, irradiance })
}

/// Emission of a facet relative to that along its normal, at `cosine` from it: the cosine, times a factor that falls
/// linearly with the tangent to zero at the edge of the spread (as in Cycles).
pub fn facet(light: &PackedLight, cosine: f64) -> f64 {
    let cosine = if light.kind == LIGHT_TWO_SIDED_FACET { cosine.abs() } else { cosine };
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    (cosine - f64::from(light.narrowing) * sine).max(0.0)
}

/// Irradiance at a distance in mesh space relative to that of the inverse square: falls to zero at the light's range,
/// as max(0, min(1, 1 - (d/range)⁴)), and cancels the increase within [`PackedLight::squared_radius`].
pub fn window(light: &PackedLight, distance: f64) -> f64 {
    let nearness = distance * distance / f64::from(light.squared_radius);
    (1.0 - (distance * f64::from(light.inverse_range)).powi(4)).clamp(0.0, 1.0) * nearness.min(1.0)
}

/// Chord between a spot's axis and the direction of emission: 2 sin of half the angle.
pub fn off_axis(light: &PackedLight, wi: DVec3) -> f64 {
    chord(light, wi).length()
}

fn chord(light: &PackedLight, wi: DVec3) -> DVec3 {
    wi + axis(light)
}

fn axis(light: &PackedLight) -> DVec3 {
    // Unit in float32, accurate to 1e-7; after a Newton step in double precision, to 1e-14.
    let axis = light.direction.as_dvec3();
    axis * (1.5 - 0.5 * axis.length_squared())
}

/// Smooth falloff of a spot between its inner and outer cone, from the chord [`off_axis`].
pub fn cone(light: &PackedLight, chord: f64) -> f64 {
    smooth(light, 0.5 * chord * chord)
}

/// [`cone`] from the versine: 1 - cos of the angle, which is chord²/2.
fn smooth(light: &PackedLight, versine: f64) -> f64 {
    let above_outer = f64::from(light.cone_versine) - versine;
    (above_outer * f64::from(light.cone_scale)).clamp(0.0, 1.0).powi(2)
}
