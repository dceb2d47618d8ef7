//! The parsed file; every index is checked where it is used.
//!
//! The gltf crate supplies the JSON types. Its accessors panic on input that its validation accepts; its validation
//! panics if POSITION refers to a missing accessor, and rejects `KHR_mesh_quantization`. So neither is used: items are
//! looked up with [`item`], which reports missing ones.
//!
//! Its types have single precision, which is too coarse for poses and for values that artists read back in a rig file.
//! So nodes, cameras and lights are parsed a second time, into our own types.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use gltf::json;
use gltf::json::validation::Checked;
use serde::Deserialize;

use super::container::{Container, buffer_bytes};
use super::light_entries::{AreaLightEntry, ImageLightEntry, LightEntry, ProfileEntry, ProfileInstance};
use super::light_extension::LightExtension;
use super::mend::mended;
use crate::error::{Error, Result};
use crate::scene::files;

/// A glTF file, parsed, with its buffers.
pub struct Document {
    pub path: PathBuf,
    pub root: json::Root,
    pub poses: Poses,
    pub buffers: Vec<Vec<u8>>,
    /// Lengths of the accessors without a buffer view that have been read.
    pub zeros: Mutex<(HashSet<usize>, usize)>,
    pub unpacked: Unpacked,
}

/// Decompressed data.
#[derive(Default)]
pub struct Unpacked {
    /// Appended to the file's own buffers.
    pub buffers: Vec<Vec<u8>>,
    /// Index into `buffers` of each decompressed buffer view.
    pub views: HashMap<usize, usize>,
}

/// The part of the file that is parsed in double precision.
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
    pub skins: Vec<SkinEntry>,
    #[serde(default)]
    extensions: RootExtensions,
}

#[derive(Deserialize)]
pub struct SceneRoots {
    #[serde(default)]
    pub nodes: Vec<usize>,
    pub extras: Option<serde_json::Value>,
    #[serde(default)]
    extensions: SceneExtensions,
}

#[derive(Deserialize, Default)]
struct SceneExtensions {
    #[serde(rename = "EXT_lights_image_based")]
    image_light: Option<LightIndex>,
}

