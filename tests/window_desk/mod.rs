//! The lighting desk in the real window, as a lighter uses it.

use std::path::Path;

use crate::command;
use crate::desktop::pictures::{cut, difference, render, render_with, scene};
use crate::desktop::{App, Desktop};
use glam::DVec3;
use relume::scene::light_filter::{BarnDoors, RigFiles};
use relume::scene::{DomeMap, Light, LightKind, Rig};

const SIZE: [usize; 2] = [360, 240];

/// The window on 16 lights, without its panel, and the rig that it saves to.
fn open<'a>(desktop: &'a Desktop, rig: &Path) -> App<'a> {
    open_scene(desktop, "balls-16.glb", rig)
}

fn open_scene<'a>(desktop: &'a Desktop, name: &str, rig: &Path) -> App<'a> {
    let scene = scene(name);
    let scene = scene.to_str().unwrap();
    if !rig.exists() {
        command::Run::of(command::relume().args(["rig", scene, "-o", rig.to_str().unwrap()])).done();
    }
    let mut window =
        desktop.relume(&["view", scene, "--rig", rig.to_str().unwrap(), "--exposure", "0.5", "--size", "360x240"]);
    window.wait_for_window();
    window.key("F2", "stops"); // without the panel the picture is in the middle
    window.key("1", "picture 1:1");
    window
}

fn picture(window: &App) -> Vec<[u8; 3]> {
    cut(&window.screenshot(), SIZE)
}

/// Saves; the window then shows, bit for bit, what `relume render` makes of the file.
fn saved_is_rendered(window: &App, rig: &Path) -> Rig {
    window.key("ctrl+s", "saved");
    let headless = render(&scene("balls-16.glb"), Some(rig), &rig.with_extension("png"));
    assert_eq!(difference(&picture(window), &headless), 0.0);
    Rig::load(rig).unwrap()
}

#[test]
fn several_lights_and_groups_are_edited_together() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let window = open(&desktop, &rig);
    let before = Rig::load(&rig).unwrap();
    let first = picture(&window);

    window.key("ctrl+Tab", "and 1 more");
    window.key("ctrl+Tab", "and 2 more");
    window.key("d", "and 2 more: moved");
    window.key("plus", "and 2 more: +0.5 stop");
    let edited = picture(&window);
    let after = saved_is_rendered(&window, &rig);
    let moved = |i: usize| after.lights[i].position - before.lights[i].position;
    assert!((0..3).all(|i| (moved(i) - moved(0)).length() < 1e-12 && after.lights[i].stops == 0.5), "{:?}", moved(0));
    assert_eq!(before.lights[3..], after.lights[3..]);
    assert!(difference(&first, &edited) > 0.5);

    window.key("ctrl+g", "group group: new");
    window.key("ctrl+minus", "group group: -0.5 stop");
    window.key("shift+ctrl+l", "group group: -0.5 stop"); // they follow nobody as it is
    window.key("n", "solo");
    let solo = saved_is_rendered(&window, &rig);
    assert_eq!((solo.groups[0].stops, solo.lights.iter().filter(|light| light.solo).count()), (-0.5, 3));
    window.key("m", "off");
    assert!(picture(&window).iter().all(|pixel| *pixel == [0; 3]), "off beats solo");
    window.key("shift+n", "solo off");
    saved_is_rendered(&window, &rig);
    for undone in ["solo off", "off", "solo", "-0.5 stop", "new", "+0.5 stop", "moved 0.1 m"] {
        window.key("ctrl+z", &format!("{undone} - relume"));
    }
    assert_eq!(difference(&picture(&window), &first), 0.0, "undone all the way, bit for bit");
}

/// Rows at the picture's top and bottom that words lie over, and columns on either side of the line.
const WORDS: usize = 24;
const LINE: usize = 8;

