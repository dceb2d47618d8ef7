//! The lighting desk in the real window, as a lighter uses it.

use std::path::Path;

use crate::command;
use crate::desktop::pictures::{cut, difference, render, scene};
use crate::desktop::{App, Desktop};
use relume::scene::Rig;

const SIZE: [usize; 2] = [360, 240];

/// The window on 16 lights, without its panel, and the rig that it saves to.
fn open<'a>(desktop: &'a Desktop, rig: &Path) -> App<'a> {
    let scene = scene("balls-16.glb");
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
