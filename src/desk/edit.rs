//! Edits of the selected lights by keys: each light changes by the same step.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec3, Vec3};

use super::apply_change::apply_change;
use super::{Desk, SizeKeeps};
use crate::scene::rig::{KELVIN, TINT, kelvin_and_tint_of, kelvin_to_rgb};
use crate::scene::{Light, LightKind};

/// The axes along which a light moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// Right, up, back.
    Camera,
    World,
}

/// An edit of the selected lights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightEdit {
    /// Steps along an axis.
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
    /// Towards blue, in micro reciprocal kelvin: equal steps look equal at any temperature.
    Mired(f64),
    /// Towards green; towards magenta if below zero.
    Tint(f64),
    /// Index of the channel (red, green, blue), and the change.
    Channel(usize, f64),
    /// Outer half-angle of a spot light, or half the spread of a flat light, degrees.
    Outer(f64),
    /// Inner half-angle of a spot light, degrees.
    Inner(f64),
    /// All barn doors, degrees.
    Doors(f64),
    /// Size, in doublings; a punctual light gets one.
    Size(f64),
    /// Switches: all selected lights take the opposite of the primary light's value.
    Toggle,
    Solo,
    Shadows,
}

impl Desk {
    /// Edits the selected lights; lights to which the edit does not apply are unchanged.
    pub fn edit(&mut self, edit: LightEdit) {
        self.edit_each(|desk, light| desk.change(light, edit));
    }

    /// Replaces each selected light by the result of `change`; on an error the light is unchanged.
    pub(super) fn edit_each(&mut self, change: impl Fn(&Self, &Light) -> Result<Light, &'static str>) {
        let mut rig = self.rig.clone();
        let mut refused = None;
        for index in self.selection.iter() {
            match change(self, &self.rig.lights[index]) {
                Ok(light) => rig.lights[index] = light,
                Err(reason) => refused = Some(format!("{}: {reason}", self.rig.lights[index].name)),
            }
        }
        match refused {
            _ if self.selection.is_empty() => self.message = "no light is selected".into(),
            Some(refused) if rig == self.rig => self.message = refused,
            _ => self.commit(rig),
        }
    }

    /// Replaces the primary light by `light`; the other selected lights change in the same way.
    pub fn edit_primary_and_selection(&mut self, light: Light) {
        let Some(primary) = self.selected() else { return };
        let before = &self.rig.lights[primary];
        if *before == light {
            return;
        }
        let mut rig = self.rig.clone();
        for index in self.selection.iter() {
            rig.lights[index] = apply_change(&self.rig.lights[index], before, &light);
        }
        rig.lights[primary] = light;
        self.commit(rig);
    }

