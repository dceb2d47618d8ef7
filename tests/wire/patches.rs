//! A patch that one side makes is what the other side applies.

use std::path::Path;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use relume::scene::light_filter::BarnDoors;
use relume::scene::rig::diff::{diff, whole};
use relume::scene::rig::merge_patch::{Object, merge};
use relume::scene::rig::patch::apply;
use relume::scene::{DomeMap, Light, LightGroup, LightKind, ObjectSet, PhysicalSky, Rig, RigFiles};

fn light(name: String) -> impl Strategy<Value = Light> {
    let kind = prop_oneof![Just(LightKind::Point), Just(LightKind::Spot), Just(LightKind::Rect), Just(LightKind::Disk)];
    let switches = (any::<bool>(), any::<bool>(), any::<bool>());
    let numbers = (-1e6..1e6f64, 0.0..1e9f64, -20.0..20.0f64, 0.0..3.0f32, 0.01..1.5f64);
    let group = proptest::option::of(0..2usize);
    (kind, switches, numbers, group, any::<u8>()).prop_map(move |(kind, switches, numbers, group, more)| {
        let mut light = Light::point(&name, DVec3::new(numbers.0, numbers.4, -numbers.0));
        (light.kind, light.group) = (kind, group);
        (light.enabled, light.two_sided, light.visible) = switches;
        (light.intensity, light.stops, light.color) = (numbers.1, numbers.2, Vec3::new(1.0, numbers.3, 0.1));
        (light.outer_angle, light.inner_angle) = (numbers.4, 0.5 * numbers.4);
        if more & 1 == 1 {
            light.range = Some(numbers.4);
            light.filter.barn_doors = Some(BarnDoors { angles: [numbers.4; 4], softness: 0.1 });
        }
        if more & 2 == 2 {
            light.links.only = vec!["Ball".into(), "Floor".into()];
            light.links.factor.insert("Wall".into(), 0.5);
        }
        light
    })
}

fn rig() -> impl Strategy<Value = Rig> {
    let groups = (0.0..2.0f64, any::<bool>(), prop_oneof![Just("one"), Just("two")]);
    let names = proptest::sample::subsequence(vec!["a", "b", "c", "d", "e"], 0..=5);
    let lights = names.prop_flat_map(|names| names.into_iter().map(|name| light(name.into())).collect::<Vec<_>>());
    (groups, lights, any::<bool>(), any::<bool>()).prop_map(|((stops, enabled, name), mut lights, set, follows)| {
        let group = LightGroup { stops, enabled, ..LightGroup::new(name) };
        if let (true, [first, .., last]) = (follows, &mut lights[..]) {
            last.follows = Some(0);
            first.follows = None;
        }
        let sets = ObjectSet { name: "set".into(), items: vec!["Ball".into()] };
        Rig {
            groups: vec![group, LightGroup::new("always")],
            sets: if set { vec![sets] } else { Vec::new() },
            lights,
            ..Rig::default()
        }
    })
}

fn by_name(rig: &Rig) -> Object {
    let mut lights = whole(rig);
    lights.values_mut().for_each(|list| list.as_object_mut().unwrap().sort_keys());
    lights
}

proptest! {
    #[test]
    fn a_difference_applied_gives_the_other_rig(before in rig(), after in rig()) {
        let patch = diff(&before, &after);
        let applied = apply(&before, patch.clone(), Path::new("")).unwrap();
        prop_assert_eq!(by_name(&applied), by_name(&after), "{:?}", patch);
        prop_assert!(diff(&applied, &after).is_empty());
        // A client that only merges has the same, but for renamed groups, which keep their old keys.
        if before.groups[0].name == after.groups[0].name {
            let mut merged = whole(&before);
            merge(&mut merged, patch.clone());
            let has_renamed = patch.get("lights").is_some_and(|lights| {
                lights.as_object().unwrap().iter().any(|(key, light)| light.get("name").is_some_and(|name| name != key))
            });
            merged.values_mut().for_each(|list| list.as_object_mut().unwrap().sort_keys());
            prop_assert!(has_renamed || merged == by_name(&after), "{:?}", patch);
        }
    }
}

#[test]
fn renamed_lights_keep_their_place() {
    let lights = ["a", "b"].map(|name| Light::point(name, DVec3::ZERO));
    let before = Rig { lights: lights.to_vec(), ..Rig::default() };
    let mut after = before.clone();
    after.lights[0].name = "c".into();
    after.lights[0].stops = 1.0;
    let patch = diff(&before, &after);
    assert_eq!(serde_json::json!(patch), serde_json::json!({ "lights": { "a": { "name": "c", "stops": 1.0 } } }));
    assert_eq!(apply(&before, patch, Path::new("")).unwrap(), after);
}

