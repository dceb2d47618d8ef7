//! The compressed operator against the one that it was made of.

mod common;

use std::path::Path;

use common::stage::{Build, lambert, look};
use common::{shipped, transfer};
use glam::{DVec3, Vec3};
use half::f16;
use relume::bake::compression::bounces::Bounces;
use relume::bake::compression::lights::{Kind, RandomLights};
use relume::bake::compression::training::{Group, Trainer};
use relume::bake::compression::validation::{Validation, validate};
use relume::bake::compression::{CompressionSettings, FitReport, Operator, vector_batch};
use relume::bake::transfer::Transfer;
use relume::bake::transfer::blocks::BlockMatrix;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::rows::RowBuffers;
use relume::bake::transport::{LightTransport, direct};
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::scene::{Camera, Material, Projection, Scene};
use relume::shared::{LIGHT_POINT, PackedLight};
use relume::storage::journal::Journal;
use relume::trace::bvh::TracedScene;

struct Stage {
    scene: TracedScene,
    framebuffer: DeepFramebuffer,
}

impl Stage {
    fn new(scene: Scene, camera: &Camera, size: u32) -> Self {
        let scene = TracedScene::new(scene);
        let settings = BakeSettings { width: size, height: size, layers: 4, samples: 1 };
        let framebuffer = bake(&scene, camera, &scene.rig, &settings, &|_| ());
        Self { scene, framebuffer }
    }

    fn load(path: &Path, size: u32) -> Self {
        let scene = Scene::load(path).unwrap();
        let camera = scene.cameras[0].clone();
        Self::new(scene, &camera, size)
    }

    /// A room seen from its middle.
    fn room(wall: Material, size: u32) -> Self {
        let mut build = Build::default();
        let wall = build.material(wall);
        build.room(DVec3::ZERO, 1.0, wall);
        let camera = look(DVec3::ZERO, DVec3::new(0.2, -0.1, 1.0), DVec3::Y, Projection::Perspective { yfov: 1.5 });
        Self::new(build.scene(), &camera, size)
    }

    fn transfer(&self, samples: usize, coarse_samples: usize, rays: u32) -> LightTransport<'_> {
        let settings = transfer::settings(samples, coarse_samples, rays);
        LightTransport::new(&self.scene, &self.framebuffer, &settings, &|_| ())
    }

    fn direct(&self, transfer: &LightTransport, light: &PackedLight) -> Vec<DVec3> {
        direct::shade(&self.scene, &transfer.fine, light)
    }

    fn compress(&self, transport: &LightTransport, error: f64) -> Transfer {
        let settings = CompressionSettings { error, lights: 192, lobe: Lobe::All, seed: 1 };
        let transfer = Transfer::nested(transport, &settings, &mut Journal::default(), &|_| ()).unwrap();
        assert!(transfer.is_consistent(self.framebuffer.samples.len()));
        assert!(transfer.chain.iter().flat_map(factors).all(|x| x.is_finite()));
        transfer
    }
}

fn relative(got: &[DVec3], want: &[DVec3]) -> f64 {
    let square = |v: &mut dyn Iterator<Item = DVec3>| v.map(|x| x.length_squared()).sum::<f64>();
    let error = square(&mut got.iter().zip(want).map(|(a, b)| *a - *b));
    (error / square(&mut want.iter().copied())).sqrt()
}

/// All factors of a matrix.
fn factors(matrix: &BlockMatrix) -> &[f16] {
    bytemuck::cast_slice(&matrix.values)
}

fn report(transfer: &Transfer) -> &FitReport {
    transfer.report.held_out.as_ref().expect("it is compressed")
}

/// Mean relative error of point lights that the compressor has never seen, against the dense operator.
fn held_out(stage: &Stage, transport: &LightTransport, compressed: &Transfer) -> f64 {
    let random = RandomLights::new(transport, 12345);
    let lit = (0..).filter_map(|i| random.light(Kind::Point, i)).map(|light| stage.direct(transport, &light));
    let lights: Vec<Vec<DVec3>> =
        lit.filter(|light| light.iter().filter(|x| **x != DVec3::ZERO).count() > light.len() / 4).take(64).collect();
    let all: Vec<u32> = (0..stage.framebuffer.samples.len() as u32).collect();
    let dense = transport.apply(&lights, &all, Lobe::All, &|_| ());
    let error = |(light, dense): (&Vec<DVec3>, &Vec<DVec3>)| relative(&compressed.apply(light), dense);
    lights.iter().zip(&dense).map(error).sum::<f64>() / lights.len() as f64
}

/// View samples that reflect have rows, but for tiles that get no light.
fn check_rows(compressed: &Transfer, framebuffer: &DeepFramebuffer) {
    let (rows, reflecting) = (&compressed.chain[2].outputs, framebuffer.reflecting());
    assert!(rows.iter().all(|row| reflecting.binary_search(row).is_ok()));
    assert!(10 * rows.len() > 9 * reflecting.len(), "{} rows of {}", rows.len(), reflecting.len());
}

