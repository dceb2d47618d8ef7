//! The deep framebuffer on disk.

use std::path::Path;

use glam::Vec3;
use safetensors::tensor::Dtype;

use super::{Inputs, Key, Reader, Writer, file, inputs, read};
use crate::bake::framebuffer::view_samples::{Tiling, pack};
use crate::bake::{BakeSettings, DeepFramebuffer};
use crate::error::Result;
use crate::scene::Camera;
use crate::shared::{Brdf, NO_BRDF, ViewSample};

/// Loads a bake. A file that is damaged or of another format version counts as absent.
pub fn load(dir: &Path, key: &Key, camera: &Camera, settings: &BakeSettings) -> Option<DeepFramebuffer> {
    let framebuffer = read(dir, key, |reader| decode(reader, camera, settings))?;
    let packets =
        pack(&framebuffer.samples, &framebuffer.geometric_normals, &framebuffer.lifts, framebuffer.tiling.len());
    Some(DeepFramebuffer { packets, ..framebuffer })
}

/// Stores a bake of `inputs`, the scene called `name`.
pub fn store(dir: &Path, inputs: &Inputs, name: &str, framebuffer: &DeepFramebuffer) -> Result<()> {
    let mut writer = Writer { tensors: Vec::new() };
    writer.add("view_samples", Dtype::U32, 8, &framebuffer.samples);
    writer.add("geometric_normals", Dtype::F32, 3, &framebuffer.geometric_normals);
    writer.add("lifts", Dtype::F32, 1, &framebuffer.lifts);
    writer.add("brdfs", Dtype::F32, 10, &framebuffer.brdfs);
    writer.add("extra_samples", Dtype::U32, 4, &framebuffer.extra_samples);
    writer.add("extra_indices", Dtype::U32, 1, &framebuffer.extra_indices);
    writer.add("extra_pixels", Dtype::U32, 4, &framebuffer.extra_pixels);
    writer.add("edges", Dtype::U32, 1, &framebuffer.edges);
    writer.add("emission", Dtype::U32, 5, &framebuffer.emission);
    writer.add("layers", Dtype::U64, 1, &framebuffer.layers);
    let metadata = [
        ("scene", name.to_owned()),
        ("what", "deep framebuffer".to_owned()),
        ("width", framebuffer.tiling.width.to_string()),
        ("height", framebuffer.tiling.height.to_string()),
        (inputs::METADATA, serde_json::to_string(inputs).expect("plain text")),
    ];
    writer.write(&file(dir, &inputs.key()), &metadata)
}

/// `None` if the file differs from what [`store`] writes. Kernels follow these indices, so every index is checked.
fn decode(reader: &Reader, camera: &Camera, settings: &BakeSettings) -> Option<DeepFramebuffer> {
    let samples: Vec<ViewSample> = reader.take("view_samples")?;
    let geometric_normals: Vec<Vec3> = reader.take("geometric_normals")?;
    let lifts = reader.take("lifts")?;
    let brdfs: Vec<Brdf> = reader.take("brdfs")?;
    let extra_samples = reader.take("extra_samples")?;
    let extra_indices: Vec<u32> = reader.take("extra_indices")?;
    let extra_pixels = reader.take("extra_pixels")?;
    let edges = reader.take("edges")?;
    let emission = reader.take("emission")?;
    let layers = reader.take("layers")?;
    let tiling = Tiling { width: settings.width, height: settings.height };
    let brdf_of = |s: &ViewSample| (s.brdf != NO_BRDF).then_some(s.brdf as usize);
    let has_specular = samples.iter().filter_map(brdf_of).any(|b| brdfs.get(b).is_some_and(|b| b.has_lobe()));
    let framebuffer = DeepFramebuffer {
        packets: Vec::new(),
        tiling,
        has_specular,
        camera: camera.clone(),
        samples,
        geometric_normals,
        lifts,
        brdfs,
        extra_samples,
        extra_indices,
        extra_pixels,
        edges,
        samples_on_edges: settings.samples,
        emission,
        layers,
        asked_layers: settings.layers,
    };
    framebuffer.is_consistent().then_some(framebuffer)
}
