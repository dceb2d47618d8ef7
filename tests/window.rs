//! The real window, as a person uses it.

mod command;
mod desktop;
mod window_desk;

use std::path::Path;
use std::time::Instant;

use desktop::Desktop;
use desktop::pictures::{cut, difference, render, render_with, scene, scene_in};
use relume::image::exr;
use relume::relight::ToneMap;
use relume::scene::Rig;

#[test]
fn a_person_sets_up_lights() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (scene, rig) = (scene("balls-2.glb"), folder.path().join("balls.toml"));
    let (rig_text, scene_text) = (rig.to_str().unwrap(), scene.to_str().unwrap());
    command::Run::of(command::relume().args(["rig", scene_text, "-o", rig_text])).done();
    let size = [360, 240];
    let arguments = ["view", scene_text, "--rig", rig_text, "--exposure", "0.5", "--size", "360x240"];
    let mut window = desktop.relume(&arguments);
    window.wait_for_window();
    window.key("F2", "stops"); // without the panel the picture is in the middle
    window.key("1", "picture 1:1");
    let first = cut(&window.screenshot(), size);
    let headless = render(&scene, Some(&rig), &folder.path().join("first.png"));
    assert_eq!(difference(&first, &headless), 0.0, "both sum all lights in the same order");

    window.key("Tab", "2 of 2");
    let before = Rig::load(&rig).unwrap();
    let name = &before.lights[1].name;
    window.key("d", &format!("{name}: moved"));
    window.key("Right", &format!("{name}: moved"));
    window.key("plus", &format!("{name}: +0.5 stop"));
    window.key("comma", &format!("{name}: colour"));
    window.key("r", &format!("{name}: colour"));
    window.mouse_to(380, 330);
    window.key("o", &format!("{name}: turned"));
    window.key("p", &format!("{name}: moved"));
    window.key("ctrl+z", "undone");
    window.key("ctrl+y", &format!("{name}: moved"));
    window.key("ctrl+d", "new");
    window.key("m", "off");
    let edited = cut(&window.screenshot(), size);
    window.key("ctrl+s", "saved");
    let saved = cut(&window.screenshot(), size);
    let headless = render(&scene, Some(&rig), &folder.path().join("saved.png"));
    assert!(difference(&edited, &headless) < 1e-3, "{}", difference(&edited, &headless));
    assert_eq!(difference(&saved, &headless), 0.0, "what is saved and opened again is the same, bit for bit");
    assert!(difference(&first, &saved) > 2.0, "the edits show");
    let after = Rig::load(&rig).unwrap();
    assert_eq!((after.lights.len(), after.lights[1].stops), (3, before.lights[1].stops + 0.5));

    // A storm of sizes, away and back.
    for i in 0..30 {
        let (width, height) = ((300 + 37 * i % 700).to_string(), (200 + 53 * i % 500).to_string());
        window.do_with_window("windowsize", &[&width, &height]);
    }
    window.do_with_window("windowminimize", &[]);
    window.do_with_window("windowmap", &[]);
    window.do_with_window("windowactivate", &[]);
    window.do_with_window("windowsize", &["500", "400"]);
    window.wait_for_size(500, 400);
    assert_eq!(difference(&cut(&window.screenshot(), size), &saved), 0.0);

    for _ in 0..12 {
        window.keys(&["ctrl+z"]);
    }
    window.wait_for_title("nothing to undo");
    assert_eq!(difference(&cut(&window.screenshot(), size), &first), 0.0, "undone all the way, bit for bit");
    // Unsaved now: quitting asks.
    window.keys(&["ctrl+q"]);
    window.keys(&["Escape"]);
    window.key("Tab", "of 2");
    window.quits_unsaved();
    assert_eq!(Rig::load(&rig).unwrap(), after);
}

#[test]
fn dialogs_and_the_panel_take_what_is_typed() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let scene = scene_in(folder.path(), "cornell-diffuse.glb");
    let saved = folder.path().join("typed.toml");
    let mut window = desktop.relume(&["view", scene.to_str().unwrap(), "--size", "240x240", "--exposure", "0"]);
    window.wait_for_window();
    window.key("ctrl+1", "new");
    window.key("question", "new");
    window.key("Escape", "new");
    window.keys(&["ctrl+q", "s", "ctrl+a", "BackSpace"]);
    // Letters that are keys of the desk go into the field.
    window.text(saved.to_str().unwrap());
    window.key("Return", "saved");
    assert_eq!(Rig::load(&saved).unwrap().lights.last().unwrap().name, "point");
    window.keys(&["ctrl+q"]);
    window.ends_silently();
}

