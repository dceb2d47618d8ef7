//! Thousands of random edits through the lighting desk, as the window makes them, at 160 x 120.

mod common;

use common::random::Random;
use common::stage::{Setup, Stage};
use common::{Gpu, gpu, transfer};
use glam::{DVec3, Vec3};
use relume::desk::selection::Selection;
use relume::desk::{Desk, Frame, GroupEdit, LightEdit, Pick};
use relume::relight::{Picture, Relighter};
use relume::scene::{Light, LightGroup, LightKind, Scene};

/// The most lights at a time, so that memory has a bound.
const MOST_LIGHTS: usize = 24;

/// One thing that a hand does.
fn act(desk: &mut Desk, random: &mut Random) {
    let count = desk.rig().lights.len();
    let a_light = random.below(count.max(1));
    let slot = random.below(9);
    // Near, so that the history grows.
    let last = desk.history().entries().len() - 1;
    let entry = (desk.history().current() + random.below(5)).saturating_sub(2).min(last);
    let normal = random.direction();
    let place = |random: &mut Random| DVec3::new(0.0, 1.0, 0.0) + random.vector(-1.5, 1.5);
    let pick = Pick { position: place(random), normal, shading_normal: normal, to_eye: normal };
    match random.below(32) {
        0..8 => {
            let edits = [
                LightEdit::Move { frame: Frame::Camera, axis: random.direction() },
                LightEdit::Move { frame: Frame::World, axis: 3.0 * random.direction() },
                LightEdit::Turn { right: random.between(-9.0, 9.0), up: random.between(-9.0, 9.0) },
                LightEdit::Stops(random.pick(&[-0.5, 0.1, 0.5])),
                LightEdit::Mired(random.between(-20.0, 20.0)),
                LightEdit::Channel(random.below(3), random.between(-0.2, 0.2)),
                LightEdit::Outer(random.between(-5.0, 5.0)),
                LightEdit::Inner(random.between(-5.0, 5.0)),
                LightEdit::Toggle,
                LightEdit::Solo,
                LightEdit::Shadows,
            ];
            desk.edit(random.pick(&edits));
        }
        8..11 if count > 0 => desk.select(Selection::only(a_light)),
        11..13 if count > 0 => {
            let mut selection = desk.selection().clone();
            selection.toggle(a_light);
            desk.select(selection);
        }
        13 if count > 0 => {
            let mut selection = desk.selection().clone();
            selection.extend_to(a_light);
            desk.select(selection);
        }
        14 => desk.place(pick),
        15 => desk.aim(pick),
        16 => desk.place_highlight(pick, random.between(0.5, 4.0)),
        17 => desk.place_shadow(place(random), pick, random.between(0.5, 4.0)),
        18 if count < MOST_LIGHTS => {
            use LightKind::{Directional, Disk, Dome, Point, Rect, Spot};
            let kinds = [Point, Spot, Directional, Disk, Rect, Dome];
            desk.add(random.pick(&kinds), place(random), 0.0, random.between(0.5, 4.0));
        }
        19 if count + desk.selection().len() <= MOST_LIGHTS => desk.duplicate(),
        20 if count > 4 && desk.selection().len() < 3 => desk.delete(),
        21 => desk.group_selected(),
        22 => desk.set_group(random.pick(&[None, Some(0)]).filter(|_| !desk.rig().groups.is_empty())),
        23 => desk.edit_group(random.pick(&[
            GroupEdit::Stops(0.5),
            GroupEdit::Stops(-0.5),
            GroupEdit::Toggle,
            GroupEdit::Solo,
        ])),
        24 if !desk.rig().groups.is_empty() => {
            let group = random.below(desk.rig().groups.len());
            desk.replace_group(group, LightGroup { color: random.color(), ..desk.rig().groups[group].clone() });
        }
        25 => random.pick(&[Desk::follow as fn(&mut Desk), Desk::unfollow, Desk::end_solo])(desk),
        26 => desk.store(slot),
        27 => desk.recall(slot),
        28 => desk.undo(),
        29 => desk.redo(),
        30 => desk.go_to(entry),
        _ => {
            if let Some(light) = desk.selected_light().cloned() {
                let color = (light.color + 0.1 * random.vector(-1.0, 1.0).as_vec3()).max(Vec3::ZERO);
                desk.edit_primary_and_selection(Light {
                    color,
                    intensity: light.intensity * random.between(0.8, 1.25),
                    ..light
                });
            }
        }
    }
    if random.below(3) > 0 {
        desk.end_gesture(); // else the next edit may be of the same drag
    }
}