/// Mean difference of some columns, between the words.
fn columns_differ(a: &[[u8; 3]], b: &[[u8; 3]], columns: std::ops::Range<usize>) -> f64 {
    let cut = |pixels: &[[u8; 3]]| -> Vec<[u8; 3]> {
        let rows = pixels.chunks(SIZE[0]).skip(WORDS).take(SIZE[1] - 2 * WORDS);
        rows.flat_map(|row| row[columns.clone()].to_vec()).collect()
    };
    difference(&cut(a), &cut(b))
}

#[test]
fn snapshots_are_recalled_and_compared() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let window = open(&desktop, &rig);
    let a = picture(&window);
    window.key("c", "store a snapshot first");
    window.key("ctrl+alt+1", "stored in slot 1");
    window.key("ctrl+a", "and 15 more");
    window.key("comma", "colour");
    window.key("d", "moved");
    window.key("shift+minus", "-1 stop");
    saved_is_rendered(&window, &rig);
    let b = picture(&window);
    assert!(difference(&a, &b) > 5.0);
    window.key("ctrl+alt+2", "stored in slot 2");

    window.key("alt+1", "recalled 1");
    assert!(difference(&picture(&window), &a) < 1e-3);
    window.key("c", "comparison with snapshot 1");
    window.key("alt+2", "recalled 2");
    window.key("ctrl+z", "undone: recalled 2");
    window.key("ctrl+z", "undone: recalled 1"); // the saved state
    let wiped = picture(&window);
    let middle = SIZE[0] / 2;
    assert_eq!(columns_differ(&wiped, &a, 0..middle - LINE), 0.0, "on the left is what was kept, bit for bit");
    assert_eq!(columns_differ(&wiped, &b, middle + LINE..SIZE[0]), 0.0, "on the right what is, bit for bit");
    let shot = window.screenshot();
    let (x, y) = (shot.width as i32 / 2, shot.height as i32 / 2);
    window.drag([x, y], [x + 90, y]);
    let wiped = picture(&window);
    assert_eq!(columns_differ(&wiped, &a, 0..middle + 90 - LINE), 0.0, "the line follows the mouse");
    assert_eq!(columns_differ(&wiped, &b, middle + 90 + LINE..SIZE[0]), 0.0);

    window.key("shift+c", "difference from snapshot 1");
    assert!(columns_differ(&picture(&window), &vec![[0; 3]; a.len()], 0..SIZE[0]) > 1.0);
    window.key("alt+1", "recalled 1");
    let nothing = columns_differ(&picture(&window), &vec![[0; 3]; a.len()], 0..SIZE[0]);
    assert!(nothing < 0.1, "the same lights differ by nothing but rounding: {nothing}");
    window.key("shift+c", "comparison off");
    assert!(difference(&picture(&window), &a) < 1e-3);
}

#[test]
fn snapshots_come_back_with_the_rig() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let window = open(&desktop, &rig);
    let first = picture(&window);
    window.key("ctrl+alt+1", "balls-16* - stored in slot 1");
    window.key("d", "moved");
    let saved = saved_is_rendered(&window, &rig);
    assert_eq!(saved.snapshots.len(), 1);
    window.keys(&["ctrl+q"]);
    window.ends_silently();

    let window = open(&desktop, &rig);
    let moved = picture(&window);
    window.key("alt+1", "recalled 1");
    assert!(difference(&picture(&window), &first) < 1e-3 && difference(&moved, &first) > 0.0);
    window.key("ctrl+z", "balls-16 - undone: recalled 1");
    window.keys(&["ctrl+q"]);
    window.ends_silently();
}

