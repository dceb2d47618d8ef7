//! The command line does what its contract says: the binary runs on small pictures.

mod command;
mod support;

use std::fs;
use std::path::Path;

use command::*;
use relume::image::png::srgb8_from_linear;
use relume::image::{Image, cryptomatte};
use relume::scene::Scene;
use relume::trace::bvh::TracedScene;
use serde_json::{Value, json};
use support::Gltf;

/// A square before a camera and a lamp, or without them; 40x30 pixels.
fn small_scene(camera: bool, light: bool) -> Gltf {
    let mut gltf = Gltf::square();
    gltf.json["scenes"][0]["extras"] = json!({ "width": 40, "height": 30 });
    if camera {
        gltf.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]);
        gltf.root(json!({"name": "eye", "camera": 0, "translation": [0.5, 0.5, 2.0]}));
    }
    if light {
        let lamp = gltf.light(json!({"type": "point", "intensity": 3.0}));
        let lights = json!({ "KHR_lights_punctual": { "light": lamp } });
        gltf.root(json!({"name": "lamp", "translation": [0.3, 0.7, 1.0], "extensions": lights}));
    }
    gltf
}

#[test]
fn version() {
    assert_eq!(run!("--version").silent().stdout, format!("relume {}\n", env!("CARGO_PKG_VERSION")));
}

/// The table in docs/options.md is what the commands take.
#[test]
fn the_options_page_tells_which_command_takes_what() {
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/options.md")).unwrap();
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter(|line| line.starts_with('|'))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    let quoted = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    let commands: Vec<String> = rows[0][1..].iter().flat_map(|cell| quoted(cell)).collect();
    let takes = |command: &str| {
        let help = run!("help", command).silent().stdout;
        // What is said of options is further to the right, and what follows them is not.
        let is_option = |line: &&str| line.starts_with("  -") || line.starts_with("      --");
        let long =
            |line: &str| line.split_whitespace().find(|w| w.starts_with("--")).map(|w| w.trim_matches('.').to_owned());
        help.lines().filter(is_option).filter_map(long).collect::<Vec<_>>()
    };
    let taken: Vec<Vec<String>> = commands.iter().map(|command| takes(command)).collect();
    let mut listed = Vec::new();
    for row in &rows[2..] {
        for option in quoted(row[0]) {
            for ((command, taken), cell) in commands.iter().zip(&taken).zip(&row[1..]) {
                assert_eq!(taken.contains(&option), *cell == "yes", "{command} {option}");
            }
            listed.push(option);
        }
    }
    let global = ["--quiet", "--verbose", "--help", "--version"];
    for option in taken.iter().flatten().filter(|option| !global.contains(&option.as_str())) {
        let shared = taken.iter().filter(|taken| taken.contains(option)).count() > 1;
        assert!(!shared || listed.contains(option) || option == "--output", "{option} is not in docs/options.md");
    }
}

#[test]
fn bad_usage_has_status_2() {
    let scene = shipped("balls-2.glb");
    run!().refused("Usage");
    run!("nosuch").refused("nosuch");
    run!("render").refused("--output");
    run!("render", &scene).refused("--output");
    run!("render", &scene, "-o", "a.png", "--nosuch").refused("--nosuch");
    for (option, value, says) in [
        ("--size", "0x0", "has no pixels"),
        ("--size", "64x0", "has no pixels"),
        ("--size", "65536x65536", "larger than"),
        ("--size", "4294967296x1", "WIDTHxHEIGHT"),
        ("--size", "64", "WIDTHxHEIGHT"),
        ("--size", "-1x-1", "WIDTHxHEIGHT"),
        ("--samples", "0", "not in"),
        ("--samples", "99999999999", "not"),
        ("--layers", "0", "not in"),
        ("--layers", "4000000000", "not in"),
        ("--threads", "0", "not in"),
        ("--shadow-size", "1", "not in"),
        ("--seed", "-1", ""),
        ("--budget", "much", "bytes"),
        ("--budget", "-1", ""),
        ("--budget", "nan", "bytes"),
        ("--passes", "", "beauty"),
        ("--passes", "nosuch", "nosuch"),
        ("--passes", "direct,,beauty", "beauty"),
        ("--passes", "direct,beauty,direct", "direct is listed twice"),
        ("--exposure", "nan", "stops"),
        ("--exposure", "1e30", "stops"),
        ("--exposure", "bright", "stops"),
        ("--tonemap", "nosuch", "agx"),
        ("--visibility", "nosuch", "traced"),
        ("--gi", "nosuch", "off"),
    ] {
        run!("render", &scene, "-o", "/nonexistent/a.png", format!("{option}={value}")).refused(says);
    }
    run!("render", &scene, "-o", "a.png", "--cache", "a", "--no-cache").refused("--no-cache");
    run!("bake").refused("SCENE");
    run!("bake", &scene, "--list").refused("--list");
    run!("bench").refused("SCENE");
    run!("bench", &scene, "--frames", "0").refused("not in");
    run!("bench", &scene, "--frames", "4294967295").refused("not in");
    run!("bench", &scene, "--lights", "18446744073709551615").refused("numbers of lights");
    run!("compare", "a.exr").refused("REFERENCE");
    for (option, value) in [("--block", "0"), ("--trim", "1"), ("--scale", "-1"), ("--scale", "nan")] {
        run!("compare", "a.exr", "b.exr", format!("{option}={value}")).refused("invalid value");
    }
    run!("rig", &scene).refused("--output");
}

#[test]
fn png_shows_the_exr() {
    let folder = folder();
    let (exr, png) = (folder.path().join("a.exr"), folder.path().join("new folder/a.PNG"));
    let scene = shipped("balls-2.glb");
    render!(&scene, &exr).silent();
    render!(&scene, &png, "--tonemap", "none", "--exposure", "-1.5").silent();
    let image = read_exr(&exr);
    assert_eq!((image.width, image.height), (64, 48));
    let linear = layer(&image, "beauty");
    let shown = read_png(&png);
    assert!(mean(&linear) > 0.01);
    for (linear, shown) in linear.chunks(3).zip(&shown) {
        for c in 0..3 {
            let want = srgb8_from_linear(linear[c] * (-1.5f32).exp2());
            assert!(want.abs_diff(shown[c]) <= 1, "{linear:?} is shown as {shown:?}");
        }
    }
}

