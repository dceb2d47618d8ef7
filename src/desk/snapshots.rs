//! Snapshots: states of the lights, stored to be recalled or compared.

use std::borrow::Cow;

use super::Desk;
use super::rig_state::RigState;
use super::selection::Selection;
use crate::scene::rig::{RigSnapshot, SLOTS};
use crate::scene::{Emitters, Rig};

/// A stored state of the lights.
pub struct Snapshot {
    /// Note of the user.
    pub note: String,
    state: RigState,
    /// Unique number; distinguishes it from earlier snapshots in its slot.
    pub id: u64,
}

/// All snapshots, by slot.
#[derive(Default)]
pub struct Snapshots {
    slots: [Option<Snapshot>; SLOTS],
    /// Slot that was stored or recalled last.
    last: Option<usize>,
    /// Number of changes.
    version: u64,
    /// Version that was loaded or last saved.
    saved: u64,
}

impl Snapshots {
    /// The snapshots of a rig file. The one of the highest slot counts as the last.
    pub fn loaded(stored: Vec<RigSnapshot>) -> Self {
        let mut snapshots = Self::default();
        snapshots.replace(stored);
        snapshots.mark_saved();
        snapshots
    }

    fn replace(&mut self, stored: Vec<RigSnapshot>) {
        self.slots = Default::default();
        self.last = stored.iter().map(|snapshot| snapshot.slot).max();
        for RigSnapshot { slot, note, rig } in stored {
            self.version += 1;
            self.slots[slot] = Some(Snapshot { note, state: RigState::of(&rig), id: self.version });
        }
        self.version += 1;
    }

    /// Changes whenever a snapshot or note does.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Whether a snapshot or note differs from what was loaded or last saved.
    pub fn are_unsaved(&self) -> bool {
        self.version != self.saved
    }

    pub fn mark_saved(&mut self) {
        self.saved = self.version;
    }

    pub fn get(&self, slot: usize) -> Option<&Snapshot> {
        self.slots[slot].as_ref()
    }

    /// Returns the slot that was stored or recalled last.
    pub fn last(&self) -> Option<usize> {
        self.last
    }
}

impl Snapshot {
    /// Formats the slot and the note: "3" or "3: warmer key".
    pub fn label(&self, slot: usize) -> String {
        if self.note.is_empty() { format!("{}", slot + 1) } else { format!("{}: {}", slot + 1, self.note) }
    }
}

impl Desk {
    pub fn snapshots(&self) -> &Snapshots {
        &self.snapshots
    }

    /// Stores the current lights in a slot, in place of its snapshot. The note of the slot is retained.
    pub fn store(&mut self, slot: usize) {
        self.history.end_gesture();
        let Snapshots { slots, last, version, .. } = &mut self.snapshots;
        *version += 1;
        let note = slots[slot].take().map(|old| old.note).unwrap_or_default();
        slots[slot] = Some(Snapshot { note, state: self.history.state().clone(), id: *version });
        *last = Some(slot);
        self.message = format!("stored in slot {}", slot + 1);
    }

    /// Replaces the lights by those of a snapshot, as an edit that can be undone.
    pub fn recall(&mut self, slot: usize) {
        self.history.end_gesture();
        let Some(snapshot) = &self.snapshots.slots[slot] else {
            self.message = format!("slot {} is empty", slot + 1);
            return;
        };
        let name = format!("recalled {}", snapshot.label(slot));
        let rig = self.snapshot_rig(slot).expect("it is there");
        let selection = self.selection.clone().within(rig.lights.len());
        self.snapshots.last = Some(slot);
        self.replace_or_tell(rig, selection, Some(name));
        self.history.end_gesture();
    }

    /// Adds the emitters of a scene that was loaded again to snapshots that lack them.
    pub(super) fn complete_snapshots(&mut self, emitters: &Emitters) {
        for slot in 0..SLOTS {
            let Some(rig) = self.snapshot_rig(slot) else { continue };
            if let (Cow::Owned(rig), Some(snapshot)) = (emitters.complete(&rig), &mut self.snapshots.slots[slot]) {
                snapshot.state = RigState::of(&rig);
            }
        }
    }

    /// Sets the note of a snapshot.
    pub fn annotate(&mut self, slot: usize, note: String) {
        if let Some(snapshot) = &mut self.snapshots.slots[slot] {
            snapshot.note = note;
            self.snapshots.version += 1;
        }
    }

    /// Returns the lights of a snapshot.
    pub fn snapshot_rig(&self, slot: usize) -> Option<Rig> {
        let snapshot = self.snapshots.get(slot)?;
        let mut rig = Rig { camera: self.rig.camera.clone(), sets: self.rig.sets.clone(), ..Rig::default() };
        snapshot.state.put_into(&mut rig);
        Some(rig)
    }

    /// Returns the rig with its snapshots, as a file stores it.
    pub fn rig_to_save(&self) -> Rig {
        let stored = self.snapshots.slots.iter().enumerate().filter_map(|(slot, snapshot)| {
            let snapshot = snapshot.as_ref()?;
            let mut rig = Rig::default();
            snapshot.state.put_into(&mut rig);
            Some(RigSnapshot { slot, note: snapshot.note.clone(), rig })
        });
        Rig { snapshots: stored.collect(), ..self.base.clone() }
    }

    /// Replaces lights and snapshots by those that a crash left.
    pub fn recover(&mut self, mut rig: Rig) {
        self.snapshots.replace(std::mem::take(&mut rig.snapshots));
        let count = rig.lights.len();
        let selection = match count {
            0 => Selection::default(),
            _ if self.selection.is_empty() => Selection::only(0),
            _ => self.selection.clone().within(count),
        };
        let rig = Rig { camera: self.rig.camera.clone(), ..rig };
        self.replace_base(rig, selection, Some("recovered".into()));
        self.history.end_gesture();
    }
}
