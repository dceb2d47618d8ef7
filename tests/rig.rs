//! Rig files, and rigs written back into glTF.

mod support;

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3, Vec3};
use proptest::prelude::*;
use relume::Error;
use relume::scene::light_filter::BarnDoors;
use relume::scene::links::MAX_FACTOR;
use relume::scene::rig::RigSnapshot;
use relume::scene::{
    Camera, DomeMap, Light, LightFilter, LightGroup, LightKind, Links, ObjectSet, PhysicalSky, Projection, Rig,
    RigFiles, Scene, export_gltf,
};
use serde_json::{Value, json};
use support::*;

fn parse(text: &str) -> Result<Rig, Error> {
    let folder = tempfile::tempdir().unwrap();
    Rig::load(&write(folder.path(), "rig.toml", text.as_bytes()))
}

/// What a rig file that says `text` is told.
fn refusal(text: &str) -> String {
    let message = parse(text).err().unwrap_or_else(|| panic!("accepted: {text}")).to_string();
    assert!(message.contains("rig.toml") && !message.contains('\n'), "{message}");
    message
}

#[test]
fn the_documented_example() {
    let rig = parse(
        r#"
[camera]
position = [0, 1, 3.6]
target = [0, 1, 0]
up = [0, 1, 0]
yfov_deg = 42.0

[[group]]
name = "rim"
stops = 0.5
color = [1, 1, 1]
enabled = true

[[light]]
name = "key.a"
kind = "spot"
position = [2.8, 3.8, 1.5]
direction = [-0.6, -0.7, -0.3]
color = [1.0, 0.95, 0.9]
intensity = 60.0
stops = 0.0
inner_deg = 18.0
outer_deg = 28.0
range = 10.0
group = "rim"
enabled = true
shadows = true
"#,
    )
    .unwrap();
    let camera = rig.camera.as_ref().unwrap();
    assert_eq!((camera.position, camera.world_from_camera), (DVec3::new(0.0, 1.0, 3.6), DMat3::IDENTITY));
    let light = &rig.lights[0];
    assert_eq!((light.name.as_str(), light.kind, light.group), ("key_a", LightKind::Spot, Some(0)));
    assert!((light.direction.length() - 1.0).abs() < 1e-15);
    assert_eq!((light.inner_angle, light.outer_angle), (18f64.to_radians(), 28f64.to_radians()));
    assert_eq!(parse(&rig.to_toml(Path::new(""))).unwrap(), rig);
}

#[test]
fn defaults() {
    let rig = parse("[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [1, 2, 3]\n").unwrap();
    assert_eq!(rig.lights, [Light::point("a", DVec3::new(1.0, 2.0, 3.0))]);
    assert_eq!(parse("").unwrap(), Rig::default());
}

#[test]
fn colour_temperature() {
    let light = |more: &str| format!("[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [0, 0, 0]\n{more}\n");
    let warm = parse(&light("kelvin = 2700")).unwrap().lights[0].color;
    assert!(warm.x > 1.0 && warm.z < 0.5, "{warm}");
    assert!(refusal(&light("kelvin = 2700\ncolor = [1, 1, 1]")).contains("line 5: light \"a\": color and kelvin"));
    assert!(refusal(&light("tint = 0.1")).contains("tint needs kelvin"));
    assert!(refusal(&light("kelvin = 100")).contains("kelvin is 100"));
}

/// Radiance is intensity over the area that a light shows straight ahead.
#[test]
fn radiance_sets_intensity_and_colour() {
    let read = |kind: &str, size: &str| {
        let text = format!(
            "[[light]]\nname = \"a\"\nkind = \"{kind}\"\nposition = [0, 0, 0]\ndirection = [0, 0, -1]\n{size}\nradiance = [6, 3, 0]\n"
        );
        Rig::from_toml(&text, RigFiles::new(Path::new(""))).unwrap().lights[0].clone()
    };
    let pi = std::f64::consts::PI;
    for (kind, size, area) in [
        ("sphere", "radius = 2", 4.0 * pi),
        ("point", "radius = 2", 4.0 * pi),
        ("disk", "radius = 2", 4.0 * pi),
        ("rect", "width = 2\nheight = 3", 6.0),
        ("sun", "angle_deg = 60", pi / 4.0),
    ] {
        let light = read(kind, size);
        assert!((light.intensity / (6.0 * area) - 1.0).abs() < 1e-12, "{kind}: {}", light.intensity);
        assert_eq!(light.color, Vec3::new(1.0, 0.5, 0.0));
    }
    assert_eq!(read("sphere", "radius = 2").kind, LightKind::Point);
    assert_eq!(read("sun", "angle_deg = 60").kind, LightKind::Directional);
}