#[test]
fn a_script_plays_the_same_every_time_and_rest_costs_nothing() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = scene("balls-2.glb");
    let (script, again, rig, stats) = (path("a.script"), path("b.script"), path("rig.toml"), path("stats.json"));
    let text = "0.1 key F2\n0.2 press D\n0.3 repeat D\n0.4 release D\n0.5 mouse 300 300\n0.6 press P\n\
                0.7 mouse 320 310\n0.8 release P\n2.5 key Ctrl+S\n2.6 text \"X\"\n3.0 key Ctrl+Q\n";
    std::fs::write(&script, text).unwrap();
    let mut poses = Vec::new();
    for (played, recorded) in [(&script, &again), (&again, &path("c.script"))] {
        command::Run::of(command::relume().args(["rig", scene.to_str().unwrap(), "-o", &rig])).done();
        let window = desktop.relume(&[
            "view",
            scene.to_str().unwrap(),
            "--rig",
            &rig,
            "--size",
            "720x480",
            "--script",
            played,
            "--record",
            recorded,
            "--stats",
            &stats,
        ]);
        window.ends_silently();
        poses.push(Rig::load(Path::new(&rig)).unwrap());
        let stats: serde_json::Value = serde_json::from_slice(&std::fs::read(&stats).unwrap()).unwrap();
        // The first picture, four edits (one frame may take several), saving, and some for the panel's going: not one a
        // sixtieth of a second.
        let frames = stats["view"]["frames"].as_u64().unwrap();
        assert!(frames < 40, "{frames} frames in three seconds of rest");
        assert!(stats["view"]["relit_frames"].as_u64().unwrap() >= 2, "{stats}");
    }
    let own = command::Run::of(command::relume().args(["rig", scene.to_str().unwrap(), "-o", &rig])).done();
    drop(own);
    assert_eq!(poses[0], poses[1]);
    assert_ne!(poses[0].lights[0].position, Rig::load(Path::new(&rig)).unwrap().lights[0].position);
}

#[test]
fn without_a_display_one_line_tells_what_to_do_instead() {
    let mut command = command::relume();
    command.args(["view", scene("balls-2.glb").to_str().unwrap()]);
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command::Run::of(&mut command).failed(&["cannot open a window", "relume render"]);
    let mut command = command::relume();
    command
        .args(["view", scene("balls-2.glb").to_str().unwrap()])
        .env("DISPLAY", ":7777")
        .env_remove("WAYLAND_DISPLAY");
    command::Run::of(&mut command).failed(&["cannot open a window"]);
}

#[test]
fn a_scene_that_does_not_load_ends_the_window_with_its_error() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let broken = folder.path().join("broken.glb");
    std::fs::write(&broken, b"glTF").unwrap();
    let output = desktop.output(&["view", broken.to_str().unwrap()]);
    command::Run::from(output).failed(&["broken.glb"]);
    let script = folder.path().join("wrong.script");
    std::fs::write(&script, "0.1 dance\n").unwrap();
    let output =
        desktop.output(&["view", scene("balls-2.glb").to_str().unwrap(), "--script", script.to_str().unwrap()]);
    command::Run::from(output).failed(&["wrong.script", "line 1", "dance"]);
}

