//! Undo and redo without end: every state of the lights, with what did not change shared between states.

use std::sync::Arc;

use super::describe;
use super::desk::selection::Selection;
use crate::scene::{Light, LightGroup, Rig};

/// The lights at one time. A thousand states of a hundred lights are a thousand lists of pointers.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    pub lights: Vec<Arc<Light>>,
    pub groups: Vec<Arc<LightGroup>>,
}

/// A state and how it came about.
pub struct Entry {
    /// "key: +0.5 stop"
    pub name: String,
    state: State,
    /// What undoing and redoing select.
    selected_before: Selection,
    selected_after: Selection,
    /// The lights that became others.
    edited: Vec<usize>,
    /// Edits of one gesture, a held key or a drag, are one entry.
    gesture: u64,
    /// Tells entries apart that stand at the same place.
    id: u64,
}

pub struct History {
    /// The first one is what was opened.
    entries: Vec<Entry>,
    current: usize,
    gesture: u64,
    next_id: u64,
    /// The id of the state that is in the file.
    saved: u64,
}

impl State {
    pub fn of(rig: &Rig) -> Self {
        Self {
            lights: rig.lights.iter().cloned().map(Arc::new).collect(),
            groups: rig.groups.iter().cloned().map(Arc::new).collect(),
        }
    }

    /// The state of `rig`, sharing with this one what is the same.
    fn then(&self, rig: &Rig) -> Self {
        Self {
            lights: shared(&self.lights, &rig.lights, |light| &light.name),
            groups: shared(&self.groups, &rig.groups, |group| &group.name),
        }
    }

    /// Makes `rig`'s lights these.
    pub fn put_into(&self, rig: &mut Rig) {
        rig.lights = self.lights.iter().map(|light| Light::clone(light)).collect();
        rig.groups = self.groups.iter().map(|group| LightGroup::clone(group)).collect();
    }

    fn has_lists_of(&self, other: &Self) -> bool {
        (self.lights.len(), self.groups.len()) == (other.lights.len(), other.groups.len())
    }

    /// The lights that were others in `before`, or not there; all that are in a group that was another.
    fn edited_since(&self, before: &Self) -> Vec<usize> {
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

/// `new` as shared values, taken from `old` where they are equal; what stays keeps its order.
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

impl History {
    pub fn new(opened: &Rig) -> Self {
        let entry = Entry {
            name: "opened".into(),
            state: State::of(opened),
            selected_before: Selection::default(),
            selected_after: Selection::default(),
            edited: Vec::new(),
            gesture: 0,
            id: 0,
        };
        Self { entries: vec![entry], current: 0, gesture: 1, next_id: 1, saved: 0 }
    }

    /// Takes in what became of the lights, and returns what that is called: `name`, or what the change is. It joins the
    /// last entry if both belong to one gesture.
    pub fn push(&mut self, rig: &Rig, selected: [&Selection; 2], name: Option<String>) -> &str {
        let state = self.state().then(rig);
        self.entries.truncate(self.current + 1);
        let last = &self.entries[self.current];
        let joins = self.current > 0 && last.gesture == self.gesture && last.state.has_lists_of(&state);
        let mut selected_before = selected[0].clone();
        if joins {
            selected_before.clone_from(&last.selected_before);
            self.entries.pop();
            self.current -= 1;
        }
        let before = self.state();
        if joins && *before == state {
            return "as before";
        }
        let entry = Entry {
            name: name.unwrap_or_else(|| describe::change(before, &state)),
            edited: state.edited_since(before),
            state,
            selected_before,
            selected_after: selected[1].clone(),
            gesture: self.gesture,
            id: self.next_id,
        };
        self.next_id += 1;
        self.entries.push(entry);
        self.current += 1;
        &self.entries[self.current].name
    }

    /// What comes next is an edit of its own.
    pub fn end_gesture(&mut self) {
        self.gesture += 1;
    }

    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Index of the entry whose state the lights are in.
    pub fn current(&self) -> usize {
        self.current
    }

    pub fn state(&self) -> &State {
        &self.entries[self.current].state
    }

    /// Goes to the state of entry `index`; returns what was selected then.
    pub fn go_to(&mut self, index: usize, rig: &mut Rig) -> Selection {
        self.end_gesture();
        let back = index < self.current;
        self.current = index;
        let entry = &self.entries[index];
        entry.state.put_into(rig);
        match self.entries.get(index + 1).filter(|_| back) {
            Some(undone) => undone.selected_before.clone(),
            None => entry.selected_after.clone(),
        }
    }

    /// What undo would take back, and redo do again.
    pub fn names(&self) -> [Option<&str>; 2] {
        let undo = (self.current > 0).then(|| self.entries[self.current].name.as_str());
        [undo, self.entries.get(self.current + 1).map(|entry| entry.name.as_str())]
    }

    pub fn mark_saved(&mut self) {
        self.end_gesture();
        self.saved = self.entries[self.current].id;
    }

    /// Whether the rig differs from what was loaded or last saved.
    pub fn is_unsaved(&self) -> bool {
        self.entries[self.current].id != self.saved
    }

    /// The lights that were edited last, since the rig was loaded or saved.
    ///
    /// They are kept out of the sum of all others, which gives a picture its last bits: so those depend on the state of
    /// the rig alone, and come back with it.
    pub fn focus(&self) -> &[usize] {
        if self.is_unsaved() { &self.entries[self.current].edited } else { &[] }
    }
}
