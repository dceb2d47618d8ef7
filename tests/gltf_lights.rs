//! `EXT_lights_area`, `EXT_lights_ies` and `EXT_lights_image_based`: what other programs write is read, and rigs are
//! written for other programs and read back.

mod support;

use std::f64::consts::PI;
use std::path::Path;

use glam::{DQuat, DVec3, Vec3};
use relume::scene::light_filter::{BarnDoors, PosedFilter};
use relume::scene::{Light, LightFilter, LightGroup, LightKind, LightUnit, Rig, RigFiles, Scene, export_gltf};
use serde_json::{Value, json};
use support::{Gltf, png, write};

/// 250 cd ahead, 200 cd at 45 degrees towards the horizontal angle 0, less elsewhere.
const LAMP: &str = "TILT=NONE\n1 -1 1 3 4 1 2 0 0 0 1 1 9 0 45 90 0 90 180 270\n250 200 1 250 20 1 250 40 1 250 80 1\n";
/// The same of type B: 60 cd at a vertical angle of 45 degrees, 30 cd at a horizontal one.
const FLOODLIGHT: &str = "TILT=NONE\n1 -1 1 3 3 2 2 0 0 0 1 1 9 -45 0 45 -45 0 45\n1 2 3 4 100 60 5 30 6\n";

fn load(gltf: &Gltf, folder: &Path) -> Rig {
    Scene::load(&gltf.write(folder, "scene.glb")).unwrap().rig
}

fn assert_near(got: DVec3, want: DVec3) {
    assert!(got.distance(want) <= 1e-12 * (1.0 + want.length()), "{got} is not {want}");
}

/// The example of the extension, under a node that turns and scales it.
#[test]
fn area_lights_of_other_programs_are_read() {
    let mut gltf = Gltf::square();
    let rect = json!({"color": [1.0, 0.5, 0.25], "intensity": 300.0, "type": "rect", "size": 0.5,
        "rect": {"aspect": 2.0}, "name": "window"});
    gltf.light_of("EXT_lights_area", rect);
    gltf.light_of("EXT_lights_area", json!({"type": "disk", "size": 1.2}));
    gltf.light_of("EXT_lights_area", json!({"type": "rect"}));
    let light = |index: usize| json!({ "EXT_lights_area": { "light": index } });
    // -z becomes -x, and y becomes z.
    let turn = DQuat::from_rotation_y(PI / 2.0) * DQuat::from_rotation_z(PI / 2.0);
    let turned = gltf.node(json!({"extensions": light(0), "rotation": turn.to_array(), "scale": [0.5, -2.0, 1.0]}));
    gltf.root(json!({"children": [turned], "translation": [1.0, 2.0, 3.0], "scale": [3.0, 3.0, 3.0]}));
    gltf.root(json!({"name": "ceiling", "extensions": light(1)}));
    gltf.root(json!({"extensions": light(2)}));
    gltf.json["extensionsRequired"] = json!(["EXT_lights_area"]);
    let folder = tempfile::tempdir().unwrap();
    let rig = load(&gltf, folder.path());
    let [ceiling, plain, window] = ["ceiling", "light2", "window"].map(|name| {
        let found = rig.lights.iter().find(|light| light.name == name);
        found.unwrap_or_else(|| panic!("{name} of {:?}", rig.lights))
    });

    assert_eq!((window.kind, window.color), (LightKind::Rect, Vec3::new(1.0, 0.5, 0.25)));
    assert_near(window.position, DVec3::new(1.0, 2.0, 3.0));
    assert_near(window.direction, DVec3::NEG_X);
    // Of the node's scale the largest component counts, times that of its parent.
    assert_near(DVec3::from((window.size[0], window.size[1], 0.0)), DVec3::new(6.0, 3.0, 0.0));
    let [along_width, along_height] = window.axes();
    assert!(along_height.y.abs() < 1e-12 && along_width.x.abs() < 1e-12, "{along_width} {along_height}");
    assert!((window.intensity / (300.0 * 18.0) - 1.0).abs() < 1e-12);
    let lumens = window.intensity * window.per_intensity(LightUnit::Lumen).unwrap();
    assert!((lumens / (300.0 * 18.0 * PI) - 1.0).abs() < 1e-12, "flux = intensity * area * pi");
    assert!(!window.two_sided && window.spread == PI);

    assert_eq!((ceiling.kind, ceiling.radius), (LightKind::Disk, 0.6));
    assert_eq!(ceiling.direction, DVec3::NEG_Z);
    assert!((ceiling.intensity / (1000.0 * PI * 0.36) - 1.0).abs() < 1e-12);
    assert_eq!((plain.size, plain.up, plain.intensity), ([1.0, 1.0], DVec3::Y, 1000.0));
}