#[test]
fn what_was_not_saved_survives_a_crash() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let kept = rig.with_extension("autosave.toml");
    let window = open(&desktop, &rig);
    let saved = Rig::load(&rig).unwrap();
    window.key("ctrl+Tab", "and 1 more");
    window.key("w", "moved");
    window.key("ctrl+g", "new");
    let lost = picture(&window);
    wait_for_groups(&kept, 1);
    window.kill();
    assert_eq!(Rig::load(&rig).unwrap(), saved, "the rig itself is what was saved");

    let scene = scene("balls-16.glb");
    let arguments =
        ["view", scene.to_str().unwrap(), "--rig", rig.to_str().unwrap(), "--exposure", "0.5", "--size", "360x240"];
    // Who does not answer is asked again.
    let mut unanswered = desktop.relume(&arguments);
    unanswered.wait_for_window_saying("unsaved edits were found");
    unanswered.kill();
    let mut window = desktop.relume(&arguments);
    window.wait_for_window_saying("unsaved edits were found");
    window.key("r", "recovered");
    window.key("F2", "recovered");
    window.key("1", "picture 1:1");
    assert!(difference(&picture(&window), &lost) < 1e-3);
    let recovered = saved_is_rendered(&window, &rig);
    assert_eq!((recovered.groups.len(), recovered.lights[0].group), (1, Some(0)));
    window.key("d", "moved");
    window.quits_unsaved();
    assert!(!kept.exists(), "who quits has decided");
}

/// Waits until the autosave file `kept` holds `count` groups.
fn wait_for_groups(kept: &Path, count: usize) {
    let is_kept = || Rig::load(kept).is_ok_and(|rig| rig.groups.len() == count);
    assert!((0..500).any(|_| is_kept() || {
        std::thread::sleep(std::time::Duration::from_millis(20));
        false
    }));
}

#[test]
fn two_windows_on_one_rig_keep_their_own_edits() {
    let (Some(left), Some(right)) = (Desktop::start(), Desktop::start()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let [one, two] = ["autosave.toml", "autosave.2.toml"].map(|extension| rig.with_extension(extension));
    let first = open(&left, &rig);
    first.key("ctrl+g", "group: new");
    wait_for_groups(&one, 1);
    let second = open(&right, &rig); // and asks nothing
    second.key("ctrl+g", "group: new");
    second.key("Tab", "2 of 16");
    second.key("ctrl+g", "group_2: new");
    wait_for_groups(&two, 2);
    second.quits_unsaved();
    assert!(!two.exists());
    wait_for_groups(&one, 1);
    first.kill();
    let scene = scene("balls-16.glb");
    let mut again =
        left.relume(&["view", scene.to_str().unwrap(), "--rig", rig.to_str().unwrap(), "--size", "360x240"]);
    again.wait_for_window_saying("unsaved edits were found");
    again.key("r", "recovered");
    again.quits_unsaved();
    assert!(!one.exists());
}

#[test]
fn what_is_exported_is_opened_again_as_the_same_picture() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (rig, exported) = (folder.path().join("rig.toml"), folder.path().join("lit.glb"));
    let window = open(&desktop, &rig);
    window.key("ctrl+Tab", "and 1 more");
    window.key("ctrl+g", "new");
    window.key("ctrl+plus", "+0.5 stop");
    window.key("e", "moved");
    window.key("comma", "colour");
    saved_is_rendered(&window, &rig);
    let shown = picture(&window);
    window.keys(&["ctrl+e", "ctrl+a", "BackSpace"]);
    window.text(exported.to_str().unwrap());
    window.key("Return", "exported");
    let again = render(&exported, None, &folder.path().join("again.png"));
    assert_eq!(difference(&again, &shown), 0.0, "bit for bit");
    window.keys(&["ctrl+q"]);
    window.ends_silently();
}