#[test]
fn wrong_rigs_name_the_line() {
    let light = "[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [0, 0, 0]\n";
    let spot = "[[light]]\nname = \"a\"\nkind = \"spot\"\nposition = [0, 0, 0]\ndirection = [0, -1, 0]\n";
    for (text, says) in [
        (format!("{light}brightness = 3\n"), "line 5: unknown field `brightness`"),
        ("\n\n[lamp]\n".into(), "line 3: unknown field `lamp`"),
        (format!("{light}radius = -0.1\n"), "line 5: light \"a\": radius is -0.1"),
        (format!("{light}radius = inf\n"), "line 5: light \"a\": radius is inf"),
        (spot.replace("spot", "rect"), "line 3: light \"a\": a rect light needs a width"),
        (spot.replace("spot", "rect") + "width = 1\n", "a rect light needs a height"),
        (spot.replace("spot", "disk"), "a disk light needs a radius"),
        (light.replace("point", "disk") + "radius = 1\n", "a disk light needs a direction"),
        (light.replace("point", "sphere"), "a sphere light needs a radius"),
        (format!("{light}radiance = [1, 1, 1]\n"), "line 5: light \"a\": a light of this kind has no radiance"),
        (format!("{light}radius = 1\nradiance = [1, -1, 1]\n"), "line 6: light \"a\": radiance must be finite"),
        (format!("{light}radius = 1\ncolor = [1, 1, 1]\nradiance = [1, 1, 1]\n"), "radiance and color are both given"),
        (format!("{light}lumen = 800\nintensity = 1\n"), "line 5: light \"a\": lumen and intensity are both given"),
        (format!("{light}watt = 1\nlumen = 8\n"), "line 5: light \"a\": watt and lumen are both given"),
        (
            format!("{light}radius = 1\nnit = 1\nradiance = [1, 1, 1]\n"),
            "line 7: light \"a\": radiance and nit are both",
        ),
        (format!("{light}nit = 1\n"), "line 5: light \"a\": a point light of this size has no nit; use intensity"),
        (format!("{light}lumen = -1\n"), "line 5: light \"a\": lumen is -1"),
        (format!("{light}watt = 1e300\n"), "line 5: light \"a\": color * intensity * 2^stops"),
        (spot.replace("spot", "sun") + "lumen = 1\n", "line 6: light \"a\": a sun light of this size has no lumen"),
        (format!("{spot}spread_deg = 0\n"), "line 6: light \"a\": spread_deg is 0"),
        (format!("{spot}angle_deg = 181\n"), "line 6: light \"a\": angle_deg is 181"),
        (format!("{spot}up = [0, nan, 0]\n"), "line 6: light \"a\": up must be finite"),
        (light.replace("point", "emitter"), "line 3: light \"a\": an emitter needs the name of its material"),
        (light.replace("point", "laser"), "line 3: light \"a\": kind `laser` is unknown"),
        (format!("{light}\n{light}"), "line 7: light \"a\" is defined twice"),
        (format!("{light}\n{}", light.replace("\"a\"", "\"\"")), "the name is empty"),
        (
            format!("{light}{}", light.replace("\"a\"", "\"b.c\"")) + &light.replace("\"a\"", "\"b_c\""),
            "\"b_c\" is defined twice",
        ),
        (format!("{light}group = \"x\"\n"), "line 5: light \"a\": there is no group \"x\""),
        (format!("{light}follows = \"x\"\n"), "line 5: light \"a\": there is no light \"x\" to follow"),
        (format!("{light}follows = \"a\"\n"), "line 5: light \"a\": lights follow each other in a cycle"),
        (format!("{light}intensity = -1\n"), "line 5: light \"a\": intensity is -1"),
        (format!("{light}intensity = nan\n"), "intensity is NaN"),
        (format!("{light}intensity = inf\n"), "intensity is inf"),
        (format!("{light}stops = 1e300\n"), "must be finite"),
        (format!("{light}intensity = 1e20\nstops = 100\n"), "must be finite"),
        (format!("{light}color = [1, -1, 1]\n"), "line 5: light \"a\": color"),
        (format!("{light}color = [1, 1]\n"), "line 5"),
        (format!("{light}range = 0\n"), "line 5: light \"a\": range is 0"),
        (format!("{light}enabled = 1\n"), "line 5"),
        (light.replace("[0, 0, 0]", "[0, inf, 0]"), "line 4: light \"a\": position must be finite"),
        (light.replace("position = [0, 0, 0]\n", ""), "line 3: light \"a\": a point light needs a position"),
        (spot.replace("position = [0, 0, 0]\n", ""), "a spot light needs a position"),
        (spot.replace("direction = [0, -1, 0]\n", ""), "a spot light needs a direction"),
        (spot.replace("spot", "directional").replace("direction = ", "#"), "a directional light needs a direction"),
        (spot.replace("-1", "0"), "line 5: light \"a\": direction must not be of zero length"),
        (format!("{spot}inner_deg = 30\nouter_deg = 20\n"), "line 7: light \"a\": inner_deg is 30, more than"),
        (format!("{spot}outer_deg = 91\n"), "outer_deg is 91"),
        (format!("{spot}visible = 1\n"), "line 6"),
        ("[[group]]\nname = \"g\"\n[[group]]\nname = \"g\"\n".into(), "line 4: group \"g\" is defined twice"),
        ("[[group]]\nname = \"g\"\nstops = nan\n".into(), "line 2: group \"g\""),
        (format!("{light}factor = {{ a = -0.1 }}\n"), "line 5: light \"a\": factor of \"a\" is -0.1, must lie in"),
        (format!("{light}factor = {{ a = 1, b = nan }}\n"), "line 5: light \"a\": factor of \"b\" is NaN"),
        (format!("{light}only = []\n"), "line 5: light \"a\": only is empty"),
        (format!("{light}only = \"a\"\n"), "line 5"),
        ("[[set]]\nname = \"s\"\nitem = []\n".into(), "line 3: unknown field `item`"),
        (
            "[[set]]\nname = \"s\"\nitems = []\n[[set]]\nname = \"s\"\nitems = []\n".into(),
            "line 5: set \"s\" is defined",
        ),
        ("[camera]\nposition = [0, 0, 0]\ntarget = [0, 0, 0]\nyfov_deg = 40\n".into(), "line 1: camera"),
        ("[[snapshot]]\nnote = \"a\"\n".into(), "line 1: missing field `slot`"),
        ("[[snapshot]]\nslot = 0\n".into(), "line 2: snapshot 0 is not in the range 1 to 9"),
        ("[[snapshot]]\nslot = -1\n".into(), "line 2"),
        ("[[snapshot]]\nslot = 2\n[[snapshot]]\nslot = 2\n".into(), "line 4: snapshot 2 is defined twice"),
        ("[[snapshot]]\nslot = 2\n[snapshot.camera]\nyfov_deg = 1\n".into(), "line 3: unknown field `camera`"),
        (
            format!("{light}[[snapshot]]\nslot = 2\n") + &light.replace("light", "snapshot.light") + "group = \"x\"\n",
            "line 11: light \"a\": there is no group \"x\"",
        ),
        ("[camera]\nposition = [0, 0, 0]\ntarget = [0, 0, 1]\nyfov_deg = 180\n".into(), "yfov_deg"),
        ("[camera]\nposition = [0, 0, 0]\ntarget = [0, 0, 1]\n".into(), "needs one of yfov_deg and ymag"),
        ("[[light]\n".into(), "line 1"),
    ] {
        let message = refusal(&text);
        assert!(message.contains(says), "{text}\nsays: {message}\nnot: {says}");
    }
    let folder = tempfile::tempdir().unwrap();
    let missing = Rig::load(&folder.path().join("none.toml")).unwrap_err().to_string();
    assert!(missing.contains("none.toml"), "{missing}");
    let binary = Rig::load(&write(folder.path(), "binary.toml", &[0xff, 0xfe, 0])).unwrap_err().to_string();
    assert!(binary.contains("binary.toml"), "{binary}");
}

