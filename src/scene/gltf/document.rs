//! The parsed file: every index checked where it is followed.
//!
//! The gltf crate supplies the JSON types. Its accessors panic on what its validation lets through, and its validation
//! panics itself when POSITION names an accessor that isn't there and refuses `KHR_mesh_quantization`. So nothing
//! here calls either: items are looked up with [`item`], which knows what to say when there is none.
//!
//! Its types hold single precision, which is too coarse for poses and for what artists read back in a rig file, so
//! nodes, cameras and lights are read a second time, into types of our own.

use std::path::{Path, PathBuf};

use gltf::json;
use gltf::json::validation::Checked;
use serde::Deserialize;

use super::container::{Container, buffer_bytes};
use crate::error::{Error, Result};

pub struct Document {
    pub path: PathBuf,
    pub root: json::Root,
    pub poses: Poses,
    pub buffers: Vec<Vec<u8>>,
}

/// The part of the file that is read in double precision.
#[derive(Deserialize)]
pub struct Poses {
    pub scene: Option<usize>,
    #[serde(default)]
    pub scenes: Vec<SceneRoots>,
    #[serde(default)]
    pub nodes: Vec<Node>,
    #[serde(default)]
    pub cameras: Vec<CameraEntry>,
    #[serde(default)]
    extensions: RootExtensions,
}

#[derive(Deserialize)]
pub struct SceneRoots {
    #[serde(default)]
    pub nodes: Vec<usize>,
    pub extras: Option<serde_json::Value>,
}

#[derive(Deserialize)]
pub struct Node {
    pub name: Option<String>,
    #[serde(default)]
    pub children: Vec<usize>,
    /// Column by column.
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    /// x, y, z, w.
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    pub mesh: Option<usize>,
    pub camera: Option<usize>,
    #[serde(default)]
    extensions: NodeExtensions,
}

#[derive(Deserialize)]
pub struct CameraEntry {
    pub name: Option<String>,
    #[serde(rename = "type")]
    pub kind: String,
    pub perspective: Option<Perspective>,
    pub orthographic: Option<Orthographic>,
}

#[derive(Deserialize)]
pub struct Perspective {
    pub yfov: f64,
}

#[derive(Deserialize)]
pub struct Orthographic {
    pub ymag: f64,
}

#[derive(Deserialize, Default)]
struct RootExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    lights: Option<Lights>,
}

#[derive(Deserialize)]
struct Lights {
    #[serde(default)]
    lights: Vec<LightEntry>,
}

#[derive(Deserialize, Default)]
struct NodeExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    light: Option<LightIndex>,
}

#[derive(Deserialize)]
struct LightIndex {
    light: usize,
}

/// `KHR_lights_punctual`.
#[derive(Deserialize)]
pub struct LightEntry {
    pub name: Option<String>,
    #[serde(rename = "type")]
    pub kind: String,
    pub color: Option<[f32; 3]>,
    pub intensity: Option<f64>,
    pub range: Option<f64>,
    #[serde(default)]
    pub spot: Spot,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase")]
pub struct Spot {
    pub inner_cone_angle: Option<f64>,
    pub outer_cone_angle: Option<f64>,
}

// What a .glb can hold. Buffers may name one file any number of times.
const MAX_BUFFER_BYTES: usize = 1 << 32;

/// What of `extensionsRequired` we have.
const SUPPORTED: &[&str] = &[
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

impl Document {
    pub fn parse(path: &Path, container: &Container) -> Result<Self> {
        let Container { json, bin } = container;
        let root: json::Root =
            serde_json::from_slice(json).map_err(|e| Error::import_from(path, "is not the JSON of a glTF", e))?;
        let poses = serde_json::from_slice(json)
            .map_err(|e| Error::import_from(path, "is not the JSON of a glTF's nodes, cameras and lights", e))?;
        let mut document = Self { path: path.to_owned(), root, poses, buffers: Vec::new() };
        document.check_version()?;
        document.check_extensions()?;
        let mut total_bytes = 0;
        for (index, buffer) in document.root.buffers.iter().enumerate() {
            let uri = buffer.uri.as_deref();
            document.buffers.push(buffer_bytes(path, index, uri, buffer.byte_length.0, bin.as_deref())?);
            total_bytes += document.buffers[index].len();
            if total_bytes > MAX_BUFFER_BYTES {
                return Err(document.error(format!("buffer {index}: more than {MAX_BUFFER_BYTES} bytes together")));
            }
        }
        Ok(document)
    }

    pub fn error(&self, reason: impl Into<String>) -> Error {
        Error::import(&self.path, reason)
    }

    /// `items[index]`, or an error saying who asked for what.
    pub fn item<'a, T>(&self, items: &'a [T], index: usize, kind: &str, asked_by: &str) -> Result<&'a T> {
        let there = items.len();
        items.get(index).ok_or_else(|| self.error(format!("{asked_by} names {kind} {index}, there are {there}")))
    }

    /// An enumeration's value, or an error naming the item.
    pub fn valid<T: Copy>(&self, value: Checked<T>, what: &str) -> Result<T> {
        match value {
            Checked::Valid(value) => Ok(value),
            Checked::Invalid => Err(self.error(format!("{what} is none that glTF has"))),
        }
    }

    pub fn lights(&self) -> &[LightEntry] {
        self.poses.extensions.lights.as_ref().map_or(&[], |l| &l.lights)
    }

    /// Whether `extension` is declared.
    pub fn uses(&self, extension: &str) -> bool {
        self.root.extensions_used.iter().chain(&self.root.extensions_required).any(|e| e == extension)
    }

    fn check_version(&self) -> Result<()> {
        let asset = &self.root.asset;
        let (version, minimum) = (&asset.version, asset.min_version.as_deref().unwrap_or("2.0"));
        if !version.starts_with("2.") || minimum != "2.0" {
            return Err(self.error(format!("is glTF {version} (at least {minimum}), expected 2.0")));
        }
        Ok(())
    }

    fn check_extensions(&self) -> Result<()> {
        let unknown = |e: &&String| !SUPPORTED.contains(&e.as_str());
        if let Some(required) = self.root.extensions_required.iter().find(unknown) {
            return Err(self.error(format!("requires {required}, which is not supported")));
        }
        let ignored: Vec<&str> = self.root.extensions_used.iter().filter(unknown).map(String::as_str).collect();
        if !ignored.is_empty() {
            tracing::warn!("{}: ignored {}", self.path.display(), ignored.join(", "));
        }
        Ok(())
    }
}

impl Node {
    pub fn light(&self) -> Option<usize> {
        self.extensions.light.as_ref().map(|l| l.light)
    }
}
