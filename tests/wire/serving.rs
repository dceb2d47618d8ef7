//! `relume serve`: edits, pictures and events.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};

use crate::client::{Client, Serve};
use crate::command::relume;

fn balls() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/balls-2.glb")
}

#[test]
fn every_client_is_told_what_the_others_edit() {
    let serve = Serve::start(&balls(), "32x24");
    let (mut one, opened) = Client::opened(&serve.file, "one");
    let (mut two, _) = Client::opened(&serve.file, "two");
    assert_eq!((&opened["size"], &opened["version"]), (&json!([32, 24]), &json!(0)));
    let answer = one.edit(json!({ "point0": { "position": [0.5, 2, 1], "kelvin": 3200, "stops": 1.5 } })).unwrap();
    let told = two.wait("edited");
    assert_eq!((&told["by"], &told["version"]), (&json!("one"), &answer["version"]));
    let change = &told["rig"]["lights"]["point0"];
    assert_eq!((&change["position"], &change["stops"]), (&json!([0.5, 2.0, 1.0]), &json!(1.5)));
    assert!(change["color"].is_array(), "{change}");
    // The author is told what it has not asked for: the colour of its kelvin.
    let told = one.wait("edited");
    assert_eq!(told["rig"], json!({ "lights": { "point0": { "color": change["color"] } } }));
    assert_eq!(one.rig(), two.rig());

    // New, in a new group, renamed, followed, deleted.
    let groups = json!({ "warm": { "stops": -1 } });
    let lights = json!({ "Area.001": { "kind": "rect", "position": [0, 3, 0], "direction": [0, -2, 0], "width": 1,
        "height": 0.5, "watt": 100, "group": "warm" } });
    one.ask(json!({ "do": "edit", "rig": { "groups": groups, "lights": lights } })).unwrap();
    one.edit(json!({ "Area.001": { "name": "softbox" }, "spot1": { "follows": "softbox" } })).unwrap();
    let softbox = &two.rig()["lights"]["softbox"];
    assert_eq!((&softbox["direction"], &softbox["group"]), (&json!([0.0, -1.0, 0.0]), &json!("warm")));
    let before = two.rig()["lights"]["spot1"]["position"][1].as_f64().unwrap();
    one.edit(json!({ "softbox": { "position": [0, 2, 0] } })).unwrap();
    let after = two.rig()["lights"]["spot1"]["position"][1].as_f64().unwrap();
    assert!((before - 1.0 - after).abs() < 1e-12, "{before} {after}");
    two.edit(json!({ "softbox": null })).unwrap();
    assert!(one.rig()["lights"]["softbox"].is_null() && one.rig()["lights"]["spot1"]["follows"].is_null());
    for _ in 0..5 {
        two.ask(json!({ "do": "undo" })).unwrap();
    }
    assert_eq!(one.rig(), opened["rig"]);
    assert_eq!(two.ask(json!({ "do": "undo" })), Err("nothing to undo".into()));
}

#[test]
fn edits_of_one_gesture_are_undone_together() {
    let serve = Serve::start(&balls(), "32x24");
    let (mut client, opened) = Client::opened(&serve.file, "");
    let mut drag = |x: f64, gesture: Value| {
        let rig = json!({ "lights": { "point0": { "position": [x, 2, 0] } } });
        client.ask(json!({ "do": "edit", "rig": rig, "gesture": gesture })).unwrap();
    };
    for (x, gesture) in [(0.1, "a"), (0.2, "a"), (0.3, "a"), (0.4, "b"), (0.5, "b")] {
        drag(x, gesture.into());
    }
    drag(0.6, Value::Null);
    drag(0.7, Value::Null);
    let mut x = || {
        client.ask(json!({ "do": "undo" })).unwrap();
        client.rig()["lights"]["point0"]["position"][0].as_f64().unwrap()
    };
    assert_eq!([x(), x(), x()], [0.6, 0.5, 0.3]);
    client.ask(json!({ "do": "undo" })).unwrap();
    assert_eq!(client.rig(), opened["rig"]);
}

#[test]
fn wrong_edits_change_nothing_and_say_why() {
    let serve = Serve::start(&balls(), "32x24");
    let (mut client, opened) = Client::opened(&serve.file, "");
    let emitters = json!({ "lamp": { "kind": "emitter", "material": "nothing" } });
    for (rig, reason) in [
        (json!({ "lights": { "point0": { "rnage": null } } }), "light \"point0\": unknown field `rnage`"),
        (json!({ "lights": { "point0": { "radius": -1 } } }), "light \"point0\": radius is -1"),
        (json!({ "lights": { "point0": { "colour": [1, 1, 1] } } }), "light \"point0\": unknown field `colour`"),
        (
            json!({ "lights": { "point0": { "watt": 1, "lumen": 1 } } }),
            "light \"point0\": watt and lumen are both given",
        ),
        (json!({ "lights": { "point0": { "intensity": 1e308, "stops": 100 } } }), "must be finite"),
        (json!({ "lights": { "point0": { "position": "here" } } }), "light \"point0\""),
        (json!({ "lights": { "point0": { "group": "none" } } }), "light \"point0\": there is no group \"none\""),
        (json!({ "lights": { "point0": { "follows": "point0" } } }), "cycle"),
        (json!({ "lights": { "point0": { "name": "spot1" } } }), "another light has this name"),
        (json!({ "lights": { "point0": { "only": ["Sofa"] } } }), "no node or material \"Sofa\""),
        (json!({ "lights": { "point0": { "ies": "/no/such.ies" } } }), "/no/such.ies"),
        (json!({ "lights": { "point0": 3 } }), "light \"point0\": expected an object"),
        (json!({ "lights": { "nobody": null } }), "light \"nobody\": there is no such light"),
        (json!({ "lights": { "new": { "kind": "point" } } }), "light \"new\": a point light needs a position"),
        (json!({ "lights": emitters }), "nothing in the scene emits light"),
        (json!({ "lights": { "point0": { "stops": 1 }, "spot1": { "stops": 1e9 } } }), "light \"spot1\""),
        (json!({ "groups": { "g": { "stops": "x" } } }), "group \"g\""),
        (json!({ "sets": { "s": [1] } }), "set \"s\""),
        (json!({ "lamps": {} }), "unknown list \"lamps\""),
        (json!({ "lights": [] }), "lights must be an object"),
    ] {
        let error = client.ask(json!({ "do": "edit", "rig": rig })).unwrap_err();
        assert!(error.contains(reason) && !error.contains('\n'), "{rig}: {error}");
    }
    assert_eq!(client.rig(), opened["rig"]);
    assert_eq!(client.ask(json!({ "do": "undo" })), Err("nothing to undo".into()));
}

