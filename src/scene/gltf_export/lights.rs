//! Writes a rig's lights as `KHR_lights_punctual`.

use std::collections::HashMap;

use glam::{DAffine3, DQuat, DVec3, Vec3};
use serde_json::{Value, json};

use super::json::{Object, array, element, object, remove_inner, short};
use crate::error::Result;
use crate::scene::gltf::document::Document;
use crate::scene::gltf::nodes::is_singular;
use crate::scene::rig::without_dots;
use crate::scene::{Light, LightKind, Rig};

const EXTENSION: &str = "KHR_lights_punctual";

/// Replaces the lights of the shown scene; nodes that only other scenes contain retain theirs.
pub fn replace(root: &mut Object, document: &Document, rig: &Rig) -> Result<()> {
    let entries = source_entries(root);
    let mut writer = Writer::new(document)?;
    for node in 0..document.poses.nodes.len() {
        let Some(light) = document.poses.nodes[node].light() else { continue };
        if writer.world_from_node.contains_key(&node) {
            let node = element(root, "nodes", node).expect("the document has this node");
            remove_inner(node, "extensions", EXTENSION);
        } else if let Some(entry) = entries.get(light) {
            let index = writer.keep(light, entry);
            refer(root, node, index);
        }
    }
    for index in 0..rig.lights.len() {
        writer.write(root, rig, index, &entries);
    }
    let lights = writer.lights;
    declare(root, !lights.is_empty());
    if lights.is_empty() {
        remove_inner(root, "extensions", EXTENSION);
    } else {
        object(object(root, "extensions"), EXTENSION).insert("lights".into(), lights.into());
    }
    Ok(())
}

struct Writer<'a> {
    document: &'a Document,
    /// Of the nodes of the shown scene.
    world_from_node: HashMap<usize, DAffine3>,
    parents: HashMap<usize, usize>,
    /// The new `lights` array.
    lights: Vec<Value>,
    /// New index of each retained light.
    kept: HashMap<usize, usize>,
    /// Nodes that already have their light.
    claimed: std::collections::HashSet<usize>,
}

impl<'a> Writer<'a> {
    fn new(document: &'a Document) -> Result<Self> {
        let (placed, _) = document.placed_nodes()?;
        let nodes = document.poses.nodes.iter().enumerate();
        Ok(Self {
            document,
            world_from_node: placed.into_iter().map(|p| (p.node, p.world_from_node)).collect(),
            parents: nodes.flat_map(|(parent, node)| node.children.iter().map(move |&c| (c, parent))).collect(),
            lights: Vec::new(),
            kept: HashMap::new(),
            claimed: Default::default(),
        })
    }

    fn keep(&mut self, light: usize, entry: &Value) -> usize {
        *self.kept.entry(light).or_insert_with(|| {
            self.lights.push(entry.clone());
            self.lights.len() - 1
        })
    }

    fn write(&mut self, root: &mut Object, rig: &Rig, index: usize, entries: &[Value]) {
        let light = &rig.lights[index];
        let source_node = light.node.filter(|node| {
            let had_light = self.document.poses.nodes.get(*node).is_some_and(|n| n.light().is_some());
            had_light && self.world_from_node.contains_key(node) && self.claimed.insert(*node)
        });
        if light.node.is_some() && source_node.is_none() {
            tracing::warn!("light \"{}\" gets a new node: its old node has no light, or a different one", light.name);
        }
        let old_light = source_node.and_then(|node| self.document.poses.nodes[node].light());
        let old_entry = old_light.and_then(|old| entries.get(old)).and_then(Value::as_object);
        let old_name = source_node.and_then(|node| self.loaded_name(node));
        self.lights.push(Value::Object(entry(rig, index, old_entry.cloned().unwrap_or_default())));
        let new_index = self.lights.len() - 1;
        match source_node {
            Some(node) => {
                let is_named = old_name.is_some_and(|name| without_dots(&name) == light.name);
                self.write_to_source_node(root, light, node, is_named, new_index);
            }
            None => self.add_node(root, light, None, new_index),
        }
    }

    /// The name that import gives a light at `node`, before it is made unique.
    fn loaded_name(&self, node: usize) -> Option<String> {
        let node = &self.document.poses.nodes[node];
        let light = node.light().and_then(|light| self.document.lights().get(light));
        let names = [Some(&node.name), light.map(|l| &l.name)];
        names.into_iter().flatten().flatten().find(|name| !name.is_empty()).cloned()
    }

    fn write_to_source_node(&self, root: &mut Object, light: &Light, index: usize, is_named: bool, new_index: usize) {
        let world_from_node = &self.world_from_node[&index];
        let node = element(root, "nodes", index).expect("the document has this node");
        let has_pose = has_pose(world_from_node, light);
        let is_free = ["mesh", "camera", "skin", "children"].iter().all(|key| !node.contains_key(*key));
        if has_pose && (is_named || is_free || !node.contains_key("name")) {
            if !is_named {
                node.insert("name".into(), light.name.clone().into());
            }
            return refer(root, index, new_index);
        }
        let world_from_parent = match self.parents.get(&index) {
            Some(parent) => self.world_from_node.get(parent).copied().unwrap_or(DAffine3::IDENTITY),
            None => DAffine3::IDENTITY,
        };
        if !is_free {
            // The node's other contents must not move, so the light gets a child node.
            return self.add_node(root, light, Some(index), new_index);
        }
        if !is_invertible(&world_from_parent) {
            return self.add_node(root, light, None, new_index);
        }
        if !is_named {
            node.insert("name".into(), light.name.clone().into());
        }
        pose(node, &world_from_parent, light);
        refer(root, index, new_index);
    }

