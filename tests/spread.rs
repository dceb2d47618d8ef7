//! Indirect light baked to one sample a pixel serves the samples of edges as well.

mod common;

use std::sync::Arc;

use common::stage::{Build, Setup, Stage, lambert, look, rig};
use common::{gpu, shipped, transfer};
use glam::{DVec3, Vec3};
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::relight::Layers;
use relume::scene::{Light, Projection, Scene};
use relume::shared::NO_BRDF;
use relume::storage::journal::Journal;

fn setup(samples: u32) -> Setup {
    Setup { samples, ..Setup::new(72, 48) }
}

fn stage(name: &str, setup: &Setup) -> Stage {
    let scene = Scene::load(&shipped(name)).expect("shipped scenes load");
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    Stage::new(scene, &camera, &rig, setup)
}

/// Indirect light of `stages`, of one scene, off the same gather samples: those of the first.
fn transfers<const N: usize>(stages: [&Stage; N]) -> [Arc<Transfer>; N] {
    let stage = stages[0];
    let settings =
        TransferSettings { outgoing: Outgoing::Glossy { functions: Some(9) }, ..transfer::settings(256, 256, 1024) };
    let transfer = LightTransport::new(&stage.scene, &stage.framebuffer, &settings, &|_| ());
    stages.map(|stage| {
        Arc::new(Transfer::dense(&transfer, &stage.framebuffer, Lobe::All, &mut Journal::default(), &|_| ()))
    })
}

/// Relative root mean square of a - b.
fn apart(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f((*a).into(), (*b).into()).powi(2)).sum()
    };
    (sum(&|a, b| a - b) / sum(&|_, b| b)).sqrt()
}

#[test]
fn rows_come_along_unchanged() {
    let stage = stage("balls-2.glb", &setup(1));
    let [plain] = transfers([&stage]);
    let light: Vec<DVec3> = {
        let count = plain.first().last().copied().unwrap();
        (0..count).map(|i| DVec3::splat(1.0 + f64::from(i % 7))).collect()
    };
    let itself = plain.spread(&stage.framebuffer, &stage.framebuffer, stage.scene.bvh.radius).unwrap();
    assert!(itself.is_consistent(stage.framebuffer.samples.len()));
    let (same, first) = (itself.apply(&light), plain.apply(&light));
    assert_eq!(same, first, "a sample is likest itself");
}

#[test]
fn edges_get_the_light_of_the_surface_on_either_side() {
    let gpu = gpu();
    let (one, many) = (stage("balls-2.glb", &setup(1)), stage("balls-2.glb", &setup(8)));
    let [plain, of_its_own] = transfers([&one, &many]);
    let spread = plain.spread(&one.framebuffer, &many.framebuffer, one.scene.bvh.radius).unwrap();
    assert!(spread.is_consistent(many.framebuffer.samples.len()));
    let spread = Arc::new(spread);
    let rig = many.scene.rig.clone();
    let picture = |stage: &Stage, transfer: &Arc<Transfer>| {
        let (scene, framebuffer) = (stage.scene.clone(), stage.framebuffer.clone());
        let stage = Stage { scene, framebuffer, transfer: Some(transfer.clone()) };
        let mut relighter = stage.relighter(&gpu, &rig, &setup(8));
        relighter.linear(Layers::Indirect).unwrap().to_vec()
    };
    let (want, got, aliased) = (picture(&many, &of_its_own), picture(&many, &spread), picture(&one, &plain));
    let (error, before) = (apart(&got, &want), apart(&aliased, &want));
    println!("indirect light on edges: {error:.4} off, {before:.4} with one sample a pixel");
    // Rows gathered for each sample have noise of their own.
    assert!(error < 0.5 * before, "{error}, {before} with one sample a pixel");
}

#[test]
fn larger_pictures_get_the_light_of_the_same_surfaces() {
    let gpu = gpu();
    let sizes = [Setup::new(71, 48), Setup::new(181, 120)];
    let [small, large] = [0, 1].map(|i| stage("balls-2.glb", &sizes[i]));
    let [plain, of_its_own] = transfers([&small, &large]);
    let spread = plain.upsampled(&small.framebuffer, &large.framebuffer, small.scene.bvh.radius).unwrap();
    assert!(spread.is_consistent(large.framebuffer.samples.len()));
    let picture = |transfer: &Arc<Transfer>| {
        let (scene, framebuffer) = (large.scene.clone(), large.framebuffer.clone());
        let stage = Stage { scene, framebuffer, transfer: Some(transfer.clone()) };
        let mut relighter = stage.relighter(&gpu, &large.scene.rig, &sizes[1]);
        relighter.linear(Layers::Indirect).unwrap().to_vec()
    };
    let (want, got) = (picture(&of_its_own), picture(&Arc::new(spread)));
    let error = apart(&got, &want);
    println!("indirect light of a picture 2.5 times as wide: {error:.4} off");
    assert!(error < 0.12, "{error}");
}

/// Samples that no light reaches are in no block, so nothing writes their places in the vector.
#[test]
fn larger_pictures_read_only_what_is_written() {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::splat(0.7)));
    // Two walls of a corner light each other; a board in front of them, to the right, faces the camera and nothing
    // else.
    build.quad(DVec3::new(-1.0, 0.0, -3.0), DVec3::X * 0.8, DVec3::Y, white);
    build.quad(DVec3::new(-1.8, 0.0, -2.0), -DVec3::Z, DVec3::Y, white);
    build.quad(DVec3::new(1.0, 0.0, -1.0), DVec3::X * 0.8, DVec3::Y * 0.8, white);
    let camera = look(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, DVec3::Y, Projection::Perspective { yfov: 0.9 });
    let rig = rig(vec![Light::point("point", DVec3::new(-0.5, 0.5, -1.5))]);
    let [small, large] =
        [Setup::new(48, 32), Setup::new(90, 60)].map(|setup| Stage::new(build.scene(), &camera, &rig, &setup));
    let settings =
        TransferSettings { outgoing: Outgoing::Glossy { functions: Some(9) }, ..transfer::settings(256, 256, 256) };
    let transport = LightTransport::new(&small.scene, &small.framebuffer, &settings, &|_| ());
    let compression = CompressionSettings { error: 0.03, lights: 64, lobe: Lobe::All, seed: 1 };
    let nested = Transfer::nested(&transport, &compression, &mut Journal::default(), &|_| ()).unwrap();
    let reflects = small.framebuffer.samples.iter().filter(|sample| sample.brdf != NO_BRDF).count();
    let lit = nested.chain.last().expect("there is a chain").outputs.len();
    assert!(0 < lit && lit < reflects, "{lit} of {reflects} samples are in blocks");

    let upsampled = nested.upsampled(&small.framebuffer, &large.framebuffer, small.scene.bvh.radius).unwrap();
    let mut written = vec![false; upsampled.vector_length];
    written[..upsampled.first().last().copied().unwrap() as usize].fill(true);
    for matrix in &upsampled.chain {
        assert!(matrix.inputs.iter().all(|&input| written[input as usize]), "reads what nothing wrote");
        if matrix.output_count as usize == written.len() {
            matrix.outputs.iter().for_each(|&output| written[output as usize] = true);
        }
    }
}
