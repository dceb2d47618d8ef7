//! Pictures made in a hurry: near the exact ones, and finished the same to the last bit.

mod common;

use std::sync::Arc;

use common::stage::{Setup, Stage};
use common::{Gpu, gpu, shipped, transfer};
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::relight::{Detail, Layers, Relighter, Request};
use relume::scene::{Rig, Scene};
use relume::storage::journal::Journal;

fn setup() -> Setup {
    Setup::new(120, 80)
}

/// A shipped scene with a small compressed transfer.
fn stage(name: &str) -> Stage {
    let scene = Scene::load(&shipped(name)).expect("shipped scenes load");
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    let mut stage = Stage::new(scene, &camera, &rig, &setup());
    let settings =
        TransferSettings { outgoing: Outgoing::Glossy { functions: Some(9) }, ..transfer::settings(512, 128, 128) };
    let transfer = LightTransport::new(&stage.scene, &stage.framebuffer, &settings, &|_| ());
    let settings = CompressionSettings { error: 0.02, lights: 128, lobe: Lobe::All, seed: 1 };
    let nested = Transfer::nested(&transfer, &settings, &mut Journal::default(), &|_| ()).unwrap().with_coarse();
    stage.transfer = Some(Arc::new(nested));
    stage
}

fn relighter(gpu: &Gpu, stage: &Stage, rig: &Rig) -> Relighter {
    stage.relighter(gpu, rig, &setup())
}

fn whole(relighter: &mut Relighter, detail: Detail) -> Vec<[f32; 3]> {
    relighter.linear(Request { detail, ..Request::default() }).unwrap().to_vec()
}

/// Relative root mean square.
fn apart(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let sum = |f: &dyn Fn(f64, f64) -> f64| {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f((*a).into(), (*b).into()).powi(2)).sum::<f64>()
    };
    (sum(&|a, b| a - b) / sum(&|_, b| b)).sqrt()
}

fn bits(picture: &[[f32; 3]]) -> Vec<u32> {
    picture.iter().flatten().map(|x| x.to_bits()).collect()
}

#[test]
fn what_is_finished_is_the_exact_picture() {
    let gpu = gpu();
    let stage = stage("balls-2.glb");
    let mut rig = stage.scene.rig.clone();
    let mut hurried = relighter(&gpu, &stage, &rig);
    let first = whole(&mut hurried, Detail::Exact);
    // A drag of one light, then of another, all in a hurry.
    for step in 0..6 {
        rig.lights[step / 3].position.x += 0.05;
        hurried.set_rig(&rig).unwrap();
        hurried.select(&[step / 3]);
        let coarse = whole(&mut hurried, Detail::Coarse);
        assert!(hurried.is_coarse());
        let mut exact = relighter(&gpu, &stage, &rig);
        let error = apart(&coarse, &whole(&mut exact, Detail::Exact));
        assert!((1e-6..0.2).contains(&error), "step {step}: {error}");
        assert!(apart(&coarse, &first) > 1e-3, "the edit shows");
    }
    let finished = whole(&mut hurried, Detail::Exact);
    assert!(!hurried.is_coarse());
    let mut exact = relighter(&gpu, &stage, &rig);
    exact.select(&[1]);
    assert_eq!(bits(&finished), bits(&whole(&mut exact, Detail::Exact)), "to the last bit");
    // Nothing is left to do.
    whole(&mut hurried, Detail::Exact);
    assert!(hurried.times().is_empty());
    // What is up to date is not made coarser.
    whole(&mut hurried, Detail::Coarse);
    assert!(!hurried.is_coarse() && hurried.times().is_empty());
}

#[test]
fn a_part_of_the_transfer_is_near_all_of_it_and_smaller() {
    let gpu = gpu();
    let stage = stage("cornell-glossy.glb");
    let transfer = stage.transfer.as_ref().unwrap();
    let size = |chain: &[relume::bake::transfer::blocks::BlockMatrix]| chain.iter().map(|m| m.bytes()).sum::<usize>();
    let (whole_size, part) = (size(&transfer.chain), size(&transfer.coarse));
    assert!(part < whole_size / 2, "{part} of {whole_size} bytes");
    assert!(transfer.coarse.iter().all(|matrix| matrix.is_consistent()));
    let rig = stage.scene.rig.clone();
    let mut exact = relighter(&gpu, &stage, &rig);
    let mut coarse = relighter(&gpu, &stage, &rig);
    let coarsely = Request { detail: Detail::Coarse, ..Layers::Indirect.into() };
    let error = apart(coarse.linear(coarsely).unwrap(), exact.linear(Layers::Indirect).unwrap());
    println!("indirect light in a hurry: {error:.4} off with {part} of {whole_size} bytes");
    // Rows of few rays are noisy, and directions that hold noise are the first to go.
    assert!((1e-5..0.3).contains(&error), "{error}");
}
