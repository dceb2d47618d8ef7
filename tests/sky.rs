//! Light of the sky by its cells: while domes turn, and what mirrors throw.

mod common;

use std::f64::consts::TAU;
use std::sync::Arc;

use common::domes::{dome, map};
use common::stage::{Build, Setup, Stage, lambert, look, mirror, rig};
use common::{assert_near, gpu, largest, shipped, transfer};
use glam::{DVec3, Vec3};
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transfer::sky::SkyTransfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, sky};
use relume::physics::sky_cells;
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::relight::{Detail, Request};
use relume::scene::light_filter::Attached;
use relume::scene::{Camera, Light, Material, Projection, Scene, SkyMap};
use relume::session::{BakeInput, BakeReport, Form, IndirectSettings};
use relume::storage::journal::Journal;

/// The first picture after an edit.
fn moving() -> Request {
    Request { detail: Detail::Progressive, ..Request::default() }
}

/// Blue above, brown below, and a bright cloud.
fn clouds() -> Attached<SkyMap> {
    map("clouds", [64, 32], |x, y| match (x, y) {
        (8..24, 4..12) => Vec3::new(4.0, 3.5, 3.0),
        _ if y < 16 => Vec3::new(0.3, 0.5, 0.9),
        _ => Vec3::new(0.2, 0.12, 0.06),
    })
}

/// A stage with compressed indirect light, and light of the sky.
fn stage(scene: Scene, camera: &Camera, setup: &Setup, [samples, coarse, rays]: [usize; 3]) -> Stage {
    let mut stage = Stage::new(scene, camera, &rig(vec![dome(None)]), setup);
    let settings = transfer::settings(samples, coarse, rays as u32);
    let transport = LightTransport::new(&stage.scene, &stage.framebuffer, &settings, &|_| ());
    let to = CompressionSettings { error: 0.02, lights: 192, lobe: Lobe::All, seed: 1 };
    let nested = Transfer::nested(&transport, &to, &mut Journal::default(), &|_| ()).unwrap();
    let sky = SkyTransfer::new(&transport, &to, &mut Journal::default(), &|_| ()).unwrap();
    println!("held out: broad {:.4}, narrow {:.4}", sky.held_out.point, sky.held_out.spot);
    assert!(sky.is_consistent(stage.framebuffer.samples.len()));
    stage.transfer = Some(Arc::new(Transfer { sky: Some(sky), ..nested }));
    stage
}

/// A room without a ceiling, and a block in it.
fn pit(albedo: f32) -> (Scene, Camera) {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::splat(albedo)));
    build.room(DVec3::ZERO, 1.0, white);
    build.quads.remove(3); // the ceiling
    for (axis, side) in [(DVec3::X, 1.0), (DVec3::X, -1.0), (DVec3::Y, 1.0), (DVec3::Z, 1.0), (DVec3::Z, -1.0)] {
        let (u, v) = (DVec3::new(axis.y, axis.z, axis.x), DVec3::new(axis.z, axis.x, axis.y));
        build.quad(DVec3::new(0.2, -0.7, -0.1) + 0.3 * side * axis, 0.3 * side * v, 0.3 * u, white);
    }
    let camera =
        look(DVec3::new(-0.7, 1.6, 0.8), DVec3::new(0.1, -0.6, 0.0), DVec3::Y, Projection::Perspective { yfov: 0.5 });
    (build.scene(), camera)
}

/// Relative RMSE and bias.
fn errors(image: &[[f32; 3]], truth: &[[f32; 3]]) -> [f64; 2] {
    let difference = |(a, b): (&[f32; 3], &[f32; 3])| Vec3::from(*a).as_dvec3() - Vec3::from(*b).as_dvec3();
    let pairs = || image.iter().zip(truth).map(difference);
    let values = || truth.iter().flatten().map(|x| f64::from(*x));
    let bias = pairs().map(DVec3::element_sum).sum::<f64>() / values().sum::<f64>();
    [(pairs().map(DVec3::length_squared).sum::<f64>() / values().map(|x| x * x).sum::<f64>()).sqrt(), bias]
}

