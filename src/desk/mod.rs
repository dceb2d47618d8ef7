//! The lighting desk without its window: lights, selection, and all edits.

mod apply_change;
mod attach;
mod check;
pub mod describe;
mod edit;
mod groups;
pub mod history;
mod linking;
mod lists;
mod place;
pub mod rig_state;
pub mod selection;
pub mod snapshots;

use std::borrow::Cow;

pub use self::attach::TakesMap;
use self::describe::{kind_name, rounded};
pub use self::edit::{Frame, LEAST_SPREAD, LightEdit, luminance};
pub use self::groups::GroupEdit;
use self::history::{Entry, History};
pub use self::linking::{LinkEdit, PickedObject};
pub use self::place::Pick;
use self::selection::Selection;
use self::snapshots::Snapshots;
use crate::scene::rig::Shot;
use crate::scene::{Camera, Emitters, Light, Rig, Scene};

/// What a light keeps when its size changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SizeKeeps {
    /// The intensity.
    Power,
    /// The intensity per area that the light shows; lights without radiance keep their intensity.
    Radiance,
}

/// The lighting desk: rig, selection, history and snapshots.
pub struct Desk {
    /// The lights of all shots.
    base: Rig,
    /// The lights as the camera sees them.
    rig: Rig,
    selection: Selection,
    history: History,
    snapshots: Snapshots,
    /// Number of changes of the rig.
    version: u64,
    camera: Camera,
    /// Length of a move step, metres: a round number near a hundredth of the scene's radius.
    step: f64,
    /// Distance from a surface at which a light is placed, metres.
    lift: f64,
    pub size_keeps: SizeKeeps,
    /// Whether edits change only the lights of the camera's shot.
    pub only_here: bool,
    /// Message to the user about the last action.
    pub message: String,
}

impl Desk {
    /// Selects the first light. `radius` is the radius of the scene, metres.
    pub fn new(mut rig: Rig, camera: Camera, radius: f64) -> Self {
        let snapshots = Snapshots::loaded(std::mem::take(&mut rig.snapshots));
        let (base, rig) = match rig.of_shot(&camera.name) {
            Ok(seen) => (rig, seen),
            Err(_) => (Rig { shots: Vec::new(), ..rig.clone() }, Rig { shots: Vec::new(), ..rig }),
        };
        let mut desk = Self {
            selection: Selection::of((!rig.lights.is_empty()).then_some(0)),
            history: History::new([&rig, &base]),
            snapshots,
            base,
            rig,
            version: 0,
            camera,
            step: step(radius),
            lift: lift(radius),
            size_keeps: SizeKeeps::Power,
            only_here: false,
            message: String::new(),
        };
        desk.message = match desk.selection.is_empty() {
            true => "no lights yet: press Ctrl+1 to Ctrl+5 to add one".into(),
            false => desk.summary(),
        };
        desk
    }

    /// The lights as they stand in `scene`, which was loaded again, with `own` lights in its file. Emitters are those
    /// of the scene. An error names the light whose links name what is not there any more.
    pub fn rig_in(&self, scene: &Scene, own: &Rig) -> Result<Rig, String> {
        let emitters = Emitters::of(scene);
        let mut rig = self.base.clone();
        rig.camera.clone_from(&own.camera);
        rig.retain_lights(|_, light| light.material.as_ref().is_none_or(|material| emitters.names.contains(material)));
        for light in &mut rig.lights {
            light.node = own.lights.iter().find(|own| own.name == light.name).and_then(|own| own.node);
        }
        let rig = emitters.complete(&rig).into_owned();
        rig.check_links(scene)?;
        Ok(rig)
    }

