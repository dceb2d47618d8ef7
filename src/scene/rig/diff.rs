//! The lights of a rig as a JSON object, and the merge patch between two rigs.
//!
//! ```json
//! {"groups": {"rim": {"stops": 0.5}}, "sets": {"table": ["Top", "Leg"]}, "lights": {"key": {"kind": "point"}}}
//! ```
//!
//! An entry has the keys of a rig file. A key that is missing has its default.

use std::collections::HashMap;

use serde_json::{Value, json};

use super::Rig;
use super::merge_patch::{Object, difference};
use crate::scene::Light;

/// All groups, sets and lights.
pub fn whole(rig: &Rig) -> Object {
    let mut whole: Object = ["groups", "sets", "lights"].map(|list| (list.to_owned(), json!({}))).into_iter().collect();
    whole.extend(diff(&Rig::default(), rig));
    whole
}

/// The patch that turns [`whole`] of `before` into that of `after`; empty if they are equal. A light or group that was
/// renamed has its old name, and `name` in its entry.
pub fn diff(before: &Rig, after: &Rig) -> Object {
    let rigs = [before, after];
    let groups = List {
        names: rigs.map(|rig| rig.groups.iter().map(|group| &*group.name).collect()),
        same: &|i, j| before.groups[i] == after.groups[j],
        entry: &|side, i| json!(rigs[side].group_entry(i)),
    };
    let sets = List {
        names: rigs.map(|rig| rig.sets.iter().map(|set| &*set.name).collect()),
        same: &|i, j| before.sets[i] == after.sets[j],
        entry: &|side, i| json!(rigs[side].sets[i].items),
    };
    let lights = List {
        names: rigs.map(|rig| rig.lights.iter().map(|light| &*light.name).collect()),
        same: &|i, j| is_same_light(rigs, i, j),
        entry: &|side, i| json!(rigs[side].light_entry(i)),
    };
    let lists = [("groups", groups.diff()), ("sets", sets.diff()), ("lights", lights.diff())];
    let changed = lists.into_iter().filter(|(_, changes)| !changes.is_empty());
    changed.map(|(list, changes)| (list.to_owned(), changes.into())).collect()
}

fn is_same_light([before, after]: [&Rig; 2], i: usize, j: usize) -> bool {
    let (was, is) = (&before.lights[i], &after.lights[j]);
    let group = |rig: &Rig, light: &Light| light.group.map(|group| rig.groups[group].name.clone());
    let leader = |rig: &Rig, light: &Light| light.follows.map(|leader| rig.lights[leader].name.clone());
    group(before, was) == group(after, is)
        && leader(before, was) == leader(after, is)
        && Light { group: is.group, follows: is.follows, ..was.clone() } == *is
}

/// A list of named values before (0) and after (1) a change.
struct List<'a> {
    names: [Vec<&'a str>; 2],
    /// Whether value `i` before equals value `j` after.
    same: &'a dyn Fn(usize, usize) -> bool,
    /// Side and index.
    entry: &'a dyn Fn(usize, usize) -> Value,
}

impl List<'_> {
    fn diff(&self) -> Object {
        let [before, after] = &self.names;
        let index = |side: usize| -> HashMap<&str, usize> {
            self.names[side].iter().enumerate().map(|(i, name)| (*name, i)).collect()
        };
        let (old, new) = (index(0), index(1));
        let is_renamed =
            |i: usize| before.len() == after.len() && !old.contains_key(after[i]) && !new.contains_key(before[i]);
        let mut patch = Object::new();
        for (i, name) in before.iter().enumerate() {
            if !new.contains_key(name) && !is_renamed(i) {
                patch.insert((*name).to_owned(), Value::Null);
            }
        }
        for (j, name) in after.iter().enumerate() {
            let known = old.get(name).copied().or_else(|| (j < before.len() && is_renamed(j)).then_some(j));
            let Some(i) = known else {
                patch.insert((*name).to_owned(), (self.entry)(1, j));
                continue;
            };
            if (self.same)(i, j) {
                continue;
            }
            let change = match ((self.entry)(0, i), (self.entry)(1, j)) {
                (Value::Object(was), Value::Object(is)) => difference(&was, &is).into(),
                (_, is) => is,
            };
            // Angles may differ by less than degrees tell.
            if change != json!({}) {
                patch.insert(before[i].to_owned(), change);
            }
        }
        patch
    }
}