#[test]
fn tone_maps_and_exposures_differ() {
    let folder = folder();
    let scene = shipped("cornell-glossy.glb");
    let mut pictures = Vec::new();
    for arguments in [["--tonemap", "agx"], ["--tonemap", "pbr-neutral"], ["--tonemap", "none"], ["--exposure", "3"]] {
        let path = folder.path().join("a.png");
        render!(&scene, &path, arguments[0], arguments[1]).silent();
        let picture = read_png(&path);
        assert!(!pictures.contains(&picture), "{arguments:?} changes nothing");
        pictures.push(picture);
    }
    let path = folder.path().join("default.png");
    render!(&scene, &path).silent();
    assert_eq!(read_png(&path), pictures[0]);
}

#[test]
fn size_is_the_scenes_own() {
    let folder = folder();
    let scene = small_scene(true, true).write(folder.path(), "small.glb");
    let (own, asked) = (folder.path().join("own.exr"), folder.path().join("asked.exr"));
    run!("render", &scene, "-o", &own, "--no-cache").silent();
    run!("render", &scene, "-o", &asked, "--no-cache", "--size", "1x1").silent();
    let (own, asked) = (read_exr(&own), read_exr(&asked));
    assert_eq!((own.width, own.height, asked.width, asked.height), (40, 30, 1, 1));
    assert!(mean(&layer(&asked, "beauty")) > 0.0);
}

/// The sum of some layers of an image.
fn sum(image: &Image, names: &[&str]) -> Vec<f32> {
    let layers: Vec<_> = names.iter().map(|name| layer(image, name)).collect();
    (0..layers[0].len()).map(|i| layers.iter().map(|layer| layer[i]).sum()).collect()
}

#[test]
fn passes_add_up() {
    let folder = folder();
    let path = folder.path().join("all.exr");
    render!(shipped("balls-2.glb"), &path, "--passes", "all").silent();
    let image = read_exr(&path);
    let names: Vec<_> = image.layers.iter().map(|layer| layer.name.as_str()).collect();
    // Nothing shines in this scene but its lights.
    assert_eq!(names, ["", "direct", "light.point0", "light.spot1", "reflection"]);
    let beauty = layer(&image, "beauty");
    // Sums of a few floats in another order.
    assert!(difference(&beauty, &sum(&image, &["direct", "reflection"])) < 1e-5);
    assert!(difference(&beauty, &sum(&image, &["light.point0", "light.spot1"])) < 1e-5);
    for name in ["direct", "reflection", "light.point0", "light.spot1"] {
        assert!(mean(&layer(&image, name)) > 1e-3, "{name} is black");
    }

    let some = folder.path().join("some.exr");
    render!(shipped("balls-2.glb"), &some, "--passes", "light:spot1, reflection").silent();
    let some = read_exr(&some);
    assert_eq!(some.layers.len(), 2);
    assert_eq!(layer(&some, "light.spot1"), layer(&image, "light.spot1"));
    assert_eq!(layer(&some, "reflection"), layer(&image, "reflection"));

    // Area lights have as many points in each part as in the whole.
    let rig = folder.path().join("rig.toml");
    let window = "name = 'window'\nkind = 'rect'\nposition = [0, 2, 2]\nwidth = 1\nheight = 1\ndirection = [0, -1, -1]\nintensity = 20\n";
    let sky = "name = 'sky'\nkind = 'dome'\nphysical_sky = { elevation_deg = 20 }\nintensity = 0.001\n";
    std::fs::write(&rig, format!("[[light]]\n{window}[[light]]\n{sky}")).unwrap();
    let parts = ["direct", "reflection", "indirect"];
    let passes = format!("{},beauty,light:window,light:sky", parts.join(","));
    let gi = ["--gi", "glossy", "--gather", "200", "--rays", "64", "--size", "64x48", "--no-cache"];
    let render = [&["render", "--passes", &passes], &gi[..]].concat();
    let files = [&shipped("balls-2.glb"), Path::new("-o"), &path, Path::new("--rig"), &rig];
    Run::of(relume().args(render).args(files)).done();
    let image = read_exr(&path);
    let beauty = layer(&image, "");
    for names in [&parts[..], &["light.window", "light.sky"]] {
        assert!(difference(&beauty, &sum(&image, names)) < 1e-5, "{names:?}");
    }

    let mut shining = small_scene(true, true);
    shining.json["materials"] = json!([{"emissiveFactor": [0.5, 0.25, 1.0]}]);
    shining.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    let shining = shining.write(folder.path(), "shining.glb");
    render!(&shining, &path, "--passes", "all").silent();
    let image = read_exr(&path);
    assert!(difference(&layer(&image, ""), &sum(&image, &["direct", "reflection", "emission"])) < 1e-5);
    let center = 3 * (24 * 64 + 32);
    assert_eq!(layer(&image, "emission")[center..center + 3], [0.5, 0.25, 1.0]);
}

/// Depth, normals and positions of surfaces, and mattes of objects and materials, are those that rays find.
#[test]
fn surfaces_and_mattes_are_what_rays_find() {
    let folder = folder();
    let path = folder.path().join("surfaces.exr");
    let (width, height) = (64, 48);
    let passes = "beauty,depth,normal,position,albedo,cryptomatte";
    render!(shipped("balls-2.glb"), &path, "--passes", passes, "--half").done();
    let file = exr::prelude::read_all_flat_layers_from_file(&path).unwrap();
    let layer = &file.layer_data[0];
    let channel = |name: &str| {
        let found = layer.channel_data.list.iter().find(|channel| channel.name.to_string() == name);
        found.unwrap_or_else(|| panic!("{name}")).sample_data.values_as_f32().collect::<Vec<f32>>()
    };
    let mattes = ["CryptoObject", "CryptoMaterial"].map(|name| {
        [channel(&format!("{name}00.R")), channel(&format!("{name}00.G")), channel(&format!("{name}00.A"))]
    });
    let (depth, albedo) = (channel("depth.Z"), channel("albedo.G"));
    let [normal, position] =
        ["normal", "position"].map(|name| ["X", "Y", "Z"].map(|c| channel(&format!("{name}.{c}"))));
    let scene = TracedScene::new(Scene::load(&shipped("balls-2.glb")).unwrap());
    let camera = &scene.cameras[0];
    let mut seen = std::collections::HashSet::new();
    for (pixel, (x, y)) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).enumerate() {
        let [u, v] = [(x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64];
        let (origin, direction) = camera.ray(u, v, width as f64 / height as f64);
        let eye = scene.space.from_world(origin);
        let Some(hit) = scene.closest_hit(eye.as_vec3(), direction.as_vec3(), f32::INFINITY) else {
            assert_eq!((depth[pixel], mattes[0][1][pixel]), (1e10, 0.0));
            continue;
        };
        let object = &scene.objects[scene.mesh.object(hit.triangle)].name;
        let material = &scene.materials[scene.mesh.triangle_materials[hit.triangle as usize] as usize].name;
        for ([hash, coverage, second], name) in mattes.iter().zip([object, material]) {
            assert_eq!(hash[pixel].to_bits(), cryptomatte::hash(name), "{x} {y}: {name}");
            assert_eq!((coverage[pixel], second[pixel]), (1.0, 0.0));
        }
        seen.insert(object.clone());
        let distance = f64::from(hit.distance) * scene.space.unit;
        assert!((f64::from(depth[pixel]) - distance).abs() < 1e-4 * distance, "{x} {y}: {} {distance}", depth[pixel]);
        let at = origin + distance * direction;
        let far = [0, 1, 2].map(|c| (f64::from(position[c][pixel]) - at[c]).abs());
        assert!(far.iter().all(|&far| far < 1e-3), "{x} {y}: {far:?}");
        let length = (0..3).map(|c| normal[c][pixel] * normal[c][pixel]).sum::<f32>();
        assert!((length - 1.0).abs() < 1e-4 && albedo[pixel] >= 0.0, "{x} {y}");
    }
    assert!(seen.len() > 2, "{seen:?}");
    let refused = "is for EXR files";
    let png = folder.path().join("{pass}.png");
    render!(shipped("balls-2.glb"), &png, "--passes", "depth").failed(&[refused]);
    render!(shipped("balls-2.glb"), &png, "--primaries", "acescg").failed(&["--primaries", refused]);
    render!(shipped("balls-2.glb"), folder.path().join("a.exr"), "--png-bits", "16").failed(&["is for PNG files"]);
}

