//! `relume farm`: jobs that Open Job Description's own checker takes and its runner runs.

mod command;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use command::{Run, folder, json, names_in, relume, shipped, with_second_camera};

const SMALL: [&str; 6] = ["--size", "48x32", "--gather", "128", "--rays", "16"];
/// Two cameras, of which one has a name that is none of a file.
const CAMERAS: [&str; 2] = ["camera", "-über uns/2"];

fn rigs(folder: &Path) -> [PathBuf; 2] {
    let light = "[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [0, 1.5, 0]\nintensity = 5\n";
    let dome = "[[light]]\nname = \"sky\"\nkind = \"dome\"\nradiance = [1, 2, 3]\n";
    [("day", dome), ("night", light)].map(|(name, text)| {
        let path = folder.join(name).with_extension("toml");
        fs::write(&path, text).unwrap();
        path
    })
}

/// The runner, where tools/setup or somebody else installed it.
fn openjd(arguments: &[&str]) -> Option<Output> {
    let ours = Path::new(env!("CARGO_MANIFEST_DIR")).join(".deps/openjd/bin/openjd");
    let program = if ours.exists() { ours } else { "openjd".into() };
    let output = Command::new(program).args(arguments).env("XDG_CACHE_HOME", env!("CARGO_TARGET_TMPDIR")).output().ok();
    if output.is_none() {
        println!("not run: jobs of relume farm: openjd is not installed");
    }
    output
}

#[track_caller]
fn succeeds(output: &Output) {
    let said = [&output.stdout[..], &output.stderr].concat();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&said));
}

/// From a bare folder, once with a relume that is killed the first time that it does anything.
#[test]
fn a_job_gives_the_pictures_of_its_shots() {
    let folder = folder();
    let dir = folder.path();
    let scene = with_second_camera("cornell-diffuse.glb", CAMERAS[1], [0.4, 1.2, 2.6], &dir.join("two cameras.glb"));
    let [day, night] = rigs(dir);
    let job = dir.join("job");
    let mut command = relume();
    command.arg("farm").arg(&scene).args(["--cameras", "all", "--lights"]).args([&day, &night]);
    command.args(["--parts", "3", "--threads", "2", "-o"]).arg(&job).arg("--").args(SMALL);
    let told = Run::of(&mut command).done().stdout;
    assert!(told.contains("2 shots, 14 tasks"), "{told}");
    let template = job.join("template.json");
    let template = template.to_str().unwrap();
    let Some(checked) = openjd(&["check", template]) else { return };
    succeeds(&checked);
    let relume_is = |program: &str| format!("Relume={program}");
    let own = relume_is(env!("CARGO_BIN_EXE_relume"));
    let all = ["run", template, "--step", "Pictures", "--run-dependencies", "-p"];
    if cfg!(unix) {
        let flaky = dir.join("flaky");
        let once = dir.join("once");
        fs::create_dir(&once).unwrap();
        let script = format!(
            "#!/bin/sh\nmark=\"{}/$(echo \"$*\" | cksum | cut -d' ' -f1)\"\n[ \"$1\" = --version ] || [ -e \"$mark\" ] || {{ touch \"$mark\"; \"{}\" \"$@\" & sleep 0.2; kill -9 $!; exit 1; }}\nexec \"{1}\" \"$@\"\n",
            once.display(),
            env!("CARGO_BIN_EXE_relume")
        );
        fs::write(&flaky, script).unwrap();
        Command::new("chmod").arg("+x").arg(&flaky).status().unwrap();
        let flaky = relume_is(flaky.to_str().unwrap());
        // Each run gets one task further, as a farm does that tries failed tasks again.
        let runs = (0..20).find(|_| openjd(&[&all[..], &[&flaky]].concat()).unwrap().status.success());
        assert!(runs.is_some_and(|runs| runs == 14), "{runs:?} runs failed");
    }
    succeeds(&openjd(&[&all[..], &[&own]].concat()).unwrap());
    let shots = ["two_cameras.camera", "two_cameras.-über_uns_2"];
    let mut pictures: Vec<String> =
        shots.iter().flat_map(|shot| ["day", "night"].map(|rig| format!("{shot}.{rig}.exr"))).collect();
    pictures.sort();
    assert_eq!(names_in(&job.join("pictures")), pictures);
    for (shot, camera) in shots.iter().zip(CAMERAS) {
        let out = dir.join("alone.{rig}.exr");
        let mut command = relume();
        command
            .arg("render")
            .arg(&scene)
            .args(["--no-cache", "--gi", "glossy", "--rig"])
            .arg(&day)
            .arg(format!("--camera={camera}"));
        Run::of(command.arg("--rig").arg(&night).args(SMALL).arg("-o").arg(out)).done();
        for rig in ["day", "night"] {
            let [alone, farmed] =
                [dir.join(format!("alone.{rig}.exr")), job.join(format!("pictures/{shot}.{rig}.exr"))]
                    .map(|path| fs::read(path).unwrap());
            assert!(alone == farmed, "{shot} {rig}");
        }
    }
}