#[test]
fn held_out_lights_come_out_as_they_do_of_the_dense_operator() {
    for (scene, coarse) in [("cornell-diffuse.glb", 256), ("cornell-glossy.glb", 192), ("balls-2.glb", 256)] {
        let stage = Stage::load(&shipped(scene), 64);
        let transfer = stage.transfer(1024, coarse, 512);
        let compressed = stage.compress(&transfer, 0.01);
        let report = report(&compressed);
        check_rows(&compressed, &stage.framebuffer);
        let error = held_out(&stage, &transfer, &compressed);
        println!(
            "{scene}: {error:.4}, points {:.4}, spots {:.4}, noise {:.4}",
            report.point, report.spot, report.noise
        );
        // Noise that is left out counts as error here, and there is much with so few rays; both together are at most
        // half of what was asked for longer than noise alone.
        assert!(error < report.noise + 0.005, "{scene}: {error}, noise {}", report.noise);
        // Dense is 3 for each of 1,024 to some 10,000 coefficients.
        let (pixels, coefficients) = (stage.framebuffer.reflecting().len(), transfer.fine.coefficient_count());
        let (dense, (bytes, multiply_adds)) = (3 * (pixels * coefficients) as u64, compressed.cost());
        assert!(multiply_adds < dense / 2, "{scene}: {multiply_adds} of {dense}");
        if scene != "cornell-diffuse.glb" {
            continue;
        }
        // Against rows gathered anew the noise that was left out tells in its favour.
        let judged = Validation { rays: 2048, share: 0.25, lights: 6, lobe: Lobe::All, seed: 99 };
        let direct = |light: &PackedLight| stage.direct(&transfer, light);
        let [points, spots] = validate(&transfer, &direct, |light| compressed.apply(light), &judged, &|_| ());
        println!("{points:?} {spots:?}");
        assert!(points.error < points.rows + 0.005, "{scene}: {points:?}");
        // Looser is smaller, and further off.
        let looser = stage.compress(&transfer, 0.2);
        assert!(looser.cost().0 < bytes && held_out(&stage, &transfer, &looser) > error);
    }
}

#[test]
fn light_adds_up() {
    let stage = Stage::room(lambert(Vec3::new(0.7, 0.5, 0.2)), 32);
    let transfer = stage.transfer(200, 200, 64);
    let compressed = stage.compress(&transfer, 0.02);
    let random = RandomLights::new(&transfer, 7);
    let mut lights = (0..).filter_map(|i| random.light(Kind::Point, i)).map(|light| stage.direct(&transfer, &light));
    let [a, b] = [lights.next().unwrap(), lights.next().unwrap()];
    let mixed: Vec<DVec3> = a.iter().zip(&b).map(|(a, b)| 2.0 * a + DVec3::new(0.5, 0.0, 3.0) * b).collect();
    let [from_a, from_b, from_both] = [&a, &b, &mixed].map(|light| compressed.apply(light));
    let sum: Vec<DVec3> = from_a.iter().zip(&from_b).map(|(a, b)| 2.0 * a + DVec3::new(0.5, 0.0, 3.0) * b).collect();
    assert!(relative(&from_both, &sum) < 1e-12);
    assert!(from_a.iter().any(|x| *x != DVec3::ZERO));
}

/// Rounding factors to half precision moves the picture by less than half of its last digit, 2^-11, three times over.
#[test]
fn half_precision_costs_nothing() {
    let stage = Stage::room(lambert(Vec3::splat(0.6)), 32);
    let transfer = stage.transfer(200, 200, 64);
    let compressed = stage.compress(&transfer, 0.01);
    let random = RandomLights::new(&transfer, 8);
    let mut lights = (0..).filter_map(|i| random.light(Kind::Point, i)).map(|light| stage.direct(&transfer, &light));
    let light = lights.find(|light| light.iter().any(|x| *x != DVec3::ZERO)).unwrap();
    let before = compressed.apply(&light);
    // One more rounding, to a digit less, shows what rounding does.
    let coarser = |x: &mut f16| *x = f16::from_bits((x.to_bits() + 1) & !1);
    let mut rounded = compressed.clone();
    for matrix in &mut rounded.chain {
        bytemuck::cast_slice_mut::<_, f16>(matrix.values.to_mut()).iter_mut().for_each(coarser);
    }
    let moved = relative(&rounded.apply(&light), &before);
    assert!(moved > 0.0 && moved < 3.0 * f64::exp2(-10.0), "{moved}");
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    let stage = Stage::load(&shipped("cornell-glossy.glb"), 24);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| stage.compress(&stage.transfer(128, 64, 32), 0.05))
    };
    let (one, three) = (on(1), on(3));
    let bits = |transfer: &Transfer| transfer.chain.iter().map(|m| factors(m).to_vec()).collect::<Vec<_>>();
    assert!(bits(&one) == bits(&three) && report(&one) == report(&three) && one.chain.iter().all(|m| m.bytes() > 0));
}

