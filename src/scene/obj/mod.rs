//! Wavefront OBJ and MTL into a [`Scene`]: triangles and materials, no lights, no camera.

mod images;
mod materials;
mod sanitize;
mod texture_map;
mod winding;
mod words;

use std::collections::HashMap;
use std::iter;
use std::ops::Range;
use std::path::Path;

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;
use glam::{DVec3, Vec2};
use tobj::{LoadOptions, Mesh};

use super::mesh_builder::MeshBuilder;
use super::mesh_part::MeshPart;
use super::texture::srgb_to_linear;
use super::{Material, Object, Rig, Scene, files};
use crate::error::{Error, Result};
use materials::Library;
use sanitize::Face;
use words::text_of;

pub fn load(path: &Path) -> Result<Scene> {
    let bytes = files::read(path)?;
    let obj = sanitize::obj(&text_of(&bytes)).map_err(|reason| Error::import(path, reason))?;
    let mut library = Library::default();
    for statement in &obj.libraries {
        library.read(path, statement)?;
    }
    // The options preserve polygons and separate indices for every attribute. Materials are assigned here, because tobj
    // discards names that it cannot find and requires libraries before their use.
    let no_materials = |_: &Path| Ok(Default::default());
    let (models, _) = tobj::load_obj_buf(&mut obj.text.as_bytes(), &LoadOptions::default(), no_materials)
        .map_err(|e| Error::import_from(path, "not an OBJ file", e))?;
    let mut mesh = models.into_iter().next().map(|model| model.mesh).unwrap_or_default();
    if mesh.vertex_color.iter().any(|&c| c > 1.0) {
        tracing::warn!("{}: vertex colours above 1 were taken for values from 0 to 255", path.display());
        mesh.vertex_color.iter_mut().for_each(|c| *c /= 255.0);
    }
    if mesh.vertex_color.iter().all(|&c| c == 1.0) {
        mesh.vertex_color.clear();
    }

    let mut polygons_of = vec![Vec::new(); obj.materials.len()];
    // Without arities, all faces are triangles.
    let mut arities = mesh.face_arities.iter().copied().chain(iter::repeat(3));
    let mut first = 0;
    let mut all_corners = Vec::with_capacity(obj.faces.len());
    for _ in &obj.faces {
        let corners = first..first + arities.next().expect("endless") as usize;
        first = corners.end;
        all_corners.push(corners);
    }
    assert_eq!(first, mesh.indices.len(), "tobj's faces differ from ours");
    let flipped = winding::flipped_faces(&mesh, &all_corners);
    if flipped.surface_count > 0 {
        let (path, count) = (path.display(), flipped.surface_count);
        tracing::warn!("{path}: {count} closed surfaces faced inwards and were flipped");
    }
    for (i, (face, corners)) in obj.faces.iter().zip(all_corners).enumerate() {
        let polygon = Polygon { face, corners, flips: flipped.winding[i], flips_normals: flipped.normals[i] };
        polygons_of[face.material].push(polygon);
    }

    let mut builder = MeshBuilder::default();
    let mut materials = Vec::new();
    for (name, polygons) in obj.materials.iter().zip(polygons_of).filter(|(_, polygons)| !polygons.is_empty()) {
        let material = library.get(name).unwrap_or_else(|| {
            if !name.is_empty() {
                tracing::warn!("{}: material \"{name}\" does not exist", path.display());
            }
            materials::default(name)
        });
        let without_uvs = polygons.iter().filter(|polygon| !polygon.face.has_uvs).count();
        if without_uvs > 0 && material.textures().next().is_some() {
            let path = path.display();
            tracing::warn!(
                "{path}: material \"{name}\": {without_uvs} faces lack texture coordinates for its textures"
            );
        }
        // Faces without normals are flat, those with normals are not: they form separate parts.
        for has_normals in [true, false] {
            let polygons = polygons.iter().filter(|polygon| polygon.face.has_normals == has_normals);
            builder.add(part(&mesh, polygons, &material, materials.len() as u32));
        }
        materials.push(material);
    }
    library.warn(path);
    let textures = library.into_textures();
    let (mesh, space) = builder.finish().map_err(|error| Error::import(path, error.reason()))?;
    Ok(Scene {
        path: path.to_owned(),
        mesh,
        space,
        materials,
        objects: vec![Object::default()],
        textures,
        cameras: Vec::new(),
        rig: Rig::default(),
        image_size: None,
    })
}

#[derive(Clone)]
struct Polygon<'a> {
    face: &'a Face,
    /// Range in the mesh's corners.
    corners: Range<usize>,
    flips: bool,
    flips_normals: bool,
}

