//! The real window: a person edits in it, a program edits through the wire, and both see the same.

use std::path::Path;

use serde_json::{Value, json};

use crate::client::Client;
use crate::desktop::Desktop;

#[test]
fn a_person_and_a_program_edit_the_same_lights() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("balls-2.glb");
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/balls-2.glb"), &scene).unwrap();
    let file = folder.path().join("connection.json");
    let [scene, file] = [&scene, &file].map(|path| path.to_str().unwrap());
    let mut app = desktop.relume(&["view", scene, "--size", "360x240", "--listen", file]);
    app.wait_for_window();
    let (mut client, opened) = Client::opened(file.as_ref(), "Blender");

    // The person's edit reaches the program.
    app.key("equal", "+0.5 stop");
    let told = client.wait("edited");
    assert_eq!((&told["by"], &told["rig"]["lights"]["point0"]), (&Value::Null, &json!({ "stops": 0.5 })));
    // The program's edit reaches the screen.
    let before = app.screenshot();
    let answer = client.edit(json!({ "point0": { "position": [1, 3, 2] } })).unwrap();
    client.wait_for(|event| event["event"] == "shown" && event["version"] == answer["version"]);
    app.wait_for_title("point0: moved");
    assert!(app.screenshot() != before);
    // Each undoes what the other did.
    app.key("ctrl+z", "undone: point0: moved");
    assert_eq!(
        client.wait("edited")["rig"]["lights"]["point0"]["position"],
        opened["rig"]["lights"]["point0"]["position"]
    );
    client.ask(json!({ "do": "undo" })).unwrap();
    assert_eq!(client.rig(), opened["rig"]);
    app.wait_for_title("undone: point0: +0.5 stop");
    // The scene is loaded again while the window stays, and works.
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell-glossy.glb"), scene).unwrap();
    let before = app.screenshot();
    client.ask(json!({ "do": "reload" })).unwrap();
    let version = client.wait("opened")["version"].clone();
    client.wait_for(|event| event["event"] == "shown" && event["version"] == version);
    app.wait_for_title("loaded again");
    assert!(app.screenshot() != before);
    app.key("equal", "+0.5 stop");
    // A program that goes leaves the window alone.
    drop(client);
    app.key("minus", "-0.5 stop");
    app.quits_unsaved();
}
