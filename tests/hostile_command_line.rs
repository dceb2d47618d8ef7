//! Hostile scenes, disks, devices and pipes: the binary ends with status 1 and one line that names input and cause,
//! never in a panic or by a signal, and leaves no file half written.

mod command;
mod support;

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::Stdio;

use command::*;
use serde_json::json;
use support::{Gltf, write};

/// Rendering `scene` fails, says all of `says`, and writes nothing.
#[track_caller]
fn assert_refused(scene: &Path, says: &[&str]) {
    let folder = folder();
    let out = folder.path().join("out/a.png");
    let name = scene.file_name().unwrap().to_string_lossy().into_owned();
    let run = run!("render", scene, "-o", &out, "--no-cache").failed(says);
    assert!(run.stderr.contains(&name), "{}", run.stderr);
    assert_eq!(names_in(folder.path()).len(), 0, "{}", run.stderr);
}

#[test]
fn scenes_that_are_none() {
    let folder = folder();
    let path = folder.path();
    assert_refused(&path.join("none.glb"), &["No such file"]);
    fs::create_dir(path.join("folder.glb")).unwrap();
    assert_refused(&path.join("folder.glb"), &["not a regular file"]);
    assert_refused(&write(path, "scene.txt", b""), &["expected .glb, .gltf or .obj"]);
    let good = fs::read(shipped("cornell-diffuse.glb")).unwrap();
    for length in [0, 3, 11, 12, 19, 500, good.len() / 2, good.len() - 1] {
        assert_refused(&write(path, "short.glb", &good[..length]), &[]);
    }
    assert_refused(&write(path, "malformed.gltf", b"{\"asset\": {\"version\": \"2.0\"}, \"scenes\": ["), &[]);
    assert_refused(&write(path, "malformed.glb", &support::glb(b"not JSON at all", b"")), &[]);
    assert_refused(&write(path, "malformed.obj", b"v 0 0\nf 1 2 3\n"), &[]);
}

#[test]
fn scenes_that_mean_nothing() {
    let folder = folder();
    let refused = |name: &str, says: &[&str], change: &dyn Fn(&mut Gltf)| {
        assert_refused(&Gltf::lit_square(change).write(folder.path(), name), says);
    };
    let out = folder.path().join("good.png");
    run!(
        "render",
        Gltf::lit_square(|_| {}).write(folder.path(), "good.glb"),
        "-o",
        &out,
        "--no-cache",
        "--size",
        "8x8"
    )
    .silent();
    refused("index.glb", &[], &|gltf| {
        gltf.json["meshes"][0]["primitives"][0]["indices"] = 99.into();
    });
    refused("vertex.glb", &[], &|gltf| {
        gltf.json["meshes"][0]["primitives"][0]["indices"] = gltf.indices(&[0, 1, 65_000]).into();
    });
    refused("nan.glb", &[], &|gltf| {
        gltf.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = gltf.f32s(&[[f32::NAN; 3]; 4]).into();
    });
    // Nothing to see is a black picture and says so.
    let empty = |name: &str, change: &dyn Fn(&mut Gltf)| {
        let scene = Gltf::lit_square(change).write(folder.path(), name);
        for gi in ["off", "diffuse", "glossy"] {
            let run = run!("render", &scene, "-o", &out, "--no-cache", "--size", "8x8", "--gi", gi).done();
            assert!(run.stderr.contains("there is nothing to see") && run.stderr.contains(name), "{}", run.stderr);
            assert!(read_png(&out).iter().all(|pixel| pixel[..3] == [0; 3]), "{name}");
        }
    };
    empty("degenerate.glb", &|gltf| {
        gltf.json["meshes"][0]["primitives"][0]["indices"] = gltf.indices(&[0, 0, 0, 1, 2, 1]).into();
    });
    empty("empty.glb", &|gltf| gltf.json["scenes"][0]["nodes"] = json!([1, 2]));
    empty("singular.glb", &|gltf| gltf.json["nodes"][0]["scale"] = json!([0, 1, 1]));
    for odd in [json!(0), json!(-1), json!(1.5), json!("wide"), json!(null), json!(1e300), json!(1_000_000_000)] {
        let scene = Gltf::lit_square(|gltf| gltf.json["scenes"][0]["extras"] = json!({ "width": odd, "height": 9 }));
        let scene = scene.write(folder.path(), "odd.glb");
        let run = run!("plan", &scene, "--no-cache").done();
        assert!(run.stdout.contains("720x480 pixels"), "{odd}: {}", run.stdout);
        assert!(run.warnings().len() == 1 && run.stderr.contains("odd.glb"), "{odd}: {}", run.stderr);
    }
}

