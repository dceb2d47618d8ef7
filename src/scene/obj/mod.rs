//! Wavefront OBJ and MTL into a [`Scene`]: triangles and materials, no lights, no camera.
//!
//! The tobj crate panics on a `Kd` of fewer than three numbers, shifts texture coordinates and normals where only some
//! faces have them, turns polylines into polygons and knows no line numbers; hence a reader of our own.

mod materials;
mod parse;
mod triangulate;

use std::collections::HashMap;
use std::path::Path;

use glam::{Vec2, Vec3, Vec4};

use super::mesh_builder::{MeshBuilder, Part};
use super::{Material, Rig, Scene, files};
use crate::error::{Error, Result};
use materials::Library;
use parse::{Corner, Obj};

pub fn load(path: &Path) -> Result<Scene> {
    let bytes = files::read(path)?;
    let obj = Obj::parse(&String::from_utf8_lossy(&bytes)).map_err(|reason| Error::import(path, reason))?;
    let mut library = Library::default();
    for line in &obj.libraries {
        library.read(path, line)?;
    }
    let mut builder = MeshBuilder::default();
    let mut materials = Vec::new();
    for (name, faces) in &obj.faces {
        let material = match library.get(name) {
            Some(material) => material,
            None => {
                if !name.is_empty() {
                    tracing::warn!("{}: there is no material \"{name}\"", path.display());
                }
                materials::default(name)
            }
        };
        // Faces without normals are flat, those with normals aren't: two kinds of parts.
        for flat in [false, true] {
            let faces = faces.iter().filter(|face| face.iter().any(|c| c.normal.is_none()) == flat);
            let part = part(&obj, faces, flat, &material, materials.len() as u32);
            builder.add(part);
        }
        materials.push(material);
    }
    let textures = library.into_textures();
    let (mesh, origin) = builder.finish().map_err(|reason| Error::import(path, reason))?;
    Ok(Scene {
        path: path.to_owned(),
        mesh,
        origin,
        materials,
        textures,
        cameras: Vec::new(),
        rig: Rig::default(),
        image_size: None,
    })
}

fn part<'a>(
    obj: &Obj,
    faces: impl Iterator<Item = &'a Vec<Corner>>,
    flat: bool,
    material: &Material,
    material_index: u32,
) -> Part {
    let mut part = Part { material: material_index, ..Part::default() };
    part.tangents_from = material.normal_texture.as_ref().map(|t| t.uv_set);
    let textured = material.textures().next().is_some();
    let colored = !obj.colors.is_empty();
    let mut numbers = HashMap::new();
    for face in faces {
        let mut vertex = |corner: &Corner| {
            let next = part.positions.len() as u32;
            let normal = corner.normal.filter(|_| !flat);
            *numbers.entry((corner.position, corner.uv, normal)).or_insert_with(|| {
                part.positions.push(obj.positions[corner.position]);
                if let Some(normal) = normal {
                    part.normals.push(obj.normals[normal]);
                }
                if textured {
                    // OBJ's v grows upwards, glTF's and ours downwards.
                    let uv = corner.uv.map_or(Vec2::ZERO, |i| obj.uvs[i]);
                    part.uvs[0].push(Vec2::new(uv.x, 1.0 - uv.y));
                }
                if colored {
                    let color = obj.colors.get(corner.position).copied().flatten();
                    part.colors.push(color.unwrap_or(Vec3::ONE).extend(1.0).clamp(Vec4::ZERO, Vec4::ONE));
                }
                next
            })
        };
        let vertices: Vec<u32> = face.iter().map(&mut vertex).collect();
        let outline: Vec<_> = face.iter().map(|c| obj.positions[c.position]).collect();
        part.triangles.extend(triangulate::polygon(&outline).into_iter().map(|t| t.map(|i| vertices[i])));
    }
    part
}
