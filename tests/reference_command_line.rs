//! `relume reference` as a user meets it.

mod command;
mod support;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use command::*;
use serde_json::json;
use support::{Gltf, write};

/// Traces a scene at 24x16; more arguments follow.
macro_rules! reference {
    ($scene:expr, $output:expr $(, $argument:expr)* $(,)?) => {
        run!("reference", $scene, "-o", $output, "--size", "24x16" $(, $argument)*)
    };
}

/// What a file says of itself: samples a pixel, and the rest in words.
fn label(path: &Path) -> (i32, String) {
    use ::exr::meta::{MetaData, attribute::AttributeValue};
    let meta = MetaData::read_from_file(path, false).unwrap();
    let own = &meta.headers[0].own_attributes;
    let samples = match own.other.get("samplesPerPixel".as_bytes()) {
        Some(AttributeValue::I32(samples)) => *samples,
        other => panic!("{other:?}"),
    };
    (samples, own.comments.as_ref().expect("it has comments").to_string())
}

#[test]
fn writes_two_halves_and_their_mean() {
    let folder = folder();
    let out = folder.path().join("new/truth.exr");
    let (scene, stats) = (shipped("cornell-glossy.glb"), folder.path().join("truth.json"));
    let run = reference!(scene, &out, "--spp", "7", "--passes", "all", "--max-bounces", "3", "--stats", &stats).done();
    let figures = json(&stats);
    assert_eq!(figures["reference"]["samples_per_pixel"]["most"], 8);
    assert!(figures["reference"]["cpu_seconds"].as_f64().unwrap() > 0.0, "{figures}");
    assert!(run.stderr.contains("standard error"), "{}", run.stderr);
    assert_eq!(run.stdout, "");
    assert_eq!(names_in(&folder.path().join("new")), ["truth.a.exr", "truth.b.exr", "truth.exr"]);
    let [both, a, b] = ["exr", "a.exr", "b.exr"].map(|extension| out.with_extension(extension));
    let (samples, words) = label(&both);
    assert_eq!(samples, 8, "odd numbers are rounded up");
    assert!(words.contains("--max-bounces 3") && words.contains("seed 1"), "{words}");
    assert_eq!([label(&a).0, label(&b).0], [4, 4]);

    let [both, a, b] = [both, a, b].map(|path| read_exr(&path));
    let names: Vec<&str> = both.layers.iter().map(|layer| layer.name.as_str()).collect();
    for name in [
        "",
        "direct",
        "reflection",
        "indirect",
        "indirect_glossy",
        "emission",
        "variance",
        "bounce.1",
        "bounce.8",
        "light.spot0",
    ] {
        assert!(names.contains(&name), "no {name} in {names:?}");
        if name != "variance" {
            let halves: Vec<f32> = layer(&a, name).iter().zip(layer(&b, name)).map(|(a, b)| 0.5 * (a + b)).collect();
            assert!(difference(&halves, &layer(&both, name)) < 1e-6, "{name} is not the mean of its halves");
        }
    }
    assert_eq!(layer(&a, "direct"), layer(&b, "direct"), "through the centres direct light has no noise");
    assert_ne!(layer(&a, "indirect"), layer(&b, "indirect"));
    assert!(layer(&both, "bounce.4").iter().all(|&v| v == 0.0));
    assert!(layer(&both, "variance").iter().all(|&v| v >= 0.0) && mean(&layer(&both, "variance")) > 0.0);

    let figures = parse(&run!("compare", out.with_extension("exr"), out.with_extension("a.exr")).done().stdout);
    assert!(figures["rel_rmse"].as_f64() > Some(0.0), "{figures}");
}

