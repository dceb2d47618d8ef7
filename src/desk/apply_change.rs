//! Application of a light's edit to other lights: those selected with it, and its followers.

use glam::{DQuat, Vec3};

use super::LEAST_SPREAD;
use crate::scene::light_filter::Gobo;
use crate::scene::{Light, LightKind, Rig};

/// Applies to `light` the change of another light from `before` to `after`: position, stops and angles by the same
/// offset, direction by the same rotation, colour, intensity, sizes and range by the same ratio. Changed switches,
/// filters and links are the other light's. Name, kind, group and leader do not change.
pub fn apply_change(light: &Light, before: &Light, after: &Light) -> Light {
    let mut light = light.clone();
    if light.kind.has_position() {
        light.position += after.position - before.position;
    }
    if light.has_direction() && before.direction != after.direction {
        let turn = DQuat::from_rotation_arc(before.direction, after.direction);
        light.direction = (turn * light.direction).normalize();
    }
    if before.color != after.color {
        let channel = |c: usize| scaled(light.color[c].into(), before.color[c].into(), after.color[c].into()) as f32;
        light.color = Vec3::new(channel(0), channel(1), channel(2)).max(Vec3::ZERO);
    }
    light.intensity = scaled(light.intensity, before.intensity, after.intensity).max(0.0);
    light.stops += after.stops - before.stops;
    if light.kind == LightKind::Spot {
        let outer = light.outer_angle + (after.outer_angle - before.outer_angle);
        light.outer_angle = outer.clamp(0.0, std::f64::consts::FRAC_PI_2);
        let inner = light.inner_angle + (after.inner_angle - before.inner_angle);
        light.inner_angle = inner.clamp(0.0, light.outer_angle);
    }
    light.radius = scaled(light.radius, before.radius, after.radius).max(0.0);
    if light.kind == LightKind::Dome {
        light.rotation += after.rotation - before.rotation;
        take(&mut light.map, &before.map, &after.map);
    }
    light.angle = scaled(light.angle, before.angle, after.angle).clamp(0.0, std::f64::consts::PI);
    light.spread = scaled(light.spread, before.spread, after.spread).clamp(LEAST_SPREAD, std::f64::consts::PI);
    for side in 0..2 {
        light.size[side] = scaled(light.size[side], before.size[side], after.size[side]).max(0.0);
    }
    if before.range != after.range {
        light.range = match (light.range, before.range, after.range) {
            (Some(own), Some(before), Some(after)) => Some(scaled(own, before, after)),
            (_, _, after) => after,
        };
    }
    light.decay_start = scaled(light.decay_start, before.decay_start, after.decay_start).max(0.0);
    if light.kind.has_position() {
        take(&mut light.filter.ies, &before.filter.ies, &after.filter.ies);
    }
    if light.kind.is_aimed() {
        take_gobo(&mut light.filter.gobo, &before.filter.gobo, &after.filter.gobo);
        take(&mut light.filter.barn_doors, &before.filter.barn_doors, &after.filter.barn_doors);
    }
    take(&mut light.links.only, &before.links.only, &after.links.only);
    take(&mut light.links.except, &before.links.except, &after.links.except);
    take(&mut light.links.factor, &before.links.factor, &after.links.factor);
    take(&mut light.links.no_shadow_from, &before.links.no_shadow_from, &after.links.no_shadow_from);
    for (own, before, after) in [
        (&mut light.enabled, before.enabled, after.enabled),
        (&mut light.shadows, before.shadows, after.shadows),
        (&mut light.solo, before.solo, after.solo),
        (&mut light.two_sided, before.two_sided, after.two_sided),
        (&mut light.visible, before.visible, after.visible),
    ] {
        take(own, &before, &after);
    }
    light
}

/// Sets a value to `after` if that differs from `before`.
fn take<T: Clone + PartialEq>(own: &mut T, before: &T, after: &T) {
    if before != after {
        own.clone_from(after);
    }
}

/// As [`take`], for each value of a gobo by itself.
fn take_gobo(own: &mut Option<Gobo>, before: &Option<Gobo>, after: &Option<Gobo>) {
    match (own, before, after) {
        (Some(own), Some(before), Some(after)) => {
            take(&mut own.image, &before.image, &after.image);
            take(&mut own.rotation, &before.rotation, &after.rotation);
            take(&mut own.scale, &before.scale, &after.scale);
            take(&mut own.tint, &before.tint, &after.tint);
        }
        (own, before, after) => take(own, before, after),
    }
}

/// Returns `x * after / before`, or `x + after` if `before` is zero.
fn scaled(x: f64, before: f64, after: f64) -> f64 {
    match before {
        _ if before == after => x,
        0.0 => x + after,
        _ => x * (after / before),
    }
}

/// Applies the edits in `rig` since `before` to the followers of edited lights, unless they were edited themselves.
pub fn update_followers(before: &Rig, rig: &mut Rig) {
    if before.lights.len() != rig.lights.len() || rig.lights.iter().all(|light| light.follows.is_none()) {
        return;
    }
    let order = rig.leaders_first().expect("cycles are refused when a light begins to follow");
    for follower in order {
        let Some(leader) = rig.lights[follower].follows else { continue };
        let was = &before.lights[follower];
        if rig.lights[follower] == *was && rig.lights[leader] != before.lights[leader] {
            rig.lights[follower] = apply_change(was, &before.lights[leader], &rig.lights[leader]);
        }
    }
}

/// Multiplies the intensity of lights whose size changed since `before`, so that their radiance is the same.
pub fn keep_radiance(before: &Rig, rig: &mut Rig) {
    if before.lights.len() != rig.lights.len() {
        return;
    }
    for (light, before) in rig.lights.iter_mut().zip(&before.lights) {
        if let (Some(was), Some(is)) = (before.projected_area(), light.projected_area())
            && was != is
        {
            light.intensity *= is / was;
        }
    }
}