#[test]
fn outputs_replace_neither_inputs_nor_each_other() {
    let folder = folder();
    let path = folder.path();
    let scene = Gltf::lit_square(|_| {}).write(path, "scene.glb");
    let map = write(
        path,
        "sky.exr",
        &fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/goldens/cornell-glossy.exr")).unwrap(),
    );
    let rig = "[[light]]\nname = \"sky\"\nkind = \"dome\"\nmap = \"sky.exr\"\nintensity = 1\n";
    let rig = write(path, "rig.toml", rig.as_bytes());
    std::os::unix::fs::symlink("scene.glb", path.join("link")).unwrap();
    let files = || names_in(path).into_iter().map(|name| fs::read(path.join(name)).unwrap()).collect::<Vec<_>>();
    let before = files();
    let [out, stats] = ["a.exr", "a.json"].map(|name| path.join(name));
    let refused = |out: &Path, more: &[&Path], says: &str| {
        let mut command = relume();
        command.arg("render").arg(&scene).arg("--rig").arg(&rig).args(["--no-cache", "--size", "8x8"]);
        Run::of(command.arg("-o").arg(out).args(more)).failed(&[says]);
        assert!(files() == before, "{out:?} {more:?}");
    };
    let [stats_is, trace_is] = ["--stats", "--trace"].map(Path::new);
    refused(&out, &[stats_is, &scene], "scene.glb: is read by this command");
    refused(&out, &[stats_is, &path.join("link")], "link: is read by this command");
    refused(&out, &[trace_is, &rig], "rig.toml: is read by this command");
    refused(&map, &[], "sky.exr: is read by this command");
    refused(
        &out,
        &[stats_is, &path.join("../").join(path.file_name().unwrap()).join("a.exr")],
        "would be written twice",
    );
    refused(&out, &[stats_is, &stats, trace_is, &stats], "a.json: would be written twice");
    render!(&scene, &out, "--stats", "/dev/null", "--trace", "/dev/null").done();
}

#[test]
fn extreme_scenes_render() {
    let folder = folder();
    let out = folder.path().join("a.exr");
    let stats = folder.path().join("stats.json");
    let render = |gltf: Gltf| {
        let scene = gltf.write(folder.path(), "scene.glb");
        render!(&scene, &out, "--passes", "all", "--stats", &stats, "--samples", "4").done();
        assert_eq!(json(&stats)["non_finite"], 0);
        read_exr(&out)
    };
    let light_name = |name: &str| {
        Gltf::lit_square(|g| g.json["extensions"]["KHR_lights_punctual"]["lights"][0]["name"] = name.into())
    };
    render(Gltf::lit_square(|gltf| gltf.json["nodes"][0]["translation"] = json!([1e6, 1e6, 1e6])));
    render(Gltf::lit_square(|gltf| gltf.json["nodes"][0]["scale"] = json!([1e-6, 1e-6, 1e-6])));
    render(Gltf::lit_square(|gltf| gltf.json["nodes"][2]["translation"] = json!([0.5, 0.5, 0.0]))); // on the surface
    render(Gltf::lit_square(|gltf| gltf.json["nodes"][1]["translation"] = json!([0.5, 0.5, 0.0])));
    for name in ["", " ", "a/b", "../../up", "a,b", "a\nb", "light:x", "ä", &"long".repeat(50)] {
        let mut scene = light_name(name);
        scene.json["nodes"][2]["name"] = name.into();
        let image = render(scene);
        assert!(image.layers.iter().any(|layer| layer.name.starts_with("light.")), "{name}");
    }
    let mut scene = light_name("key");
    scene.json["nodes"][2]["name"] = "long".repeat(1000).into();
    let scene = scene.write(folder.path(), "scene.glb");
    render!(&scene, &out).silent();
    render!(&scene, &out, "--passes", "all").failed(&["a.exr", "too long"]);

    // A light's name does not lead out of the folder.
    let mut scene = light_name("../../up");
    scene.json["nodes"][2]["name"] = "../../up".into();
    let scene = scene.write(folder.path(), "scene.glb");
    let deep = folder.path().join("one/two");
    render!(&scene, deep.join("{pass}.png"), "--passes", "all").silent();
    assert_eq!(names_in(&deep), ["beauty.png", "direct.png", "light.______up.png", "reflection.png"]);
    assert_eq!(names_in(&folder.path().join("one")), ["two"]);
}

