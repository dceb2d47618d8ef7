//! Changes of a rig's lights by a JSON Merge Patch of [`whole`](super::diff::whole).

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::keys::keys_of;
use super::merge_patch::{Object, merge, object};
use super::read::GroupEntry;
use super::read_light::LightEntry;
use super::{Rig, without_dots};
use crate::scene::{LightKind, ObjectSet, RigFiles};

/// Keys of which an entry has one.
const EXCLUSIVE: [&[&str]; 3] =
    [&["intensity", "lumen", "nit", "watt", "radiance"], &["color", "kelvin", "radiance"], &["map", "physical_sky"]];

/// `rig` changed by `patch`, without snapshots. Names have no dots. Paths are relative to `folder`. An error names the
/// light, group or set.
pub fn apply(rig: &Rig, patch: Object, folder: &Path) -> Result<Rig, String> {
    let mut rig = Rig { snapshots: Vec::new(), ..rig.clone() };
    let mut lights = Vec::new();
    for (list, changes) in patch {
        let Value::Object(changes) = changes else { return Err(format!("{list} must be an object")) };
        match list.as_str() {
            "groups" => changes.into_iter().try_for_each(|(name, change)| patch_group(&mut rig, &name, change))?,
            "sets" => changes.into_iter().try_for_each(|(name, change)| patch_set(&mut rig, name, change))?,
            // These name groups.
            "lights" => lights = changes.into_iter().collect(),
            _ => return Err(format!("unknown list \"{list}\", expected \"groups\", \"sets\" or \"lights\"")),
        }
    }
    patch_lights(&mut rig, lights, folder)?;
    Ok(rig)
}

fn patch_group(rig: &mut Rig, name: &str, change: Value) -> Result<(), String> {
    let what = format!("group \"{name}\"");
    let known = rig.groups.iter().position(|group| group.name == name);
    match (known, change) {
        (None, Value::Null) => return Err(format!("{what}: there is no such group")),
        (Some(group), Value::Null) => {
            rig.groups.remove(group);
            for light in &mut rig.lights {
                light.group = light.group.filter(|of| *of != group).map(|of| of - usize::from(of > group));
            }
        }
        (known, Value::Object(change)) => {
            let entry = known.map_or_else(|| json!({ "name": name }), |group| json!(rig.group_entry(group)));
            let parsed =
                parse(&what, &[patched::<GroupEntry>(&what, entry, change)?], &[], RigFiles::new(Path::new("")))?;
            match (known, parsed.groups.into_iter().next().expect("one was parsed")) {
                (Some(group), parsed) => rig.groups[group] = parsed,
                (None, parsed) => rig.groups.push(parsed),
            }
        }
        _ => return Err(format!("{what}: expected an object, or null to delete it")),
    }
    Ok(())
}

fn patch_set(rig: &mut Rig, name: String, change: Value) -> Result<(), String> {
    let known = rig.sets.iter().position(|set| set.name == name);
    let items: Option<Option<Vec<String>>> = serde_json::from_value(change).ok();
    match (known, items) {
        (None, Some(None)) => return Err(format!("set \"{name}\": there is no such set")),
        (Some(set), Some(None)) => drop(rig.sets.remove(set)),
        (Some(set), Some(Some(items))) => rig.sets[set].items = items,
        (None, Some(Some(items))) => rig.sets.push(ObjectSet { name, items }),
        (_, None) => return Err(format!("set \"{name}\": expected a list of names, or null to delete it")),
    }
    Ok(())
}

