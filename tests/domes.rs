//! Light from all directions where the answer is known: relit, and traced by the path tracer.

mod common;

use std::f64::consts::{PI, TAU};
use std::path::Path;

use common::domes::{dome, map};
use common::stage::{Build, Setup, Stage, lambert, look, pixels, rig};
use common::{assert_near, gpu, output_dir, shared, shipped, transfer};
use glam::{DVec3, Vec3};
use relume::bake::transport::TransferSettings;
use relume::image::exr;
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::relight::{Detail, Layers, Request};
use relume::scene::light_filter::Attached;
use relume::scene::{Camera, Light, LightKind, Projection, Rig, RigFiles, Scene, SkyMap};
use relume::trace::bvh::TracedScene;

const ALBEDO: f64 = 0.6;

/// Blue above, brown below, and two lamps.
fn studio() -> Attached<SkyMap> {
    map("studio", [64, 32], |x, y| match (x, y) {
        (20..24, 8..11) => Vec3::new(60.0, 50.0, 30.0),
        (50..52, 12..14) => Vec3::new(5.0, 10.0, 40.0),
        _ if y < 16 => Vec3::new(0.3, 0.5, 0.9),
        _ => Vec3::new(0.2, 0.12, 0.06),
    })
}

fn balls() -> (Scene, Camera) {
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let camera = scene.cameras[0].clone();
    (scene, camera)
}

fn settings(max_bounces: Option<u32>, size: u32) -> Settings {
    Settings {
        width: size,
        height: size,
        layers: 4,
        max_bounces,
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed: 1,
    }
}

/// Relative RMSE, the worst 0.1 % of pixels left out, and bias.
fn errors(image: &[[f32; 3]], truth: &[[f32; 3]]) -> [f64; 2] {
    let difference = |(a, b): (&[f32; 3], &[f32; 3])| Vec3::from(*a).as_dvec3() - Vec3::from(*b).as_dvec3();
    let pairs = || image.iter().zip(truth);
    let mut squares: Vec<f64> = pairs().map(difference).map(DVec3::length_squared).collect();
    squares.sort_by(f64::total_cmp);
    let error: f64 = squares[..squares.len() * 999 / 1000].iter().sum();
    let values = || truth.iter().flatten().map(|x| f64::from(*x));
    let bias = pairs().map(difference).map(DVec3::element_sum).sum::<f64>() / values().sum::<f64>();
    [(error / values().map(|x| x * x).sum::<f64>()).sqrt(), bias]
}

/// A white dome of unit radiance gives planes that see nothing else the radiance of their albedo.
#[test]
fn white_domes() {
    let gpu = gpu();
    let facing = |normal: DVec3| {
        let (u, v) = normal.any_orthonormal_pair();
        let mut build = Build::default();
        let grey = build.material(lambert(Vec3::splat(ALBEDO as f32)));
        build.quad(DVec3::ZERO, 4.0 * u, 4.0 * v, grey);
        (build.scene(), look(normal, DVec3::ZERO, u, Projection::Orthographic { ymag: 0.5 }))
    };
    let white = [None, Some(map("white", [3, 2], |_, _| Vec3::ONE))];
    for (scene, camera) in [DVec3::Y, DVec3::Z, DVec3::new(0.6, -0.64, 0.48)].map(facing) {
        for light in white.clone().map(dome) {
            let (setup, all) = (Setup::new(8, 8), rig(vec![light]));
            let stage = Stage::new(scene.clone(), &camera, &all, &setup);
            for (detail, tolerance) in [(Detail::Exact, 1e-3), (Detail::Coarse, 3e-2)] {
                let mut relighter = stage.relighter(&gpu, &all, &setup);
                let picture = relighter.linear(Request { detail, ..Request::default() }).unwrap();
                let mean = picture.iter().flatten().map(|&x| f64::from(x)).sum::<f64>() / (3 * picture.len()) as f64;
                println!("{detail:?}: {mean}");
                assert_near(mean, ALBEDO, tolerance, format!("{detail:?}"));
            }
            let traced = TracedScene::new(scene.clone());
            let film = PathTracer::new(&traced, &camera, &all, &settings(Some(0), 8)).trace(512, &|| false, &|_| ());
            let layer = film.layer(Half::Both, Layer::Direct);
            let mean = layer.iter().flatten().map(|&x| f64::from(x)).sum::<f64>() / (3 * layer.len()) as f64;
            assert_near(mean, ALBEDO, 2e-3, "path tracer");
        }
    }
}

