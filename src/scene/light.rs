//! Lights as artists edit them: world space, double precision, with colour and intensity separate from the pose.

use glam::{DVec3, Vec3};

use super::MeshSpace;
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT, PackedLight};

/// The light types of `KHR_lights_punctual`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightKind {
    Point,
    Spot,
    Directional,
}

/// One light. Its image is linear in `color * intensity * 2^stops`; any other change requires shading it again.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Unique in its rig; contains no dot, because image layers are called `light.NAME`.
    pub name: String,
    pub kind: LightKind,
    /// World space, metres; ignored for directional lights.
    pub position: DVec3,
    /// Unit direction of emission of a spot or directional light; ignored for point lights.
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
    /// Metres; the light has no effect beyond it.
    pub range: Option<f64>,
    /// Index into the rig's groups.
    pub group: Option<usize>,
    pub enabled: bool,
    /// If any light or group is solo, all lights are off that are not solo themselves or by their group.
    pub solo: bool,
    /// Index of the light in the same rig that this one follows: edits of the leader are applied to this light too, and
    /// their difference is preserved.
    pub follows: Option<usize>,
    /// Whether geometry blocks its light.
    pub shadows: bool,
    /// Source glTF node.
    pub node: Option<usize>,
}

/// A group of lights with a common factor.
#[derive(Clone, Debug, PartialEq)]
pub struct LightGroup {
    pub name: String,
    pub stops: f64,
    /// Linear Rec. 709; multiplies the lights' colours.
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

    /// Factor on this light's unit image, without its group's factor; zero if the light is off.
    pub fn scale(&self) -> Vec3 {
        if self.enabled { self.color * (self.intensity * self.stops.exp2()) as f32 } else { Vec3::ZERO }
    }
}

impl Light {
    /// This light in mesh space, white and at unit intensity.
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
    /// A group whose factor is one.
    pub fn new(name: &str) -> Self {
        Self { name: name.into(), stops: 0.0, color: Vec3::ONE, enabled: true, solo: false }
    }

    /// Factor on the sum of this group's lights; zero if the group is off.
    pub fn scale(&self) -> Vec3 {
        if self.enabled { self.color * self.stops.exp2() as f32 } else { Vec3::ZERO }
    }
}
