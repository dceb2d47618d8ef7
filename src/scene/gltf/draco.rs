//! `KHR_draco_mesh_compression`: replaces Draco-compressed primitives by plain accessors.

use draco_core::{DecodeLimits, DecoderBuffer, Mesh, MeshDecoder};
use gltf::json;
use json::accessor::{Accessor, ComponentType, GenericComponentType, Type};
use json::mesh::Semantic;
use json::validation::{Checked, USize64};
use serde::Deserialize;

use super::document::Document;
use super::primitives::MAX_CORNERS;
use crate::error::{Error, Result};

pub const EXTENSION: &str = "KHR_draco_mesh_compression";

/// The extension's object in a primitive.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Packed {
    buffer_view: usize,
    /// Draco attribute ids by glTF attribute name.
    attributes: std::collections::BTreeMap<String, u32>,
}

/// Points, faces and bytes: 45 million triangles with 1 GiB of attributes; see `MAX_CORNERS` of primitives.
const LIMITS: [u64; 3] = [1 << 27, 45_000_000, 1 << 30];

impl Document {
    /// Gives every compressed primitive its own accessors, over decompressed buffers.
    pub fn unpack_draco(&mut self) -> Result<()> {
        let mut corners = 0;
        for mesh in 0..self.root.meshes.len() {
            for primitive in 0..self.root.meshes[mesh].primitives.len() {
                let extensions = self.root.meshes[mesh].primitives[primitive].extensions.as_ref();
                let Some(packed) = extensions.and_then(|e| e.others.get(EXTENSION)) else { continue };
                let what = format!("mesh {mesh}, primitive {primitive}: {EXTENSION}");
                let packed: Packed = serde_json::from_value(packed.clone())
                    .map_err(|e| Error::import_from(&self.path, what.clone(), e))?;
                corners += self.unpack_primitive(mesh, primitive, &packed, &what)?;
                if corners > MAX_CORNERS {
                    return Err(self.error(format!("{what}: more than {MAX_CORNERS} corners of triangles")));
                }
            }
        }
        Ok(())
    }

    /// Returns the number of vertices and corners.
    fn unpack_primitive(&mut self, mesh: usize, primitive: usize, packed: &Packed, what: &str) -> Result<usize> {
        let decoded = self.decode_draco(packed, what)?;
        let count = decoded.num_points();
        for (name, &id) in &packed.attributes {
            let Checked::Valid(semantic) = semantic(name) else { continue };
            let attribute = decoded.attribute_by_unique_id(id);
            let attribute = attribute.ok_or_else(|| self.error(format!("{what}: has no attribute {id} for {name}")))?;
            let attributes = &self.root.meshes[mesh].primitives[primitive].attributes;
            let Some(index) = attributes.get(&Checked::Valid(semantic.clone())).map(|index| index.value()) else {
                continue;
            };
            let accessor = self.item(&self.root.accessors, index, "accessor", what)?.clone();
            let GenericComponentType(component) = self.valid(accessor.component_type, what)?;
            let kind = self.valid(accessor.type_, what)?;
            let components = kind.multiplicity();
            if usize::from(attribute.num_components()) != components
                || !matches!(kind, Type::Scalar | Type::Vec2 | Type::Vec3 | Type::Vec4)
            {
                let there = attribute.num_components();
                return Err(self.error(format!("{what}: {name} has {there} components and an accessor of {kind:?}")));
            }
            let values = attribute.read_f32s(count, components);
            let bytes = values.into_iter().flat_map(|value| component_bytes(component, value)).collect();
            let accessor = self.unpacked_accessor(accessor, count, bytes);
            let attributes = &mut self.root.meshes[mesh].primitives[primitive].attributes;
            attributes.insert(Checked::Valid(semantic), json::Index::new(accessor as u32));
        }
        let corners = decoded.faces().iter().flatten().flat_map(|corner| corner.0.to_le_bytes()).collect();
        let indices = Accessor {
            buffer_view: None,
            byte_offset: None,
            count: USize64(0),
            component_type: Checked::Valid(GenericComponentType(ComponentType::U32)),
            extensions: None,
            extras: Default::default(),
            type_: Checked::Valid(Type::Scalar),
            min: None,
            max: None,
            name: None,
            normalized: false,
            sparse: None,
        };
        let indices = self.unpacked_accessor(indices, 3 * decoded.num_faces(), corners);
        let primitive = &mut self.root.meshes[mesh].primitives[primitive];
        primitive.indices = Some(json::Index::new(indices as u32));
        primitive.mode = Checked::Valid(json::mesh::Mode::Triangles);
        Ok(count + 3 * decoded.num_faces())
    }

    fn decode_draco(&self, packed: &Packed, what: &str) -> Result<Mesh> {
        let [points, faces, bytes] = LIMITS;
        let mut limits = DecodeLimits::default();
        (limits.max_points, limits.max_faces, limits.max_decoded_bytes) = (points, faces, bytes);
        let mut buffer = DecoderBuffer::new(self.view(packed.buffer_view, what)?).with_limits(limits);
        let mut mesh = Mesh::new();
        let decoded = MeshDecoder::new().decode(&mut buffer, &mut mesh);
        decoded.map_err(|e| Error::import_from(&self.path, format!("{what}: cannot be decoded"), e))?;
        Ok(mesh)
    }

    /// Adds `bytes` to the file, and a copy of `accessor` over them; returns its index.
    fn unpacked_accessor(&mut self, accessor: Accessor, count: usize, bytes: Vec<u8>) -> usize {
        let view = self.add_unpacked(bytes);
        let accessor = Accessor {
            buffer_view: Some(json::Index::new(view as u32)),
            byte_offset: None,
            count: USize64(count as u64),
            sparse: None,
            ..accessor
        };
        self.root.accessors.push(accessor);
        self.root.accessors.len() - 1
    }
}

fn semantic(name: &str) -> Checked<Semantic> {
    serde_json::from_value(name.into()).unwrap_or(Checked::Invalid)
}

/// Draco stores integers exactly; all values of a mesh here fit in single precision.
fn component_bytes(component: ComponentType, value: f32) -> Vec<u8> {
    match component {
        ComponentType::I8 => vec![value as i8 as u8],
        ComponentType::U8 => vec![value as u8],
        ComponentType::I16 => (value as i16).to_le_bytes().to_vec(),
        ComponentType::U16 => (value as u16).to_le_bytes().to_vec(),
        ComponentType::U32 => (value as u32).to_le_bytes().to_vec(),
        ComponentType::F32 => value.to_le_bytes().to_vec(),
    }
}
