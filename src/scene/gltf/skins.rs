//! Skins: vertices transformed by joints. The transform of the skinned mesh's own node is ignored [glTF 2.0, 3.7.3.3].

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DVec3};
use gltf::json::mesh::Semantic;

use super::accessor::{F32, U8, U8_NORM, U16, U16_NORM};
use super::document::Document;
use super::node_primitive::NodePrimitive;
use super::nodes::Placed;
use crate::error::Result;

/// For each joint, the transform from the mesh's local space to world space.
pub type Joints = Vec<DAffine3>;

impl Document {
    /// The joints of the skin of `node`, if it has one.
    pub fn joints(&self, node: usize, placed: &HashMap<usize, DAffine3>) -> Result<Option<Joints>> {
        let Some(index) = self.poses.nodes[node].skin else { return Ok(None) };
        let skin = self.item(&self.poses.skins, index, "skin", &self.node_name(node))?;
        let what = format!("skin {index}");
        let mut inverse_binds = match skin.inverse_bind_matrices {
            Some(accessor) => self.vectors::<16>(accessor, &format!("{what}: inverse bind matrices"), &[F32], &[])?,
            None => Vec::new(),
        };
        let (given, wanted) = (inverse_binds.len(), skin.joints.len());
        if skin.inverse_bind_matrices.is_some() && given < wanted {
            return Err(self.error(format!("{what}: {given} inverse bind matrices for {wanted} joints")));
        }
        inverse_binds.resize(wanted, glam::Mat4::IDENTITY.to_cols_array());
        let joint = |(&joint, inverse_bind): (&usize, &[f32; 16])| {
            self.item(&self.poses.nodes, joint, "joint", &what)?;
            let Some(world_from_joint) = placed.get(&joint) else {
                return Err(self.error(format!("{what}: its joint {} is not in the scene", self.node_name(joint))));
            };
            let m = inverse_bind.map(f64::from);
            let column = |i: usize| DVec3::new(m[4 * i], m[4 * i + 1], m[4 * i + 2]);
            let joint_from_mesh =
                DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) };
            let world_from_mesh = *world_from_joint * joint_from_mesh;
            if !world_from_mesh.is_finite() {
                return Err(self.error(format!("{what}: the transform of {} is not finite", self.node_name(joint))));
            }
            Ok(world_from_mesh)
        };
        skin.joints.iter().zip(&inverse_binds).map(joint).collect::<Result<_>>().map(Some)
    }
}

/// World transforms of all nodes of the scene, by index.
pub fn by_node(placed: &[Placed]) -> HashMap<usize, DAffine3> {
    placed.iter().map(|p| (p.node, p.world_from_node)).collect()
}

impl NodePrimitive<'_> {
    /// For each of `count` vertices, the weighted mean of its joints' transforms; `None` if the primitive has no
    /// joints.
    pub fn skinned(&self, joints: &Joints, count: usize) -> Result<Option<Vec<DAffine3>>> {
        let zero = DAffine3 { matrix3: DMat3::ZERO, translation: DVec3::ZERO };
        let mut sums = Vec::new();
        let mut firsts = Vec::new();
        for set in 0.. {
            let (Some(indices), Some(weights)) =
                (self.attribute(Semantic::Joints(set)), self.attribute(Semantic::Weights(set)))
            else {
                break;
            };
            let (joints_name, weights_name) = (format!("JOINTS_{set}"), format!("WEIGHTS_{set}"));
            self.same_length(indices, count, &joints_name)?;
            self.same_length(weights, count, &weights_name)?;
            let what = |name: &str| format!("{}: {name}", self.what);
            let indices = self.document.vectors::<4>(indices, &what(&joints_name), &[U8, U16], &[])?;
            let weights = self.document.vectors::<4>(weights, &what(&weights_name), &[F32, U8_NORM, U16_NORM], &[])?;
            sums.resize(count, (zero, 0.0)); // as many as were read
            for (i, (indices, weights)) in indices.iter().zip(&weights).enumerate() {
                for (&joint, &weight) in indices.iter().zip(weights) {
                    // Integers up to 65,535, so the conversion is exact.
                    let joint = joint as usize;
                    let there = joints.len();
                    // An entry of zero weight may have any index.
                    if weight == 0.0 && joint >= there {
                        continue;
                    }
                    let Some(transform) = joints.get(joint) else {
                        let reason =
                            format!("{}: vertex {i} names joint {joint}, there are {there}", what(&joints_name));
                        return Err(self.document.error(reason));
                    };
                    if !(weight.is_finite() && weight >= 0.0) {
                        let reason = format!("{}: vertex {i} has a weight of {weight}", what(&weights_name));
                        return Err(self.document.error(reason));
                    }
                    let (sum, total) = &mut sums[i];
                    let weight = f64::from(weight);
                    sum.matrix3 += transform.matrix3 * weight;
                    sum.translation += transform.translation * weight;
                    *total += weight;
                }
            }
            if set == 0 {
                firsts = indices.iter().map(|indices| indices[0] as usize).collect();
            }
        }
        if firsts.is_empty() {
            return Ok(None);
        }
        // Weights should sum to one, and do up to rounding. If all are zero, the vertex belongs to the first joint.
        let transforms = sums.into_iter().zip(firsts).map(|((mut sum, total), first)| {
            if total > 0.0 {
                sum.matrix3 *= 1.0 / total;
                sum.translation /= total;
                return Ok(sum);
            }
            let transform = joints.get(first).copied();
            transform.ok_or_else(|| self.document.error(format!("{}: its skin has no joint {first}", self.what)))
        });
        transforms.collect::<Result<_>>().map(Some)
    }
}