/// None would be a few percent of the diagonal from floor and ceiling.
#[test]
fn low_rooms_have_lights() {
    let mut build = Build::default();
    let wall = build.material(lambert(Vec3::new(0.8, 0.5, 0.6)));
    let (x, y, z) = (DVec3::X * 20.0, DVec3::Y * 1.25, DVec3::Z * 15.0);
    for [a, b, c] in [[x, y, z], [y, z, x], [z, x, y]] {
        build.quad(-a, b, c, wall).quad(a, c, b, wall);
    }
    let eye = DVec3::new(-18.0, 0.5, -13.0);
    let camera = look(eye, DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.0 });
    let stage = Stage::new(build.scene(), &camera, 48);
    let transfer = stage.transfer(1024, 256, 256);
    let compressed = stage.compress(&transfer, 0.01);
    let report = report(&compressed);
    check_rows(&compressed, &stage.framebuffer);
    let error = held_out(&stage, &transfer, &compressed);
    println!("{error:.4}, points {:.4}, spots {:.4}, noise {:.4}", report.point, report.spot, report.noise);
    assert!(report.point > 0.0 && error < report.noise + 0.005, "{error}, noise {}", report.noise);
}

#[test]
fn lights_come_again_where_few_are_seen() {
    let stage = Stage::room(lambert(Vec3::splat(0.6)), 16);
    let transfer = stage.transfer(100, 50, 64);
    let operator = Operator { transport: &transfer, from_sky: None };
    let bounces = Bounces::new(operator);
    // Points in some thin slices of the room, no spots.
    let direct =
        |light: &PackedLight| match light.kind == LIGHT_POINT && (100.0 * light.position.x).fract().abs() < 0.02 {
            true => stage.direct(&transfer, light),
            false => vec![DVec3::ZERO; transfer.fine.coefficient_count()],
        };
    let probes = transfer.rows(&stage.framebuffer.reflecting(), Lobe::All);
    let trainer = Trainer { operator, bounces: &bounces, direct: &direct, probes: &probes, share: 1.0 };
    let group = |kind, count| Group { kind, count, seed: 5 };
    let lights = trainer.lights(&[group(Kind::Spot, 3), group(Kind::Point, 40)]);
    let squares = vector_batch::multiply(&probes, &bounces.seen(&lights.direct, &lights.further)).squares();
    assert_eq!(squares[..3], [0.0; 3]);
    assert!(squares[3..].iter().all(|square| (square - 1.0).abs() < 1e-3), "{squares:?}");
    let first = |light: usize| {
        (0..transfer.fine.coefficient_count()).find(|&i| lights.direct.get(0, i, light) != lights.direct.get(0, i, 3))
    };
    let again = (4..43).find(|&light| first(light).is_none()).unwrap();
    assert!((5..30).contains(&again), "light {again} is the first one again");
}

#[test]
fn nothing_to_compress() {
    // No gather samples; nothing that reflects; one of each.
    let black = Stage::room(lambert(Vec3::ZERO), 8);
    let nothing = black.compress(&black.transfer(50, 50, 16), 0.01);
    assert!(nothing.chain.iter().all(|matrix| matrix.panels.is_empty()) && report(&nothing).tiles.is_empty());
    assert!(nothing.apply(&[]).iter().all(|x| *x == DVec3::ZERO));

    let grey = Stage::room(lambert(Vec3::splat(0.5)), 8);
    for coarse in [1, 0] {
        let transfer = grey.transfer(1, coarse, 64);
        let one = grey.compress(&transfer, 0.01);
        check_rows(&one, &grey.framebuffer);
        let light = vec![DVec3::new(1.0, 2.0, 3.0); transfer.fine.coefficient_count()];
        let all: Vec<u32> = (0..grey.framebuffer.samples.len() as u32).collect();
        let dense = transfer.apply(std::slice::from_ref(&light), &all, Lobe::All, &|_| ()).remove(0);
        assert!(relative(&one.apply(&light), &dense) < 1e-3);
    }

    let away = look(DVec3::splat(9.0), DVec3::splat(10.0), DVec3::Y, Projection::Perspective { yfov: 1.0 });
    let mut build = Build::default();
    let wall = build.material(lambert(Vec3::splat(0.5)));
    build.room(DVec3::ZERO, 1.0, wall);
    let unseen = Stage::new(build.scene(), &away, 8);
    let none = unseen.compress(&unseen.transfer(50, 20, 16), 0.01);
    assert!(none.chain[2].panels.is_empty());
}

#[test]
fn rows_are_the_same_in_used_buffers() {
    let stage = Stage::room(lambert(Vec3::splat(0.6)), 16);
    let transfer = stage.transfer(100, 50, 64);
    let all = stage.framebuffer.reflecting();
    let gatherer = transfer.row_gatherer(Lobe::All);
    let mut buffers = RowBuffers::default();
    for some in [&all[..40], &all[40..57], &[], &all[7..80]] {
        gatherer.gather_to(some, &mut buffers);
        assert_eq!(buffers.rows, gatherer.gather(some), "{} rows", some.len());
        assert_eq!(buffers.rows.len(), some.len());
    }
}
