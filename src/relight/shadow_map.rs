//! Shadow maps: draws depth as seen from each light and computes the visibility of samples by percentage-closer
//! filtering.
//!
//! Surfaces with alpha are drawn by a separate pipeline ([`super::cutouts`]).
//!
//! Directional lights, spots of up to 45 degrees half-angle and lights far outside the scene need one map. Wider spots
//! and points need six cube faces. Clusters of triangles outside a face's frustum are not drawn.

use std::ops::Range;
use std::sync::Arc;

use glam::{Mat4, Vec3};

use super::cutouts::Cutouts;
use crate::error::Result;
use crate::gpu::raster::DepthDraw;
use crate::gpu::{Buffer, Context, DepthArray, DepthKernel, Frame, Kernel};
use crate::scene::{Light, LightKind, Scene};
use crate::shared::{PackedLight, ShadowFace, ShadowPcfPush, ShadowPush, ViewSample};
use crate::trace::bvh::TracedScene;

/// Triangles per cluster, the unit of culling.
const CLUSTER_SIZE: usize = 256;
/// Radius of the filter in texels: one tap and half a bilinear footprint, rounded up.
const FILTER_TEXELS: f32 = 2.0;
/// Maximum half-angle of a spot with a single map. Texels of wider maps are too uneven: at 80 degrees the measured
/// error is 6.7 %, against 3.5 % with cube faces.
const MAX_SINGLE_ANGLE: f64 = 45.0 * std::f64::consts::PI / 180.0;
/// Distance from the scene's centre, in scene radii, from which one face suffices for a light: the face is then no
/// wider than a cube face.
const FAR_RADII: f32 = 1.5;

/// Draws and looks up the shadow maps of one light at a time.
pub struct ShadowMaps {
    depth: DepthArray,
    draw: DepthKernel<ShadowPush>,
    pcf: Kernel<ShadowPcfPush>,
    /// x, y, z of each vertex.
    positions: Buffer<f32>,
    indices: Buffer<u32>,
    clusters: Vec<Cluster>,
    /// Triangles with alpha, if any.
    cutouts: Option<Cutouts>,
    /// Half the diagonal of the scene's bounds, whose centre is the origin of mesh space.
    radius: f32,
    /// Index ranges that each face draws; stored here to reuse the allocations.
    ranges: Vec<Vec<Range<u32>>>,
}

/// Triangles that are culled together, with their bounding sphere.
pub(super) struct Cluster {
    center: Vec3,
    radius: f32,
    indices: Range<u32>,
}

/// Frustum of one face of a map.
pub(super) struct Face {
    /// Right, up, and towards the scene.
    axes: [Vec3; 3],
    /// Tangent of the half-angle; 0: orthographic.
    tangent: f32,
}

impl ShadowMaps {
    /// `size`: side of a map in texels.
    pub fn new(context: &Arc<Context>, scene: &TracedScene, size: u32) -> Result<Self> {
        let mesh = &scene.mesh;
        // The BVH's order is spatially coherent: clusters are compact and vertices are reused soon.
        let (passable, opaque): (Vec<u32>, Vec<u32>) =
            scene.bvh.triangle_order().partition(|&triangle| scene.is_masked(triangle));
        let order: Vec<[u32; 3]> = opaque.iter().map(|&t| mesh.triangles[t as usize]).collect();
        let cutouts = || Cutouts::new(context, scene, &passable);
        Ok(Self {
            depth: DepthArray::new(context, "shadow map", size, 6)?,
            draw: DepthKernel::new(context)?,
            pcf: Kernel::new(context, ())?,
            positions: Buffer::from_slice(context, "shadow positions", bytemuck::cast_slice(&mesh.positions))?,
            indices: Buffer::from_slice(context, "shadow indices", bytemuck::cast_slice(&order))?,
            clusters: clusters(scene, &order),
            cutouts: if passable.is_empty() { None } else { Some(cutouts()?) },
            radius: scene.bvh.radius,
            ranges: vec![Vec::new(); 6],
        })
    }