/// Images of many lights are made over several frames, between which the window answers.
#[test]
fn many_lights_come_one_after_another() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (scene, rig_path) = (scene("balls-2.glb"), folder.path().join("many.toml"));
    let trace = folder.path().join("trace.json");
    command::Run::of(command::relume().arg("rig").arg(&scene).arg("-o").arg(&rig_path)).done();
    let mut rig = Rig::load(&rig_path).unwrap();
    for number in 0..500 {
        let mut light = rig.lights[number % 2].clone();
        light.name = format!("copy {number}");
        light.position.y += 0.01 * number as f64;
        light.intensity *= 0.01;
        rig.lights.push(light);
    }
    rig.save(&rig_path).unwrap();
    let settings = ["--rig", rig_path.to_str().unwrap(), "--size", "360x240", "--gi", "off", "--samples", "1"];
    let headless = render_with(&scene, &settings, &folder.path().join("many.png"));

    let arguments = ["view", scene.to_str().unwrap(), "--trace", trace.to_str().unwrap()];
    let mut window = desktop.relume(&[&arguments[..], &settings].concat());
    window.wait_for_window();
    window.key("F2", "stops");
    window.key("1", "picture 1:1");
    let started = Instant::now();
    while difference(&cut(&window.screenshot(), [360, 240]), &headless) > 1e-3 {
        assert!(started.elapsed().as_secs() < 60, "the picture does not become that of all lights");
    }
    window.keys(&["ctrl+q"]);
    window.ends_silently();
    let trace: serde_json::Value = serde_json::from_slice(&std::fs::read(&trace).unwrap()).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    let passes: Vec<_> = events.iter().filter_map(|event| event["name"].as_str()).collect();
    let shading = passes.split(|name| *name == "composite").filter(|frame| frame.contains(&"shade light")).count();
    assert!(shading >= 3, "{shading} frames shade lights");
}

/// Once the lights rest, indirect light is gathered until the error is as asked. What is known of a light stays.
#[test]
fn at_rest_the_picture_becomes_right() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (scene, size) = (scene_in(folder.path(), "cornell-glossy.glb"), [64, 64]);
    let stats = folder.path().join("stats.json");
    let mut arguments = vec!["view", scene.to_str().unwrap(), "--size", "64x64", "--exposure", "0", "--no-cache"];
    arguments.extend(["--gi", "glossy", "--gather", "200", "--rays", "16"]);
    let shown = |more: &[&str]| {
        let mut window = desktop.relume(&[&arguments, more].concat());
        window.wait_for_window();
        window.key("F2", "stops");
        window.key("1", "picture 1:1");
        window
    };
    let window = shown(&["--final", "off"]);
    let rough = cut(&window.screenshot(), size);
    window.keys(&["ctrl+q"]);
    window.ends_silently();

    let window = shown(&["--final", "6%", "--stats", stats.to_str().unwrap()]);
    window.wait_for_title("expected error");
    let gathered = cut(&window.screenshot(), size);
    let [a, b] = ["a", "b"].map(|half| {
        let truth = exr::read(&command::shipped(&format!("truth/cornell-glossy-64.{half}.exr"))).unwrap();
        truth.layer("beauty").unwrap().pixels.clone()
    });
    let mean = a.iter().zip(&b).map(|(a, b)| [0, 1, 2].map(|c| 0.5 * (a[c] + b[c])));
    let truth: Vec<[u8; 3]> = ToneMap::Agx.display8(mean.collect());
    let [before, after] = [&rough, &gathered].map(|picture| difference(picture, &truth));
    println!("{before} levels off before it rests, {after} after");
    assert!(after < 0.5 * before, "{after} levels off, {before} before");

    for (key, says) in [("comma", "colour"), ("d", "moved"), ("m", "off")] {
        window.key(key, says);
        let edited = cut(&window.screenshot(), size);
        assert!(difference(&edited, &gathered) > 0.05, "the edit shows");
        window.key("ctrl+z", "undone");
        assert_eq!(difference(&cut(&window.screenshot(), size), &gathered), 0.0, "undone, bit for bit");
    }
    window.keys(&["ctrl+q"]);
    window.ends_silently();
    let stats: serde_json::Value = serde_json::from_slice(&std::fs::read(stats).unwrap()).unwrap();
    let gathering = &stats["view"]["final"];
    assert!(gathering["expected_error"].as_f64().unwrap() <= 0.06 && gathering["goes_on"] == false, "{gathering}");
}