#[cfg(target_os = "linux")]
#[test]
fn pictures_beyond_all_memory() {
    let folder = folder();
    let scene = shipped("balls-2.glb");
    // 2^28 pixels with some 160 samples each: more than any machine has.
    let out = folder.path().join("a.png");
    let run = run!("render", &scene, "-o", &out, "--no-cache", "--size", "16384x16384", "--samples", "4096");
    run.failed(&["balls-2.glb", "16384x16384", "GB"]);
    assert_eq!(names_in(folder.path()).len(), 0);
    render!(&scene, &out, "--samples", "4096").silent();
}

#[test]
fn outputs_that_cannot_be_written() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let scene = shipped("cornell-diffuse.glb");
    fs::create_dir(path("folder.png")).unwrap();
    fs::write(path("file"), "kept").unwrap();
    render!(&scene, path("folder.png")).failed(&["folder.png", "is a directory"]);
    render!(&scene, path("file/a.png")).failed(&["file"]);
    render!(&scene, "/proc/nosuch/a.png").failed(&["/proc/nosuch"]);
    render!(&scene, "/proc/a.exr").failed(&["/proc/a.exr"]);
    for name in ["a.jpg", "a", "png", "a.png.bak", ".png"] {
        render!(&scene, path(name)).failed(&[name, ".exr or .png"]);
    }
    let out = path("a.png");
    render!(&scene, &out, "--stats", path("file/stats.json")).failed(&["file"]);
    render!(&scene, &out, "--trace", path("folder.png")).failed(&["folder.png"]);
    run!("bench", &scene, "--json", path("file/bench.json"), "--no-cache").failed(&["file"]);
    run!("rig", &scene, "-o", path("file/rig.toml")).failed(&["file"]);
    run!("rig", &scene, "-o", folder.path()).failed(&["is a directory"]);
    assert_eq!(names_in(folder.path()), ["file", "folder.png"]);
    render!(&scene, path("a.exr")).silent();
    for map in ["--diff", "--false-color"] {
        run!("compare", path("a.exr"), path("a.exr"), map, path("file/d.png")).failed(&["file"]);
    }
    assert_eq!(fs::read(path("file")).unwrap(), b"kept");
    assert_eq!(names_in(folder.path()), ["a.exr", "file", "folder.png"]);
}

#[test]
fn a_failed_render_keeps_what_is_there() {
    let folder = folder();
    let out = folder.path().join("a.exr");
    fs::write(&out, "kept").unwrap();
    render!(folder.path().join("none.glb"), &out).failed(&["none.glb"]);
    render!(shipped("balls-2.glb"), &out, "--passes", "light:nosuch").failed(&["nosuch"]);
    render!(shipped("balls-2.glb"), &out, "--device", "nosuch").failed(&["nosuch"]);
    assert_eq!(fs::read(&out).unwrap(), b"kept");
}

#[test]
fn caches_that_are_none() {
    let folder = folder();
    let file = folder.path().join("file");
    fs::write(&file, "kept").unwrap();
    let scene = shipped("balls-2.glb");
    let out = folder.path().join("a.png");
    for cache in [&file, &file.join("cache"), Path::new("/proc/nosuch")] {
        run!("render", &scene, "-o", &out, "--size", "64x48", "--cache", cache).silent();
        // What is there to fill the cache fails where it cannot.
        run!("bake", &scene, "--size", "64x48", "--cache", cache).failed(&[&cache.to_string_lossy()]);
    }
    let mut command = relume();
    command.args(["render", "--size", "64x48", "-o"]).arg(&out).arg(&scene).env("XDG_CACHE_HOME", &file);
    Run::of(&mut command).done(); // Mesa says that it cannot use it either
    run!("bake", "--list", "--cache", &file).failed(&["file"]);
    run!("bake", "--prune", "--cache", &file).failed(&["file"]);
    assert_eq!(fs::read(&file).unwrap(), b"kept");
}

