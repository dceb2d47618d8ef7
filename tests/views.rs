//! Each view of the real window is the picture that `relume render` makes of it.

mod command;
mod desktop;

use std::path::{Path, PathBuf};

use desktop::pictures::{cut, difference, render_with, scene, scene_in};
use desktop::{App, Desktop};
use relume::scene::Scene;

const SIZE: [usize; 2] = [360, 240];

fn balls() -> PathBuf {
    scene("balls-2.glb")
}

fn picture(window: &App) -> Vec<[u8; 3]> {
    cut(&window.screenshot(), SIZE)
}

/// What `relume render` makes of it with further arguments.
fn render(output: &Path, arguments: &[&str]) -> Vec<[u8; 3]> {
    render_with(&balls(), &[&SETTINGS[..], arguments].concat(), output)
}

/// Few gather samples, so that the bake takes a second.
const SETTINGS: [&str; 10] =
    ["--exposure", "0.5", "--size", "360x240", "--gi", "glossy", "--gather", "256", "--rays", "64"];

fn open<'a>(desktop: &'a Desktop, arguments: &[&str]) -> App<'a> {
    let balls = balls();
    let mut window = desktop.relume(&[&["view", balls.to_str().unwrap()], &SETTINGS[..], arguments].concat());
    window.wait_for_window();
    window.key("F2", "stops"); // without the panel the picture is in the middle
    window.key("1", "picture 1:1");
    window
}

#[test]
fn every_view_is_what_render_makes_of_it() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("pass.png");
    // Bakes indirect light, which the window then finds.
    let beauty = render(&output, &[]);
    let window = open(&desktop, &[]);
    let light = format!("light:{}", Scene::load(&balls()).unwrap().rig.lights[0].name);
    assert_eq!(difference(&picture(&window), &beauty), 0.0, "beauty");
    for (key, title, pass) in [
        ("F6", "view: direct", "direct"),
        ("F7", "view: reflection", "reflection"),
        ("F8", "view: indirect", "indirect"),
        ("F9", "view: selected light", &light),
    ] {
        window.key(key, title);
        let (shown, headless) = (picture(&window), render(&output, &["--passes", pass]));
        assert_eq!(difference(&shown, &headless), 0.0, "{pass}");
        assert!(difference(&shown, &beauty) > 1.0, "{pass} is not the whole");
    }
    window.key("F5", "view: beauty");
    window.key("F4", "false colours on");
    let headless = render(&output, &["--tonemap", "false-color"]);
    assert_eq!(difference(&picture(&window), &headless), 0.0, "false colours");
    window.key("F4", "false colours off");
    assert_eq!(difference(&picture(&window), &beauty), 0.0, "the first picture is back");
    // What no headless picture shows is something else each time, and none of it ends the program.
    let mut seen = vec![beauty.clone()];
    for (key, title) in [
        ("F10", "view: every light"),
        ("F12", "view: distance"),
        ("F12", "view: position"),
        ("F12", "view: normal, layer 1"),
        ("shift+F12", "view: normal, layer 2"),
        ("shift+F8", "view: error of indirect light"),
    ] {
        window.key(key, title);
        let shown = picture(&window);
        assert!(seen.iter().all(|other| difference(other, &shown) > 0.5), "{title} looks like another view");
        seen.push(shown);
    }
    window.key("F10", "view: every light");
    window.key("F5", "view: beauty");
    window.mouse_to(400, 350);
    for (key, title) in [
        ("shift+F4", "histogram on"),
        ("shift+F5", "probe on"),
        ("shift+F6", "gather samples on"),
        ("shift+F3", "profile on"),
    ] {
        window.key(key, title);
        let shown = picture(&window);
        assert!(difference(seen.last().unwrap(), &shown) > 0.0, "{title}");
        seen.push(shown);
    }
    window.keys(&["shift+F4", "shift+F5", "shift+F6", "shift+F3"]);
    window.wait_for_title("profile off");
    assert_eq!(difference(&picture(&window), &beauty), 0.0, "nothing of it stays");
    window.keys(&["ctrl+q"]);
    window.ends_silently();
}

/// Until the window shows `wanted`, bit for bit.
#[track_caller]
fn wait_for_picture(window: &App, wanted: &[[u8; 3]]) {
    let start = std::time::Instant::now();
    loop {
        let apart = difference(&picture(window), wanted);
        if apart == 0.0 {
            return;
        }
        assert!(start.elapsed().as_secs() < 60, "the picture stays {apart} from what it is to become");
    }
}

