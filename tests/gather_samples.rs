//! Gather samples: where they lie, what area they stand for, and in which order.

mod common;

use std::time::Instant;

use common::stage::{Build, lambert, mirror};
use common::{assert_near, shared};
use glam::{DVec3, Vec3};
use relume::bake::gather_samples::{GatherSamples, Placement, Surfaces};
use relume::scene::{Material, Scene};
use relume::trace::bvh::TracedScene;
use relume::trace::point_tree::middle;

const CLUSTERED: Placement = Placement::Clustered { points: 4 };

fn place(scene: &Scene, placement: Placement, count: usize, seed: u64) -> GatherSamples {
    let scene = &TracedScene::new(scene.clone());
    GatherSamples::place(scene, &Surfaces::even(scene), placement, count, seed)
}

/// Square metres.
fn area(scene: &Scene, samples: &GatherSamples) -> f64 {
    samples.area() * scene.space.unit.powi(2)
}

fn room(half: f64) -> Build {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::ONE));
    build.room(DVec3::new(3.0, 1.0, -2.0), half, white);
    build
}

/// Largest distance between a sample and its own points, in units of the side of a square of its mean area.
fn spread(samples: &GatherSamples) -> f32 {
    let width = (samples.area() / samples.len() as f64).sqrt() as f32;
    let farthest = |i: usize| {
        samples.points_of(i).iter().map(|p| p.position.distance(samples.samples[i].position)).fold(0.0, f32::max)
    };
    (0..samples.len()).map(farthest).fold(0.0, f32::max) / width
}

#[test]
fn samples_share_out_the_area() {
    for (half, placement) in [(1.0, CLUSTERED), (1e-3, CLUSTERED), (1e3, CLUSTERED), (1.0, Placement::Random)] {
        let scene = room(half).scene();
        let samples = place(&scene, placement, 500, 1);
        assert!((490..=500).contains(&samples.len()), "{} samples", samples.len());
        assert_near(
            area(&scene, &samples),
            24.0 * half * half,
            0.02 * f64::from(placement == Placement::Random) + 1e-5,
            "area",
        );
        let off = |p: Vec3| (scene.space.to_world(p) - scene.space.origin).abs().max_element();
        assert!(samples.samples.iter().all(|s| off(s.position) <= half * 1.0001));
        if placement == CLUSTERED {
            let mean = samples.area() / samples.len() as f64;
            let areas = samples.samples.iter().map(|s| f64::from(s.area) / mean);
            let (least, most) = areas.fold((f64::MAX, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
            assert!(least > 0.3 && most < 2.0, "areas from {least} to {most} of the mean");
            assert!(spread(&samples) < 1.3, "clusters reach {} of their width", spread(&samples));
            assert!(
                samples.samples.iter().all(|s| s.normal.abs().max_element() > 0.999),
                "a cluster bends round an edge"
            );
        }
    }
}

#[test]
fn the_order_is_that_of_a_balanced_tree() {
    let samples = place(&room(1.0).scene(), CLUSTERED, 512, 1);
    let width = |first: usize, end: usize| {
        let all = || samples.samples[first..end].iter().map(|s| s.position);
        (all().reduce(Vec3::max).unwrap() - all().reduce(Vec3::min).unwrap()).length()
    };
    // Halving three times leaves pieces of eight that lie together.
    let mut nodes = vec![(0, samples.len())];
    while nodes[0].1 - nodes[0].0 > 8 {
        nodes = nodes.into_iter().flat_map(|(a, b)| [(a, middle(a, b)), (middle(a, b), b)]).collect();
    }
    let mean = nodes.iter().map(|&(a, b)| width(a, b)).sum::<f32>() / nodes.len() as f32;
    assert!(mean < 1.2, "eight neighbours are {mean} m across in a room of 2 m with 512 samples");
}

/// A box upon the floor: neither its inside nor the floor under it gets a sample; mirrors get none either.
#[test]
fn enclosed_surfaces_and_mirrors_get_none() {
    let mut build = room(1.0);
    let outside = build.material(lambert(Vec3::ONE));
    let glass = build.material(mirror(Vec3::ONE, 1.0));
    let floor = DVec3::new(3.0, 0.0, -2.0);
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let (u, v) = (0.4 * DVec3::new(axis.y, axis.z, axis.x), 0.4 * DVec3::new(axis.z, axis.x, axis.y));
        let material = if axis == DVec3::Y { outside } else { glass };
        build.quad(floor + DVec3::Y * 0.4 + axis * 0.4, v, u, material);
        build.quad(floor + DVec3::Y * 0.4 - axis * 0.4, u, v, material);
    }
    let scene = build.scene();
    let samples = place(&scene, CLUSTERED, 2000, 1);
    // Walls and ceiling, the floor around the box, the box's top; and its bottom, which faces the void below the floor.
    assert_near(area(&scene, &samples), 24.0 - 0.64 + 0.64 + 0.64, 0.002, "area");
    let under = |p: Vec3| {
        let p = scene.space.to_world(p) - scene.space.origin;
        p.x.abs() < 0.39 && p.z.abs() < 0.39 && p.y < -0.99
    };
    assert!(!samples.points.iter().any(|p| p.normal.y > 0.0 && under(p.position)), "a sample lies under the box");
}

#[test]
fn both_sides_of_a_double_sided_face_get_samples() {
    let mut build = Build::default();
    let sheet = build.material(Material { double_sided: true, ..lambert(Vec3::ONE) });
    build.quad(DVec3::ZERO, DVec3::X, DVec3::Y, sheet);
    let scene = build.scene();
    let samples = place(&scene, CLUSTERED, 200, 1);
    assert_near(area(&scene, &samples), 8.0, 1e-5, "area");
    let up = samples.samples.iter().filter(|s| s.normal.z > 0.9).count();
    let down = samples.samples.iter().filter(|s| s.normal.z < -0.9).count();
    assert!(up + down == samples.len() && up.abs_diff(down) < 20, "{up} and {down} of {}", samples.len());
}

#[test]
fn a_seed_gives_the_same_samples_on_any_number_of_threads() {
    let scene = room(1.0).scene();
    for placement in [CLUSTERED, Placement::Random] {
        let on = |threads: usize, seed: u64| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            format!("{:?}", pool.install(|| place(&scene, placement, 300, seed)))
        };
        assert_eq!(on(1, 7), on(3, 7));
        assert_ne!(on(1, 7), on(1, 8));
    }
}

/// Statues: compact everywhere. Prints what it took.
#[test]
fn clusters_of_statues_are_compact() {
    let counts: &[usize] = if std::env::var_os("RELUME_FULL").is_some() { &[4096, 16384, 65536] } else { &[4096] };
    for (name, &count) in
        ["buddha", "bunny-dragon-2", "cornell-glossy"].iter().flat_map(|n| counts.iter().map(move |c| (n, c)))
    {
        let Some(path) = shared(&format!("scenes/{name}.glb")) else { continue };
        let scene = Scene::load(&path).unwrap();
        let start = Instant::now();
        let samples = place(&scene, CLUSTERED, count, 1);
        println!(
            "{name}: {} samples, {:.2} s, spread {:.2}",
            samples.len(),
            start.elapsed().as_secs_f64(),
            spread(&samples)
        );
        assert!(samples.len() > count * 97 / 100);
        assert!(spread(&samples) < 3.0, "{name}: a cluster reaches {} of its width", spread(&samples));
    }
}
