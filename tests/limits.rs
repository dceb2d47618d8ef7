//! Smaller and smaller devices, made by RELUME_LIMITS: either a picture comes out right, or one clear error says before
//! the bake what does not fit. A limit that is not asked shows as an error of Vulkan.

mod command;

use std::path::Path;
use std::sync::{Arc, Mutex};

use command::{Run, folder, parse, relume, shipped};
use glam::DVec3;
use relume::bake::transport::Outgoing;
use relume::relight::{Picture, RelightSettings, Site, VisibilityMethod};
use relume::scene::{Light, Rig};
use relume::session::{Form, IndirectSettings, OpenSettings, Survey, Target};
use relume::{Session, SessionSettings};

/// Its factors take 19 MB, a gather sample 100 kB at the most.
const SIZE: &str = "256x192";
const SIDES: [usize; 2] = [256, 192];
const INDIRECT: [[&str; 2]; 4] = [["--gi", "glossy"], ["--gather", "64"], ["--rays", "16"], ["--transfer", "dense"]];

/// Runs `relume COMMAND SCENE` on a device with `limits`, or on the driver's own without any.
fn run(command: &str, scene: &str, limits: &str, more: &[&str]) -> Run {
    let mut run = relume();
    if !limits.is_empty() {
        run.env("RELUME_LIMITS", limits);
    }
    run.arg(command).arg(shipped(scene)).args(more);
    for [option, value] in INDIRECT {
        if !more.contains(&option) {
            run.args([option, value]);
        }
    }
    Run::of(&mut run)
}

fn render(folder: &Path, scene: &str, limits: &str, more: &[&str]) -> Run {
    let [output, cache] = ["picture.png", "cache"].map(|name| folder.join(name).to_str().unwrap().to_owned());
    run("render", scene, limits, &[&["-o", &output, "--cache", &cache], more].concat())
}

/// Renders on devices with each of `values` as `limit`, and counts pictures and refusals. Pictures are those of a
/// device without limits.
fn sweep(limit: &str, values: &[u64], more: &[&str]) -> [usize; 2] {
    let more = [&["--size", SIZE], more].concat();
    let clean = folder();
    render(clean.path(), "cornell-diffuse.glb", "", &more).done();
    let want = std::fs::read(clean.path().join("picture.png")).unwrap();
    let mut counts = [0; 2];
    for value in values {
        let folder = folder();
        let run = render(folder.path(), "cornell-diffuse.glb", &format!("{limit}:{value}"), &more);
        if run.code == Some(0) {
            run.sane();
            assert!(std::fs::read(folder.path().join("picture.png")).unwrap() == want, "{limit} {value}");
            counts[0] += 1;
        } else {
            run.failed(&["cornell-diffuse.glb: ", "; choose "]);
            // Nothing was baked.
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{limit} {value}");
            counts[1] += 1;
        }
    }
    counts
}

/// `count` numbers from `first` to `last`, each as many times the one before.
fn log_spaced(first: f64, last: f64, count: i32) -> Vec<u64> {
    (0..count).map(|i| (first * (last / first).powf(f64::from(i) / f64::from(count - 1))) as u64).collect()
}

#[track_caller]
fn on_both_sides([pictures, refusals]: [usize; 2]) {
    assert!(pictures > 1 && refusals > 1, "{pictures} pictures, {refusals} refusals");
}

#[test]
fn buffers() {
    on_both_sides(sweep("buffer", &log_spaced(5e5, 3e7, 12), &[]));
}

#[test]
fn allocations() {
    on_both_sides(sweep("allocation", &log_spaced(1e6, 3e7, 8), &[]));
}

#[test]
fn memory_of_the_device() {
    on_both_sides(sweep("heap", &log_spaced(8e6, 1e8, 12), &[]));
}

#[test]
fn shadow_maps() {
    let maps = ["--visibility", "map", "--shadow-size", "600"];
    on_both_sides(sweep("image", &[16, 599, 600, 4096], &maps));
    on_both_sides(sweep("allocation", &log_spaced(5e6, 1.2e7, 6), &maps));
}

