//! Emissive materials as lights: dimmed, coloured and switched, relit and traced.

mod common;

use common::stage::{Build, Setup, Stage, emitter, lambert, look, mirror, pixels, rig};
use common::transfer::settings;
use common::{gpu, largest, output_dir, shipped};
use glam::{DVec3, Vec3};
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, TransferSettings};
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::relight::{Layers, Picture, Request};
use relume::scene::{Camera, Emitters, Light, Material, Projection, Rig, Scene};
use relume::session::{OpenSettings, Opened};
use relume::storage::journal::Journal;
use relume::trace::bvh::TracedScene;
use std::sync::Arc;

/// A grey room with a mirror, a panel of one material and two of another.
fn room(panel: Vec3, pair: Vec3) -> (Scene, Camera) {
    let named = |name: &str, material: Material| Material { name: name.into(), ..material };
    let mut build = Build::default();
    let wall = build.material(named("wall", lambert(Vec3::splat(0.5))));
    build.room(DVec3::ZERO, 1.0, wall);
    let shiny = build.material(named("mirror", mirror(Vec3::splat(0.9), 1.0)));
    build.quad(DVec3::new(0.0, -0.3, -0.9), DVec3::X * 0.4, DVec3::Y * 0.4, shiny);
    let one = build.material(named("panel", emitter(panel)));
    build.quad(DVec3::new(0.5, 0.95, 0.2), DVec3::X * 0.2, DVec3::Z * 0.2, one);
    for x in [-0.6, 0.0] {
        // Different materials of one name are one emitter.
        let other = build.material(named("pair", emitter(pair)));
        build.quad(DVec3::new(x, 0.5, -0.95), DVec3::X * 0.1, DVec3::Y * 0.2, other);
    }
    let camera = look(DVec3::new(0.0, 0.0, 0.95), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.5 });
    (build.scene(), camera)
}

/// The room under a lamp, with indirect light, compressed.
fn stage(scene: Scene, camera: &Camera, setup: &Setup) -> Stage {
    let mut stage = Stage::new(scene, camera, &lamp(), setup);
    let (scene, framebuffer) = (stage.scene.clone(), stage.framebuffer.clone());
    let transport = LightTransport::new(&scene, &framebuffer, &settings(600, 0, 128), &|_| ());
    let compression = CompressionSettings { error: 0.05, lights: 32, lobe: Lobe::All, seed: 1 };
    let nested = Transfer::nested(&transport, &compression, &mut Journal::default(), &|_| ()).unwrap();
    stage.transfer = Some(Arc::new(nested));
    stage
}

fn lamp() -> Rig {
    rig(vec![Light { intensity: 0.5, ..Light::point("lamp", DVec3::new(-0.4, 0.2, 0.3)) }])
}

/// The lamp, the panel at half and reddish, the pair at twice.
fn dimmed() -> Rig {
    let mut rig = lamp();
    rig.lights.push(Light { stops: -1.0, color: Vec3::new(1.0, 0.5, 0.25), ..Light::emitter("panel", "panel") });
    rig.lights.push(Light { intensity: 2.0, ..Light::emitter("two", "pair") });
    rig
}

const PANEL: Vec3 = Vec3::new(4.0, 3.0, 2.0);
const PAIR: Vec3 = Vec3::new(0.5, 1.0, 2.0);

fn assert_same(got: &[[f32; 3]], want: &[[f32; 3]], tolerance: f64, what: &str) {
    let pairs = || got.as_flattened().iter().zip(want.as_flattened()).map(|(a, b)| (f64::from(*a), f64::from(*b)));
    let (most, off) = (largest(pairs().map(|(_, b)| b.abs())), largest(pairs().map(|(a, b)| (a - b).abs())));
    assert!(most > 0.0 && off <= tolerance * most, "{what}: off by {off} of {most}");
}