fn vector(size: f64) -> impl Strategy<Value = DVec3> {
    [-size..size, -size..size, -size..size].prop_map(DVec3::from_array)
}

fn unit() -> impl Strategy<Value = DVec3> {
    vector(1.0).prop_filter_map("too short", |v| (v.length() > 1e-3).then(|| v.normalize()))
}

fn color() -> impl Strategy<Value = Vec3> {
    [0f32..2.0, 0f32..2.0, 0f32..2.0].prop_map(Vec3::from_array)
}

fn names() -> impl Strategy<Value = Vec<String>> {
    proptest::collection::vec(".*", 0..3)
}

fn links() -> impl Strategy<Value = Links> {
    let factor = proptest::collection::btree_map(".*", 0.0..=MAX_FACTOR, 0..3);
    (names(), names(), factor, names()).prop_map(|(only, except, factor, no_shadow_from)| Links {
        only,
        except,
        factor,
        no_shadow_from,
    })
}

fn light() -> impl Strategy<Value = Light> {
    use LightKind::{Directional, Disk, Dome, Emitter, Point, Rect, Spot};
    let kinds = [Point, Spot, Directional, Disk, Rect, Dome, Emitter];
    let kind = proptest::sample::select(kinds.to_vec());
    let lengths = [0.0..10.0f64, 0.0..10.0f64, 0.0..10.0f64];
    let sizes = (lengths, vector(2.0), 0.0..=180.0f64, 0.01..=180.0f64, any::<bool>());
    // Whole degrees, which read back to the last bit.
    let degrees = |low: i32, high: i32| (low..=high).prop_map(|degrees| f64::from(degrees).to_radians());
    let angles = [degrees(-90, 90), degrees(-90, 90), degrees(-90, 90), degrees(-90, 90)];
    let doors = (angles, degrees(1, 90)).prop_map(|(angles, softness)| BarnDoors { angles, softness });
    let doors = (0.0..10.0f64, proptest::option::of(doors));
    let sky = (degrees(0, 90), 1.0..=10.0f64, 0.0..=1.0f64, any::<bool>());
    let sky = sky.prop_map(|(elevation, turbidity, ground, sun)| PhysicalSky { elevation, turbidity, ground, sun });
    let map = proptest::option::of(sky.prop_map(DomeMap::physical));
    let intensity = prop_oneof![Just(0.0), Just(1e-20), Just(1e20), 0.0..1e3f64];
    let angles = (0.0..=1.0f64, 0.0..=std::f64::consts::FRAC_PI_2).prop_map(|(share, outer)| (share * outer, outer));
    (
        (kind, vector(1e4), unit(), color(), intensity, -20.0..20.0f64, angles),
        (proptest::option::of(1e-3..1e3f64), proptest::option::of(0usize..2), any::<[bool; 4]>()),
        (".*", proptest::option::of(0usize..1000), sizes, (doors, links(), map)),
    )
        .prop_map(
            |(
                (kind, position, direction, color, intensity, stops, angles),
                (range, group, flags),
                (name, node, sizes, ((decay_start, barn_doors), links, map)),
            )| {
                let ([radius, width, height], up, angle, spread, two_sided) = sizes;
                let [enabled, shadows, solo, visible] = flags;
                let (inner_angle, outer_angle) = angles;
                let name = name.replace('.', "_");
                let filter = LightFilter { barn_doors, ..LightFilter::default() };
                Light {
                    name,
                    kind,
                    position,
                    direction,
                    color,
                    intensity,
                    stops,
                    inner_angle,
                    outer_angle,
                    radius,
                    size: [width, height],
                    map,
                    material: (kind == LightKind::Emitter).then(|| format!("of {radius}")),
                    rotation: spread.to_radians(),
                    up,
                    angle: angle.to_radians(),
                    spread: spread.to_radians(),
                    two_sided,
                    visible,
                    range,
                    decay_start,
                    filter,
                    group,
                    enabled,
                    solo,
                    follows: None,
                    shadows,
                    links,
                    node,
                }
            },
        )
}

