//! `EXT_mesh_gpu_instancing`: one node, many copies of its mesh.

use glam::{DAffine3, DQuat, DVec3};

use super::accessor::{F32, Form, I8, I8_NORM, I16, I16_NORM, U8, U8_NORM, U16, U16_NORM};
use super::document::{Document, InstanceAttributes};
use crate::error::Result;

/// The extension specifies single precision, or normalized integers for rotations. Compressors also write the others.
const VECTORS: &[Form] = &[F32, I8, I8_NORM, U8, U8_NORM, I16, I16_NORM, U16, U16_NORM];
const ROTATIONS: &[Form] = &[F32, I8_NORM, I16_NORM];

impl Document {
    /// Number of copies of its mesh that `node` shows.
    pub fn instance_count(&self, node: usize) -> Result<usize> {
        let Some(attributes) = self.poses.nodes[node].instances() else { return Ok(1) };
        let what = format!("the instances of {}", self.node_name(node));
        let given = [attributes.translation, attributes.rotation, attributes.scale].into_iter().flatten();
        let mut counts = given.map(|index| self.accessor_count(index, &what));
        let Some(first) = counts.next().transpose()? else { return Ok(1) };
        for count in counts {
            let count = count?;
            if count != first {
                return Err(self.error(format!("{what}: {count} values for {first} copies")));
            }
        }
        Ok(first)
    }

    /// Transforms of the copies in the node's space.
    pub fn instances(&self, node: usize, attributes: &InstanceAttributes) -> Result<Vec<DAffine3>> {
        let what = |attribute: &str| format!("{attribute} of the instances of {}", self.node_name(node));
        let vectors = |index: Option<usize>, attribute| {
            index.map(|index| self.vectors::<3>(index, &what(attribute), VECTORS, &[])).transpose()
        };
        let translations = vectors(attributes.translation, "TRANSLATION")?;
        let scales = vectors(attributes.scale, "SCALE")?;
        let rotations = attributes.rotation;
        let rotations =
            rotations.map(|index| self.vectors::<4>(index, &what("ROTATION"), ROTATIONS, &[])).transpose()?;
        // Those that are given were read: there are as many values in the file.
        let count = self.instance_count(node)?;
        let vector = |list: &Option<Vec<[f32; 3]>>, i: usize, default: DVec3| {
            list.as_ref().map_or(default, |list| DVec3::from_array(list[i].map(f64::from)))
        };
        (0..count)
            .map(|i| {
                let (translation, scale) = (vector(&translations, i, DVec3::ZERO), vector(&scales, i, DVec3::ONE));
                let rotation =
                    rotations.as_ref().map_or(DQuat::IDENTITY, |list| DQuat::from_array(list[i].map(f64::from)));
                if !rotation.length_squared().is_normal() {
                    return Err(self.error(format!("{}: copy {i}: not a quaternion", what("ROTATION"))));
                }
                Ok(DAffine3::from_scale_rotation_translation(scale, rotation.normalize(), translation))
            })
            .collect()
    }
}
