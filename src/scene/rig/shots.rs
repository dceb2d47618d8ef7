//! What lights have only in pictures of one camera. All else of a rig is shared by all of its shots.

use std::path::Path;

use serde_json::{Value, json};

use super::Rig;
use super::diff::diff;
use super::merge_patch::{Object, object};
use super::patch::apply;
use crate::scene::Light;

/// Keys of lights and groups that are the same in all shots: what a light is, and files, which take long to read.
const SHARED: [&str; 10] =
    ["name", "kind", "material", "node", "group", "follows", "map", "physical_sky", "ies", "gobo"];

/// Values of lights and groups in pictures of one camera, where they differ from those of the rig.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shot {
    /// Name of the camera, unique in its rig.
    pub camera: String,
    /// By list, name and key, as in [`whole`](super::diff::whole); `null` is the default of the key.
    values: Object,
}

/// The lists that a shot changes.
const LISTS: [&str; 2] = ["groups", "lights"];

impl Shot {
    pub fn new(camera: &str) -> Self {
        Self { camera: camera.to_owned(), values: Object::new() }
    }

    /// The values of a light ("lights") or group ("groups") in this shot, by the keys of a rig file.
    pub fn values(&self, list: &str, name: &str) -> Option<&Object> {
        self.values.get(list)?.get(name)?.as_object()
    }

    /// The entries of a list that differ, by name.
    pub fn entries(&self, list: &str) -> impl Iterator<Item = (&String, &Object)> {
        let entries = self.values.get(list).and_then(Value::as_object).into_iter().flatten();
        entries.filter_map(|(name, values)| Some((name, values.as_object()?)))
    }

    pub(super) fn forget(&mut self, list: &str, names: &[String]) {
        names.iter().for_each(|name| drop(self.list(list).remove(name)));
    }

    fn is_empty(&self) -> bool {
        LISTS.iter().all(|list| self.entries(list).next().is_none())
    }

    fn list(&mut self, list: &str) -> &mut Object {
        let entries = self.values.entry(list).or_insert_with(|| json!({}));
        entries.as_object_mut().expect("a list of entries is an object")
    }

    fn set(&mut self, list: &str, name: &str, key: &str, value: Value) {
        let entry = self.list(list).entry(name).or_insert_with(|| json!({}));
        entry.as_object_mut().expect("an entry is an object").insert(key.to_owned(), value);
    }
}

impl Rig {
    /// Adds a shot with `values`, by list, name and key. An error names what the rig does not have or cannot be.
    pub(super) fn add_shot(&mut self, camera: &str, values: Object) -> Result<(), String> {
        for (list, entries) in &values {
            for (name, entry) in entries.as_object().into_iter().flatten() {
                let what = format!("{} \"{name}\"", list.trim_end_matches('s'));
                if self.entry(list, name).is_none() {
                    return Err(format!("{what}: there is no such {}", list.trim_end_matches('s')));
                }
                let mut keys = entry.as_object().into_iter().flatten().map(|(key, _)| key);
                if let Some(key) = keys.find(|key| SHARED.contains(&key.as_str())) {
                    return Err(format!("{what}: {key} is the same in all shots"));
                }
            }
        }
        let lit = Self { shots: Vec::new(), ..self.clone() }.replaced(&values)?;
        // In the keys that this program writes: lumen become an intensity.
        let mut shot = Shot::new(camera);
        for list in LISTS {
            for (name, entry) in values.get(list).and_then(Value::as_object).into_iter().flatten() {
                let [shared, own] = [self, &lit].map(|rig| rig.entry(list, name).expect("it was found above"));
                let is_given = |key: &str| entry.get(key).is_some();
                let keys = shared.keys().chain(own.keys().filter(|key| !shared.contains_key(*key)));
                for key in keys.filter(|key| is_given(key) || shared.get(*key) != own.get(*key)) {
                    shot.set(list, name, key, own.get(key).cloned().unwrap_or_default());
                }
            }
        }
        self.shots.push(shot);
        Ok(())
    }

    /// The entry of a light or group, as [`whole`](super::diff::whole) has it.
    fn entry(&self, list: &str, name: &str) -> Option<Object> {
        Some(object(match list {
            "lights" => json!(self.light_entry(self.lights.iter().position(|light| light.name == name)?)),
            _ => json!(self.group_entry(self.groups.iter().position(|group| group.name == name)?)),
        }))
    }

    pub fn shot(&self, camera: &str) -> Option<&Shot> {
        self.shots.iter().find(|shot| shot.camera == camera)
    }