/// Builds a part; either all or none of the polygons have normals.
fn part<'a>(
    mesh: &Mesh,
    polygons: impl Iterator<Item = &'a Polygon<'a>>,
    material: &Material,
    material_index: u32,
) -> MeshPart {
    let mut part = MeshPart { material: material_index, ..MeshPart::default() };
    part.tangents_from = material.normal_texture.as_ref().map(|t| t.uv_set);
    let textured = material.textures().next().is_some();
    let three = |values: &[f64], i: u32| DVec3::from_slice(&values[3 * i as usize..]);
    let mut numbers = HashMap::new();
    for Polygon { face, corners, flips, flips_normals } in polygons {
        let sign = if *flips_normals { -1.0 } else { 1.0 };
        let mut vertex = |corner: usize| {
            let next = part.positions.len() as u32;
            let position = mesh.indices[corner];
            let uv = face.has_uvs.then(|| mesh.texcoord_indices[corner]);
            let normal = face.has_normals.then(|| mesh.normal_indices[corner]);
            *numbers.entry((position, uv, normal, *flips_normals)).or_insert_with(|| {
                part.positions.push(three(&mesh.positions, position));
                part.normals.extend(normal.map(|i| sign * three(&mesh.normals, i).as_vec3()));
                if textured {
                    // OBJ's v points up, glTF's and ours down.
                    let turned = |i| Vec2::new(mesh.texcoords[2 * i] as f32, 1.0 - mesh.texcoords[2 * i + 1] as f32);
                    part.uvs[0].push(uv.map_or(Vec2::Y, |i| turned(i as usize)));
                }
                if !mesh.vertex_color.is_empty() {
                    let color = three(&mesh.vertex_color, position).clamp(DVec3::ZERO, DVec3::ONE);
                    part.colors.push(color.map(srgb_to_linear).as_vec3().extend(1.0));
                }
                next
            })
        };
        let vertices: Vec<u32> = corners.clone().map(&mut vertex).collect();
        let outline: Vec<DVec3> = mesh.indices[corners.clone()].iter().map(|&i| three(&mesh.positions, i)).collect();
        for [a, b, c] in triangulated(&outline).into_iter().map(|t| t.map(|i| vertices[i])) {
            part.triangles.push(if *flips { [a, c, b] } else { [a, b, c] });
        }
    }
    part
}

/// Triangulates a planar polygon, as indices of its corners with the same winding. Self-intersecting outlines lose some
/// triangles, those without area all.
fn triangulated(outline: &[DVec3]) -> Vec<[usize; 3]> {
    if outline.len() == 3 {
        return vec![[0, 1, 2]];
    }
    // Relative to the first corner: far from the origin the normal would be lost to rounding.
    let corners: Vec<[f64; 3]> = outline.iter().map(|&p| (p - outline[0]).to_array()).collect();
    let (mut flat, mut triangles) = (Vec::new(), Vec::new());
    if project3d_to_2d(&corners, corners.len(), &mut flat) {
        Earcut::new().earcut_slice(&flat, &[], &mut triangles);
    }
    triangles.as_chunks().0.to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> DVec3 {
        triangles.iter().map(|&[a, b, c]| (corners[b] - corners[a]).cross(corners[c] - corners[a]) / 2.0).sum()
    }

    #[test]
    fn concave_polygons_keep_their_area() {
        // An L, also started next to its inner corner, where a fan would leave the polygon.
        let l = [(0., 0.), (2., 0.), (2., 1.), (1., 1.), (1., 2.), (0., 2.)].map(|(x, y)| DVec3::new(x, 0.5, -y));
        let far = DVec3::new(4e5, 0.0, 5e6);
        for first in 0..6 {
            let mut corners = l.map(|p| p + far);
            corners.rotate_left(first);
            let triangles = triangulated(&corners);
            assert_eq!(triangles.len(), 4);
            assert!((area(&corners, &triangles) - DVec3::new(0.0, 3.0, 0.0)).length() < 1e-9);
            for t in &triangles {
                assert!(area(&corners, &[*t]).y > 0.0, "{triangles:?} from {first}");
            }
        }
    }

    #[test]
    fn nonsense_still_ends() {
        let bow = [DVec3::ZERO, DVec3::new(1., 1., 0.), DVec3::X, DVec3::Y];
        assert!(triangulated(&bow).len() <= 2);
        assert_eq!(triangulated(&[DVec3::ONE; 7]).len(), 0);
    }
}