#[test]
fn a_file_for_each_pass() {
    let folder = folder();
    let scene = shipped("balls-2.glb");
    let template = folder.path().join("{rig}/{pass}.exr");
    render!(&scene, &template, "--passes", "beauty,direct,light:spot1").silent();
    let inside = folder.path().join("balls-2");
    assert_eq!(names_in(&inside), ["beauty.exr", "direct.exr", "light.spot1.exr"]);
    assert_eq!(read_exr(&inside.join("direct.exr")).layers[0].name, "");
    render!(&scene, folder.path().join("{pass}.png"), "--passes", "beauty,direct").silent();
    assert_eq!(names_in(folder.path()), ["balls-2", "beauty.png", "direct.png"]);

    render!(&scene, folder.path().join("a.png"), "--passes", "all").failed(&["a.png", "{pass}"]);
    let nosuch = render!(&scene, folder.path().join("b.exr"), "--passes", "beauty,light:nosuch");
    nosuch.failed(&["nosuch", "point0, spot1"]);
    assert!(!folder.path().join("b.exr").exists());
}

/// A rig of the scene's lights, all changed by some stops.
fn write_rig(folder: &Path, scene: &Path, name: &str, stops: f64) -> std::path::PathBuf {
    let path = folder.join(name);
    run!("rig", scene, "-o", &path).silent();
    let text = fs::read_to_string(&path).unwrap();
    let mut table: toml::Table = text.parse().unwrap();
    for light in table["light"].as_array_mut().unwrap() {
        light.as_table_mut().unwrap().insert("stops".into(), stops.into());
    }
    fs::write(&path, table.to_string()).unwrap();
    path
}

/// Edges of the lights of all rigs get samples, whichever comes first.
#[test]
fn rigs_have_their_shadow_edges() {
    let folder = folder();
    let rig = |name: &str, x: f64| {
        let light = format!("[[light]]\nname = \"l\"\nkind = \"point\"\nposition = [{x}, 2.0, 0.5]\nintensity = 20\n");
        let path = folder.path().join(format!("{name}.toml"));
        fs::write(&path, light).unwrap();
        path
    };
    let [left, right] = [rig("left", -1.0), rig("right", 1.0)];
    let pictures = ["a", "b"].map(|name| folder.path().join(name));
    for (pictures, [first, second]) in pictures.iter().zip([[&left, &right], [&right, &left]]) {
        let out = pictures.join("{rig}.exr");
        render!(shipped("balls-2.glb"), out, "--samples", "4", "--rig", first, "--rig", second).silent();
    }
    let [one, other] =
        pictures.map(|folder| ["left", "right"].map(|rig| fs::read(folder.join(rig).with_extension("exr"))));
    for (one, other) in one.into_iter().zip(other) {
        assert!(one.unwrap() == other.unwrap());
    }
}

#[test]
fn rigs_share_one_exposure() {
    let folder = folder();
    let scene = shipped("cornell-diffuse.glb");
    let dim = write_rig(folder.path(), &scene, "dim.toml", 0.0);
    let bright = write_rig(folder.path(), &scene, "bright.toml", 1.0);
    let out = folder.path().join("out");
    render!(&scene, out.join("{rig}.png"), "--rig", &dim, "--rig", &bright).silent();
    assert_eq!(names_in(&out), ["bright.png", "dim.png"]);
    let alone = folder.path().join("alone.png");
    render!(&scene, &alone, "--rig", &bright).silent();
    let level = |path: &Path| read_png(path).iter().map(|p| f64::from(p[1])).sum::<f64>();
    let (dim_level, bright_level) = (level(&out.join("dim.png")), level(&out.join("bright.png")));
    assert!(bright_level > 1.1 * dim_level, "{bright_level} {dim_level}");
    // Twice the light exposed by itself is the same picture.
    assert!((level(&alone) / dim_level - 1.0).abs() < 0.01);

    let exr = |rig: &Path, name: &str| {
        let path = folder.path().join(name);
        render!(&scene, &path, "--rig", rig).silent();
        layer(&read_exr(&path), "beauty")
    };
    let doubled: Vec<f32> = exr(&dim, "d.exr").iter().map(|v| 2.0 * v).collect();
    assert!(difference(&doubled, &exr(&bright, "b.exr")) < 1e-6);

    render!(&scene, folder.path().join("c.png"), "--rig", &dim, "--rig", &bright).failed(&["c.png", "{rig}"]);
    let twice = render!(&scene, folder.path().join("{rig}.exr"), "--rig", &dim, "--rig", &dim);
    twice.failed(&["dim.exr", "two rigs"]);
}