/// What an error proposes works, and the largest that it proposes is the largest that works.
#[test]
fn remedies() {
    let folder = folder();
    let proposed = |limits: &str, option: &str, more: &[&str]| {
        let error = render(folder.path(), "cornell-diffuse.glb", limits, more).failed(&[option]).stderr;
        let after = error.split(option).nth(1).unwrap();
        after.split_whitespace().next().unwrap().to_owned()
    };
    // 32 bytes for each view sample and each function of a gather sample. Tiles have 8x8 pixels.
    let size = proposed("buffer:6000000", "--size ", &["--size", "1024x768"]);
    let [width, height] = [0, 1].map(|side| size.split('x').nth(side).unwrap().parse::<usize>().unwrap());
    let bytes = |[width, height]: [usize; 2]| 32 * (width.next_multiple_of(8) * height.next_multiple_of(8) + 49 * 64);
    assert!(bytes([width, height]) <= 6_000_000 && bytes([width + 8, height + 8]) > 6_000_000, "{size}");
    render(folder.path(), "cornell-diffuse.glb", "buffer:6000000", &["--size", &size, "--gi", "off"]).done();
    let maps = ["--size", SIZE, "--visibility", "map"];
    assert_eq!(proposed("image:512", "--shadow-size ", &maps), "512");
    let small = [&maps[..], &["--shadow-size", "512"]].concat();
    render(folder.path(), "cornell-diffuse.glb", "image:512", &small).done();
    render(folder.path(), "cornell-diffuse.glb", "image:512", &maps).failed(&["--visibility traced"]);
}