/// White surfaces under a white dome are as bright as the dome, whatever bounces among them: a pit and a block in it.
#[test]
fn a_white_furnace() {
    let gpu = gpu();
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::ONE));
    build.room(DVec3::ZERO, 1.0, white);
    build.quads.remove(3); // the ceiling
    for (axis, side) in [(DVec3::X, 1.0), (DVec3::X, -1.0), (DVec3::Y, 1.0), (DVec3::Z, 1.0), (DVec3::Z, -1.0)] {
        let (u, v) = (DVec3::new(axis.y, axis.z, axis.x), DVec3::new(axis.z, axis.x, axis.y));
        build.quad(DVec3::new(0.2, -0.7, -0.1) + 0.3 * side * axis, 0.3 * side * v, 0.3 * u, white);
    }
    let camera =
        look(DVec3::new(-0.7, 1.6, 0.8), DVec3::new(0.1, -0.6, 0.0), DVec3::Y, Projection::Perspective { yfov: 0.5 });
    let (setup, all) = (Setup::new(48, 32), rig(vec![dome(None)]));
    let mut stage = Stage::new(build.scene(), &camera, &all, &setup);
    // The seed decides where samples lie, which changes the mean by 1e-3.
    const SEEDS: u64 = 4;
    let mut of_seed = |seed| {
        let settings = TransferSettings { seed, ..transfer::settings(4096, 1024, 1024) };
        stage.transfer = Some(transfer::dense(&stage, &settings));
        let mut relighter = stage.relighter(&gpu, &all, &setup);
        let [whole, indirect] = [Layers::All, Layers::Indirect].map(|layers| {
            let picture = pixels(&mut relighter, layers);
            let seen = || picture.iter().flatten().filter(|x| **x > 0.0).map(|&x| f64::from(x));
            seen().sum::<f64>() / seen().count() as f64
        });
        println!("seed {seed}: mean {whole:.5}, of indirect light {indirect:.5}");
        assert!(indirect > 0.1, "there are bounces");
        whole
    };
    let mean = (1..=SEEDS).map(&mut of_seed).sum::<f64>() / SEEDS as f64;
    assert_near(mean, 1.0, 1.5e-3, "mean");
}

/// A bright texel is a sun, and a map is the same light as the map without its brightest texel and a sun.
#[test]
fn one_texel_is_a_sun() {
    let gpu = gpu();
    let (scene, camera) = balls();
    let size = [512, 256];
    let texel = [300, 60];
    let radiance = Vec3::new(1e6, 5e5, 2e5);
    let bright = |x: usize, y: usize| if [x, y] == texel { radiance } else { Vec3::ZERO };
    let sky = |_: usize, y: usize| Vec3::new(3.0, 4.0, 6.0) * (256 - y) as f32;
    let [u, v] = [0, 1].map(|axis| (texel[axis] as f64 + 0.5) / size[axis] as f64);
    let towards = DVec3::new((PI * v).sin() * (TAU * u).sin(), (PI * v).cos(), -(PI * v).sin() * (TAU * u).cos());
    let solid_angle = TAU / 512.0 * PI / 256.0 * (PI * v).sin();
    let sun = Light {
        kind: LightKind::Directional,
        direction: -towards,
        color: Vec3::new(1.0, 0.5, 0.2),
        intensity: 1e6 * solid_angle,
        ..Light::point("sun", DVec3::ZERO)
    };
    let setup = Setup::new(96, 64);
    let picture = |lights: Vec<Light>| {
        let all = rig(lights);
        let stage = Stage::new(scene.clone(), &camera, &all, &setup);
        pixels(&mut stage.relighter(&gpu, &all, &setup), Layers::Direct)
    };
    let one = picture(vec![dome(Some(map("texel", size, bright)))]);
    let both = picture(vec![dome(Some(map("sky and texel", size, |x, y| sky(x, y) + bright(x, y))))]);
    let split = picture(vec![dome(Some(map("sky", size, sky))), sun.clone()]);
    for (what, got, want) in [("one texel", one, picture(vec![sun])), ("a split map", both, split)] {
        let [error, bias] = errors(&got, &want);
        println!("{what}: error {error:.4}, bias {bias:+.4}");
        assert!(error < 0.05 && bias.abs() < 0.005, "{what}: off by {error}, {bias}");
    }
}

