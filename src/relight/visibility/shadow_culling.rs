//! Faces of shadow maps, and the clusters of triangles that each may see.
//!
//! Directional lights, spots of up to 45 degrees half-angle and lights far outside the scene need one map. Wider spots
//! and points need six cube faces. Clusters of triangles outside a face's frustum are not drawn.

use std::ops::Range;

use glam::{Mat4, Vec3};

use crate::scene::{Light, LightKind, Scene};
use crate::shared::PackedLight;

/// Triangles per cluster, the unit of culling.
const CLUSTER_SIZE: usize = 256;
/// Maximum half-angle of a spot with a single map. Texels of wider maps are too uneven: at 80 degrees the measured
/// error is 6.7 %, against 3.5 % with cube faces.
const MAX_SINGLE_ANGLE: f64 = 45.0 * std::f64::consts::PI / 180.0;
/// Distance from the scene's centre, in scene radii, from which one face suffices for a light: the face is then no
/// wider than a cube face.
const FAR_RADII: f32 = 1.5;

/// Triangles that are culled together, with their bounding sphere.
pub struct Cluster {
    center: Vec3,
    radius: f32,
    indices: Range<u32>,
}

/// Frustum of one face of a map.
pub struct Face {
    /// Right, up, and towards the scene.
    axes: [Vec3; 3],
    /// Tangent of the half-angle; 0: orthographic.
    tangent: f32,
}

/// Clusters of consecutive triangles in `order`.
pub fn clusters(scene: &Scene, order: &[[u32; 3]]) -> Vec<Cluster> {
    let cluster = |(i, triangles): (usize, &[[u32; 3]])| {
        let corners = || triangles.iter().flatten().map(|&v| scene.mesh.positions[v as usize]);
        let (lo, hi) = corners().fold((Vec3::MAX, Vec3::MIN), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let center = (lo + hi) / 2.0;
        let radius = corners().map(|p| p.distance(center)).fold(0.0, f32::max);
        let first = (3 * i * CLUSTER_SIZE) as u32;
        Cluster { center, radius, indices: first..first + 3 * triangles.len() as u32 }
    };
    order.chunks(CLUSTER_SIZE).enumerate().map(cluster).collect()
}

/// Faces of `packed`, which is `light` or a point of it, for a scene of `radius` around the origin; mesh space.
/// `margin` widens them for the filter.
pub fn faces_of(light: &Light, packed: &PackedLight, radius: f32, margin: f32) -> Vec<Face> {
    let single = |forward: Vec3, tangent: f32| {
        let (right, up) = forward.any_orthonormal_pair();
        vec![Face { axes: [right, up, forward], tangent }]
    };
    // For a light far enough outside, one face covers the scene.
    let PackedLight { position, direction, .. } = *packed;
    let distance = position.length();
    let whole =
        (distance > FAR_RADII * radius).then(|| radius / (distance - radius).sqrt() / (distance + radius).sqrt());
    match light.kind {
        LightKind::Directional | LightKind::Dome => single(direction, 0.0),
        LightKind::Spot
            if light.outer_angle <= MAX_SINGLE_ANGLE
                && whole.is_none_or(|whole| light.outer_angle.tan() < f64::from(whole)) =>
        {
            single(direction, (light.outer_angle.tan() as f32).max(1e-6) * margin)
        }
        _ if let Some(whole) = whole => single(-position / distance, whole * margin),
        // Same order as in `cube_face` of shadow_pcf.comp.
        _ => [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z]
            .map(|forward| {
                let right = Vec3::new(forward.y, forward.z, forward.x).abs();
                Face { axes: [right, forward.cross(right), forward], tangent: margin }
            })
            .into(),
    }
}

impl Face {
    /// Projection with reversed depth: near plane / distance for perspective; orthographic depth falls from 1 to 0
    /// across a scene of `radius`.
    pub fn clip_from_mesh(&self, light: Vec3, radius: f32) -> Mat4 {
        let [right, up, forward] = self.axes;
        // Reversed floating-point depth: a near plane this close costs no precision.
        let near = 1e-6 * radius;
        let rows = if self.tangent > 0.0 {
            let scale = self.tangent.recip();
            let row = |axis: Vec3| (axis * scale).extend(-axis.dot(light) * scale);
            [row(right), row(up), Vec3::ZERO.extend(near), forward.extend(-forward.dot(light))]
        } else {
            let scale = radius.recip();
            let row = |axis: Vec3| (axis * scale).extend(0.0);
            [row(right), row(up), (-0.5 * scale * forward).extend(0.5), Vec3::ZERO.extend(1.0)]
        };
        Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose()
    }

    /// Whether a sphere around `center`, relative to the light, may intersect the frustum.
    fn sees(&self, center: Vec3, radius: f32) -> bool {
        if self.tangent == 0.0 {
            return true;
        }
        let [x, y, z] = self.axes.map(|axis| axis.dot(center));
        // Distance from a side plane is (|x| - z t) / sqrt(1 + t^2).
        let reach = radius * (1.0 + self.tangent * self.tangent).sqrt();
        z > -radius && x.abs() - z * self.tangent <= reach && y.abs() - z * self.tangent <= reach
    }
}

/// Index ranges of the clusters that `face` may see; adjacent ranges are merged.
pub fn visible_ranges(clusters: &[Cluster], face: &Face, light: &PackedLight, ranges: &mut Vec<Range<u32>>) {
    ranges.clear();
    let range = if light.inverse_range > 0.0 { light.inverse_range.recip() } else { f32::INFINITY };
    for cluster in clusters {
        let center = cluster.center - light.position;
        let in_range = face.tangent == 0.0 || center.length() - cluster.radius <= range;
        if !in_range || !face.sees(center, cluster.radius) {
            continue;
        }
        match ranges.last_mut() {
            Some(last) if last.end == cluster.indices.start => last.end = cluster.indices.end,
            _ => ranges.push(cluster.indices.clone()),
        }
    }
}