/// White surfaces under a white sky are as bright as the sky, also while it turns.
#[test]
fn a_white_furnace_turns() {
    let gpu = gpu();
    let (scene, camera) = pit(1.0);
    let setup = Setup::new(48, 32);
    let stage = stage(scene, &camera, &setup, [1200, 600, 1024]);
    let all = rig(vec![dome(None)]);
    let picture = stage.relighter(&gpu, &all, &setup).linear(moving()).unwrap().to_vec();
    let seen = || picture.iter().flatten().filter(|x| **x > 0.0).map(|&x| f64::from(x));
    let mean = seen().sum::<f64>() / seen().count() as f64;
    let spread = (seen().map(|x| (x - mean).powi(2)).sum::<f64>() / seen().count() as f64).sqrt();
    println!("mean {mean:.4}, deviation {spread:.4}");
    assert_near(mean, 1.0, 1e-2, "mean");
    assert!(spread < 0.05, "{spread}");
}

/// The device multiplies what the double-precision twin does, wherever the dome is turned; whole turns change nothing.
#[test]
fn the_device_and_its_twin() {
    let gpu = gpu();
    let (scene, camera) = pit(0.6);
    let setup = Setup::new(48, 32);
    let stage = stage(scene, &camera, &setup, [600, 200, 256]);
    let mut all = rig(vec![dome(Some(clouds()))]);
    let mut relighter = stage.relighter(&gpu, &all, &setup);
    let mut first = Vec::new();
    for turn in 0..7 {
        all.lights[0].rotation = f64::from(turn) * TAU / 6.0;
        relighter.set_rig(&all).unwrap();
        let picture = relighter.linear(moving()).unwrap().to_vec();
        let light = &all.lights[0];
        assert!(light.sky().parts().suns().is_empty());
        let glow = light.sky().parts().glow(light.turns());
        assert_eq!(glow.len(), sky_cells::COUNT);
        let twice: Vec<DVec3> = glow.iter().chain(&glow).map(|x| x.as_dvec3()).collect();
        assert_eq!(twice.len(), sky::COLUMNS);
        let want = stage.transfer.as_ref().unwrap().sky.as_ref().unwrap().apply(&twice);
        let tiling = stage.framebuffer.tiling;
        let most = largest(want.iter().flat_map(|x| x.to_array()));
        for (i, got) in picture.iter().enumerate() {
            let want = want[tiling.index(i as u32 % 48, i as u32 / 48)];
            // Sums of hundreds of terms in single precision.
            let error = largest((Vec3::from(*got).as_dvec3() - want).abs().to_array());
            assert!(error < 1e-4 * most, "{i}: {got:?}, want {want}");
        }
        assert_eq!(turn == 0 || turn == 6, first.is_empty() || picture == first, "turn {turn}");
        if first.is_empty() {
            first = picture;
        }
    }
}

