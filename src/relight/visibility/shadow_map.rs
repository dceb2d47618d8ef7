//! Shadow maps: draws depth as seen from each light and computes the visibility of samples by percentage-closer
//! filtering.
//!
//! Surfaces with alpha are drawn by a separate pipeline ([`crate::relight::visibility::cutouts`]).

use std::ops::Range;
use std::sync::Arc;

use super::cutouts::Cutouts;
use super::shadow_culling::{Cluster, clusters, faces_of, visible_ranges};
use crate::error::Result;
use crate::gpu::raster::DepthDraw;
use crate::gpu::{Buffer, Context, DepthArray, DepthKernel, Frame, Kernel};
use crate::scene::Light;
use crate::shared::{PackedLight, ShadowFace, ShadowPcfPush, ShadowPush, ViewSample};
use crate::trace::bvh::TracedScene;

/// Radius of the filter in texels: one tap and half a bilinear footprint, rounded up.
const FILTER_TEXELS: f32 = 2.0;
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
        let faces = faces_of(light, packed, self.radius, margin);
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
