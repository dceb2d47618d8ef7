//! The lighting desk without its window: lights, which of them are selected, and every edit that a hand can make.

mod alike;
mod check;
mod edit;
mod groups;
mod lists;
mod place;
pub mod selection;
pub mod snapshots;

pub use self::edit::{Frame, LightEdit, luminance};
pub use self::groups::GroupEdit;
pub use self::place::Pick;
use self::selection::Selection;
use self::snapshots::Snapshots;
use super::describe::{kind_name, rounded};
use super::history::History;
use crate::scene::{Camera, Light, Rig};

pub struct Desk {
    rig: Rig,
    selection: Selection,
    history: History,
    snapshots: Snapshots,
    /// Counts the states that the rig went through.
    version: u64,
    camera: Camera,
    /// Metres that a plain step moves: a nice number near a hundredth of the scene's radius.
    step: f64,
    /// How far off a surface a light is put, metres.
    lift: f64,
    /// What happened last, for people.
    pub message: String,
}

impl Desk {
    /// `radius` is that of the scene, metres.
    pub fn new(rig: Rig, camera: Camera, radius: f64) -> Self {
        let mut desk = Self {
            selection: Selection::of((!rig.lights.is_empty()).then_some(0)),
            history: History::new(&rig),
            snapshots: Snapshots::default(),
            rig,
            version: 0,
            camera,
            step: nice(radius / 100.0),
            lift: radius / 20.0,
            message: String::new(),
        };
        desk.message = match desk.selection.is_empty() {
            true => "no lights yet: Ctrl+1, 2 or 3 adds one".into(),
            false => desk.summary(),
        };
        desk
    }

    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    pub fn history(&self) -> &History {
        &self.history
    }

    /// Changes whenever the rig does.
    pub fn version(&self) -> u64 {
        self.version
    }

    pub fn selection(&self) -> &Selection {
        &self.selection
    }

    /// The light that was selected last.
    pub fn selected(&self) -> Option<usize> {
        self.selection.primary()
    }

    pub fn selected_light(&self) -> Option<&Light> {
        self.selected().map(|index| &self.rig.lights[index])
    }

    pub fn step(&self) -> f64 {
        self.step
    }

    /// Whether lights are off because others are solo.
    pub fn is_solo(&self) -> bool {
        self.rig.lights.iter().any(|light| light.solo) || self.rig.groups.iter().any(|group| group.solo)
    }

    pub fn select(&mut self, selection: Selection) {
        self.history.end_gesture();
        self.selection = selection.within(self.rig.lights.len());
        self.message = self.summary();
    }

    /// Selects the next light, or the one before: `by` is 1 or -1.
    pub fn select_next(&mut self, by: isize) {
        if let Some(index) = self.next(by) {
            self.select(Selection::only(index));
        }
    }

    /// Selects the next light, or the one before, with those that are.
    pub fn select_next_too(&mut self, by: isize) {
        if let Some(index) = self.next(by) {
            let mut selection = self.selection.clone();
            selection.add(index);
            self.select(selection);
        }
    }

    pub fn select_all(&mut self) {
        let mut all = Selection::of(0..self.rig.lights.len());
        self.selected().into_iter().for_each(|primary| all.add(primary));
        self.select(all);
    }

    fn next(&mut self, by: isize) -> Option<usize> {
        let count = self.rig.lights.len();
        if count == 0 {
            self.message = "there are no lights".into();
            return None;
        }
        Some(self.selected().map_or(0, |i| (i as isize + by).rem_euclid(count as isize) as usize))
    }

    /// One line on what is selected.
    pub fn summary(&self) -> String {
        let Some(index) = self.selected() else { return "no light".into() };
        let light = &self.rig.lights[index];
        let off = if light.enabled { "" } else { ", off" };
        let more = match self.selection.len() {
            1 => String::new(),
            count => format!(" and {} more", count - 1),
        };
        let (kind, stops) = (kind_name(light.kind), rounded(light.stops));
        let count = self.rig.lights.len();
        format!("{}{more} ({kind}{off}), {} of {count}, {stops} stops", light.name, index + 1)
    }

    /// What comes next can be undone apart from what was.
    pub fn end_gesture(&mut self) {
        self.history.end_gesture();
    }

    /// The lights become those of `rig`, and what follows them changes alike; refused if no rig file could hold it.
    fn commit(&mut self, rig: Rig) {
        self.commit_as(rig, self.selection.clone(), None);
    }

    /// [`Self::commit`], with another selection, and under a name of its own.
    fn commit_as(&mut self, mut rig: Rig, selection: Selection, name: Option<String>) {
        alike::carry_to_followers(&self.rig, &mut rig);
        self.become_rig(rig, selection, name);
    }

    /// [`Self::commit_as`], with nobody following.
    fn become_rig(&mut self, rig: Rig, selection: Selection, name: Option<String>) {
        if rig == self.rig {
            return;
        }
        if let Err(reason) = check::check(&self.rig, &rig) {
            self.message = reason;
            return;
        }
        self.message = self.history.push(&rig, [&self.selection, &selection], name).to_owned();
        self.rig = rig;
        self.selection = selection;
        self.version += 1;
    }

    pub fn undo(&mut self) {
        match self.history.names()[0].map(ToOwned::to_owned) {
            None => self.message = "nothing to undo".into(),
            Some(name) => {
                self.go_to(self.history.current() - 1);
                self.message = format!("undone: {name}");
            }
        }
    }

    pub fn redo(&mut self) {
        match self.history.names()[1].is_some() {
            true => self.go_to(self.history.current() + 1),
            false => self.message = "nothing to redo".into(),
        }
    }

    /// Goes back, or forth, to the state of an entry of the history.
    pub fn go_to(&mut self, entry: usize) {
        self.selection = self.history.go_to(entry, &mut self.rig).within(self.rig.lights.len());
        self.version += 1;
        self.message = self.history.entries()[entry].name.clone();
    }

    /// The rig is in a file as it is now.
    pub fn mark_saved(&mut self) {
        self.history.mark_saved();
    }
}

/// The nearest of 1, 2, 5, 10, ... times a power of ten.
fn nice(x: f64) -> f64 {
    let power = 10f64.powf(x.max(1e-30).log10().floor());
    let times =
        [1.0, 2.0, 5.0, 10.0].into_iter().min_by(|a, b| (x / power - a).abs().total_cmp(&(x / power - b).abs()));
    power * times.expect("there are four")
}

#[cfg(test)]
mod tests;
