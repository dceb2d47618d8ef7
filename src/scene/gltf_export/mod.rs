//! Writes a rig's lights back to the glTF file of the scene.
//!
//! Edits the JSON in place, so that unknown content is preserved.

mod json;
mod lights;
mod pack;

use std::path::Path;

use super::gltf::container::{Container, MAGIC};
use super::gltf::document::Document;
use super::gltf::embedded_rig;
use super::gltf::light_extension::LightExtension;
use super::light_filter::Attached;
use super::{DomeMap, Light, LightFilter, Links, Rig, Scene};
use crate::error::{Error, Result};
use crate::storage::file;

/// Writes the source file of `scene` with `rig`'s lights in place of its own, as one `.glb` or `.gltf` with embedded
/// buffers and images.
///
/// A light with a source node returns to it, in the space of the node's parent; others get new nodes. Groups, stops,
/// switches and solo are folded into intensity and colour. Rectangles and disks are written as `EXT_lights_area`,
/// points with a profile as `EXT_lights_ies`, all others as `KHR_lights_punctual`. Other sizes and filters, `shadows`
/// and links have no counterpart in glTF; an `EXT_lights_image_based` of the file is kept as it is. The exact rig is
/// stored too, except camera and snapshots: relume restores it unless the lights of the file's nodes have been edited
/// since.
pub fn export_gltf(scene: &Scene, rig: &Rig, path: &Path) -> Result<()> {
    let has_extension =
        |path: &Path, extension: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
    if !has_extension(&scene.path, "glb") && !has_extension(&scene.path, "gltf") {
        return Err(Error::import(&scene.path, "only glTF scenes can be exported"));
    }
    let is_glb = has_extension(path, "glb");
    if !is_glb && !has_extension(path, "gltf") {
        return Err(Error::invalid(path.display().to_string(), "scenes are written as .glb or .gltf"));
    }
    let container = Container::read(&scene.path)?;
    let mut document = Document::parse(&scene.path, &container)?;
    document.unpack()?;
    let root: serde_json::Value = serde_json::from_slice(&container.json)
        .map_err(|e| Error::import_from(&scene.path, "is not the JSON of a glTF", e))?;
    let serde_json::Value::Object(mut root) = root else {
        return Err(Error::import(&scene.path, "is not a JSON object"));
    };
    lights::replace(&mut root, &document, &rig.with_solo_applied())?;
    embed_rig(&mut root, &document, rig, path);
    if let Some(light) = rig.lights.iter().find(|light| !light.shadows) {
        tracing::warn!("{}: glTF cannot store that \"{}\" casts no shadows", path.display(), light.name);
    }
    let is_more = |light: &&Light| light.links != Links::default() || !outside_extension(light).is_none();
    if let Some(light) = rig.lights.iter().find(is_more) {
        let path = path.display();
        tracing::warn!("{path}: glTF cannot store filters and links of \"{}\"; relume restores them", light.name);
    }
    let bytes = if is_glb {
        let bin = pack::into_one_buffer(&mut root, &document)?;
        glb(&serialized(&root, path)?, &bin, path)?
    } else {
        pack::into_data_uris(&mut root, &document)?;
        serialized(&root, path)?
    };
    file::write_whole(path, |out| out.write_all(&bytes).map_err(Error::io("write", path)))
}

fn serialized(root: &json::Object, path: &Path) -> Result<Vec<u8>> {
    serde_json::to_vec(root).map_err(|e| Error::Export { path: path.to_owned(), source: e.into() })
}

/// The filters of `light` that its extension does not hold.
fn outside_extension(light: &Light) -> LightFilter {
    let ies = light.filter.ies.clone().filter(|_| LightExtension::of(light) != LightExtension::Profile);
    LightFilter { ies, ..light.filter.clone() }
}

/// Stores the exact rig in the file at `path`, for [`embedded_rig`] to find. It may name files in the same folder only.
fn embed_rig(root: &mut json::Object, document: &Document, rig: &Rig, path: &Path) {
    let folder = path.parent().unwrap_or(Path::new(""));
    let warn = |light: &Light, file: &Path, effect: &str| {
        let (path, file, name) = (path.display(), file.display(), &light.name);
        tracing::warn!(
            "{path}: \"{name}\" {effect}: {file} lies outside of the folder; copy it there and name that file"
        );
    };
    let Some(scene) = json::element(root, "scenes", document.shown_scene()) else { return };
    if scene.get("extras").is_none_or(serde_json::Value::is_object) {
        let mut rig = Rig { camera: None, snapshots: Vec::new(), ..rig.clone() };
        for light in &mut rig.lights {
            light.filter = outside_extension(light);
            let within = light.filter.within(folder);
            let without = light.filter.ies.as_ref().filter(|_| within.ies.is_none()).map(Attached::path);
            let gobo = light.filter.gobo.as_ref().filter(|_| within.gobo.is_none()).map(|gobo| gobo.image.path());
            for file in without.into_iter().chain(gobo) {
                warn(light, file, "will be without its filter");
            }
            light.filter = within;
            if let Some(DomeMap::File(map)) = light.map.take_if(|map| map.as_file().is_some()) {
                let map = map.in_scene(&document.path);
                if map.is_within(folder) {
                    light.map = Some(DomeMap::File(map));
                } else {
                    warn(light, map.path(), "will be off");
                    light.enabled = false;
                }
            }
        }
        json::object(scene, "extras").insert(embedded_rig::KEY.into(), rig.to_toml(folder).into());
    }
}

/// Header, JSON chunk, and binary chunk if it is not empty [glTF 2.0, 4.4].
fn glb(json: &[u8], bin: &[u8], path: &Path) -> Result<Vec<u8>> {
    let padded = |length: usize| length.next_multiple_of(4);
    let bin_bytes = if bin.is_empty() { 0 } else { 8 + padded(bin.len()) };
    let total = 12 + 8 + padded(json.len()) + bin_bytes;
    let Ok(total) = u32::try_from(total) else {
        let reason = format!("{total} bytes are more than a .glb can hold");
        return Err(Error::invalid(path.display().to_string(), reason));
    };
    let mut bytes = Vec::with_capacity(total as usize);
    bytes.extend(MAGIC);
    bytes.extend(2u32.to_le_bytes());
    bytes.extend(total.to_le_bytes());
    let mut chunk = |kind: &[u8; 4], content: &[u8], padding: u8| {
        let end = bytes.len() + 8 + padded(content.len());
        // The total fits in 32 bits, so its parts do.
        bytes.extend((padded(content.len()) as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(content);
        bytes.resize(end, padding);
    };
    chunk(b"JSON", json, b' ');
    if !bin.is_empty() {
        chunk(b"BIN\0", bin, 0);
    }
    Ok(bytes)
}
