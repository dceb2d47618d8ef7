//! Final gathering against the path tracer, whatever gives the light; and how it is combined with a biased picture.

mod common;

use std::f64::consts::PI;

use common::drawn::tracing;
use common::random::Random;
use common::shipped;
use common::stage::{Build, emitter, lambert, look, mirror, rig};
use glam::{DVec3, Vec3};
use rayon::ThreadPoolBuilder;
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::final_gather::{Combination, FinalGather};
use relume::reference::path_tracer::{Half, Layer, PathTracer};
use relume::scene::{Camera, Light, LightKind, Material, Projection, Rig, Scene};
use relume::trace::bvh::TracedScene;

const SIDE: u32 = 24;

fn seen(scene: &TracedScene, camera: &Camera) -> DeepFramebuffer {
    let settings = BakeSettings { width: SIDE, height: SIDE, layers: 4, samples: 1 };
    bake(scene, camera, &Rig::default(), &settings, &|_| ())
}

/// Mean of indirect light over the picture and channels, by final gathering and by the path tracer.
fn means(scene: &TracedScene, camera: &Camera, rig: &Rig, passes: u32) -> [f64; 2] {
    let framebuffer = seen(scene, camera);
    let mut gather = FinalGather::new(scene, &framebuffer, rig, 1);
    (0..passes).for_each(|_| gather.pass(&|| false));
    let tracer = PathTracer::new(scene, camera, rig, &tracing(SIDE, SIDE));
    let film = tracer.trace(1024, &|| false, &|_| ());
    let mean = |pixels: &mut dyn Iterator<Item = Vec3>| {
        pixels.map(|pixel| f64::from(pixel.element_sum())).sum::<f64>() / f64::from(3 * SIDE * SIDE)
    };
    let of_source = |(source, light): (usize, usize)| {
        let halves = [0, 1].map(|half| gather.image(half, source));
        let scale = rig.scale(light);
        halves.iter().map(|image| 0.5 * mean(&mut image.iter().map(|pixel| *pixel * scale))).sum::<f64>()
    };
    let gathered = gather.lights().enumerate().map(of_source).sum();
    let of_layer = |layer| mean(&mut film.layer(Half::Both, layer).into_iter().map(Vec3::from));
    // What emitters add to the picture, seen directly, is no indirect light.
    let emitted = framebuffer.emission.iter().map(|part| f64::from(part.radiance.element_sum())).sum::<f64>();
    let emission = of_layer(Layer::Emission) - emitted / f64::from(3 * SIDE * SIDE);
    [gathered, of_layer(Layer::Indirect) + emission]
}

fn assert_alike(what: &str, [got, want]: [f64; 2]) {
    let off = got / want - 1.0;
    println!("{what}: {got:.6}, want {want:.6}, {:+.2} %", 100.0 * off);
    assert!(want > 0.0 && off.abs() < 0.02, "{what}: {got}, want {want}");
}

/// Lights without and with a size, near and far, alone and together, in a box with matt and glossy surfaces.
#[test]
fn light_of_any_kind_is_what_the_path_tracer_finds() {
    let scene = TracedScene::new(Scene::load(&shipped("cornell-glossy.glb")).unwrap());
    let camera = scene.cameras[0].clone();
    let point = Light::point("point", DVec3::new(-0.3, 1.2, 0.4));
    let spot = Light {
        name: "spot".into(),
        kind: LightKind::Spot,
        position: DVec3::new(0.3, 1.8, 0.4),
        direction: DVec3::new(0.3, 0.05, -1.0).normalize(),
        inner_angle: 0.1,
        outer_angle: 0.2,
        intensity: 40.0,
        ..point.clone()
    };
    let sphere = Light { radius: 0.1, ..point.clone() };
    let rect = Light {
        kind: LightKind::Rect,
        position: DVec3::new(0.0, 1.9, 0.0),
        direction: DVec3::NEG_Y,
        size: [0.5, 0.3],
        two_sided: true,
        ..point.clone()
    };
    let sun = Light {
        kind: LightKind::Directional,
        direction: DVec3::new(-0.3, -0.3, -1.0).normalize(),
        angle: 0.1,
        ..point.clone()
    };
    let dome = Light { kind: LightKind::Dome, ..point.clone() };
    let bright = Light { name: "bright".into(), intensity: 5.0, ..point.clone() };
    let without_shadows = Light { shadows: false, position: DVec3::new(0.0, 2.5, 0.0), ..point.clone() };
    let rigs = [
        ("point", vec![point]),
        ("two without size", vec![bright, spot]),
        ("sphere", vec![sphere]),
        ("two-sided rectangle", vec![rect]),
        ("sun", vec![sun]),
        ("dome", vec![dome]),
        ("without shadows", vec![without_shadows]),
    ];
    for (what, lights) in rigs {
        assert_alike(what, means(&scene, &camera, &rig(lights), 96));
    }
}

