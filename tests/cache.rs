//! What is kept on disk: taken if it is whole and fits, else made anew; whoever else is writing.

mod command;

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant, SystemTime};

use command::{Run, folder, json, names_in, relume, shipped};
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::bake::{BakeSettings, bake, cache};
use relume::scene::Scene;
use relume::storage::journal::Journal;
use relume::trace::bvh::TracedScene;

/// Few samples and rays: what is tested does not depend on them.
const SMALL: [&str; 8] = ["--gather", "60", "--rays", "16", "--size", "32x24", "--gi", "diffuse"];

fn bakes_in(cache: &Path) -> Vec<PathBuf> {
    names_in(cache).iter().filter(|name| name.starts_with("bake-")).map(|name| cache.join(name)).collect()
}

/// One flipped bit at a time, anywhere, and files that end early or late.
#[test]
fn only_whole_files_are_taken() {
    let folder = folder();
    let dir = folder.path();
    let scene = TracedScene::new(Scene::load(&shipped("cornell-glossy.glb")).unwrap());
    let camera = &scene.cameras[0];
    let settings = BakeSettings { width: 24, height: 16, layers: 4, samples: 1 };
    let framebuffer = bake(&scene, camera, &scene.rig, &settings, &|_| ());
    let of_transfer = TransferSettings {
        outgoing: Outgoing::Diffuse,
        samples: 40,
        paths: TransferSettings::paths_for(40),
        coarse_samples: 20,
        points: 2,
        rays: 16,
        layers: 4,
        bounces: None,
        seed: 1,
    };
    let transfer = LightTransport::new(&scene, &framebuffer, &of_transfer, &|_| ());
    let compression = CompressionSettings { error: 0.1, lights: 32, lobe: Lobe::All, seed: 1 };
    let transfer = Transfer::nested(&transfer, &compression, &mut Journal::default(), &|_| ()).unwrap();

    let inputs = cache::Inputs::of(&scene, camera, &scene.rig, &settings);
    let key = inputs.key();
    cache::store(dir, &inputs, "a", &framebuffer).unwrap();
    let of_framebuffer = bakes_in(dir).remove(0);
    let transfer_key = cache::transfer_key(&key, &"settings");
    cache::store_transfer(dir, &transfer_key, "a", &framebuffer, &transfer).unwrap();
    let of_transfer = bakes_in(dir).into_iter().find(|path| *path != of_framebuffer).unwrap();

    let load = || cache::load(dir, &key, camera, &settings).map(|b| b.samples.len());
    let load_transfer = || cache::load_transfer(dir, &transfer_key, &framebuffer).map(|t| t.cost());
    assert!(load() == Some(framebuffer.samples.len()) && load_transfer() == Some(transfer.cost()));
    let stays_out = |path: &Path, absent: &dyn Fn() -> bool| {
        let good = fs::read(path).unwrap();
        let check = |bytes: &[u8], what: &str| {
            // Beside and renamed, as all files of the cache are.
            let mut beside = tempfile::NamedTempFile::new_in(dir).unwrap();
            beside.write_all(bytes).unwrap();
            beside.persist(path).unwrap();
            assert!(absent(), "{what} of {} bytes", good.len());
        };
        let header = u64::from_le_bytes(good[..8].try_into().unwrap()) as usize + 8;
        let data = (header..good.len()).step_by((good.len() - header) / 97);
        for place in (0..header).chain(data).chain([good.len() - 1]) {
            let mut flipped = good.clone();
            flipped[place] ^= 1 << (place % 7);
            check(&flipped, &format!("a flipped bit in byte {place}"));
        }
        for end in [0, 7, 8, header - 1, header, header + 1, good.len() / 2, good.len() - 1] {
            check(&good[..end], "the beginning");
        }
        check(&[&good[..], &[0]].concat(), "more than all");
        fs::write(path, &good).unwrap();
        assert!(!absent());
    };
    stays_out(&of_framebuffer, &|| load().is_none());
    stays_out(&of_transfer, &|| load_transfer().is_none());
    // A file under another's name fits its own key alone.
    fs::copy(&of_framebuffer, &of_transfer).unwrap();
    assert!(load_transfer().is_none());
}