/// Factor of the light's filter in a world direction, times its intensity.
fn candela(light: &Light, direction: DVec3) -> f32 {
    PosedFilter::new(light).unwrap().factor(direction.normalize().as_vec3()).x * light.intensity as f32
}

/// As a file, a `data:` URI and a buffer view; turned, scaled, tinted.
#[test]
fn profiles_of_other_programs_are_read() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("my lamps")).unwrap();
    write(folder.path(), "my lamps/lamp.ies", LAMP.as_bytes());
    let mut gltf = Gltf::square();
    let view = gltf.view(LAMP.as_bytes());
    let data = format!("data:application/x-ies-lm-63,{}", FLOODLIGHT.replace('\n', "%0A").replace(' ', "%20"));
    gltf.light_of("EXT_lights_ies", json!({"uri": "my%20lamps/lamp.ies"}));
    gltf.light_of("EXT_lights_ies", json!({"bufferView": view, "mimeType": "application/x-ies-lm-63", "name": "down"}));
    gltf.light_of("EXT_lights_ies", json!({"uri": data, "name": "flood"}));
    let instance = |index: usize| json!({ "EXT_lights_ies": { "light": index } });
    gltf.root(json!({"name": "file", "extensions": instance(0)}));
    let bright = json!({"EXT_lights_ies": {"light": 1, "multiplier": 2.0, "color": [1.0, 0.5, 0.25]}});
    // -z becomes -y, and y becomes -z.
    let down = DQuat::from_rotation_x(-PI / 2.0).to_array();
    gltf.root(
        json!({"extensions": bright, "rotation": down, "translation": [1.0, 2.0, 3.0], "scale": [5.0, 5.0, 5.0]}),
    );
    gltf.root(json!({"extensions": instance(2)}));
    let rig = load(&gltf, folder.path());
    let [file, down, flood] = ["file", "down", "flood"]
        .map(|name| rig.lights.iter().find(|light| light.name == name).unwrap_or_else(|| panic!("{name}")));

    let near = |light: &Light, direction: [f64; 3], want: f32| {
        let got = candela(light, DVec3::from(direction));
        assert!((got - want).abs() < 1e-3, "{}: {got} cd, not {want}", light.name);
    };
    assert_eq!((file.kind, file.radius, file.intensity), (LightKind::Point, 0.0, 250.0));
    // The horizontal angle 0 is +x of the node, 90 degrees +y.
    for (direction, want) in
        [([0.0, 0.0, -1.0], 250.0), ([1.0, 0.0, -1.0], 200.0), ([0.0, 1.0, -1.0], 20.0), ([-1.0, 0.0, -1.0], 40.0)]
    {
        near(file, direction, want);
    }
    assert_eq!((down.position, down.color), (DVec3::new(1.0, 2.0, 3.0), Vec3::new(1.0, 0.5, 0.25)));
    for (direction, want) in [([0.0, -1.0, 0.0], 500.0), ([1.0, -1.0, 0.0], 400.0), ([0.0, -1.0, -1.0], 40.0)] {
        near(down, direction, want);
    }
    // The vertical plane of a profile is the plane of x and z.
    for (direction, want) in [([0.0, 0.0, -1.0], 100.0), ([1.0, 0.0, -1.0], 60.0), ([0.0, -1.0, -1.0], 30.0)] {
        near(flood, direction, want);
    }
    // A rig names a profile that has no file of its own by the scene and its index.
    let text = rig.to_toml(folder.path());
    assert!(text.contains("ies = \"my lamps/lamp.ies\"") && text.contains("ies = \"scene.glb#2\""), "{text}");
    assert_eq!(Rig::from_toml(&text, RigFiles::new(folder.path())).unwrap(), rig);
    let wrong = text.replace("scene.glb#2", "scene.glb#7");
    let reason = Rig::from_toml(&wrong, RigFiles::new(folder.path())).unwrap_err();
    assert!(reason.contains("scene.glb") && reason.contains("IES light 7"), "{reason}");
    let wrong = text.replace("scene.glb#2", "none.glb#2");
    assert!(Rig::from_toml(&wrong, RigFiles::new(folder.path())).unwrap_err().contains("none.glb"));
}

