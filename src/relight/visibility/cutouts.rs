//! Surfaces with alpha in shadow maps: masked ones are drawn with their holes, blended ones discard texels at random.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use super::shadow_culling::{Cluster, Face, clusters, visible_ranges};
use crate::error::Result;
use crate::gpu::raster::DepthDraw;
use crate::gpu::{Buffer, Context, DepthKernel, Pass};
use crate::scene::{AlphaMode, Material, Scene, Wrap};
use crate::shared::gpu_struct::Read;
use crate::shared::*;

/// Triangles with alpha, and the pipeline that draws them.
pub struct Cutouts {
    kernel: DepthKernel<ShadowCutoutPush>,
    corners: Buffer<CutoutCorner>,
    cutouts: Buffer<Cutout>,
    texels: Buffer<u32>,
    clusters: Vec<Cluster>,
    /// Ranges of corners that each face draws; stored here to reuse the allocations.
    ranges: Vec<Vec<Range<u32>>>,
}

impl Cutouts {
    /// `triangles` index the mesh, in a spatially coherent order.
    pub fn new(context: &Arc<Context>, scene: &Scene, triangles: &[u32]) -> Result<Self> {
        let corners: Vec<CutoutCorner> = triangles.iter().flat_map(|&triangle| corners(scene, triangle)).collect();
        let order: Vec<[u32; 3]> = triangles.iter().map(|&t| scene.mesh.triangles[t as usize]).collect();
        let mut alphas = Alphas::default();
        let cutouts: Vec<Cutout> = scene.materials.iter().map(|material| alphas.cutout(scene, material)).collect();
        Ok(Self {
            kernel: DepthKernel::new(context)?,
            corners: Buffer::from_slice(context, "shadow positions (cutouts)", &corners)?,
            cutouts: Buffer::from_slice(context, "shadow cutouts", &cutouts)?,
            texels: Buffer::from_slice(context, "shadow alphas", &alphas.words())?,
            clusters: clusters(scene, &order),
            ranges: vec![Vec::new(); 6],
        })
    }

    pub fn kernel(&self) -> &DepthKernel<ShadowCutoutPush> {
        &self.kernel
    }

    /// Finds the clusters that each face of a light may see.
    pub fn cull(&mut self, faces: &[Face], light: &PackedLight) {
        for (face, ranges) in faces.iter().zip(&mut self.ranges) {
            visible_ranges(&self.clusters, face, light, ranges);
        }
    }

    /// Draw calls for the first `count` faces.
    pub fn draws(
        &self,
        pass: &mut Pass,
        faces: Read<ShadowFace>,
        count: usize,
    ) -> Vec<DepthDraw<'_, ShadowCutoutPush>> {
        let (corners, cutouts, texels) = (pass.read(&self.corners), pass.read(&self.cutouts), pass.read(&self.texels));
        let push = |face: usize| ShadowCutoutPush { corners, cutouts, texels, faces, face: face as u32, unused: 0 };
        (0..count).map(|face| DepthDraw { push: push(face), ranges: &self.ranges[face] }).collect()
    }
}

fn corners(scene: &Scene, triangle: u32) -> [CutoutCorner; 3] {
    let mesh = &scene.mesh;
    let cutout = mesh.triangle_materials[triangle as usize];
    let material = &scene.materials[cutout as usize];
    mesh.triangles[triangle as usize].map(|v| {
        let v = v as usize;
        let uv = material.base_color_texture.as_ref().map(|t| {
            let uv = mesh.uvs[t.uv_set].get(v).copied().unwrap_or_default();
            (t.uv_transform * uv.extend(1.0)).truncate()
        });
        let alpha = material.base_color.w * mesh.colors.get(v).map_or(1.0, |color| color.w);
        CutoutCorner { position: mesh.positions[v], alpha, uv: uv.unwrap_or_default(), cutout }
    })
}

/// Alphas of all textures at their finest level, concatenated.
#[derive(Default)]
struct Alphas {
    texels: Vec<u8>,
    /// First texel of each texture.
    first: HashMap<usize, u32>,
}

impl Alphas {
    fn cutout(&mut self, scene: &Scene, material: &Material) -> Cutout {
        let cutoff = match material.alpha_mode {
            AlphaMode::Mask { cutoff } => cutoff.max(0.0),
            AlphaMode::Blend => -1.0,
            AlphaMode::Opaque => 0.0,
        };
        let none = Cutout { first: NO_TEXELS, width: 1, height: 1, wrap_u: 0, wrap_v: 0, cutoff };
        match &material.base_color_texture {
            Some(t) if material.alpha_mode != AlphaMode::Opaque => {
                let finest = &scene.textures[t.texture].levels[0];
                let first = *self.first.entry(t.texture).or_insert_with(|| {
                    let first = self.texels.len() as u32;
                    self.texels.extend(finest.texels.iter().map(|texel| texel[3]));
                    first
                });
                let (width, height) = (finest.width as u32, finest.height as u32);
                Cutout { first, width, height, wrap_u: wrap(t.wrap[0]), wrap_v: wrap(t.wrap[1]), cutoff }
            }
            _ => none,
        }
    }

    /// Four texels per word, at least one word.
    fn words(mut self) -> Vec<u32> {
        self.texels.resize(self.texels.len().next_multiple_of(4).max(4), 0);
        self.texels.chunks_exact(4).map(|four| u32::from_le_bytes([four[0], four[1], four[2], four[3]])).collect()
    }
}

fn wrap(wrap: Wrap) -> u32 {
    match wrap {
        Wrap::Repeat => WRAP_REPEAT,
        Wrap::Mirror => WRAP_MIRROR,
        Wrap::Clamp => WRAP_CLAMP,
    }
}