/// A picture by its bytes, whether all of its bake was cached, and what was said.
struct Rendered {
    bytes: Vec<u8>,
    cached: bool,
    run: Run,
}

fn render(folder: &Path, scene: &Path, arguments: &[&str]) -> Rendered {
    let (out, stats) = (folder.join("a.exr"), folder.join("a.json"));
    let mut command = relume();
    command.arg("render").arg(scene).arg("-o").arg(&out).args(SMALL).args(arguments);
    let run = Run::of(command.arg("--cache").arg(folder.join("cache")).arg("--stats").arg(&stats)).done();
    Rendered { bytes: fs::read(out).unwrap(), cached: json(&stats)["bake"]["cached"] == true, run }
}

/// The rig says the scene's camera in other numbers.
#[test]
fn a_scenes_own_rig_finds_its_bake() {
    let folder = folder();
    let rig = folder.path().join("own.toml");
    for scene in ["balls-2.glb", "cornell-glossy.glb", "statues-16.glb"].map(shipped).iter().filter(|s| s.exists()) {
        run!("rig", scene, "-o", &rig).done();
        assert!(!render(folder.path(), scene, &[]).cached);
        assert!(render(folder.path(), scene, &["--rig", rig.to_str().unwrap()]).cached, "{}", scene.display());
    }
}

#[test]
fn one_line_says_why_a_bake_is_made_anew() {
    let folder = folder();
    let render = || render(folder.path(), &shipped("cornell-glossy.glb"), &[]);
    let first = render();
    let files = bakes_in(&folder.path().join("cache"));
    assert!(!first.cached && files.len() == 2);
    let [framebuffer, transfer] = &files[..] else { unreachable!("there are two") };
    let change = |path: &Path, change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = fs::read(path).unwrap();
        change(&mut bytes);
        fs::write(path, bytes).unwrap();
    };
    let other_version = |bytes: &mut Vec<u8>| {
        let field = b"\"relume\":\"";
        let place = bytes.windows(field.len()).position(|w| w == field).unwrap() + field.len();
        bytes[place] ^= 1;
    };
    let middle_flipped = |bytes: &mut Vec<u8>| {
        let middle = bytes.len() / 2;
        bytes[middle] ^= 4;
    };
    let cut_off = |bytes: &mut Vec<u8>| bytes.truncate(bytes.len() - 4);
    // Both at once, that there are few bakes: each must be told of by itself.
    for (first_change, second_change, reasons) in [
        (&other_version as &dyn Fn(&mut Vec<u8>), &cut_off as &dyn Fn(&mut Vec<u8>), ["another version", "damaged"]),
        (&middle_flipped, &other_version, ["damaged", "another version"]),
    ] {
        change(framebuffer, first_change);
        change(transfer, second_change);
        let again = render();
        assert!(!again.cached && again.bytes == first.bytes);
        let warnings = again.run.warnings();
        assert_eq!(warnings.len(), 2, "{}", again.run.stderr);
        for (path, reason) in [framebuffer, transfer].into_iter().zip(reasons) {
            let name = path.file_name().unwrap().to_str().unwrap();
            assert!(warnings.iter().any(|w| w.contains(name) && w.contains(reason)), "{}", again.run.stderr);
        }
        let mended = render();
        assert!(mended.cached && mended.bytes == first.bytes && mended.run.stderr.is_empty());
    }
}