/// Writes a rig into a copy of `gltf` and reads it back; `change` is what another program does to the JSON meanwhile.
fn export(gltf: &Gltf, rig: &Rig, folder: &Path, name: &str, change: impl FnOnce(&mut Value)) -> Rig {
    let scene = Scene::load(&gltf.write(folder, "source.glb")).unwrap();
    let out = folder.join(name);
    export_gltf(&scene, rig, &out).unwrap();
    if name.ends_with(".gltf") {
        let mut json: Value = serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap();
        change(&mut json);
        std::fs::write(&out, json.to_string()).unwrap();
    }
    Scene::load(&out).unwrap().rig
}

fn without_exact_rig(json: &mut Value) {
    json["scenes"][0]["extras"].as_object_mut().unwrap().remove("relume_rig").unwrap();
}

fn filters(folder: &Path) -> Vec<LightFilter> {
    write(folder, "lamp.ies", LAMP.as_bytes());
    write(folder, "flood.ies", FLOODLIGHT.as_bytes());
    write(folder, "leaves.png", &png(2, 2, &[[1, 2, 3, 255], [40, 50, 60, 255], [7, 8, 9, 128], [255, 255, 255, 255]]));
    let gobo = "[[light]]\nname = \"a\"\nkind = \"spot\"\nposition = [0, 0, 0]\ndirection = [0, 0, -1]\n\
        gobo = { image = \"leaves.png\", rotate_deg = 33.3, scale = 0.7, tint = [1, 0.3, 0.1] }\n";
    let gobo = Rig::from_toml(gobo, RigFiles::new(folder)).unwrap().lights[0].filter.gobo.clone();
    let mut files = RigFiles::new(folder);
    let [lamp, flood] = ["lamp.ies", "flood.ies"].map(|name| Some(files.profile(name).unwrap()));
    let angles = [10f64, 20.0, 30.0, 40.0].map(f64::to_radians);
    let doors = Some(BarnDoors { angles, softness: 5f64.to_radians() });
    let none = LightFilter::default();
    vec![
        none.clone(),
        LightFilter { ies: lamp.clone(), ..none.clone() },
        LightFilter { ies: flood, ..none.clone() },
        LightFilter { gobo: gobo.clone(), ..none.clone() },
        LightFilter { barn_doors: doors, ..none },
        LightFilter { ies: lamp, gobo, barn_doors: doors },
    ]
}

const KINDS: [LightKind; 5] =
    [LightKind::Point, LightKind::Spot, LightKind::Directional, LightKind::Disk, LightKind::Rect];

