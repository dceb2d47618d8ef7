//! The node hierarchy, flattened.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};

use super::document::{Document, Node};
use crate::error::Result;
use crate::scene::Object;

/// A node of the scene and its world transform.
pub struct Placed {
    pub node: usize,
    /// Index into the objects.
    pub object: u32,
    pub world_from_node: DAffine3,
}

impl Document {
    /// All nodes of the shown scene, sorted by index, and the objects that they form.
    ///
    /// Uses an explicit stack, because files may nest nodes deeper than the call stack allows.
    pub fn placed_nodes(&self) -> Result<(Vec<Placed>, Vec<Object>)> {
        let nodes = &self.poses.nodes;
        let mut seen = vec![false; nodes.len()];
        let mut placed = Vec::new();
        let mut objects = vec![Object::default()];
        let mut object_indices = HashMap::new();
        let mut open: Vec<_> =
            self.roots()?.into_iter().rev().map(|root| (root, DAffine3::IDENTITY, None, 0)).collect();
        while let Some((index, world_from_parent, parent_node, parent)) = open.pop() {
            let asked_by = parent_node.map_or("the scene".into(), |parent| self.node_name(parent));
            let node = self.item(nodes, index, "node", &asked_by)?;
            // Also prevents a small file from describing exponentially many nodes.
            if std::mem::replace(&mut seen[index], true) {
                let name = self.node_name(index);
                return Err(self.error(format!("{name} is its own ancestor or has two parents")));
            }
            let world_from_node = world_from_parent * self.parent_from_node(index, node)?;
            let object = match node.name.as_deref().unwrap_or_default() {
                "" => parent,
                name => *object_indices.entry((name, parent)).or_insert_with(|| {
                    objects.push(Object { name: name.into(), parent });
                    objects.len() as u32 - 1
                }),
            };
            open.extend(node.children.iter().rev().map(|&child| (child, world_from_node, Some(index), object)));
            placed.push(Placed { node: index, object, world_from_node });
        }
        placed.sort_by_key(|p| p.node);
        Ok((placed, objects))
    }

    /// Index of the shown scene: the default one, else the first.
    pub fn shown_scene(&self) -> usize {
        self.poses.scene.unwrap_or(0)
    }

    /// The scene's root nodes; without scenes, every node that has no parent.
    fn roots(&self) -> Result<Vec<usize>> {
        if self.poses.scene.is_none() && self.poses.scenes.is_empty() {
            let mut is_child = vec![false; self.poses.nodes.len()];
            for &child in self.poses.nodes.iter().flat_map(|node| &node.children) {
                if let Some(flag) = is_child.get_mut(child) {
                    *flag = true;
                }
            }
            return Ok((0..is_child.len()).filter(|&i| !is_child[i]).collect());
        }
        Ok(self.item(&self.poses.scenes, self.shown_scene(), "scene", "the file")?.nodes.clone())
    }

    /// `node 3 "lamp"`.
    pub fn node_name(&self, index: usize) -> String {
        match self.poses.nodes.get(index).and_then(|node| node.name.as_deref()) {
            Some(name) => format!("node {index} \"{name}\""),
            None => format!("node {index}"),
        }
    }

    fn parent_from_node(&self, index: usize, node: &Node) -> Result<DAffine3> {
        local_pose(node.matrix, node.translation, node.rotation, node.scale)
            .map_err(|reason| self.error(format!("{}: {reason}", self.node_name(index))))
    }
}

/// A node's transform, from a matrix or from translation, rotation and scale [glTF 2.0, 3.5.3].
pub fn local_pose(
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
) -> Result<DAffine3, &'static str> {
    if let Some(matrix) = matrix {
        let matrix = DMat4::from_cols_array(&matrix);
        let bottom = matrix.row(3);
        // Exporters write the last row with rounding errors.
        if (bottom - glam::DVec4::W).abs().max_element() > 1e-6 {
            return Err("the last row of its matrix is not 0 0 0 1");
        }
        return Ok(DAffine3::from_mat4(matrix));
    }
    let rotation = DQuat::from_array(rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
    if !(rotation.length_squared().is_normal()) {
        return Err("its rotation is not a quaternion");
    }
    Ok(DAffine3::from_scale_rotation_translation(
        DVec3::from_array(scale.unwrap_or([1.0; 3])),
        rotation.normalize(),
        DVec3::from_array(translation.unwrap_or_default()),
    ))
}

/// Whether `matrix` is singular, or has columns that cannot be normalized.
pub fn is_singular(matrix: DMat3) -> bool {
    let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::try_normalize);
    let [Some(x), Some(y), Some(z)] = columns else { return true };
    // 1e-12: four digits above the rounding error of the determinant of three coplanar columns.
    x.cross(y).dot(z).abs() <= 1e-12
}
