//! Writes a rig's lights as `KHR_lights_punctual`, `EXT_lights_area` and `EXT_lights_ies`.

use std::collections::{HashMap, HashSet};

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};
use serde_json::{Value, json};

use super::json::{Object, array, element, object, remove_inner, short};
use super::pack::data_uri;
use crate::error::Result;
use crate::scene::gltf::area_lights::world_scale;
use crate::scene::gltf::document::Document;
use crate::scene::gltf::light_extension::LightExtension;
use crate::scene::gltf::nodes::is_singular;
use crate::scene::light_filter::Profile;
use crate::scene::rig::without_dots;
use crate::scene::{Light, LightKind, LightUnit, Rig, files};

/// Replaces the lights of the shown scene; nodes that only other scenes contain retain theirs.
pub fn replace(root: &mut Object, document: &Document, rig: &Rig) -> Result<()> {
    let mut writer = Writer::new(root, document)?;
    for (index, node) in document.poses.nodes.iter().enumerate() {
        for extension in node.light_extensions() {
            if writer.world_from_node.contains_key(&index) {
                let node = element(root, "nodes", index).expect("the document has this node");
                remove_inner(node, "extensions", extension.name());
            } else if let Some(light) = node.light(extension)
                && let Some(light) = writer.keep(extension, light)?
            {
                refer(root, index, extension).insert("light".into(), light.into());
            }
        }
    }
    // The others are in the embedded rig.
    for index in (0..rig.lights.len()).filter(|&i| rig.lights[i].kind.is_in_gltf()) {
        writer.write(root, rig, index);
    }
    for List { extension, new, .. } in writer.lists {
        declare(root, extension.name(), !new.is_empty());
        if new.is_empty() {
            remove_inner(root, "extensions", extension.name());
        } else {
            object(object(root, "extensions"), extension.name()).insert("lights".into(), new.into());
        }
    }
    Ok(())
}

/// The `lights` of an extension.
struct List {
    extension: LightExtension,
    old: Vec<Value>,
    new: Vec<Value>,
    /// New index of each retained light.
    kept: HashMap<usize, usize>,
}

impl List {
    fn push(&mut self, entry: Value) -> usize {
        self.new.push(entry);
        self.new.len() - 1
    }
}

struct Writer<'a> {
    document: &'a Document,
    /// Of the nodes of the shown scene.
    world_from_node: HashMap<usize, DAffine3>,
    parents: HashMap<usize, usize>,
    /// In the order of [`LightExtension::ALL`].
    lists: [List; 3],
    /// Index of each profile by its URI.
    profiles: HashMap<String, usize>,
    /// Nodes that already have their light.
    claimed: HashSet<usize>,
}

impl<'a> Writer<'a> {
    fn new(root: &Object, document: &'a Document) -> Result<Self> {
        let (placed, _) = document.placed_nodes()?;
        let nodes = document.poses.nodes.iter().enumerate();
        Ok(Self {
            document,
            world_from_node: placed.into_iter().map(|p| (p.node, p.world_from_node)).collect(),
            parents: nodes.flat_map(|(parent, node)| node.children.iter().map(move |&c| (c, parent))).collect(),
            lists: LightExtension::ALL.map(|extension| List {
                extension,
                old: source_entries(root, extension),
                new: Vec::new(),
                kept: HashMap::new(),
            }),
            profiles: HashMap::new(),
            claimed: HashSet::new(),
        })
    }

    fn list(&mut self, extension: LightExtension) -> &mut List {
        &mut self.lists[extension as usize]
    }

    /// The new index of an old light; `None` if there is no such light.
    fn keep(&mut self, extension: LightExtension, light: usize) -> Result<Option<usize>> {
        let document = self.document;
        let list = self.list(extension);
        if let Some(&index) = list.kept.get(&light) {
            return Ok(Some(index));
        }
        let Some(mut entry) = list.old.get(light).cloned() else { return Ok(None) };
        if extension == LightExtension::Profile
            && let Some(uri) = entry.get("uri").and_then(Value::as_str).filter(|uri| !uri.starts_with("data:"))
        {
            let bytes = files::read_uri(&document.path, uri, &format!("IES light {light}"))?;
            entry["uri"] = data_uri(IES, &bytes).into();
        }
        let index = list.push(entry);
        list.kept.insert(light, index);
        Ok(Some(index))
    }

