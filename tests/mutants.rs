//! Thousands of damaged files for each importer that takes text or binary of ours: rigs, event scripts, cache files
//! whose checksum is right. Each ends as something sound or in one error that names the file. tests/hostile_scenes.rs
//! has scenes, tests/image_files.rs has images, tests/cache.rs cache files whose checksum tells.

mod common;

use std::path::Path;

use common::random::Random;
use common::{mutants, shipped, transfer};
use glam::DVec3;
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::bake::{BakeSettings, bake, cache};
use relume::scene::{MeshSpace, Rig, Scene};
use relume::storage::journal::Journal;
use relume::trace::bvh::TracedScene;
use relume::view::input::script::Script;

/// A text with numbers replaced; or with words, lines and bytes replaced, repeated or left out.
fn damaged(random: &mut Random, good: &str) -> Vec<u8> {
    let numbers = ["0", "-1", "2", "1e308", "-1e-308", "nan", "-inf", "90", "179.99", "18446744073709551616", "0.1.2"];
    let words = ["", "true", "[", "]", "{}", "\"", "[[light]]", "[[]]", "=", "#", "key", "up", "left", "\u{feff}"];
    let mut lines: Vec<String> = good.lines().map(str::to_owned).collect();
    let only_numbers = random.below(2) == 0;
    for _ in 0..=random.below(2) {
        let (at, other) = (random.below(lines.len()), random.below(lines.len()));
        match if only_numbers { 5 } else { random.below(5) } {
            0 => lines[at] = lines[other].clone(),
            1 => lines.insert(at, lines[other].clone()),
            2 => lines[at].clear(),
            kind => {
                let mut parts: Vec<&str> = lines[at].split(' ').collect();
                let part = random.below(parts.len());
                let number = parts[part].trim_matches([',', '[', ']']);
                let replaced = match number.parse::<f64>() {
                    Ok(_) if kind > 2 => parts[part].replace(number, random.pick(&numbers)),
                    _ if only_numbers => parts[part].to_owned(),
                    _ => random.pick(&words).to_owned(),
                };
                parts[part] = &replaced;
                lines[at] = parts.join(" ");
            }
        }
    }
    let mut bytes = lines.join("\n").into_bytes();
    if only_numbers {
        return bytes;
    }
    for _ in 0..random.below(3) {
        let at = random.below(bytes.len().max(1));
        if let Some(byte) = bytes.get_mut(at) {
            *byte = random.pick(&[0, 9, 10, 34, 46, 91, 127, 195, 255]);
        }
    }
    if random.below(8) == 0 {
        bytes.truncate(random.below(bytes.len().max(1)));
    }
    bytes
}

/// One line that names the file.
fn assert_names(error: &relume::Error, path: &Path) {
    let text = error.to_string();
    assert!(text.contains(path.file_name().unwrap().to_str().unwrap()) && !text.contains('\n'), "{text}");
}

#[test]
fn rigs() {
    let folder = tempfile::tempdir().unwrap();
    let [path, again] = ["damaged.toml", "again.toml"].map(|name| folder.path().join(name));
    let mut random = Random::new(3);
    std::fs::write(&path, EXAMPLE).unwrap();
    Rig::load(&path).unwrap();
    let mut taken = 0;
    for _ in 0..mutants() {
        std::fs::write(&path, damaged(&mut random, EXAMPLE)).unwrap();
        match Rig::load(&path) {
            Err(error) => assert_names(&error, &path),
            Ok(rig) => {
                taken += 1;
                for light in &rig.lights {
                    let packed = light.pack(MeshSpace::WORLD);
                    assert!(packed.direction.is_finite() && packed.inverse_range.is_finite(), "{light:?}");
                    assert!(light.scale().is_finite() && light.position.is_finite(), "{light:?}");
                }
                rig.save(&again).unwrap();
                let read = Rig::load(&again).unwrap();
                assert_eq!((read.lights, read.groups), (rig.lights, rig.groups));
            }
        }
    }
    assert!(taken > mutants() / 20, "only {taken} were taken: they do not get far");
}

const EXAMPLE: &str = r#"
[camera]
position = [0, 1, 3.6]
target = [0, 1, 0]
up = [0, 1, 0]
yfov_deg = 42.0

[[group]]
name = "rim"
stops = 0.5
color = [1, 1, 1]

[[light]]
name = "key"
kind = "spot"
position = [2.8, 3.8, 1.5]
direction = [-0.6, -0.7, -0.3]
color = [1.0, 0.95, 0.9]
intensity = 60.0
inner_deg = 18.0
outer_deg = 28.0
range = 10.0
group = "rim"

[[light]]
name = "sun"
kind = "directional"
direction = [0, -1, 0.5]
kelvin = 5600
intensity = 3
stops = -1
"#;