/// Lights of all kinds with all filters, none with a round number.
fn lights(folder: &Path) -> Vec<Light> {
    let filters = filters(folder);
    let with = |(i, (kind, filter)): (usize, (LightKind, &LightFilter))| {
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.3 + i as f64, 0.7 * i as f64, 0.1);
        Light {
            kind,
            direction: (turn * DVec3::NEG_Z).normalize(),
            up: turn * DVec3::Y,
            color: Vec3::new(0.9, 0.1 * i as f32, 1.7),
            intensity: 100.0 / 3.0,
            stops: 1.0 / 3.0,
            radius: 0.1,
            size: [1.0 / 3.0, 0.7],
            angle: 3f64.to_radians(),
            spread: 77f64.to_radians(),
            two_sided: i % 2 == 0,
            visible: i % 3 == 0,
            decay_start: 0.01,
            filter: filter.clone(),
            ..Light::point(&format!("light {i}"), DVec3::new(0.1, 1.0 / 7.0, i as f64))
        }
    };
    let all = KINDS.into_iter().flat_map(|kind| filters.iter().map(move |filter| (kind, filter)));
    all.enumerate().map(with).collect()
}

#[test]
fn every_kind_with_every_filter_comes_back_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = Rig { lights: lights(folder.path()), ..Rig::default() };
    rig.groups.push(LightGroup { stops: 0.3, color: Vec3::new(0.7, 2.0, 0.9), ..LightGroup::new("rim") });
    rig.lights.iter_mut().step_by(4).for_each(|light| light.group = Some(0));
    rig.lights[3].enabled = false;
    for name in ["out.glb", "out.gltf"] {
        let mut back = export(&Gltf::square(), &rig, folder.path(), name, |_| ());
        assert_eq!(back.lights.len(), rig.lights.len());
        for (light, want) in back.lights.iter_mut().zip(&rig.lights) {
            assert!(light.node.take().is_some());
            let (Some(ies), Some(wanted)) = (&light.filter.ies, &want.filter.ies) else { continue };
            assert_eq!(**ies, **wanted);
            // The profiles of points lie in the scene itself.
            light.filter.ies = want.filter.ies.clone();
        }
        assert_eq!(back, rig);
        // Nothing refers to the folder of the profiles of points any more.
        let moved = tempfile::tempdir().unwrap();
        let points: Vec<Light> = rig.lights[..3].to_vec();
        let points = Rig { lights: points, groups: rig.groups.clone(), ..Rig::default() };
        export(&Gltf::square(), &points, folder.path(), name, |_| ());
        std::fs::copy(folder.path().join(name), moved.path().join(name)).unwrap();
        let back = Scene::load(&moved.path().join(name)).unwrap().rig;
        assert_eq!(back.groups, rig.groups);
        assert_eq!(back.lights[2].filter.ies.as_deref(), rig.lights[2].filter.ies.as_deref());
    }
}

/// Parents that turn, scale, mirror and shear.
fn tilted() -> (Gltf, usize) {
    let mut gltf = Gltf::square();
    for light in [json!({"type": "disk", "size": 2.0}), json!({"type": "rect"})] {
        gltf.light_of("EXT_lights_area", light);
    }
    gltf.light_of("EXT_lights_ies", json!({"uri": "lamp.ies"}));
    let area = |light: usize| json!({ "EXT_lights_area": { "light": light } });
    let children = [
        json!({"name": "disk", "extensions": area(0), "scale": [0.5, 3.0, 1.0]}),
        json!({"name": "rect", "extensions": area(1), "rotation": [0.1, 0.2, 0.3, 0.9], "scale": [-1.0, 1.0, 1.0]}),
        json!({"name": "lamp", "extensions": {"EXT_lights_ies": {"light": 0}}, "translation": [0.5, 1.0, 2.0]}),
    ];
    let children: Vec<usize> = children.into_iter().map(|node| gltf.node(node)).collect();
    let matrix = [2.0, 0.1, 0.0, 0.0, 0.0, -0.5, 0.3, 0.0, 0.2, 0.0, 3.0, 0.0, 7.0, 8.0, 9.0, 1.0];
    let parent = gltf.root(json!({"children": children, "matrix": matrix}));
    (gltf, parent)
}

