//! Edits carried over from one light to others: to those selected with it, and to those that follow it.

use glam::{DQuat, Vec3};

use crate::scene::{Light, LightKind, Rig};

/// What becomes of `light` when another one goes from `before` to `after`: offsets, ratios and turns stay as they were,
/// switches become the other's. Name, kind, group and links are a light's own.
pub fn alike(light: &Light, before: &Light, after: &Light) -> Light {
    let mut light = light.clone();
    if light.kind != LightKind::Directional {
        light.position += after.position - before.position;
    }
    if light.kind != LightKind::Point && before.direction != after.direction {
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
    if before.range != after.range {
        light.range = match (light.range, before.range, after.range) {
            (Some(own), Some(before), Some(after)) => Some(scaled(own, before, after)),
            (_, _, after) => after,
        };
    }
    for (own, before, after) in [
        (&mut light.enabled, before.enabled, after.enabled),
        (&mut light.shadows, before.shadows, after.shadows),
        (&mut light.solo, before.solo, after.solo),
    ] {
        if before != after {
            *own = after;
        }
    }
    light
}

/// `x` in the ratio of `after` to `before`; from nothing on, as much more.
fn scaled(x: f64, before: f64, after: f64) -> f64 {
    match before {
        _ if before == after => x,
        0.0 => x + after,
        _ => x * (after / before),
    }
}

/// Carries what was edited in `rig` since `before` over to lights that follow, and were not edited themselves.
pub fn carry_to_followers(before: &Rig, rig: &mut Rig) {
    if before.lights.len() != rig.lights.len() || rig.lights.iter().all(|light| light.follows.is_none()) {
        return;
    }
    let order = rig.leaders_first().expect("links are checked before they are made");
    for follower in order {
        let Some(leader) = rig.lights[follower].follows else { continue };
        let was = &before.lights[follower];
        if rig.lights[follower] == *was && rig.lights[leader] != before.lights[leader] {
            rig.lights[follower] = alike(was, &before.lights[leader], &rig.lights[leader]);
        }
    }
}