/// What the window does for each frame: hands over lights and focus, shows the picture.
fn picture(relighter: &mut Relighter, desk: &Desk) -> Vec<[f32; 3]> {
    relighter.set_rig(desk.rig()).expect("the device has room");
    relighter.select(desk.history().focus());
    relighter.linear(Picture::Whole).expect("frames run").to_vec()
}

/// Bytes of this process that are in memory.
fn resident_bytes() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").ok();
    let pages = pages.and_then(|text| text.split(' ').nth(1)?.parse::<u64>().ok());
    4096 * pages.unwrap_or(0)
}

fn edits(gpu: &Gpu, count: usize, seed: u64) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/balls-16.glb");
    let scene = Scene::load(path.as_ref()).unwrap();
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    let setup = Setup::new(160, 120);
    let mut stage = Stage::new(scene, &camera, &rig, &setup);
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(64, 64, 16)));
    let mut relighter = stage.relighter(gpu, &rig, &setup);
    let mut desk = Desk::new(rig, camera, f64::from(stage.scene.bvh.radius));
    let first = picture(&mut relighter, &desk);
    let mut random = Random::new(seed);
    let mut memory = None;
    let mut compared = 0;
    for i in 1..=count {
        act(&mut desk, &mut random);
        let got = picture(&mut relighter, &desk);
        if i == count || i.is_multiple_of(count / 12) {
            let want = picture(&mut stage.relighter(gpu, desk.rig(), &setup), &desk);
            assert!(got == want, "edit {i}, {}: not what a new relighter shows", desk.message);
            compared += 1;
        }
        assert!(got.iter().flatten().all(|value| value.is_finite() && *value >= 0.0), "edit {i}: {}", desk.message);
        // By then every buffer has been needed.
        if i == count / 4 {
            memory = Some((gpu.memory_by_owner(), resident_bytes()));
        }
    }
    assert!(compared >= 12 && desk.history().entries().len() > count / 20, "{}", desk.history().entries().len());
    let (device, resident) = memory.expect("a quarter was done");
    let total = |owners: &[(String, u64)]| owners.iter().map(|(_, bytes)| bytes).sum::<u64>();
    let image = 12 * stage.framebuffer.pixel_stride() as u64;
    // A light more at a time than in the first quarter is two images more.
    let most = total(&device) + 2 * MOST_LIGHTS as u64 * image;
    assert!(total(&gpu.memory_by_owner()) <= most, "{device:?}\n{:?}", gpu.memory_by_owner());
    // States share what is the same: some 600 bytes an edit.
    let grown = resident_bytes().saturating_sub(resident);
    assert!(grown < 16_000_000 + 2_000 * count as u64, "{grown} bytes more than after a quarter of the edits");
    println!("{count} edits: {} states, {grown} bytes more than after a quarter", desk.history().entries().len());
    while desk.history().current() > 0 {
        desk.undo();
    }
    assert!(picture(&mut relighter, &desk) == first, "undone all the way it is the first picture, bit for bit");
}

#[test]
fn any_edits_leave_the_picture_of_their_lights() {
    let gpu = gpu();
    edits(&gpu, 300, 1);
    if std::env::var_os("RELUME_FULL").is_some() {
        edits(&gpu, 10_000, 2);
    }
}
