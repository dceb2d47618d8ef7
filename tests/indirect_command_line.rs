//! Indirect light from the command line: passes, methods, cache, and options that exclude each other.

mod command;

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use command::{Run, difference, folder, json, layer, mean, names_in, read_exr, relume, shipped};
use relume::image::Image;
use serde_json::Value;

/// Few samples and rays: what is tested does not depend on them.
const SMALL: [&str; 6] = ["--gather", "120", "--rays", "32", "--size", "40x30"];

fn render(output: &Path, arguments: &[&str]) -> Run {
    let scene = shipped("cornell-glossy.glb");
    let mut command = relume();
    command.arg("render").arg(scene).arg("-o").arg(output).args(SMALL).args(arguments);
    Run::of(&mut command)
}

fn rendered(folder: &Path, arguments: &[&str]) -> Image {
    let path = folder.join("picture.exr");
    render(&path, &[&["--no-cache"], arguments].concat()).done();
    read_exr(&path)
}

fn sum(layers: &[Vec<f32>]) -> Vec<f32> {
    (0..layers[0].len()).map(|i| layers.iter().map(|layer| layer[i]).sum()).collect()
}

#[test]
fn passes_add_up() {
    let folder = folder();
    let image = rendered(folder.path(), &["--gi", "glossy", "--basis", "sh4", "--passes", "all"]);
    let of = |name: &str| layer(&image, name);
    let parts = ["direct", "reflection", "indirect"].map(of);
    assert!(mean(&parts[2]) > 0.01 * mean(&parts[0]), "there is indirect light");
    assert!(difference(&of(""), &sum(&parts)) < 1e-5);
    let glossy = of("indirect_glossy");
    assert!(mean(&glossy) > 0.0 && mean(&glossy) < mean(&parts[2]), "the specular lobe's share");
    let without = rendered(folder.path(), &["--gi", "off", "--passes", "all"]);
    assert!(without.layer("indirect").is_none());
    assert_eq!(layer(&without, "direct"), parts[0]);

    // Without diffuse lobes all that pixels make of indirect light is glossy.
    let stripped = ["--gi", "glossy", "--basis", "sh4", "--strip-diffuse", "--passes", "indirect,indirect_glossy"];
    let stripped = rendered(folder.path(), &stripped);
    assert!(difference(&layer(&stripped, "indirect"), &layer(&stripped, "indirect_glossy")) < 1e-5);
}

/// Direct and indirect light, diffuse and specular, of each light add up to the beauty, also on mirrors and
/// anti-aliased edges, and under an area light.
#[test]
fn parts_of_lights_add_up() {
    let folder = folder();
    let rig = folder.path().join("rig.toml");
    let sized =
        "[[light]]\nname = \"ball\"\nkind = \"sphere\"\nposition = [0.5, 1.5, 0.5]\nradius = 0.2\nintensity = 3\n";
    fs::write(&rig, format!("{sized}[[light]]\nname = \"key\"\nkind = \"point\"\nposition = [-0.5, 1.4, 0.6]\n"))
        .unwrap();
    for (scene, more) in [("cornell-glossy.glb", &["--samples", "4"][..]), ("balls-2.glb", &["--samples", "4"])] {
        let path = folder.path().join("parts.exr");
        let mut command = relume();
        command.arg("render").arg(shipped(scene)).arg("-o").arg(&path).args(SMALL).args(more).arg("--rig").arg(&rig);
        command.args(["--gi", "glossy", "--no-cache", "--passes", "beauty,parts,light:ball"]);
        Run::of(&mut command).done();
        let image = read_exr(&path);
        let parts = ["direct.diffuse", "direct.specular", "reflection", "indirect.diffuse", "indirect.specular"];
        let of_light = |name: &str| parts.map(|part| layer(&image, &format!("light.{name}.{part}")));
        let (ball, key) = (of_light("ball"), of_light("key"));
        assert!(difference(&layer(&image, "light.ball"), &sum(&ball)) < 1e-6, "{scene}");
        assert!(difference(&layer(&image, ""), &sum(&[&ball[..], &key[..]].concat())) < 1e-6, "{scene}");
        for part in [0, 1, 3] {
            assert!(mean(&key[part]) > 0.0, "{scene}: {}", parts[part]);
        }
    }
    // Without diffuse lobes there is no diffuse light, and without indirect light no part of it.
    let path = folder.path().join("specular.exr");
    let mut command = relume();
    command.arg("render").arg(shipped("cornell-glossy.glb")).arg("-o").arg(&path).args(SMALL).arg("--rig").arg(&rig);
    Run::of(command.args(["--gi", "off", "--no-cache", "--strip-diffuse", "--passes", "parts"])).done();
    let image = read_exr(&path);
    assert_eq!(mean(&layer(&image, "light.key.direct.diffuse")), 0.0);
    assert!(mean(&layer(&image, "light.key.direct.specular")) > 0.0);
    assert!(image.layer("light.key.indirect.diffuse").is_none());
}

