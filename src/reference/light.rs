//! Punctual lights [KHR_lights_punctual]. Twin of glsl/lib/light.glsl.

use glam::DVec3;

use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_SPOT, PackedLight};

/// Light that arrives at a point.
#[derive(Clone, Copy, Debug)]
pub struct Incident {
    /// Unit, towards the light.
    pub wi: DVec3,
    /// At normal incidence, for unit intensity: 1/m² for points and spots, 1 for directional lights.
    pub irradiance: f64,
}

/// What arrives at `position` (mesh space) with nothing between; `None` at the light itself.
pub fn incident(light: &PackedLight, position: DVec3) -> Option<Incident> {
    if light.kind == LIGHT_DIRECTIONAL {
        return Some(Incident { wi: -light.direction.as_dvec3().normalize(), irradiance: 1.0 });
    }
    let to_light = light.position.as_dvec3() - position;
    let wi = to_light.try_normalize()?;
    let distance = to_light.length();
    let mut irradiance = window(light, distance) / (distance * distance);
    if light.kind == LIGHT_SPOT {
        irradiance *= cone(light, off_axis(light, wi));
    }
    Some(Incident { wi, irradiance })
}

/// The fall to zero at the light's range: max(0, min(1, 1 - (d/range)⁴)).
pub fn window(light: &PackedLight, distance: f64) -> f64 {
    (1.0 - (distance * f64::from(light.inverse_range)).powi(4)).clamp(0.0, 1.0)
}

/// Chord between a spot's axis and the direction in which its light leaves: 2 sin of half the angle.
pub fn off_axis(light: &PackedLight, wi: DVec3) -> f64 {
    (wi + light.direction.as_dvec3().normalize()).length()
}

/// A spot's smoothing between its inner and outer cone, by [`off_axis`]; cos outer is 1 - versine, cos of the angle
/// 1 - chord²/2.
pub fn cone(light: &PackedLight, chord: f64) -> f64 {
    let above_outer = f64::from(light.cone_versine) - 0.5 * chord * chord;
    (above_outer * f64::from(light.cone_scale)).clamp(0.0, 1.0).powi(2)
}