#[test]
fn a_light_is_dragged_in_the_picture() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let window = open(&desktop, &rig);
    window.key("F2", "picture 1:1"); // the panel, and with it the handles
    let camera = relume::scene::Scene::load(&scene("balls-16.glb")).unwrap().cameras[0].clone();
    let aspect = SIZE[0] as f64 / SIZE[1] as f64;
    let pixel = |rig: &Rig, light: usize| {
        let [x, y] = camera.project(rig.lights[light].position, aspect).unwrap();
        [x * SIZE[0] as f64, y * SIZE[1] as f64]
    };
    let shot = window.screenshot();
    window.mouse_to((shot.width as i32 - 290) / 2, shot.height as i32 / 2 + 40);
    window.key("p", "moved"); // the lights of this scene stand beside the picture
    window.key("ctrl+s", "saved");
    let (before, light) = (Rig::load(&rig).unwrap(), 0);
    let corner = [(shot.width - 290 - SIZE[0]) / 2, (shot.height - SIZE[1]) / 2];
    let from = [0, 1].map(|axis| corner[axis] as i32 + pixel(&before, light)[axis].round() as i32);
    window.drag(from, [from[0] + 40, from[1] + 20]);
    window.wait_for_title(&format!("{}: moved", before.lights[light].name));
    window.key("ctrl+s", "saved");
    let after = Rig::load(&rig).unwrap();
    let moved = [0, 1].map(|axis| pixel(&after, light)[axis] - pixel(&before, light)[axis]);
    assert!((moved[0] - 40.0).abs() < 1.5 && (moved[1] - 20.0).abs() < 1.5, "{moved:?}");
}

/// The picture's upper left corner in the window with the panel, at 1:1.
fn corner(window: &App) -> [f64; 2] {
    let shot = window.screenshot();
    [(shot.width - 290 - SIZE[0]) / 2, (shot.height - SIZE[1]) / 2].map(|x| x as f64)
}

fn pixels(at: [f64; 2]) -> [i32; 2] {
    at.map(|x| x.round() as i32)
}

/// A disk in the middle of the picture shines downwards: its left door and its spread open in the picture's plane.
#[test]
fn doors_and_spread_are_dragged_in_the_picture() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let camera = relume::scene::Scene::load(&scene("balls-2.glb")).unwrap().cameras[0].clone();
    let [back, down] = [camera.world_from_camera.z_axis, -camera.world_from_camera.y_axis];
    let mut light = Light::point("key", camera.position - 2.0 * back);
    (light.kind, light.radius, light.direction, light.up) = (LightKind::Disk, 0.01, down, back);
    let doors = BarnDoors { angles: [30f64.to_radians(); 4], softness: 4f64.to_radians() };
    light.filter.barn_doors = Some(doors);
    Rig { lights: vec![light], ..Rig::default() }.save(&rig).unwrap();
    let window = open_scene(&desktop, "balls-2.glb", &rig);
    window.key("F2", "picture 1:1"); // the panel, and with it the handles
    let corner = corner(&window);
    let beside_light =
        |x: f64, y: f64| pixels([corner[0] + SIZE[0] as f64 / 2.0 + x, corner[1] + SIZE[1] as f64 / 2.0 + y]);
    let saved = || {
        window.key("ctrl+s", "saved");
        Rig::load(&rig).unwrap().lights.remove(0)
    };
    let before = saved();

    let door = |deg: f64| beside_light(15.0 + 45.0 * deg.to_radians().sin(), 45.0 * deg.to_radians().cos());
    window.drag(door(30.0), door(75.0));
    window.wait_for_title("key: barn doors");
    let after = saved().filter.barn_doors.unwrap().angles.map(f64::to_degrees);
    assert!((after[0] - 75.0).abs() < 3.0, "{after:?}");
    assert!(after[1..].iter().all(|angle| (angle - 30.0).abs() < 1e-9), "{after:?}");
    window.key("ctrl+z", "undone: key: barn doors");
    assert_eq!(saved(), before, "a drag is one edit");

    window.key("4", "a change of size keeps the radiance");
    let spread = |deg: f64| {
        let half = deg.to_radians() / 2.0;
        beside_light(-60.0 * half.sin(), 60.0 * half.cos())
    };
    window.drag(spread(180.0), spread(100.0));
    window.wait_for_title("key: spread ");
    let after = saved();
    assert!((after.spread.to_degrees() - 100.0).abs() < 4.0 && after.intensity == before.intensity, "{after:?}");
    window.key("ctrl+z", "undone: key: spread ");
    assert_eq!(saved(), before);
    window.quits_unsaved();
}