    /// Draws the maps of `light` and looks up `lists` in them: pairs of samples and the buffer for their visibility.
    pub fn run(
        &mut self,
        frame: &mut Frame,
        light: &Light,
        packed: &PackedLight,
        lists: &[(&Buffer<ViewSample>, &Buffer<u32>)],
    ) {
        let margin = 1.0 + 2.0 * FILTER_TEXELS / self.depth.size() as f32;
        let faces = faces_of(light, packed.position, self.radius, margin);
        let matrices: Vec<ShadowFace> = faces
            .iter()
            .map(|face| ShadowFace { clip_from_mesh: face.clip_from_mesh(packed.position, self.radius) })
            .collect();
        frame.cpu("cull shadow casters", || {
            for (face, ranges) in faces.iter().zip(&mut self.ranges) {
                visible_ranges(&self.clusters, face, packed, ranges);
            }
            if let Some(cutouts) = &mut self.cutouts {
                cutouts.cull(&faces, packed);
            }
        });
        let uploaded = frame.upload(&matrices);

        let mut pass = frame.pass("draw shadow map");
        let positions = pass.read(&self.positions);
        let draws: Vec<DepthDraw<ShadowPush>> = (0..faces.len())
            .map(|face| DepthDraw {
                push: ShadowPush { positions, faces: uploaded, face: face as u32, unused: 0 },
                ranges: &self.ranges[face],
            })
            .collect();
        let cutouts = self.cutouts.as_ref().map(|cutouts| (cutouts, cutouts.draws(&mut pass, uploaded, faces.len())));
        let unindexed = cutouts.as_ref().map(|(cutouts, draws)| (cutouts.kernel(), &draws[..]));
        pass.draw_depth(&self.depth, (&self.draw, &self.indices, &draws), unindexed);

        for &(samples, visibility) in lists {
            let mut pass = frame.pass("look up shadow map");
            pass.sample(&self.depth);
            let push = ShadowPcfPush {
                samples: pass.read(samples),
                faces: uploaded,
                visibility: pass.write(visibility),
                light_position: packed.position,
                face_count: faces.len() as u32,
                sample_count: samples.len() as u32,
                texel: 1.0 / self.depth.size() as f32,
            };
            pass.dispatch(&self.pcf, &push, push.sample_count.div_ceil(4));
        }
    }
}

/// Clusters of consecutive triangles in `order`.
pub(super) fn clusters(scene: &Scene, order: &[[u32; 3]]) -> Vec<Cluster> {
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

/// Faces of a light at `position` for a scene of `radius` around the origin; mesh space. `margin` widens them for the
/// filter.
fn faces_of(light: &Light, position: Vec3, radius: f32, margin: f32) -> Vec<Face> {
    let single = |forward: Vec3, tangent: f32| {
        let (right, up) = forward.any_orthonormal_pair();
        vec![Face { axes: [right, up, forward], tangent }]
    };
    // For a light far enough outside, one face covers the scene.
    let distance = position.length();
    let whole =
        (distance > FAR_RADII * radius).then(|| radius / (distance - radius).sqrt() / (distance + radius).sqrt());
    match light.kind {
        LightKind::Directional => single(light.direction.as_vec3(), 0.0),
        LightKind::Spot
            if light.outer_angle <= MAX_SINGLE_ANGLE
                && whole.is_none_or(|whole| light.outer_angle.tan() < f64::from(whole)) =>
        {
            single(light.direction.as_vec3(), (light.outer_angle.tan() as f32).max(1e-6) * margin)
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
    fn clip_from_mesh(&self, light: Vec3, radius: f32) -> Mat4 {
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
pub(super) fn visible_ranges(clusters: &[Cluster], face: &Face, light: &PackedLight, ranges: &mut Vec<Range<u32>>) {
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
