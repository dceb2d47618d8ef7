//! Unlimited undo and redo: all states of the lights, which share their unchanged parts.

use super::describe;
use super::rig_state::RigState;
use super::selection::Selection;
use crate::scene::Rig;

/// A state, and the edit that led to it.
pub struct Entry {
    /// Description of the edit: "key: +0.5 stop".
    pub name: String,
    /// The lights as the shown camera sees them.
    state: RigState,
    /// The lights of all shots.
    base: RigState,
    /// Selection after undoing the edit.
    selected_before: Selection,
    /// Selection after redoing the edit.
    selected_after: Selection,
    /// Indices of the lights that the edit changed.
    edited: Vec<usize>,
    /// Number of the gesture; edits of one gesture (a held key or a drag) are one entry.
    gesture: u64,
    /// Unique number; distinguishes entries that have stood at the same index.
    id: u64,
}

impl Entry {
    /// The lights of all shots.
    pub fn base(&self) -> &RigState {
        &self.base
    }
}

/// The history of the lights.
pub struct History {
    /// The first entry is the opened rig.
    entries: Vec<Entry>,
    current: usize,
    gesture: u64,
    next_id: u64,
    /// Id of the saved entry.
    saved: u64,
}

impl History {
    /// `opened`: as the camera sees the lights, and of all shots.
    pub fn new(opened: [&Rig; 2]) -> Self {
        let entry = Entry {
            name: "opened".into(),
            state: RigState::of(opened[0]),
            base: RigState::of(opened[1]),
            selected_before: Selection::default(),
            selected_after: Selection::default(),
            edited: Vec::new(),
            gesture: 0,
            id: 0,
        };
        Self { entries: vec![entry], current: 0, gesture: 1, next_id: 1, saved: 0 }
    }

    /// Records a change and returns its description: `name`, or else one derived from the change. Merged with the last
    /// entry if both belong to one gesture. `rigs`: as the camera sees the lights, and
    /// of all shots. `selected` is the selection before and after the change.
    pub fn push(&mut self, rigs: [&Rig; 2], selected: [&Selection; 2], name: Option<String>) -> &str {
        let entry = &self.entries[self.current];
        let (state, base) = (entry.state.then(rigs[0]), entry.base.then(rigs[1]));
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
        if joins && *before == state && self.entries[self.current].base == base {
            return "no change";
        }
        let entry = Entry {
            name: name.unwrap_or_else(|| describe::change(before, &state)),
            edited: state.edited_since(before),
            state,
            base,
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

    /// Ends a gesture: the next edit is an entry of its own.
    pub fn end_gesture(&mut self) {
        self.gesture += 1;
    }

    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Returns the index of the current entry.
    pub fn current(&self) -> usize {
        self.current
    }

    pub fn state(&self) -> &RigState {
        &self.entries[self.current].state
    }

    /// Takes the lights of the current entry as another camera sees them.
    pub fn look_at(&mut self, rig: &Rig) {
        let entry = &mut self.entries[self.current];
        entry.state = entry.state.then(rig);
    }

    /// Restores the state of entry `index` in `base`, the lights of all shots; returns the selection of that state.
    pub fn go_to(&mut self, index: usize, base: &mut Rig) -> Selection {
        self.end_gesture();
        let back = index < self.current;
        self.current = index;
        let entry = &self.entries[index];
        entry.base.put_into(base);
        match self.entries.get(index + 1).filter(|_| back) {
            Some(undone) => undone.selected_before.clone(),
            None => entry.selected_after.clone(),
        }
    }

    /// Returns the descriptions of the edits that undo and redo would apply to.
    pub fn names(&self) -> [Option<&str>; 2] {
        let undo = (self.current > 0).then(|| self.entries[self.current].name.as_str());
        [undo, self.entries.get(self.current + 1).map(|entry| entry.name.as_str())]
    }

    /// Marks the current entry as saved.
    pub fn mark_saved(&mut self) {
        self.end_gesture();
        self.saved = self.entries[self.current].id;
    }

    /// No entry is the one that was saved.
    pub fn mark_unsaved(&mut self) {
        self.saved = u64::MAX;
    }

    /// Whether the rig differs from what was loaded or last saved.
    pub fn is_unsaved(&self) -> bool {
        self.entries[self.current].id != self.saved
    }

    /// Returns the indices of the lights of the last edit; empty if the rig is saved.
    ///
    /// The relighter adds these lights separately to the sum of all others. The order of summation, and so the
    /// rounding, depends only on the history entry. A restored entry thus gives the same picture, bit for bit.
    pub fn focus(&self) -> &[usize] {
        if self.is_unsaved() { &self.entries[self.current].edited } else { &[] }
    }
}
