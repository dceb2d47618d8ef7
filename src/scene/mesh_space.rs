//! Mesh space, the space of all single-precision geometry.

use glam::{DVec3, Vec3};

/// Transform between world space and mesh space. Mesh space is recentred and of unit size, so that single-precision
/// results do not depend on the scene's position and size. Directions are the same in both.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MeshSpace {
    /// World position of mesh space's origin.
    pub origin: DVec3,
    /// Metres per unit of mesh space.
    pub unit: f64,
}

impl MeshSpace {
    /// Mesh space that equals world space.
    pub const WORLD: Self = Self { origin: DVec3::ZERO, unit: 1.0 };

    /// Mesh space of a box: the origin is its centre, the unit half its diagonal.
    pub fn around(low: DVec3, high: DVec3) -> Self {
        let size = high - low;
        // Divided before squaring, so that it neither overflows nor underflows.
        let longest = size.max_element();
        Self { origin: low + size / 2.0, unit: 0.5 * longest * (size / longest).length() }
    }

    /// Maps a point to mesh space, still in double precision.
    pub fn from_world(&self, point: DVec3) -> DVec3 {
        (point - self.origin) / self.unit
    }

    /// Maps a point to world space.
    pub fn to_world(&self, point: Vec3) -> DVec3 {
        self.origin + self.unit * point.as_dvec3()
    }
}
