//! Morph targets: weighted differences, added to positions, normals and tangents [glTF 2.0, 3.7.2.2].

use glam::DVec3;
use gltf::json::mesh::MorphTarget;

use super::accessor::{F32, Form, I8, I8_NORM, I16, I16_NORM, U8, U8_NORM, U16, U16_NORM};
use super::node_primitive::NodePrimitive;
use crate::error::Result;

/// The attributes that targets change.
#[derive(Clone, Copy)]
pub enum Morphed {
    Position,
    Normal,
    Tangent,
}

impl Morphed {
    fn name(self) -> &'static str {
        match self {
            Self::Position => "POSITION",
            Self::Normal => "NORMAL",
            Self::Tangent => "TANGENT",
        }
    }

    fn accessor(self, target: &MorphTarget) -> Option<usize> {
        let index = match self {
            Self::Position => target.positions,
            Self::Normal => target.normals,
            Self::Tangent => target.tangents,
        };
        index.map(|index| index.value())
    }

    /// The forms that `KHR_mesh_quantization` adds.
    fn quantized(self) -> &'static [Form] {
        match self {
            Self::Position => &[I8, I8_NORM, U8, U8_NORM, I16, I16_NORM, U16, U16_NORM],
            _ => &[I8, I8_NORM, I16, I16_NORM],
        }
    }
}

impl NodePrimitive<'_> {
    /// Targets of non-zero weight: index, target and weight.
    fn active_targets(&self) -> impl Iterator<Item = (usize, &MorphTarget, f64)> {
        let targets = self.primitive.targets.iter().flatten().enumerate();
        targets.zip(self.weights).map(|((i, target), &weight)| (i, target, weight)).filter(|t| t.2 != 0.0)
    }

    /// Number of targets of non-zero weight.
    pub fn active_target_count(&self) -> usize {
        self.active_targets().count()
    }

    /// Adds the weighted differences of all targets to `values`.
    pub fn morph(&self, attribute: Morphed, values: &mut [DVec3]) -> Result<()> {
        for (i, target, weight) in self.active_targets() {
            let Some(index) = attribute.accessor(target) else { continue };
            let name = format!("{} of morph target {i}", attribute.name());
            self.same_length(index, values.len(), &name)?;
            let what = format!("{}: {name}", self.what);
            let differences = self.document.vectors::<3>(index, &what, &[F32], attribute.quantized())?;
            for (value, difference) in values.iter_mut().zip(differences) {
                *value += DVec3::from_array(difference.map(f64::from)) * weight;
            }
        }
        Ok(())
    }
}
