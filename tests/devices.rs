//! What is measured once on each device, and the choices that follow from it.

mod command;

use std::path::{Path, PathBuf};

use command::{Run, SWIFTSHADER, folder, json, parse, relume, shipped};
use serde_json::Value;

/// Runs relume with a cache of its own; `drivers`: as in VK_DRIVER_FILES.
fn run(cache: &Path, drivers: Option<&str>, arguments: &[&str]) -> Run {
    let mut command = relume();
    command.env("XDG_CACHE_HOME", cache).args(arguments);
    if let Some(drivers) = drivers {
        command.env_remove("VK_ICD_FILENAMES").env("VK_DRIVER_FILES", drivers);
    }
    Run::of(&mut command).silent()
}

/// Figures of a small picture.
fn stats(cache: &Path, drivers: Option<&str>) -> Value {
    let [scene, picture, stats] = [shipped("balls-2.glb"), cache.join("a.exr"), cache.join("a.json")];
    let [scene, picture, file] = [&scene, &picture, &stats].map(|path| path.to_str().unwrap());
    run(cache, drivers, &["render", scene, "--size", "16x12", "-o", picture, "--stats", file]);
    json(&stats)
}

/// The files of measurements, one for each device that was measured.
fn kept(cache: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(cache.join("relume")).unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| path.file_name().unwrap().to_string_lossy().starts_with("measurements-")).collect()
}

/// The figures that are kept under a name with this start, if any.
fn figures<'a>(measurements: &'a mut Value, start: &str) -> Option<&'a mut Value> {
    measurements.as_object_mut().unwrap().iter_mut().find(|(name, _)| name.starts_with(start)).map(|(_, value)| value)
}

#[test]
fn visibility_is_measured_once() {
    let folder = folder();
    let cache = folder.path();
    let first = stats(cache, None);
    let reason = first["visibility"]["reason"].as_str().unwrap();
    assert!(reason.starts_with("measured: "), "{reason}");
    let measured = |file: &PathBuf| figures(&mut json(file), "visibility").is_some();
    let file = kept(cache).into_iter().find(measured).expect("it is kept");
    for (map_ms, traced_ms, method) in [(1.0, 2.0, "map"), (2.0, 1.0, "traced")] {
        let mut measurements = json(&file);
        let times = figures(&mut measurements, "visibility").unwrap();
        assert!(times["map_ms"].is_f64() && times["traced_ms"].is_f64(), "{times}");
        (times["map_ms"], times["traced_ms"]) = (map_ms.into(), traced_ms.into());
        std::fs::write(&file, measurements.to_string()).unwrap();
        assert_eq!(stats(cache, None)["visibility"]["method"], method);
        let devices = parse(&run(cache, None, &["devices", "--json"]).stdout);
        let mut listed = devices["devices"].as_array().unwrap().iter();
        let used = listed.find(|device| device["name"] == first["device"]).unwrap();
        assert_eq!(used["visibility"]["method"], method);
        let text = run(cache, None, &["devices"]).stdout;
        assert!(text.contains(&format!("--visibility auto is {method}: ")), "{text}");
    }
    // A damaged file counts as none.
    std::fs::write(&file, "{").unwrap();
    let again = stats(cache, None)["visibility"]["reason"].clone();
    assert!(again.as_str().unwrap().starts_with("measured: "), "{again}");
}

/// Manifest of lavapipe, whose name depends on the distribution.
fn lavapipe() -> Option<PathBuf> {
    let manifests = std::fs::read_dir("/usr/share/vulkan/icd.d").into_iter().flatten().flatten();
    manifests.map(|entry| entry.path()).find(|path| path.to_string_lossy().contains("/lvp_icd"))
}

#[test]
fn the_faster_device_is_chosen() {
    let Some(lavapipe) = lavapipe().filter(|_| Path::new(SWIFTSHADER).exists()) else {
        println!("not run: the choice between devices, which needs lavapipe and SwiftShader");
        return;
    };
    let lavapipe = lavapipe.to_str().unwrap();
    let folder = folder();
    let cache = folder.path();
    stats(cache, Some(lavapipe));
    assert!(kept(cache).iter().all(|file| figures(&mut json(file), "speed").is_none()), "there was no choice");
    let uses = |drivers: [&str; 2]| stats(cache, Some(&drivers.join(":")))["device"].as_str().unwrap().to_owned();
    let visibility_of_lavapipe = kept(cache);
    uses([lavapipe, SWIFTSHADER]);
    // What is kept decides, not a new measurement, nor the order.
    let files = kept(cache);
    assert_eq!(files.len(), 2);
    for (name, of_lavapipe, of_other) in [("llvmpipe", 1.0, 2.0), ("SwiftShader", 2.0, 1.0)] {
        for file in &files {
            let mut measurements = json(file);
            let is_lavapipe = visibility_of_lavapipe.contains(file);
            let speed = figures(&mut measurements, "speed").unwrap();
            speed["yardstick_ms"] = if is_lavapipe { of_lavapipe } else { of_other }.into();
            std::fs::write(file, measurements.to_string()).unwrap();
        }
        for drivers in [[lavapipe, SWIFTSHADER], [SWIFTSHADER, lavapipe]] {
            assert!(uses(drivers).contains(name), "{drivers:?}");
        }
    }
}
