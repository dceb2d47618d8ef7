//! The layered deep framebuffer: which surfaces each pixel sees, also in mirrors.

pub mod edges;
pub mod view_samples;
mod worst_case;

use glam::Vec3;

use self::view_samples::{EyeRays, Tiling};
use crate::scene::{Camera, Rig};
use crate::shared::{Brdf, ExtraPixel, ExtraSample, NO_BRDF, ViewSample};
use crate::trace::bvh::TracedScene;
use crate::trace::packet::{self, SamplePacket};

/// Resolution and sampling of a bake.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct BakeSettings {
    pub width: u32,
    pub height: u32,
    /// Layers of the deep framebuffer: 1 = no reflections.
    pub layers: u32,
    /// Number of eye paths of a pixel on an edge.
    pub samples: u32,
}

impl BakeSettings {
    /// Number of pixel tiles, the unit of progress that `bake` reports.
    pub fn tile_count(&self) -> usize {
        Tiling { width: self.width, height: self.height }.len() / packet::PACKET_SIZE
    }
}

/// What a matte tells apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Thing {
    /// Index into the scene's objects.
    Object,
    /// Index into the scene's materials.
    Material,
}

/// What a pixel sees of an emitter.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct EmittedPixel {
    /// Index into the scene's [`Emitters`](crate::scene::Emitters).
    pub emitter: u32,
    /// In tile order.
    pub pixel: u32,
    pub radiance: Vec3,
}

/// The layered deep framebuffer of one camera.
#[derive(Clone)]
pub struct DeepFramebuffer {
    pub camera: Camera,
    pub tiling: Tiling,
    /// Layer 1: one sample per pixel, tile by tile, padded to whole tiles. The extra samples follow.
    pub samples: Vec<ViewSample>,
    /// Of each sample; unit, mesh space.
    pub geometric_normals: Vec<Vec3>,
    /// Offset of the origin of shadow rays above each sample, along its geometric normal; mesh space.
    pub lifts: Vec<f32>,
    /// The same samples in the layout of the shadow tracer.
    pub packets: Vec<SamplePacket>,
    /// One per material, then those of textured samples.
    pub brdfs: Vec<Brdf>,
    /// Weight and layer of each extra sample.
    pub extra_samples: Vec<ExtraSample>,
    /// Indices into `extra_samples`, grouped by pixel.
    pub extra_indices: Vec<u32>,
    /// Pixels with extra samples, and pixels on edges.
    pub extra_pixels: Vec<ExtraPixel>,
    /// Pixels on edges, in tile order.
    pub edges: Vec<u32>,
    /// Number of eye paths of a pixel on an edge.
    pub samples_on_edges: u32,
    /// Pixels that see emitters, straight or in mirrors: by emitter, then in tile order.
    pub emission: Vec<EmittedPixel>,
    /// Number of samples in each layer.
    pub layers: Vec<usize>,
    /// The number of layers requested.
    pub asked_layers: u32,
    /// Whether any sample has a specular lobe.
    pub has_specular: bool,
}

impl DeepFramebuffer {
    /// Whether every index that a kernel follows is valid.
    pub(super) fn is_consistent(&self) -> bool {
        let pixels = self.pixel_stride();
        let extras = self.extra_samples.len();
        let brdf_exists = |s: &ViewSample| s.brdf == NO_BRDF || (s.brdf as usize) < self.brdfs.len();
        let list_exists = |p: &ExtraPixel| {
            (p.pixel as usize) < pixels && p.first as usize + p.count as usize <= self.extra_indices.len()
        };
        self.samples.len() == pixels + extras
            && self.geometric_normals.len() == self.samples.len()
            && self.lifts.len() == self.samples.len()
            && self.samples.iter().all(brdf_exists)
            && self.extra_pixels.iter().all(list_exists)
            && self.extra_indices.iter().all(|&i| (i as usize) < extras)
            && self.edges.is_sorted()
            && self.edges.last().is_none_or(|&pixel| (pixel as usize) < pixels)
            && self.emission.iter().all(|part| (part.pixel as usize) < pixels)
    }

    /// Indices of the samples that reflect direct light.
    pub fn reflecting(&self) -> Vec<u32> {
        (0..self.samples.len() as u32).filter(|&i| self.samples[i as usize].brdf != NO_BRDF).collect()
    }

    /// The same without specular lobes: surfaces keep what those leave to the diffuse lobe.
    #[must_use]
    pub fn without_specular(&self) -> Self {
        let brdfs = self.brdfs.iter().map(|brdf| Brdf { alpha: 0.0, ..*brdf }).collect();
        Self { brdfs, has_specular: false, ..self.clone() }
    }

    /// Objects (`of` is [`Thing::Object`]) or materials that each pixel sees directly, and how much of it each one
    /// covers: pixels row by row, things in the order in which its eye paths meet them.
    pub fn coverage(&self, scene: &TracedScene, of: Thing) -> Vec<Vec<(u32, f32)>> {
        let width = self.tiling.width as usize;
        let mut covers = vec![Vec::new(); width * self.tiling.height as usize];
        for (pixel, (point, share)) in view_samples::seen(scene, self) {
            let (x, y) = self.tiling.pixel(pixel as usize);
            let thing = match of {
                Thing::Object => scene.mesh.object(point.triangle) as u32,
                Thing::Material => point.material,
            };
            covers[y as usize * width + x as usize].push((thing, share));
        }
        covers
    }

    /// Number of layer-1 samples, padding included; the size of one image plane.
    pub fn pixel_stride(&self) -> usize {
        self.tiling.len()
    }
}

/// Bakes the view of `scene` from `camera`. The lights of `rig` determine the shadow edges to be anti-aliased.
pub fn bake(
    scene: &TracedScene,
    camera: &Camera,
    rig: &Rig,
    settings: &BakeSettings,
    progress: &(dyn Fn(usize) + Sync),
) -> DeepFramebuffer {
    let tiling = Tiling { width: settings.width, height: settings.height };
    let eye = EyeRays { scene, camera, tiling, layers: settings.layers };
    let framebuffer = view_samples::collect(&eye, settings, &[], progress);
    if settings.samples <= 1 {
        return framebuffer;
    }
    let edges = edges::find(&eye, &framebuffer, rig);
    view_samples::collect(&eye, settings, &edges, progress)
}