    fn write(&mut self, root: &mut Object, rig: &Rig, index: usize) {
        let light = &rig.lights[index].nearest_in_gltf();
        let extension = LightExtension::of(light);
        let source_node = light.node.filter(|node| {
            let had_light = self.document.poses.nodes.get(*node).is_some_and(|n| n.light_extensions().next().is_some());
            had_light && self.world_from_node.contains_key(node) && self.claimed.insert(*node)
        });
        if light.node.is_some() && source_node.is_none() {
            tracing::warn!("light \"{}\" gets a new node: its old node has no light, or a different one", light.name);
        }
        let (node, world_from_node) = match source_node {
            Some(node) => self.write_to_source_node(root, light, node),
            None => self.add_node(root, light, None),
        };
        let old_light = source_node.and_then(|node| self.document.poses.nodes[node].light(extension));
        let strength = strength(rig, index);
        let list = self.list(extension);
        let old_entry = old_light.and_then(|old| list.old.get(old)?.as_object().cloned()).unwrap_or_default();
        let new_index = match (extension, &light.filter.ies) {
            (LightExtension::Profile, Some(ies)) => self.profile(ies),
            (LightExtension::Area, _) => {
                list.push(Value::Object(area_entry(light, strength, world_scale(&world_from_node), old_entry)))
            }
            _ => list.push(Value::Object(punctual_entry(light, strength, old_entry))),
        };
        let reference = refer(root, node, extension);
        reference.insert("light".into(), new_index.into());
        if let (LightExtension::Profile, Some(ies)) = (extension, &light.filter.ies) {
            let (color, intensity) = strength;
            reference.insert("multiplier".into(), (intensity / ies.max()).into());
            reference.insert("color".into(), color.to_array().map(short).to_vec().into());
        }
    }

    /// Index of the IES file in its extension.
    fn profile(&mut self, ies: &Profile) -> usize {
        let uri = data_uri(IES, &ies.file);
        let list = &mut self.lists[LightExtension::Profile as usize];
        *self.profiles.entry(uri).or_insert_with_key(|uri| list.push(json!({ "uri": uri })))
    }

    /// Returns the light's node and its world transform.
    fn write_to_source_node(&self, root: &mut Object, light: &Light, index: usize) -> (usize, DAffine3) {
        let world_from_node = self.world_from_node[&index];
        let old_extension = self.document.poses.nodes[index].light_extensions().next();
        let old_name = old_extension.and_then(|extension| self.document.light_name(index, extension));
        let is_named = old_name.is_some_and(|name| without_dots(&name) == light.name);
        let node = element(root, "nodes", index).expect("the document has this node");
        let has_pose = has_pose(&world_from_node, light);
        let is_free = ["mesh", "camera", "skin", "children"].iter().all(|key| !node.contains_key(*key));
        if has_pose && (is_named || is_free || !node.contains_key("name")) {
            if !is_named {
                node.insert("name".into(), light.name.clone().into());
            }
            return (index, world_from_node);
        }
        let world_from_parent = match self.parents.get(&index) {
            Some(parent) => self.world_from_node.get(parent).copied().unwrap_or(DAffine3::IDENTITY),
            None => DAffine3::IDENTITY,
        };
        if !is_free {
            // The node's other contents must not move, so the light gets a child node.
            return self.add_node(root, light, Some(index));
        }
        if !is_invertible(&world_from_parent) {
            return self.add_node(root, light, None);
        }
        if !is_named {
            node.insert("name".into(), light.name.clone().into());
        }
        (index, pose(node, &world_from_parent, light))
    }

    /// Returns the new node and its world transform.
    fn add_node(&self, root: &mut Object, light: &Light, parent: Option<usize>) -> (usize, DAffine3) {
        let parent = parent.filter(|parent| is_invertible(&self.world_from_node[parent]));
        let world_from_parent = parent.map_or(DAffine3::IDENTITY, |parent| self.world_from_node[&parent]);
        let mut node = Object::new();
        node.insert("name".into(), light.name.clone().into());
        let world_from_node = pose(&mut node, &world_from_parent, light);
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
        (index, world_from_node)
    }
}

/// Media type of profiles in `EXT_lights_ies`.
const IES: &str = "application/x-ies-lm-63";

fn source_entries(root: &Object, extension: LightExtension) -> Vec<Value> {
    let lights = root.get("extensions").and_then(|e| e.get(extension.name())).and_then(|e| e.get("lights"));
    lights.and_then(Value::as_array).cloned().unwrap_or_default()
}

/// What a node says of its light in `extension`.
fn refer(root: &mut Object, node: usize, extension: LightExtension) -> &mut Object {
    let node = element(root, "nodes", node).expect("the document has this node");
    object(object(node, "extensions"), extension.name())
}

/// Lists the extension in `extensionsUsed` if and only if it is used.
fn declare(root: &mut Object, extension: &str, is_used: bool) {
    let is_ours = |name: &Value| name.as_str() == Some(extension);
    for key in ["extensionsUsed", "extensionsRequired"] {
        if is_used && key == "extensionsUsed" && !array(root, key).iter().any(is_ours) {
            array(root, key).push(extension.into());
        }
        if !is_used && let Some(Value::Array(names)) = root.get_mut(key) {
            names.retain(|name| !is_ours(name));
            if names.is_empty() {
                root.remove(key);
            }
        }
    }
}