#[test]
fn methods_agree_roughly_and_bounces_add() {
    let folder = folder();
    let indirect = |arguments: &[&str]| {
        mean(&layer(&rendered(folder.path(), &[arguments, &["--passes", "indirect"]].concat()), "indirect"))
    };
    let all = indirect(&["--gi", "glossy"]);
    for others in [&["--gi", "diffuse"][..], &["--gi", "glossy", "--basis", "sh4"]] {
        let mean = indirect(others);
        assert!((mean / all - 1.0).abs() < 0.2, "{others:?}: {mean}, all functions {all}");
    }
    // Random samples and raw form factors scatter widely at so few samples.
    for thesis in [&["--gi", "diffuse"][..], &["--gi", "glossy"], &["--gi", "glossy", "--basis", "svd3"]] {
        let mean = indirect(&[thesis, &["--method", "thesis"]].concat());
        assert!(mean > 0.3 * all && mean < 3.0 * all, "{thesis:?}: {mean}, ours {all}");
    }
    let bounces = ["0", "1", "2", "9", "inf"].map(|n| indirect(&["--gi", "diffuse", "--bounces", n]));
    assert!(bounces[0] == 0.0 && bounces.is_sorted(), "{bounces:?}");
    assert!(bounces[3] > 0.9 * bounces[4] && bounces[3] < bounces[4], "{bounces:?}");
    let many = indirect(&["--gi", "diffuse", "--bounces", "4000000000"]);
    assert!((many / bounces[4] - 1.0).abs() < 1e-3, "{many} of {bounces:?}");
}

/// Few samples and rays are far off; final gathering makes up for it, in all passes alike, and says how well.
#[test]
fn final_gathering_refines_a_coarse_operator() {
    let folder = folder();
    let stats = folder.path().join("stats.json");
    let refined = ["--gi", "glossy", "--final", "8%", "--passes", "all", "--stats", stats.to_str().unwrap()];
    let image = rendered(folder.path(), &refined);
    let of = |name: &str| layer(&image, name);
    let parts = ["direct", "reflection", "indirect"].map(of);
    assert!(difference(&of(""), &sum(&parts)) < 1e-5);
    let figures = &json(&stats)["final"];
    let expected = figures["estimated_error"].as_f64().unwrap();
    assert!(expected > 0.0 && expected <= 0.08 && figures["passes"].as_u64() >= Some(2), "{figures}");
    let [errors, beauty] = [of("expected_error"), of("")].map(|pixels| pixels.into_iter().map(f64::from));
    let (square, count) =
        errors.map(|error| error * error).fold((0.0, 0.0), |(sum, n), square| (sum + square, n + 1.0));
    let luminances = beauty.zip([0.2126, 0.7152, 0.0722].into_iter().cycle()).map(|(value, share)| value * share);
    let relative = (square / count).sqrt() / (3.0 * luminances.sum::<f64>() / count);
    assert!((relative / expected - 1.0).abs() < 1e-3, "{relative} in the layer, {expected} in the figures");

    let truth = folder.path().join("truth.exr");
    let mut command = relume();
    command.arg("reference").arg(shipped("cornell-glossy.glb")).arg("-o").arg(&truth);
    Run::of(command.args(["--size", "40x30", "--spp", "1024"])).done();
    let (want, plain) = (read_exr(&truth), rendered(folder.path(), &["--gi", "glossy", "--passes", "all"]));
    let off = |image: &Image| {
        let [got, want] = [image, &want].map(|image| layer(image, "indirect"));
        let squares = |of: &mut dyn Iterator<Item = f32>| of.map(|x| f64::from(x).powi(2)).sum::<f64>();
        (squares(&mut got.iter().zip(&want).map(|(a, b)| a - b)) / squares(&mut want.iter().copied())).sqrt()
    };
    let [before, after] = [&plain, &image].map(off);
    println!("indirect light is {before:.3} off, refined {after:.3}");
    assert!(after < 0.5 * before, "{before} before, {after} after");

    // A picture in 8 bits, and at once when the time is over.
    render(&folder.path().join("a.png"), &["--no-cache", "--gi", "diffuse", "--seconds", "0.01"]).done();
    let refused = |arguments: &[&str]| render(&folder.path().join("b.exr"), arguments);
    refused(&["--final", "1%", "--gi", "off"]).failed(&["--final", "--gi off"]);
    refused(&["--seconds", "1", "--gi", "diffuse", "--bounces", "2"]).failed(&["--seconds", "all bounces"]);
    refused(&["--final", "1%", "--gi", "diffuse", "--method", "thesis"]).failed(&["--final", "all bounces"]);
    refused(&["--gi", "diffuse", "--passes", "expected_error"]).failed(&["expected_error", "--final"]);
    refused(&["--final", "0"]).refused("more than 0");
    refused(&["--final", "200%"]).refused("less than 1");
    refused(&["--seconds", "0"]).refused("seconds");
}