#[test]
fn another_vertex_is_another_bake_and_other_lights_are_not() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let write = |top: f64| {
        // A floor and a wall, one corner of which moves.
        let corners = format!("v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv -1 2 -1\nv 1 {top} -1\n");
        fs::write(path("a.obj"), corners + "f 4 3 2 1\nf 1 2 6 5\n").unwrap();
    };
    let light = |x: f64| {
        let camera = "[camera]\nposition = [0.3, 1.5, 4]\ntarget = [0, 0.8, 0]\nup = [0, 1, 0]\nyfov_deg = 40.0\n";
        let light = format!("[[light]]\nname = \"a\"\nkind = \"point\"\nposition = [{x}, 1, 0.4]\nintensity = 3.0\n");
        fs::write(path("rig.toml"), camera.to_owned() + &light).unwrap();
    };
    let rig = path("rig.toml");
    let render = || render(folder.path(), &path("a.obj"), &["--rig", rig.to_str().unwrap()]);
    write(2.0);
    light(0.2);
    let first = render();
    assert!(!first.cached);
    light(-0.3);
    let other_light = render();
    assert!(other_light.cached && other_light.bytes != first.bytes);
    write(2.001);
    let other_vertex = render();
    assert!(!other_vertex.cached && other_vertex.run.stderr == other_light.run.stderr, "{}", other_vertex.run.stderr);
    assert_eq!(bakes_in(&path("cache")).len(), 4);
    write(2.0);
    let back = render();
    assert!(back.cached && back.bytes == other_light.bytes);
}

#[test]
fn two_at_once_are_both_right() {
    let folder = folder();
    let cache = folder.path().join("cache");
    let outs = ["a.exr", "b.exr"].map(|name| folder.path().join(name));
    let start = |out: &PathBuf| {
        let mut command = relume();
        command.arg("render").arg(shipped("cornell-glossy.glb")).arg("-o").arg(out).args(SMALL);
        command.arg("--cache").arg(&cache).stderr(std::process::Stdio::piped()).spawn().unwrap()
    };
    for process in [start(&outs[0]), start(&outs[1])] {
        Run::from(process.wait_with_output().unwrap()).silent();
    }
    let [a, b] = outs.map(|out| fs::read(out).unwrap());
    assert!(a == b);
    assert_eq!(bakes_in(&cache).len(), 2);
    assert!(!names_in(&cache).iter().any(|name| name.ends_with(".part")), "{:?}", names_in(&cache));
    let third = render(folder.path(), &shipped("cornell-glossy.glb"), &[]);
    assert!(third.cached && third.bytes == a);
}

