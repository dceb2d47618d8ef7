//! One state of the lights, as the history and snapshots store it.

use std::sync::Arc;

use crate::scene::rig::Shot;
use crate::scene::{Light, LightGroup, ObjectSet, Rig};

/// One state of the lights. States share lights, so each state costs little more than a list of pointers.
#[derive(Clone, Debug, PartialEq)]
pub struct RigState {
    pub lights: Vec<Arc<Light>>,
    pub groups: Vec<Arc<LightGroup>>,
    pub sets: Arc<Vec<ObjectSet>>,
    pub shots: Arc<Vec<Shot>>,
}

impl RigState {
    pub fn of(rig: &Rig) -> Self {
        Self {
            lights: rig.lights.iter().cloned().map(Arc::new).collect(),
            groups: rig.groups.iter().cloned().map(Arc::new).collect(),
            sets: Arc::new(rig.sets.clone()),
            shots: Arc::new(rig.shots.clone()),
        }
    }

    /// Returns the state of `rig`, which shares unchanged lights and groups with this one.
    pub fn then(&self, rig: &Rig) -> Self {
        Self {
            lights: shared(&self.lights, &rig.lights, |light| &light.name),
            groups: shared(&self.groups, &rig.groups, |group| &group.name),
            sets: if *self.sets == rig.sets { self.sets.clone() } else { Arc::new(rig.sets.clone()) },
            shots: if *self.shots == rig.shots { self.shots.clone() } else { Arc::new(rig.shots.clone()) },
        }
    }

    /// Replaces the lights, groups, sets and shots of `rig` by those of this state.
    pub fn put_into(&self, rig: &mut Rig) {
        rig.lights = self.lights.iter().map(|light| Light::clone(light)).collect();
        rig.groups = self.groups.iter().map(|group| LightGroup::clone(group)).collect();
        rig.sets.clone_from(&self.sets);
        rig.shots.clone_from(&self.shots);
    }

    pub fn has_lists_of(&self, other: &Self) -> bool {
        (self.lights.len(), self.groups.len()) == (other.lights.len(), other.groups.len())
    }

    /// Returns the indices of lights that are new or changed since `before`, or whose group changed.
    pub fn edited_since(&self, before: &Self) -> Vec<usize> {
        let same_list = self.lights.len() == before.lights.len();
        let is_known = |light: &Light| before.lights.iter().any(|other| other.name == light.name);
        let group_changed =
            |light: &Light| light.group.is_some_and(|group| before.groups.get(group) != self.groups.get(group));
        let is_edited = |index: &usize| {
            let light = &self.lights[*index];
            if same_list { *light != before.lights[*index] || group_changed(light) } else { !is_known(light) }
        };
        (0..self.lights.len()).filter(is_edited).collect()
    }
}

/// Returns `new` as shared values; those equal to a value of the same name in `old` are shared with it. Common values
/// must have the same order in both lists.
fn shared<T: Clone + PartialEq>(old: &[Arc<T>], new: &[T], name: impl Fn(&T) -> &str) -> Vec<Arc<T>> {
    let mut rest = old;
    let mut share = |value: &T| {
        let found = rest.iter().position(|other| name(other) == name(value))?;
        let shared = &rest[found];
        rest = &rest[found + 1..];
        (**shared == *value).then(|| shared.clone())
    };
    new.iter().map(|value| share(value).unwrap_or_else(|| Arc::new(value.clone()))).collect()
}