    fn add_node(&self, root: &mut Object, light: &Light, parent: Option<usize>, new_index: usize) {
        let parent = parent.filter(|parent| is_invertible(&self.world_from_node[parent]));
        let world_from_parent = parent.map_or(DAffine3::IDENTITY, |parent| self.world_from_node[&parent]);
        let mut node = Object::new();
        node.insert("name".into(), light.name.clone().into());
        pose(&mut node, &world_from_parent, light);
        let nodes = array(root, "nodes");
        let index = nodes.len();
        nodes.push(Value::Object(node));
        match parent {
            Some(parent) => {
                let parent = element(root, "nodes", parent).expect("the document has this node");
                array(parent, "children").push(index.into());
            }
            // Without scenes, every node without a parent is shown.
            None => {
                if let Some(scene) = element(root, "scenes", self.document.shown_scene()) {
                    array(scene, "nodes").push(index.into());
                }
            }
        }
        refer(root, index, new_index);
    }
}

fn source_entries(root: &Object) -> Vec<Value> {
    let lights = root.get("extensions").and_then(|e| e.get(EXTENSION)).and_then(|e| e.get("lights"));
    lights.and_then(Value::as_array).cloned().unwrap_or_default()
}

fn refer(root: &mut Object, node: usize, light: usize) {
    let node = element(root, "nodes", node).expect("the document has this node");
    object(object(node, "extensions"), EXTENSION).insert("light".into(), light.into());
}

/// Lists the extension in `extensionsUsed` if and only if it is used.
fn declare(root: &mut Object, is_used: bool) {
    let is_ours = |name: &Value| name.as_str() == Some(EXTENSION);
    for key in ["extensionsUsed", "extensionsRequired"] {
        if is_used && key == "extensionsUsed" && !array(root, key).iter().any(is_ours) {
            array(root, key).push(EXTENSION.into());
        }
        if !is_used && let Some(Value::Array(names)) = root.get_mut(key) {
            names.retain(|name| !is_ours(name));
            if names.is_empty() {
                root.remove(key);
            }
        }
    }
}

/// The light's glTF entry, based on the file's old `entry`.
fn entry(rig: &Rig, index: usize, mut entry: Object) -> Object {
    let light = &rig.lights[index].without_size();
    let group = light.group.map(|group| &rig.groups[group]);
    let is_on = light.enabled && group.is_none_or(|g| g.enabled);
    let mut color = light.color * group.map_or(Vec3::ONE, |g| g.color);
    let mut intensity = light.intensity * (light.stops + group.map_or(0.0, |g| g.stops)).exp2();
    // glTF colours are at most 1.
    let brightest = color.max_element();
    if brightest > 1.0 {
        color /= brightest;
        intensity *= f64::from(brightest);
    }
    let kind = match light.kind {
        LightKind::Point => "point",
        LightKind::Spot | LightKind::Disk | LightKind::Rect => "spot",
        LightKind::Directional => "directional",
    };
    entry.insert("type".into(), kind.into());
    entry.entry("name").or_insert_with(|| light.name.clone().into());
    entry.insert("color".into(), color.to_array().map(short).to_vec().into());
    entry.insert("intensity".into(), if is_on { intensity } else { 0.0 }.into());
    match light.range {
        Some(range) => _ = entry.insert("range".into(), range.into()),
        None => _ = entry.remove("range"),
    }
    if light.kind == LightKind::Spot {
        // The inner angle must be less than the outer one; the difference is below single precision.
        let inner = light.inner_angle.min(light.outer_angle * (1.0 - 1e-7));
        let spot = object(&mut entry, "spot");
        spot.insert("innerConeAngle".into(), inner.into());
        spot.insert("outerConeAngle".into(), light.outer_angle.into());
    } else {
        entry.remove("spot");
    }
    entry
}

/// Whether the node already has the light's pose, up to rounding.
fn has_pose(world_from_node: &DAffine3, light: &Light) -> bool {
    let position = world_from_node.translation;
    let direction = (-world_from_node.matrix3.z_axis).normalize_or_zero();
    // 1e-9: far below any intended change, far above rounding.
    let near = light.position.distance(position) <= 1e-9 * (1.0 + position.length());
    let along = light.direction.distance(direction) <= 1e-9;
    (near || light.kind == LightKind::Directional) && (along || light.kind == LightKind::Point)
}

/// Sets `node`'s transform to the light's pose.
fn pose(node: &mut Object, world_from_parent: &DAffine3, light: &Light) {
    let parent_from_world = world_from_parent.inverse();
    let translation = match light.kind {
        // It has no position; the node's translation is retained.
        LightKind::Directional => node.get("matrix").and_then(|m| m.as_array()).and_then(|m| {
            let column: Vec<f64> = m.iter().skip(12).take(3).filter_map(Value::as_f64).collect();
            column.try_into().ok().map(DVec3::from_array)
        }),
        _ => Some(parent_from_world.transform_point3(light.position)),
    };
    if let Some(translation) = translation {
        node.insert("translation".into(), json!(translation.to_array()));
    }
    node.remove("matrix");
    if light.kind != LightKind::Point {
        let direction = parent_from_world.transform_vector3(light.direction).normalize();
        let rotation = DQuat::from_rotation_arc(DVec3::NEG_Z, direction);
        node.insert("rotation".into(), json!(rotation.to_array()));
        // A mirroring scale would reverse the direction; it has no other effect on a light.
        node.remove("scale");
    }
}

fn is_invertible(transform: &DAffine3) -> bool {
    transform.is_finite() && !is_singular(transform.matrix3)
}