#[derive(Deserialize)]
pub struct Node {
    pub name: Option<String>,
    #[serde(default)]
    pub children: Vec<usize>,
    /// Column-major.
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    /// x, y, z, w.
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    pub mesh: Option<usize>,
    pub camera: Option<usize>,
    pub skin: Option<usize>,
    /// Morph target weights; override the mesh's.
    pub weights: Option<Vec<f64>>,
    #[serde(default)]
    extensions: NodeExtensions,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct SkinEntry {
    /// Node indices.
    #[serde(default)]
    pub joints: Vec<usize>,
    /// Accessor with one matrix per joint; `None` is the identity.
    pub inverse_bind_matrices: Option<usize>,
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
#[serde(rename_all = "camelCase")]
pub struct Perspective {
    pub yfov: f64,
    pub aspect_ratio: Option<f64>,
}

#[derive(Deserialize)]
pub struct Orthographic {
    pub xmag: Option<f64>,
    pub ymag: f64,
}

#[derive(Deserialize, Default)]
struct RootExtensions {
    #[serde(rename = "KHR_lights_punctual", default)]
    lights: Lights<LightEntry>,
    #[serde(rename = "EXT_lights_area", default)]
    area_lights: Lights<AreaLightEntry>,
    #[serde(rename = "EXT_lights_ies", default)]
    profiles: Lights<ProfileEntry>,
    #[serde(rename = "EXT_lights_image_based", default)]
    image_lights: Lights<ImageLightEntry>,
}

#[derive(Deserialize)]
struct Lights<Entry> {
    #[serde(default = "Vec::new")]
    lights: Vec<Entry>,
}

impl<Entry> Default for Lights<Entry> {
    fn default() -> Self {
        Self { lights: Vec::new() }
    }
}

#[derive(Deserialize, Default)]
struct NodeExtensions {
    #[serde(rename = "KHR_lights_punctual")]
    light: Option<LightIndex>,
    #[serde(rename = "EXT_lights_area")]
    area_light: Option<LightIndex>,
    #[serde(rename = "EXT_lights_ies")]
    profile: Option<ProfileInstance>,
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    instances: Option<Instances>,
}

#[derive(Deserialize)]
struct LightIndex {
    light: usize,
}

/// `EXT_mesh_gpu_instancing`.
#[derive(Deserialize)]
pub struct Instances {
    #[serde(default)]
    pub attributes: InstanceAttributes,
}

/// Accessor indices.
#[derive(Deserialize, Default)]
#[serde(rename_all = "UPPERCASE")]
pub struct InstanceAttributes {
    pub translation: Option<usize>,
    pub rotation: Option<usize>,
    pub scale: Option<usize>,
}

/// Names of the extension for compressed buffer views.
pub const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

// The maximum size of a .glb. Many buffers may refer to one file.
const MAX_BUFFER_BYTES: usize = 1 << 32;

/// Supported entries of `extensionsRequired`.
const SUPPORTED: &[&str] = &[
    "EXT_lights_area",
    "EXT_lights_ies",
    "EXT_lights_image_based",
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_transform",
];

/// Unsupported extensions that are accepted in `extensionsRequired`: the scene is still recognizable without them.
/// Visible effects have warnings of their own.
const IGNORED: &[&str] = &[
    "KHR_animation_pointer",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_transmission",
    "KHR_materials_variants",
    "KHR_materials_volume",
];

impl Document {
    /// Parses the JSON and reads the buffers. Geometry stays compressed until [`Self::unpack`].
    pub fn parse(path: &Path, container: &Container) -> Result<Self> {
        let Container { json, bin } = container;
        let (root, poses) = parsed(path, json).or_else(|first| match mended(json) {
            Some(json) => parsed(path, &json),
            None => Err(first),
        })?;
        let mut document = Self {
            path: path.to_owned(),
            root,
            poses,
            buffers: Vec::new(),
            zeros: Mutex::default(),
            unpacked: Unpacked::default(),
        };
        document.check_version()?;
        document.check_extensions()?;
        let mut total_bytes = 0;
        for (index, buffer) in document.root.buffers.iter().enumerate() {
            let uri = buffer.uri.as_deref();
            let bytes = match uri {
                None if is_fallback(buffer) => Vec::new(),
                _ => buffer_bytes(path, index, uri, buffer.byte_length.0, bin.as_deref())?,
            };
            document.buffers.push(bytes);
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

    /// `items[index]`, or an error that names the item and what refers to it.
    pub fn item<'a, T>(&self, items: &'a [T], index: usize, kind: &str, asked_by: &str) -> Result<&'a T> {
        let there = items.len();
        items.get(index).ok_or_else(|| self.error(format!("{asked_by} names {kind} {index}, there are {there}")))
    }

    /// The value of an enumeration, or an error that names the item.
    pub fn valid<T: Copy>(&self, value: Checked<T>, what: &str) -> Result<T> {
        match value {
            Checked::Valid(value) => Ok(value),
            Checked::Invalid => Err(self.error(format!("{what} is not defined by glTF"))),
        }
    }

    pub fn lights(&self) -> &[LightEntry] {
        &self.poses.extensions.lights.lights
    }

    pub fn area_lights(&self) -> &[AreaLightEntry] {
        &self.poses.extensions.area_lights.lights
    }

    pub fn profiles(&self) -> &[ProfileEntry] {
        &self.poses.extensions.profiles.lights
    }

    pub fn image_lights(&self) -> &[ImageLightEntry] {
        &self.poses.extensions.image_lights.lights
    }

    /// Whether the file declares `extension`.
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
        let unknown = |all: &'_ [String]| -> Vec<String> {
            let is_known = |e: &str| SUPPORTED.contains(&e) || IGNORED.contains(&e);
            all.iter().filter(|e| !is_known(e)).map(|e| files::shortened(e)).collect()
        };
        let required = unknown(&self.root.extensions_required);
        if !required.is_empty() {
            let (names, is) = (required.join(", "), if required.len() == 1 { "is" } else { "are" });
            return Err(self.error(format!("requires {names}, which {is} not supported")));
        }
        let ignored = unknown(&self.root.extensions_used);
        if !ignored.is_empty() {
            tracing::warn!("{}: ignored {}", self.path.display(), ignored.join(", "));
        }
        Ok(())
    }
}

/// Whether a buffer holds only fallback data for programs that cannot decompress.
fn is_fallback(buffer: &json::Buffer) -> bool {
    let others = buffer.extensions.as_ref().map(|e| &e.others);
    others.is_some_and(|others| MESHOPT.iter().any(|name| others.contains_key(*name)))
}

fn parsed(path: &Path, json: &[u8]) -> Result<(json::Root, Poses)> {
    let root = serde_json::from_slice(json).map_err(|e| Error::import_from(path, "is not the JSON of a glTF", e))?;
    let poses = serde_json::from_slice(json)
        .map_err(|e| Error::import_from(path, "is not the JSON of a glTF's nodes, cameras and lights", e))?;
    Ok((root, poses))
}

impl SceneRoots {
    /// Index of the scene's light in `EXT_lights_image_based`.
    pub fn image_light(&self) -> Option<usize> {
        self.extensions.image_light.as_ref().map(|l| l.light)
    }
}

impl Node {
    /// Index of the node's light in an extension.
    pub fn light(&self, extension: LightExtension) -> Option<usize> {
        match extension {
            LightExtension::Punctual => self.extensions.light.as_ref().map(|l| l.light),
            LightExtension::Area => self.extensions.area_light.as_ref().map(|l| l.light),
            LightExtension::Profile => self.profile().map(|l| l.light),
        }
    }

    /// The extensions in which the node has a light.
    pub fn light_extensions(&self) -> impl Iterator<Item = LightExtension> {
        LightExtension::ALL.into_iter().filter(|&extension| self.light(extension).is_some())
    }

    pub fn profile(&self) -> Option<&ProfileInstance> {
        self.extensions.profile.as_ref()
    }

    pub fn instances(&self) -> Option<&InstanceAttributes> {
        self.extensions.instances.as_ref().map(|i| &i.attributes)
    }
}
