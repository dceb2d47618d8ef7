//! Pictures of shipped scenes on every Vulkan driver that this machine has: lavapipe at other vector widths,
//! SwiftShader.
//!
//! `tools/test` runs the tests of kernels on the same drivers.

mod command;

use std::path::Path;

use command::{Run, SWIFTSHADER, difference, folder, read_exr, relume, shipped};

/// Lavapipe at 256 bits makes the pictures that others are compared with.
const USUAL: Driver = Driver { name: "lavapipe, 256 bits", variable: "LP_NATIVE_VECTOR_WIDTH", value: "256" };
/// Largest difference from that, relative to the brightest value of a picture: what other roundings of the same
/// operations, some hundred in a row, come to. Lavapipe differs at no width.
const ROUNDINGS: f32 = 1e-5;

struct Driver {
    name: &'static str,
    variable: &'static str,
    value: &'static str,
}

fn others() -> Vec<Driver> {
    let mut drivers = vec![Driver { name: "lavapipe, 128 bits", value: "128", ..USUAL }];
    if is_wide() {
        drivers.push(Driver { name: "lavapipe, 512 bits", value: "512", ..USUAL });
    } else {
        println!("not run: pictures of lavapipe at 512 bits, which this processor does not have");
    }
    if Path::new(SWIFTSHADER).exists() {
        drivers.push(Driver { name: "SwiftShader", variable: "VK_DRIVER_FILES", value: SWIFTSHADER });
    } else {
        println!("not run: pictures of SwiftShader, which tools/setup found nowhere");
    }
    drivers
}

#[cfg(target_arch = "x86_64")]
fn is_wide() -> bool {
    std::arch::is_x86_feature_detected!("avx512f")
}

#[cfg(not(target_arch = "x86_64"))]
fn is_wide() -> bool {
    false
}

/// All passes of `scene`, layer by layer; what is baked is in `cache`.
fn passes(scene: &str, driver: &Driver, cache: &Path) -> Vec<(String, Vec<f32>)> {
    let output = cache.join(format!("{}.exr", driver.value.rsplit('/').next().unwrap()));
    let mut command = relume();
    command.env_remove("VK_ICD_FILENAMES").env_remove("VK_DRIVER_FILES").env(driver.variable, driver.value);
    command.arg("render").arg(shipped(scene)).args(["--size", "48x32", "--gi", "glossy", "--passes", "all"]);
    // Kernels are compared, not bakes.
    command.args(["--gather", "256", "--rays", "64"]);
    Run::of(command.arg("--cache").arg(cache).arg("-o").arg(&output)).done();
    let image = read_exr(&output);
    image.layers.iter().map(|layer| (layer.name.clone(), layer.pixels.iter().flatten().copied().collect())).collect()
}

#[test]
fn pictures_are_the_same_on_every_driver() {
    let scenes =
        ["balls-2.glb", "cornell-glossy.glb", "balls-16.glb", "cornell-diffuse.glb", "cornell-glossy-floor.glb"];
    let count = if std::env::var_os("RELUME_FULL").is_some() { scenes.len() } else { 2 };
    let drivers = others();
    for scene in &scenes[..count] {
        let cache = folder();
        let usual = passes(scene, &USUAL, cache.path());
        for driver in &drivers {
            let mut largest = 0.0f32;
            let others = passes(scene, driver, cache.path());
            let names = |layers: &[(String, Vec<f32>)]| layers.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
            assert_eq!(names(&usual), names(&others));
            for ((name, want), (_, got)) in usual.iter().zip(others) {
                let error = difference(want, &got);
                let bound = if driver.variable == USUAL.variable { 0.0 } else { ROUNDINGS };
                assert!(error <= bound, "{scene}, layer {name:?}, {}: off by {error:.1e}", driver.name);
                largest = largest.max(error);
            }
            println!("| {scene} | {} | {largest:.1e} |", driver.name);
        }
    }
}