#[test]
fn no_device() {
    let folder = folder();
    let out = folder.path().join("a.png");
    let scene = shipped("balls-2.glb");
    let none = |arguments: &[&str]| {
        let mut command = relume();
        command.args(arguments).args(["--size", "64x48", "--no-cache"]).arg(&scene);
        command.env("VK_DRIVER_FILES", "/nonexistent.json").env("VK_ICD_FILENAMES", "/nonexistent.json");
        Run::of(&mut command)
    };
    none(&["render", "-o", out.to_str().unwrap()]).failed(&["no Vulkan device", "tools/setup"]);
    none(&["bench"]).failed(&["no Vulkan device", "tools/setup"]);
    none(&["plan"]).silent();
    let mut devices = relume();
    devices.arg("devices").env("VK_DRIVER_FILES", "/nonexistent.json").env("VK_ICD_FILENAMES", "/nonexistent.json");
    Run::of(&mut devices).failed(&["no Vulkan device", "tools/setup"]);
    for device in ["nosuch", "99", "-1", ""] {
        let run = render!(&scene, &out, format!("--device={device}"));
        if !device.is_empty() {
            run.failed(&["no Vulkan device", device, "there are: 0 "]);
        }
    }
}

#[test]
fn rigs_that_are_none() {
    let folder = folder();
    let out = folder.path().join("a.png");
    let refused = |text: &[u8], says: &[&str]| {
        let rig = write(folder.path(), "rig.toml", text);
        let run = render!(shipped("balls-2.glb"), &out, "--rig", &rig).failed(says);
        assert!(run.stderr.contains("rig.toml") && !out.exists(), "{}", run.stderr);
    };
    refused(b"[[light]]\nname = \"a\"\nbrightness = 3\n", &["brightness", "3"]);
    refused(b"[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [0,0,0]\nwattage = 3\n", &["wattage", "line 5"]);
    refused(b"[lights]\n", &["lights"]);
    refused(
        b"[[light]]\nname = \"a\"\nkind = \"emitter\"\nmaterial = \"b\"\n",
        &["light \"a\"", "nothing in the scene emits"],
    );
    refused(b"[[light]]\nname = \"a\"\nkind = \"emitter\"\n", &["material", "line 3"]);
    refused(b"[[light]]\nname = \"a\"\nkind = \"dome\"\nmap = \"none.hdr\"\n", &["none.hdr", "4"]);
    refused(
        b"[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [0,0,0]\nradius = -1.0\n",
        &["radius is -1", "line 5"],
    );
    refused(b"[[light]]\nname = \"a\"\nkind = \"sphere\"\nposition = [0,0,0]\n", &["sphere light needs a radius", "3"]);
    refused(b"not TOML", &[]);
    refused(b"\xff\xfe", &["UTF-8"]);
    let none = render!(shipped("balls-2.glb"), &out, "--rig", folder.path().join("none.toml"));
    none.failed(&["none.toml", "No such file"]);
    let folder_rig = render!(shipped("balls-2.glb"), &out, "--rig", folder.path());
    folder_rig.failed(&["not a regular file"]);
    // The second of two is read before the first is rendered.
    let good = folder.path().join("good.toml");
    run!("rig", shipped("balls-2.glb"), "-o", &good).silent();
    let both = render!(shipped("balls-2.glb"), folder.path().join("{rig}.png"), "--rig", &good, "--rig", "none.toml");
    both.failed(&["none.toml"]);
    assert!(!folder.path().join("good.png").exists());
}

#[test]
fn images_that_are_none() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    render!(shipped("balls-2.glb"), path("a.exr")).silent();
    run!("render", shipped("balls-2.glb"), "-o", path("small.exr"), "--size", "32x24", "--no-cache").silent();
    let good = fs::read(path("a.exr")).unwrap();
    fs::write(path("short.exr"), &good[..good.len() / 2]).unwrap();
    fs::write(path("text.exr"), "text").unwrap();
    run!("compare", path("short.exr"), path("a.exr")).failed(&["short.exr"]);
    run!("compare", path("a.exr"), path("text.exr")).failed(&["text.exr"]);
    run!("compare", path("a.exr"), path("small.exr")).failed(&["a.exr", "64x48", "32x24"]);
    run!("compare", path("a.exr"), path("a.exr"), "--mask", path("none.png")).failed(&["none.png"]);
    run!("compare", path("a.exr"), folder.path()).failed(&["not a regular file"]);
}