/// What mirrors add is known after the deep framebuffer, and asked before indirect light.
#[test]
fn extra_samples() {
    let folder = folder();
    let exact = format!("buffer:{}", 32 * (SIDES[0] * SIDES[1] + 49 * 16));
    let more = ["--size", SIZE, "--gather", "16"];
    render(folder.path(), "balls-2.glb", &exact, &more).failed(&["balls-2.glb", "view samples", "--layers"]);
    let names: Vec<_> = std::fs::read_dir(folder.path().join("cache"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(names.len(), 1, "a deep framebuffer and no transfer: {names:?}");
    let flat = [&more[..], &["--layers", "1"]].concat();
    render(folder.path(), "balls-2.glb", &exact, &flat).done();
}

/// Other commands say the same.
#[test]
fn other_commands() {
    let reason = |run: Run| run.failed(&["; choose "]).stderr.trim().to_owned();
    let bench = reason(run("bench", "cornell-diffuse.glb", "buffer:1200000", &["--size", SIZE, "--no-cache"]));
    let folder = folder();
    assert_eq!(reason(render(folder.path(), "cornell-diffuse.glb", "buffer:1200000", &["--size", SIZE])), bench);
    let plan = |limits: &str| {
        let more = ["--size", SIZE, "--no-cache", "--json", "--device", "0"];
        let memory = parse(&run("plan", "cornell-diffuse.glb", limits, &more).done().stdout)["memory"].clone();
        (memory["fits"].as_bool().unwrap(), memory["verdict"].as_str().unwrap().to_owned())
    };
    let (fits, verdict) = plan("buffer:1200000");
    assert!(!fits && bench.ends_with(verdict.strip_prefix("does not fit: ").unwrap()), "{verdict}");
    assert!(plan("buffer:30000000").0);
}

#[test]
fn devices_report_limits() {
    let mut devices = relume();
    devices.args(["devices", "--json"]).env("RELUME_LIMITS", "buffer:1,allocation:2,image:3,heap:4");
    let first = parse(&Run::of(&mut devices).silent().stdout)["devices"][0].clone();
    let limits = &first["limits"];
    let told = [&limits["buffer_bytes"], &limits["allocation_bytes"], &limits["image_side"], &first["memory_bytes"]];
    assert_eq!(told.map(|number| number.as_u64().unwrap()), [1, 2, 3, 4]);
    for wrong in ["", "buffer", "buffer:x", "heap:-1", "disk:3", "buffer:1,"] {
        let mut devices = relume();
        Run::of(devices.arg("devices").env("RELUME_LIMITS", wrong)).failed(&["RELUME_LIMITS"]);
    }
}

/// Kernels need a whole panel of the transfer in a buffer. The number that is proposed is the largest that fits.
#[test]
fn gather_samples_of_a_device_that_multiplies() {
    let relight = RelightSettings { site: Some(Site::Device), ..Default::default() };
    let mut target = Target::new(None, None, relight).unwrap();
    target.device.limits.buffer_bytes = 3_000_000;
    let refusal = |gather: u32| {
        let outgoing = Outgoing::Glossy { functions: None };
        let (form, gather) = (Form::Dense, Some(gather));
        let indirect = IndirectSettings::Robust { outgoing, form, gather, rays: Some(16), bounces: None };
        let mut settings = SessionSettings { cache_dir: None, indirect: Some(indirect), ..Default::default() };
        settings.open.size = Some([64, 48]);
        let survey = Survey::new(&shipped("cornell-glossy.glb"), None, &settings, &()).unwrap();
        survey.footprint(&target).refusal(&target.device)
    };
    let refused = refusal(64).expect("a panel has more bytes");
    let gather = refused.split("--gather ").nth(1).and_then(|rest| rest.split(' ').next()).expect("it is proposed");
    let gather: u32 = gather.parse().unwrap();
    assert!(refusal(gather).is_none() && refusal(gather + 1).is_some(), "{refused}");
}

/// The footprint is what a relighter allocates, but for the allocator's blocks.
#[test]
fn footprints_are_the_memory_that_is_taken() {
    let path = shipped("balls-2.glb");
    let mut settings = SessionSettings { cache_dir: None, indirect: None, ..Default::default() };
    settings.open.size = Some([128, 96]); // counted, not estimated
    for visibility in [VisibilityMethod::Map, VisibilityMethod::Traced] {
        let relight = RelightSettings { visibility, shadow_size: 256, budget_bytes: Some(0), ..Default::default() };
        let target = Target::new(None, None, relight.clone()).unwrap();
        let footprint = Survey::new(&path, None, &settings, &()).unwrap().footprint(&target);
        let session = Session::open(&path, None, &settings, &()).unwrap();
        let context = session.context(None).unwrap();
        let _relighter = session.relighter(&context, &session.rig, &relight).unwrap();
        let taken: u64 = context.memory_by_owner().iter().map(|(_, bytes)| bytes).sum();
        let blocks = 8 << 20;
        let (most, least) = (footprint.total_bytes(), footprint.total_bytes() - blocks);
        assert!(taken <= most && taken as f64 > 0.95 * least as f64, "{visibility:?}: {taken} of {least} to {most}");
    }
}

/// A picture that is made once needs images for the depth of the tree of lights, not for each light.
#[test]
fn many_lights_of_one_picture_take_few_images() {
    let settings = SessionSettings {
        open: OpenSettings { size: Some([32, 24]), ..Default::default() },
        indirect: None,
        cache_dir: None,
        ..Default::default()
    };
    let session = Session::open(&shipped("balls-2.glb"), None, &settings, &()).unwrap();
    let place = |i: usize| DVec3::new((i % 20) as f64 * 0.1 - 1.0, 2.0, (i / 20) as f64 * 0.1 - 1.0);
    let lights = (0..500).map(|i| Light::point(&format!("light {i}"), place(i))).collect();
    let rig = Rig { lights, ..Rig::default() };
    let [all, few] = [true, false].map(|keep_images| {
        let context = session.context(None).unwrap();
        let relight = RelightSettings { keep_images, ..Default::default() };
        let mut relighter = session.relighter(&context, &rig, &relight).unwrap();
        let done = Arc::new(Mutex::new(Vec::new()));
        let told = done.clone();
        relighter.set_progress(move |lights, of| told.lock().unwrap().push((lights, of)));
        let picture = relighter.linear(Picture::Whole).unwrap().to_vec();
        let done = done.lock().unwrap();
        assert!(done.is_sorted() && done.len() > 5 && done.last() == Some(&(500, 500)), "{done:?}");
        let images = context.memory_by_owner().into_iter().find(|(owner, _)| owner == "light").expect("there are some");
        (picture, images.1)
    });
    assert!(few.0 == all.0, "the pictures differ");
    assert!(10 * few.1 < all.1, "{} bytes of images instead of {}", few.1, all.1);
}