fn camera() -> impl Strategy<Value = Camera> {
    let projection = prop_oneof![
        (0.01..3.1f64).prop_map(|yfov| Projection::Perspective { yfov }),
        (0.01..1e3f64).prop_map(|ymag| Projection::Orthographic { ymag })
    ];
    // In memory names have no dots.
    (vector(1e5), unit(), unit(), projection, "[^.]*").prop_filter_map("degenerate", |(position, back, up, p, name)| {
        let camera = Camera::look_at(position, position - back, up, p)?;
        (up.cross(back).length() > 0.1).then_some(Camera { name, ..camera })
    })
}

proptest! {
    #[test]
    fn toml_reads_back_equal(
        lights in proptest::collection::vec(light(), 0..4),
        camera in proptest::option::of(camera()),
        tints in [color(), color()],
        stops in -9.0..9.0f64,
        items in names(),
    ) {
        let group = |i: usize| LightGroup {
            name: format!("g \"{i}\"\n"), stops: stops * i as f64, color: tints[i], enabled: i == 0, solo: i == 1,
        };
        let sets = vec![ObjectSet { name: "set\n".into(), items }];
        let mut rig = Rig { camera, groups: vec![group(0), group(1)], sets, lights, ..Rig::default() };
        let count = rig.lights.len();
        for (i, light) in rig.lights.iter_mut().enumerate() {
            light.name = format!("{}{i}", light.name);
            light.follows = [Some(1), None, Some(0)].get(i).copied().flatten().filter(|_| count > 1);
        }
        let text = rig.to_toml(Path::new(""));
        let mut read = parse(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        for (read, light) in read.lights.iter_mut().zip(&rig.lights) {
            prop_assert!((read.inner_angle - light.inner_angle).abs() < 1e-15);
            prop_assert!((read.outer_angle - light.outer_angle).abs() < 1e-15);
            (read.inner_angle, read.outer_angle) = (light.inner_angle, light.outer_angle);
        }
        if let (Some(read), Some(camera)) = (&mut read.camera, &rig.camera) {
            prop_assert!((read.world_from_camera - camera.world_from_camera).to_cols_array().iter().all(|d| d.abs() < 1e-12));
            read.world_from_camera = camera.world_from_camera;
            if let (Projection::Perspective { yfov: a }, Projection::Perspective { yfov: b }) = (read.projection, camera.projection) {
                prop_assert!((a - b).abs() < 1e-15);
                read.projection = camera.projection;
            }
        }
        prop_assert_eq!(read, rig, "{}", text);
    }
}

/// A snapshot has its own lights, of the same names, and its own groups and sets.
#[test]
fn snapshots_are_read_as_the_rig_is() {
    let light = "name = \"a\"\nkind = \"point\"\nposition = [0, 0, 0]\n";
    let rig = parse(&format!(
        "[[snapshot]]\nslot = 3\nnote = \"cold\\n\"\n[[snapshot.group]]\nname = \"g\"\n\
        [[snapshot.light]]\n{light}group = \"g\"\nintensity = 0.1\n[[snapshot]]\nslot = 1\n[[light]]\n{light}"
    ))
    .unwrap();
    assert_eq!((rig.lights.len(), rig.lights[0].intensity, rig.groups.len()), (1, 1.0, 0));
    let [cold, empty] = &rig.snapshots[..] else { panic!("{rig:?}") };
    assert_eq!((cold.slot, cold.note.as_str(), empty.slot), (2, "cold\n", 0));
    assert_eq!((cold.rig.lights[0].intensity, cold.rig.lights[0].group), (0.1, Some(0)));
    assert_eq!(parse(&rig.to_toml(Path::new(""))).unwrap(), rig);
    assert!(!Rig { snapshots: Vec::new(), ..rig }.to_toml(Path::new("")).contains("snapshot"));
}

#[test]
fn save_writes_what_load_reads() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let rig = Rig { lights: vec![Light::point("a", DVec3::ONE)], ..Rig::default() };
    rig.save(&path).unwrap();
    assert_eq!(Rig::load(&path).unwrap(), rig);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    let nowhere = rig.save(&folder.path().join("none/rig.toml")).unwrap_err().to_string();
    assert!(nowhere.contains("none/rig.toml"), "{nowhere}");
}