#[test]
fn options_do_what_they_say() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let scene = shipped("balls-2.glb");
    reference!(&scene, path("a.exr"), "--spp", "2", "--quiet").silent();
    reference!(&scene, path("same.exr"), "--spp", "2", "--quiet", "--threads", "3").silent();
    for extension in ["exr", "a.exr", "b.exr"] {
        let bytes = |name: &str| std::fs::read(path(name).with_extension(extension)).unwrap();
        assert_eq!(bytes("a"), bytes("same"), "bytes depend on threads");
    }
    let first = read_exr(&path("a.exr"));
    let changed = |arguments: &[&str]| {
        let mut command = relume();
        command.args(["reference", "--size", "24x16", "--spp", "2", "--quiet", "-o"]).arg(path("b.exr")).arg(&scene);
        Run::of(command.args(arguments)).silent();
        read_exr(&path("b.exr"))
    };
    assert_ne!(layer(&changed(&["--seed", "2"]), "indirect"), layer(&first, "indirect"));
    assert!(mean(&layer(&changed(&["--layers", "1"]), "reflection")) == 0.0);
    assert_ne!(layer(&changed(&["--filter", "box"]), "direct"), layer(&first, "direct"));
    assert!(mean(&layer(&changed(&["--max-bounces", "0"]), "indirect")) == 0.0);
    assert!(mean(&layer(&changed(&["--strip-diffuse"]), "direct")) < 0.5 * mean(&layer(&first, "direct")));
    let rig = write(
        folder.path(),
        "dark.toml",
        b"[[light]]\nname = \"off\"\nkind = \"point\"\nposition = [0, 1, 0]\nintensity = 0.0\n",
    );
    assert!(mean(&layer(&changed(&["--rig", rig.to_str().unwrap()]), "")) == 0.0);
    let trace = path("new/trace.json");
    changed(&["--trace", trace.to_str().unwrap()]);
    let trace = json(&trace);
    let stages: Vec<_> = trace["traceEvents"].as_array().unwrap().iter().filter(|e| e["ph"] == "X").collect();
    let names: Vec<_> = stages.iter().map(|stage| stage["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["load", "build BVH", "path tracing", "write"]);
    assert!(changed(&["--passes", "bounce:2"]).layers.len() == 1);
    let lights = changed(&["--passes", "light:spot1,beauty,light:point0"]);
    let sum: Vec<f32> =
        layer(&lights, "light.point0").iter().zip(layer(&lights, "light.spot1")).map(|(a, b)| a + b).collect();
    assert!(difference(&sum, &layer(&lights, "")) < 1e-6, "lights do not add up");
    assert_eq!(layer(&lights, ""), layer(&first, ""), "asking for lights changes the picture");
    let started = std::time::Instant::now();
    reference!(&scene, path("c.exr"), "--seconds", "0.5").done();
    assert!(started.elapsed() > Duration::from_millis(500));
    assert!(label(&path("c.exr")).0 > 2);
}

#[test]
fn hostile_arguments() {
    let folder = folder();
    let scene = shipped("balls-2.glb");
    let out = folder.path().join("a.exr");
    for (option, value, says) in [
        ("--spp", "0", "not in"),
        ("--spp", "-1", ""),
        ("--spp", "99999999999", "not"),
        ("--seconds", "0", "seconds"),
        ("--seconds", "nan", "seconds"),
        ("--seconds", "inf", "seconds"),
        ("--max-bounces", "-1", ""),
        ("--max-bounces", "many", "inf"),
        ("--filter", "gauss", "centre"),
        ("--passes", "", "beauty"),
        ("--passes", "bounce:0", "bounce:1"),
        ("--passes", "bounce:4000000000", "bounce:1"),
        ("--passes", "lights:key", "light:NAME"),
        ("--passes", "light:key,light:key", "twice"),
        ("--passes", "direct,direct", "twice"),
        ("--layers", "0", "not in"),
    ] {
        run!("reference", &scene, "-o", &out, format!("{option}={value}")).refused(says);
    }
    run!("reference", &scene, "-o", &out, "--spp", "2", "--seconds", "1").refused("--spp");
    run!("reference", &scene).refused("--output");
    reference!(&scene, folder.path().join("a.png")).failed(&["a.png", ".exr"]);
    reference!(folder.path().join("none.glb"), &out).failed(&["none.glb"]);
    reference!(&scene, &out, "--rig", folder.path().join("none.toml")).failed(&["none.toml"]);
    reference!(&scene, &out, "--camera", "nosuch").failed(&["nosuch"]);
    reference!(&scene, &out, "--passes", "beauty,light:nosuch").failed(&["light:nosuch", "point0, spot1"]);
    reference!(&scene, "/proc/nosuch/a.exr").failed(&["/proc/nosuch"]);
    run!("reference", &scene, "-o", &out, "--size", "16384x16384", "--passes", "bounce:64")
        .failed(&["16384x16384", "GB"]);
    assert_eq!(names_in(folder.path()).len(), 0);
    std::fs::create_dir(folder.path().join("a.b.exr")).unwrap();
    reference!(&scene, &out, "--spp", "2").failed(&["a.b.exr", "is a directory"]);
    assert_eq!(names_in(folder.path()), ["a.b.exr"], "refused before anything is written");
}

#[test]
fn extreme_scenes_are_finite() {
    let folder = folder();
    let out = folder.path().join("a.exr");
    let trace = |gltf: Gltf| {
        let scene = gltf.write(folder.path(), "scene.glb");
        reference!(&scene, &out, "--spp", "8", "--passes", "all", "--filter", "box").done();
        for layer in &read_exr(&out).layers {
            assert!(layer.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "layer {}", layer.name);
        }
    };
    trace(Gltf::lit_square(|_| ()));
    trace(Gltf::lit_square(|gltf| gltf.json["nodes"][0]["translation"] = json!([1e6, 1e6, 1e6])));
    trace(Gltf::lit_square(|gltf| gltf.json["nodes"][0]["scale"] = json!([1e-6, 1e-6, 1e-6])));
    trace(Gltf::lit_square(|gltf| gltf.json["nodes"][2]["translation"] = json!([0.5, 0.5, 0.0]))); // on the surface
    trace(Gltf::lit_square(|gltf| gltf.json["nodes"][1]["translation"] = json!([0.5, 0.5, 0.0])));
    let material = |value: serde_json::Value| {
        Gltf::lit_square(move |gltf| {
            gltf.json["materials"] = json!([value]);
            gltf.json["meshes"][0]["primitives"][0]["material"] = json!(0);
        })
    };
    for roughness in [0.0, 1e-6, 1e-3, 1.0] {
        let metal = json!({"metallicFactor": 1.0, "roughnessFactor": roughness});
        trace(material(json!({"pbrMetallicRoughness": metal})));
        let plastic = json!({"metallicFactor": 0.0, "roughnessFactor": roughness});
        trace(material(
            json!({"pbrMetallicRoughness": plastic, "emissiveFactor": [1.0, 0.5, 0.0], "doubleSided": true}),
        ));
    }
}

#[test]
fn a_scene_without_lights_is_black() {
    let folder = folder();
    let out = folder.path().join("a.exr");
    let scene = write(folder.path(), "plain.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let run = reference!(&scene, &out, "--spp", "2").done();
    assert!(run.warnings().iter().any(|line| line.contains("no lights")), "{}", run.stderr);
    assert!(layer(&read_exr(&out), "").iter().all(|&v| v == 0.0));
}

/// Ctrl-C writes what there is and says how much that is.
#[cfg(unix)]
#[test]
fn an_interrupted_run_leaves_its_samples() {
    let folder = folder();
    let out = folder.path().join("a.exr");
    let mut command = relume();
    command.args(["reference", "--size", "64x64", "--spp", "1000000", "-v", "-o"]).arg(&out);
    let child = command.arg(shipped("balls-2.glb")).stderr(Stdio::piped()).spawn().unwrap();
    // Caught from the start of the tracing on; before it, nothing is lost.
    std::thread::sleep(Duration::from_secs(3));
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let run = Run::from(child.wait_with_output().unwrap()).done();
    assert!(run.stderr.contains("interrupted"), "{}", run.stderr);
    let (samples, words) = label(&out);
    assert!((2..1_000_000).contains(&samples) && words.contains(&samples.to_string()), "{samples}: {words}");
    assert_eq!(names_in(folder.path()), ["a.a.exr", "a.b.exr", "a.exr"]);
}
