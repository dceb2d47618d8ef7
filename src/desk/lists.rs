//! Adding, duplicating and deleting lights.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec3;

use super::Desk;
use super::describe::kind_name;
use super::place::MARGIN;
use super::selection::Selection;
use crate::scene::rig::UniqueNames;
use crate::scene::{Light, LightKind};

impl Desk {
    /// Adds a light above and right of the camera, aimed at `target`, or nearer if less is `free` along
    /// [`Self::offset_of_new`]. A white surface at the target gets a radiance of 0.5 after `exposure` (stops).
    pub fn add(&mut self, kind: LightKind, target: DVec3, exposure: f32, free: f64) {
        let distance = self.distance_to(target);
        let offset = self.offset_of_new(target);
        let position = target + offset.clamp_length_max((1.0 - MARGIN) * free);
        let mut light = Light::point(&self.light_names().claim(kind_name(kind)), position);
        light.kind = kind;
        light.direction = (target - position).normalize();
        // White diffuse radiance 0.5: E = pi/2 lux at the target.
        let lux = FRAC_PI_2 * f64::from(-exposure).exp2();
        let at_target = if !kind.has_position() { 1.0 } else { (target - position).length_squared() };
        light.intensity = two_digits(if kind == LightKind::Dome { lux / PI } else { lux * at_target });
        (light.inner_angle, light.outer_angle) = match kind {
            LightKind::Spot => (15f64.to_radians(), 20f64.to_radians()),
            _ => (light.inner_angle, light.outer_angle),
        };
        match kind {
            LightKind::Disk => light.radius = two_digits(0.1 * distance),
            LightKind::Rect => light.size = [0.25 * distance, 0.125 * distance].map(two_digits),
            LightKind::Dome => light.visible = true,
            LightKind::Point | LightKind::Spot | LightKind::Directional | LightKind::Emitter => {}
        }
        if !kind.has_position() {
            light.position = DVec3::ZERO;
        }
        self.insert(vec![light]);
    }

    /// Returns where a new light stands, as seen from its target, if nothing is in the way.
    pub fn offset_of_new(&self, target: DVec3) -> DVec3 {
        let axes = self.camera.world_from_camera;
        self.camera.position - target + (axes.x_axis + axes.y_axis) * 0.3 * self.distance_to(target)
    }

    fn distance_to(&self, target: DVec3) -> f64 {
        (target - self.camera.position).length().max(self.step)
    }

    /// Duplicates the selected lights, but no emitters, and selects the copies.
    pub fn duplicate(&mut self) {
        let mut names = self.light_names();
        let mut copy = |index: usize| {
            let light = &self.rig.lights[index];
            let stem = light.name.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('_');
            let name = names.claim(if stem.is_empty() { &light.name } else { stem });
            // A copy belongs to no node of the scene.
            Light { name, node: None, ..light.clone() }
        };
        let is_emitter = |light: &usize| self.rig.lights[*light].kind == LightKind::Emitter;
        let lights: Vec<Light> = self.selection.iter().filter(|light| !is_emitter(light)).map(&mut copy).collect();
        if lights.is_empty() && !self.selection.is_empty() {
            self.message = "emitters cannot be duplicated".into();
            return;
        }
        self.insert(lights);
    }

    pub(super) fn insert(&mut self, lights: Vec<Light>) {
        if lights.is_empty() {
            self.message = "no light is selected".into();
            return;
        }
        self.history.end_gesture();
        let mut rig = self.rig.clone();
        let first = rig.lights.len();
        rig.lights.extend(lights);
        let new = Selection::of(first..rig.lights.len());
        self.commit_as(rig, new, None);
        self.history.end_gesture();
    }

    /// Deletes the selected lights, but no emitters; their followers follow no light any more.
    pub fn delete(&mut self) {
        let Some(first) = self.selection.iter().min() else {
            self.message = "no light is selected".into();
            return;
        };
        let is_emitter = |light: usize| self.rig.lights[light].kind == LightKind::Emitter;
        if self.selection.iter().all(is_emitter) {
            self.message = "materials emit light; switch it off instead".into();
            return;
        }
        self.history.end_gesture();
        let mut rig = self.rig.clone();
        rig.retain_lights(|light, _| !self.selection.contains(light) || is_emitter(light));
        let left = rig.lights.len();
        let selection = match left {
            0 => Selection::default(),
            _ => Selection::only(first.min(left - 1)),
        };
        self.commit_as(rig, selection, None);
    }

    /// Returns the names of all lights.
    pub(super) fn light_names(&self) -> UniqueNames {
        let mut names = UniqueNames::default();
        for light in &self.rig.lights {
            names.claim(&light.name);
        }
        names
    }
}

fn two_digits(x: f64) -> f64 {
    format!("{x:.1e}").parse().unwrap_or(x)
}