/// Mirrors send on light that comes from matt surfaces, and show emitters to these.
#[test]
fn mirrors_and_emitters() {
    let scene = TracedScene::new(Scene::load(&shipped("balls-2.glb")).unwrap());
    assert_alike("balls", means(&scene, &scene.cameras[0].clone(), &scene.rig.clone(), 48));

    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.5)));
    let shiny = build.material(mirror(Vec3::splat(0.9), 1.0));
    let panel = build.material(Material { name: "panel".into(), ..emitter(Vec3::splat(10.0)) });
    build.room(DVec3::ZERO, 1.0, grey);
    build.quad(DVec3::new(0.0, 0.9, 0.0), DVec3::X * 0.3, DVec3::Z * 0.3, shiny);
    build.quad(DVec3::new(0.3, 0.4, 0.0), DVec3::X * 0.1, DVec3::NEG_Z * 0.1, panel);
    let camera = look(DVec3::new(0.0, 0.0, 0.9), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.4 });
    let all = rig(vec![Light::emitter("panel", "panel")]);
    assert_alike("panel below a mirror", means(&TracedScene::new(build.scene()), &camera, &all, 48));
}

/// Inside a white-hot box whose walls reflect half of the light, indirect radiance is emission times albedo / (1 - albedo).
#[test]
fn a_furnace_is_even() {
    let mut build = Build::default();
    let wall = Material { name: "wall".into(), emissive: Vec3::ONE, ..lambert(Vec3::splat(0.5)) };
    let wall = build.material(wall);
    build.room(DVec3::ZERO, 1.0, wall);
    let camera = look(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, Projection::Perspective { yfov: PI / 2.0 });
    let scene = TracedScene::new(build.scene());
    let framebuffer = seen(&scene, &camera);
    let mut gather = FinalGather::new(&scene, &framebuffer, &rig(vec![Light::emitter("wall", "wall")]), 1);
    (0..64).for_each(|_| gather.pass(&|| false));
    let image: Vec<f32> = [0, 1].iter().flat_map(|&half| gather.image(half, 0)).map(|pixel| pixel.x).collect();
    let mean = image.iter().sum::<f32>() / image.len() as f32;
    let square = image.iter().map(|value| (value - 1.0).powi(2)).sum::<f32>() / image.len() as f32;
    println!("mean {mean}, noise {}", square.sqrt());
    assert!((mean - 1.0).abs() < 0.002 && square.sqrt() < 0.05, "mean {mean}, noise {}", square.sqrt());
}

#[test]
fn threads_do_not_matter() {
    let scene = TracedScene::new(Scene::load(&shipped("balls-2.glb")).unwrap());
    let framebuffer = seen(&scene, &scene.cameras[0]);
    let images = |threads: usize| {
        ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut gather = FinalGather::new(&scene, &framebuffer, &scene.rig, 3);
            (0..3).for_each(|_| gather.pass(&|| false));
            [0, 1].map(|half| [0, 1].map(|source| gather.image(half, source)))
        })
    };
    let one = images(1);
    assert!(one.iter().flatten().flatten().any(|pixel| *pixel != Vec3::ZERO));
    assert!(images(2) == one && images(3) == one);
}

/// Share of the noise that may be taken for bias where there is hardly any.
const LEFT: f64 = 0.15;

/// Of a biased and a noisy estimate, the combination is nearly as good as the better one, or better, and knows how good.
#[test]
fn the_combination_is_at_least_as_good_as_the_better_estimate() {
    const WIDTH: usize = 96;
    let mut random = Random::new(5);
    let mut normal = || (0..12).map(|_| random.unit()).sum::<f64>() - 6.0;
    for (bias, noise) in [(0.5, 0.01), (0.1, 0.1), (0.02, 0.5), (0.0, 0.2), (0.2, 0.0)] {
        let truth = |x: usize, y: usize| 1.0 + (x as f64 * 0.1).sin() * (y as f64 * 0.07).cos();
        let image = |value: &mut dyn FnMut(f64, f64) -> f64| -> Vec<Vec3> {
            let at = |i: usize| (i % WIDTH, i / WIDTH);
            (0..WIDTH * WIDTH).map(|i| Vec3::splat(value(truth(at(i).0, at(i).1), at(i).0 as f64) as f32)).collect()
        };
        let want = image(&mut |truth, _| truth);
        let biased = image(&mut |truth, x| truth + bias * (x * 0.05).sin());
        let [a, b] = [(); 2].map(|()| image(&mut |truth, _| truth + noise * normal()));
        let combination = Combination::new(WIDTH, &biased, [&a, &b]);
        let change = combination.change(&biased, [&a, &b]);
        let error = |image: &mut dyn Iterator<Item = Vec3>| {
            let squares = image.zip(&want).map(|(got, want)| f64::from((got - *want).x).powi(2)).sum::<f64>();
            (squares / want.len() as f64).sqrt()
        };
        let combined = error(&mut biased.iter().zip(&change).map(|(biased, change)| *biased + *change));
        let noisy = error(&mut a.iter().zip(&b).map(|(a, b)| (*a + *b) * 0.5));
        let best = noisy.min(error(&mut biased.iter().copied()));
        let known = combination.errors2();
        let known = (known.iter().copied().map(f64::from).sum::<f64>() / known.len() as f64).sqrt();
        println!("bias {bias}, noise {noise}: best {best:.4}, combined {combined:.4}, expected {known:.4}");
        assert!(
            combined <= 1.1 * best + LEFT * noise + 1e-6,
            "bias {bias}, noise {noise}: {combined}, the better one {best}"
        );
        if bias > 0.0 && noise > 0.0 {
            assert!((2.0 / 3.0..1.5).contains(&(known / combined)), "{known} is expected, it is {combined}");
        }
    }
}