    /// Continues in a scene that was loaded again, with its [`Self::rig_in`]. If states of the history name objects
    /// or emissive materials that are not there any more, or lack new ones, nothing can be undone.
    pub fn change_scene(&mut self, rig: Rig, scene: &Scene, camera: Camera) {
        let radius = scene.space.unit;
        (self.camera, self.step, self.lift) = (camera, step(radius), lift(radius));
        let emitters = Emitters::of(scene);
        let fits = |entry: &Entry| {
            let mut rig = Rig::default();
            entry.base().put_into(&mut rig);
            let has_all = matches!(emitters.complete(&rig), Cow::Borrowed(_));
            rig.check_links(scene).is_ok() && emitters.check(&rig).is_ok() && has_all
        };
        self.complete_snapshots(&emitters);
        let selection = self.selection.clone().within(rig.lights.len());
        self.history.end_gesture();
        if self.history.entries().iter().all(fits) {
            self.replace_base(rig, selection, Some("scene loaded again".into()));
            self.history.end_gesture();
            return self.see_base();
        }
        let is_unsaved = self.history.is_unsaved() || rig != self.base;
        (self.base, self.selection) = (rig, selection);
        self.see_base();
        self.history = History::new([&self.rig, &self.base]);
        if is_unsaved {
            self.history.mark_unsaved();
        }
        self.message = "scene loaded again; nothing can be undone".into();
    }

    /// Takes another camera of the scene: lights move as it sees them, and have the values of its shot.
    pub fn look_from(&mut self, camera: Camera) {
        self.history.end_gesture();
        self.camera = camera;
        self.see_base();
    }

    /// Shows the lights of all shots as the camera sees them.
    fn see_base(&mut self) {
        match self.base.of_shot(&self.camera.name) {
            Ok(rig) => self.rig = rig,
            Err(reason) => self.message = reason,
        }
        self.history.look_at(&self.rig);
        self.version += 1;
    }

    /// The current lights as the camera sees them, without shots and snapshots.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The current lights of all shots, without snapshots.
    pub fn base(&self) -> &Rig {
        &self.base
    }

    /// What the shown shot has of its own, if it does.
    pub fn shot(&self) -> Option<&Shot> {
        self.base.shot(&self.camera.name)
    }