    /// Returns the edited light, or the reason why the edit does not apply.
    fn change(&self, light: &Light, edit: LightEdit) -> Result<Light, &'static str> {
        let axes = self.camera.world_from_camera;
        let like = self.selected_light().unwrap_or(light);
        let mut light = light.clone();
        match edit {
            LightEdit::Move { .. } | LightEdit::Turn { .. } if light.kind == LightKind::Emitter => {
                return Err("an emitter is where its material is");
            }
            LightEdit::Move { .. } if !light.kind.has_position() => {
                return Err("a directional light or dome has no position; turn it");
            }
            LightEdit::Move { frame: Frame::Camera, axis } => light.position += axes * (axis * self.step),
            LightEdit::Move { frame: Frame::World, axis } => light.position += axis * self.step,
            LightEdit::Turn { right, .. } if light.kind == LightKind::Dome => light.rotation -= right.to_radians(),
            LightEdit::Turn { .. } if !light.has_direction() => {
                return Err("a point light shines in all directions and cannot turn");
            }
            LightEdit::Turn { right, up } => {
                let sideways = DQuat::from_axis_angle(axes.y_axis, -right.to_radians());
                let upwards = DQuat::from_axis_angle(axes.x_axis, up.to_radians());
                light.direction = (sideways * upwards * light.direction).normalize();
            }
            LightEdit::Stops(by) => light.stops += by,
            LightEdit::Mired(by) => light.color = shifted(light.color, by, 0.0),
            LightEdit::Tint(by) => light.color = shifted(light.color, 0.0, by),
            LightEdit::Channel(channel, by) => light.color[channel] = (light.color[channel] + by as f32).max(0.0),
            LightEdit::Outer(by) if matches!(light.kind, LightKind::Disk | LightKind::Rect) => {
                light.spread = (light.spread + 2.0 * by.to_radians()).clamp(LEAST_SPREAD, PI);
            }
            LightEdit::Outer(_) if light.kind != LightKind::Spot => {
                return Err("only spots have a cone, only disks and rectangles a spread");
            }
            LightEdit::Inner(_) if light.kind != LightKind::Spot => return Err("only a spot light has an inner cone"),
            LightEdit::Outer(by) => {
                light.outer_angle = (light.outer_angle + by.to_radians()).clamp(0.0, FRAC_PI_2);
                light.inner_angle = light.inner_angle.min(light.outer_angle);
            }
            LightEdit::Inner(by) => {
                light.inner_angle = (light.inner_angle + by.to_radians()).clamp(0.0, light.outer_angle);
            }
            LightEdit::Doors(by) => {
                let doors = light.filter.barn_doors.as_mut();
                let doors = doors.ok_or("it has no barn doors; switch them on in the panel")?;
                doors.angles = doors.angles.map(|angle| (angle + by.to_radians()).clamp(-FRAC_PI_2, FRAC_PI_2));
            }
            LightEdit::Size(by) => self.resize(&mut light, by.exp2()),
            LightEdit::Toggle => light.enabled = !like.enabled,
            LightEdit::Solo => light.solo = !like.solo,
            LightEdit::Shadows => light.shadows = !like.shadows,
        }
        Ok(light)
    }
}

impl Desk {
    /// Changes what lights keep when their size changes.
    pub fn toggle_size_keeps(&mut self) {
        (self.size_keeps, self.message) = match self.size_keeps {
            SizeKeeps::Power => (SizeKeeps::Radiance, "a change of size keeps the radiance".into()),
            SizeKeeps::Radiance => (SizeKeeps::Power, "a change of size keeps the power".into()),
        };
    }

    /// Multiplies a light's size. Smaller than a thousandth of a step, or a thousandth of a degree, is no size.
    fn resize(&self, light: &mut Light, factor: f64) {
        let grown = |size: f64, first: f64| match size * factor {
            0.0 if factor > 1.0 => first,
            smaller if smaller < 1e-3 * first => 0.0,
            size => size,
        };
        match light.kind {
            LightKind::Rect => light.size = light.size.map(|side| grown(side, self.step)),
            LightKind::Directional => light.angle = grown(light.angle, SUN).min(PI),
            LightKind::Point | LightKind::Spot | LightKind::Disk => light.radius = grown(light.radius, self.step),
            LightKind::Dome | LightKind::Emitter => {}
        }
    }
}

/// Angle of the sun, radians.
const SUN: f64 = 0.53 * PI / 180.0;

/// Smallest spread of a flat light that a rig file stores, radians.
pub const LEAST_SPREAD: f64 = 0.01 * PI / 180.0;

/// Shifts temperature and tint of `color` at the same luminance.
fn shifted(color: Vec3, mired: f64, by_tint: f64) -> Vec3 {
    let (kelvin, tint) = kelvin_and_tint_of(color);
    let mired = (1e6 / kelvin - mired).clamp(1e6 / KELVIN.end(), 1e6 / KELVIN.start());
    kelvin_to_rgb(1e6 / mired, (tint + by_tint).clamp(*TINT.start(), *TINT.end())) * luminance(color)
}

/// Returns the luminance of linear Rec. 709 RGB.
pub fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126729, 0.7151522, 0.0721750))
}