#[test]
fn event_scripts() {
    let folder = tempfile::tempdir().unwrap();
    let [path, again] = ["damaged.script", "again.script"].map(|name| folder.path().join(name));
    let mut random = Random::new(4);
    let good = "# drags\n0 key Tab\n0.1 press A\n0.2 repeat A\n0.3 release A\n0.4 mouse 320.5 240\n0.5 down left\n\
                0.6 mouse 10 -20\n0.7 up left\n0.8 wheel 0 -1\n0.9 text \"rim light\"\n1 key Ctrl+Shift+Z\n1.5 key Ctrl+Q\n";
    let mut taken = 0;
    for _ in 0..mutants() {
        std::fs::write(&path, damaged(&mut random, good)).unwrap();
        match Script::load(&path) {
            Err(error) => assert_names(&error, &path),
            Ok(script) => {
                taken += 1;
                assert!(script.events.is_sorted_by_key(|(time, _)| *time));
                script.save(&again).unwrap();
                Script::load(&again).unwrap();
            }
        }
    }
    assert!(taken > mutants() / 20, "only {taken} were taken: they do not get far");
}

/// The file under a checksum of its own again, as someone would make it who means harm.
fn resealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let at = find(&bytes, b"\"blake3\":\"").expect("mutants leave it alone") + 10;
    bytes[at..at + 64].fill(b'0');
    let checksum = blake3::hash(&bytes[8..]);
    assert!(at + 64 <= 8 + length);
    bytes[at..at + 64].copy_from_slice(checksum.to_hex().as_bytes());
    bytes
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}

/// What a cache file holds is followed only where it leads somewhere, even if the file's checksum is right.
#[test]
fn cache_files_with_the_right_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let scene = TracedScene::new(Scene::load(&shipped("cornell-glossy.glb")).unwrap());
    let settings = BakeSettings { width: 16, height: 16, layers: 4, samples: 1 };
    let framebuffer = bake(&scene, &scene.cameras[0], &scene.rig, &settings, &|_| ());
    let inputs = cache::Inputs::of(&scene, &scene.cameras[0], &scene.rig, &settings);
    let key = inputs.key();
    cache::store(dir, &inputs, "a", &framebuffer).unwrap();
    let files = || -> Vec<_> { std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect() };
    let of_framebuffer = files().remove(0);
    let of_transfer = TransferSettings {
        outgoing: Outgoing::Glossy { functions: Some(4) },
        points: 2,
        ..transfer::settings(24, 12, 16)
    };
    let transfer = LightTransport::new(&scene, &framebuffer, &of_transfer, &|_| ());
    let compression = CompressionSettings { error: 0.3, lights: 32, lobe: Lobe::All, seed: 1 };
    let transfer = Transfer::nested(&transfer, &compression, &mut Journal::default(), &|_| ()).unwrap();
    let transfer_key = cache::transfer_key(&key, &"mutants");
    cache::store_transfer(dir, &transfer_key, "a", &framebuffer, &transfer).unwrap();
    let of_transfer = files().into_iter().find(|path| *path != of_framebuffer).unwrap();

    let mut random = Random::new(5);
    for path in [&of_framebuffer, &of_transfer] {
        let good = std::fs::read(path).unwrap();
        assert!(resealed(good.clone()) == good, "sealed as the cache does it");
        let header = u64::from_le_bytes(good[..8].try_into().unwrap()) as usize + 8;
        let checksum = find(&good, b"\"blake3\":\"").unwrap() + 10;
        let mut taken = 0;
        for i in 0..mutants() {
            let mut bytes = good.clone();
            for _ in 0..=random.below(3) {
                let reach = if i % 3 == 0 { 8..header } else { header..good.len() };
                let at = reach.start + random.below(reach.len());
                if at < checksum + 80 && at + 20 > checksum {
                    continue;
                }
                // A whole word in the data: an index or a float.
                let any = random.bits() as u32;
                let word: u32 = random.pick(&[0, 1, 0x7f80_0000, 0x7fc0_0000, u32::MAX, 1 << 31, any]);
                match reach.start {
                    8 => bytes[at] = random.pick(b"0123456789,:[]{}\"-e "),
                    start => {
                        let at = start + (at - start) / 4 * 4;
                        let end = (at + 4).min(bytes.len());
                        bytes[at..end].copy_from_slice(&word.to_le_bytes()[..end - at]);
                    }
                }
            }
            let bytes = resealed(bytes);
            std::fs::write(path, &bytes).unwrap();
            if path == &of_framebuffer {
                taken += usize::from(cache::load(dir, &key, &scene.cameras[0], &settings).is_some());
            } else if let Some(transfer) = cache::load_transfer(dir, &transfer_key, &framebuffer) {
                taken += 1;
                // As the kernels do: with every index that it has.
                let length = transfer.first().last().map_or(0, |&first| first as usize);
                if transfer.vector_length < 1 << 20 {
                    assert_eq!(transfer.apply(&vec![DVec3::ONE; length]).len(), framebuffer.samples.len());
                }
            }
        }
        std::fs::write(path, &good).unwrap();
        println!("{}: {taken} of {} taken", path.display(), mutants());
        assert!(taken < mutants() && taken > mutants() / 20, "{taken} of {} were taken", mutants());
    }
}
