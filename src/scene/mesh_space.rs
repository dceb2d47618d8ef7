//! Where single precision is at home.

use glam::{DVec3, Vec3};

/// Mesh space in world space: recentred and of unit size, so that what is in single precision is the same wherever a scene
/// lies and however large it is. Directions are those of world space.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MeshSpace {
    /// World position of mesh space's (0, 0, 0).
    pub origin: DVec3,
    /// Metres of mesh space's unit.
    pub unit: f64,
}

impl MeshSpace {
    /// World space itself.
    pub const WORLD: Self = Self { origin: DVec3::ZERO, unit: 1.0 };

    /// That of a box: its centre, and half its diagonal.
    pub fn around(low: DVec3, high: DVec3) -> Self {
        let size = high - low;
        // Not squared as it is, so that it neither overflows nor vanishes.
        let longest = size.max_element();
        Self { origin: low + size / 2.0, unit: 0.5 * longest * (size / longest).length() }
    }

    /// A point of world space, not rounded yet.
    pub fn from_world(&self, point: DVec3) -> DVec3 {
        (point - self.origin) / self.unit
    }

    pub fn to_world(&self, point: Vec3) -> DVec3 {
        self.origin + self.unit * point.as_dvec3()
    }
}