#[test]
fn a_job_asks_for_what_a_bake_takes() {
    let folder = folder();
    let job = folder.path().join("job");
    let requirements = |size: &str| {
        let mut command = relume();
        command.arg("farm").arg(shipped("balls-2.glb")).arg("-o").arg(&job).args(["--", "--size", size]);
        Run::of(&mut command).done();
        let template = json(&job.join("template.json"));
        let step = &template["steps"][2];
        let [vcpu, memory] = [0, 1].map(|i| step["hostRequirements"]["amounts"][i]["min"].as_f64().unwrap());
        (vcpu, memory, step["script"]["actions"]["onRun"]["timeout"].as_u64().unwrap())
    };
    let (small, large) = (requirements("160x120"), requirements("7680x4320"));
    assert!(small.0 == 4.0 && large.0 == 4.0);
    assert!(small.1 > 300.0 && large.1 > 10.0 * small.1, "{small:?} {large:?}");
    assert!(small.2 == 3600 && large.2 > 3600, "{small:?} {large:?}");
}

#[test]
fn what_is_no_job_is_told() {
    let folder = folder();
    let job = folder.path().join("job");
    let run = |arguments: &[&str]| {
        let mut command = relume();
        command.arg("farm").arg(shipped("balls-2.glb")).arg("-o").arg(&job).args(arguments);
        Run::of(&mut command)
    };
    run(&["--cameras", "none"]).failed(&["none"]);
    run(&["--", "--sise", "3x3"]).refused("--sise");
    run(&["--", "--size", "3by3"]).refused("WIDTHxHEIGHT");
    run(&["--parts", "0"]).refused("--parts");
    run(&["--", "--threads", "3"]).failed(&["the job sets", "--threads"]);
    run(&["--", "--no-cache"]).failed(&["the job sets", "--cache"]);
    run(&["--", "--gi", "off"]).failed(&["only nested blocks"]);
    run(&["--", "--transfer", "dense"]).failed(&["only nested blocks"]);
    let rig = folder.path().join("a.toml");
    fs::write(&rig, "").unwrap();
    let rig = rig.to_str().unwrap();
    run(&["--lights", rig, rig]).failed(&["two rigs would have pictures called a"]);
    run(&["--lights", "missing.toml"]).failed(&["missing.toml"]);
    let scene = shipped("balls-2.glb");
    run(&["--", scene.to_str().unwrap()]).refused("unexpected argument");
    run(&["--report", "quick", "--", "--gather", "99", "--seed", "3"]).done();
    let template = json(&job.join("template.json"));
    let step = template["steps"].as_array().unwrap().last().unwrap();
    assert_eq!((&step["name"], &step["dependencies"][0]["dependsOn"]), (&"Report".into(), &"Plan".into()));
    let arguments = step["script"]["actions"]["onRun"]["args"].to_string();
    assert!(arguments.contains("--seed") && !arguments.contains("--gather"), "{arguments}");
    fs::remove_dir_all(&job).unwrap();
    let mut command = relume();
    command.arg("farm").arg(&scene).arg(&scene).arg("-o").arg(&job);
    Run::of(&mut command).failed(&["two shots would have pictures called balls-2"]);
    assert!(!job.exists());
}

#[test]
fn all_cameras_are_rendered_one_after_the_other() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let scene = with_second_camera("balls-2.glb", CAMERAS[1], [-1.5, 1.6, 4.0], &path("two.glb"));
    let render = |camera: &str, output: &str, more: &[&str]| {
        let mut command = relume();
        command.arg("render").arg(&scene).arg("--no-cache").arg(format!("--camera={camera}")).args(SMALL).args(more);
        Run::of(command.arg("-o").arg(path(output)))
    };
    render("all", "all.{camera}.exr", &[]).done();
    for (camera, file) in [(CAMERAS[0], "all.camera.exr"), (CAMERAS[1], "all.-über_uns_2.exr")] {
        render(camera, "alone.exr", &[]).done();
        assert!(fs::read(path(file)).unwrap() == fs::read(path("alone.exr")).unwrap(), "{file}");
    }
    // Exposure is that of the first camera.
    render("all", "all.{camera}.png", &[]).done();
    assert!(path("all.camera.png").exists() && path("all.-über_uns_2.png").exists());
    render("all", "all.exr", &[]).failed(&["needs {camera}"]);
    let stats = path("stats.json");
    render("all", "all.{camera}.exr", &["--stats", stats.to_str().unwrap()]).failed(&["--camera all", "one camera"]);
    let bake = |more: &[&str]| {
        let mut command = relume();
        command.arg("bake").arg(&scene).args(["--camera", "all", "--cache"]).arg(path("cache")).args(SMALL).args(more);
        Run::of(&mut command)
    };
    let told = bake(&[]).done().stdout;
    assert!(told.contains("camera camera\n") && told.contains("camera -über uns/2\n"), "{told}");
    assert_eq!(names_in(&path("cache")).iter().filter(|name| name.starts_with("bake-")).count(), 2);
    bake(&["--part", "1/2", "-o", "x"]).failed(&["of one camera"]);
    let mut command = relume();
    command.args(["render", "--camera", "all", "-o", "{camera}.exr"]).arg(shipped("README.md").with_extension("obj"));
    Run::of(&mut command).failed(&["README.obj"]);
}