#[test]
fn a_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let folder = folder();
    let bytes = |arguments: &[&str]| {
        let path = folder.path().join("a.exr");
        render(&path, &[&["--no-cache", "--gi", "glossy", "--basis", "sh4"], arguments].concat()).done();
        fs::read(path).unwrap()
    };
    let one = bytes(&["--threads", "1"]);
    assert_eq!(one, bytes(&["--threads", "3"]));
    assert_ne!(one, bytes(&["--seed", "2"]));
}

#[test]
fn transfer_is_kept_whatever_the_lights() {
    let folder = folder();
    let (out, stats, cache) = (folder.path().join("a.exr"), folder.path().join("a.json"), folder.path().join("cache"));
    let run = |arguments: &[&str]| {
        let files = ["--cache", cache.to_str().unwrap(), "--stats", stats.to_str().unwrap(), "--gi", "glossy"];
        let run = render(&out, &[&files, arguments].concat()).done();
        (json(&stats)["bake"]["cached"].as_bool().unwrap(), fs::read(&out).unwrap(), run)
    };
    let (cached, bytes, _) = run(&[]);
    assert!(!cached);
    assert_eq!(names_in(&cache).iter().filter(|name| name.starts_with("bake-")).count(), 2);
    let (cached, bytes_2, _) = run(&[]);
    assert!(cached && bytes == bytes_2);

    let rig = folder.path().join("rig.toml");
    fs::write(&rig, "[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [0.1, 1.2, 0.3]\nintensity = 2.0\n")
        .unwrap();
    let (cached, with_other_light, _) = run(&["--rig", rig.to_str().unwrap()]);
    assert!(cached && with_other_light != bytes, "only the lights differ");
    for other in [["--gather", "149"], ["--rays", "31"], ["--basis", "sh9"], ["--method", "thesis"], ["--bounces", "3"]]
    {
        // clap takes an option once: these stand instead of the ones in SMALL.
        let arguments: Vec<&str> = SMALL.chunks(2).filter(|pair| pair[0] != other[0]).flatten().copied().collect();
        let gi: &[&str] = if other[0] == "--gi" { &[] } else { &["--gi", "glossy"] };
        let mut command = relume();
        command.arg("render").arg(shipped("cornell-glossy.glb")).arg("-o").arg(&out).args(arguments).args(other);
        Run::of(command.arg("--cache").arg(&cache).arg("--stats").arg(&stats).args(gi)).done();
        assert_eq!(json(&stats)["bake"]["cached"], false, "{other:?} makes another operator");
    }

    let listed = Run::of(relume().args(["bake", "--list", "--cache"]).arg(&cache)).silent().stdout;
    assert_eq!(listed.lines().filter(|line| line.contains(" transfer ")).count(), 6, "{listed}");

    // Damaged: one line says so, and the picture is the same.
    let large = |name: &String| name.starts_with("bake-").then(|| cache.join(name));
    for path in names_in(&cache).iter().filter_map(large) {
        let mut data = fs::read(&path).unwrap();
        let middle = data.len() / 2;
        data[middle] ^= 4;
        fs::write(&path, data).unwrap();
    }
    let (cached, bytes_3, run_3) = run(&[]);
    assert!(!cached && bytes == bytes_3);
    assert_eq!(run_3.warnings().len(), 2, "{}", run_3.stderr);
    assert!(run(&[]).0, "mended");
}

