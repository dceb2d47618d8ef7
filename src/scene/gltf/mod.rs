//! glTF 2.0: `.gltf` and `.glb` into a [`Scene`].

mod accessor;
pub mod area_lights;
pub mod container;
pub mod document;
mod draco;
pub mod embedded_rig;
mod ignored_counts;
pub mod image_lights;
mod instances;
mod light_entries;
pub mod light_extension;
mod lights;
mod material_extensions;
mod materials;
mod mend;
mod meshopt;
mod morph;
mod node_primitive;
pub mod nodes;
mod primitives;
pub mod profile_files;
mod profile_lights;
mod skins;
pub mod unpack;
mod vertices;

use std::path::Path;

use container::Container;
use document::Document;
use materials::Materials;

use super::mesh_builder::{MeshBuildError, MeshBuilder};
use super::{AlphaMode, MAX_IMAGE_SIDE, Material, Mesh, MeshSpace, Scene, Texture};
use crate::error::Result;

pub fn load(path: &Path) -> Result<Scene> {
    let mut document = Document::parse(path, &Container::read(path)?)?;
    document.unpack()?;
    let (placed, objects) = document.placed_nodes()?;
    let mut materials = Materials::new(&document);
    let mut builder = MeshBuilder::default();
    let ignored = primitives::import_meshes(&document, &placed, &mut materials, &mut builder)?;
    let rig = embedded_rig::rig(&document, document.import_lights(&placed)?);
    let cameras = document.import_cameras(&placed)?;
    let (mut materials, textures) = materials.finish()?;
    if materials.is_empty() {
        materials.push(Material::default());
    }
    let (mesh, space) = match builder.finish() {
        Ok(built) => built,
        Err(MeshBuildError::Empty(reason)) => {
            tracing::warn!("{}: {reason}, so there is nothing to see", document.path.display());
            (Mesh::default(), MeshSpace::WORLD)
        }
        Err(MeshBuildError::Wrong(reason)) => return Err(document.error(reason)),
    };
    ignored.warn(path);
    if !document.root.animations.is_empty() {
        tracing::warn!("{}: animations are not supported: nodes have their static transforms", path.display());
    }
    mark_opaque(&mut materials, &textures, &mesh);
    let image_size = image_size(&document);
    Ok(Scene { path: path.to_owned(), mesh, space, materials, objects, textures, cameras, rig, image_size })
}

/// Blending materials with full alpha, as many exporters write them, become opaque, which is cheaper.
fn mark_opaque(materials: &mut [Material], textures: &[Texture], mesh: &Mesh) {
    if mesh.colors.iter().any(|color| color.w < 1.0) {
        return;
    }
    let blending = materials.iter_mut().filter(|m| m.alpha_mode == AlphaMode::Blend);
    blending.filter(|m| m.has_full_alpha(textures)).for_each(|m| m.alpha_mode = AlphaMode::Opaque);
}

/// `extras.width/height` of the shown scene; warns about an invalid size.
fn image_size(document: &Document) -> Option<[u32; 2]> {
    let scene = document.poses.scenes.get(document.shown_scene())?;
    let extras = scene.extras.as_ref()?;
    let (width, height) = (extras.get("width")?, extras.get("height")?);
    let side = |value: &serde_json::Value| {
        let side = value.as_f64().filter(|s| s.fract() == 0.0 && (1.0..=f64::from(MAX_IMAGE_SIDE)).contains(s));
        side.map(|s| s as u32)
    };
    let size = side(width).zip(side(height)).map(|(w, h)| [w, h]);
    if size.is_none() {
        tracing::warn!("{}: the image size {width} x {height} is invalid and ignored", document.path.display());
    }
    size
}