fn patch_lights(rig: &mut Rig, changes: Vec<(String, Value)>, folder: &Path) -> Result<(), String> {
    let mut deleted = vec![false; rig.lights.len()];
    let mut new = Vec::new();
    // Leaders by name: they may come later in the patch.
    let mut leaders: Vec<(String, Value)> = Vec::new();
    // Before any is renamed.
    let index = |name: &str| rig.lights.iter().position(|light| light.name == name);
    let changes: Vec<_> = changes.into_iter().map(|(name, change)| (index(&name), name, change)).collect();
    for (known, name, change) in changes {
        let what = format!("light \"{name}\"");
        match (known, change) {
            (None, Value::Null) => return Err(format!("{what}: there is no such light")),
            (Some(light), Value::Null) if rig.lights[light].kind == LightKind::Emitter => {
                return Err(format!("{what}: a material emits this light; set \"enabled\" to false instead"));
            }
            (Some(light), Value::Null) => deleted[light] = true,
            (known, Value::Object(change)) => {
                let base = known.map(|light| &rig.lights[light]);
                let entry = known.map_or_else(|| json!({ "name": name }), |light| json!(rig.light_entry(light)));
                let follows_anew = change.contains_key("follows");
                let mut entry = patched::<LightEntry>(&what, entry, change)?;
                let leader = entry.remove("follows").unwrap_or(Value::Null);
                let group = entry.get("group").and_then(Value::as_str).map(without_dots);
                let group = group.and_then(|name| rig.groups.iter().position(|group| group.name == name));
                let groups: Vec<Object> = group.iter().map(|group| object(json!(rig.group_entry(*group)))).collect();
                let files = base.into_iter().fold(RigFiles::new(folder), |files, light| files.with_files_of(light));
                let parsed = parse(&what, &groups, &[entry], files)?;
                let mut light = parsed.lights.into_iter().next().expect("one was parsed");
                light.group = group;
                // The one whose map is rendered already.
                if let Some(base) = base.filter(|base| base.map == light.map) {
                    light.map.clone_from(&base.map);
                }
                light.follows = base.and_then(|base| base.follows);
                if follows_anew {
                    leaders.push((light.name.clone(), leader));
                }
                match known {
                    Some(known) => rig.lights[known] = light,
                    None => new.push(light),
                }
            }
            _ => return Err(format!("{what}: expected an object, or null to delete it")),
        }
    }
    rig.retain_lights(|light, _| !deleted[light]);
    rig.lights.extend(new);
    for (name, leader) in leaders {
        let index = |name: &str| rig.lights.iter().position(|light| light.name == name);
        let follower = index(&name).expect("it was changed");
        let leader = match &leader {
            Value::Null => None,
            Value::String(leader) => match index(&without_dots(leader)) {
                Some(leader) => Some(leader),
                None => return Err(format!("light \"{name}\": there is no light \"{leader}\" to follow")),
            },
            _ => return Err(format!("light \"{name}\": follows must be the name of a light")),
        };
        rig.lights[follower].follows = leader;
    }
    let cyclic = |light: usize| format!("light \"{}\": lights follow each other in a cycle", rig.lights[light].name);
    rig.leaders_first().map(drop).map_err(cyclic)
}

/// The merged entry of a light or group. Of keys that exclude each other those of the change stay. An error names a key
/// that is to be removed and that a `T` does not have.
fn patched<T: DeserializeOwned>(what: &str, entry: Value, change: Object) -> Result<Object, String> {
    let is_unknown = |(key, value): &(&String, &Value)| value.is_null() && !keys_of::<T>().contains(&key.as_str());
    if let Some((key, _)) = change.iter().find(is_unknown) {
        return Err(format!("{what}: unknown field `{key}`"));
    }
    let mut entry = object(entry);
    let given = |key: &&str| change.get(*key).is_some_and(|value| !value.is_null());
    for keys in EXCLUSIVE.iter().filter(|keys| keys.iter().any(&given)) {
        keys.iter().filter(|key| !given(key)).for_each(|key| drop(entry.remove(*key)));
    }
    merge(&mut entry, change);
    Ok(entry)
}

/// Reads entries as those of a rig file. An error begins with `what`.
fn parse(what: &str, groups: &[Object], lights: &[Object], files: RigFiles) -> Result<Rig, String> {
    let wrong = |reason: String| if reason.starts_with(what) { reason } else { format!("{what}: {reason}") };
    let document = toml::Table::try_from(json!({ "group": groups, "light": lights }));
    let document = document.map_err(|error| wrong(error.to_string()))?;
    Rig::from_toml(&document.to_string(), files).map_err(|reason| {
        // It begins with the line of a file that nobody wrote.
        let after_line = reason.strip_prefix("line ").and_then(|rest| rest.split_once(": "));
        wrong(after_line.map_or(reason.clone(), |(_, reason)| reason.to_owned()))
    })
}