#[test]
fn at_rest_pictures_become_what_render_makes_of_more_samples() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (output, rig) = (folder.path().join("best.png"), folder.path().join("moved.toml"));
    let rig_text = rig.to_str().unwrap();
    command::Run::of(command::relume().args(["rig", balls().to_str().unwrap(), "-o", rig_text])).done();
    let lit = ["--rig", rig_text];
    let (plain, best) = (render(&output, &lit), render(&output, &[&lit[..], &["--samples", "8"]].concat()));
    assert!(difference(&plain, &best) > 0.1, "edges are smoother");
    let window = open(&desktop, &["--samples", "8", "--rig", rig_text]);
    wait_for_picture(&window, &best);
    // A recoloured light leaves edges where they are; a moved one takes them along.
    window.key("r", "colour");
    window.key("D", "moved");
    window.key("ctrl+s", "saved");
    let moved = render(&output, &["--samples", "8", "--rig", rig_text]);
    assert!(difference(&moved, &best) > 1.0, "the edits show");
    wait_for_picture(&window, &moved);
    window.key("ctrl+z", "undone");
    window.key("ctrl+z", "undone");
    wait_for_picture(&window, &best);
    window.quits_unsaved();
}

#[test]
fn a_slow_drag_is_coarse_and_finished_exactly() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (script, stats, rig) = (path("a.script"), path("stats.json"), path("rig.toml"));
    let balls = balls();
    let mut text = String::from("0.2 press D\n");
    (1..20).for_each(|i| text += &format!("{:.2} repeat D\n", 0.2 + 0.05 * f64::from(i)));
    std::fs::write(&script, text + "1.3 release D\n2.5 key Ctrl+S\n").unwrap();
    command::Run::of(command::relume().args(["rig", balls.to_str().unwrap(), "-o", &rig])).done();
    // Bakes indirect light, which the window then finds.
    render(&folder.path().join("first.png"), &["--rig", &rig]);
    // No frame fits a thousandth of a millisecond.
    let budget = ["--frame-budget", "0.001", "--script", &script, "--stats", &stats, "--rig", &rig];
    let mut window = desktop.relume(&[&["view", balls.to_str().unwrap()], &SETTINGS[..], &budget].concat());
    window.wait_for_window();
    window.wait_for_title("saved");
    window.key("F2", "saved");
    window.key("1", "picture 1:1");
    let finished = picture(&window);
    let headless = render(&folder.path().join("finished.png"), &["--rig", &rig]);
    assert_eq!(difference(&finished, &headless), 0.0);
    window.keys(&["ctrl+q"]);
    window.ends_silently();
    let stats: serde_json::Value = serde_json::from_slice(&std::fs::read(&stats).unwrap()).unwrap();
    // However few frames a busy machine makes of the drag.
    assert!(stats["view"]["coarse_frames"].as_u64().unwrap() >= 1, "{stats}");
}

#[test]
fn scripts_reach_views_and_a_trace_tells_of_every_frame() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (script, stats, trace) = (path("a.script"), path("stats.json"), path("trace.json"));
    let text = "0.1 key F2\n0.2 key F6\n0.4 key F10\n0.6 mouse 300 200\n0.7 down left\n0.8 up left\n0.9 key F5\n\
                1.0 press D\n1.1 repeat D\n1.2 release D\n2.0 key Ctrl+Q\n2.2 key Q\n";
    std::fs::write(&script, text).unwrap();
    let balls = scene_in(folder.path(), "balls-2.glb");
    let window = desktop.relume(&[
        "view",
        balls.to_str().unwrap(),
        "--size",
        "360x240",
        "--script",
        &script,
        "--stats",
        &stats,
        "--trace",
        &trace,
    ]);
    window.ends_silently();
    let read = |path: &str| -> serde_json::Value { serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap() };
    let (stats, trace) = (read(&stats), read(&trace));
    let events = trace["traceEvents"].as_array().unwrap();
    let count = |name: &str| events.iter().filter(|event| event["name"] == name).count();
    let [frames, relit] = ["frames", "relit_frames"].map(|name| stats["view"][name].as_u64().unwrap() as usize);
    assert!(
        (relit..=frames).contains(&count("present")),
        "all but the loading bar's: {} of {frames}",
        count("present")
    );
    // A busy machine may take several events at once.
    assert!(count("contact sheet") >= 2 && count("composite") >= 1, "{trace}");
    let times = events.iter().filter(|event| event["name"] == "present").map(|event| event["ts"].as_f64().unwrap());
    let times: Vec<f64> = times.collect();
    assert!(times.is_sorted() && times[times.len() - 1] - times[0] > 1e6, "frames come when they came: {times:?}");
}