/// A patch of one value of a sky leaves its others.
#[test]
fn tables_are_merged() {
    let sky = PhysicalSky { elevation: 0.2, turbidity: 2.0, ground: 0.5, sun: false };
    let dome = Light { kind: LightKind::Dome, map: Some(DomeMap::physical(sky)), ..Light::point("day", DVec3::ZERO) };
    let patch = serde_json::json!({ "lights": { "day": { "physical_sky": { "turbidity": 5 } } } });
    let serde_json::Value::Object(patch) = patch else { panic!("{patch}") };
    let after = apply(&Rig { lights: vec![dome], ..Rig::default() }, patch, Path::new("")).unwrap();
    let sky = &by_name(&after)["lights"]["day"]["physical_sky"];
    let is_near = |key: &str, value: f64| (sky[key].as_f64().unwrap() - value).abs() < 1e-9;
    assert!(is_near("turbidity", 5.0) && is_near("ground", 0.5), "{sky}");
    assert!(is_near("elevation_deg", 0.2f64.to_degrees()) && sky["sun"] == false, "{sky}");
}

/// Edits of a follower that do not say whom it follows, beside a leader that gets another name or is deleted.
#[test]
fn followers_keep_their_leader() {
    let lights = ["key", "fill"].map(|name| Light::point(name, DVec3::ZERO));
    let mut rig = Rig { lights: lights.to_vec(), ..Rig::default() };
    rig.lights[1].follows = Some(0);
    let edited = |patch: serde_json::Value| {
        let serde_json::Value::Object(lights) = patch else { panic!("{patch}") };
        let patch = [("lights".to_owned(), lights.into())].into_iter().collect();
        apply(&rig, patch, Path::new("")).unwrap()
    };
    for patch in [
        serde_json::json!({ "fill": { "stops": 1 }, "key": { "name": "main" } }),
        serde_json::json!({ "key": { "name": "main" }, "fill": { "stops": 1 } }),
    ] {
        let after = edited(patch);
        assert_eq!((after.lights[0].name.as_str(), after.lights[1].follows), ("main", Some(0)));
    }
    let alone = edited(serde_json::json!({ "key": null, "fill": { "stops": 1 } }));
    assert_eq!((alone.lights.len(), alone.lights[0].follows, alone.lights[0].stops), (1, None, 1.0));
}

proptest! {
    /// Whatever is edited in whichever shot: that shot shows it, and a file has all shots.
    #[test]
    fn an_edit_in_a_shot_shows_there(
        first in rig(),
        edits in prop::collection::vec((rig(), prop_oneof![Just("left"), Just("right")], any::<bool>()), 1..5),
    ) {
        let mut base = first;
        for (after, camera, only_here) in edits {
            let before = base.of_shot(camera).unwrap();
            // Cones that are valid here and not in another shot are refused.
            let Ok(edited) = base.edited_in_shot(camera, [&before, &after], only_here) else { continue };
            prop_assert_eq!(by_name(&edited.of_shot(camera).unwrap()), by_name(&after), "{:?}", edited.shots);
            let stored = Rig::from_toml(&edited.to_toml(Path::new("")), RigFiles::new(Path::new(""))).unwrap();
            for camera in ["left", "right", "middle"] {
                let [is, was] = [&stored, &edited].map(|rig| by_name(&rig.of_shot(camera).unwrap()));
                prop_assert_eq!(is, was, "{}", edited.to_toml(Path::new("")));
            }
            base = edited;
        }
    }

    /// Values that change in one shot alone are as before in all others.
    #[test]
    fn an_edit_of_one_shot_alone_leaves_the_others(base in rig(), stops in -2.0..2.0f64, other in 0.0..1.0f64) {
        let before = base.of_shot("left").unwrap();
        let mut after = before.clone();
        after.lights.iter_mut().for_each(|light| (light.stops, light.visible) = (stops, !light.visible));
        after.groups[0].stops = stops;
        let edited = base.edited_in_shot("left", [&before, &after], true).unwrap();
        prop_assert_eq!(by_name(&edited.of_shot("right").unwrap()), by_name(&base));
        // Then an edit of all shots leaves what is of this one alone.
        let before = edited.of_shot("right").unwrap();
        let mut after = before.clone();
        after.lights.iter_mut().for_each(|light| (light.stops, light.intensity) = (-stops, other));
        let edited = edited.edited_in_shot("right", [&before, &after], false).unwrap();
        for (left, right) in edited.of_shot("left").unwrap().lights.iter().zip(&after.lights) {
            prop_assert_eq!((left.stops, left.intensity), (stops, other));
            prop_assert_eq!(left.visible, !right.visible);
        }
    }
}