/// Light that a mirror throws onto a floor, beside the path tracer, in every form of the operator; without the cells it
/// is missing.
#[test]
fn what_mirrors_throw() {
    let gpu = gpu();
    let mut build = Build::default();
    let (grey, silver) = (build.material(lambert(Vec3::splat(0.5))), build.material(mirror(Vec3::splat(0.9), 1.0)));
    build.quad(DVec3::ZERO, DVec3::X, DVec3::NEG_Z, grey);
    build.quad(DVec3::new(0.0, 1.0, -1.0), DVec3::X, DVec3::Y, silver);
    let camera =
        look(DVec3::new(0.3, 2.0, 0.8), DVec3::new(0.0, 0.0, -0.1), DVec3::Y, Projection::Perspective { yfov: 0.6 });
    let (setup, scene) = (Setup::new(48, 48), build.scene());
    // Bright before the mirror.
    let front = map("front", [32, 16], |x, y| Vec3::splat(if (8..24).contains(&x) && y < 8 { 2.0 } else { 0.1 }));
    let all = rig(vec![dome(Some(front))]);
    let mut stage = stage(scene, &camera, &setup, [400, 100, 512]);
    let settings = Settings {
        width: 48,
        height: 48,
        layers: 4,
        max_bounces: None,
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed: 1,
    };
    let film = PathTracer::new(&stage.scene, &camera, &all, &settings).trace(1024, &|| false, &|_| ());
    let truth = film.layer(Half::Both, Layer::Beauty);
    let compare = |what: &str, stage: &Stage, detail| {
        let picture = stage.relighter(&gpu, &all, &setup).linear(Request { detail, ..moving() }).unwrap().to_vec();
        let [error, bias] = errors(&picture, &truth);
        println!("{what}: error {error:.4}, bias {bias:+.4}");
        [error, bias]
    };
    let [error, bias] = compare("at rest", &stage, Detail::Exact);
    assert!(error < 0.06 && bias.abs() < 0.01, "at rest: off by {error}, {bias}");
    let [error, bias] = compare("while it turns", &stage, Detail::Progressive);
    assert!(error < 0.1 && bias.abs() < 0.02, "while it turns: off by {error}, {bias}");
    for form in [Form::Nested(0.02), Form::Haar(0.02), Form::Dense] {
        let outgoing = Outgoing::Glossy { functions: None };
        let (gather, rays) = (Some(400), Some(512));
        let plan = IndirectSettings::Robust { outgoing, form, gather, rays, bounces: None }.plan([48, 48], 4, 1);
        let input = BakeInput { scene: &stage.scene, framebuffer: &stage.framebuffer };
        let made = plan.bake(input, Lobe::All, true, &mut BakeReport::default(), &()).unwrap();
        stage.transfer = Some(Arc::new(made));
        let [error, bias] = compare(&format!("{form:?}"), &stage, Detail::Exact);
        assert!(error < 0.06 && bias.abs() < 0.01, "{form:?}: off by {error}, {bias}");
    }
    let without = Transfer { sky: None, ..Transfer::clone(stage.transfer.as_ref().unwrap()) };
    stage.transfer = Some(Arc::new(without));
    let [_, bias] = compare("without cells", &stage, Detail::Exact);
    assert!(bias < -0.1, "mirrors throw light: {bias}");
}

/// Where there is no mirror, cells add nothing to a picture at rest.
#[test]
fn without_mirrors_rest_needs_no_cells() {
    let gpu = gpu();
    let (scene, camera) = pit(0.6);
    let setup = Setup::new(24, 16);
    let mut stage = stage(scene, &camera, &setup, [300, 100, 128]);
    let all = rig(vec![dome(Some(clouds()))]);
    let exact = |stage: &Stage| stage.relighter(&gpu, &all, &setup).linear(Request::default()).unwrap().to_vec();
    let with = exact(&stage);
    let transfer = Transfer::clone(stage.transfer.as_ref().unwrap());
    let cells = transfer.sky.as_ref().unwrap();
    assert!(!cells.has_mirrors());
    let by_mirrors: Vec<DVec3> = (0..sky::COLUMNS).map(|i| DVec3::splat(f64::from(i >= sky_cells::COUNT))).collect();
    assert!(cells.apply(&by_mirrors).iter().all(|x| *x == DVec3::ZERO));
    stage.transfer = Some(Arc::new(Transfer { sky: None, ..transfer }));
    assert!(with == exact(&stage));
}