/// What other programs see of a rig: relume reads it without the exact rig.
#[test]
fn other_programs_see_shapes_and_profiles() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "lamp.ies", LAMP.as_bytes());
    let (gltf, _) = tilted();
    let source = load(&gltf, folder.path());
    assert_eq!(source.lights.iter().map(|light| light.name.as_str()).collect::<Vec<_>>(), ["disk", "rect", "lamp"]);
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 0.7, 1.1);
    let moved = |light: &Light| Light {
        position: light.position + DVec3::ONE,
        direction: turn * light.direction,
        up: turn * DVec3::Z,
        radius: light.radius * 0.3,
        size: [0.2, 0.7],
        ..light.clone()
    };
    let mut changed = source.clone();
    changed.lights = source.lights.iter().map(moved).collect();
    write(folder.path(), "flood.ies", FLOODLIGHT.as_bytes());
    let flood = Some(RigFiles::new(folder.path()).profile("flood.ies").unwrap());
    let filter = LightFilter { ies: flood, ..LightFilter::default() };
    changed.lights.push(Light { filter, name: "flood".into(), ..changed.lights[2].clone() });
    for rig in [&source, &changed] {
        let back = export(&gltf, rig, folder.path(), "out.gltf", without_exact_rig);
        assert_eq!(back.lights.len(), rig.lights.len());
        for want in &rig.lights {
            let got = back.lights.iter().find(|light| light.name == want.name).unwrap();
            let near = |a: DVec3, b: DVec3| assert!(a.distance(b) < 1e-9, "{}: {a} is not {b}", want.name);
            assert_eq!(got.kind, want.kind);
            near(got.position, want.position);
            near(got.direction, want.direction);
            assert!((got.intensity / want.intensity - 1.0).abs() < 1e-9, "{} {}", got.intensity, want.intensity);
            match want.kind {
                LightKind::Disk => assert!((got.radius / want.radius - 1.0).abs() < 1e-9),
                LightKind::Rect => {
                    near(DVec3::from((got.size[0], got.size[1], 0.0)), DVec3::from((want.size[0], want.size[1], 0.0)))
                }
                _ => assert_eq!(got.filter.ies.as_deref(), want.filter.ies.as_deref()),
            }
            if want.kind != LightKind::Disk {
                near(got.axes()[1], want.axes()[1]);
            }
        }
    }
    // A light that has not moved stays in its node as it is.
    export(&gltf, &source, folder.path(), "out.gltf", |json| {
        for node in 1..4 {
            for key in ["scale", "rotation", "translation", "name"] {
                assert_eq!(json["nodes"][node][key], gltf.json["nodes"][node][key]);
            }
        }
        assert_eq!(json["extensionsUsed"], json!(["EXT_lights_area", "EXT_lights_ies"]));
        let disk = &json["extensions"]["EXT_lights_area"]["lights"][0];
        assert!((disk["size"].as_f64().unwrap() - 2.0).abs() < 1e-12, "{disk}");
        assert!((disk["intensity"].as_f64().unwrap() - 1000.0).abs() < 1e-9, "{disk}");
        let uri = json["extensions"]["EXT_lights_ies"]["lights"][0]["uri"].as_str().unwrap();
        assert!(uri.starts_with("data:application/x-ies-lm-63;base64,"), "{uri}");
    });
}