#[test]
fn another_camera_of_the_scene_is_a_key_away() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scene = command::with_second_camera("balls-2.glb", "left", [-1.5, 1.6, 4.0], &path("balls.glb"));
    let (scene_text, rig) = (scene.to_str().unwrap(), path("balls.toml"));
    let rig_text = rig.to_str().unwrap();
    command::Run::of(command::relume().args(["rig", scene_text, "-o", rig_text])).done();
    let size = [360, 240];
    let mut window = desktop.relume(&["view", scene_text, "--rig", rig_text, "--exposure", "0.5", "--size", "360x240"]);
    window.wait_for_window();
    window.key("F2", "stops");
    window.key("1", "picture 1:1");
    let first = cut(&window.screenshot(), size);
    window.key("plus", "+0.5 stop");
    window.key("ctrl+s", "saved");
    let edited = cut(&window.screenshot(), size);
    window.key("ctrl+Next", "camera left");
    window.key("Tab", "2 of 2");
    let headless = |camera: &str| {
        let arguments = ["--exposure", "0.5", "--size", "360x240", "--rig", rig_text, "--camera", camera];
        render_with(&scene, &arguments, &path("headless.png"))
    };
    assert_eq!(difference(&cut(&window.screenshot(), size), &headless("left")), 0.0, "with the edited lights");
    window.key("ctrl+Next", "camera camera");
    window.key("ctrl+z", "undone");
    assert_eq!(difference(&cut(&window.screenshot(), size), &first), 0.0, "edits before the change can be undone");
    window.key("ctrl+y", "+0.5 stop");
    // Two changes in a row: the first one's bake ends.
    window.keys(&["ctrl+Prior", "ctrl+Prior"]);
    window.key("Tab", "of 2");
    assert_eq!(difference(&cut(&window.screenshot(), size), &edited), 0.0);
    window.keys(&["ctrl+q"]);
    window.ends_silently();
}

#[test]
fn all_cameras_follow_a_light() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scene = command::with_second_camera("balls-2.glb", "left", [-1.5, 1.6, 4.0], &path("balls.glb"));
    let (scene_text, rig) = (scene.to_str().unwrap(), path("balls.toml"));
    let rig_text = rig.to_str().unwrap();
    command::Run::of(command::relume().args(["rig", scene_text, "-o", rig_text])).done();
    let name = Rig::load(&rig).unwrap().lights[0].name.clone();
    let text = std::fs::read_to_string(&rig).unwrap();
    let shot = format!("\n[[shot]]\ncamera = \"left\"\n\n[[shot.light]]\nname = \"{name}\"\ncolor = [1.0, 0.0, 0.0]\n");
    std::fs::write(&rig, text + &shot).unwrap();
    let size = [360, 240];
    let mut window = desktop.relume(&["view", scene_text, "--rig", rig_text, "--exposure", "0.5", "--size", "360x240"]);
    window.wait_for_window();
    window.key("F2", "stops");
    window.key("1", "picture 1:1");
    window.key("shift+F10", "picture 1:1");
    // The sheet has baked for the other camera once its picture shows an edit.
    let headless = |camera: &str| {
        let arguments = ["--exposure", "0.5", "--size", "360x240", "--rig", rig_text, "--camera", camera];
        render_with(&scene, &arguments, &path("headless.png"))
    };
    let reddish = |pixels: &[[u8; 3]]| pixels.iter().filter(|p| p[0] > 60 && p[0] > 2 * p[1].max(1)).count();
    let begun = std::time::Instant::now();
    while reddish(&window.screenshot().rgb) < 1000 {
        assert!(begun.elapsed().as_secs() < 120, "no picture of the other camera");
        std::thread::sleep(std::time::Duration::from_millis(200));
    }
    let before = reddish(&window.screenshot().rgb);
    window.key("m", "off");
    let begun = std::time::Instant::now();
    while 2 * reddish(&window.screenshot().rgb) > before {
        assert!(begun.elapsed().as_secs() < 60, "the other camera's picture does not follow");
        std::thread::sleep(std::time::Duration::from_millis(200));
    }
    window.key("ctrl+z", "undone");
    window.key("plus", "+0.5 stop");
    window.key("ctrl+s", "saved");
    window.keys(&["Escape"]);
    window.key("ctrl+Next", "camera left");
    window.key("Tab", "2 of 2");
    assert_eq!(difference(&cut(&window.screenshot(), size), &headless("left")), 0.0, "with the colour of its shot");
    window.key("ctrl+Next", "camera camera");
    window.key("Tab", "of 2");
    assert_eq!(difference(&cut(&window.screenshot(), size), &headless("camera")), 0.0);
    window.keys(&["ctrl+q"]);
    window.ends_silently();
    let saved = Rig::load(&rig).unwrap();
    assert_eq!((saved.shots.len(), saved.lights[0].stops), (1, 0.5));
}
