//! Undo and redo without end: every edit as the change of one light, named after what it did.

use crate::scene::{Light, LightKind, Rig};

/// The change of one light, forwards.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    Replace { index: usize, before: Box<Light>, after: Box<Light> },
    Insert { index: usize, light: Box<Light> },
    Remove { index: usize, light: Box<Light> },
}

/// One entry of the history.
#[derive(Clone, Debug)]
pub struct Edit {
    pub change: Change,
    /// The selection to which undoing returns.
    pub selected_before: Option<usize>,
    /// Edits of one gesture, a held key or a drag, are one entry.
    gesture: u64,
    /// Tells states apart that are equally deep.
    id: u64,
}

#[derive(Default)]
pub struct History {
    done: Vec<Edit>,
    undone: Vec<Edit>,
    gesture: u64,
    next_id: u64,
    /// The id of the last edit that is in the file; `None`: no edit is.
    saved: Option<u64>,
}

impl Change {
    pub fn apply(&self, rig: &mut Rig) {
        match self {
            Self::Replace { index, after, .. } => rig.lights[*index] = *after.clone(),
            Self::Insert { index, light } => rig.lights.insert(*index, *light.clone()),
            Self::Remove { index, .. } => drop(rig.lights.remove(*index)),
        }
    }

    pub fn revert(&self, rig: &mut Rig) {
        match self {
            Self::Replace { index, before, .. } => rig.lights[*index] = *before.clone(),
            Self::Insert { index, .. } => drop(rig.lights.remove(*index)),
            Self::Remove { index, light } => rig.lights.insert(*index, *light.clone()),
        }
    }

    /// "key: +0.5 stop"
    pub fn name(&self) -> String {
        match self {
            Self::Replace { before, after, .. } => format!("{}: {}", before.name, difference(before, after)),
            Self::Insert { light, .. } => format!("{}: new", light.name),
            Self::Remove { light, .. } => format!("{}: deleted", light.name),
        }
    }
}

/// What became of a light, in a few words.
fn difference(before: &Light, after: &Light) -> String {
    let mut parts = Vec::new();
    if before.name != after.name {
        parts.push(format!("renamed {}", after.name));
    }
    if before.kind != after.kind {
        parts.push(format!("made a {} light", kind_name(after.kind)));
    }
    if before.enabled != after.enabled {
        parts.push(if after.enabled { "on" } else { "off" }.into());
    }
    if before.shadows != after.shadows {
        parts.push(if after.shadows { "shadows on" } else { "shadows off" }.into());
    }
    if before.position != after.position {
        parts.push(format!("moved {} m", rounded((after.position - before.position).length())));
    }
    if before.direction != after.direction {
        let turned = before.direction.angle_between(after.direction).to_degrees();
        parts.push(format!("turned {}°", rounded(turned)));
    }
    if before.stops != after.stops {
        let by = after.stops - before.stops;
        let unit = if by.abs() > 1.0 { "stops" } else { "stop" };
        parts.push(format!("{}{} {unit}", if by > 0.0 { "+" } else { "" }, rounded(by)));
    }
    if before.intensity != after.intensity {
        parts.push(format!("{} {}", rounded(after.intensity), intensity_unit(after.kind)));
    }
    if before.color != after.color {
        parts.push("colour".into());
    }
    if before.outer_angle != after.outer_angle {
        parts.push(format!("cone {}°", rounded(after.outer_angle.to_degrees())));
    } else if before.inner_angle != after.inner_angle {
        parts.push(format!("inner cone {}°", rounded(after.inner_angle.to_degrees())));
    }
    if before.range != after.range {
        parts.push(after.range.map_or("no range".into(), |range| format!("range {} m", rounded(range))));
    }
    if before.group != after.group {
        parts.push("group".into());
    }
    parts.join(", ")
}

pub fn kind_name(kind: LightKind) -> &'static str {
    match kind {
        LightKind::Point => "point",
        LightKind::Spot => "spot",
        LightKind::Directional => "directional",
    }
}

pub fn intensity_unit(kind: LightKind) -> &'static str {
    if kind == LightKind::Directional { "lx" } else { "cd" }
}

/// Three significant digits, as people write them.
pub fn rounded(x: f64) -> String {
    let digits = (2 - x.abs().max(1e-9).log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{x:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

impl History {
    /// Takes in a change that was made. It joins the last one if both belong to one gesture and one light.
    pub fn push(&mut self, change: Change, selected_before: Option<usize>) {
        self.undone.clear();
        if let Some(last) = self.done.last_mut()
            && last.gesture == self.gesture
            && let Change::Replace { index, before, after } = &mut last.change
            && let Change::Replace { index: same, after: newer, .. } = &change
            && index == same
        {
            after.clone_from(newer);
            self.next_id += 1;
            last.id = self.next_id;
            if before == after {
                self.done.pop();
            }
            return;
        }
        self.next_id += 1;
        self.done.push(Edit { change, selected_before, gesture: self.gesture, id: self.next_id });
    }

    /// What comes next is an edit of its own.
    pub fn end_gesture(&mut self) {
        self.gesture += 1;
    }

    pub fn undo(&mut self, rig: &mut Rig) -> Option<&Edit> {
        self.end_gesture();
        let edit = self.done.pop()?;
        edit.change.revert(rig);
        self.undone.push(edit);
        self.undone.last()
    }

    pub fn redo(&mut self, rig: &mut Rig) -> Option<&Edit> {
        self.end_gesture();
        let edit = self.undone.pop()?;
        edit.change.apply(rig);
        self.done.push(edit);
        self.done.last()
    }

    /// What undo would take back, and redo do again.
    pub fn names(&self) -> [Option<String>; 2] {
        [self.done.last(), self.undone.last()].map(|edit| edit.map(|e| e.change.name()))
    }

    pub fn mark_saved(&mut self) {
        self.end_gesture();
        self.saved = self.position();
    }

    /// Whether the rig differs from what was loaded or last saved.
    pub fn is_unsaved(&self) -> bool {
        self.position() != self.saved
    }

    /// The light that was edited last, since the rig was loaded or saved.
    ///
    /// It is kept out of the sum of all others, which gives a picture its last bits: so those depend on the state of
    /// the rig alone, and come back with it.
    pub fn focus(&self) -> Option<usize> {
        match &self.done.last().filter(|_| self.is_unsaved())?.change {
            Change::Replace { index, .. } | Change::Insert { index, .. } => Some(*index),
            Change::Remove { .. } => None,
        }
    }

    fn position(&self) -> Option<u64> {
        self.done.last().map(|edit| edit.id)
    }
}