/// Seven turns of a seventh lead back to the same bytes.
#[test]
fn turned_all_around() {
    let gpu = gpu();
    let (scene, camera) = balls();
    let setup = Setup::new(48, 32);
    let mut all = rig(vec![Light { visible: true, ..dome(Some(studio())) }]);
    let stage = Stage::new(scene, &camera, &all, &setup);
    let mut relighter = stage.relighter(&gpu, &all, &setup);
    let first = pixels(&mut relighter, Layers::All);
    for turn in 0..7 {
        all.lights[0].rotation += TAU / 7.0;
        relighter.set_rig(&all).unwrap();
        let picture = pixels(&mut relighter, Layers::All);
        assert_eq!(turn == 6, picture == first, "after turn {turn}");
    }
}

/// At rest and while it turns, beside the path tracer.
#[test]
fn domes_against_the_path_tracer() {
    let gpu = gpu();
    let (scene, camera) = balls();
    let setup = Setup::new(128, 128);
    let light = Light { rotation: 0.7, ..dome(Some(studio())) };
    let all = rig(vec![light]);
    let mut stage = Stage::new(scene.clone(), &camera, &all, &setup);
    let traced = TracedScene::new(scene);
    let film = PathTracer::new(&traced, &camera, &all, &settings(Some(0), 128)).trace(128, &|| false, &|_| ());
    let truth = film.layer(Half::Both, Layer::Direct);
    let [error, bias] = errors(&pixels(&mut stage.relighter(&gpu, &all, &setup), Layers::Direct), &truth);
    println!("direct light at rest: error {error:.4}, bias {bias:+.4}");
    // The path tracer's own noise is most of it.
    assert!(error < 0.03 && bias.abs() < 0.005, "off by {error}, {bias}");
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(1600, 80, 64)));
    let [moving, exact] = [Detail::Coarse, Detail::Exact].map(|detail| {
        let request = Request { detail, ..Request::default() };
        stage.relighter(&gpu, &all, &setup).linear(request).unwrap().to_vec()
    });
    let [error, bias] = errors(&moving, &exact);
    println!("while it turns: error {error:.4}, bias {bias:+.4}");
    assert!(error < 0.1 && bias.abs() < 0.02, "while it turns: off by {error}, {bias}");
}

/// A white sky behind the window of a closed room lights it as a white rectangle in place of the window does.
#[test]
fn a_window_is_a_rectangle() {
    const HALF: f64 = 0.2;
    let gpu = gpu();
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(ALBEDO as f32)));
    build.room(DVec3::ZERO, 1.0, grey);
    build.quads.remove(0); // the wall at -x, whose place four strips take
    let (along, across) = ((1.0 - HALF) / 2.0, 1.0 - (1.0 - HALF) / 2.0);
    for side in [-1.0, 1.0] {
        let y = DVec3::new(-1.0, side * across, 0.0);
        build.quad(y, along * DVec3::Y, DVec3::Z, grey);
        let z = DVec3::new(-1.0, 0.0, side * across);
        build.quad(z, HALF * DVec3::Y, along * DVec3::Z, grey);
    }
    let camera =
        look(DVec3::new(0.9, 0.5, 0.8), DVec3::new(-0.5, -0.8, -0.2), DVec3::Y, Projection::Perspective { yfov: 1.2 });
    let (setup, scene) = (Setup::new(96, 64), build.scene());
    let window = Light {
        kind: LightKind::Rect,
        size: [2.0 * HALF; 2],
        direction: DVec3::X,
        intensity: 4.0 * HALF * HALF,
        ..Light::point("window", DVec3::new(-1.0, 0.0, 0.0))
    };
    let [sky, window] = [dome(None), window].map(|light| {
        let all = rig(vec![light]);
        let stage = Stage::new(scene.clone(), &camera, &all, &setup);
        pixels(&mut stage.relighter(&gpu, &all, &setup), Layers::Direct)
    });
    let [error, bias] = errors(&sky, &window);
    println!("error {error:.4}, bias {bias:+.4}");
    // Shadows have steps. Without a choice of directions it would be 6 %.
    assert!(error < 0.05 && bias.abs() < 0.005, "off by {error}, {bias}");
}