#[test]
fn pictures_follow_the_lights() {
    let serve = Serve::start(&balls(), "32x24");
    let (mut client, _) = Client::opened(&serve.file, "");
    let picture = |client: &mut Client, format: &str| {
        let answer = client.ask(json!({ "do": "picture", "format": format })).unwrap();
        assert_eq!(answer["picture"]["size"], json!([32, 24]));
        BASE64_STANDARD.decode(answer["picture"]["data"].as_str().unwrap()).unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    let exr = |bytes: Vec<u8>| {
        let path = folder.path().join("picture.exr");
        std::fs::write(&path, bytes).unwrap();
        relume::image::exr::read(&path).unwrap().layers[0].pixels.clone()
    };
    let before = exr(picture(&mut client, "exr"));
    let shown = picture(&mut client, "rgba8");
    assert_eq!(shown.len(), 4 * 32 * 24);
    client.edit(json!({ "point0": { "stops": 1 }, "spot1": { "stops": 1 } })).unwrap();
    let after = exr(picture(&mut client, "exr"));
    assert!(before.iter().zip(&after).all(|(b, a)| (0..3).all(|c| (2.0 * b[c] - a[c]).abs() <= 1e-6 * a[c])));
    assert_ne!(picture(&mut client, "rgba8"), shown);
    let png = folder.path().join("picture.png");
    std::fs::write(&png, picture(&mut client, "png")).unwrap();
    let png = relume::image::png::read(&png).unwrap();
    assert_eq!(png.rgba.as_flattened(), picture(&mut client, "rgba8"));
}

/// A scene whose file changes is loaded again; one that does not fit the lights, or is broken, leaves all as it was.
#[test]
fn a_changed_scene_is_loaded_again_and_its_lights_stay() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    std::fs::copy(balls(), &path).unwrap();
    let serve = Serve::start(&path, "32x24");
    let (mut client, opened) = Client::opened(&serve.file, "");
    client.edit(json!({ "point0": { "position": [0.5, 3, 1] } })).unwrap();
    let lights = client.rig();
    let pixels = |client: &mut Client| {
        client.ask(json!({ "do": "picture", "format": "rgba8" })).unwrap()["picture"]["data"].take()
    };
    let before = pixels(&mut client);

    std::fs::write(&path, b"glTF, but not really").unwrap();
    client.ask(json!({ "do": "reload" })).unwrap();
    let failed = client.wait("failed");
    assert!(failed["message"].as_str().unwrap().contains("scene.glb"), "{failed}");
    assert_eq!((pixels(&mut client), client.rig()), (before.clone(), lights.clone()));

    let other = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell-glossy.glb");
    std::fs::copy(other, &path).unwrap();
    client.ask(json!({ "do": "reload" })).unwrap();
    let reopened = client.wait("opened");
    assert_eq!(reopened["rig"]["lights"]["point0"]["position"], json!([0.5, 3.0, 1.0]));
    assert_ne!(reopened["version"], opened["version"]);
    assert_ne!(pixels(&mut client), before);
    client.ask(json!({ "do": "undo" })).unwrap();
    client.ask(json!({ "do": "undo" })).unwrap();
}

#[test]
fn one_program_speaks_on_standard_streams() {
    let mut command = relume();
    command.args(["serve", "--size", "32x24", "--gi", "off", "--no-cache", "--quiet"]).arg(balls());
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(|line| line.unwrap());
    let mut wait = |member: &str| -> Value {
        let values = lines.by_ref().map(|line| serde_json::from_str::<Value>(&line).unwrap());
        values.into_iter().find(|value| value.get(member).is_some()).unwrap()
    };
    assert_eq!(wait("protocol")["protocol"], 1);
    assert!(wait("rig")["rig"]["lights"]["spot1"].is_object());
    let mut input = child.stdin.take().unwrap();
    writeln!(input, "{}", json!({ "do": "picture", "id": 5 })).unwrap();
    assert_eq!(wait("picture")["id"], 5);
    drop(input);
    assert!(child.wait().unwrap().success());
}

#[test]
fn the_reference_client_speaks_the_protocol() {
    let serve = Serve::start(&balls(), "32x24");
    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/relume_client.py");
    let edit = r#"{"do": "edit", "rig": {"lights": {"point0": {"stops": 2}}}}"#;
    let run =
        |requests: &[&str]| Command::new("python3").arg(&client).arg(&serve.file).args(requests).output().unwrap();
    let said = run(&[edit, r#"{"do": "rig"}"#]);
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    assert!(String::from_utf8_lossy(&said.stdout).contains("\"stops\": 2.0"));
    let said = run(&[r#"{"do": "edit", "rig": {"lights": {"point0": {"radius": -1}}}}"#]);
    assert!(String::from_utf8_lossy(&said.stderr).contains("Refused: light \"point0\": radius is -1"));
}
