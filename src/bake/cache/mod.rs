//! Baked data on disk, keyed by content: safetensors files, which NumPy opens too, with a checksum over their data.

mod framebuffer;
mod transfer;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use bytemuck::Pod;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};

pub use self::framebuffer::{load, store};
pub use self::transfer::{load_transfer, store_transfer, transfer_key};

use super::BakeSettings;
use crate::error::{Error, Result};
use crate::image::file::write_bytes;
use crate::scene::{Camera, Rig, Scene};

/// Counts changes of what a file holds.
const FORMAT: &str = "4";

/// Name of what a bake depends on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key(String);

/// One file of the cache.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Entry {
    pub path: PathBuf,
    pub scene: String,
    /// Deep framebuffer or transfer.
    pub what: String,
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

/// Everything in a cache directory.
pub fn list(dir: &Path) -> Result<Vec<Entry>> {
    let mut entries = Vec::new();
    for path in files(dir)? {
        let bytes = std::fs::read(&path).map_err(Error::io("read", &path))?;
        let metadata =
            SafeTensors::read_metadata(&bytes).ok().and_then(|(_, m)| m.metadata().clone()).unwrap_or_default();
        let field = |name: &str| metadata.get(name).cloned().unwrap_or("?".into());
        let size = format!("{}x{}", field("width"), field("height"));
        let [scene, what] = [field("scene"), field("what")];
        entries.push(Entry { path, scene, what, size, bytes: bytes.len() as u64 });
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

/// The file of a key, unless `decode` finds it damaged or of another version.
fn read<T>(dir: &Path, key: &Key, decode: impl Fn(&[u8]) -> Option<T>) -> Option<T> {
    let path = file(dir, key);
    let bytes = std::fs::read(&path).ok()?;
    let decoded = decode(&bytes);
    if decoded.is_none() {
        tracing::warn!("{} is damaged or of another version: baking anew", path.display());
    }
    decoded
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

/// Writes one file: tensors by name, type and columns.
struct Writer<'a> {
    tensors: Vec<(String, Dtype, usize, &'a [u8])>,
}

impl<'a> Writer<'a> {
    fn add<T: Pod>(&mut self, name: impl Into<String>, dtype: Dtype, columns: usize, data: &'a [T]) {
        self.tensors.push((name.into(), dtype, columns, bytemuck::cast_slice(data)));
    }

    fn write(&self, path: &Path, metadata: &[(&str, String)]) -> Result<()> {
        let dir = path.parent().expect("files of the cache lie in it");
        std::fs::create_dir_all(dir).map_err(Error::io("create", dir))?;
        let encode_error = |e: safetensors::SafeTensorError| Error::Export { path: path.into(), source: e.into() };
        let mut views = Vec::new();
        let mut hasher = blake3::Hasher::new();
        for (name, dtype, columns, bytes) in &self.tensors {
            let rows = bytes.len() / (columns * dtype.bitsize() / 8);
            hasher.update_rayon(bytes);
            views.push((name, TensorView::new(*dtype, vec![rows, *columns], bytes).map_err(encode_error)?));
        }
        let ours = [("relume", FORMAT.to_owned()), ("blake3", hasher.finalize().to_hex().to_string())];
        let all = ours.iter().chain(metadata).map(|(k, v)| ((*k).to_owned(), v.clone()));
        let bytes = serialize(views, Some(all.collect())).map_err(encode_error)?;
        write_bytes(path, &bytes)
    }
}

/// Reads one file. Tensors are asked for in the order in which they were added, all of them, since that is the order of
/// the checksum.
struct Reader<'a> {
    tensors: SafeTensors<'a>,
    metadata: HashMap<String, String>,
    hasher: blake3::Hasher,
}

impl<'a> Reader<'a> {
    fn new(bytes: &'a [u8]) -> Option<Self> {
        let (_, header) = SafeTensors::read_metadata(bytes).ok()?;
        let metadata = header.metadata().clone()?;
        Some(Self { tensors: SafeTensors::deserialize(bytes).ok()?, metadata, hasher: blake3::Hasher::new() })
    }

    fn take<T: Pod>(&mut self, name: &str) -> Option<Vec<T>> {
        let data = self.tensors.tensor(name).ok()?.data();
        self.hasher.update_rayon(data);
        elements(data)
    }

    fn field<T: std::str::FromStr>(&self, name: &str) -> Option<T> {
        self.metadata.get(name)?.parse().ok()
    }

    /// Whether version and checksum fit.
    fn is_whole(&self) -> bool {
        let is = |name: &str, value: &str| self.metadata.get(name).is_some_and(|v| v == value);
        is("relume", FORMAT) && is("blake3", &self.hasher.finalize().to_hex())
    }
}

fn elements<T: Pod>(bytes: &[u8]) -> Option<Vec<T>> {
    bytes.len().is_multiple_of(size_of::<T>()).then(|| bytemuck::pod_collect_to_vec(bytes))
}