/// As with punctual lights, what the file's nodes say counts.
#[test]
fn edits_of_other_programs_win() {
    let folder = tempfile::tempdir().unwrap();
    let all = lights(folder.path());
    let groups = vec![LightGroup::new("rim")];
    let rig = |index: usize| Rig { lights: vec![all[index].clone()], groups: groups.clone(), ..Rig::default() };
    let (point, disk, rect) = (rig(1), rig(18), rig(24));
    let area = "/extensions/EXT_lights_area/lights/0";
    let node = "/nodes/1/extensions/EXT_lights_ies";
    for (rig, pointer) in [
        (&disk, format!("{area}/size")),
        (&disk, format!("{area}/intensity")),
        (&rect, format!("{area}/size")),
        (&rect, format!("{area}/rect/aspect")),
        (&rect, "/nodes/1/rotation/0".into()),
        (&point, format!("{node}/multiplier")),
        (&point, "/nodes/1/translation/1".into()),
        (&point, "/nodes/1/rotation/0".into()),
    ] {
        let edited = export(&Gltf::square(), rig, folder.path(), "out.gltf", |json| {
            let value = json.pointer_mut(&pointer).unwrap_or_else(|| panic!("{pointer}"));
            *value = json!(value.as_f64().unwrap() * 1.5 + 0.1);
        });
        assert!(edited.groups.is_empty(), "{pointer}");
        let same = export(&Gltf::square(), rig, folder.path(), "out.gltf", |_| ());
        assert_eq!(same.groups.len(), 1, "{pointer}");
    }
}

#[test]
fn other_scenes_keep_their_area_lights_and_profiles() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "lamp.ies", LAMP.as_bytes());
    let (mut gltf, parent) = tilted();
    let nodes = gltf.json["scenes"][0]["nodes"].as_array().unwrap().clone();
    gltf.push("scenes", json!({ "nodes": [parent] }));
    gltf.json["scenes"][0]["nodes"] = nodes.into_iter().filter(|node| *node != json!(parent)).collect();
    let elsewhere = tempfile::tempdir().unwrap();
    let scene = Scene::load(&gltf.write(folder.path(), "source.glb")).unwrap();
    let out = elsewhere.path().join("out.gltf");
    export_gltf(&scene, &Rig::default(), &out).unwrap();
    let mut json: Value = serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap();
    assert_eq!(json["extensions"]["EXT_lights_area"], gltf.json["extensions"]["EXT_lights_area"]);
    json["scene"] = 1.into();
    std::fs::write(&out, json.to_string()).unwrap();
    let back = Scene::load(&out).unwrap().rig;
    assert_eq!(back.lights.len(), 3);
    assert_eq!(back.lights[2].filter.ies.as_ref().unwrap().file, LAMP.as_bytes());
}

/// Faces of one colour each, RGBD; of +z, the upper left quarter of the image is white.
fn faces() -> [Vec<u8>; 6] {
    let colors =
        [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 51], [255, 255, 0, 255], [255, 0, 255, 255], [0, 188, 255, 0]];
    let mut index = 0;
    colors.map(|color| {
        let mut texels = [color; 64];
        if index == 4 {
            (0..4).for_each(|row| texels[8 * row..][..4].fill([255; 4]));
        }
        index += 1;
        png(8, 8, &texels)
    })
}

/// Colours of [`faces`]. A divisor of 0 counts as the smallest, 1 / 255.
const RED: Vec3 = Vec3::new(1.0, 0.0, 0.0);
const GREEN: Vec3 = Vec3::new(0.0, 1.0, 0.0);
const BRIGHT_BLUE: Vec3 = Vec3::new(0.0, 0.0, 5.0);
const YELLOW: Vec3 = Vec3::new(1.0, 1.0, 0.0);
const PURPLE: Vec3 = Vec3::new(1.0, 0.0, 1.0);
const BRIGHT_CYAN: Vec3 = Vec3::new(0.0, 0.502_886 * 255.0, 255.0);

/// A scene with an environment of these faces.
fn with_environment(change: impl FnOnce(&mut Value)) -> Gltf {
    let mut gltf = Gltf::square();
    change(gltf.environment(&faces()));
    gltf
}