#[test]
fn dimmed_emitters_are_dimmer_materials() {
    let gpu = gpu();
    let setup = Setup::new(40, 32);
    let (scene, camera) = room(PANEL, PAIR);
    let stage = stage(scene, &camera, &setup);
    let mut relighter = stage.relighter(&gpu, &lamp(), &setup);
    assert_eq!(relighter.rig().lights.len(), 3, "a rig gets the emitters that it does not name");
    pixels(&mut relighter, Layers::All);
    relighter.set_rig(&dimmed()).unwrap();
    let got = pixels(&mut relighter, Layers::All);
    let (other, _) = room(PANEL * 0.5 * Vec3::new(1.0, 0.5, 0.25), PAIR * 2.0);
    let other = self::stage(other, &camera, &setup);
    let want = pixels(&mut other.relighter(&gpu, &lamp(), &setup), Layers::All);
    assert_same(&got, &want, 1e-5, "the picture");
    for layers in [Layers::Direct, Layers::Indirect] {
        let mut without = stage.relighter(&gpu, &lamp(), &setup);
        let got = pixels(&mut relighter, layers);
        assert_same(&got, &pixels(&mut without, layers), 0.0, "emitters are in neither layer");
    }
}

#[test]
fn each_emitter_is_a_light() {
    let gpu = gpu();
    let setup = Setup::new(40, 32);
    let (scene, camera) = room(PANEL, PAIR);
    let stage = stage(scene, &camera, &setup);
    let mut relighter = stage.relighter(&gpu, &dimmed(), &setup);
    let mut picture = |picture: Picture| relighter.linear(Request::from(picture)).unwrap().to_vec();
    let [all, together, lamp, panel, pair] =
        [Picture::Whole, Picture::Emission, Picture::Light(0), Picture::Light(1), Picture::Light(2)].map(&mut picture);
    let sum = |parts: &[&Vec<[f32; 3]>]| -> Vec<[f32; 3]> {
        (0..all.len()).map(|i| parts.iter().map(|part| Vec3::from(part[i])).sum::<Vec3>().to_array()).collect()
    };
    assert_same(&together, &sum(&[&panel, &pair]), 1e-6, "emitters");
    assert_same(&all, &sum(&[&lamp, &panel, &pair]), 1e-6, "all lights");
    for emitter in [&panel, &pair] {
        let lit = emitter.iter().filter(|pixel| pixel[0] > 0.0).count();
        assert!(lit > emitter.len() * 8 / 10, "it bounces off the walls: {lit} of {} pixels", emitter.len());
    }
    let mut off = dimmed();
    off.lights[1].enabled = false;
    relighter.set_rig(&off).unwrap();
    assert_same(&pixels(&mut relighter, Layers::All), &sum(&[&lamp, &pair]), 1e-6, "switched off");
    off.lights[2].solo = true;
    relighter.set_rig(&off).unwrap();
    assert_same(&pixels(&mut relighter, Layers::All), &pair, 0.0, "solo");
}

#[test]
fn the_path_tracer_dims_emitters_too() {
    let settings = |light_layers: bool| Settings {
        width: 16,
        height: 16,
        layers: 4,
        max_bounces: None,
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers,
        seed: 1,
    };
    let trace = |(scene, camera): (Scene, Camera), rig: &Rig, light_layers: bool| {
        let scene = TracedScene::new(scene);
        PathTracer::new(&scene, &camera, rig, &settings(light_layers)).trace(4, &|| false, &|_| ())
    };
    let film = trace(room(PANEL, PAIR), &dimmed(), true);
    let image = |layer: Layer| film.layer(Half::Both, layer);
    let other = trace(room(PANEL * 0.5 * Vec3::new(1.0, 0.5, 0.25), PAIR * 2.0), &lamp(), false);
    let want = other.layer(Half::Both, Layer::Emission);
    assert_same(&image(Layer::Emission), &want, 1e-6, "as dimmer materials");
    let [panel, pair] = [1, 2].map(|light| image(Layer::Light(light)));
    let sum: Vec<[f32; 3]> =
        panel.iter().zip(&pair).map(|(a, b)| (Vec3::from(*a) + Vec3::from(*b)).to_array()).collect();
    assert_same(&sum, &want, 1e-6, "the sum of both");
}

