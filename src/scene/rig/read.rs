//! Parses and validates TOML to a [`Rig`].

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use serde::Deserialize;
use serde_json::{Value, json};
use toml::Spanned;

use super::merge_patch::{Object, object};
use super::read_light::{self, LightEntry, is_color};
use super::rig_text::RigText;
use super::{Rig, RigSnapshot, SLOTS, without_dots};
use crate::scene::{Camera, LightGroup, ObjectSet, Projection, RigFiles};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    camera: Option<Spanned<CameraEntry>>,
    #[serde(default)]
    group: Vec<GroupEntry>,
    #[serde(default)]
    set: Vec<SetEntry>,
    #[serde(default)]
    light: Vec<LightEntry>,
    #[serde(default)]
    shot: Vec<ShotEntry>,
    #[serde(default)]
    snapshot: Vec<SnapshotEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ShotEntry {
    camera: Spanned<String>,
    #[serde(default)]
    group: Vec<Spanned<toml::Table>>,
    #[serde(default)]
    light: Vec<Spanned<toml::Table>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SnapshotEntry {
    slot: Spanned<usize>,
    #[serde(default)]
    note: String,
    #[serde(default)]
    group: Vec<GroupEntry>,
    #[serde(default)]
    set: Vec<SetEntry>,
    #[serde(default)]
    light: Vec<LightEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraEntry {
    name: Option<String>,
    position: [f64; 3],
    target: [f64; 3],
    #[serde(default = "up")]
    up: [f64; 3],
    yfov_deg: Option<f64>,
    /// Half the height of an orthographic view, metres.
    ymag: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroupEntry {
    name: Spanned<String>,
    #[serde(default)]
    stops: f64,
    #[serde(default = "white")]
    color: [f32; 3],
    #[serde(default = "read_light::yes")]
    enabled: bool,
    #[serde(default)]
    solo: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SetEntry {
    name: Spanned<String>,
    items: Vec<String>,
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

/// Errors begin with the line number.
pub fn parse(source: &str, mut files: RigFiles) -> Result<Rig, String> {
    let text = RigText(source);
    let file: File = toml::from_str(source).map_err(|e| {
        let at = e.span().unwrap_or_default();
        let message = e.message().replace('\n', " ");
        text.line(at.clone(), format!("{message}: {}", text.source_line(at)))
    })?;
    let camera = file.camera.map(|camera| text.camera(camera)).transpose()?;
    let mut rig = Rig { camera, ..text.lists(file.group, file.set, file.light, &mut files)? };
    file.shot.into_iter().try_for_each(|entry| text.shot(entry, &mut rig))?;
    for SnapshotEntry { slot, note, group, set, light } in file.snapshot {
        let wrong = |reason: &str| Err(text.line(slot.span(), format!("snapshot {} {reason}", slot.get_ref())));
        if !(1..=SLOTS).contains(slot.get_ref()) {
            return wrong(&format!("is not in the range 1 to {SLOTS}"));
        }
        let index = slot.get_ref() - 1;
        if rig.snapshots.iter().any(|snapshot| snapshot.slot == index) {
            return wrong("is defined twice");
        }
        rig.snapshots.push(RigSnapshot { slot: index, note, rig: text.lists(group, set, light, &mut files)? });
    }
    Ok(rig)
}

impl RigText<'_> {
    fn lists(
        &self,
        groups: Vec<GroupEntry>,
        sets: Vec<SetEntry>,
        lights: Vec<LightEntry>,
        files: &mut RigFiles,
    ) -> Result<Rig, String> {
        let mut rig = Rig::default();
        let mut group_indices = HashMap::new();
        for entry in groups {
            let at = entry.name.span();
            let group = self.group(entry)?;
            if group_indices.insert(group.name.clone(), rig.groups.len()).is_some() {
                return Err(self.line(at, format!("group \"{}\" is defined twice", group.name)));
            }
            rig.groups.push(group);
        }
        for SetEntry { name, items } in sets {
            let wrong = |reason: &str| Err(self.line(name.span(), format!("set \"{}\" {reason}", name.get_ref())));
            if rig.sets.iter().any(|set| set.name == *name.get_ref()) {
                return wrong("is defined twice");
            }
            rig.sets.push(ObjectSet { name: name.into_inner(), items });
        }
        let mut light_indices = HashMap::new();
        let mut leaders = Vec::new();
        for mut entry in lights {
            let at = entry.name.span();
            leaders.push(entry.follows.take());
            let light = read_light::light(self, entry, &group_indices, &rig.groups, files)?;
            if light_indices.insert(light.name.clone(), rig.lights.len()).is_some() {
                return Err(self.line(at, format!("light \"{}\" is defined twice", light.name)));
            }
            rig.lights.push(light);
        }
        self.follow(&mut rig, &leaders, &light_indices)?;
        Ok(rig)
    }

    fn shot(&self, ShotEntry { camera, group, light }: ShotEntry, rig: &mut Rig) -> Result<(), String> {
        let at = camera.span();
        let name = without_dots(camera.get_ref());
        let wrong = |reason: &str| Err(self.line(at.clone(), format!("shot \"{name}\" {reason}")));
        if rig.shot(&name).is_some() {
            return wrong("is defined twice");
        }
        let mut values = Object::new();
        for (list, entries) in [("groups", group), ("lights", light)] {
            let mut of_list = Object::new();
            for entry in entries {
                let mut entry = entry.into_inner();
                let Some(toml::Value::String(of)) = entry.remove("name") else {
                    return wrong("has an entry without a name");
                };
                let unset = match entry.remove("unset").map(toml::Value::try_into::<Vec<String>>) {
                    None => Vec::new(),
                    Some(Ok(keys)) => keys,
                    Some(Err(_)) => return wrong(&format!("has \"{of}\" with an unset that is no list of keys")),
                };
                let mut own = object(json!(entry));
                own.extend(unset.into_iter().map(|key| (key, Value::Null)));
                if of_list.insert(without_dots(&of), own.into()).is_some() {
                    return wrong(&format!("has \"{of}\" twice"));
                }
            }
            values.insert(list.to_owned(), of_list.into());
        }
        rig.add_shot(&name, values).map_err(|reason| self.line(at, format!("shot \"{name}\": {reason}")))
    }

    fn camera(&self, entry: Spanned<CameraEntry>) -> Result<Camera, String> {
        let at = entry.span();
        let wrong = |reason: &str| self.line(at.clone(), format!("camera: {reason}"));
        let entry = entry.into_inner();
        let projection = match (entry.yfov_deg, entry.ymag) {
            (Some(deg), None) if deg > 0.0 && deg < 180.0 => Projection::Perspective { yfov: deg.to_radians() },
            (Some(_), None) => return Err(wrong("yfov_deg must lie between 0 and 180")),
            (None, Some(ymag)) if ymag > 0.0 && ymag.is_finite() => Projection::Orthographic { ymag },
            (None, Some(_)) => return Err(wrong("ymag must be positive")),
            _ => return Err(wrong("needs one of yfov_deg and ymag")),
        };
        let [position, target, up] = [entry.position, entry.target, entry.up].map(DVec3::from_array);
        let mut camera = Camera::look_at(position, target, up, projection)
            .ok_or_else(|| wrong("position, target and up do not define a view"))?;
        if let Some(name) = entry.name {
            camera.name = without_dots(&name);
        }
        Ok(camera)
    }

    /// Resolves `follows` by name; a light may follow a later one.
    fn follow(
        &self,
        rig: &mut Rig,
        leaders: &[Option<Spanned<String>>],
        light_indices: &HashMap<String, usize>,
    ) -> Result<(), String> {
        let wrong = |index: usize, rig: &Rig, reason: String| {
            let at = leaders[index].as_ref().map(Spanned::span).unwrap_or_default();
            Err(self.line(at, format!("light \"{}\": {reason}", rig.lights[index].name)))
        };
        for (index, leader) in leaders.iter().enumerate() {
            let Some(name) = leader else { continue };
            let leader = light_indices.get(&without_dots(name.get_ref()));
            if leader.is_none() {
                return wrong(index, rig, format!("there is no light \"{}\" to follow", name.get_ref()));
            }
            rig.lights[index].follows = leader.copied();
        }
        match rig.leaders_first() {
            Err(index) => wrong(index, rig, "lights follow each other in a cycle".into()),
            Ok(_) => Ok(()),
        }
    }

    fn group(&self, entry: GroupEntry) -> Result<LightGroup, String> {
        let name = without_dots(entry.name.get_ref());
        let GroupEntry { stops, enabled, solo, .. } = entry;
        let group = LightGroup { name, stops, color: Vec3::from_array(entry.color), enabled, solo };
        let wrong = |reason: &str| self.line(entry.name.span(), format!("group \"{}\": {reason}", group.name));
        if group.name.is_empty() {
            return Err(wrong("the name is empty"));
        }
        if !is_color(group.color) {
            return Err(wrong("color must be finite and not negative"));
        }
        if !group.stops.is_finite() || !(group.color * group.stops.exp2() as f32).is_finite() {
            return Err(wrong("color * 2^stops must be finite"));
        }
        Ok(group)
    }
}
