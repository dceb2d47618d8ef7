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
        let count = self.instance_count(node)?;
        let what = |attribute: &str| format!("{attribute} of the instances of {}", self.node_name(node));
        let vectors = |index: Option<usize>, attribute, default: DVec3| -> Result<Vec<DVec3>> {
            let Some(index) = index else { return Ok(vec![default; count]) };
            let read = self.vectors::<3>(index, &what(attribute), VECTORS, &[])?;
            Ok(read.into_iter().map(|v| DVec3::from_array(v.map(f64::from))).collect())
        };
        let translations = vectors(attributes.translation, "TRANSLATION", DVec3::ZERO)?;
        let scales = vectors(attributes.scale, "SCALE", DVec3::ONE)?;
        let rotations = match attributes.rotation {
            Some(index) => self.vectors::<4>(index, &what("ROTATION"), ROTATIONS, &[])?,
            None => vec![[0.0, 0.0, 0.0, 1.0]; count],
        };
        let poses = translations.into_iter().zip(rotations).zip(scales).enumerate();
        poses
            .map(|(i, ((translation, rotation), scale))| {
                let rotation = DQuat::from_array(rotation.map(f64::from));
                if !rotation.length_squared().is_normal() {
                    return Err(self.error(format!("{}: copy {i}: not a quaternion", what("ROTATION"))));
                }
                Ok(DAffine3::from_scale_rotation_translation(scale, rotation.normalize(), translation))
            })
            .collect()
    }
}