/// Sides of the pictures beside the path tracer.
const SIDE: usize = 32;

/// No light but the emitter "panel".
fn panel() -> Rig {
    rig(vec![Light::emitter("panel", "panel")])
}

fn staged(build: Build, camera: &Camera) -> Stage {
    Stage::new(build.scene(), camera, &rig(Vec::new()), &Setup::new(SIDE as u32, SIDE as u32))
}

/// Light of the panel, relume's.
fn relit(stage: &mut Stage, settings: &TransferSettings) -> Vec<[f32; 3]> {
    let (gpu, setup) = (gpu(), Setup::new(SIDE as u32, SIDE as u32));
    let (scene, framebuffer) = (stage.scene.clone(), stage.framebuffer.clone());
    let transport = LightTransport::new(&scene, &framebuffer, settings, &|_| ());
    let compression = CompressionSettings { error: 0.05, lights: 32, lobe: Lobe::All, seed: settings.seed };
    let nested = Transfer::nested(&transport, &compression, &mut Journal::default(), &|_| ()).unwrap();
    stage.transfer = Some(Arc::new(nested));
    stage.relighter(&gpu, &panel(), &setup).linear(Picture::Emission).unwrap().to_vec()
}

/// Light of the panel, the path tracer's with so many samples a pixel.
fn path_traced(stage: &Stage, camera: &Camera, samples: u32) -> Vec<[f32; 3]> {
    let settings = Settings {
        width: SIDE as u32,
        height: SIDE as u32,
        layers: 4,
        max_bounces: None,
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed: 1,
    };
    let film = PathTracer::new(&stage.scene, camera, &panel(), &settings).trace(samples, &|| false, &|_| ());
    film.layer(Half::Both, Layer::Emission)
}

/// Light of the panel: relume's with 200 gather samples, `coarse` of them for further bounces, and rows of 128 rays;
/// and the path tracer's with so many samples a pixel.
fn beside_the_path_tracer(build: Build, camera: &Camera, coarse: usize, samples: u32) -> [Vec<[f32; 3]>; 2] {
    let mut stage = staged(build, camera);
    [relit(&mut stage, &settings(200, coarse, 128)), path_traced(&stage, camera, samples)]
}

/// Relative RMS error and bias of blocks of `side` pixels, red.
fn differences([ours, want]: &[Vec<[f32; 3]>; 2], side: usize) -> (f64, f64) {
    let along = SIDE / side;
    let blocks = |image: &[[f32; 3]]| -> Vec<f64> {
        let mut blocks = vec![0.0; along * along];
        image
            .iter()
            .enumerate()
            .for_each(|(i, c)| blocks[i / SIDE / side * along + i % SIDE / side] += f64::from(c[0]));
        blocks
    };
    let (ours, want) = (blocks(ours), blocks(want));
    let bias = ours.iter().sum::<f64>() / want.iter().sum::<f64>() - 1.0;
    let square = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>();
    let error = (square(&mut ours.iter().zip(&want).map(|(a, b)| a - b)) / square(&mut want.iter().copied())).sqrt();
    println!("blocks of {side}: error {error:.4}, bias {bias:+.4}");
    (error, bias)
}