#[track_caller]
fn assert_radiance(dome: &Light, from: [f64; 3], want: Vec3) {
    let in_map = dome.turn().inverse() * DVec3::from(from).normalize();
    let got = dome.sky().radiance(in_map.as_vec3());
    assert!(got.distance(want) <= 1e-5 * want.length(), "from {from:?}: {got}, want {want}");
}

#[test]
fn environments_of_other_programs_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut gltf = with_environment(|light| light["intensity"] = json!(2.5));
    gltf.json["extensionsRequired"] = json!(["EXT_lights_image_based"]);
    let rig = load(&gltf, folder.path());
    let [dome] = &rig.lights[..] else { panic!("{:?}", rig.lights) };
    assert_eq!((dome.name.as_str(), dome.kind, dome.intensity), ("environment", LightKind::Dome, 2.5));
    assert_eq!((dome.color, dome.rotation, dome.visible), (Vec3::ONE, 0.0, false));
    // +x of the cube is -x of the scene.
    assert_radiance(dome, [-1.0, 0.0, 0.0], RED);
    assert_radiance(dome, [1.0, 0.0, 0.0], GREEN);
    assert_radiance(dome, [0.0, 1.0, 0.0], BRIGHT_BLUE);
    assert_radiance(dome, [0.0, -1.0, 0.0], YELLOW);
    assert_radiance(dome, [0.0, 0.0, -1.0], BRIGHT_CYAN);
    // Upside down, the upper left of an image is the lower left as seen from the middle: towards +x.
    assert_radiance(dome, [0.5, -0.5, 1.0], Vec3::ONE);
    for other in [[0.5, 0.5, 1.0], [-0.5, 0.5, 1.0], [-0.5, -0.5, 1.0]] {
        assert_radiance(dome, other, PURPLE);
    }

    // A rig names the map by the scene and the light's index.
    let text = rig.to_toml(folder.path());
    assert!(text.contains("map = \"scene.glb#0\""), "{text}");
    assert_eq!(Rig::from_toml(&text, RigFiles::new(folder.path())).unwrap(), rig);
    let wrong = text.replace("scene.glb#0", "scene.glb#7");
    let reason = Rig::from_toml(&wrong, RigFiles::new(folder.path())).unwrap_err();
    assert!(reason.contains("scene.glb") && reason.contains("image-based light 7"), "{reason}");
    // Outside of a scene, nothing is meant by an index alone.
    let wrong = text.replace("scene.glb#0", "#0");
    assert!(Rig::from_toml(&wrong, RigFiles::new(folder.path())).is_err());
}

/// The rotation is one of the cube, whose +x is -x of the scene.
#[test]
fn environments_are_turned() {
    let folder = tempfile::tempdir().unwrap();
    let dome = |rotation: DQuat| {
        let gltf = with_environment(|light| light["rotation"] = json!(rotation.to_array()));
        load(&gltf, folder.path()).lights.remove(0)
    };
    let quarter = PI / 2.0;
    let (about_x, about_y) = (DQuat::from_rotation_x(quarter), DQuat::from_rotation_y(quarter));
    // About the vertical: +z of the cube becomes its +x. The map is as it was.
    for rotation in [about_y, -about_y, about_y * 3.0] {
        let turned = dome(rotation);
        assert!((turned.rotation + quarter).abs() < 1e-12, "{}", turned.rotation);
        assert_radiance(&turned, [-1.0, 0.5, -0.5], PURPLE);
        assert_radiance(&turned, [0.0, 0.0, 1.0], GREEN);
        assert_radiance(&turned, [0.0, 1.0, 0.0], BRIGHT_BLUE);
        assert_radiance(&turned, [-1.0, -0.5, 0.5], Vec3::ONE);
    }
    // About x: +z of the cube becomes its -y, and +y its +z.
    let tilted = dome(about_x);
    assert_eq!(tilted.rotation, 0.0);
    assert_radiance(&tilted, [-0.5, -1.0, 0.5], PURPLE);
    assert_radiance(&tilted, [0.5, -1.0, -0.5], Vec3::ONE);
    assert_radiance(&tilted, [0.0, 0.0, 1.0], BRIGHT_BLUE);
    assert_radiance(&tilted, [-1.0, 0.0, 0.0], RED);
    // First about x, then about the vertical, by which the dome is turned.
    let both = dome(about_y * about_x);
    assert!((both.rotation + quarter).abs() < 1e-12, "{}", both.rotation);
    assert_radiance(&both, [-0.5, -1.0, -0.5], PURPLE);
    assert_radiance(&both, [0.5, -1.0, 0.5], Vec3::ONE);
    assert_radiance(&both, [-1.0, 0.0, 0.0], BRIGHT_BLUE);
    assert_radiance(&both, [0.0, 0.0, -1.0], RED);
    assert_radiance(&dome(DQuat::from_rotation_z(PI)), [1.0, 0.0, 0.0], RED);
}

