//! [`Baked`] on disk, keyed by content: safetensors files, which NumPy opens too, with a checksum over their data.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use bytemuck::Pod;
use glam::Vec3;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};

use super::view_samples::{Tiling, pack};
use super::{BakeSettings, Baked};
use crate::error::{Error, Result};
use crate::image::file::write_bytes;
use crate::scene::{Camera, Rig, Scene};
use crate::shared::NO_BRDF;

/// Counts changes of what a file holds.
const FORMAT: &str = "2";

/// Name of what a bake depends on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key(String);

/// One file of the cache.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Entry {
    pub path: PathBuf,
    pub scene: String,
    pub size: String,
    pub bytes: u64,
}

/// Hashes everything that a bake looks at. Lights count only where shadow edges are anti-aliased.
pub fn key(scene: &Scene, camera: &Camera, rig: &Rig, settings: &BakeSettings) -> Key {
    let mut hasher = blake3::Hasher::new();
    let mut text = |what: String| {
        hasher.update(&(what.len() as u64).to_le_bytes());
        hasher.update(what.as_bytes());
    };
    text(format!("{} {FORMAT} {settings:?} {:?}", env!("CARGO_PKG_VERSION"), scene.origin));
    text(format!("{:?} {:?} {:?}", camera.position, camera.world_from_camera, camera.projection));
    text(format!("{:?}", scene.materials));
    if settings.samples > 1 {
        for light in rig.lights.iter().filter(|light| light.enabled && light.shadows) {
            text(format!("{:?}", light.pack(scene.origin)));
        }
    }
    let mesh = &scene.mesh;
    let arrays: [&[u8]; 8] = [
        bytemuck::cast_slice(&mesh.positions),
        bytemuck::cast_slice(&mesh.normals),
        bytemuck::cast_slice(&mesh.uvs[0]),
        bytemuck::cast_slice(&mesh.uvs[1]),
        bytemuck::cast_slice(&mesh.colors),
        bytemuck::cast_slice(&mesh.tangents),
        bytemuck::cast_slice(&mesh.triangles),
        bytemuck::cast_slice(&mesh.triangle_materials),
    ];
    for array in arrays {
        hasher.update(&(array.len() as u64).to_le_bytes());
        hasher.update_rayon(array);
    }
    for texture in &scene.textures {
        let finest = &texture.levels[0];
        hasher.update(format!("{:?} {} {}", texture.encoding, finest.width, finest.height).as_bytes());
        hasher.update_rayon(bytemuck::cast_slice(&finest.texels));
    }
    Key(hasher.finalize().to_hex()[..32].to_owned())
}

/// Looks a bake up. A file that is damaged or from another version counts as absent.
pub fn load(dir: &Path, key: &Key, settings: &BakeSettings) -> Option<Baked> {
    let path = file(dir, key);
    let bytes = std::fs::read(&path).ok()?;
    let baked = decode(&bytes, settings);
    if baked.is_none() {
        tracing::warn!("{} is damaged: baking anew", path.display());
    }
    baked
}

/// Stores a bake of the scene called `name`.
pub fn store(dir: &Path, key: &Key, name: &str, baked: &Baked) -> Result<()> {
    std::fs::create_dir_all(dir).map_err(Error::io("create", dir))?;
    let path = file(dir, key);
    let tensors: [(&str, Dtype, usize, &[u8]); 8] = [
        ("view_samples", Dtype::U32, 8, bytemuck::cast_slice(&baked.samples)),
        ("geometric_normals", Dtype::F32, 3, bytemuck::cast_slice(&baked.geometric_normals)),
        ("brdfs", Dtype::F32, 10, bytemuck::cast_slice(&baked.brdfs)),
        ("extra_samples", Dtype::U32, 4, bytemuck::cast_slice(&baked.extra_samples)),
        ("extra_indices", Dtype::U32, 1, bytemuck::cast_slice(&baked.extra_indices)),
        ("extra_pixels", Dtype::U32, 4, bytemuck::cast_slice(&baked.extra_pixels)),
        ("emission", Dtype::F32, 1, bytemuck::cast_slice(&baked.emission)),
        ("layers", Dtype::U64, 1, bytemuck::cast_slice(&baked.layers)),
    ];
    let encode_error = |e: safetensors::SafeTensorError| Error::Export { path: path.clone(), source: e.into() };
    let mut views = Vec::new();
    let mut hasher = blake3::Hasher::new();
    for (tensor, dtype, columns, bytes) in tensors {
        let rows = bytes.len() / (columns * dtype.bitsize() / 8);
        hasher.update_rayon(bytes);
        views.push((tensor, TensorView::new(dtype, vec![rows, columns], bytes).map_err(encode_error)?));
    }
    let metadata = HashMap::from(
        [
            ("relume", FORMAT.to_owned()),
            ("scene", name.to_owned()),
            ("width", baked.tiling.width.to_string()),
            ("height", baked.tiling.height.to_string()),
            ("blake3", hasher.finalize().to_hex().to_string()),
        ]
        .map(|(k, v)| (k.to_owned(), v)),
    );
    let bytes = serialize(views, Some(metadata)).map_err(encode_error)?;
    write_bytes(&path, &bytes)
}