/// A square; lights under rotated, scaled and sheared parents, on a node with a mesh, on one with a child.
fn lit() -> Gltf {
    let mut gltf = Gltf::square();
    let spot = json!({"type": "spot", "intensity": 60.5, "color": [1.0, 0.95, 0.9], "range": 12.5, "extras": {"a": 1},
        "spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.5}});
    for light in [json!({"type": "point", "name": "bulb"}), spot, json!({"type": "directional", "intensity": 2.0})] {
        gltf.light(light);
    }
    let light = |index: usize| json!({"KHR_lights_punctual": {"light": index}});
    let key = gltf.node(json!({"name": "key", "extensions": light(1), "translation": [0.5, 1.0, 2.0],
        "rotation": [0.1, 0.2, 0.3, 0.927], "scale": [1.0, 1.0, -1.0], "extras": {"kept": true}}));
    let matrix = [2.0, 0.1, 0.0, 0.0, 0.0, 0.5, 0.3, 0.0, 0.2, 0.0, 3.0, 0.0, 7.0, 8.0, 9.0, 1.0];
    gltf.root(json!({"children": [key], "matrix": matrix}));
    gltf.root(json!({"name": "bulb node", "extensions": light(0), "mesh": 0, "translation": [0.0, 0.0, 4.0]}));
    let child = gltf.node(json!({"mesh": 0, "translation": [0.0, 0.0, 1.0]}));
    gltf.root(json!({"extensions": light(2), "children": [child], "rotation": [0.5, 0.5, 0.5, 0.5]}));
    gltf.json["extras"] = json!({"anything": [1, 2.5, "x"]});
    gltf.json["nodes"][0]["extensions"] = json!({"VENDOR_thing": {"z": 1, "a": 2}});
    gltf
}

fn export(gltf: &Gltf, rig: &Rig, name: &str) -> (Scene, Scene, Value) {
    let folder = tempfile::tempdir().unwrap();
    let source = Scene::load(&gltf.write(folder.path(), "source.glb")).unwrap();
    let path = folder.path().join(name);
    export_gltf(&source, rig, &path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let json = if bytes.starts_with(b"glTF") {
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        &bytes[20..20 + length]
    } else {
        &bytes[..]
    };
    let json = serde_json::from_slice(json).unwrap();
    (source, Scene::load(&path).unwrap(), json)
}

fn rig_of(gltf: &Gltf) -> Rig {
    let folder = tempfile::tempdir().unwrap();
    Scene::load(&gltf.write(folder.path(), "source.glb")).unwrap().rig
}

/// Lights compared by name, to 1e-6; nodes and what export folds are not.
fn assert_same_lights(got: &Rig, want: &Rig) {
    let names = |rig: &Rig| rig.lights.iter().map(|l| l.name.clone()).collect::<std::collections::BTreeSet<_>>();
    assert_eq!(names(got), names(want));
    for (i, light) in want.lights.iter().enumerate() {
        let j = got.lights.iter().position(|l| l.name == light.name).unwrap();
        let read = &got.lights[j];
        assert_eq!(read.kind, light.kind);
        assert!(
            read.position.distance(light.position) <= 1e-6 * (1.0 + light.position.length()),
            "{read:?}\n{light:?}"
        );
        if light.kind != LightKind::Point {
            assert!(read.direction.distance(light.direction) <= 1e-6, "{read:?}\n{light:?}");
        }
        let size = |light: &Light| (light.radius, light.size, light.up, light.angle, light.spread);
        assert_eq!(size(read), size(light));
        assert_eq!((read.two_sided, read.visible), (light.two_sided, light.visible));
        if light.kind == LightKind::Spot {
            assert!((read.inner_angle - light.inner_angle).abs() <= 1e-6);
            assert!((read.outer_angle - light.outer_angle).abs() <= 1e-6);
        }
        let (a, b) = (got.scale(j), want.scale(i));
        assert!((a - b).abs().max_element() <= 1e-6 * b.max_element(), "{a} {b}");
        assert_eq!(read.range, light.range);
    }
}

fn assert_same_geometry(a: &Scene, b: &Scene) {
    let bytes = |scene: &Scene| {
        let positions = scene.mesh.positions.iter().flat_map(|p| p.to_array()).map(f32::to_bits);
        positions.chain(scene.mesh.triangles.iter().flatten().copied()).collect::<Vec<u32>>()
    };
    assert_eq!(bytes(a), bytes(b));
    assert_eq!((a.space, a.mesh.normals.len()), (b.space, b.mesh.normals.len()));
}

/// Other programs read rectangles and disks of the nearest shape, and points; relume the exact rig.
#[test]
fn lights_with_a_size_come_back() {
    let gltf = lit();
    let mut rig = rig_of(&gltf);
    let added = [LightKind::Point, LightKind::Spot, LightKind::Directional, LightKind::Disk, LightKind::Rect];
    rig.lights.extend(added.iter().enumerate().map(|(i, &kind)| Light {
        kind,
        direction: DVec3::new(0.6, -0.8, 0.0),
        radius: 0.25,
        size: [0.5, 1.5],
        up: DVec3::Z,
        angle: 0.1,
        spread: 1.5,
        two_sided: true,
        visible: true,
        ..Light::point(&format!("sized{i}"), DVec3::new(1.0, 2.0, i as f64))
    }));
    let (_, back, json) = export(&gltf, &rig, "out.glb");
    assert_same_lights(&back.rig, &rig);
    let lights = json["extensions"]["EXT_lights_area"]["lights"].as_array().unwrap();
    let types: Vec<_> = lights.iter().map(|light| light["type"].as_str().unwrap()).collect();
    assert_eq!(types, ["disk", "rect"]);
}

#[test]
fn an_untouched_rig_changes_nothing() {
    let gltf = lit();
    let rig = rig_of(&gltf);
    for name in ["out.glb", "out.gltf"] {
        let (source, back, json) = export(&gltf, &rig, name);
        assert_same_geometry(&source, &back);
        assert_same_lights(&back.rig, &rig);
        assert_eq!(back.rig.lights.iter().map(|l| l.node).collect::<Vec<_>>(), [Some(1), Some(3), Some(5)]);
        for i in [0, 1, 2, 3, 4] {
            let (mut node, mut old) = (json["nodes"][i].clone(), gltf.json["nodes"][i].clone());
            node.as_object_mut().unwrap().remove("extensions");
            old.as_object_mut().unwrap().remove("extensions");
            assert_eq!(node, old);
        }
        assert_eq!(json["extras"], gltf.json["extras"]);
        assert_eq!(json["nodes"][0]["extensions"], gltf.json["nodes"][0]["extensions"]);
        assert_eq!(json["extensions"]["KHR_lights_punctual"]["lights"][0]["extras"], json!({"a": 1}));
        assert_eq!((&json["accessors"], &json["meshes"]), (&gltf.json["accessors"], &gltf.json["meshes"]));
    }
}

#[test]
fn moved_lights_stand_where_the_rig_says() {
    let gltf = lit();
    let mut rig = rig_of(&gltf);
    for light in &mut rig.lights {
        if light.kind != LightKind::Directional {
            light.position += DVec3::new(0.5, -1.0, 0.25);
        }
        if light.kind != LightKind::Point {
            light.direction = (DQuat::from_rotation_y(1.0) * light.direction + DVec3::Y * 0.3).normalize();
        }
        light.stops = 1.5;
    }
    for name in ["out.glb", "out.gltf"] {
        let (source, back, json) = export(&gltf, &rig, name);
        // Meshes on the lights' nodes and below them have not moved along.
        assert_same_geometry(&source, &back);
        assert_same_lights(&back.rig, &rig);
        let key = back.rig.lights.iter().find(|l| l.name == "key").unwrap();
        assert_eq!(key.node, Some(1));
        assert_eq!(json["nodes"][1]["extras"], json!({"kept": true}));
    }
}

#[test]
fn groups_stops_and_switches_are_folded() {
    let gltf = lit();
    let mut rig = rig_of(&gltf);
    rig.groups.push(LightGroup {
        name: "g".into(),
        stops: -2.0,
        color: Vec3::new(0.5, 3.0, 1.0),
        enabled: true,
        solo: false,
    });
    rig.groups.push(LightGroup { name: "off".into(), stops: 0.0, color: Vec3::ONE, enabled: false, solo: false });
    (rig.lights[0].group, rig.lights[0].stops) = (Some(0), 3.0);
    rig.lights[1].enabled = false;
    rig.lights[2].group = Some(1);
    let (_, back, json) = export(&gltf, &rig, "out.glb");
    assert_same_lights(&back.rig, &rig);
    for light in json["extensions"]["KHR_lights_punctual"]["lights"].as_array().unwrap() {
        assert!(light["color"].as_array().unwrap().iter().all(|c| c.as_f64().unwrap() <= 1.0), "{light}");
    }
}

#[test]
fn new_and_deleted_lights() {
    let gltf = lit();
    let mut rig = rig_of(&gltf);
    rig.lights.remove(0);
    let mut new = Light::point("new.one", DVec3::new(1.0, 2.0, 3.0));
    (new.name, new.kind, new.direction) = ("new_one".into(), LightKind::Spot, DVec3::Z);
    rig.lights.push(new);
    // A copy: two lights cannot share a node.
    rig.lights.push(Light { name: "copy".into(), ..rig.lights[0].clone() });
    // Names a node that has no light.
    rig.lights.push(Light { node: Some(0), ..Light::point("stray", DVec3::X) });
    let (source, back, json) = export(&gltf, &rig, "out.glb");
    assert_same_geometry(&source, &back);
    assert_same_lights(&back.rig, &rig);
    assert!(json["nodes"][1].get("extensions").is_none());
    assert_eq!(json["extensionsUsed"], json!(["KHR_lights_punctual"]));

    let (_, dark, json) = export(&gltf, &Rig::default(), "out.glb");
    assert!(dark.rig.lights.is_empty());
    assert!(json.get("extensions").is_none() && json.get("extensionsUsed").is_none());

    let (_, renamed, _) = {
        let mut rig = rig_of(&gltf);
        rig.lights.iter_mut().for_each(|l| l.name.push('x'));
        let out = export(&gltf, &rig, "out.glb");
        assert_same_lights(&out.1.rig, &rig);
        out
    };
    assert_eq!(renamed.rig.lights.len(), 3);
}

#[test]
fn other_scenes_keep_their_lights() {
    let mut gltf = lit();
    let other = gltf.light(json!({"type": "point", "intensity": 5.0, "name": "other"}));
    let node = gltf.node(json!({"extensions": {"KHR_lights_punctual": {"light": other}}}));
    gltf.push("scenes", json!({"nodes": [node]}));
    let (_, _, json) = export(&gltf, &Rig::default(), "out.glb");
    assert_eq!(
        json["extensions"]["KHR_lights_punctual"]["lights"],
        json!([{"type": "point", "intensity": 5.0, "name": "other"}])
    );
    assert_eq!(json["nodes"][node]["extensions"]["KHR_lights_punctual"]["light"], 0);
}

#[test]
fn external_files_come_along() {
    let mut gltf = lit();
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (gltf.bin.clone(), png(1, 1, &[[1, 2, 3, 255]]));
    write(folder.path(), "first.bin", &first);
    write(folder.path(), "image.png", &second);
    // Two buffers, the second holding an image; another image is a file.
    write(folder.path(), "second.bin", &second);
    gltf.json["buffers"] =
        json!([{"byteLength": first.len(), "uri": "first.bin"}, {"byteLength": second.len(), "uri": "second.bin"}]);
    let view = gltf.push("bufferViews", json!({"buffer": 1, "byteLength": second.len()}));
    gltf.json["images"] = json!([{"bufferView": view, "mimeType": "image/png"}, {"uri": "image.png"}]);
    gltf.json["textures"] = json!([{"source": 0}, {"source": 1}]);
    gltf.json["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
        "emissiveTexture": {"index": 1}}]);
    gltf.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    let path = write(folder.path(), "source.gltf", gltf.json.to_string().as_bytes());
    let source = Scene::load(&path).unwrap();
    let elsewhere = tempfile::tempdir().unwrap();
    for name in ["out.glb", "out.gltf"] {
        let path = elsewhere.path().join(name);
        export_gltf(&source, &source.rig, &path).unwrap();
        let back = Scene::load(&path).unwrap();
        assert_same_geometry(&source, &back);
        assert_eq!(back.textures.len(), 2);
        assert!(back.textures.iter().all(|t| t.levels[0].texels == [[1, 2, 3, 255]]));
    }
    assert_eq!(std::fs::read_dir(elsewhere.path()).unwrap().count(), 2);
}

#[test]
fn export_refuses_what_it_cannot_do() {
    let folder = tempfile::tempdir().unwrap();
    let obj = write(folder.path(), "scene.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let scene = Scene::load(&obj).unwrap();
    let message = export_gltf(&scene, &Rig::default(), &folder.path().join("out.glb")).unwrap_err().to_string();
    assert!(message.contains("scene.obj") && message.contains("glTF"), "{message}");
    let scene = Scene::load(&Gltf::square().write(folder.path(), "scene.glb")).unwrap();
    let message = export_gltf(&scene, &Rig::default(), Path::new("out.toml")).unwrap_err().to_string();
    assert!(message.contains("out.toml"), "{message}");
}

#[test]
fn the_shared_scenes_round_trip() {
    let shared = std::env::var("RELUME_SHARED").map(PathBuf::from);
    let shared = shared.unwrap_or_else(|_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"));
    let path = shared.join("scenes/balls-16.glb");
    if !path.is_file() {
        println!("not run: there is no {}", path.display());
        return;
    }
    let scene = Scene::load(&path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let toml = folder.path().join("rig.toml");
    scene.rig.save(&toml).unwrap();
    let rig = Rig::load(&toml).unwrap();
    let out = folder.path().join("out.glb");
    export_gltf(&scene, &rig, &out).unwrap();
    let back = Scene::load(&out).unwrap();
    assert_same_geometry(&scene, &back);
    assert_same_lights(&back.rig, &scene.rig);
}

#[test]
fn what_we_export_we_read_back_to_the_last_bit() {
    let gltf = lit();
    let mut rig = rig_of(&gltf);
    rig.groups.push(LightGroup { stops: 0.3, color: Vec3::new(0.7, 2.0, 0.9), ..LightGroup::new("rim") });
    (rig.lights[0].group, rig.lights[0].stops, rig.lights[0].position.x) = (Some(0), 1.0 / 3.0, 0.1);
    rig.lights[1].enabled = false;
    rig.lights[2].follows = Some(0);
    rig.lights.push(Light { solo: true, intensity: 7.0, ..Light::point("new", DVec3::new(1.0, 2.0, 3.3)) });
    for name in ["out.glb", "out.gltf"] {
        let (_, mut back, mut json) = export(&gltf, &rig, name);
        let nodes = |rig: &Rig| rig.lights.iter().map(|light| light.node).collect::<Vec<_>>();
        assert_eq!(nodes(&back.rig)[..3], nodes(&rig)[..3]);
        assert!(back.rig.lights[3].node.is_some());
        back.rig.lights[3].node = None;
        assert_eq!(back.rig, rig);
        // Somebody else moves a light: what the file's nodes say counts.
        let node = json["nodes"].as_array().unwrap().iter().position(|node| node["name"] == "new").unwrap();
        json["nodes"][node]["translation"][0] = 5.into();
        let folder = tempfile::tempdir().unwrap();
        let path = write(folder.path(), "moved.gltf", &serde_json::to_vec(&json).unwrap());
        if name.ends_with(".gltf") {
            let moved = Scene::load(&path).unwrap().rig;
            assert!(moved.groups.is_empty() && moved.lights.iter().any(|light| light.position.x == 5.0));
        }
    }
}

/// Two floors, one on an unnamed node below a named one.
fn linked() -> (Scene, [u32; 2]) {
    let mut gltf = Gltf::square();
    let unnamed = gltf.node(json!({"mesh": 0, "translation": [0.0, 0.0, 1.0]}));
    let child = gltf.node(json!({"name": "seat", "children": [unnamed]}));
    gltf.root(json!({"name": "sofa", "children": [child]}));
    gltf.json["nodes"][0]["name"] = json!("table");
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::load(&gltf.write(folder.path(), "linked.glb")).unwrap();
    let last = scene.mesh.triangles.len() as u32 - 1;
    (scene, [0, last])
}

fn links_of(text: &str) -> Rig {
    let light = "[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [0, 0, 0]\n";
    let set = "[[set]]\nname = \"all\"\nitems = [\"table\", \"sofa\", \"seat\"]\n";
    Rig::from_toml(&format!("{set}{light}{text}\n"), RigFiles::new(Path::new(""))).unwrap()
}

#[test]
fn links_name_nodes_their_descendants_materials_and_sets() {
    let (scene, triangles) = linked();
    let material = scene.materials[0].name.clone();
    for (text, factors, casts) in [
        ("only = [\"sofa\"]", [0.0, 1.0], [true; 2]),
        ("only = [\"seat\"]", [0.0, 1.0], [true; 2]),
        ("only = [\"all\"]\nexcept = [\"table\"]", [0.0, 1.0], [true; 2]),
        ("except = [\"MATERIAL\"]", [0.0; 2], [true; 2]),
        ("factor = { sofa = 3, seat = 0.5, table = 0 }", [0.0, 1.5], [true; 2]),
        ("factor = { all = 0.5 }", [0.5; 2], [true; 2]),
        ("factor = { MATERIAL = 2, table = 2 }", [4.0, 2.0], [true; 2]),
        ("no_shadow_from = [\"seat\"]", [1.0; 2], [true, false]),
        ("no_shadow_from = [\"MATERIAL\"]", [1.0; 2], [false; 2]),
    ] {
        let rig = links_of(&text.replace("MATERIAL", &material));
        let links = &rig.resolve_links(&scene).unwrap()[&0];
        assert_eq!(triangles.map(|t| links.factor(&scene.mesh, t)), factors, "{text}");
        assert_eq!(triangles.map(|t| links.casts_shadow(&scene.mesh, t)), casts, "{text}");
    }
    assert!(links_of("").resolve_links(&scene).unwrap().is_empty());
}

#[test]
fn unknown_names_in_links_are_refused_with_the_nearest() {
    let (scene, _) = linked();
    let refusal = |text: &str| links_of(text).resolve_links(&scene).err().unwrap();
    let says = "light \"a\": only: the scene has no node or material \"sofas\"; did you mean \"sofa\"?";
    assert_eq!(refusal("only = [\"sofas\"]"), says);
    let says = "light \"a\": factor: the scene has no node or material \"x\"";
    assert_eq!(refusal("factor = { x = 0.5 }"), says);
    assert!(refusal("no_shadow_from = [\"\"]").contains("no_shadow_from: the scene has no node or material \"\""));
}

/// Shots are checked as lights are; what no light uses is only told.
#[test]
fn unknown_names_in_shots_snapshots_and_sets() {
    let (scene, _) = linked();
    let shot = links_of("[[shot]]\ncamera = \"left\"\n[[shot.light]]\nname = \"a\"\nonly = [\"sofas\"]");
    let refusal = shot.check_links(&scene).unwrap_err();
    assert!(refusal.contains("shot \"left\": light \"a\": only: ") && refusal.contains("\"sofas\""), "{refusal}");
    let mut rig = links_of("[[set]]\nname = \"none\"\nitems = [\"stool\"]");
    let stale = links_of("only = [\"chair\"]");
    rig.snapshots.push(RigSnapshot { slot: 2, note: String::new(), rig: stale });
    assert_eq!(rig.check_links(&scene), Ok(()));
    let told = rig.stale_links(&scene);
    assert!(
        told.len() == 2 && told[0].starts_with("set \"none\": ") && told[1].starts_with("snapshot 3: "),
        "{told:?}"
    );
}

#[test]
fn links_survive_export() {
    let mut rig = links_of("only = [\"all\"]\nfactor = { \"table\" = 0.25 }\nno_shadow_from = [\"sofa\"]");
    let (_, read, _) = export(&lit(), &rig, "linked.glb");
    rig.lights[0].node = read.rig.lights[0].node;
    assert_eq!(read.rig, rig);
}

#[test]
fn shots_change_what_they_name() {
    let text = r#"
[[group]]
name = "rim"

[[light]]
name = "key"
kind = "point"
position = [0, 1, 0]
color = [1, 1, 1]
intensity = 100
range = 3

[[light]]
name = "back"
kind = "point"
position = [0, 1, 0]
color = [1, 1, 1]
intensity = 1
group = "rim"

[[shot]]
camera = "eye.left"

[[shot.group]]
name = "rim"
stops = -1

[[shot.light]]
name = "key"
lumen = 2513.2741228718346
unset = ["range"]
"#;
    let view = "[camera]\nname = \"eye.left\"\nposition = [0, 0, 0]\ntarget = [0, 0, 1]\nymag = 1\n";
    assert_eq!(parse(&format!("{view}{text}")).unwrap().camera.unwrap().name, "eye_left");
    let rig = parse(text).unwrap();
    let [left, right] = ["eye_left", "right"].map(|camera| rig.of_shot(camera).unwrap());
    assert_eq!((left.groups[0].stops, right.groups[0].stops), (-1.0, 0.0));
    assert_eq!((left.lights[0].range, right.lights[0].range), (None, Some(3.0)));
    assert!((left.lights[0].intensity - 200.0).abs() < 1e-9 && right.lights[0].intensity == 100.0, "{left:?}");
    assert_eq!(left.lights[1], right.lights[1]);
    let again = parse(&rig.to_toml(Path::new(""))).unwrap();
    assert_eq!(again.shots, rig.shots, "{}", rig.to_toml(Path::new("")));

    let wrong = |from: &str, to: &str| refusal(&text.replace(from, to));
    let of_key = "name = \"key\"\nlumen";
    let told = wrong(of_key, "name = \"kye\"\nlumen");
    assert!(told.contains("line 22: shot \"eye_left\": light \"kye\": there is no such light"), "{told}");
    assert!(wrong("lumen", "kind = \"disk\"\nlumen").contains("kind is the same in all shots"));
    assert!(wrong("lumen", "lummen").contains("unknown field `lummen`"));
    assert!(wrong("unset = [\"range\"]", "unset = 3").contains("no list of keys"));
    assert!(wrong("unset = [\"range\"]", "unset = [\"rnage\"]").contains("light \"key\": unknown field `rnage`"));
    assert!(wrong("unset = [\"range\"]", "range = -1").contains("light \"key\""));
    assert!(wrong(of_key, "lumen").contains("an entry without a name"));
    assert!(refusal(&format!("{text}\n[[shot]]\ncamera = \"eye_left\"")).contains("is defined twice"));
}

/// Factors of objects are one value: in a shot and out of it none is mixed with another's.
#[test]
fn factors_of_a_shot_replace_those_of_the_rig() {
    let factors = |names: &[&str]| {
        names.iter().map(|name| ((*name).to_owned(), 0.0)).collect::<std::collections::BTreeMap<_, _>>()
    };
    let with = |names: &[&str]| {
        let mut light = Light::point("key", DVec3::ZERO);
        light.links.factor = factors(names);
        Rig { lights: vec![light], ..Rig::default() }
    };
    for (base, after) in [(&["b"][..], &["a", "b"][..]), (&["a", "b"], &["a"]), (&["a"], &[]), (&[], &["a"])] {
        let (base, after) = (with(base), with(after));
        let edited = base.edited_in_shot("left", [&base, &after], true).unwrap();
        assert_eq!(edited.of_shot("left").unwrap(), after);
        assert_eq!(edited.of_shot("right").unwrap(), base);
        let stored = parse(&edited.to_toml(Path::new(""))).unwrap();
        assert_eq!((stored.of_shot("left").unwrap(), stored.of_shot("right").unwrap()), (after, base));
    }
}