#[test]
fn history_is_a_list_to_click() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let window = open_scene(&desktop, "balls-2.glb", &rig); // a short list of lights above it
    let opened = picture(&window);
    window.key("d", "moved 0.1 m");
    let moved = picture(&window);
    window.key("plus", "+0.5 stop");
    window.key("comma", "colour");
    let colored = picture(&window);
    assert!(difference(&opened, &moved) > 0.0 && difference(&moved, &colored) > 0.0);
    window.key("F2", "colour"); // the panel
    let in_panel = |x: i32, y: i32| {
        let shot = window.screenshot();
        window.click(shot.width as i32 + x, y);
    };
    in_panel(HISTORY[0], HISTORY[1]);
    // "opened", then a line an edit.
    for (line, says, shown) in [(1, "moved 0.1 m", &moved), (0, "opened", &opened), (3, "colour", &colored)] {
        in_panel(HISTORY[0], HISTORY[1] + 21 + 21 * line);
        window.wait_for_title(says);
        window.key("F2", says);
        assert_eq!(difference(&picture(&window), shown), 0.0, "{says}");
        window.key("F2", says);
    }
    window.key("ctrl+z", "undone: point0: colour");
    window.quits_unsaved();
}

/// Where the panel's heading "History" lies: from the window's right edge, from its top.
const HISTORY: [i32; 2] = [-245, 451];

#[test]
fn objects_are_linked_under_the_mouse() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let window = open_scene(&desktop, "balls-2.glb", &rig);
    let shot = window.screenshot();
    window.mouse_to(shot.width as i32 / 2, shot.height as i32 / 2); // the ball in the middle
    let opened = picture(&window);
    window.key("z", "point0: does not light ball_diffuse");
    let unlit = picture(&window);
    assert!(difference(&opened, &unlit) > 0.0);
    window.key("shift+z", "point0: no shadow from ball_diffuse");
    let light = saved_is_rendered(&window, &rig).lights.remove(0);
    assert_eq!(
        (light.links.except, light.links.no_shadow_from),
        (vec!["ball_diffuse".into()], vec!["ball_diffuse".into()])
    );
    assert!(difference(&unlit, &picture(&window)) > 0.0);
    window.key("z", "point0: lights ball_diffuse");
    window.key("ctrl+z", "undone");
    window.key("ctrl+z", "undone");
    assert_eq!(difference(&picture(&window), &unlit), 0.0, "bit for bit");
    window.quits_unsaved();
}

#[test]
fn a_light_with_a_size_is_made_resized_and_saved() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let window = open_scene(&desktop, "balls-2.glb", &rig);
    let shot = window.screenshot();
    window.mouse_to(shot.width as i32 / 2, shot.height as i32 / 2);
    window.key("ctrl+5", "new");
    let small = picture(&window);
    window.key("6", " x ");
    window.key("6", " x ");
    assert!(difference(&small, &picture(&window)) > 0.0);
    window.key("ctrl+s", "saved");
    // All points of the light are in the picture after some seconds.
    let headless = render(&scene("balls-2.glb"), Some(&rig), &rig.with_extension("png"));
    let is_finished = || {
        std::thread::sleep(std::time::Duration::from_millis(500));
        difference(&picture(&window), &headless) == 0.0
    };
    assert!((0..100).any(|_| is_finished()), "the picture at rest is the one that `render` makes");
    let saved = Rig::load(&rig).unwrap();
    let light = saved.lights.last().unwrap();
    assert_eq!(light.kind, LightKind::Rect);
    window.key("ctrl+z", "undone");
    window.key("ctrl+s", "saved");
    let undone = Rig::load(&rig).unwrap();
    let before = undone.lights.last().unwrap();
    assert!(before.size < light.size, "{undone:?}");
    window.key("3", "intensity in lm");
    window.key("4", "a change of size keeps the radiance");
    window.key("6", " cd, ");
    window.key("ctrl+s", "saved");
    let larger = Rig::load(&rig).unwrap();
    let after = larger.lights.last().unwrap();
    let radiance = |light: &Light| light.intensity / light.projected_area().unwrap();
    assert!(after.size > before.size && (radiance(after) / radiance(before) - 1.0).abs() < 1e-12, "{after:?}");
    window.quits_unsaved();
}

