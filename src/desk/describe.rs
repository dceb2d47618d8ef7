//! Short descriptions of changes to lights, for the history and messages.

use std::sync::Arc;

use super::rig_state::RigState;
use crate::scene::{DomeMap, Light, LightGroup, LightKind, LightUnit, Links};

/// Describes a change: "key: +0.5 stop", "key and 2 more: moved 0.1 m", "group rim: off".
pub fn change(before: &RigState, after: &RigState) -> String {
    let listed = |was: usize, is: usize| was.abs_diff(is);
    match listed(before.lights.len(), after.lights.len()) {
        0 => {}
        count => {
            let (more, fewer, what) = match after.lights.len() > before.lights.len() {
                true => (&after.lights, &before.lights, "new"),
                false => (&before.lights, &after.lights, "deleted"),
            };
            let first = more.iter().find(|light| fewer.iter().all(|other| other.name != light.name));
            return format!("{}: {what}", and_more(first.map_or("lights", |light| &light.name), count));
        }
    }
    if let (false, Some(group)) = (before.groups.len() > after.groups.len(), after.groups.get(before.groups.len())) {
        return format!("group {}: new", group.name);
    }
    let groups = before.groups.iter().zip(&after.groups).find(|(before, after)| before != after);
    if let (true, Some((before, after))) = (listed(before.groups.len(), after.groups.len()) == 0, groups) {
        return format!("group {}: {}", before.name, group_difference(before, after));
    }
    let lights = || before.lights.iter().zip(&after.lights).filter(|(before, after)| before != after);
    match lights().next() {
        Some((before, after)) => {
            format!("{}: {}", and_more(&before.name, lights().count()), light_difference(before, after))
        }
        None => "groups or sets".into(),
    }
}

fn and_more(first: &str, count: usize) -> String {
    if count == 1 { first.to_owned() } else { format!("{first} and {} more", count - 1) }
}

fn group_difference(before: &LightGroup, after: &LightGroup) -> String {
    let mut parts = Vec::new();
    if before.name != after.name {
        parts.push(format!("renamed to {}", after.name));
    }
    switches(&mut parts, [before.enabled, after.enabled], [before.solo, after.solo]);
    stops(&mut parts, before.stops, after.stops);
    if before.color != after.color {
        parts.push("tint".into());
    }
    parts.join(", ")
}

fn light_difference(before: &Arc<Light>, after: &Arc<Light>) -> String {
    let mut parts = Vec::new();
    if before.name != after.name {
        parts.push(format!("renamed to {}", after.name));
    }
    if before.kind != after.kind {
        parts.push(format!("changed to a {} light", kind_name(after.kind)));
    }
    switches(&mut parts, [before.enabled, after.enabled], [before.solo, after.solo]);
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
    if before.rotation != after.rotation {
        parts.push(format!("turned {}°", rounded((after.rotation - before.rotation).to_degrees())));
    }
    if before.map != after.map {
        parts.push(match &after.map {
            None => "no map".into(),
            Some(DomeMap::File(map)) => format!("map {}", map.path().file_name().unwrap_or_default().display()),
            Some(DomeMap::Physical(_)) => "physical sky".into(),
        });
    }
    stops(&mut parts, before.stops, after.stops);
    if before.intensity != after.intensity {
        parts.push(format!("{} {}", rounded(after.intensity), LightUnit::of_intensity(after.kind).symbol(after.kind)));
    }
    if before.color != after.color {
        parts.push("colour".into());
    }
    if before.outer_angle != after.outer_angle {
        parts.push(format!("cone {}°", rounded(after.outer_angle.to_degrees())));
    } else if before.inner_angle != after.inner_angle {
        parts.push(format!("inner cone {}°", rounded(after.inner_angle.to_degrees())));
    }
    if (before.radius, before.angle, before.size) != (after.radius, after.angle, after.size) {
        parts.push(size(after));
    }
    if before.spread != after.spread {
        parts.push(format!("spread {}°", rounded(after.spread.to_degrees())));
    }
    if before.visible != after.visible {
        parts.push(if after.visible { "visible" } else { "not visible" }.into());
    }
    if before.two_sided != after.two_sided {
        parts.push(if after.two_sided { "two sides" } else { "one side" }.into());
    }
    if before.range != after.range {
        parts.push(after.range.map_or("no range".into(), |range| format!("range {} m", rounded(range))));
    }
    if before.decay_start != after.decay_start {
        parts.push(format!("decay from {} m", rounded(after.decay_start)));
    }
    let others = [
        ("IES", before.filter.ies != after.filter.ies),
        ("gobo", before.filter.gobo != after.filter.gobo),
        ("barn doors", before.filter.barn_doors != after.filter.barn_doors),
    ];
    parts.extend(others.iter().filter(|(_, differs)| *differs).map(|(name, _)| (*name).to_owned()));
    parts.extend(linking(&before.links, &after.links));
    if before.group != after.group {
        parts.push("group".into());
    }
    if before.follows != after.follows {
        parts.push(if after.follows.is_some() { "follows another light" } else { "follows no light" }.into());
    }
    parts.join(", ")
}

/// What is lit or casts a shadow from now on, or no longer.
fn linking(before: &Links, after: &Links) -> Vec<String> {
    let mut parts = Vec::new();
    let mut compare = |before: &[String], after: &[String], added: &str, removed: &str| {
        let new = |from: &[String], to: &[String]| to.iter().find(|name| !from.contains(name)).cloned();
        parts.extend(new(before, after).map(|name| format!("{added} {name}")));
        parts.extend(new(after, before).map(|name| format!("{removed} {name}")));
    };
    compare(&before.only, &after.only, "lights", "does not light");
    compare(&before.except, &after.except, "does not light", "lights");
    compare(&before.no_shadow_from, &after.no_shadow_from, "no shadow from", "shadow from");
    if before.factor != after.factor {
        parts.push("light on objects".into());
    }
    parts
}

fn switches(parts: &mut Vec<String>, enabled: [bool; 2], solo: [bool; 2]) {
    if enabled[0] != enabled[1] {
        parts.push(if enabled[1] { "on" } else { "off" }.into());
    }
    if solo[0] != solo[1] {
        parts.push(if solo[1] { "solo" } else { "solo off" }.into());
    }
}

fn stops(parts: &mut Vec<String>, before: f64, after: f64) {
    let by = after - before;
    if by != 0.0 {
        let unit = if by.abs() > 1.0 { "stops" } else { "stop" };
        parts.push(format!("{}{} {unit}", if by > 0.0 { "+" } else { "" }, rounded(by)));
    }
}

fn size(light: &Light) -> String {
    let [width, height] = light.size.map(rounded);
    match light.kind {
        LightKind::Rect => format!("{width} x {height} m"),
        LightKind::Directional => format!("{}° wide", rounded(light.angle.to_degrees())),
        _ => format!("radius {} m", rounded(light.radius)),
    }
}

pub fn kind_name(kind: LightKind) -> &'static str {
    match kind {
        LightKind::Point => "point",
        LightKind::Spot => "spot",
        LightKind::Directional => "directional",
        LightKind::Disk => "disk",
        LightKind::Rect => "rectangle",
        LightKind::Dome => "dome",
        LightKind::Emitter => "emitter",
    }
}

/// Formats a number with three significant digits, without trailing zeros.
pub fn rounded(x: f64) -> String {
    let digits = (2 - x.abs().max(1e-9).log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{x:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}
