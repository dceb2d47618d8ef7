//! A primitive of a mesh, as one node shows it: what vertices, morph targets and skins read.

use gltf::json::mesh::{Primitive, Semantic};
use gltf::json::validation::Checked;

use super::document::Document;
use crate::error::Result;

/// A primitive of a mesh, as one node shows it.
pub struct NodePrimitive<'a> {
    pub document: &'a Document,
    pub primitive: &'a Primitive,
    pub what: String,
    /// Morph target weights; there may be fewer or more than targets.
    pub weights: &'a [f64],
}

impl NodePrimitive<'_> {
    /// The accessor of an attribute.
    pub fn attribute(&self, semantic: Semantic) -> Option<usize> {
        self.primitive.attributes.get(&Checked::Valid(semantic)).map(|index| index.value())
    }

    /// Checks that accessor `index` has as many elements as the positions, before it is read.
    pub fn same_length(&self, index: usize, count: usize, attribute: &str) -> Result<()> {
        let length = self.document.accessor_count(index, &format!("{}: {attribute}", self.what))?;
        if length == count {
            return Ok(());
        }
        let reason = format!("{}: {length} of {attribute} for {count} of POSITION", self.what);
        Err(self.document.error(reason))
    }
}