/// A picture while a dome turns is near the one at rest, under a glow and under a small sun.
#[test]
fn turning_is_near_rest() {
    let gpu = gpu();
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let camera = scene.cameras[0].clone();
    let setup = Setup::new(96, 64);
    let stage = stage(scene, &camera, &setup, [1536, 400, 256]);
    let sun = map("sun", [512, 256], |x, y| match (x, y) {
        (300..303, 60..63) => Vec3::new(4e4, 3e4, 2e4),
        _ if y < 128 => Vec3::new(1.0, 1.5, 2.5),
        _ => Vec3::splat(0.4),
    });
    for (what, map, suns, most) in [("a glow", clouds(), 0, 0.08), ("a sun", sun, 1, 0.08)] {
        let all = rig(vec![Light { rotation: 0.7, ..dome(Some(map)) }]);
        assert_eq!(all.lights[0].sky().parts().suns().len(), suns);
        let [moving, exact] = [Detail::Progressive, Detail::Exact]
            .map(|detail| stage.relighter(&gpu, &all, &setup).linear(Request { detail, ..moving() }).unwrap().to_vec());
        let [error, bias] = errors(&moving, &exact);
        println!("{what}: error {error:.4}, bias {bias:+.4}");
        assert!(error < most && bias.abs() < 0.02, "{what}: off by {error}, {bias}");
    }
}

/// Gloss shows a sun while the dome turns no brighter than at rest, though the sun is traced as a direction.
#[test]
fn gloss_does_not_sparkle() {
    let gpu = gpu();
    let mut build = Build::default();
    let metal = build.material(Material { metallic: 1.0, roughness: 0.08, ..lambert(Vec3::splat(0.8)) });
    build.quad(DVec3::ZERO, DVec3::X, DVec3::NEG_Z, metal);
    let camera = look(DVec3::new(0.0, 1.0, -1.0), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.3 });
    let setup = Setup::new(64, 64);
    let stage = stage(build.scene(), &camera, &setup, [200, 50, 128]);
    let sun = map("small sun", [512, 256], |x, y| match (x, y) {
        (255..258, 60..63) => Vec3::splat(4e4),
        _ => Vec3::splat(0.4),
    });
    let all = rig(vec![dome(Some(sun))]);
    assert_eq!(all.lights[0].sky().parts().suns().len(), 1);
    let [moving, exact] = [Detail::Progressive, Detail::Exact].map(|detail| {
        let request = Request { detail, ..Request::default() };
        let picture = stage.relighter(&gpu, &all, &setup).linear(request).unwrap().to_vec();
        let sum = picture.iter().flatten().map(|&x| f64::from(x)).sum::<f64>();
        (largest(picture.iter().flatten().map(|&x| f64::from(x))), sum)
    });
    println!("brightest and sum: {moving:?}, at rest {exact:?}");
    assert!(moving.0 < 1.5 * exact.0);
    assert_near(moving.1, exact.1, 0.1, "sum");
}

/// No light of the sky is kept where none arrives.
#[test]
fn closed_rooms_keep_nothing() {
    let gpu = gpu();
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.6)));
    build.room(DVec3::ZERO, 1.0, grey);
    let camera = look(DVec3::ZERO, DVec3::new(0.2, -0.1, 1.0), DVec3::Y, Projection::Perspective { yfov: 1.5 });
    let setup = Setup::new(16, 16);
    let mut stage = Stage::new(build.scene(), &camera, &rig(vec![]), &setup);
    let transport = LightTransport::new(&stage.scene, &stage.framebuffer, &transfer::settings(200, 100, 64), &|_| ());
    let to = CompressionSettings { error: 0.02, lights: 64, lobe: Lobe::All, seed: 1 };
    let nested = Transfer::nested(&transport, &to, &mut Journal::default(), &|_| ()).unwrap();
    let sky = SkyTransfer::new(&transport, &to, &mut Journal::default(), &|_| ()).unwrap();
    assert!(sky.chain.is_empty());
    stage.transfer = Some(Arc::new(Transfer { sky: Some(sky), ..nested }));
    let all = rig(vec![dome(None)]);
    for detail in [Detail::Progressive, Detail::Exact] {
        let picture = stage.relighter(&gpu, &all, &setup).linear(Request { detail, ..moving() }).unwrap().to_vec();
        assert!(picture.iter().flatten().all(|x| *x == 0.0));
    }
}
