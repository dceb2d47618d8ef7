//! Indirect light baked to one sample a pixel serves the samples of edges as well.

mod common;

use std::sync::Arc;

use common::stage::{Setup, Stage};
use common::{gpu, shipped, transfer};
use glam::DVec3;
use relume::bake::Baked;
use relume::bake::spread::spread;
use relume::bake::transfer::baked::BakedTransfer;
use relume::bake::transfer::rows::Lobe;
use relume::bake::transfer::{Outgoing, Transfer, TransferSettings};
use relume::relight::{Layers, Picture};
use relume::scene::Scene;
use relume::storage::journal::Journal;

fn setup(samples: u32) -> Setup {
    Setup { samples, ..Setup::new(72, 48) }
}

fn stage(name: &str, samples: u32) -> Stage {
    let scene = Scene::load(&shipped(name)).expect("shipped scenes load");
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    Stage::new(scene, &camera, &rig, &setup(samples))
}

/// The deep framebuffers of `stages`, of one scene, with indirect light off the same gather samples: those of the first.
fn with_transfer<const N: usize>(stages: [&Stage; N]) -> [Arc<Baked>; N] {
    let stage = stages[0];
    let settings =
        TransferSettings { outgoing: Outgoing::Glossy { functions: Some(9) }, ..transfer::settings(256, 256, 1024) };
    let transfer = Transfer::new(&stage.scene, &stage.baked, &settings, &|_| ());
    stages.map(|stage| {
        let dense = BakedTransfer::dense(&transfer, &stage.baked, Lobe::All, &mut Journal::default(), &|_| ());
        Arc::new(Baked { transfer: Some(dense), ..Baked::clone(&stage.baked) })
    })
}

#[test]
fn rows_come_along_unchanged() {
    let stage = stage("balls-2.glb", 1);
    let [plain] = with_transfer([&stage]);
    let light: Vec<DVec3> = {
        let count = plain.transfer.as_ref().unwrap().first().last().copied().unwrap();
        (0..count).map(|i| DVec3::splat(1.0 + f64::from(i % 7))).collect()
    };
    let itself = spread(&plain, &plain, stage.scene.bvh.radius).unwrap();
    assert!(itself.is_consistent(plain.samples.len()));
    let (same, first) = (itself.apply(&light), plain.transfer.as_ref().unwrap().apply(&light));
    assert_eq!(same, first, "a sample is likest itself");
}

#[test]
fn edges_get_the_light_of_the_surface_on_either_side() {
    let gpu = gpu();
    let (one, many) = (stage("balls-2.glb", 1), stage("balls-2.glb", 8));
    let [plain, of_its_own] = with_transfer([&one, &many]);
    let spread = spread(&plain, &many.baked, one.scene.bvh.radius).unwrap();
    assert!(spread.is_consistent(many.baked.samples.len()));
    let spread = Arc::new(Baked { transfer: Some(spread), ..Baked::clone(&many.baked) });
    let rig = many.scene.rig.clone();
    let picture = |baked: &Arc<Baked>| {
        let stage = Stage { scene: many.scene.clone(), baked: baked.clone() };
        let mut relighter = stage.relighter(&gpu, &rig, &setup(8));
        relighter.set_layers(Layers::Indirect);
        relighter.linear(Picture::Whole).unwrap().to_vec()
    };
    let apart = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f((*a).into(), (*b).into()).powi(2)).sum()
        };
        (sum(&|a, b| a - b) / sum(&|_, b| b)).sqrt()
    };
    let (want, got, aliased) = (picture(&of_its_own), picture(&spread), picture(&plain));
    let (error, before) = (apart(&got, &want), apart(&aliased, &want));
    println!("indirect light on edges: {error:.4} off, {before:.4} with one sample a pixel");
    // Rows gathered for each sample have noise of their own.
    assert!(error < 0.5 * before, "{error}, {before} with one sample a pixel");
}