#[cfg(target_os = "linux")]
#[test]
fn standard_output_and_error_that_take_nothing() {
    let scene = shipped("balls-2.glb");
    let full = || Stdio::from(fs::File::options().write(true).open("/dev/full").unwrap());
    let folder = folder();
    let (out, rig) = (folder.path().join("a.exr"), folder.path().join("rig.toml"));
    render!(&scene, &out).silent();
    let out = out.to_str().unwrap();
    let small = ["--size", "64x48", "--no-cache"];
    let scene = scene.to_str().unwrap();
    for arguments in
        [&["plan", scene][..], &["plan", scene, "--json"], &["bench", scene, "--frames", "1"], &["bake", scene]]
    {
        let run = Run::of(relume().args(arguments).args(small).stdout(full()));
        run.failed(&["standard output", "No space left"]);
    }
    for arguments in [&["compare", out, out][..], &["devices"], &["devices", "--json"]] {
        Run::of(relume().args(arguments).stdout(full())).failed(&["standard output", "No space left"]);
    }
    // A full stderr can be told nothing, but the status tells.
    let status =
        |arguments: &[&str]| without_indirect(relume().args(arguments)).stderr(full()).status().unwrap().code();
    assert_eq!(status(&["render", scene, "-o", out, "--size", "64x48", "--no-cache", "-vv"]), Some(0));
    assert_eq!(status(&["render", "none.glb", "-o", out]), Some(1));
    assert_eq!(status(&["render"]), Some(2));
    // Closed ones.
    let closed = |script: &str| {
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", script, env!("CARGO_BIN_EXE_relume"), scene]).arg(&rig).status().unwrap().code()
    };
    assert_eq!(closed("exec \"$0\" devices >&-"), Some(0));
    assert_eq!(closed("exec \"$0\" rig \"$1\" -o \"$2\" <&- >&- 2>&-"), Some(0));
    assert!(fs::read_to_string(&rig).unwrap().contains("[[light]]"), "closed streams let files take their numbers");
    assert_eq!(closed("exec \"$0\" rig none.glb -o \"$2\" 2>&-"), Some(1));
}

#[cfg(unix)]
#[test]
fn readers_that_leave_early() {
    let folder = folder();
    let bench = ["--frames", "2", "--size", "64x48", "--no-cache", "--gi", "off"];
    let mut child = relume()
        .arg("bench")
        .arg(shipped("balls-2.glb"))
        .args(bench)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap(); // then the pipe closes
    assert!(line.contains("triangles"), "{line}");
    let run = Run::from(child.wait_with_output().unwrap());
    run.silent();

    // With --json the file is what the work is for.
    let json_file = folder.path().join("bench.json");
    let mut child = relume()
        .arg("bench")
        .arg(shipped("balls-2.glb"))
        .args(bench)
        .arg("--json")
        .arg(&json_file)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdout.take().unwrap().read_exact(&mut [0]).unwrap();
    Run::from(child.wait_with_output().unwrap()).silent();
    assert!(json(&json_file)["records"].as_array().unwrap().len() > 8);
}

#[cfg(target_os = "linux")]
#[test]
fn names_that_are_not_utf8() {
    use std::os::unix::ffi::OsStrExt;
    let folder = folder();
    let name = |bytes: &[u8]| folder.path().join(std::ffi::OsStr::from_bytes(bytes));
    let scene = name(b"sc\xffne.glb");
    run!("render", &scene, "-o", "a.png").failed(&["ne.glb", "No such file"]);
    fs::copy(shipped("balls-2.glb"), &scene).unwrap();
    for out in [&b"p\xffcture.png"[..], b"p\xffcture.exr", b"{rig} \xff.exr"] {
        render!(&scene, name(out), "--stats", name(b"\xff.json"), "--trace", name(b"\xfe.json")).silent();
        assert!(name(out).is_file(), "{:?}", names_in(folder.path()));
    }
    assert!(name(b"\xff.json").is_file() && name(b"\xfe.json").is_file());
    let cache = name(b"c\xffche");
    run!("bake", &scene, "--cache", &cache, "--size", "64x48").silent();
    run!("bake", "--list", "--cache", &cache).silent();
    run!("rig", &scene, "-o", name(b"r\xffg.toml")).silent();
    render!(&scene, folder.path().join("{rig}.png"), "--rig", name(b"r\xffg.toml")).silent();
    run!("plan", &scene, "--size", "64x48", "--no-cache").silent();
    let mut odd = relume();
    Run::of(odd.arg("render").arg(&scene).arg("-o").arg("a.png").arg("--camera").arg(name(b"\xff"))).refused("UTF-8");
}