    /// The rig in pictures of the camera of this name, without shots and snapshots. An error names the shot and the
    /// light.
    pub fn of_shot(&self, camera: &str) -> Result<Self, String> {
        let shared = Self { shots: Vec::new(), snapshots: Vec::new(), ..self.clone() };
        match self.shot(camera) {
            None => Ok(shared),
            Some(shot) => shared.replaced(&shot.values).map_err(|reason| format!("shot \"{camera}\": {reason}")),
        }
    }

    /// The rig with other values, by list, name and key, in place of its own: a patch would merge tables.
    fn replaced(mut self, values: &Object) -> Result<Self, String> {
        let lights = values.get("lights").and_then(Value::as_object);
        let has_factors = |light: &&mut Light| {
            lights.is_some_and(|lights| lights.get(&light.name).is_some_and(|own| own.get("factor").is_some()))
        };
        self.lights.iter_mut().filter(has_factors).for_each(|light| light.links.factor.clear());
        apply(&self, values.clone(), Path::new(""))
    }

    /// The rig after an edit that turned its lights in pictures of `camera` from `before` into `after`. Values that
    /// differ in this shot change there, and all others in all shots; with `only_here` all values change in this shot
    /// alone. An error names a shot and a light that would be invalid.
    pub fn edited_in_shot(&self, camera: &str, [before, after]: [&Self; 2], only_here: bool) -> Result<Self, String> {
        let mut edited = Self { snapshots: self.snapshots.clone(), shots: Vec::new(), ..after.clone() };
        if self.shots.is_empty() && !only_here {
            return Ok(edited);
        }
        let mut shots = self.shots.clone();
        let at = shots.iter().position(|shot| shot.camera == camera).unwrap_or_else(|| {
            shots.push(Shot::new(camera));
            shots.len() - 1
        });
        // Entries of the rig before the edit by their names after it.
        let mut known: Vec<(&str, String, Object)> = Vec::new();
        for list in LISTS {
            let names: Vec<&String> = match list {
                "lights" => self.lights.iter().map(|light| &light.name).collect(),
                _ => self.groups.iter().map(|group| &group.name).collect(),
            };
            let mut changes = diff(before, after).remove(list).map(object).unwrap_or_default();
            for name in names {
                let change = changes.remove(name);
                if change == Some(Value::Null) {
                    shots.iter_mut().for_each(|shot| drop(shot.list(list).remove(name)));
                    continue;
                }
                let change = change.map(object).unwrap_or_default();
                let new_name = change.get("name").and_then(Value::as_str).unwrap_or(name);
                if new_name != name {
                    for shot in &mut shots {
                        let entry = shot.list(list).remove(name);
                        entry.into_iter().for_each(|entry| drop(shot.list(list).insert(new_name.to_owned(), entry)));
                    }
                }
                let differs =
                    |key: &str, shot: &Shot| shot.values(list, new_name).is_some_and(|values| values.contains_key(key));
                let entry = after.entry(list, new_name).expect("it stays");
                for key in change.keys().filter(|key| !SHARED.contains(&key.as_str())) {
                    if only_here || differs(key, &shots[at]) {
                        shots[at].set(list, new_name, key, entry.get(key).cloned().unwrap_or_default());
                    }
                }
                known.push((list, new_name.to_owned(), self.entry(list, name).expect("it has this name")));
            }
        }
        // What is of this shot alone stays in the others as it was.
        let mut shared = Shot::default();
        for (list, name, entry) in &known {
            for key in shots[at].values(list, name).into_iter().flat_map(Object::keys) {
                shared.set(list, name, key, entry.get(key).cloned().unwrap_or_default());
            }
        }
        edited = edited.replaced(&shared.values)?;
        edited.snapshots.clone_from(&self.snapshots);
        edited.shots = shots;
        edited.shots.retain(|shot| !shot.is_empty());
        edited.shots.iter().try_for_each(|shot| edited.of_shot(&shot.camera).map(drop))?;
        Ok(edited)
    }

    /// Makes lights and groups in pictures of `camera` those of all other shots. An error names a light that would be
    /// invalid.
    pub fn share(&mut self, camera: &str, lights: &[String], groups: &[String]) -> Result<(), String> {
        let Some(shot) = self.shots.iter_mut().find(|shot| shot.camera == camera) else { return Ok(()) };
        shot.forget("lights", lights);
        shot.forget("groups", groups);
        self.shots.retain(|shot| !shot.is_empty());
        self.of_shot(camera).map(drop)
    }
}