/// Everything in a cache directory.
pub fn list(dir: &Path) -> Result<Vec<Entry>> {
    let mut entries = Vec::new();
    for path in files(dir)? {
        let bytes = std::fs::read(&path).map_err(Error::io("read", &path))?;
        let metadata =
            SafeTensors::read_metadata(&bytes).ok().and_then(|(_, m)| m.metadata().clone()).unwrap_or_default();
        let field = |name: &str| metadata.get(name).cloned().unwrap_or("?".into());
        let size = format!("{}x{}", field("width"), field("height"));
        entries.push(Entry { path, scene: field("scene"), size, bytes: bytes.len() as u64 });
    }
    Ok(entries)
}

/// Removes every bake from a cache directory; returns how many files and bytes that were.
pub fn prune(dir: &Path) -> Result<(usize, u64)> {
    let mut bytes = 0;
    let files = files(dir)?;
    for path in &files {
        bytes += path.metadata().map_or(0, |m| m.len());
        std::fs::remove_file(path).map_err(Error::io("remove", path))?;
    }
    Ok((files.len(), bytes))
}

fn file(dir: &Path, key: &Key) -> PathBuf {
    dir.join(format!("bake-{}.safetensors", key.0))
}

fn files(dir: &Path) -> Result<Vec<PathBuf>> {
    let listed = match std::fs::read_dir(dir) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        listed => listed.map_err(Error::io("list", dir))?,
    };
    let ours = |path: &PathBuf| {
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        name.starts_with("bake-") && name.ends_with(".safetensors")
    };
    let mut files: Vec<_> = listed.flatten().map(|entry| entry.path()).filter(ours).collect();
    files.sort();
    Ok(files)
}

/// `None` if anything is not as [`store`] writes it: kernels follow these indices, so every one is checked.
fn decode(bytes: &[u8], settings: &BakeSettings) -> Option<Baked> {
    let (_, header) = SafeTensors::read_metadata(bytes).ok()?;
    let metadata = header.metadata().as_ref()?;
    let tensors = SafeTensors::deserialize(bytes).ok()?;
    let mut hasher = blake3::Hasher::new();
    // In the order in which they were hashed.
    let mut tensor = |name: &str| {
        let data = tensors.tensor(name).ok()?.data();
        hasher.update_rayon(data);
        Some(data)
    };
    let samples = elements(tensor("view_samples")?)?;
    let geometric_normals: Vec<Vec3> = elements(tensor("geometric_normals")?)?;
    let brdfs: Vec<crate::shared::Brdf> = elements(tensor("brdfs")?)?;
    let extra_samples = elements(tensor("extra_samples")?)?;
    let extra_indices: Vec<u32> = elements(tensor("extra_indices")?)?;
    let extra_pixels = elements(tensor("extra_pixels")?)?;
    let emission: Vec<f32> = elements(tensor("emission")?)?;
    let layers = elements(tensor("layers")?)?;
    let tiling = Tiling { width: settings.width, height: settings.height };
    let whole = metadata.get("relume")? == FORMAT && *metadata.get("blake3")? == hasher.finalize().to_hex().to_string();
    let brdf_of = |s: &crate::shared::ViewSample| (s.brdf != NO_BRDF).then_some(s.brdf as usize);
    let has_specular = samples.iter().filter_map(brdf_of).any(|b| brdfs.get(b).is_some_and(|b| b.has_lobe()));
    let baked = Baked {
        packets: Vec::new(),
        tiling,
        has_specular,
        samples,
        geometric_normals,
        brdfs,
        extra_samples,
        extra_indices,
        extra_pixels,
        emission,
        layers,
        asked_layers: settings.layers,
    };
    if !whole || !baked.is_consistent() {
        return None;
    }
    let packets = pack(&baked.samples, &baked.geometric_normals, tiling.len());
    Some(Baked { packets, ..baked })
}

fn elements<T: Pod>(bytes: &[u8]) -> Option<Vec<T>> {
    bytes.len().is_multiple_of(size_of::<T>()).then(|| bytemuck::pod_collect_to_vec(bytes))
}
