use super::*;
use crate::scene::Projection;

fn desk(count: usize) -> Desk {
    let light = |i: usize| Light::point(&format!("key_{i}"), DVec3::new(i as f64, 1.0, 0.0));
    let rig = Rig { lights: (0..count).map(light).collect(), ..Rig::default() };
    let yfov = Projection::Perspective { yfov: 0.7 };
    let camera = Camera::look_at(DVec3::Z * 5.0, DVec3::ZERO, DVec3::Y, yfov).unwrap();
    Desk::new(rig, camera, 10.0)
}

const RIGHT: LightEdit = LightEdit::Move { frame: Frame::Camera, axis: DVec3::X };

#[test]
fn every_edit_can_be_undone_and_redone_exactly() {
    let mut desk = desk(3);
    let first = desk.rig().clone();
    let pick = Pick { position: DVec3::new(0.3, 0.0, 0.2), normal: DVec3::Y };
    let mut states = vec![first.clone()];
    type Edit = Box<dyn Fn(&mut Desk)>;
    let edits: Vec<Edit> = vec![
        Box::new(|d| d.edit(RIGHT)),
        Box::new(|d| d.edit(LightEdit::Stops(0.5))),
        Box::new(|d| d.edit(LightEdit::Mired(-10.0))),
        Box::new(|d| d.edit(LightEdit::Channel(2, -0.05))),
        Box::new(|d| d.edit(LightEdit::Toggle)),
        Box::new(|d| d.add(LightKind::Spot, DVec3::ZERO, 0.0)),
        Box::new(|d| d.edit(LightEdit::Turn { right: 2.0, up: 1.0 })),
        Box::new(|d| d.edit(LightEdit::Outer(-10.0))),
        Box::new(move |d| d.place(pick)),
        Box::new(move |d| d.aim(Pick { position: DVec3::X, ..pick })),
        Box::new(Desk::duplicate),
        Box::new(Desk::delete),
        Box::new(Desk::delete),
        Box::new(|d| d.edit(LightEdit::Shadows)),
    ];
    for edit in &edits {
        desk.end_gesture();
        edit(&mut desk);
        assert_ne!(desk.rig(), states.last().unwrap(), "{}", desk.message);
        states.push(desk.rig().clone());
    }
    for state in states.iter().rev().skip(1) {
        desk.undo();
        assert_eq!(desk.rig(), state, "{}", desk.message);
    }
    assert!(!desk.history().is_unsaved());
    desk.undo();
    assert_eq!((desk.rig(), desk.message.as_str()), (&first, "nothing to undo"));
    for state in &states[1..] {
        desk.redo();
        assert_eq!(desk.rig(), state, "{}", desk.message);
    }
}

#[test]
fn a_held_key_is_one_edit_with_one_name() {
    let mut desk = desk(2);
    for _ in 0..5 {
        desk.edit(LightEdit::Stops(0.5));
    }
    assert_eq!(desk.history().names()[0].as_deref(), Some("key_0: +2.5 stops"));
    desk.end_gesture();
    desk.edit(LightEdit::Stops(-0.5));
    desk.undo();
    desk.undo();
    assert_eq!(desk.rig().lights[0].stops, 0.0);
    // There and back in one gesture is nothing at all.
    desk.end_gesture();
    desk.edit(RIGHT);
    desk.edit(LightEdit::Move { frame: Frame::Camera, axis: DVec3::NEG_X });
    assert!(!desk.history().is_unsaved());
}

#[test]
fn what_is_saved_is_known_through_undo_and_other_paths() {
    let mut desk = desk(1);
    desk.edit(RIGHT);
    desk.mark_saved();
    assert!(!desk.history().is_unsaved() && desk.history().focus().is_none());
    desk.undo();
    assert!(desk.history().is_unsaved());
    desk.edit(LightEdit::Stops(1.0)); // as deep as the saved state, and another
    assert!(desk.history().is_unsaved() && desk.history().focus() == Some(0));
}

#[test]
fn what_makes_no_sense_is_told_and_changes_nothing() {
    let mut desk = desk(1);
    let first = desk.rig().clone();
    desk.edit(LightEdit::Turn { right: 1.0, up: 0.0 });
    assert_eq!(desk.message, "key_0: a point light shines everywhere; nothing to turn");
    desk.edit(LightEdit::Outer(1.0));
    desk.edit(LightEdit::Stops(1e9));
    assert_eq!(desk.message, "key_0: it would be brighter than numbers go");
    desk.aim(Pick { position: DVec3::ZERO, normal: DVec3::Y });
    desk.replace(0, Light { name: String::new(), ..first.lights[0].clone() });
    assert_eq!(desk.rig(), &first);
    desk.delete();
    for edit in [RIGHT, LightEdit::Toggle] {
        desk.edit(edit);
        assert_eq!(desk.message, "no light is selected");
    }
    desk.delete();
    desk.duplicate();
    desk.select_next(1);
    desk.add(LightKind::Directional, DVec3::ZERO, 0.0);
    assert_eq!((desk.rig().lights.len(), desk.selected()), (1, Some(0)));
    desk.edit(RIGHT);
    assert!(desk.message.contains("no place"), "{}", desk.message);
}

#[test]
fn names_stay_unique() {
    let mut desk = desk(2);
    desk.duplicate();
    desk.duplicate();
    let names: Vec<_> = desk.rig().lights.iter().map(|light| light.name.clone()).collect();
    let unique: std::collections::HashSet<_> = names.iter().collect();
    assert_eq!(unique.len(), 4, "{names:?}");
    let renamed = Light { name: names[0].clone(), ..desk.rig().lights[1].clone() };
    desk.replace(1, renamed);
    assert_eq!(desk.rig().lights[1].name, names[1]);
}

#[test]
fn a_new_light_is_as_bright_at_its_target_whatever_the_scale() {
    for scale in [1e-3, 1.0, 1e3] {
        let mut desk = desk(0);
        desk.camera.position *= scale;
        desk.add(LightKind::Point, DVec3::ZERO, 1.0);
        let light = &desk.rig().lights[0];
        let lux = light.intensity / light.position.length_squared();
        assert!((lux / (std::f64::consts::FRAC_PI_2 / 2.0) - 1.0).abs() < 0.05, "{scale}: {lux}");
    }
}
