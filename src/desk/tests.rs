use glam::{DVec3, Vec3};

use super::*;
use crate::scene::light_filter::{BarnDoors, RigFiles};
use crate::scene::rig::kelvin_and_tint_of;
use crate::scene::{LightGroup, LightKind, Links, ObjectSet, Projection, Scene};

fn desk_lights(count: usize) -> Vec<Light> {
    (0..count).map(|i| Light::point(&format!("key_{i}"), DVec3::new(i as f64, 1.0, 0.0))).collect()
}

fn desk(count: usize) -> Desk {
    let rig = Rig { lights: desk_lights(count), ..Rig::default() };
    Desk::new(rig, desk_camera(), 10.0)
}

fn desk_camera() -> Camera {
    let yfov = Projection::Perspective { yfov: 0.7 };
    Camera::look_at(DVec3::Z * 5.0, DVec3::ZERO, DVec3::Y, yfov).unwrap()
}

const RIGHT: LightEdit = LightEdit::Move { frame: Frame::Camera, axis: DVec3::X };

#[test]
fn every_edit_can_be_undone_and_redone_exactly() {
    let mut desk = desk(3);
    let first = desk.rig().clone();
    let pick =
        Pick { position: DVec3::new(0.3, 0.0, 0.2), normal: DVec3::Y, shading_normal: DVec3::Y, to_eye: DVec3::Y };
    let mut states = vec![first.clone()];
    type Edit = Box<dyn Fn(&mut Desk)>;
    let edits: Vec<Edit> = vec![
        Box::new(|d| d.edit(RIGHT)),
        Box::new(|d| d.edit(LightEdit::Stops(0.5))),
        Box::new(|d| d.edit(LightEdit::Mired(-10.0))),
        Box::new(|d| d.edit(LightEdit::Channel(2, -0.05))),
        Box::new(|d| d.edit(LightEdit::Toggle)),
        Box::new(|d| d.add(LightKind::Spot, DVec3::ZERO, 0.0, f64::INFINITY)),
        Box::new(|d| d.edit(LightEdit::Turn { right: 2.0, up: 1.0 })),
        Box::new(|d| d.edit(LightEdit::Outer(-10.0))),
        Box::new(move |d| d.place(pick)),
        Box::new(move |d| d.aim(Pick { position: DVec3::X, ..pick })),
        Box::new(Desk::duplicate),
        Box::new(Desk::delete),
        Box::new(Desk::delete),
        Box::new(|d| d.edit(LightEdit::Shadows)),
        Box::new(|d| {
            d.select_all();
            d.group_selected();
        }),
        Box::new(|d| d.edit_group(GroupEdit::Stops(-1.0))),
        Box::new(|d| d.edit_group(GroupEdit::Solo)),
        Box::new(Desk::end_solo),
        Box::new(Desk::follow),
        Box::new(|d| d.edit(RIGHT)),
        Box::new(Desk::unfollow),
        Box::new(|d| d.set_group(None)),
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
    assert_eq!(desk.history().names()[0], Some("key_0: +2.5 stops"));
    desk.end_gesture();
    desk.edit(LightEdit::Stops(-0.5));
    desk.undo();
    desk.undo();
    assert_eq!(desk.rig().lights[0].stops, 0.0);
    // A move forth and back in one gesture is no edit.
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
    assert!(!desk.history().is_unsaved() && desk.history().focus().is_empty());
    desk.undo();
    assert!(desk.history().is_unsaved());
    desk.edit(LightEdit::Stops(1.0)); // another state at the same depth of the history as the saved one
    assert!(desk.history().is_unsaved() && desk.history().focus() == [0]);
}

#[test]
fn what_makes_no_sense_is_told_and_changes_nothing() {
    let mut desk = desk(1);
    let first = desk.rig().clone();
    desk.edit(LightEdit::Turn { right: 1.0, up: 0.0 });
    assert_eq!(desk.message, "key_0: a point light shines in all directions and cannot turn");
    desk.edit(LightEdit::Outer(1.0));
    desk.edit(LightEdit::Stops(1e9));
    assert_eq!(desk.message, "key_0: its brightness would be out of range");
    let up = DVec3::Y;
    desk.aim(Pick { position: DVec3::ZERO, normal: up, shading_normal: up, to_eye: up });
    desk.edit_primary_and_selection(Light { name: String::new(), ..first.lights[0].clone() });
    assert_eq!(desk.rig(), &first);
    desk.delete();
    for edit in [RIGHT, LightEdit::Toggle] {
        desk.edit(edit);
        assert_eq!(desk.message, "no light is selected");
    }
    desk.delete();
    desk.duplicate();
    desk.select_next(1);
    desk.add(LightKind::Directional, DVec3::ZERO, 0.0, f64::INFINITY);
    assert_eq!((desk.rig().lights.len(), desk.selected()), (1, Some(0)));
    desk.edit(RIGHT);
    assert!(desk.message.contains("no position"), "{}", desk.message);
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
    desk.select(Selection::only(1));
    desk.edit_primary_and_selection(renamed);
    assert_eq!(desk.rig().lights[1].name, names[1]);
}

#[test]
fn a_new_light_is_as_bright_at_its_target_whatever_the_scale() {
    for scale in [1e-3, 1.0, 1e3] {
        let mut desk = desk(0);
        desk.camera.position *= scale;
        desk.add(LightKind::Point, DVec3::ZERO, 1.0, f64::INFINITY);
        let light = &desk.rig().lights[0];
        let lux = light.intensity / light.position.length_squared();
        assert!((lux / (std::f64::consts::FRAC_PI_2 / 2.0) - 1.0).abs() < 0.05, "{scale}: {lux}");
    }
}

/// In a room the light stands inside of it.
#[test]
fn a_new_light_stands_before_what_is_in_its_way() {
    let mut desk = desk(0);
    desk.add(LightKind::Rect, DVec3::ZERO, 0.0, f64::INFINITY);
    desk.add(LightKind::Rect, DVec3::ZERO, 0.0, 2.0);
    let [far, near] = &desk.rig().lights[..] else { panic!("{:?}", desk.rig()) };
    assert!(far.position.length() > 5.0 && (near.position.length() - 1.8).abs() < 1e-12, "{:?}", near.position);
    assert!((near.direction - far.direction).length() < 1e-12);
}

/// Three different lights, all selected, the first one as the primary.
fn several() -> Desk {
    let mut desk = desk(3);
    for (index, light) in desk.rig.lights.iter_mut().enumerate() {
        let i = index as f64;
        (light.intensity, light.stops, light.kind) = (1.0 + i, i, LightKind::Spot);
        (light.outer_angle, light.inner_angle) = (0.3 + 0.1 * i, 0.1);
        light.color = Vec3::new(1.0, 0.5 + 0.1 * i as f32, 0.2);
        light.enabled = index != 1;
    }
    desk.base = desk.rig.clone();
    desk.history = History::new([&desk.rig, &desk.base]);
    desk.select(Selection::of([1, 2, 0]));
    desk
}

#[test]
fn several_lights_change_alike_and_keep_what_they_differ_in() {
    let mut desk = several();
    let before = desk.rig().lights.clone();
    let primary = &before[0];
    desk.edit_primary_and_selection(Light {
        position: primary.position + DVec3::Y,
        intensity: 3.0 * primary.intensity,
        stops: primary.stops - 0.5,
        color: primary.color * Vec3::new(0.5, 1.0, 1.0),
        outer_angle: primary.outer_angle + 0.05,
        range: Some(4.0),
        ..primary.clone()
    });
    assert!(desk.message.starts_with("key_0 and 2 more: moved 1 m, -0.5 stop, 3 cd, colour"), "{}", desk.message);
    for (before, after) in before.iter().zip(&desk.rig().lights) {
        assert_eq!(after.position, before.position + DVec3::Y);
        assert_eq!((after.intensity, after.stops), (3.0 * before.intensity, before.stops - 0.5));
        assert_eq!(after.color, before.color * Vec3::new(0.5, 1.0, 1.0));
        assert!((after.outer_angle - before.outer_angle - 0.05).abs() < 1e-15);
        assert_eq!((after.range, after.enabled), (Some(4.0), before.enabled));
    }
    // A switch makes them all the same.
    desk.edit(LightEdit::Toggle);
    assert!(desk.rig().lights.iter().all(|light| !light.enabled));
    // Lights to which an edit does not apply are unchanged; the others are edited.
    let mut point = desk.rig().lights[2].clone();
    point.kind = LightKind::Point;
    desk.select(Selection::only(2));
    desk.edit_primary_and_selection(point);
    desk.select_all();
    desk.edit(LightEdit::Turn { right: 10.0, up: 0.0 });
    assert!(desk.rig().lights[2] == desk.history().state().lights[2].as_ref().clone());
    assert_ne!(desk.rig().lights[0].direction, before[0].direction);
    desk.delete();
    assert_eq!((desk.rig().lights.len(), desk.message.as_str()), (0, "key_0 and 2 more: deleted"));
}

#[test]
fn a_selection_is_made_of_single_lights_and_ranges() {
    let mut selection = Selection::only(4);
    selection.extend_to(2);
    assert_eq!(selection.iter().collect::<Vec<_>>(), [4, 3, 2]);
    selection.toggle(3);
    selection.add(4);
    assert_eq!((selection.primary(), selection.len()), (Some(4), 2));
    assert_eq!(selection.within(3).iter().collect::<Vec<_>>(), [2]);
    let mut desk = desk(3);
    desk.add_next_to_selection(1);
    assert_eq!((desk.selection().len(), desk.message.contains("key_1 and 1 more")), (2, true), "{}", desk.message);
    desk.select_next(1);
    assert_eq!((desk.selection().len(), desk.selected()), (1, Some(2)));
}

#[test]
fn groups_have_a_master_and_go_with_their_last_light() {
    let mut desk = several();
    desk.group_selected();
    assert_eq!(desk.message, "group group: new");
    for _ in 0..3 {
        desk.edit_group(GroupEdit::Stops(0.5));
    }
    assert_eq!(desk.message, "group group: +1.5 stops");
    assert_eq!(desk.history().focus(), [0, 1, 2], "the lights of the edited group are summed separately");
    desk.replace_group(0, LightGroup { color: Vec3::new(-1.0, 0.0, 0.0), ..desk.rig().groups[0].clone() });
    assert!(desk.message.contains("out of range"), "{}", desk.message);
    desk.select(Selection::of([0, 1]));
    desk.group_selected();
    assert_eq!(desk.rig().groups[1].name, "group_2");
    desk.select(Selection::only(2));
    desk.set_group(Some(1));
    let names: Vec<_> = desk.rig().groups.iter().map(|group| group.name.as_str()).collect();
    assert_eq!(names, ["group_2"], "the first group has no lights any more");
    assert!(desk.rig().lights.iter().all(|light| light.group == Some(0)));
}

#[test]
fn off_beats_solo() {
    let mut desk = several(); // the light in the middle is off
    let shining =
        |desk: &Desk| desk.rig().with_solo_applied().lights.iter().map(|light| light.enabled).collect::<Vec<_>>();
    assert_eq!(shining(&desk), [true, false, true]);
    desk.select(Selection::of([0, 1]));
    desk.edit(LightEdit::Solo);
    assert_eq!(shining(&desk), [true, false, false]);
    desk.select(Selection::only(2));
    desk.group_selected();
    desk.edit_group(GroupEdit::Solo);
    assert_eq!(shining(&desk), [true, false, true]);
    desk.end_solo();
    assert!(!desk.is_solo());
}

#[test]
fn followers_go_where_their_leader_goes() {
    let mut desk = several();
    desk.select(Selection::of([2, 1]));
    desk.follow(); // 2 follows 1
    desk.select(Selection::of([1, 0]));
    desk.follow(); // 1 follows 0
    desk.select(Selection::of([0, 2]));
    desk.follow();
    assert_eq!(desk.message, "key_2 already follows one of them");
    let before = desk.rig().lights.clone();
    desk.select(Selection::only(0));
    desk.edit(RIGHT);
    let moved = |desk: &Desk| [0, 1, 2].map(|i| desk.rig().lights[i].position - before[i].position);
    assert!(moved(&desk).iter().all(|by| (*by - DVec3::X * desk.step()).length() < 1e-12), "{:?}", moved(&desk));
    desk.select(Selection::only(1));
    desk.edit(LightEdit::Stops(1.0));
    assert_eq!([0, 1, 2].map(|i| desk.rig().lights[i].stops - before[i].stops), [0.0, 1.0, 1.0]);
    desk.delete();
    assert_eq!(desk.rig().lights.iter().map(|light| light.follows).collect::<Vec<_>>(), [None; 2]);
    desk.undo();
    assert_eq!(desk.rig().lights.iter().map(|light| light.follows).collect::<Vec<_>>(), [None, Some(0), Some(1)]);
}

#[test]
fn states_of_the_past_are_a_click_away_and_share_what_is_the_same() {
    let mut desk = several();
    let mut rigs = vec![desk.rig().clone()];
    for light in [0, 1, 2, 0] {
        desk.select(Selection::only(light));
        desk.edit(RIGHT);
        rigs.push(desk.rig().clone());
    }
    for entry in [2, 0, 4, 1] {
        desk.go_to(entry);
        assert_eq!(desk.rig(), &rigs[entry]);
    }
    let before = desk.history().state().clone();
    desk.select(Selection::only(2));
    desk.edit(RIGHT);
    let shared = desk.history().state().lights.iter().zip(&before.lights);
    let shared: Vec<bool> = shared.map(|(a, b)| std::sync::Arc::ptr_eq(a, b)).collect();
    assert_eq!((shared, desk.history().entries().len()), (vec![true, true, false], 3));
}

/// A point on a floor that is seen from above at 45 degrees.
fn floor(position: DVec3) -> Pick {
    Pick { position, normal: DVec3::Y, shading_normal: DVec3::Y, to_eye: DVec3::new(0.0, 1.0, 1.0).normalize() }
}

#[test]
fn highlights_and_shadows_fall_where_somebody_points() {
    let mut desk = several();
    desk.select(Selection::only(0));
    let (at, caster) = (DVec3::new(0.5, 0.0, 0.5), DVec3::new(0.5, 1.0, 0.0));
    let distance = (desk.rig().lights[0].position - at).length();
    desk.place_highlight(floor(at), 100.0);
    let light = desk.rig().lights[0].clone();
    let mirrored = DVec3::new(0.0, 1.0, -1.0).normalize();
    assert!(
        (light.position - at - distance * mirrored).length() < 1e-12 && (light.direction + mirrored).length() < 1e-12
    );
    desk.place_highlight(floor(at), 0.5);
    assert!(((desk.rig().lights[0].position - at).length() - 0.45).abs() < 1e-12, "it stays in front of the obstacle");
    let from_below = Pick { to_eye: DVec3::new(0.0, -0.1, 1.0).normalize(), ..floor(at) };
    desk.place_highlight(from_below, 1.0);
    assert!(desk.message.contains("no highlight is possible there"), "{}", desk.message);

    desk.place_shadow(caster, floor(at), 100.0);
    let light = desk.rig().lights[0].clone();
    let ray = (caster - at).normalize();
    assert!((light.position - caster).normalize().dot(ray) > 1.0 - 1e-12 && light.direction.dot(ray) < -1.0 + 1e-12);
    desk.place_shadow(DVec3::NEG_Y, floor(at), 1.0);
    assert!(desk.message.contains("no shadow of that point"), "{}", desk.message);
}

#[test]
fn snapshots_are_kept_recalled_and_undone() {
    let mut desk = several();
    let kept = desk.rig().clone();
    desk.recall(3);
    assert_eq!(desk.message, "slot 4 is empty");
    desk.store(3);
    desk.annotate(3, "cold".into());
    desk.select_all();
    desk.delete();
    desk.add(LightKind::Point, DVec3::ZERO, 0.0, f64::INFINITY);
    let other = desk.rig().clone();
    desk.recall(3);
    assert_eq!((desk.rig(), desk.message.as_str()), (&kept, "recalled 4: cold"));
    desk.undo();
    assert_eq!(desk.rig(), &other);
    let id = desk.snapshots().get(3).map(|snapshot| snapshot.id);
    desk.store(3);
    let again = desk.snapshots().get(3).unwrap();
    assert!(Some(again.id) != id && again.note == "cold" && desk.snapshot_rig(3).as_ref() == Some(&other));
}

#[test]
fn snapshots_and_notes_are_saved_with_the_rig() {
    let mut desk = several();
    assert!(!desk.is_unsaved());
    desk.store(3);
    assert!(desk.is_unsaved() && !desk.history().is_unsaved(), "a snapshot is to be saved, too");
    desk.mark_saved();
    desk.annotate(3, "cold".into());
    assert!(desk.is_unsaved());
    desk.group_selected();
    desk.store(0);
    desk.select_all();
    desk.delete();
    let saved = desk.rig_to_save();
    let slots: Vec<_> = saved.snapshots.iter().map(|snapshot| (snapshot.slot, snapshot.note.as_str())).collect();
    assert_eq!(slots, [(0, ""), (3, "cold")]);
    let text = saved.to_toml(std::path::Path::new(""));
    let read = Rig::from_toml(&text, crate::scene::RigFiles::new(std::path::Path::new(""))).unwrap();
    assert_eq!(read, saved, "{text}");

    let mut again = Desk::new(read, desk.camera.clone(), 10.0);
    assert!(!again.is_unsaved() && again.rig().snapshots.is_empty() && again.rig_to_save() == saved);
    assert_eq!(again.snapshots().last(), Some(3));
    again.recall(3);
    assert_eq!((again.rig().lights.len(), again.message.as_str()), (3, "recalled 4: cold"));
    assert_eq!(again.snapshot_rig(3), desk.snapshot_rig(3));
    again.recover(desk.rig().clone());
    assert!(again.snapshots().get(3).is_none() && again.is_unsaved(), "what a crash left had no snapshots");
}

#[test]
fn files_become_filters_of_the_selected_lights() {
    let folder = tempfile::tempdir().unwrap();
    let lamp = folder.path().join("lamp.IES");
    std::fs::write(&lamp, "TILT=NONE\n1 -1 1 1 1 1 2 0 0 0 1 1 9 0 0 250\n").unwrap();
    let leaves = folder.path().join("leaves.png");
    image::RgbImage::new(2, 2).save(&leaves).unwrap();
    let mut desk = desk(1);
    desk.end_gesture();
    desk.attach(&lamp);
    let light = desk.selected_light().unwrap();
    assert!(light.filter.ies.is_some() && light.intensity == 250.0, "{}", desk.message);
    desk.attach(&leaves);
    assert_eq!(desk.message, "key_0: only spots, disks and rectangles have a gobo");
    desk.end_gesture();
    desk.add(LightKind::Spot, DVec3::ZERO, 0.0, f64::INFINITY);
    desk.add_next_to_selection(-1);
    desk.end_gesture();
    desk.attach_gobo(folder.path(), "leaves.png");
    let gobos: Vec<bool> = desk.rig().lights.iter().map(|light| light.filter.gobo.is_some()).collect();
    assert_eq!(gobos, [false, true], "{}", desk.message);
    desk.attach_gobo(folder.path(), "none.png");
    assert!(desk.message.contains("none.png"), "{}", desk.message);
    desk.end_gesture();
    desk.attach_gobo(folder.path(), "");
    assert!(desk.rig().lights[1].filter.is_none(), "{}", desk.message);
    desk.undo();
    assert!(desk.rig().lights[1].filter.gobo.is_some(), "{}", desk.message);
    desk.go_to(0);
    assert!(desk.rig().lights[0].filter.is_none() && desk.rig().lights[0].intensity == 1.0);
}

#[test]
fn a_map_is_one_edit_of_the_selected_domes() {
    let folder = tempfile::tempdir().unwrap();
    image::RgbImage::new(4, 2).save(folder.path().join("sky.png")).unwrap();
    let map = RigFiles::new(folder.path()).sky_map("sky.png").unwrap();
    let mut desk = desk(1);
    desk.set_map(Some(map.clone()));
    assert_eq!(desk.message, "key_0: only domes have a map");
    for _ in 0..2 {
        desk.add(LightKind::Dome, DVec3::ZERO, 0.0, f64::INFINITY);
    }
    desk.select_all();
    desk.set_map(Some(map));
    assert!(desk.message.ends_with("and 1 more: map sky.png"), "{}", desk.message);
    let maps = |desk: &Desk| desk.rig().lights.iter().filter(|light| light.map.is_some()).count();
    assert_eq!(maps(&desk), 2);
    desk.undo();
    assert_eq!(maps(&desk), 0);
    desk.end_gesture();
    desk.edit(LightEdit::Turn { right: 15.0, up: 0.0 });
    assert!(desk.message.ends_with("and 1 more: turned -15°"), "{}", desk.message);
}

/// A ball, or the ground, of a scene in which every node has a material of its own.
fn object<'a>(scene: &'a Scene, name: &'a str) -> PickedObject<'a> {
    let triangles = 0..scene.mesh.triangles.len() as u32;
    let has_name = |triangle: &u32| scene.objects[scene.mesh.object(*triangle)].name == name;
    PickedObject { scene, name, triangle: triangles.into_iter().find(has_name).unwrap() }
}

fn balls() -> Scene {
    Scene::load(std::path::Path::new("scenes/balls-2.glb")).unwrap()
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[test]
fn objects_are_lit_or_not() {
    let scene = balls();
    let [gold, silver, steel] = ["ball_gold", "ball_silver", "ball_steel"].map(|name| object(&scene, name));
    let mut desk = desk(2);
    desk.select_all();
    let links = |desk: &Desk| desk.rig().lights.iter().map(|light| light.links.clone()).collect::<Vec<_>>();
    desk.edit_links(LinkEdit::Light, gold);
    desk.edit_links(LinkEdit::Shadow, silver);
    let linked = Links { except: names(&["ball_gold"]), no_shadow_from: names(&["ball_silver"]), ..Links::default() };
    assert_eq!(links(&desk), [linked.clone(), linked]);
    desk.edit_links(LinkEdit::Light, gold);
    desk.edit_links(LinkEdit::Shadow, silver);
    assert_eq!(links(&desk), [Links::default(), Links::default()]);
    let mut light = desk.selected_light().unwrap().clone();
    light.links =
        Links { only: names(&["ball_gold"]), factor: [("ball_steel".into(), 0.3)].into(), ..Links::default() };
    desk.edit_primary_and_selection(light);
    desk.edit_links(LinkEdit::Light, steel);
    assert_eq!(links(&desk)[0], Links { only: names(&["ball_gold", "ball_steel"]), ..Links::default() });
    desk.edit_links(LinkEdit::Light, gold);
    let linked = Links { only: names(&["ball_gold", "ball_steel"]), except: names(&["ball_gold"]), ..Links::default() };
    assert_eq!(links(&desk), [linked.clone(), linked]);
}

/// What was not saved before a scene is loaded again is not saved after it, though nothing can be undone; and snapshots
/// get the emitters that are new.
#[test]
fn a_scene_is_loaded_again_among_unsaved_edits() {
    let before = balls();
    let mut desk = desk(1);
    desk.store(0);
    let linked = |only: &[&str]| {
        let mut rig = Rig { lights: desk_lights(1), ..Rig::default() };
        rig.lights[0].links.only = names(only);
        rig
    };
    desk.take_rig(linked(&["ball_gold"])).unwrap();
    desk.end_gesture();
    desk.take_rig(Rig { lights: vec![Light { stops: 1.0, ..linked(&[]).lights[0].clone() }], ..Rig::default() })
        .unwrap();
    let mut after = before.clone();
    after.objects.iter_mut().filter(|object| object.name == "ball_gold").for_each(|object| object.name = "new".into());
    after.materials[0].emissive = Vec3::ONE;
    let rig = desk.rig_in(&after, &Rig::default()).unwrap();
    desk.change_scene(rig, &after, desk_camera());
    assert!(desk.is_unsaved() && desk.rig().lights.len() == 2);
    desk.undo();
    assert_eq!((desk.rig().lights[0].stops, desk.rig().lights.len()), (1.0, 2), "{}", desk.message);
    desk.recall(0);
    assert_eq!((desk.rig().lights[0].stops, desk.rig().lights[1].kind), (0.0, LightKind::Emitter));
}

/// One edit switches an object, by whatever name the links include it.
#[test]
fn objects_in_sets_are_lit_or_not() {
    let scene = balls();
    let [gold, silver] = ["ball_gold", "ball_silver"].map(|name| object(&scene, name));
    let mut desk = desk(1);
    let set = |name: &str, items: &[&str]| ObjectSet { name: name.into(), items: names(items) };
    desk.rig.sets = vec![set("metals", &["ball_gold", "silver", "ball_steel"]), set("ground", &["ball_gold"])];
    let metals = || names(&["metals"]);
    let mut edited = |links: Links, edit, object| {
        desk.rig.lights[0].links = links;
        desk.edit_links(edit, object);
        desk.rig.lights[0].links.clone()
    };
    // What a set lights goes dark, what a set leaves dark is lit.
    let only = Links { only: metals(), ..Links::default() };
    let dark = Links { except: names(&["ball_gold"]), ..only.clone() };
    assert_eq!(edited(only.clone(), LinkEdit::Light, gold), dark);
    assert_eq!(edited(dark, LinkEdit::Light, gold), only);
    let except = Links { except: metals(), ..Links::default() };
    let others = names(&["silver", "ball_steel"]);
    let lit = Links { except: others.clone(), ..Links::default() };
    assert_eq!(edited(except, LinkEdit::Light, gold), lit);
    // By the name of its material.
    let lit = Links { except: names(&["ball_steel"]), ..Links::default() };
    assert_eq!(edited(Links { except: others.clone(), ..Links::default() }, LinkEdit::Light, silver), lit);
    let factor = |names: &[String]| names.iter().map(|name| (name.clone(), 0.0)).collect();
    let zero = Links { factor: factor(&metals()), ..Links::default() };
    assert_eq!(edited(zero, LinkEdit::Light, gold), Links { factor: factor(&others), ..Links::default() });
    let shadowless = Links { no_shadow_from: metals(), ..Links::default() };
    let cast = Links { no_shadow_from: others, ..Links::default() };
    assert_eq!(edited(shadowless, LinkEdit::Shadow, gold), cast);
    // This name is that of a set without the object.
    assert_eq!(edited(Links::default(), LinkEdit::Light, object(&scene, "ground")), Links::default());
    assert_eq!(desk.message, "key_0: a set has the name of this object; edit the links in the rig file");
}

#[test]
fn tint_spread_and_doors_are_edited_in_steps() {
    let mut desk = desk(1);
    desk.edit(LightEdit::Tint(0.1));
    desk.edit(LightEdit::Tint(-0.3));
    let (kelvin, tint) = kelvin_and_tint_of(desk.selected_light().unwrap().color);
    let (before, was) = kelvin_and_tint_of(Vec3::ONE);
    assert!((kelvin / before - 1.0).abs() < 2e-3 && (tint - was + 0.2).abs() < 2e-3, "{kelvin} {tint}");
    assert!((luminance(desk.selected_light().unwrap().color) - 1.0).abs() < 1e-5);
    desk.edit(LightEdit::Outer(1.0));
    assert_eq!(desk.message, "key_0: only spots have a cone, only disks and rectangles a spread");
    desk.add(LightKind::Rect, DVec3::ZERO, 0.0, f64::INFINITY);
    desk.edit(LightEdit::Outer(-10.0));
    assert!((desk.selected_light().unwrap().spread.to_degrees() - 160.0).abs() < 1e-9, "{}", desk.message);
    desk.edit(LightEdit::Outer(-500.0));
    assert_eq!(desk.selected_light().unwrap().spread, LEAST_SPREAD);
    desk.edit(LightEdit::Inner(1.0));
    assert_eq!(desk.message, "rectangle: only a spot light has an inner cone");
    desk.edit(LightEdit::Doors(1.0));
    assert_eq!(desk.message, "rectangle: it has no barn doors; switch them on in the panel");
    let doors = BarnDoors { angles: [30f64, 89.5, -20.0, 0.0].map(f64::to_radians), softness: 0.1 };
    let mut light = desk.selected_light().unwrap().clone();
    light.filter.barn_doors = Some(doors);
    desk.edit_primary_and_selection(light);
    desk.end_gesture();
    desk.edit(LightEdit::Doors(1.0));
    desk.edit(LightEdit::Doors(1.0));
    let angles = desk.selected_light().unwrap().filter.barn_doors.unwrap().angles.map(f64::to_degrees);
    assert!(angles.iter().zip([32.0, 90.0, -18.0, 2.0]).all(|(is, want)| (is - want).abs() < 1e-9), "{angles:?}");
    desk.undo();
    assert_eq!(desk.selected_light().unwrap().filter.barn_doors, Some(doors), "a held key is one edit");
}

#[test]
fn a_change_of_size_keeps_power_or_radiance() {
    let mut desk = desk(3);
    for light in &mut desk.rig.lights {
        (light.kind, light.radius, light.intensity) = (LightKind::Disk, 0.5, 8.0);
    }
    desk.rig.lights[1].radius = 0.0;
    desk.rig.lights[2].follows = Some(0);
    desk.base = desk.rig.clone();
    desk.history = History::new([&desk.rig, &desk.base]);
    let first = desk.rig().clone();
    let strengths = |desk: &Desk| [0, 1, 2].map(|i| (desk.rig().lights[i].radius, desk.rig().lights[i].intensity));
    // By key, as the power stays.
    desk.edit(LightEdit::Size(1.0));
    assert_eq!(strengths(&desk), [(1.0, 8.0), (0.0, 8.0), (1.0, 8.0)]);
    desk.undo();
    desk.toggle_size_keeps();
    assert_eq!(desk.message, "a change of size keeps the radiance");
    desk.edit(LightEdit::Size(1.0));
    assert_eq!(strengths(&desk), [(1.0, 32.0), (0.0, 8.0), (1.0, 32.0)], "the follower has its own radiance");
    desk.undo();
    assert_eq!(desk.rig(), &first, "size and intensity are one edit");
    desk.redo();
    assert_eq!(desk.rig().lights[0].intensity, 32.0, "redone, not applied again");
    desk.undo();
    // By number or handle, several lights; a punctual light has no radiance.
    desk.select(Selection::of([1, 0]));
    desk.edit_primary_and_selection(Light { radius: 0.25, ..desk.rig().lights[0].clone() });
    assert_eq!(strengths(&desk), [(0.25, 2.0), (0.0, 8.0), (0.25, 2.0)]);
    desk.edit_primary_and_selection(Light { radius: 0.0, ..desk.rig().lights[0].clone() });
    assert_eq!(strengths(&desk)[0], (0.0, 2.0));
    // Another intensity is another radiance.
    desk.go_to(0);
    desk.edit_primary_and_selection(Light { intensity: 4.0, ..desk.rig().lights[0].clone() });
    assert_eq!(strengths(&desk), [(0.5, 4.0), (0.0, 4.0), (0.5, 4.0)]);
}

#[test]
fn shots_differ_where_they_were_told_to() {
    let mut desk = desk(2);
    let camera = |name: &str| Camera { name: name.into(), ..desk_camera() };
    desk.look_from(camera("left"));
    desk.only_here = true;
    desk.edit(LightEdit::Stops(1.0));
    desk.only_here = false;
    desk.end_gesture();
    desk.edit(RIGHT);
    let left = desk.rig().clone();
    desk.look_from(camera("right"));
    let right = desk.rig().clone();
    assert_eq!((left.lights[0].stops, right.lights[0].stops), (1.0, 0.0));
    assert_eq!(left.lights[0].position, right.lights[0].position, "it moved in all shots");

    // What is of this shot alone is edited there, wherever edits go.
    desk.look_from(camera("left"));
    desk.edit(LightEdit::Stops(0.5));
    assert_eq!(desk.rig().lights[0].stops, 1.5);
    desk.look_from(camera("right"));
    assert_eq!(desk.rig(), &right);

    // Undone from another camera.
    for expected in [1.0, 1.0, 0.0] {
        desk.undo();
        assert_eq!(desk.base().of_shot("left").unwrap().lights[0].stops, expected, "{}", desk.message);
    }
    assert!(desk.base().shots.is_empty() && !desk.is_unsaved());
    (0..3).for_each(|_| desk.redo());
    desk.look_from(camera("left"));
    desk.share_selected();
    assert_eq!((desk.rig(), desk.base().shots.len()), (&right, 0), "{}", desk.message);

    // A light's name and end are the same everywhere.
    desk.only_here = true;
    desk.edit(LightEdit::Stops(1.0));
    let renamed = Light { name: "rim".into(), ..desk.rig().lights[0].clone() };
    desk.edit_primary_and_selection(renamed);
    desk.look_from(camera("right"));
    assert_eq!((&*desk.rig().lights[0].name, desk.rig().lights[0].stops), ("rim", 0.0));
    assert_eq!(desk.base().of_shot("left").unwrap().lights[0].stops, 1.0);
    desk.delete();
    assert!(desk.base().shots.is_empty() && desk.rig().lights.len() == 1);
}