/// Of a file larger than memory.
#[test]
fn listing_reads_headers_alone() {
    let folder = folder();
    let floats = 1u64 << 38;
    let metadata = r#""__metadata__":{"scene":"huge","what":"transfer","width":"7","height":"5"}"#;
    let header =
        format!(r#"{{{metadata},"a":{{"dtype":"F32","shape":[{floats}],"data_offsets":[0,{}]}}}}"#, 4 * floats);
    let mut file = File::create(folder.path().join("bake-1.safetensors")).unwrap();
    file.write_all(&(header.len() as u64).to_le_bytes()).unwrap();
    file.write_all(header.as_bytes()).unwrap();
    if let Err(error) = file.set_len(8 + header.len() as u64 + 4 * floats) {
        println!("not run: listing of a file of a terabyte: {error}");
        return;
    }
    let listed = run!("bake", "--list", "--cache", folder.path()).silent().stdout;
    assert!(listed.contains("1099511.6 MB") && listed.contains("7x5") && listed.contains("huge"), "{listed}");
}

/// What a bake does not depend on finds it again; what it depends on is named.
#[test]
fn a_bake_says_what_changed() {
    let folder = folder();
    let dir = folder.path();
    let load = || Scene::load(&shipped("cornell-glossy.glb")).unwrap();
    let settings = BakeSettings { width: 24, height: 16, layers: 4, samples: 1 };
    let inputs = |scene: &Scene| cache::Inputs::of(scene, &scene.cameras[0], &scene.rig, &settings);
    let scene = load();
    let first = inputs(&scene);
    assert_eq!(first.changes(dir, "a"), None, "there is no bake yet");
    let traced = TracedScene::new(load());
    let framebuffer = bake(&traced, &scene.cameras[0], &scene.rig, &settings, &|_| ());
    cache::store(dir, &first, "a", &framebuffer).unwrap();
    let changed = |edit: &dyn Fn(&mut Scene)| {
        let mut scene = load();
        edit(&mut scene);
        let inputs = inputs(&scene);
        ((inputs.key() != first.key()).then(|| inputs.changes(dir, "a").expect("it names what changed")), inputs)
    };
    let names: Vec<String> = scene.materials.iter().map(|material| material.name.clone()).collect();
    assert_eq!(changed(&|scene| scene.materials[0].name = "other".into()).0, None);
    assert_eq!(changed(&|scene| scene.rig.lights[0].intensity = 7.0).0, None);
    let repainted = changed(&|scene| scene.materials[1].base_color.x = 0.123);
    assert_eq!(repainted.0, Some(format!("the material \"{}\"", names[1])));
    assert_eq!(changed(&|scene| scene.cameras[0].position.y += 0.01).0, Some("the camera".into()));
    let all = changed(&|scene| {
        scene.mesh.positions[0].x += 0.01;
        scene.materials.iter_mut().for_each(|material| material.roughness = 0.77);
    });
    assert_eq!(all.0, Some(format!("geometry, {} of {0} materials", names.len())));
    assert_eq!(all.1.changes(dir, "b"), None, "another scene's bake is no earlier one");
    // Of several earlier bakes the most similar one counts.
    cache::store(dir, &all.1, "a", &framebuffer).unwrap();
    assert_eq!(repainted.1.changes(dir, "a"), Some(format!("the material \"{}\"", names[1])));

    let bake = |size: &str| {
        let mut command = relume();
        command.arg("bake").arg(shipped("balls-2.glb")).args(["--gi", "off", "--size", size, "--cache"]).arg(dir);
        Run::of(&mut command).done().stdout
    };
    assert!(!bake("32x24").contains("baked again"));
    assert!(bake("33x24").contains("what changed since: the size of the picture"));
    assert!(!bake("32x24").contains("baked again"), "it is in the cache");
}

fn bake_command(cache: &Path, arguments: &[&str]) -> Run {
    Run::of(relume().arg("bake").args(arguments).arg("--cache").arg(cache))
}

/// Makes a file of the cache as old as so many days.
fn aged(path: &Path, days: u64) {
    let then = SystemTime::now() - Duration::from_secs(days * 86400 + 60);
    File::options().write(true).open(path).unwrap().set_modified(then).unwrap();
}

#[test]
fn files_are_listed_and_pruned_by_last_use() {
    let folder = folder();
    let cache = folder.path().join("cache");
    let sizes = ["32x24", "33x24", "34x24"];
    let bake = |size: &str| {
        let scene = shipped("balls-2.glb");
        bake_command(&cache, &[scene.to_str().unwrap(), "--gi", "off", "--size", size]).done();
    };
    sizes.iter().for_each(|size| bake(size));
    let listed = || bake_command(&cache, &["--list"]).silent().stdout;
    let path_of = |size: &str| {
        let listed = listed();
        let line = listed.lines().find(|line| line.contains(size)).unwrap();
        PathBuf::from(line.split_whitespace().last().unwrap())
    };
    let paths = sizes.map(path_of);
    [3, 1, 2].iter().zip(&paths).for_each(|(days, path)| aged(path, *days));
    let order: Vec<String> =
        listed().lines().take(3).map(|line| line.split_whitespace().nth(2).unwrap().into()).collect();
    assert_eq!(order, ["1d", "2d", "3d"], "{}", listed());
    assert!(listed().contains("MB in 3 files of"), "{}", listed());
    // A bake that is used is young again, listing is no use.
    bake(sizes[0]);
    let there = || paths.each_ref().map(|path| path.exists());
    assert!(bake_command(&cache, &["--prune", "--older-than", "36h"]).done().stdout.contains("removed 1 files"));
    assert_eq!(there(), [true, true, false]);
    let bytes = paths[0].metadata().unwrap().len().to_string();
    assert!(bake_command(&cache, &["--prune", "--keep", &bytes]).done().stdout.contains("removed 1 files"));
    assert_eq!(there(), [true, false, false]);
    bake_command(&cache, &["--prune", "--older-than", "1d", "--keep", "1G"]).done();
    assert_eq!(there(), [true, false, false]);
    let in_use = File::open(&paths[0]).unwrap();
    in_use.lock_shared().unwrap();
    assert!(bake_command(&cache, &["--prune"]).done().stdout.contains("removed 0 files, 0.0 MB, from"));
    assert!(bake_command(&cache, &["--prune"]).done().stdout.contains("; 1 are in use"));
    assert_eq!(there(), [true, false, false]);
    drop(in_use);
    bake_command(&cache, &["--prune"]).done();
    assert_eq!(there(), [false, false, false]);
    for wrong in ["12", "h", "1.5.2d", "1w"] {
        bake_command(&cache, &["--prune", "--older-than", wrong]).refused("--older-than");
    }
    bake_command(&cache, &["--list", "--keep", "1G"]).refused("--list");
}

#[test]
fn a_file_of_another_version_is_listed_as_such() {
    let folder = folder();
    let scene = shipped("balls-2.glb");
    bake_command(folder.path(), &[scene.to_str().unwrap(), "--gi", "off", "--size", "32x24"]).done();
    let path = bakes_in(folder.path()).remove(0);
    let mut bytes = fs::read(&path).unwrap();
    let field = b"\"relume\":\"";
    let place = bytes.windows(field.len()).position(|w| w == field).unwrap() + field.len();
    bytes[place] ^= 1;
    fs::write(&path, bytes).unwrap();
    fs::write(folder.path().join("bake-1.safetensors"), "nothing").unwrap();
    let listed = bake_command(folder.path(), &["--list"]).silent().stdout;
    assert!(listed.contains("deep framebuffer of another version") && listed.contains("damaged"), "{listed}");
}

/// Twenty processes at a time read, write and prune one folder: each picture has the right bytes, and no file goes that
/// nobody wanted to go.
#[test]
fn a_shared_folder_gives_no_wrong_byte() {
    let folder = folder();
    let cache = folder.path().join("cache");
    let seconds = if std::env::var_os("RELUME_FULL").is_some() { 300 } else { 3 };
    let scenes = ["balls-2.glb", "cornell-glossy.glb", "cornell-diffuse.glb"].map(shipped);
    let render = |number: usize, scene: &Path| {
        let out = folder.path().join(format!("{number}.exr"));
        let mut command = relume();
        command.arg("render").arg(scene).arg("-o").arg(&out).args(SMALL).args(["--threads", "1"]);
        Run::of(command.arg("--cache").arg(&cache)).silent();
        fs::read(out).unwrap()
    };
    let want: Vec<Vec<u8>> = scenes.iter().map(|scene| render(0, scene)).collect();
    let all = bakes_in(&cache);
    let work = |prunes: &[&[&str]]| {
        let end = Instant::now() + Duration::from_secs(seconds);
        let runs = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for number in 0..20 {
                let (runs, want, scenes, cache) = (&runs, &want, &scenes, &cache);
                scope.spawn(move || {
                    while Instant::now() < end {
                        let run = runs.fetch_add(1, Ordering::Relaxed);
                        match number {
                            0 => drop(bake_command(cache, &["--list"]).silent()),
                            1 | 2 => drop(bake_command(cache, prunes[run % prunes.len()]).silent()),
                            _ => assert!(render(number, &scenes[run % 3]) == want[run % 3], "run {run}"),
                        }
                    }
                });
            }
        });
        println!("{} runs", runs.into_inner());
    };
    work(&[&["--prune"], &["--prune", "--keep", "100K"]]);
    scenes.iter().for_each(|scene| drop(render(0, scene)));
    work(&[&["--prune", "--older-than", "1h"], &["--prune", "--keep", "1G"]]);
    assert_eq!(bakes_in(&cache), all, "no file is lost, and none is left over");
}