/// Another renderer's picture under a map of a room with lamps; means over 4x4 pixels.
#[test]
fn agrees_with_another_renderer() {
    let files = ["env_home_office_full_lights.hdr", "balls-office-0.direct.a.exr", "balls-office-0.direct.b.exr"];
    let Some([office, a, b]) = files
        .map(|file| shared(&format!("reference/lights/{file}")))
        .into_iter()
        .collect::<Option<Vec<_>>>()
        .map(|found| <[_; 3]>::try_from(found).unwrap())
    else {
        return;
    };
    let gpu = gpu();
    let (scene, camera) = balls();
    let setup = Setup::new(384, 256);
    let all = rig(vec![dome(Some(RigFiles::new(Path::new("")).sky_map(&office.to_string_lossy()).unwrap()))]);
    let stage = Stage::new(scene, &camera, &all, &setup);
    let got = pixels(&mut stage.relighter(&gpu, &all, &setup), Layers::Direct);
    let [a, b] = [a, b].map(|path| exr::read(&path).unwrap().layers.remove(0).pixels);
    let truth: Vec<[f32; 3]> = a.iter().zip(&b).map(|(a, b)| [0, 1, 2].map(|c| 0.5 * (a[c] + b[c]))).collect();
    let [error, bias] = errors(&blocks(&got), &blocks(&truth));
    println!("error {error:.4}, bias {bias:+.4}");
    assert!(error < 0.02 && bias.abs() < 0.01, "off by {error}, {bias}");
}

/// Means over 4x4 pixels of 384x256.
fn blocks(image: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let pixel = |x: usize, y: usize| Vec3::from(image[y * 384 + x]);
    let mean = |i: usize| (0..16).map(|j| pixel(i % 96 * 4 + j % 4, i / 96 * 4 + j / 4)).sum::<Vec3>() / 16.0;
    (0..96 * 64).map(|i| mean(i).to_array()).collect()
}

/// A map of values that are no radiance gives finite pictures; what is no map gives an error that names it.
#[test]
fn strange_maps() {
    let gpu = gpu();
    let (scene, camera) = balls();
    let setup = Setup::new(24, 16);
    let strange = |x: usize, _: usize| match x % 4 {
        0 => Vec3::splat(f32::NAN),
        1 => Vec3::new(-3.0, f32::INFINITY, 1.0),
        2 => Vec3::splat(1e6),
        _ => Vec3::splat(1e-30),
    };
    let all = rig(vec![Light { visible: true, ..dome(Some(map("strange", [16, 8], strange))) }]);
    let stage = Stage::new(scene.clone(), &camera, &all, &setup);
    for detail in [Detail::Coarse, Detail::Exact] {
        let request = Request { detail, ..Request::default() };
        let picture = stage.relighter(&gpu, &all, &setup).linear(request).unwrap().to_vec();
        assert!(picture.iter().flatten().all(|x| x.is_finite() && *x >= 0.0), "{detail:?}");
    }
    let path = output_dir().join("no_map.hdr");
    std::fs::write(&path, "#?RADIANCE\n\n-Y 7 +X 9999999\n").unwrap();
    let error = RigFiles::new(Path::new("")).sky_map(&path.to_string_lossy()).unwrap_err();
    assert!(error.chain().contains("no_map.hdr"), "{}", error.chain());
}

/// A rig file with a dome reads back as it was.
#[test]
fn rig_files() {
    let light = Light { rotation: 90f64.to_radians(), visible: true, ..dome(Some(studio())) };
    let mut all: Rig = rig(vec![light]);
    all.lights[0].name = "sky".into();
    let folder = output_dir();
    let path = folder.join("dome.toml");
    std::fs::write(&path, all.to_toml(&folder)).unwrap();
    assert_eq!(Rig::load(&path).unwrap().lights, all.lights);
}