/// From the first key to the next start of the program, by hand.
#[test]
fn a_light_with_a_size_is_dragged_linked_saved_and_opened_again() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    let camera = relume::scene::Scene::load(&scene("balls-2.glb")).unwrap().cameras[0].clone();
    let window = open_scene(&desktop, "balls-2.glb", &rig);
    window.key("F2", "picture 1:1"); // the panel, and with it the handles
    let corner = corner(&window);
    let ball = pixels([0, 1].map(|axis| corner[axis] + SIZE[axis] as f64 / 2.0));
    let saved = || {
        window.key("ctrl+s", "saved");
        Rig::load(&rig).unwrap().lights.pop().unwrap()
    };
    let point = |at| {
        let [x, y] = camera.project(at, SIZE[0] as f64 / SIZE[1] as f64).unwrap();
        [corner[0] + x * SIZE[0] as f64, corner[1] + y * SIZE[1] as f64]
    };
    let drag = |from: [f64; 2], [x, y]: [f64; 2]| window.drag(pixels(from), pixels([from[0] + x, from[1] + y]));

    window.mouse_to(ball[0], ball[1]);
    window.key("ctrl+5", "new");
    window.key("p", "moved");
    let placed = saved();
    drag(point(placed.position), [30.0, -20.0]);
    window.wait_for_title("moved");
    let moved = saved();
    let by = [0, 1].map(|axis| point(moved.position)[axis] - point(placed.position)[axis]);
    assert!((by[0] - 30.0).abs() < 1.5 && (by[1] + 20.0).abs() < 1.5, "{by:?}");

    let [width, height] = moved.axes();
    let edge = moved.position + width * (moved.size[0] / 2.0) + height * (moved.size[1] / 2.0);
    let outwards = [0, 1].map(|axis| 0.5 * (point(edge)[axis] - point(moved.position)[axis]));
    drag(point(edge), outwards);
    window.wait_for_title(" m - relume");
    let resized = saved();
    assert!(resized.size != moved.size, "{resized:?}");

    window.mouse_to(ball[0], ball[1]);
    window.key("z", "rectangle: does not light ball_diffuse");
    let linked = saved();
    assert_eq!(linked.links.except, ["ball_diffuse"]);
    window.key("ctrl+z", "undone");
    assert_eq!(saved(), resized);
    window.key("ctrl+y", "does not light ball_diffuse");
    assert_eq!(saved(), linked);
    window.keys(&["ctrl+q"]);
    window.ends_silently();

    let again = open_scene(&desktop, "balls-2.glb", &rig);
    let headless = render(&scene("balls-2.glb"), Some(&rig), &rig.with_extension("png"));
    assert!((0..100).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(500));
        difference(&picture(&again), &headless) == 0.0
    }));
    again.keys(&["ctrl+q"]);
    again.ends_silently();
}