/// Colour of at most 1, and intensity, with stops and group; an intensity of 0 if the light is off.
fn strength(rig: &Rig, index: usize) -> (Vec3, f64) {
    let light = &rig.lights[index];
    let group = light.group.map(|group| &rig.groups[group]);
    let is_on = light.enabled && group.is_none_or(|g| g.enabled);
    let mut color = light.color * group.map_or(Vec3::ONE, |g| g.color);
    let mut intensity = light.intensity * (light.stops + group.map_or(0.0, |g| g.stops)).exp2();
    let brightest = color.max_element();
    if brightest > 1.0 {
        color /= brightest;
        intensity *= f64::from(brightest);
    }
    (color, if is_on { intensity } else { 0.0 })
}

/// An entry of `KHR_lights_punctual`, based on the file's old `entry`.
fn punctual_entry(light: &Light, strength: (Vec3, f64), mut entry: Object) -> Object {
    let kind = match light.kind {
        LightKind::Point => "point",
        LightKind::Spot | LightKind::Disk | LightKind::Rect => "spot",
        LightKind::Directional => "directional",
        LightKind::Dome | LightKind::Emitter => unreachable!("glTF has no such lights"),
    };
    start_entry(&mut entry, kind, light, strength);
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

/// An entry of `EXT_lights_area`, based on the file's old `entry`, for a node that is scaled by `scale`.
fn area_entry(light: &Light, (color, candela): (Vec3, f64), scale: f64, mut entry: Object) -> Object {
    let nits = candela * light.per_intensity(LightUnit::Nit).unwrap_or(0.0);
    let kind = if light.kind == LightKind::Rect { "rect" } else { "disk" };
    start_entry(&mut entry, kind, light, (color, nits));
    if light.kind == LightKind::Rect {
        entry.insert("size".into(), (light.size[1] / scale).into());
        object(&mut entry, "rect").insert("aspect".into(), (light.size[0] / light.size[1]).into());
    } else {
        entry.insert("size".into(), (2.0 * light.radius / scale).into());
        entry.remove("rect");
    }
    entry
}

/// What the entries of both extensions have.
fn start_entry(entry: &mut Object, kind: &str, light: &Light, (color, intensity): (Vec3, f64)) {
    entry.insert("type".into(), kind.into());
    entry.entry("name").or_insert_with(|| light.name.clone().into());
    entry.insert("color".into(), color.to_array().map(short).to_vec().into());
    entry.insert("intensity".into(), intensity.into());
}

/// Whether the node already has the light's pose, up to rounding.
fn has_pose(world_from_node: &DAffine3, light: &Light) -> bool {
    let position = world_from_node.translation;
    let direction = (-world_from_node.matrix3.z_axis).normalize_or_zero();
    // 1e-9: far below any intended change, far above rounding.
    let near = light.position.distance(position) <= 1e-9 * (1.0 + position.length());
    let along = light.direction.distance(direction) <= 1e-9;
    let upright = light.up_axis_in_gltf().is_none_or(|axis| {
        let up = world_from_node.matrix3.col(axis).reject_from_normalized(direction).normalize_or_zero();
        light.axes()[1].distance(up) <= 1e-9
    });
    // Its size is relative to the node's scale.
    let has_scale = LightExtension::of(light) != LightExtension::Area || is_invertible(world_from_node);
    let is_placed = near || light.kind == LightKind::Directional;
    is_placed && (along || !light.has_direction()) && upright && has_scale
}

/// Sets `node`'s transform to the light's pose and returns its world transform.
fn pose(node: &mut Object, world_from_parent: &DAffine3, light: &Light) -> DAffine3 {
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
    if !light.has_direction() {
        return *world_from_parent;
    }
    let rotation = rotation(&parent_from_world, light);
    node.insert("rotation".into(), json!(rotation.to_array()));
    // A mirroring scale would reverse the direction; it has no other effect on a light.
    node.remove("scale");
    *world_from_parent * DAffine3::from_quat(rotation)
}

/// The rotation of a node whose light has the right direction and, if it matters, the right upward axis.
fn rotation(parent_from_world: &DAffine3, light: &Light) -> DQuat {
    let direction = parent_from_world.transform_vector3(light.direction).normalize();
    let Some(axis) = light.up_axis_in_gltf() else { return DQuat::from_rotation_arc(DVec3::NEG_Z, direction) };
    let up = parent_from_world.transform_vector3(light.axes()[1]).reject_from_normalized(direction).normalize();
    let back = -direction;
    let [x, y] = if axis == 0 { [up, back.cross(up)] } else { [up.cross(back), up] };
    DQuat::from_mat3(&DMat3::from_cols(x, y, back))
}

fn is_invertible(transform: &DAffine3) -> bool {
    transform.is_finite() && !is_singular(transform.matrix3)
}