#[test]
fn stats_tell_everything() {
    let folder = folder();
    let (out, stats) = (folder.path().join("a.exr"), folder.path().join("figures/stats.json"));
    render!(shipped("balls-2.glb"), &out, "--stats", &stats).silent();
    let stats = json(&stats);
    for key in [
        "/schema",
        "/relume",
        "/device",
        "/driver",
        "/scene/triangles",
        "/scene/lights",
        "/scene/width",
        "/scene/height",
        "/bake/seconds",
        "/bake/cpu_seconds",
        "/bake/stages/0/name",
        "/bake/stages/0/seconds",
        "/bake/cached",
        "/bake/peak_bytes",
        "/samples/view",
        "/samples/gather",
        "/samples/layers/3",
        "/transfer/method",
        "/transfer/form",
        "/transfer/bytes",
        "/transfer/bytes_per_pixel",
        "/transfer/macs_per_pixel",
        "/transfer/held_out/point",
        "/transfer/held_out/spot",
        "/transfer/held_out/worst_tile",
        "/transfer/spectral_radius",
        "/transfer/bounces",
        "/transfer/residual",
        "/transfer/capped",
        "/frame/passes/0/name",
        "/frame/passes/0/ms",
        "/frame/passes/0/on",
        "/frame/gpu_ms",
        "/frame/wall_ms",
        "/non_finite",
        "/negative",
        "/memory/0/owner",
        "/memory/0/bytes",
        "/left_out/0/what",
        "/left_out/0/why",
        "/left_out/0/saves",
    ] {
        assert!(stats.pointer(key).is_some(), "no {key} in {stats:#}");
    }
    let number = |key: &str| stats.pointer(key).unwrap().as_f64().unwrap_or_else(|| panic!("{key} in {stats:#}"));
    assert_eq!((number("/schema"), number("/non_finite"), number("/negative")), (1.0, 0.0, 0.0));
    assert_eq!((number("/scene/triangles"), number("/scene/lights")), (9922.0, 2.0));
    assert_eq!((number("/scene/width"), number("/scene/height")), (64.0, 48.0));
    assert_eq!(stats["bake"]["cached"], false);
    assert!((1e6..1e10).contains(&number("/bake/peak_bytes")));
    assert!((1e-4..60.0).contains(&number("/bake/seconds")));
    let layers: Vec<_> = stats["samples"]["layers"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    assert!(layers.len() == 4 && layers[0] <= 64 * 48 && layers[1] > 0, "{layers:?}");
    let passes = stats["frame"]["passes"].as_array().unwrap();
    for name in ["trace shadows", "shade light", "composite"] {
        assert!(passes.iter().any(|pass| pass["name"] == name), "no {name} in {passes:?}");
    }
    let spent: f64 = passes.iter().filter(|p| p["on"] == "gpu").map(|p| p["ms"].as_f64().unwrap()).sum();
    assert!((spent - number("/frame/gpu_ms")).abs() < 1e-6);
    assert!(number("/frame/wall_ms") >= number("/frame/gpu_ms"));
}

#[test]
fn traces_hold_every_stage_and_pass() {
    let folder = folder();
    let (out, trace) = (folder.path().join("{pass}.png"), folder.path().join("trace.json"));
    // More lights than one frame takes.
    render!(shipped("balls-16.glb"), &out, "--passes", "beauty,direct", "--trace", &trace).silent();
    let trace = json(&trace);
    let events = trace["traceEvents"].as_array().unwrap();
    let named = |name: &str| events.iter().filter(|e| e["name"] == name && e["ph"] == "X").collect::<Vec<_>>();
    for name in ["load", "build BVH", "deep framebuffer", "shade light", "composite"] {
        assert!(!named(name).is_empty(), "no {name} in {trace:#}");
    }
    assert_eq!(named("trace shadows").len(), 2 * 16); // in the picture of everything, and in that of layer 1
    let mut end = 0.0;
    for event in named("trace shadows") {
        let start = event["ts"].as_f64().unwrap();
        assert!(start >= end - 1e-3, "{event} begins before {end}"); // microseconds, rounded
        end = start + event["dur"].as_f64().unwrap();
    }
    for event in events.iter().filter(|e| e["ph"] == "X") {
        assert!(event["pid"].is_u64() && event["tid"].is_u64() && event["dur"].as_f64() >= Some(0.0), "{event}");
    }
}

#[test]
fn options_of_the_bake() {
    let folder = folder();
    let scene = shipped("balls-2.glb");
    let picture = |name: &str, arguments: &[&str]| {
        let path = folder.path().join(format!("{name}.exr"));
        let passes = ["render", "--size", "64x48", "--no-cache", "--passes", "beauty,direct,reflection"];
        Run::of(relume().args(passes).arg(&scene).arg("-o").arg(&path).args(arguments)).silent();
        read_exr(&path)
    };
    let usual = picture("usual", &[]);
    let beauty = layer(&usual, "beauty");

    let flat = picture("flat", &["--layers", "1"]);
    assert_eq!(layer(&flat, "direct"), layer(&usual, "direct"));
    assert_eq!(mean(&layer(&flat, "reflection")), 0.0);
    assert!(mean(&layer(&usual, "reflection")) > 1e-3);

    let smooth = picture("smooth", &["--samples", "4"]);
    assert_ne!(layer(&smooth, "beauty"), beauty);
    let change = mean(&layer(&smooth, "beauty")) / mean(&beauty) - 1.0;
    assert!(change.abs() < 0.05, "{change}");

    let stripped = picture("stripped", &["--strip-diffuse"]);
    assert!(mean(&layer(&stripped, "direct")) < 0.5 * mean(&layer(&usual, "direct")));

    assert_eq!(picture("forced", &["--force-all"]), usual);
    assert_eq!(picture("all of it", &["--force-all", "--samples", "4"]), smooth);
    let plan =
        |arguments: &[&str]| Run::of(relume().args(["plan", "--gi", "off"]).arg(&scene).args(arguments)).done().stdout;
    for what in ["parts of mirror layers", "BRDFs of single samples"] {
        assert!(plan(&[]).contains(what) && !plan(&["--force-all"]).contains(what), "{what}");
    }
    assert_eq!(picture("one thread", &["--threads", "1", "--samples", "4"]), smooth);
    assert_eq!(picture("two threads", &["--threads", "2", "--samples", "4"]), smooth);
    assert_eq!(picture("seed", &["--seed", "18446744073709551615"]).width, 64);
    assert_eq!(fs::read(folder.path().join("two threads.exr")).unwrap(), {
        fs::read(folder.path().join("one thread.exr")).unwrap()
    });
    picture("device", &["--device", "0"]);
}

#[test]
fn shadow_maps_come_close_to_rays() {
    let folder = folder();
    let scene = shipped("cornell-diffuse.glb");
    let (map, traced) = (folder.path().join("map.exr"), folder.path().join("traced.exr"));
    for (method, path) in [("map", &map), ("traced", &traced)] {
        run!("render", &scene, "-o", path, "--size", "128x96", "--no-cache", "--visibility", method).silent();
    }
    let figures = parse(&run!("compare", &map, &traced).silent().stdout);
    let trimmed = parse(&run!("compare", &map, &traced, "--trim", "0.03").silent().stdout);
    // They differ where shadows end: along lines, so on few of the pixels.
    assert!(figures["rel_rmse"].as_f64().unwrap() < 0.1, "{figures}");
    assert!(trimmed["trimmed"].as_f64().unwrap() < 0.01, "{trimmed}");
    assert!(figures["rel_rmse"].as_f64().unwrap() > 0.0, "both are the same");
}

#[test]
fn shadow_maps_of_far_lights_are_as_fine() {
    let folder = folder();
    let scene = shipped("balls-2.glb");
    let (map, traced) = (folder.path().join("map.exr"), folder.path().join("traced.exr"));
    let spot = "kind = \"spot\"\ndirection = [-1, -3, -1]\nouter_deg = 60.0\ninner_deg = 50.0\n";
    for kind in ["kind = \"point\"\n", spot] {
        let light = "intensity = 1e6\nposition = [200, 600, 200]\n";
        let rig = format!("[[light]]\nname = \"far\"\n{kind}{light}");
        let rig = support::write(folder.path(), "rig.toml", rig.as_bytes());
        for (method, path) in [("map", &map), ("traced", &traced)] {
            run!("render", &scene, "-o", path, "--size", "128x96", "--no-cache", "--rig", &rig, "--visibility", method)
                .silent();
        }
        let figures = parse(&run!("compare", &map, &traced, "--trim", "0.03").silent().stdout);
        assert!(figures["trimmed"].as_f64().unwrap() < 1e-3, "{kind}: {figures}");
        assert!(mean(&layer(&read_exr(&traced), "")) > 0.1);
    }
}

#[test]
fn a_tiny_budget_changes_nothing() {
    let folder = folder();
    let scene = shipped("balls-16.glb");
    let (usual, tiny) = (folder.path().join("usual.exr"), folder.path().join("tiny.exr"));
    render!(&scene, &usual).silent();
    let warned = render!(&scene, &tiny, "--budget", "1").done();
    assert!(matches!(warned.warnings().as_slice(), [one] if one.contains("budget")), "{}", warned.stderr);
    render!(&scene, folder.path().join("huge.png"), "--budget", "1e300G").silent();
    let (usual, tiny) = (layer(&read_exr(&usual), ""), layer(&read_exr(&tiny), ""));
    assert!(difference(&usual, &tiny) < 1e-5); // 16 floats summed in another order
}

#[test]
fn cached_is_as_uncached() {
    let folder = folder();
    let (cache, stats) = (folder.path().join("cache"), folder.path().join("stats.json"));
    let scene = shipped("balls-2.glb");
    let out = folder.path().join("a.exr");
    let render = || {
        let mut command = relume();
        command.args(["render", "--size", "64x48", "--samples", "4"]).arg(&scene).arg("-o").arg(&out);
        let run = Run::of(command.arg("--cache").arg(&cache).arg("--stats").arg(&stats));
        let cached = json(&stats)["bake"]["cached"].as_bool().unwrap();
        (run.done(), cached, fs::read(&out).unwrap())
    };
    let (first, cached, bytes) = render();
    assert!(!cached && first.stderr.is_empty());
    let (second, cached, bytes_2) = render();
    assert!(cached && second.stderr.is_empty());
    assert!(bytes == bytes_2);

    let stored = names_in(&cache).into_iter().find(|name| name.starts_with("bake-")).unwrap();
    let stored = cache.join(stored);
    let good = fs::read(&stored).unwrap();
    let mut flipped = good.clone();
    *flipped.last_mut().unwrap() ^= 1;
    let mut header = good.clone();
    header[..8].fill(0xff);
    for damaged in [&good[..good.len() / 2], &flipped, &header, b""] {
        fs::write(&stored, damaged).unwrap();
        let (run, cached, bytes_3) = render();
        assert!(!cached && bytes == bytes_3);
        let warnings = run.warnings();
        assert!(warnings.len() == 1 && warnings[0].contains("damaged"), "{}", run.stderr);
        let (_, cached, bytes_4) = render();
        assert!(cached && bytes == bytes_4, "not mended");
    }
}

#[test]
fn bake_list_prune() {
    let folder = folder();
    let cache = folder.path().join("cache");
    let scene = shipped("balls-2.glb");
    assert_eq!(run!("bake", "--list", "--cache", &cache).silent().stdout, "");
    let baked = run!("bake", &scene, "--size", "64x48", "--cache", &cache).silent().stdout;
    assert!(baked.contains("deep framebuffer") && !baked.contains("from the cache"), "{baked}");
    let again = run!("bake", &scene, "--size", "64x48", "--cache", &cache).silent().stdout;
    assert!(again.contains("from the cache"), "{again}");
    run!("bake", &scene, "--size", "32x24", "--cache", &cache).silent();
    let list = run!("bake", "--list", "--cache", &cache).silent().stdout;
    assert!(list.lines().count() == 3 && list.contains("64x48") && list.contains("balls-2"), "{list}");
    // What bakes leave that were killed.
    fs::write(cache.join("bake-1.journal"), "").unwrap();
    fs::write(cache.join(".relume-1.part"), "").unwrap();
    let pruned = run!("bake", "--prune", "--cache", &cache).silent().stdout;
    assert!(pruned.starts_with("removed 4 files"), "{pruned}");
    assert_eq!(fs::read_dir(&cache).unwrap().count(), 0);
    assert_eq!(run!("bake", "--list", "--cache", &cache).silent().stdout, "");
    run!("bake", "--list", "--no-cache").failed(&["--no-cache"]);
    run!("bake", &scene, "--size", "64x48", "--no-cache").silent();
}

#[test]
fn no_light_is_black_and_no_camera_is_framed() {
    let folder = folder();
    let out = folder.path().join("a.exr");
    let dark = small_scene(true, false).write(folder.path(), "dark.glb");
    let run = run!("render", &dark, "-o", &out, "--no-cache", "--passes", "all").done();
    assert_eq!((run.warnings().len(), run.stderr.lines().count()), (1, 1), "{}", run.stderr);
    assert!(run.stderr.contains("dark.glb: no lights"), "{}", run.stderr);
    assert_eq!(mean(&layer(&read_exr(&out), "")), 0.0);
    run!("render", &dark, "-o", folder.path().join("a.png"), "--no-cache", "--quiet").silent();
    let none = run!("render", &dark, "-o", &out, "--no-cache", "--passes", "light:key");
    none.failed(&["light:key", "there are no lights"]);
    // What glows is a light.
    let mut glowing = small_scene(true, false);
    glowing.json["materials"] = json!([{"emissiveFactor": [0.5, 0.25, 1.0]}]);
    glowing.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    let glowing = glowing.write(folder.path(), "glowing.glb");
    run!("render", &glowing, "-o", &out, "--no-cache").silent();

    let blind = small_scene(false, true).write(folder.path(), "blind.glb");
    let run = run!("render", &blind, "-o", &out, "--no-cache").done();
    assert_eq!(run.stderr.lines().count(), 1, "{}", run.stderr);
    assert!(run.warnings()[0].contains("blind.glb: no camera"), "{}", run.stderr);
    assert!(mean(&layer(&read_exr(&out), "")) > 0.0);
    run!("render", &blind, "-o", &out, "--no-cache", "--camera", "eye").failed(&["--camera eye", "no cameras"]);
    let seeing = small_scene(true, true).write(folder.path(), "seeing.glb");
    run!("render", &seeing, "-o", &out, "--no-cache", "--camera", "eye").silent();
    run!("render", &seeing, "-o", &out, "--no-cache", "--camera", "ear")
        .failed(&["--camera ear", "its cameras are: eye"]);
}

#[test]
fn obj_with_a_rig() {
    let folder = folder();
    let scene = support::write(
        folder.path(),
        "square.obj",
        b"mtllib square.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3 4\n",
    );
    support::write(folder.path(), "square.mtl", b"newmtl a\nKd 0.5 0.5 0.5\n");
    let rig = b"[camera]\nposition = [0.5, 0.5, 2]\ntarget = [0.5, 0.5, 0]\nup = [0, 1, 0]\nyfov_deg = 40\n\
        [[light]]\nname = \"key\"\nkind = \"point\"\nposition = [0.5, 0.5, 1]\nintensity = 3.0\n";
    let rig = support::write(folder.path(), "rig.toml", rig);
    let out = folder.path().join("a.exr");
    render!(&scene, &out, "--rig", &rig, "--passes", "beauty,light:key").silent();
    assert!(mean(&layer(&read_exr(&out), "light.key")) > 0.01);
    let bare = render!(&scene, &out).done();
    assert_eq!(bare.warnings().len(), 2, "{}", bare.stderr);
}

#[test]
fn plan_tells_why_it_takes_so_many_samples_and_rays() {
    let scene = shipped("cornell-diffuse.glb");
    let plan = |arguments: &[&str]| {
        let plan = Run::of(relume().args(["plan", "--json", "--no-cache"]).arg(&scene).args(arguments)).silent().stdout;
        let plan = parse(&plan);
        plan["reasons"].as_array().unwrap().iter().map(|r| r.as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let start = |arguments: &[&str], samples: &str, rays: &str| {
        let reasons = plan(arguments);
        assert!(reasons[0].starts_with(samples) && reasons[1].starts_with(rays), "{arguments:?}: {reasons:?}");
        reasons
    };
    start(
        &["--size", "96x64"],
        "2304 gather samples: one for 4 of 6144 pixels, at least 2304",
        "1024 rays a row: 1024",
    );
    start(&["--size", "200x100"], "5000 gather samples: one for 4 of 20000 pixels,", "1024 rays");
    start(&["--size", "200x100", "--error", "0.02"], "2500 gather samples: one for 8 of", "512 rays");
    start(
        &["--size", "720x480", "--error", "0.02"],
        "16384 gather samples",
        "256 rays a row: 512 with --error 0.02, 0.50",
    );
    start(&["--size", "96x64", "--error", "0.005"], "2304 gather samples", "2048 rays");
    let given =
        start(&["--gather", "99", "--rays", "7", "--gi", "diffuse"], "99 gather samples: --gather", "7 rays a row: --");
    assert_eq!(given[2], "1 function a sample: --gi diffuse");
    assert_eq!(plan(&["--method", "thesis"])[0], "2304 gather samples: a dense matrix of more is too large");
    assert!(plan(&["--gi", "off"]).is_empty());
}

#[test]
fn plan_tells_what_is_left_out() {
    let scene = shipped("cornell-diffuse.glb");
    let plan = parse(&run!("plan", &scene, "--json", "--no-cache", "--size", "64x48").silent().stdout);
    assert_eq!(plan["schema"], 1);
    assert_eq!(plan["scene"], json!({ "triangles": 8086, "lights": 1, "width": 64, "height": 48 }));
    let left_out = plan["left_out"].as_array().unwrap();
    assert!(left_out.iter().any(|item| item["what"] == "mirror layers"), "{plan:#}");
    let text = run!("plan", &scene, "--no-cache", "--size", "64x48").silent().stdout;
    assert!(text.contains("8086 triangles, 1 lights") && text.contains("no mirror is visible"), "{text}");
}

#[test]
fn plan_tells_why_there_is_no_light_of_the_sky() {
    const CORNERS: &str = "v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\n";
    const FACES: &str = "f 1 2 3 4\nf 6 5 8 7\nf 5 1 4 8\nf 2 6 7 3\nf 5 6 2 1\n";
    const CAMERA: &str = "[camera]\nposition = [0, 0, 0.9]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\nyfov_deg = 50\n";
    let folder = folder();
    let write = |name: &str, text: &str| support::write(folder.path(), name, text.as_bytes());
    let open = write("open.obj", &format!("{CORNERS}{FACES}"));
    // Larger than the hole: closed surfaces would be turned to face outwards.
    let lid = "v -1.1 1 -1.1\nv 1.1 1 -1.1\nv 1.1 1 1.1\nv -1.1 1 1.1\nf 9 10 11 12\n";
    let closed = write("closed.obj", &format!("{CORNERS}{FACES}{lid}"));
    let why = |scene: &Path, light: &str| {
        let rig = write("rig.toml", &format!("{CAMERA}[[light]]\nname = \"light\"\n{light}"));
        let plan = run!("plan", scene, "--rig", &rig, "--json", "--no-cache", "--size", "64x48");
        let plan = parse(&plan.silent().stdout);
        let mut items = plan["left_out"].as_array().unwrap().iter();
        items.find(|item| item["what"] == "light of the sky").map(|item| item["why"].as_str().unwrap().to_owned())
    };
    let dome = "kind = \"dome\"\n";
    assert_eq!(why(&open, "kind = \"point\"\nposition = [0, 0, 0]\n").unwrap(), "no light is a dome");
    assert_eq!(why(&open, dome), None);
    assert_eq!(why(&closed, dome).unwrap(), "hardly any ray leaves the scene");
}

#[test]
fn plan_estimates_and_stores_nothing() {
    let folder = folder();
    let cache = folder.path().join("cache");
    let scene = shipped("balls-2.glb");
    let plan = |more: &[&str]| {
        let mut command = relume();
        command.args(["plan", "--json", "--gi", "off", "--size", "384x256"]).arg(&scene).arg("--cache").arg(&cache);
        parse(&Run::of(command.args(more)).silent().stdout)
    };
    // Edges in curved mirrors are neither as many as pixels nor as lines are long.
    for samples in ["1", "4"] {
        let more = ["--samples", samples];
        let estimated = plan(&more);
        assert!(!cache.exists() || samples != "1", "a plan filled the cache");
        assert_eq!(estimated["samples"]["counted_in"], json!([157, 105]));
        run!("bake", &scene, "--size", "384x256", "--cache", &cache, "--samples", samples).silent();
        let exact = plan(&more);
        assert_eq!(exact["samples"]["counted_in"], "cache");
        let counts = |plan: &Value| {
            let layers = plan["samples"]["layers"].as_array().unwrap();
            let all = layers.iter().take(2).chain([&plan["samples"]["view"]]);
            all.map(|count| count.as_f64().unwrap()).collect::<Vec<_>>()
        };
        for (estimate, count) in counts(&estimated).into_iter().zip(counts(&exact)) {
            assert!((estimate / count - 1.0).abs() < 0.05, "{samples}: {estimate} is not near {count}");
        }
        assert_eq!(estimated["left_out"].as_array().unwrap().len(), exact["left_out"].as_array().unwrap().len());
    }
    let small = parse(&run!("plan", &scene, "--json", "--no-cache", "--size", "64x48").silent().stdout);
    assert_eq!(small["samples"]["counted_in"], "picture");
}

#[test]
fn plan_tells_what_fits() {
    let plan = |more: &[&str]| {
        let mut command = relume();
        command.args(["plan", "--gi", "off", "--size", "64x48", "--no-cache"]).arg(shipped("balls-2.glb"));
        Run::of(command.args(more)).silent().stdout
    };
    // Two lights have four images of 64x48 pixels, 12 bytes each: 147,456 bytes.
    let memory = |more: &[&str]| {
        let plan = parse(&plan(&[&["--json"], more].concat()));
        assert_eq!(plan["light_image_bytes"], 147_456);
        let told = plan["memory"]["verdict"].as_str().unwrap_or_default().to_owned();
        (plan["memory"]["fits"].clone(), told, plan["memory"]["device"].is_string())
    };
    assert_eq!(memory(&[]), (Value::Null, String::new(), false));
    let (fits, told, _) = memory(&["--budget", "1M"]);
    assert!(fits == true && told.starts_with("fits: "), "{told}");
    let (fits, told, _) = memory(&["--budget", "1K"]);
    assert!(fits == false && told.contains("--budget 1M") && told.contains("--size 5x3"), "{told}");
    let (fits, _, has_device) = memory(&["--device", "0"]);
    assert!(fits == true && has_device);
    assert!(plan(&["--budget", "1K"]).contains("memory: does not fit"));
    assert!(plan(&["--visibility", "traced"]).contains("shadow maps: rays are traced"));
    assert!(!plan(&["--visibility", "map", "--device", "0"]).contains("rays are traced"));
    // A hundred lights need at least 25 of 200 images.
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("many.toml");
    let light = |number| format!("[[light]]\nname = \"{number}\"\nkind = \"point\"\nposition = [0.0, 2.0, 0.0]\n");
    std::fs::write(&rig, (0..100).map(light).collect::<String>()).unwrap();
    let told = plan(&["--rig", rig.to_str().unwrap()]);
    assert!(told.contains("light images: 1 MB to 7 MB, as the budget allows"), "{told}");
    let nosuch = run!("plan", shipped("balls-2.glb"), "--no-cache", "--device", "nosuch");
    nosuch.failed(&["no Vulkan device", "nosuch"]);
    run!("plan", shipped("balls-2.glb"), "--budget", "much").refused("bytes");
}

#[test]
fn devices_are_listed() {
    let devices = parse(&run!("devices", "--json").silent().stdout);
    assert_eq!(devices["schema"], 1);
    let first = &devices["devices"][0];
    for key in ["index", "name", "driver", "kind", "api", "memory_bytes", "lacks"] {
        assert!(!first[key].is_null(), "{devices:#}");
    }
    let text = run!("devices").silent().stdout;
    assert!(text.contains(first["name"].as_str().unwrap()), "{text}");
}

#[test]
fn rigs_come_out_and_go_in() {
    let folder = folder();
    let scene = shipped("balls-2.glb");
    let path = |name: &str| folder.path().join(name);
    run!("rig", &scene, "-o", path("rig.toml")).silent();
    run!("rig", &scene, "--rig", path("rig.toml"), "-o", path("again.glb")).silent();
    run!("rig", path("again.glb"), "-o", path("again.toml")).silent();
    assert_eq!(fs::read(path("again.toml")).unwrap(), fs::read(path("rig.toml")).unwrap());
    let picture = |scene: &Path| {
        render!(scene, path("a.exr")).silent();
        layer(&read_exr(&path("a.exr")), "")
    };
    assert!(difference(&picture(&scene), &picture(&path("again.glb"))) < 1e-5);
    run!("rig", &scene, "-o", path("b.glb")).failed(&["b.glb", "--rig"]);
}

#[test]
fn compare_prints_figures() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let scene = shipped("balls-2.glb");
    render!(&scene, path("a.exr"), "--passes", "all").silent();
    render!(&scene, path("b.exr"), "--passes", "all", "--layers", "1").silent();
    let same = parse(&run!("compare", path("a.exr"), path("a.exr")).silent().stdout);
    for key in ["rel_rmse", "rmse", "rel_mse", "bias", "flip_mean", "flip_floor", "noise_free", "trimmed", "max_abs"] {
        assert!(same.get(key).is_some(), "no {key} in {same:#}");
    }
    let sizes = ["schema", "non_finite", "width", "height"].map(|key| same[key].as_u64().unwrap());
    assert_eq!((same["rel_rmse"].as_f64(), sizes), (Some(0.0), [1, 0, 64, 48]));
    let options = ["--block=4", "--trim=0.1", "--scale=3"];
    let (map, colors) = (path("new/d.png"), path("newer/f.png"));
    let other = Run::of(
        relume()
            .arg("compare")
            .args([path("b.exr"), path("a.exr"), path("a.exr")])
            .args(options)
            .arg("--diff")
            .arg(&map)
            .arg("--false-color")
            .arg(&colors),
    );
    let other = parse(&other.silent().stdout);
    assert!(other["rel_rmse"].as_f64() > Some(0.01) && other["noise_free"] == true, "{other:#}");
    assert!(other["flip_mean"].as_f64() > Some(0.01) && other["flip_floor"] == 0.0, "{other:#}");
    assert_eq!(read_png(&map).len(), 64 * 48);
    assert!(read_png(&colors).len() > 64 * 48, "no legend");
    let direct = run!("compare", path("b.exr"), path("a.exr"), "--layer", "direct").silent();
    assert_eq!(parse(&direct.stdout)["max_abs"], 0.0);
    run!("compare", path("a.exr"), path("a.exr"), "--layer", "nosuch").failed(&["a.exr", "nosuch"]);
    run!("compare", path("a.exr"), path("none.exr")).failed(&["none.exr"]);
}

#[test]
fn bench_measures_every_edit() {
    let folder = folder();
    let path = folder.path().join("new/bench.json");
    let bench = run!(
        "bench",
        shipped("balls-2.glb"),
        "--json",
        &path,
        "--frames",
        "3",
        "--lights",
        "1,3",
        "--size",
        "64x48",
        "--no-cache"
    );
    let table = bench.silent().stdout;
    let bench = json(&path);
    for key in ["/schema", "/device", "/driver", "/load", "/rates/segments_per_s_core", "/rates/gather_rays_per_s"] {
        assert!(bench.pointer(key).is_some(), "no {key} in {bench:#}");
    }
    for key in ["copy_gb_s", "fma_gflop_s", "yardstick_ms"] {
        assert!(bench["limits"][key].as_f64() > Some(0.0), "{bench:#}");
    }
    let records = bench["records"].as_array().unwrap();
    for record in records {
        let keys: Vec<_> = record.as_object().unwrap().keys().map(String::as_str).collect();
        for key in ["scene", "lights", "edit", "edited_kind", "gi", "method", "size", "visibility", "passes"] {
            assert!(keys.contains(&key), "no {key} in {record:#}");
        }
        let [best, median, p95] = ["best_ms", "median_ms", "p95_ms"].map(|key| record[key].as_f64().unwrap());
        assert!(0.0 < best && best <= median && median <= p95, "{record:#}");
        let first = &record["passes"][0];
        let measured = first["name"].is_string() && first["median_ms"].is_f64();
        assert!(measured || record["edit"] == "none", "{record:#}");
        assert!(table.contains(record["edit"].as_str().unwrap()), "{table}");
    }
    let edits = |lights: u64| {
        let of = records.iter().filter(|record| record["lights"] == lights && record["edited_kind"] == "point");
        of.map(|record| record["edit"].as_str().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(edits(1), ["color", "toggle", "move", "move_direct", "none"]);
    assert_eq!(edits(3), ["color", "toggle", "move", "move_direct", "select", "group", "multi", "none"]);
    // What moves shades a light; an unchanged frame does nothing.
    let passes = |edit: &str| {
        let record = records.iter().find(|record| record["edit"] == edit).unwrap();
        record["passes"].as_array().unwrap().iter().map(|p| p["name"].clone()).collect::<Vec<Value>>()
    };
    assert!(passes("move").contains(&"shade light".into()) && passes("none").is_empty());

    let dark = small_scene(true, false).write(folder.path(), "dark.glb");
    let run = run!("bench", &dark, "--frames", "1", "--no-cache", "--json", &path).done();
    assert_eq!(run.warnings().len(), 1);
    assert_eq!(json(&path)["records"].as_array().unwrap().len(), 1);
}

#[test]
fn bench_writes_figures_and_a_trace_for_each_scene() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let (one, two) = (shipped("balls-2.glb"), shipped("cornell-diffuse.glb"));
    let bench = |scenes: &[&Path], stats: &str, trace: &str| {
        let mut command = relume();
        command.args(["bench", "--size", "32x24", "--frames", "2", "--no-cache", "--tonemap", "none"]).args(scenes);
        Run::of(command.arg("--stats").arg(path(stats)).arg("--trace").arg(path(trace)))
    };
    bench(&[&one], "one.json", "trace.json").silent();
    let stats = json(&path("one.json"));
    for key in ["/device", "/scene/triangles", "/bake/stages/0/name", "/frame/passes/0/name", "/memory/0/owner"] {
        assert!(!stats.pointer(key).unwrap_or(&Value::Null).is_null(), "no {key} in {stats:#}");
    }
    let trace = json(&path("trace.json"));
    let events = trace["traceEvents"].as_array().unwrap();
    let named = |name: &str| events.iter().filter(|e| e["name"] == name && e["ph"] == "X").collect::<Vec<_>>();
    for name in ["load", "deep framebuffer", "move_direct", "shade light"] {
        assert!(!named(name).is_empty(), "no {name} in {trace:#}");
    }
    let span = |e: &Value| {
        let start = e["ts"].as_f64().unwrap();
        (start, start + e["dur"].as_f64().unwrap())
    };
    let edits: Vec<_> = named("move_direct").into_iter().map(span).collect();
    // Two frames of each edit of a light of each kind, inside of the edit; microseconds, rounded.
    let inside = |(start, end): (f64, f64)| {
        let shaded = named("shade light").into_iter().map(span);
        shaded.filter(|(s, e)| *s >= start - 1e-3 && *e <= end + 1e-3).count()
    };
    assert!(edits.iter().all(|edit| inside(*edit) == 2), "{edits:?}");

    bench(&[&one, &two], "both.json", "{scene}.trace.json").failed(&["both.json", "{scene}"]);
    bench(&[&one, &two], "{scene}.json", "{scene}.trace.json").silent();
    assert_eq!(json(&path("cornell-diffuse.json"))["scene"]["triangles"], 8086);
    assert!(path("balls-2.trace.json").is_file());
}

#[test]
fn quiet_and_verbose() {
    let folder = folder();
    let out = folder.path().join("a.png");
    let scene = shipped("balls-2.glb");
    let told = render!(&scene, &out, "-v").done().stderr;
    for part in ["deep framebuffer", "device: ", "exposure: ", "a.png"] {
        assert!(told.contains(part), "no {part} in {told}");
    }
    assert!(told.lines().all(|line| line.starts_with(" INFO ")), "{told}");
    render!(&scene, &out, "-vv").done();
    render!(&scene, &out, "-v", "-q").silent();
}