/// Three files, of which one is broken. Maps are exchanged by a click and the dome is turned by a drag on its ball.
#[test]
fn a_dome_takes_maps_of_its_folder_and_is_turned_by_its_ball() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.toml");
    for (name, color) in [("a.png", [200, 0, 0]), ("b.png", [0, 0, 200])] {
        // One half is brighter, so that it matters how the dome is turned.
        let texel = |i: usize| if i % 64 < 32 { color } else { color.map(|channel| channel / 4) };
        let texels: Vec<[u8; 3]> = (0..64 * 32).map(texel).collect();
        relume::image::png::write(&folder.path().join(name), 64, 32, &texels).unwrap();
    }
    std::fs::write(folder.path().join("c.hdr"), "#?RADIANCE\n").unwrap();
    let map = RigFiles::new(folder.path()).sky_map("a.png").unwrap();
    let dome = Light {
        kind: LightKind::Dome,
        map: Some(DomeMap::File(map)),
        visible: true,
        ..Light::point("sky", DVec3::ZERO)
    };
    Rig { lights: vec![dome], ..Rig::default() }.save(&rig).unwrap();
    let window = open_scene(&desktop, "balls-2.glb", &rig);
    window.key("F2", "picture 1:1"); // the panel, and with it the ball
    let saved = || {
        window.key("ctrl+s", "saved");
        Rig::load(&rig).unwrap().lights.remove(0)
    };

    window.key("ctrl+7", "picture 1:1");
    let is_shown = || {
        let shot = window.screenshot();
        let [red, blue] = [0, 1].map(thumbnail).map(|[x, y]| shot.rgb[y as usize * shot.width + x as usize]);
        red[0] > red[2].saturating_add(40) && blue[2] > blue[0].saturating_add(40)
    };
    assert!((0..20).any(|_| is_shown()), "thumbnails appear");
    let click = |row| {
        let [x, y] = thumbnail(row);
        window.click(x, y);
    };
    click(2);
    window.wait_for_title("the map");
    click(1);
    window.wait_for_title("sky: map b.png");
    let exchanged = saved();
    assert!(
        exchanged.map.as_ref().and_then(DomeMap::as_file).is_some_and(|map| map.path().ends_with("b.png")),
        "{exchanged:?}"
    );
    window.key("Escape", "saved");

    let corner = corner(&window);
    let ball = pixels([0, 1].map(|axis| corner[axis] + SIZE[axis] as f64 - 56.0));
    window.drag(ball, [ball[0] + 24, ball[1]]);
    window.wait_for_title("sky: turned");
    let turned = saved();
    assert!((turned.rotation - 1.0).abs() < 1e-6, "half the radius is one radian: {}", turned.rotation);
    window.key("ctrl+z", "undone: sky: turned");
    assert_eq!(saved(), exchanged, "a drag is one edit");
    window.key("ctrl+z", "undone: sky: map b.png");
    window.quits_unsaved();
}

/// The middle of a thumbnail in the browser of environment maps, from the window's top left.
fn thumbnail(row: i32) -> [i32; 2] {
    [83, 98 + 75 * row]
}

/// A scene is opened without a dome, and so without light of the sky. With the first dome that is baked, too.
#[test]
fn a_first_dome_gets_light_of_the_sky() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let [rig, cache] = ["rig.toml", "cache"].map(|name| folder.path().join(name));
    let balls = scene("balls-2.glb");
    Rig { lights: vec![Light::point("key", DVec3::new(0.0, 2.0, 2.0))], ..Rig::default() }.save(&rig).unwrap();
    let [scene, rig_name, cache_name] = [&balls, &rig, &cache].map(|path| path.to_str().unwrap());
    let settings = ["--rig", rig_name, "--cache", cache_name, "--gi", "glossy", "--gather", "100", "--rays", "64"];
    let settings = [&settings[..], &["--samples", "8", "--exposure", "0.5", "--size", "360x240"]].concat();
    let mut window = desktop.relume(&[&["view", scene], &settings[..]].concat());
    window.wait_for_window();
    window.key("F2", "stops");
    window.key("1", "picture 1:1");
    window.key("ctrl+6", "dome: new");
    window.key("ctrl+s", "saved");

    let has_sky = || {
        let what = b"light of the sky";
        let files = std::fs::read_dir(&cache).unwrap().map(|file| file.unwrap().path());
        // Journals come and go.
        let mut kept = files.filter(|path| path.extension().is_some_and(|extension| extension == "safetensors"));
        kept.any(|path| std::fs::read(path).unwrap().windows(what.len()).any(|part| part == what))
    };
    let soon = |is_so: &dyn Fn() -> bool| {
        (0..200).any(|_| {
            std::thread::sleep(std::time::Duration::from_millis(500));
            is_so()
        })
    };
    assert!(soon(&has_sky), "it is baked and kept");
    let headless = render_with(&balls, &settings, &rig.with_extension("png"));
    assert!(soon(&|| difference(&picture(&window), &headless) == 0.0), "the window shows what a new start would");
    window.keys(&["ctrl+q"]);
    window.ends_silently();
}
