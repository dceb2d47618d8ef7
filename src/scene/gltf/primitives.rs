//! Imports the triangles of each node as parts of the mesh.

use glam::{DAffine3, DMat3, DVec3};
use gltf::json;
use json::mesh::{Mode, Semantic};

use super::document::Document;
use super::ignored_counts::IgnoredCounts;
use super::materials::Materials;
use super::node_primitive::NodePrimitive;
use super::nodes::{Placed, is_singular};
use super::skins;
use super::vertices::Pose;
use crate::error::Result;
use crate::scene::mesh_builder::MeshBuilder;
use crate::scene::mesh_part::MeshPart;

// Many nodes may show one mesh, so a small file can require more memory than there is. 2^27 corners are 45 million
// triangles: 150 times our largest scene, and 6 GB.
pub const MAX_CORNERS: usize = 1 << 27;

/// Adds all triangles of the meshes that `placed` nodes show.
pub fn import_meshes(
    document: &Document,
    placed: &[Placed],
    materials: &mut Materials,
    builder: &mut MeshBuilder,
) -> Result<IgnoredCounts> {
    check_size(document, placed)?;
    let mut ignored = IgnoredCounts::default();
    let by_node = skins::by_node(placed);
    for &Placed { node, object, world_from_node } in placed {
        if document.poses.nodes[node].mesh.is_none() {
            continue;
        }
        let node_mesh = NodeMesh { document, node, object };
        if let Some(joints) = document.joints(node, &by_node)? {
            node_mesh.add(world_from_node, Some(&joints), materials, builder, &mut ignored)?;
            continue;
        }
        let copies = match document.poses.nodes[node].instances() {
            Some(attributes) => document.instances(node, attributes)?,
            None => vec![DAffine3::IDENTITY],
        };
        for node_from_mesh in copies {
            node_mesh.add(world_from_node * node_from_mesh, None, materials, builder, &mut ignored)?;
        }
    }
    Ok(ignored)
}

/// Refuses more corners than fit in memory, before any is read.
fn check_size(document: &Document, placed: &[Placed]) -> Result<()> {
    let mut corners = 0usize;
    for &Placed { node, object, .. } in placed {
        if document.poses.nodes[node].mesh.is_none() {
            continue;
        }
        let mut of_mesh = 0usize;
        NodeMesh { document, node, object }.for_triangles(&mut 0, |source, mode| {
            of_mesh = of_mesh.saturating_add(source.corner_count(mode)?);
            Ok(())
        })?;
        corners = corners.saturating_add(of_mesh.saturating_mul(document.instance_count(node)?));
        if corners > MAX_CORNERS {
            let name = document.node_name(node);
            return Err(document.error(format!("{name}: more than {MAX_CORNERS} corners of triangles")));
        }
    }
    Ok(())
}

/// The mesh of one node.
struct NodeMesh<'a> {
    document: &'a Document,
    node: usize,
    object: u32,
}

impl NodeMesh<'_> {
    /// Visits the triangle primitives; counts the others.
    fn for_triangles(
        &self,
        others: &mut usize,
        mut visit: impl FnMut(&NodePrimitive, Mode) -> Result<()>,
    ) -> Result<()> {
        let document = self.document;
        let node = &document.poses.nodes[self.node];
        let index = node.mesh.expect("only nodes with a mesh are shown");
        let mesh = document.item(&document.root.meshes, index, "mesh", &document.node_name(self.node))?;
        let of_mesh: Vec<f64> = mesh.weights.iter().flatten().map(|&w| f64::from(w)).collect();
        let weights = node.weights.as_ref().unwrap_or(&of_mesh);
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            let what = format!("mesh {index}, primitive {i}");
            let mode = document.valid(primitive.mode, &format!("{what}: the mode"))?;
            if matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
                visit(&NodePrimitive { document, primitive, what, weights }, mode)?;
            } else {
                *others += 1;
            }
        }
        Ok(())
    }

    fn add(
        &self,
        world_from_mesh: DAffine3,
        joints: Option<&skins::Joints>,
        materials: &mut Materials,
        builder: &mut MeshBuilder,
        ignored: &mut IgnoredCounts,
    ) -> Result<()> {
        let mut others = 0;
        let mut has_vanished = false;
        self.for_triangles(&mut others, |source, mode| {
            // All-zero positions are a single point, so there are no triangles.
            let positions = source.attribute(Semantic::Positions).filter(|&p| !self.document.is_all_zeros(p));
            let Some(positions) = positions else {
                ignored.without_positions += 1;
                return Ok(());
            };
            let count = self.document.accessor_count(positions, &source.what)?;
            let skinned = joints.map(|joints| source.skinned(joints, count)).transpose()?.flatten();
            let pose = match skinned {
                Some(transforms) => Some(Pose::Skinned(transforms)),
                None => self.rigid(world_from_mesh)?,
            };
            let part = match &pose {
                Some(pose) => {
                    let material = materials.get(source.primitive.material.map(|m| m.value()), &source.what)?;
                    source.part(mode, positions, pose, &material, ignored)?
                }
                None => None,
            };
            match part {
                Some(part) => builder.add(MeshPart { object: self.object, ..part }),
                None => has_vanished = true,
            }
            Ok(())
        })?;
        ignored.points_and_lines += others;
        ignored.vanished += usize::from(has_vanished);
        Ok(())
    }

    /// `None` if the transform leaves no area.
    fn rigid(&self, world_from_mesh: DAffine3) -> Result<Option<Pose>> {
        if !world_from_mesh.is_finite() {
            let name = self.document.node_name(self.node);
            return Err(self.document.error(format!("{name}: its transform is not finite")));
        }
        if !is_singular(world_from_mesh.matrix3) {
            return Ok(Some(Pose::Rigid(world_from_mesh)));
        }
        let flat = unflattened(world_from_mesh.matrix3);
        Ok(flat.map(|(axis, directions)| Pose::Flat { world_from_mesh, axis, directions }))
    }
}

/// The axis that `matrix` scales to zero, and a regular matrix for directions: a zero scale across the plane of a flat
/// mesh does not change it. `None` if more than one axis is lost.
fn unflattened(matrix: DMat3) -> Option<(usize, DMat3)> {
    let mut columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    let axis = columns.iter().position(|&c| c == DVec3::ZERO)?;
    let across = columns[(axis + 1) % 3].try_normalize()?.cross(columns[(axis + 2) % 3].try_normalize()?);
    columns[axis] = across.try_normalize()?;
    let [x, y, z] = columns;
    let directions = DMat3::from_cols(x, y, z);
    (!is_singular(directions)).then_some((axis, directions))
}