/// Nor is what the cache has of the one taken for the other's.
#[test]
fn nothing_left_out_is_the_same_picture() {
    let folder = folder();
    let cache = folder.path().join("cache");
    for (samples, gi) in [("1", "glossy"), ("4", "glossy"), ("1", "diffuse")] {
        let pictures = [&[][..], &["--force-all"], &[]].map(|arguments| {
            let path = folder.path().join("picture.exr");
            let mut command = relume();
            command.arg("render").arg(shipped("balls-2.glb")).arg("-o").arg(&path).args(SMALL);
            command.args(["--gi", gi, "--samples", samples, "--cache"]).arg(&cache).args(arguments);
            let run = Run::of(&mut command).done();
            assert!(run.warnings().is_empty(), "{}", run.stderr);
            read_exr(&path)
        });
        assert!(pictures[0] == pictures[1] && pictures[0] == pictures[2], "--samples {samples} --gi {gi}");
    }
}

#[test]
fn figures_of_the_transfer() {
    let folder = folder();
    let stats = folder.path().join("a.json");
    let arguments = ["--no-cache", "--gi", "diffuse", "--stats", stats.to_str().unwrap()];
    render(&folder.path().join("a.png"), &arguments).done();
    let figures = json(&stats);
    let transfer = &figures["transfer"];
    assert_eq!(transfer["method"], "robust");
    assert_eq!(transfer["form"], "nested");
    let point = transfer["held_out"]["point"].as_f64().unwrap();
    assert!(point > 0.0 && point < 0.5, "{point}");
    let radius = transfer["spectral_radius"].as_f64().unwrap();
    assert!(radius > 0.1 && radius < 1.0, "{radius}");
    assert!(transfer["macs_per_pixel"].as_f64().unwrap() > 10.0);
    // Solved in single precision.
    let residual = |transfer: &Value| transfer["residual"].as_f64().unwrap();
    assert!(residual(transfer) > 0.0 && residual(transfer) < 1e-5, "{}", residual(transfer));
    assert!(figures["samples"]["gather"].as_u64().unwrap() > 100);
    let passes: Vec<&str> =
        figures["frame"]["passes"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    for name in ["trace gather samples", "shade gather samples", "Haar transform", "transfer", "transfer to pixels"] {
        assert!(passes.contains(&name), "{passes:?}");
    }
    let dense = [&arguments[..], &["--transfer", "dense"]].concat();
    render(&folder.path().join("a.png"), &dense).done();
    let of_dense = json(&stats)["transfer"].clone();
    assert_eq!(of_dense["form"], "dense");
    assert!(residual(&of_dense) < 1e-9, "{}", residual(&of_dense));
    assert!(of_dense["macs_per_pixel"].as_f64() > transfer["macs_per_pixel"].as_f64());
    let thesis = [&arguments[..], &["--method", "thesis"]].concat();
    render(&folder.path().join("a.png"), &thesis).done();
    assert_eq!(json(&stats)["transfer"]["method"], "thesis");
    assert_eq!(json(&stats)["transfer"]["bounces"], 5);
    assert!(json(&stats)["transfer"]["residual"].is_null(), "a truncated sum has none");
}

#[test]
fn a_bake_tells_of_the_transfer_what_a_picture_of_it_does() {
    let folder = folder();
    let [cache, framebuffer, rendered, trace] =
        ["cache", "a.json", "b.json", "t.json"].map(|name| folder.path().join(name));
    let mut command = relume();
    command.arg("bake").arg(shipped("cornell-glossy.glb")).args(SMALL).args(["--gi", "glossy", "--verify", "--cache"]);
    let files = [Path::new("--stats"), &framebuffer, Path::new("--trace"), &trace];
    Run::of(command.arg(&cache).args(files)).done();
    let arguments = ["--gi", "glossy", "--cache", cache.to_str().unwrap(), "--stats", rendered.to_str().unwrap()];
    render(&folder.path().join("a.png"), &arguments).done();
    let [mut framebuffer, rendered] = [framebuffer, rendered].map(|path| json(&path));
    let anew = framebuffer["transfer"]["held_out"].as_object_mut().unwrap().remove("anew").unwrap();
    assert!(["point", "spot"].iter().all(|kind| anew[kind]["error"].as_f64().unwrap() > 0.0), "{anew}");
    for what in ["schema", "relume", "scene", "samples", "transfer"] {
        assert_eq!(framebuffer[what], rendered[what], "{what}");
    }
    assert!(framebuffer["frame"].is_null(), "a bake draws nothing");
    let stages = framebuffer["bake"]["stages"].as_array().unwrap().len();
    let events = json(&trace)["traceEvents"].as_array().unwrap().clone();
    assert_eq!(events.iter().filter(|event| event["cat"] == "bake").count(), stages);
}

#[test]
fn options_that_exclude_each_other() {
    let folder = folder();
    let out = folder.path().join("a.exr");
    let glossy = |arguments: &[&str]| render(&out, &[&["--gi", "glossy"], arguments].concat());
    glossy(&["--basis", "svd8"]).failed(&["--basis", "--method thesis"]);
    glossy(&["--basis", "sh9", "--method", "thesis"]).failed(&["--basis", "--method robust"]);
    glossy(&["--bounces", "inf", "--method", "thesis"]).failed(&["--bounces inf"]);
    glossy(&["--transfer", "nested", "--method", "thesis"]).failed(&["--transfer nested", "dense"]);
    render(&out, &["--gi", "diffuse", "--basis", "sh9"]).failed(&["--basis", "--gi diffuse"]);
    render(&out, &["--gi", "off", "--passes", "indirect"]).failed(&["--passes indirect", "--gi off"]);
    render(&out, &["--gi", "off", "--passes", "beauty,indirect_glossy"]).failed(&["indirect_glossy", "--gi off"]);
    for (option, value) in [("--basis", "sh5"), ("--basis", "svd0"), ("--bounces", "many"), ("--gi", "some")] {
        render(&out, &[option, value]).refused(option);
    }
    assert!(names_in(folder.path()).is_empty(), "refused before anything is written");
}

#[test]
fn a_bake_that_was_killed_goes_on() {
    killed_and_goes_on(&["--transfer", "nested", "--size", "128x96"]);
    killed_and_goes_on(&["--transfer", "dense", "--size", "192x128"]);
    killed_and_goes_on(&["--transfer", "haar", "--size", "192x128"]);
    killed_and_goes_on(&["--method", "thesis", "--size", "192x128"]);
}

/// What a bake makes in two goes is what it makes in one, to the last byte.
fn killed_and_goes_on(form: &[&str]) {
    let folder = folder();
    let bake = |cache: &Path| {
        let mut command = relume();
        command.arg("bake").arg(shipped("cornell-glossy.glb")).args(["-v", "--gi", "glossy", "--threads", "1"]);
        command.args(["--gather", "120", "--rays", "64"]).args(form).arg("--cache").arg(cache);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let in_cache = |cache: &Path, end: &str| -> Vec<PathBuf> {
        let all = fs::read_dir(cache).into_iter().flatten().map(|entry| entry.unwrap().path());
        let mut found: Vec<_> = all.filter(|path| path.to_string_lossy().ends_with(end)).collect();
        found.sort();
        found
    };
    let [whole, stopped] = ["whole", "stopped"].map(|name| folder.path().join(name));
    Run::of(&mut bake(&whole)).done();

    let mut child = bake(&stopped).spawn().unwrap();
    // Until more than the first record is there: its length, a checksum and itself.
    let goes_on = |path: &PathBuf| {
        let mut length = [0; 8];
        let mut file = fs::File::open(path).unwrap();
        let read = file.read_exact(&mut length).is_ok();
        read && file.metadata().unwrap().len() > 40 + u64::from_le_bytes(length)
    };
    while !in_cache(&stopped, ".journal").iter().any(goes_on) {
        assert!(child.try_wait().unwrap().is_none(), "{form:?} ended before it could be killed");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let again = Run::of(&mut bake(&stopped)).done();
    assert!(again.stderr.contains("resumes an interrupted bake"), "{form:?}: {}", again.stderr);
    assert!(in_cache(&stopped, ".journal").is_empty());
    let transfers = [&whole, &stopped].map(|cache| in_cache(cache, ".safetensors"));
    assert_eq!(transfers[0].len(), 2);
    for (a, b) in transfers[0].iter().zip(&transfers[1]) {
        assert_eq!(a.file_name(), b.file_name());
        assert!(fs::read(a).unwrap() == fs::read(b).unwrap(), "{form:?}: {}", a.display());
    }
}
