//! Checks whether a rig file can store the result of an edit.

use std::collections::HashSet;

use glam::Vec3;

use crate::scene::{Light, LightGroup, Rig};

/// Checks what differs from `before`; an error names the light or group.
pub fn check(before: &Rig, rig: &Rig) -> Result<(), String> {
    for (i, group) in rig.groups.iter().enumerate() {
        if before.groups.get(i) != Some(group) {
            check_group(group).map_err(|reason| format!("group {}: {reason}", group.name))?;
        }
    }
    for (i, light) in rig.lights.iter().enumerate() {
        let group = |rig: &Rig, light: &Light| light.group.and_then(|group| rig.groups.get(group).cloned());
        let is_same = before.lights.get(i).is_some_and(|b| b == light && group(before, b) == group(rig, light));
        if !is_same {
            let group = light.group.map(|group| &rig.groups[group]);
            check_light(light, group).map_err(|reason| format!("{}: {reason}", light.name))?;
        }
    }
    let mut names = HashSet::new();
    let twice = rig.lights.iter().find(|light| !names.insert(&light.name));
    if let Some(light) = twice {
        return Err(format!("{}: another light has this name", light.name));
    }
    let mut names = HashSet::new();
    match rig.groups.iter().find(|group| !names.insert(&group.name)) {
        Some(group) => Err(format!("group {}: another group has this name", group.name)),
        None => Ok(()),
    }
}

fn check_light(light: &Light, group: Option<&LightGroup>) -> Result<(), &'static str> {
    check_name(&light.name)?;
    if !light.position.is_finite() || !light.direction.is_normalized() {
        return Err("its position or direction would not be valid");
    }
    let group = group.map_or(Vec3::ONE, |group| LightGroup { enabled: true, ..group.clone() }.scale());
    let on = Light { enabled: true, ..light.clone() };
    if !(on.scale() * group).is_finite() || !light.stops.is_finite() || !light.intensity.is_finite() {
        return Err("its brightness would be out of range");
    }
    if light.range.is_some_and(|range| !range.is_finite() || range <= 0.0) {
        return Err("its range must be greater than zero");
    }
    if !light.decay_start.is_finite() {
        return Err("its decay start would be out of range");
    }
    Ok(())
}

fn check_group(group: &LightGroup) -> Result<(), &'static str> {
    check_name(&group.name)?;
    let on = LightGroup { enabled: true, ..group.clone() };
    if !group.stops.is_finite() || !on.scale().is_finite() || group.color.min_element() < 0.0 {
        return Err("its brightness would be out of range");
    }
    Ok(())
}

fn check_name(name: &str) -> Result<(), &'static str> {
    match name.is_empty() || name.contains('.') {
        true => Err("a name must not be empty or contain dots"),
        false => Ok(()),
    }
}
