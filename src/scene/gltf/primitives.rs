//! Triangles: from accessors to parts of the mesh.

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3, Vec4};
use gltf::json;
use json::accessor::Type;
use json::mesh::{Mode, Primitive, Semantic};
use json::validation::Checked;

use super::accessor::{F32, I8, I8_NORM, I16, I16_NORM, U8, U8_NORM, U16, U16_NORM};
use super::document::Document;
use super::materials::Materials;
use super::nodes::{Placed, is_singular};
use crate::error::Result;
use crate::scene::Material;
use crate::scene::mesh_builder::{MeshBuilder, Part};

// Nodes may show one mesh any number of times, so a small file can mean more than memory holds. 2^27 corners are
// 45 million triangles: 150 times the largest scene that we have, and 6 GB.
const MAX_CORNERS: usize = 1 << 27;

/// What was left out, to be said once.
#[derive(Default)]
pub struct LeftOut {
    pub points_and_lines: usize,
    pub missing_uvs: usize,
}

/// Adds all triangles of the meshes that `placed` nodes show.
pub fn import_meshes(
    document: &Document,
    placed: &[Placed],
    materials: &mut Materials,
    builder: &mut MeshBuilder,
) -> Result<LeftOut> {
    let mut left_out = LeftOut::default();
    let mut corners = 0;
    for Placed { node, world_from_node } in placed {
        let Some(index) = document.poses.nodes[*node].mesh else { continue };
        let name = document.node_name(*node);
        let mesh = document.item(&document.root.meshes, index, "mesh", &name)?;
        if !world_from_node.is_finite() || is_singular(world_from_node.matrix3) {
            return Err(document.error(format!("{name}: its transform is singular or not finite")));
        }
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            let what = format!("mesh {index}, primitive {i}");
            let mode = document.valid(primitive.mode, &format!("{what}: the mode"))?;
            if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
                left_out.points_and_lines += 1;
                continue;
            }
            let source = Source { document, primitive, what };
            corners += source.corner_count(mode)?;
            if corners > MAX_CORNERS {
                return Err(document.error(format!("{name}: more than {MAX_CORNERS} corners of triangles")));
            }
            builder.add(source.part(mode, world_from_node, materials, &mut left_out)?);
        }
    }
    Ok(left_out)
}

struct Source<'a> {
    document: &'a Document,
    primitive: &'a Primitive,
    what: String,
}