/// The exact rig has the dome, and the file has its map: neither is read twice, nor lost if the file gets another name.
#[test]
fn environments_are_exported_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut gltf = with_environment(|light| light["name"] = json!("lamp"));
    gltf.light(json!({"type": "point"}));
    gltf.root(json!({"name": "lamp", "extensions": {"KHR_lights_punctual": {"light": 0}}}));
    let source = Scene::load(&gltf.write(folder.path(), "source.glb")).unwrap().rig;
    assert_eq!(source.lights.iter().map(|light| light.name.as_str()).collect::<Vec<_>>(), ["lamp", "lamp_2"]);
    let mut edited = source.clone();
    edited.lights[1] =
        Light { name: "sky".into(), intensity: 3.0, rotation: 40f64.to_radians(), ..edited.lights[1].clone() };
    edited.lights.push(Light { name: "grey".into(), map: None, ..edited.lights[1].clone() });
    let without = Rig { lights: source.lights[..1].to_vec(), ..Rig::default() };
    let elsewhere = tempfile::tempdir().unwrap();
    for (rig, name) in [(&source, "out.glb"), (&edited, "out.glb"), (&edited, "out.gltf"), (&without, "out.glb")] {
        export(&gltf, rig, folder.path(), name, |_| ());
        let moved = elsewhere.path().join(format!("moved-{name}"));
        std::fs::rename(folder.path().join(name), &moved).unwrap();
        let back = Scene::load(&moved).unwrap().rig;
        assert_eq!(back.lights.len(), rig.lights.len());
        for (got, want) in back.lights.iter().zip(&rig.lights) {
            assert_eq!(got.map.is_some(), want.map.is_some());
            assert_eq!(Light { map: None, node: None, ..got.clone() }, Light { map: None, node: None, ..want.clone() });
            if got.map.is_some() {
                assert_radiance(&Light { rotation: 0.0, ..got.clone() }, [-1.0, 0.0, 0.0], RED);
            }
        }
        assert!(rig.lights.len() == 1 || back.to_toml(elsewhere.path()).contains(&format!("map = \"moved-{name}#0\"")));
    }
    // Without the exact rig, the environment is that of the source.
    let plain = export(&gltf, &edited, folder.path(), "out.gltf", without_exact_rig);
    assert_eq!(plain.lights.iter().map(|light| light.kind).collect::<Vec<_>>(), [LightKind::Point, LightKind::Dome]);
    // If another program has removed the map, the exact rig cannot be restored.
    let removed = export(&gltf, &source, folder.path(), "out.gltf", |json| {
        json["extensions"].as_object_mut().unwrap().remove("EXT_lights_image_based");
        json["scenes"][0].as_object_mut().unwrap().remove("extensions");
    });
    assert_eq!(removed.lights.iter().map(|light| light.kind).collect::<Vec<_>>(), [LightKind::Point]);
}
