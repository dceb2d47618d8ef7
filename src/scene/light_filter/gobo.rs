//! Gobos: images that a light projects.

use std::f32::consts::FRAC_PI_2;

use glam::{Vec2, Vec3, Vec4Swizzles};

use super::Attached;
use crate::scene::texture::{Texture, Wrap};
use crate::scene::{Light, LightKind};

/// An image in front of a light, as a slide in a projector; what lies outside of it is black.
#[derive(Clone, Debug, PartialEq)]
pub struct Gobo {
    /// sRGB; transparent texels are black.
    pub image: Attached<Texture>,
    /// Radians, counter-clockwise as the picture appears on a wall, seen from the light.
    pub rotation: f64,
    /// At 1 the image's longer side is as wide as the light's cone or spread.
    pub scale: f64,
    /// Linear Rec. 709; multiplies the image.
    pub tint: Vec3,
}

/// Largest half-angle of a cone that an image at scale 1 fills, radians: a plane does not show 180 degrees.
const MAX_SPOT: f64 = 80.0 / 180.0 * std::f64::consts::PI;
const MAX_FLAT: f64 = std::f64::consts::FRAC_PI_4;

/// A gobo in front of a light.
pub(super) struct PosedGobo {
    image: Attached<Texture>,
    tint: Vec3,
    /// Rows of the matrix from tangents to image coordinates relative to the middle.
    to_image: [Vec2; 2],
}

impl PosedGobo {
    pub fn new(gobo: &Gobo, light: &Light) -> Self {
        let half_angle = match light.kind {
            LightKind::Spot => light.outer_angle.min(MAX_SPOT),
            _ => (light.spread / 2.0).min(MAX_FLAT),
        };
        let [width, height] = [gobo.image.width(), gobo.image.height()].map(|side| side as f32);
        let longer = width.max(height);
        let side = 2.0 * (half_angle.tan() * gobo.scale) as f32;
        let along = Vec2::from_angle(gobo.rotation as f32);
        // Row 0 of an image is its top.
        let down = Vec2::from_angle(gobo.rotation as f32 - FRAC_PI_2);
        let to_image = [along * (longer / width / side), down * (longer / height / side)];
        Self { image: gobo.image.clone(), tint: gobo.tint, to_image }
    }

    /// RGB factor in the direction with these tangents to the right and upwards.
    pub fn transmittance(&self, on_plane: [f32; 2]) -> Vec3 {
        let at = self.to_image.map(|row| row.dot(on_plane.into()));
        if !at.iter().all(|x| x.abs() <= 0.5) {
            return Vec3::ZERO;
        }
        let texel = self.image.sample(Vec2::from(at) + 0.5, [Wrap::Clamp; 2], 0.0);
        self.tint * texel.xyz() * texel.w
    }
}
