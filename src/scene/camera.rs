//! Cameras: a pose in world space and a projection.

use glam::{DMat3, DVec3};

use super::{Mesh, MeshSpace};

/// A named camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub name: String,
    /// World space, metres.
    pub position: DVec3,
    /// Orthonormal columns right, up, back: the camera looks down its -Z.
    pub world_from_camera: DMat3,
    pub projection: Projection,
    /// Width over height of the intended picture, if the file specifies it.
    pub aspect: Option<f64>,
}

/// How a camera maps view space to the image.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub enum Projection {
    /// Vertical field of view in radians, in (0, pi).
    Perspective { yfov: f64 },
    /// Half the height of the view in metres.
    Orthographic { ymag: f64 },
}

/// Relative tolerance of [`Camera::sees_as`]: files may store poses in single precision.
const ROUNDED: f64 = 1e-6;

impl Camera {
    /// A camera at `position` that looks at `target`. `None` if the pose is degenerate (target at position, up parallel
    /// to the view direction, not finite).
    pub fn look_at(position: DVec3, target: DVec3, up: DVec3, projection: Projection) -> Option<Self> {
        let back = (position - target).try_normalize()?;
        let right = up.cross(back).try_normalize()?;
        let world_from_camera = DMat3::from_cols(right, back.cross(right), back);
        let finite = position.is_finite() && world_from_camera.is_finite();
        finite.then(|| Self { name: "camera".into(), position, world_from_camera, projection, aspect: None })
    }

    /// A camera that sees all of `mesh` from the front, slightly above.
    pub fn framing(mesh: &Mesh, space: MeshSpace) -> Self {
        let (lo, hi) = mesh.bounds();
        let center = space.to_world((lo + hi) / 2.0);
        // An empty mesh gets a radius of one metre.
        let radius = match space.unit * f64::from((hi - lo).length() / 2.0) {
            0.0 => 1.0,
            radius => radius,
        };
        let yfov = 40f64.to_radians();
        let back = DVec3::new(0.0, 0.25, 1.0).normalize();
        let position = center + back * radius / (yfov / 2.0).sin();
        Self::look_at(position, center, DVec3::Y, Projection::Perspective { yfov })
            .expect("the view is neither vertical nor of zero length")
    }

    /// Whether both cameras have the same pose and projection, up to rounding in a file.
    pub fn sees_as(&self, other: &Self) -> bool {
        let near = |a: f64, b: f64| (a - b).abs() <= ROUNDED * a.abs();
        let scale = 1.0 + self.position.length();
        self.position.abs_diff_eq(other.position, ROUNDED * scale)
            && self.world_from_camera.abs_diff_eq(other.world_from_camera, ROUNDED)
            && match (self.projection, other.projection) {
                (Projection::Perspective { yfov: a }, Projection::Perspective { yfov: b }) => near(a, b),
                (Projection::Orthographic { ymag: a }, Projection::Orthographic { ymag: b }) => near(a, b),
                _ => false,
            }
    }

    /// Ray through image point (x, y) in [0, 1]², y down: (origin, unit direction) in world space.
    pub fn ray(&self, x: f64, y: f64, aspect: f64) -> (DVec3, DVec3) {
        let (sx, sy) = (2.0 * x - 1.0, 1.0 - 2.0 * y);
        match self.projection {
            Projection::Perspective { yfov } => {
                let half_height = (yfov / 2.0).tan();
                let direction = DVec3::new(sx * half_height * aspect, sy * half_height, -1.0);
                (self.position, (self.world_from_camera * direction).normalize())
            }
            Projection::Orthographic { ymag } => {
                let offset = DVec3::new(sx * ymag * aspect, sy * ymag, 0.0);
                (self.position + self.world_from_camera * offset, -self.world_from_camera.z_axis)
            }
        }
    }

    /// Projects a world-space point to image coordinates, in units of the image's size, y down; `None` behind a
    /// perspective camera. The inverse of [`Camera::ray`].
    pub fn project(&self, point: DVec3, aspect: f64) -> Option<[f64; 2]> {
        let seen = self.world_from_camera.transpose() * (point - self.position);
        let half_height = match self.projection {
            Projection::Perspective { yfov } if seen.z < 0.0 => -seen.z * (yfov / 2.0).tan(),
            Projection::Perspective { .. } => return None,
            Projection::Orthographic { ymag } => ymag,
        };
        Some([0.5 + 0.5 * seen.x / (half_height * aspect), 0.5 - 0.5 * seen.y / half_height])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_ray_meets_projects_back() {
        let (position, target) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.5, 0.0));
        for projection in [Projection::Perspective { yfov: 0.7 }, Projection::Orthographic { ymag: 2.0 }] {
            let camera = Camera::look_at(position, target, DVec3::Y, projection).unwrap();
            for (x, y) in [(0.5, 0.5), (0.0, 0.0), (0.9, 0.2)] {
                let (origin, direction) = camera.ray(x, y, 1.5);
                let [u, v] = camera.project(origin + 4.0 * direction, 1.5).unwrap();
                assert!((u - x).abs() < 1e-12 && (v - y).abs() < 1e-12, "({x}, {y}): ({u}, {v})");
            }
        }
        let camera = Camera::look_at(position, target, DVec3::Y, Projection::Perspective { yfov: 0.7 }).unwrap();
        assert_eq!(camera.project(position + (position - target), 1.5), None);
    }
}