    /// Makes the selected lights and their groups in this shot as they are in all others.
    pub fn share_selected(&mut self) {
        let lights = || self.selection.iter().map(|light| &self.rig.lights[light]);
        let names: Vec<String> = lights().map(|light| light.name.clone()).collect();
        let groups = lights().filter_map(|light| light.group).map(|group| self.rig.groups[group].name.clone());
        let groups: Vec<String> = groups.collect();
        let mut base = self.base.clone();
        if let Err(reason) = base.share(&self.camera.name, &names, &groups) {
            self.message = reason;
            return;
        }
        self.history.end_gesture();
        self.replace_base(base, self.selection.clone(), Some(format!("{}: as in all shots", names.join(", "))));
        self.history.end_gesture();
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

    /// Returns the index of the primary light, which was selected last.
    pub fn selected(&self) -> Option<usize> {
        self.selection.primary()
    }

    /// Returns the primary light.
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

    /// Selects the next light (`by` is 1) or the previous light (-1).
    pub fn select_next(&mut self, by: isize) {
        if let Some(index) = self.next(by) {
            self.select(Selection::only(index));
        }
    }

    /// Adds the next light (`by` is 1) or the previous light (-1) to the selection.
    pub fn add_next_to_selection(&mut self, by: isize) {
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

    /// Describes the selection in one line.
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

    /// Ends a gesture: the next edit is undone separately.
    pub fn end_gesture(&mut self) {
        self.history.end_gesture();
    }

    /// Replaces the lights by those of `rig`, updates followers and applies [`SizeKeeps`]. Refused with a message if a
    /// rig file cannot store them.
    fn commit(&mut self, rig: Rig) {
        self.commit_as(rig, self.selection.clone(), None);
    }

    /// [`Self::commit`] with a new selection, and an optional name for the history.
    fn commit_as(&mut self, mut rig: Rig, selection: Selection, name: Option<String>) {
        apply_change::update_followers(&self.rig, &mut rig);
        if self.size_keeps == SizeKeeps::Radiance {
            apply_change::keep_radiance(&self.rig, &mut rig);
        }
        self.replace_or_tell(rig, selection, name);
    }

    /// [`Self::replace_rig`]; the message tells why it is refused.
    fn replace_or_tell(&mut self, rig: Rig, selection: Selection, name: Option<String>) {
        if let Err(reason) = self.replace_rig(rig, selection, name) {
            self.message = reason;
        }
    }

    /// [`Self::commit_as`] with the lights as they are in `rig`.
    fn replace_rig(&mut self, rig: Rig, selection: Selection, name: Option<String>) -> Result<(), String> {
        if rig != self.rig {
            check::check(&self.rig, &rig)?;
            let base = self.base.edited_in_shot(&self.camera.name, [&self.rig, &rig], self.only_here)?;
            self.record(rig, base, selection, name);
        }
        Ok(())
    }

    /// Replaces the lights of all shots.
    fn replace_base(&mut self, base: Rig, selection: Selection, name: Option<String>) {
        if base == self.base {
            return;
        }
        let seen = base.of_shot(&self.camera.name).and_then(|rig| check::check(&self.rig, &rig).map(|()| rig));
        match seen {
            Ok(rig) => self.record(rig, base, selection, name),
            Err(reason) => self.message = reason,
        }
    }

    fn record(&mut self, rig: Rig, base: Rig, selection: Selection, name: Option<String>) {
        self.message = self.history.push([&rig, &base], [&self.selection, &selection], name).to_owned();
        (self.rig, self.base, self.selection) = (rig, base, selection);
        self.version += 1;
    }

    /// Replaces the lights by those of another program, as an edit. Followers of changed lights change with them.
    /// Lights stay selected by their names. An error tells what no rig file could store.
    pub fn take_rig(&mut self, mut rig: Rig) -> Result<(), String> {
        check::check(&self.rig, &rig)?;
        apply_change::update_followers(&self.rig, &mut rig);
        let index = |name: &str| rig.lights.iter().position(|light| light.name == name);
        let same_list = rig.lights.len() == self.rig.lights.len();
        let kept = |light: usize| index(&self.rig.lights[light].name).or(Some(light).filter(|_| same_list));
        let selection = Selection::of(self.selection.iter().filter_map(kept));
        self.message = "no change".into(); // unless there is one
        // The switch is not theirs.
        let only_here = std::mem::replace(&mut self.only_here, false);
        let outcome = self.replace_rig(rig, selection, None);
        self.only_here = only_here;
        outcome
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

    /// Restores the state of a history entry.
    pub fn go_to(&mut self, entry: usize) {
        let selection = self.history.go_to(entry, &mut self.base);
        self.see_base();
        self.selection = selection.within(self.rig.lights.len());
        self.message = self.history.entries()[entry].name.clone();
    }

    /// Whether lights or snapshots differ from what was loaded or last saved.
    pub fn is_unsaved(&self) -> bool {
        self.history.is_unsaved() || self.snapshots.are_unsaved()
    }

    /// Marks the current state as saved.
    pub fn mark_saved(&mut self) {
        self.history.mark_saved();
        self.snapshots.mark_saved();
    }
}

/// Length of a move step in a scene of this radius, metres.
fn step(radius: f64) -> f64 {
    nice(radius / 100.0)
}

/// Distance from a surface at which a light is placed, metres.
fn lift(radius: f64) -> f64 {
    radius / 20.0
}

/// Returns the nearest of 1, 2, 5 and 10 times a power of ten.
fn nice(x: f64) -> f64 {
    let power = 10f64.powf(x.max(1e-30).log10().floor());
    let times =
        [1.0, 2.0, 5.0, 10.0].into_iter().min_by(|a, b| (x / power - a).abs().total_cmp(&(x / power - b).abs()));
    power * times.expect("there are four")
}

#[cfg(test)]
mod tests;