/// A panel shines up at the ceiling of a closed room. Which samples its small bright patch gets is left to chance, so
/// the bias is a mean over seeds.
#[test]
fn panels_light_rooms_as_much_as_paths_find() {
    const SEEDS: u64 = 8;
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.5)));
    let panel = build.material(Material { name: "panel".into(), ..emitter(Vec3::splat(10.0)) });
    build.room(DVec3::ZERO, 1.0, grey);
    build.quad(DVec3::new(-0.6, 0.5, 0.3), DVec3::X * 0.2, DVec3::NEG_Z * 0.2, panel);
    let camera = look(DVec3::new(0.1, 0.1, 0.95), DVec3::NEG_Z, DVec3::Y, Projection::Perspective { yfov: 1.3 });
    let mut stage = staged(build, &camera);
    let truth = path_traced(&stage, &camera, 1024);
    for coarse in [400, 800] {
        let of_seed = |seed| {
            let settings = TransferSettings { seed, ..settings(800, coarse, 256) };
            let (error, bias) = differences(&[relit(&mut stage, &settings), truth.clone()], 8);
            assert!(error < 0.03, "{coarse} coarse samples, seed {seed}: off by {error}");
            bias
        };
        let bias = (1..=SEEDS).map(of_seed).sum::<f64>() / SEEDS as f64;
        assert!(bias.abs() < 0.01, "{coarse} coarse samples: bias {bias:+}");
    }
}

/// A panel shines up at a mirror, which throws its light onto the floor.
#[test]
fn mirrors_throw_light_of_emitters() {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.5)));
    let shiny = build.material(mirror(Vec3::splat(0.9), 1.0));
    let panel = build.material(Material { name: "panel".into(), ..emitter(Vec3::splat(10.0)) });
    build.quad(DVec3::ZERO, DVec3::X, DVec3::NEG_Z, grey);
    build.quad(DVec3::new(0.0, 1.5, 0.0), DVec3::X * 0.3, DVec3::Z * 0.3, shiny);
    build.quad(DVec3::new(0.3, 0.7, 0.0), DVec3::X * 0.1, DVec3::NEG_Z * 0.1, panel);
    let camera = look(DVec3::new(0.0, 0.6, 1.6), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.7 });
    let (error, bias) = differences(&beside_the_path_tracer(build, &camera, 100, 8192), 8);
    assert!(error < 0.03 && bias.abs() < 0.02, "off by {error}, {bias:+}");
}

/// A panel shines up at a small card above it, which alone lights the floor: few of a row's rays find the card.
#[test]
fn small_bright_surfaces_leave_no_dots() {
    // On two levels, and on one.
    for coarse in [100, 200] {
        let mut build = Build::default();
        let grey = build.material(lambert(Vec3::splat(0.5)));
        let white = build.material(lambert(Vec3::splat(0.8)));
        let panel = build.material(Material { name: "panel".into(), ..emitter(Vec3::splat(100.0)) });
        build.quad(DVec3::ZERO, DVec3::X, DVec3::NEG_Z, grey);
        build.quad(DVec3::new(0.0, 0.75, 0.0), DVec3::X * 0.06, DVec3::Z * 0.06, white);
        build.quad(DVec3::new(0.0, 0.55, 0.0), DVec3::X * 0.03, DVec3::NEG_Z * 0.03, panel);
        let camera = look(DVec3::new(0.0, 0.6, 1.6), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.7 });
        let images = beside_the_path_tracer(build, &camera, coarse, 8192);
        let (error, bias) = differences(&images, 8);
        assert!(error < 0.03 && bias.abs() < 0.02, "{coarse}: off by {error}, {bias:+}");
        // The limit for single pixels is larger because of the path tracer's noise.
        let (error, _) = differences(&images, 1);
        assert!(error < 0.08, "{coarse}: pixels are off by {error}");
    }
}

#[test]
fn rigs_name_emitters_of_the_scene() {
    let (scene, _) = room(PANEL, PAIR);
    let complete = Emitters::of(&scene).complete(&lamp()).into_owned();
    assert_eq!(complete.lights[1..], [Light::emitter("panel", "panel"), Light::emitter("pair", "pair")]);
    assert_eq!(Emitters::of(&scene).complete(&complete).into_owned(), complete);
    // A scene in which nothing glows.
    let path = output_dir().join("emitters.toml");
    dimmed().save(&path).unwrap();
    let refused = Opened::new(&shipped("balls-2.glb"), Some(&path), &OpenSettings::default(), &());
    let reason = refused.err().expect("there is no such material").to_string();
    assert!(reason.contains("panel") && reason.contains("emitters.toml"), "{reason}");
}
