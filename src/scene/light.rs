//! Lights as artists set them: world space, double precision, colour and intensity apart from pose.

use glam::{DVec3, Vec3};

use super::MeshSpace;
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT, PackedLight};

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightKind {
    Point,
    Spot,
    Directional,
}

/// One light. Its picture is linear in `color * intensity * 2^stops`; all else needs it shaded again.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Unique in its rig; holds no dot, since image layers are called `light.NAME`.
    pub name: String,
    pub kind: LightKind,
    /// World space, metres; ignored for directional lights.
    pub position: DVec3,
    /// Unit vector along which a spot or directional light shines; ignored for points.
    pub direction: DVec3,
    /// Linear Rec. 709.
    pub color: Vec3,
    /// Candela; lux for directional lights.
    pub intensity: f64,
    /// Intensity is multiplied by 2^stops.
    pub stops: f64,
    /// Spot half-angles in radians, 0 <= inner <= outer <= pi/2.
    pub inner_angle: f64,
    pub outer_angle: f64,
    /// Metres; nothing is lit beyond it.
    pub range: Option<f64>,
    /// Index into the rig's groups.
    pub group: Option<usize>,
    pub enabled: bool,
    /// Where any light or group is solo, only those shine, and of those only what is enabled.
    pub solo: bool,
    /// Index of the light in the same rig that this one follows: edited with it, as far off as before.
    pub follows: Option<usize>,
    /// Whether geometry blocks it.
    pub shadows: bool,
    /// The glTF node that it came from.
    pub node: Option<usize>,
}

/// A master over some lights: a factor on all of them.
#[derive(Clone, Debug, PartialEq)]
pub struct LightGroup {
    pub name: String,
    pub stops: f64,
    /// Linear Rec. 709, multiplies the lights' own.
    pub color: Vec3,
    pub enabled: bool,
    pub solo: bool,
}

impl Light {
    /// White point light of one candela at `position`.
    pub fn point(name: &str, position: DVec3) -> Self {
        Self {
            name: name.into(),
            kind: LightKind::Point,
            position,
            direction: DVec3::NEG_Z,
            color: Vec3::ONE,
            intensity: 1.0,
            stops: 0.0,
            inner_angle: 0.0,
            outer_angle: std::f64::consts::FRAC_PI_4,
            range: None,
            group: None,
            enabled: true,
            solo: false,
            follows: None,
            shadows: true,
            node: None,
        }
    }

    /// What the unit picture of this light is multiplied by, its group not counted; zero if it is off.
    pub fn scale(&self) -> Vec3 {
        if self.enabled { self.color * (self.intensity * self.stops.exp2()) as f32 } else { Vec3::ZERO }
    }
}

impl Light {
    /// This light at unit intensity and white, in mesh space.
    pub fn pack(&self, space: MeshSpace) -> PackedLight {
        let (inner, outer) = (self.inner_angle.cos(), self.outer_angle.cos());
        PackedLight {
            position: space.from_world(self.position).as_vec3(),
            kind: match self.kind {
                LightKind::Point => LIGHT_POINT,
                LightKind::Spot => LIGHT_SPOT,
                LightKind::Directional => LIGHT_DIRECTIONAL,
            },
            direction: self.direction.as_vec3(),
            inverse_range: self.range.map_or(0.0, |range| space.unit / range) as f32,
            cone_scale: (inner - outer).max(0.001).recip() as f32,
            // 1 - cos without cancellation.
            cone_versine: (2.0 * (self.outer_angle / 2.0).sin().powi(2)) as f32,
            strength: space.unit.powi(-2) as f32,
        }
    }
}

impl LightGroup {
    /// A group that changes nothing.
    pub fn new(name: &str) -> Self {
        Self { name: name.into(), stops: 0.0, color: Vec3::ONE, enabled: true, solo: false }
    }

    /// What the sum of this group's lights is multiplied by; zero if it is off.
    pub fn scale(&self) -> Vec3 {
        if self.enabled { self.color * self.stops.exp2() as f32 } else { Vec3::ZERO }
    }
}
