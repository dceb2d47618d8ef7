//! The lighting desk without its window: lights, which of them is selected, and every edit that a hand can make.

use glam::{DQuat, DVec3, Vec3};

use super::history::{Change, History, kind_name, rounded};
use crate::scene::rig::{KELVIN, UniqueNames, kelvin_of, kelvin_to_rgb};
use crate::scene::{Camera, Light, LightKind, Rig};

/// Whose axes a light moves along.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// Right, up, back.
    Camera,
    World,
}

/// A surface point that somebody points at, world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    pub position: DVec3,
    /// Unit; towards the eye.
    pub normal: DVec3,
}

/// An edit of the selected light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightEdit {
    /// In steps along an axis.
    Move {
        frame: Frame,
        axis: DVec3,
    },
    /// Degrees to the camera's right, and up.
    Turn {
        right: f64,
        up: f64,
    },
    Stops(f64),
    /// Towards blue, in micro reciprocal kelvin: equal steps look alike at any temperature.
    Mired(f64),
    /// Of red, green and blue.
    Channel(usize, f64),
    /// Degrees of the spot's half-angles.
    Outer(f64),
    Inner(f64),
    Toggle,
    Shadows,
}

pub struct Desk {
    rig: Rig,
    selected: Option<usize>,
    history: History,
    /// Only the selected light shines.
    solo: bool,
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
        let selected = (!rig.lights.is_empty()).then_some(0);
        Self {
            rig,
            selected,
            history: History::default(),
            solo: false,
            camera,
            step: nice(radius / 100.0),
            lift: radius / 20.0,
            message: String::new(),
        }
    }

    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    pub fn history(&self) -> &History {
        &self.history
    }

    pub fn selected(&self) -> Option<usize> {
        self.selected
    }

    pub fn selected_light(&self) -> Option<&Light> {
        self.selected.map(|index| &self.rig.lights[index])
    }

    pub fn is_solo(&self) -> bool {
        self.solo
    }

    pub fn step(&self) -> f64 {
        self.step
    }

    /// The lights as the picture shows them.
    pub fn shown_rig(&self) -> Rig {
        let mut rig = self.rig.clone();
        if let (true, Some(selected)) = (self.solo, self.selected) {
            for (i, light) in rig.lights.iter_mut().enumerate() {
                light.enabled &= i == selected;
            }
        }
        rig
    }

    pub fn select(&mut self, index: usize) {
        self.history.end_gesture();
        self.selected = Some(index);
        self.message = self.describe(index);
    }

    /// Selects the next light, or the one before: `by` is 1 or -1.
    pub fn select_next(&mut self, by: isize) {
        let count = self.rig.lights.len();
        if count == 0 {
            self.message = "there are no lights".into();
            return;
        }
        let index = self.selected.map_or(0, |i| (i as isize + by).rem_euclid(count as isize) as usize);
        self.select(index);
    }

    /// One line on the selected light.
    pub fn summary(&self) -> String {
        match self.selected {
            None => "no light".into(),
            Some(index) => {
                let light = &self.rig.lights[index];
                format!("{}, {} stops", self.describe(index), rounded(light.stops))
            }
        }
    }

    fn describe(&self, index: usize) -> String {
        let light = &self.rig.lights[index];
        let off = if light.enabled { "" } else { ", off" };
        format!("{} ({}{off}), {} of {}", light.name, kind_name(light.kind), index + 1, self.rig.lights.len())
    }

    pub fn toggle_solo(&mut self) {
        self.solo = !self.solo;
        self.message = if self.solo { "solo: only the selected light shines" } else { "solo off" }.into();
    }

    /// What comes next can be undone apart from what was.
    pub fn end_gesture(&mut self) {
        self.history.end_gesture();
    }

    /// Puts `light` in the place of light `index`; refused if it is no light.
    pub fn replace(&mut self, index: usize, light: Light) {
        let before = &self.rig.lights[index];
        if *before == light {
            return;
        }
        if let Err(reason) = self.check(index, &light) {
            self.message = format!("{}: {reason}", light.name);
            return;
        }
        let change = Change::Replace { index, before: Box::new(before.clone()), after: Box::new(light) };
        self.make(change, self.selected);
    }

    /// Whether the rig could hold `light` at `index`, by the rules of rig files.
    fn check(&self, index: usize, light: &Light) -> Result<(), &'static str> {
        if light.name.is_empty() || light.name.contains('.') {
            return Err("a name is not empty and has no dots");
        }
        let others = self.rig.lights.iter().enumerate().filter(|&(i, _)| i != index);
        if self.rig.lights[index].name != light.name && others.into_iter().any(|(_, other)| other.name == light.name) {
            return Err("another light is called that");
        }
        if !light.position.is_finite() || !light.direction.is_normalized() {
            return Err("it would be nowhere");
        }
        let group = light.group.map_or(Vec3::ONE, |group| self.rig.groups[group].scale());
        let on = Light { enabled: true, ..light.clone() };
        if !(on.scale() * group).is_finite() || !light.stops.is_finite() {
            return Err("it would be brighter than numbers go");
        }
        Ok(())
    }

    fn make(&mut self, change: Change, selected: Option<usize>) {
        self.message = change.name();
        change.apply(&mut self.rig);
        self.history.push(change, self.selected);
        self.selected = selected;
    }

    /// Edits the selected light.
    pub fn edit(&mut self, edit: LightEdit) {
        let Some(index) = self.selected else {
            self.message = "no light is selected".into();
            return;
        };
        let mut light = self.rig.lights[index].clone();
        let refused = self.change(&mut light, edit);
        match refused {
            Some(reason) => self.message = format!("{}: {reason}", light.name),
            None => self.replace(index, light),
        }
    }

    /// Changes `light`, or tells why not.
    fn change(&self, light: &mut Light, edit: LightEdit) -> Option<&'static str> {
        let axes = self.camera.world_from_camera;
        match edit {
            LightEdit::Move { .. } if light.kind == LightKind::Directional => {
                return Some("a directional light has no place; turn it");
            }
            LightEdit::Move { frame: Frame::Camera, axis } => light.position += axes * (axis * self.step),
            LightEdit::Move { frame: Frame::World, axis } => light.position += axis * self.step,
            LightEdit::Turn { .. } if light.kind == LightKind::Point => {
                return Some("a point light shines everywhere; nothing to turn");
            }
            LightEdit::Turn { right, up } => {
                let sideways = DQuat::from_axis_angle(axes.y_axis, -right.to_radians());
                let upwards = DQuat::from_axis_angle(axes.x_axis, up.to_radians());
                light.direction = (sideways * upwards * light.direction).normalize();
            }
            LightEdit::Stops(by) => light.stops += by,
            LightEdit::Mired(by) => light.color = shifted(light.color, by),
            LightEdit::Channel(channel, by) => light.color[channel] = (light.color[channel] + by as f32).max(0.0),
            LightEdit::Outer(_) | LightEdit::Inner(_) if light.kind != LightKind::Spot => {
                return Some("only a spot has a cone");
            }
            LightEdit::Outer(by) => {
                light.outer_angle = (light.outer_angle + by.to_radians()).clamp(0.0, std::f64::consts::FRAC_PI_2);
                light.inner_angle = light.inner_angle.min(light.outer_angle);
            }
            LightEdit::Inner(by) => {
                light.inner_angle = (light.inner_angle + by.to_radians()).clamp(0.0, light.outer_angle);
            }
            LightEdit::Toggle => light.enabled = !light.enabled,
            LightEdit::Shadows => light.shadows = !light.shadows,
        }
        None
    }

    /// Puts the selected light at a surface point, a little off it.
    pub fn place(&mut self, at: Pick) {
        self.edit_at(|desk, light| match light.kind {
            LightKind::Directional => Err("a directional light has no place; aim it"),
            _ => {
                light.position = at.position + at.normal * desk.lift;
                Ok(())
            }
        });
    }

    /// Aims the selected light at a surface point; a directional light then meets it head-on.
    pub fn aim(&mut self, at: Pick) {
        self.edit_at(|_, light| {
            light.direction = match light.kind {
                LightKind::Point => return Err("a point light shines everywhere; nothing to aim"),
                LightKind::Directional => -at.normal,
                LightKind::Spot => (at.position - light.position).try_normalize().ok_or("it is there already")?,
            };
            Ok(())
        });
    }

    fn edit_at(&mut self, edit: impl FnOnce(&Self, &mut Light) -> Result<(), &'static str>) {
        let Some(index) = self.selected else {
            self.message = "no light is selected".into();
            return;
        };
        let mut light = self.rig.lights[index].clone();
        match edit(self, &mut light) {
            Err(reason) => self.message = format!("{}: {reason}", light.name),
            Ok(()) => self.replace(index, light),
        }
    }

    /// A new light that shines over the viewer's shoulder at `target`, as bright there as middle grey at `exposure`.
    pub fn add(&mut self, kind: LightKind, target: DVec3, exposure: f32) {
        self.history.end_gesture();
        let axes = self.camera.world_from_camera;
        let distance = (target - self.camera.position).length().max(self.step);
        let position = self.camera.position + (axes.x_axis + axes.y_axis) * 0.3 * distance;
        let mut light = Light::point(&self.unused_name(kind_name(kind)), position);
        light.kind = kind;
        light.direction = (target - position).normalize();
        // White of radiance 0.5: E = pi/2 lux at the target.
        let lux = std::f64::consts::FRAC_PI_2 * f64::from(-exposure).exp2();
        let at_target = if kind == LightKind::Directional { 1.0 } else { (target - position).length_squared() };
        light.intensity = two_digits(lux * at_target);
        (light.inner_angle, light.outer_angle) = match kind {
            LightKind::Spot => (15f64.to_radians(), 20f64.to_radians()),
            _ => (light.inner_angle, light.outer_angle),
        };
        if kind == LightKind::Directional {
            light.position = DVec3::ZERO;
        }
        self.insert(light);
    }

    pub fn duplicate(&mut self) {
        self.history.end_gesture();
        let Some(light) = self.selected_light() else {
            self.message = "no light is selected".into();
            return;
        };
        let stem = light.name.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('_');
        let name = self.unused_name(if stem.is_empty() { &light.name } else { stem });
        // It came from no node of the scene.
        self.insert(Light { name, node: None, ..light.clone() });
    }

    fn insert(&mut self, light: Light) {
        let index = self.rig.lights.len();
        self.make(Change::Insert { index, light: Box::new(light) }, Some(index));
    }

    pub fn delete(&mut self) {
        self.history.end_gesture();
        let Some(index) = self.selected else {
            self.message = "no light is selected".into();
            return;
        };
        let left = self.rig.lights.len() - 1;
        let selected = (left > 0).then(|| index.min(left.saturating_sub(1)));
        self.make(Change::Remove { index, light: Box::new(self.rig.lights[index].clone()) }, selected);
    }

    fn unused_name(&self, name: &str) -> String {
        let mut names = UniqueNames::default();
        for light in &self.rig.lights {
            names.claim(&light.name);
        }
        names.claim(name)
    }

    pub fn undo(&mut self) {
        match self.history.undo(&mut self.rig) {
            None => self.message = "nothing to undo".into(),
            Some(edit) => {
                self.message = format!("undone: {}", edit.change.name());
                self.selected = edit.selected_before;
            }
        }
    }

    pub fn redo(&mut self) {
        match self.history.redo(&mut self.rig) {
            None => self.message = "nothing to redo".into(),
            Some(edit) => {
                self.message = edit.change.name();
                let last = self.rig.lights.len().checked_sub(1);
                self.selected = match &edit.change {
                    Change::Replace { index, .. } | Change::Insert { index, .. } => Some(*index),
                    Change::Remove { index, .. } => last.map(|last| last.min(*index)),
                };
            }
        }
    }

    /// The rig is in a file as it is now.
    pub fn mark_saved(&mut self) {
        self.history.mark_saved();
    }
}

/// `color` with its temperature shifted, at the same luminance; an off-white tint goes.
fn shifted(color: Vec3, mired: f64) -> Vec3 {
    let mired = (1e6 / kelvin_of(color) - mired).clamp(1e6 / KELVIN.end(), 1e6 / KELVIN.start());
    kelvin_to_rgb(1e6 / mired, 0.0) * luminance(color)
}

pub fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126729, 0.7151522, 0.0721750))
}

/// The nearest of 1, 2, 5, 10, ... times a power of ten.
fn nice(x: f64) -> f64 {
    let power = 10f64.powf(x.max(1e-30).log10().floor());
    let times =
        [1.0, 2.0, 5.0, 10.0].into_iter().min_by(|a, b| (x / power - a).abs().total_cmp(&(x / power - b).abs()));
    power * times.expect("there are four")
}

fn two_digits(x: f64) -> f64 {
    format!("{x:.1e}").parse().unwrap_or(x)
}

#[cfg(test)]
mod tests;