#[test]
fn full_disk() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let (disk, kept, scene) = (path("disk"), path("kept.exr"), shipped("balls-2.glb"));
    fs::create_dir(&disk).unwrap();
    render!(&scene, &kept).silent();
    // 64 KiB hold the small picture that is there, and no large one beside it.
    let script = r#"
        mount -t tmpfs -o size=64k none "$1" || exit 77
        cp "$2" "$1/kept.exr"
        "$0" render "$3" -o "$1/kept.exr" --gi off --size 512x384 --no-cache; echo "image: $?"
        "$0" render "$3" -o "$1/new.png" --gi off --size 1024x768 --no-cache; echo "new image: $?"
        "$0" rig "$3" --rig "$4" -o "$1/new.glb"; echo "scene: $?"
        "$0" bake "$3" --gi off --size 512x384 --cache "$1/cache"; echo "bake: $?"
        "$0" render "$3" -o "$5" --gi off --size 512x384 --cache "$1/cache"; echo "image elsewhere: $?"
        find "$1" -type f -name '*.part' -o -name 'new.*' -o -name 'bake-*'
        cmp "$2" "$1/kept.exr" && echo "the old image is whole""#;
    let (rig, elsewhere) = (path("rig.toml"), path("elsewhere.png"));
    run!("rig", &scene, "-o", &rig).silent();
    let arguments = [&disk, &kept, &scene, &rig, &elsewhere].map(|path| path.as_os_str());
    let Some(run) = with_own_mounts("full disk", script, &arguments) else { return };
    let run = run.sane();
    let said: Vec<_> = run.stdout.lines().collect();
    let want = ["image: 1", "new image: 1", "scene: 1", "bake: 1", "image elsewhere: 0", "the old image is whole"];
    assert_eq!(said, want, "{}", run.stderr);
    let errors: Vec<_> = run.stderr.lines().collect();
    assert_eq!(errors.len(), 4, "{errors:?}");
    for (error, file) in errors.iter().zip(["kept.exr", "new.png", "new.glb", "bake-"]) {
        assert!(error.contains(file) && error.contains("No space left"), "{error}");
    }
    assert!(elsewhere.is_file());
}

#[test]
fn read_only_cache() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let (cache, out, scene) = (path("cache"), path("a.png"), shipped("balls-2.glb"));
    run!("bake", &scene, "--cache", &cache, "--size", "64x48").silent();
    // Root may write where the permissions forbid it, but not into a mount that is read-only.
    let script = r#"
        mount --bind -o ro "$1" "$1" && mount -o remount,bind,ro "$1" || exit 77
        "$0" bake "$2" --cache "$1" --gi off --size 64x48 | grep -c 'from the cache'
        "$0" render "$2" -o "$3" --cache "$1" --gi off --size 64x48; echo "stored before: $?"
        "$0" render "$2" -o "$3" --cache "$1" --gi off --size 32x24; echo "not stored: $?"
        "$0" bake "$2" --cache "$1" --gi off --size 32x24; echo "bake: $?"
        "$0" bake "$2" --cache "$1" --gather 64 --size 64x48; echo "indirect light: $?""#;
    let arguments = [&cache, &scene, &out].map(|path| path.as_os_str());
    let Some(run) = with_own_mounts("read-only cache", script, &arguments) else { return };
    let run = run.sane();
    let said: Vec<_> = run.stdout.lines().collect();
    assert_eq!(said, ["1", "stored before: 0", "not stored: 0", "bake: 1", "indirect light: 1"], "{}", run.stderr);
    assert_eq!(run.stderr.matches("Read-only file system").count(), 2, "{}", run.stderr);
    assert_eq!(run.stderr.lines().count(), 2, "{}", run.stderr);
}