impl Source<'_> {
    fn attribute(&self, semantic: Semantic) -> Option<usize> {
        self.primitive.attributes.get(&Checked::Valid(semantic)).map(|index| index.value())
    }

    fn positions_accessor(&self) -> Result<usize> {
        let missing = || self.document.error(format!("{}: has no POSITION", self.what));
        self.attribute(Semantic::Positions).ok_or_else(missing)
    }

    /// An upper bound of the vertices that the primitive becomes, before anything is read.
    fn corner_count(&self, mode: Mode) -> Result<usize> {
        let vertices = self.document.accessor_count(self.positions_accessor()?, &self.what)?;
        let indices = match self.primitive.indices {
            Some(indices) => self.document.accessor_count(indices.value(), &self.what)?,
            None => vertices,
        };
        let corners_per_index = if mode == Mode::Triangles { 1 } else { 3 };
        Ok(vertices.saturating_add(indices.saturating_mul(corners_per_index)))
    }

    fn part(
        &self,
        mode: Mode,
        world_from_node: &DAffine3,
        materials: &mut Materials,
        left_out: &mut LeftOut,
    ) -> Result<Part> {
        let document = self.document;
        let (material_index, material) = materials.get(self.primitive.material.map(|m| m.value()), &self.what)?;
        let mut part = Part { material: material_index as u32, ..Part::default() };
        part.positions = self.positions(world_from_node)?;
        let count = part.positions.len();
        part.triangles = self.triangles(mode, count)?;
        if mirrors(world_from_node.matrix3) {
            part.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        if let Some(index) = self.attribute(Semantic::Normals) {
            let what = format!("{}: NORMAL", self.what);
            let normals = document.vectors::<3>(index, &what, &[F32], &[I8_NORM, I16_NORM])?;
            self.same_length(normals.len(), count, "NORMAL")?;
            let normal_matrix = normal_matrix(world_from_node.matrix3);
            part.normals = normals.into_iter().map(|n| direction(normal_matrix, Vec3::from_array(n))).collect();
        }
        for set in uv_sets(material).into_iter().enumerate().filter_map(|(set, used)| used.then_some(set)) {
            part.uvs[set] = match self.attribute(Semantic::TexCoords(set as u32)) {
                Some(index) => self.uvs(index, set, count)?,
                None => {
                    left_out.missing_uvs += 1;
                    vec![Vec2::ZERO; count]
                }
            };
        }
        if let Some(index) = self.attribute(Semantic::Colors(0)) {
            part.colors = self.colors(index, count)?;
        }
        part.tangents_from = material.normal_texture.as_ref().map(|t| t.uv_set);
        if part.tangents_from.is_some()
            && let Some(index) = self.attribute(Semantic::Tangents)
        {
            part.tangents = self.tangents(index, count, world_from_node.matrix3)?;
        }
        Ok(part)
    }

    fn positions(&self, world_from_node: &DAffine3) -> Result<Vec<DVec3>> {
        let what = format!("{}: POSITION", self.what);
        let quantized = [I8, I8_NORM, U8, U8_NORM, I16, I16_NORM, U16, U16_NORM];
        let positions = self.document.vectors::<3>(self.positions_accessor()?, &what, &[F32], &quantized)?;
        let world = |(i, p): (usize, &[f32; 3])| {
            let world = world_from_node.transform_point3(Vec3::from_array(*p).as_dvec3());
            if world.is_finite() {
                return Ok(world);
            }
            Err(self.document.error(format!("{what}: vertex {i} is not finite")))
        };
        positions.iter().enumerate().map(world).collect()
    }

    fn uvs(&self, index: usize, set: usize, count: usize) -> Result<Vec<Vec2>> {
        let name = format!("TEXCOORD_{set}");
        let what = format!("{}: {name}", self.what);
        let quantized = [I8, I8_NORM, U8, I16, I16_NORM, U16];
        let uvs = self.document.vectors::<2>(index, &what, &[F32, U8_NORM, U16_NORM], &quantized)?;
        self.same_length(uvs.len(), count, &name)?;
        // Texture lookups read what is not finite as 0; tangents could not.
        Ok(uvs.into_iter().map(|uv| Vec2::from_array(uv.map(|t| if t.is_finite() { t } else { 0.0 }))).collect())
    }

    fn colors(&self, index: usize, count: usize) -> Result<Vec<Vec4>> {
        let document = self.document;
        let what = format!("{}: COLOR_0", self.what);
        let forms = [F32, U8_NORM, U16_NORM];
        let colors: Vec<Vec4> = match document.accessor_type(index, &what)? {
            Type::Vec3 => {
                let rgb = document.vectors::<3>(index, &what, &forms, &[])?;
                rgb.into_iter().map(|c| Vec3::from_array(c).extend(1.0)).collect()
            }
            _ => document.vectors::<4>(index, &what, &forms, &[])?.into_iter().map(Vec4::from_array).collect(),
        };
        self.same_length(colors.len(), count, "COLOR_0")?;
        if let Some(i) = colors.iter().position(|c| !c.is_finite()) {
            return Err(document.error(format!("{what}: vertex {i} is not finite")));
        }
        Ok(colors.into_iter().map(|c| c.clamp(Vec4::ZERO, Vec4::ONE)).collect())
    }

    fn tangents(&self, index: usize, count: usize, world_from_node: DMat3) -> Result<Vec<Vec4>> {
        let what = format!("{}: TANGENT", self.what);
        let tangents = self.document.vectors::<4>(index, &what, &[F32], &[I8_NORM, I16_NORM])?;
        self.same_length(tangents.len(), count, "TANGENT")?;
        // A mirrored node mirrors the bitangent too, which cross(normal, tangent) doesn't show.
        let mirror = if mirrors(world_from_node) { -1.0 } else { 1.0 };
        let world = |t: [f32; 4]| direction(world_from_node, Vec3::new(t[0], t[1], t[2])).extend(t[3] * mirror);
        Ok(tangents.into_iter().map(world).collect())
    }

    fn triangles(&self, mode: Mode, vertex_count: usize) -> Result<Vec<[u32; 3]>> {
        let document = self.document;
        let indices = match self.primitive.indices {
            Some(indices) => document.indices(indices.value(), &format!("{}: indices", self.what))?,
            None => (0..vertex_count as u32).collect(),
        };
        if let Some(index) = indices.iter().find(|&&i| i as usize >= vertex_count) {
            let reason = format!("{}: index {index} is out of range, there are {vertex_count} vertices", self.what);
            return Err(document.error(reason));
        }
        let (i, n) = (&indices, indices.len());
        Ok(match mode {
            Mode::Triangles if !n.is_multiple_of(3) => {
                return Err(document.error(format!("{}: {n} indices are no whole triangles", self.what)));
            }
            // Every second triangle of a strip is turned, so that all face alike [glTF 2.0, 3.7.2.1].
            Mode::TriangleStrip => {
                (0..n.saturating_sub(2)).map(|k| [i[k], i[k + 1 + k % 2], i[k + 2 - k % 2]]).collect()
            }
            Mode::TriangleFan => (1..n.saturating_sub(1)).map(|k| [i[k], i[k + 1], i[0]]).collect(),
            _ => i.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        })
    }

    fn same_length(&self, length: usize, count: usize, attribute: &str) -> Result<()> {
        if length == count {
            return Ok(());
        }
        let reason = format!("{}: {length} of {attribute} for {count} of POSITION", self.what);
        Err(self.document.error(reason))
    }
}

/// Which sets of texture coordinates a material reads.
fn uv_sets(material: &Material) -> [bool; 2] {
    let mut used = [false; 2];
    material.textures().for_each(|t| used[t.uv_set] = true);
    used
}

/// `matrix` times a direction, unit length; zero if there is none, for the builder to mend.
fn direction(matrix: DMat3, v: Vec3) -> Vec3 {
    let turned = matrix * v.as_dvec3();
    // Two steps, so that tiny and huge scales don't leave the range of squares.
    let scaled = turned / turned.abs().max_element();
    scaled.try_normalize().map_or(Vec3::ZERO, |n| n.as_vec3())
}

/// The inverse transpose but for a positive factor: cofactors, which exist whatever the scale.
fn normal_matrix(matrix: DMat3) -> DMat3 {
    let largest = matrix.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    let (x, y, z) = (matrix.x_axis / largest, matrix.y_axis / largest, matrix.z_axis / largest);
    let sign = if mirrors(matrix) { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign
}

/// Whether a matrix turns left hands into right ones; its columns' lengths play no part, so nothing underflows.
fn mirrors(matrix: DMat3) -> bool {
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|c| c / c.abs().max_element());
    x.cross(y).dot(z) < 0.0
}
