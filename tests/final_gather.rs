//! Final gathering against the path tracer, whatever gives the light; and how it is combined with a biased picture.

mod common;

use std::f64::consts::PI;

use common::drawn::tracing;
use common::random::Random;
use common::stage::{Build, Setup, Stage, emitter, lambert, look, mirror, pixels, rig};
use common::{assert_near, gpu, shipped, transfer};
use glam::{DVec3, Vec3};
use rayon::ThreadPoolBuilder;
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::final_gather::{Combination, FinalGather, LEAST_PASSES, Refined};
use relume::reference::path_tracer::{Half, Layer, PathTracer, Settings};
use relume::relight::{Layers, LightChanges, Picture, Relighter, Request};
use relume::scene::{AlphaMode, Camera, Light, LightKind, Material, Projection, Rig, Scene};
use relume::trace::bvh::TracedScene;

const SIDE: u32 = 24;

fn seen(scene: &TracedScene, camera: &Camera, side: u32) -> DeepFramebuffer {
    let settings = BakeSettings { width: side, height: side, layers: 4, samples: 1 };
    bake(scene, camera, &Rig::default(), &settings, &|_| ())
}

/// Passes of final gathering, and samples a pixel of the path tracer.
type Effort = (u32, u32);

/// Mean of indirect light over the picture and channels, by final gathering and by the path tracer.
fn means(scene: &TracedScene, camera: &Camera, side: u32, rig: &Rig, (passes, samples): Effort) -> [f64; 2] {
    let framebuffer = seen(scene, camera, side);
    let mut gather = FinalGather::new(scene, &framebuffer, rig, |_| true, 1, 0);
    (0..passes).for_each(|_| gather.pass(&|| false));
    let tracer = PathTracer::new(scene, camera, rig, &tracing(side, side));
    let film = tracer.trace(samples, &|| false, &|_| ());
    let mean = |pixels: &mut dyn Iterator<Item = Vec3>| {
        pixels.map(|pixel| f64::from(pixel.element_sum())).sum::<f64>() / f64::from(3 * side * side)
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
    let emission = of_layer(Layer::Emission) - emitted / f64::from(3 * side * side);
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
        assert_alike(what, means(&scene, &camera, SIDE, &rig(lights), (40, 256)));
    }
}

/// Mirrors send on light that comes from matt surfaces, and from lights: small ones by photons, others by rays.
/// Emitters, too.
#[test]
fn mirrors_and_emitters() {
    let scene = TracedScene::new(Scene::load(&shipped("balls-2.glb")).unwrap());
    for share in [0.04, 0.1] {
        let mut rig = scene.rig.clone();
        let radius = share * f64::from(scene.bvh.radius) * scene.space.unit;
        rig.lights.iter_mut().for_each(|light| *light = Light { kind: LightKind::Point, radius, ..light.clone() });
        let what = format!("balls under spheres of {radius:.2} m");
        assert_alike(&what, means(&scene, &scene.cameras[0].clone(), 2 * SIDE, &rig, (48, 1024)));
    }

    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.5)));
    let shiny = build.material(mirror(Vec3::splat(0.9), 1.0));
    let panel = build.material(Material { name: "panel".into(), ..emitter(Vec3::splat(10.0)) });
    build.room(DVec3::ZERO, 1.0, grey);
    build.quad(DVec3::new(0.0, 0.9, 0.0), DVec3::X * 0.3, DVec3::Z * 0.3, shiny);
    build.quad(DVec3::new(0.3, 0.4, 0.0), DVec3::X * 0.1, DVec3::NEG_Z * 0.1, panel);
    let camera = look(DVec3::new(0.0, 0.0, 0.9), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.4 });
    let all = rig(vec![Light::emitter("panel", "panel")]);
    assert_alike("panel below a mirror", means(&TracedScene::new(build.scene()), &camera, SIDE, &all, (48, 1024)));
}

/// Slabs thinner than the first cells of surface, of a material with two sides: no light is inside, where cells of the
/// outside must not count area.
#[test]
fn slabs_have_no_inside() {
    let mut build = Build::default();
    let grey = build.material(Material { double_sided: true, ..lambert(Vec3::splat(0.6)) });
    for (center, size) in [
        (DVec3::ZERO, DVec3::new(8.0, 0.1, 8.0)),
        (DVec3::new(0.0, 1.5, -3.0), DVec3::new(8.0, 3.0, 0.1)),
        (DVec3::new(-3.0, 1.5, 0.0), DVec3::new(0.1, 3.0, 8.0)),
    ] {
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| 0.5 * axis * size);
        for [a, b, c] in [[x, y, z], [y, z, x], [z, x, y]] {
            build.quad(center + a, b, c, grey).quad(center - a, c, b, grey);
        }
    }
    let camera =
        look(DVec3::new(1.0, 2.5, 6.0), DVec3::new(0.0, 0.5, 0.0), DVec3::Y, Projection::Perspective { yfov: 0.9 });
    let sun = Light {
        kind: LightKind::Directional,
        direction: DVec3::new(-0.4, -0.7, -0.5).normalize(),
        ..Light::point("sun", DVec3::ZERO)
    };
    let effort = (LEAST_PASSES, 512);
    assert_alike("slabs", means(&TracedScene::new(build.scene()), &camera, 2 * SIDE, &rig(vec![sun]), effort));
}

/// A room twice in the same place, where rays find one object or the other.
#[test]
fn objects_in_one_place() {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.7)));
    build.room(DVec3::ZERO, 1.0, grey).room(DVec3::ZERO, 1.0, grey);
    let mut scene = build.scene();
    let half = scene.mesh.triangles.len() / 2;
    scene.mesh.triangle_objects = (0..2 * half).map(|i| u32::from(i >= half)).collect();
    scene.objects.push(scene.objects[0].clone());
    assert_alike("a room twice", means(&TracedScene::new(scene), &into_a_corner(), 2 * SIDE, &lamp(), (8, 512)));
}

/// A curtain that lets half of the light through, between the lamp and the eye.
#[test]
fn surfaces_that_stop_half_of_the_light() {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.7)));
    let veil = Material { alpha_mode: AlphaMode::Blend, double_sided: true, ..lambert(Vec3::splat(0.9)) };
    let veil = build.material(Material { base_color: veil.base_color.with_w(0.5), ..veil });
    build.room(DVec3::ZERO, 1.0, grey);
    for x in [0.3, 0.4, 0.5] {
        build.quad(DVec3::X * x, DVec3::Y, DVec3::Z, veil);
    }
    assert_alike("veils", means(&TracedScene::new(build.scene()), &into_a_corner(), 2 * SIDE, &lamp(), (8, 512)));
}

/// A wall whose vertex normals point up, away from the floor that the eye sees, lights the floor like a flat wall.
#[test]
fn normals_may_face_away() {
    let mut build = Build::default();
    // Dark, as cells know only one irradiance, that by the vertex normals.
    let dark = build.material(lambert(Vec3::splat(0.03)));
    build.room(DVec3::ZERO, 1.0, dark);
    let flat = build.scene();
    let mut smooth = build.scene();
    let to_wall = smooth.mesh.normals.iter_mut().filter(|normal| **normal == Vec3::X);
    assert_eq!(to_wall.map(|normal| *normal = Vec3::new(0.01, 1.0, 0.0).normalize()).count(), 4);
    let [flat, smooth] = [flat, smooth].map(TracedScene::new);
    let camera = look(DVec3::X * -0.6, DVec3::new(-0.6, -1.0, 0.0), DVec3::Z, Projection::Perspective { yfov: 0.5 });
    let first_bounce = |scene: &TracedScene| {
        let settings = Settings { max_bounces: Some(1), ..tracing(SIDE, SIDE) };
        let film = PathTracer::new(scene, &camera, &lamp(), &settings).trace(64, &|| false, &|_| ());
        film.layer(Half::Both, Layer::Indirect).into_iter().map(|pixel| f64::from(pixel[0])).sum::<f64>()
    };
    assert_near(first_bounce(&smooth), first_bounce(&flat), 0.002, "first bounce");
    assert_alike("normals", means(&smooth, &camera, SIDE, &lamp(), (8, 512)));
}

/// A sun that shines into a box through a hole of its roof, on a wide plain: a thousandth of its rays get in.
#[test]
fn sun_through_a_hole() {
    let mut build = Build::default();
    let white = build.material(Material { double_sided: true, ..lambert(Vec3::splat(0.8)) });
    build.room(DVec3::ZERO, 1.0, white);
    // The roof: a quad of which four others are left.
    let is_roof = |(corners, _): &([DVec3; 4], usize)| corners.iter().all(|corner| corner.y == 1.0);
    build.quads.retain(|quad| !is_roof(quad));
    for (x, z) in [(0.65, 0.3), (-0.3, 0.65), (-0.65, -0.3), (0.3, -0.65)] {
        let [u, v] = if f64::abs(x) > f64::abs(z) { [0.35, 0.7] } else { [0.7, 0.35] };
        build.quad(DVec3::new(x, 1.0, z), DVec3::Z * v, DVec3::X * u, white);
    }
    build.quad(DVec3::Y * -1.2, DVec3::Z * 8.0, DVec3::X * 8.0, white);
    let sun = Light {
        kind: LightKind::Directional,
        direction: DVec3::new(0.3, -1.0, 0.2).normalize(),
        ..Light::point("sun", DVec3::ZERO)
    };
    let scene = TracedScene::new(build.scene());
    assert_alike("hole", means(&scene, &into_a_corner(), 2 * SIDE, &rig(vec![sun]), (16, 512)));
}

fn lamp() -> Rig {
    rig(vec![Light::point("lamp", DVec3::new(0.2, 0.4, 0.3))])
}

fn into_a_corner() -> Camera {
    look(DVec3::new(0.9, 0.0, 0.9), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.4 })
}

/// Glossy walls send on what they get, many times.
#[test]
fn rooms_of_metal() {
    for (color, roughness) in [(1.0, 1.0), (0.9, 0.4), (0.95, 0.2)] {
        let mut build = Build::default();
        let base_color = Vec3::splat(color).extend(1.0);
        let wall = Material { name: "wall".into(), base_color, emissive: Vec3::ONE, roughness, ..Material::default() };
        let wall = build.material(Material { metallic: 1.0, ..wall });
        build.room(DVec3::ZERO, 1.0, wall);
        let camera = look(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, Projection::Perspective { yfov: 1.2 });
        let all = rig(vec![Light::emitter("wall", "wall")]);
        let what = format!("a room of metal, roughness {roughness}");
        assert_alike(&what, means(&TracedScene::new(build.scene()), &camera, SIDE, &all, (12, 192)));
    }
}

/// Light leaves a can, open to one side, after many bounces in it.
#[test]
fn a_lamp_in_a_can() {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.6)));
    let tin = build.material(Material { double_sided: true, ..lambert(Vec3::splat(0.8)) });
    let bulb = build.material(Material { name: "bulb".into(), ..emitter(Vec3::splat(100.0)) });
    build.room(DVec3::ZERO, 1.0, grey);
    let (middle, sides, radius, height) = (DVec3::new(0.2, -0.3, -0.1), 8, 0.12, 0.3);
    for side in 0..sides {
        let (sin, cos) = (2.0 * PI * f64::from(side) / f64::from(sides)).sin_cos();
        let out = DVec3::new(cos, 0.0, sin);
        let along = DVec3::new(-sin, 0.0, cos) * (radius * (PI / f64::from(sides)).tan());
        build.quad(middle + out * radius, along, DVec3::Y * (height / 2.0), tin);
    }
    build.quad(middle - DVec3::Y * (height / 2.0), DVec3::X * 0.2, DVec3::Z * 0.2, tin);
    build.quad(middle - DVec3::Y * (height / 2.0 - 0.02), DVec3::Z * 0.05, DVec3::X * 0.05, bulb);
    let camera = look(DVec3::new(0.7, 0.5, 0.9), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.2 });
    let all = rig(vec![Light::emitter("bulb", "bulb")]);
    assert_alike("a lamp in a can", means(&TracedScene::new(build.scene()), &camera, SIDE, &all, (96, 1024)));
}

/// A plane mirror throws light on a floor as if the light stood behind it, through a window as large as the mirror.
#[test]
fn a_mirror_is_a_window() {
    let mut build = Build::default();
    let floor = build.material(lambert(Vec3::splat(0.5)));
    let silver = build.material(mirror(Vec3::splat(0.8), 1.0));
    build.quad(DVec3::ZERO, 2.0 * DVec3::Z, 2.0 * DVec3::X, floor);
    build.quad(DVec3::new(0.0, 0.5, -1.0), 0.6 * DVec3::X, 0.5 * DVec3::Y, silver);
    let camera = look(DVec3::new(0.0, 3.0, 0.0), DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 0.9 });
    let scene = TracedScene::new(build.scene());
    let framebuffer = seen(&scene, &camera, SIDE);
    let at = DVec3::new(0.2, 0.8, -0.2);
    let image = DVec3::new(at.x, at.y, -2.0 - at.z);
    let thrown = |floor: DVec3| {
        let between = floor - image;
        let through = image + between * ((-1.0 - image.z) / between.z);
        let is_in = through.x.abs() < 0.6 && (0.0..1.0).contains(&through.y);
        let wi = -between.normalize();
        let fresnel = 0.8 + 0.2 * (1.0 - wi.z.abs()).powi(5);
        if is_in { fresnel * 0.5 / PI * wi.y / between.length_squared() } else { 0.0 }
    };
    let at_pixel = |i: u32| {
        let along = |i: u32| 0.9 * (2.0 * (f64::from(i) + 0.5) / f64::from(SIDE) - 1.0);
        DVec3::new(along(i % SIDE), 0.0, along(i / SIDE))
    };
    let want: Vec<f64> = (0..SIDE * SIDE).map(|i| thrown(at_pixel(i))).collect();
    for kind in [LightKind::Point, LightKind::Spot] {
        let light =
            Light { kind, direction: DVec3::NEG_Z, outer_angle: 1.5, inner_angle: 1.5, ..Light::point("l", at) };
        let mut gather = FinalGather::new(&scene, &framebuffer, &rig(vec![light]), |_| true, 1, 0);
        (0..32).for_each(|_| gather.pass(&|| false));
        let halves = [0, 1].map(|half| gather.image(half, 0));
        let got: Vec<f64> = halves[0].iter().zip(&halves[1]).map(|(a, b)| f64::from(0.5 * (a + b).x)).collect();
        let off = got.iter().sum::<f64>() / want.iter().sum::<f64>() - 1.0;
        // Edges of the window are blurred.
        let inside = |i: &usize| [1, SIDE as usize].iter().all(|by| [i - by, i + by].iter().all(|j| want[*j] > 0.0));
        let inside: Vec<usize> = (25..want.len() - 25).filter(|&i| want[i] > 0.0).filter(inside).collect();
        let squares = inside.iter().map(|&i| (got[i] / want[i] - 1.0).powi(2)).sum::<f64>();
        let error = (squares / inside.len() as f64).sqrt();
        println!("{kind:?}: mean {:+.2} %, {} pixels inside {:.2} % off", 100.0 * off, inside.len(), 100.0 * error);
        assert!(inside.len() > 100 && off.abs() < 0.01 && error < 0.05, "{off}, {error}");
    }
}

/// Inside a white-hot box whose walls reflect half of the light, indirect radiance is emission times albedo / (1 -
/// albedo).
#[test]
fn a_furnace_is_even() {
    let mut build = Build::default();
    let wall = Material { name: "wall".into(), emissive: Vec3::ONE, ..lambert(Vec3::splat(0.5)) };
    let wall = build.material(wall);
    build.room(DVec3::ZERO, 1.0, wall);
    let camera = look(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, Projection::Perspective { yfov: PI / 2.0 });
    let scene = TracedScene::new(build.scene());
    let framebuffer = seen(&scene, &camera, SIDE);
    let mut gather = FinalGather::new(&scene, &framebuffer, &rig(vec![Light::emitter("wall", "wall")]), |_| true, 1, 0);
    (0..256).for_each(|_| gather.pass(&|| false));
    let image: Vec<f32> = [0, 1].iter().flat_map(|&half| gather.image(half, 0)).map(|pixel| pixel.x).collect();
    let mean = image.iter().sum::<f32>() / image.len() as f32;
    let square = image.iter().map(|value| (value - 1.0).powi(2)).sum::<f32>() / image.len() as f32;
    println!("mean {mean}, noise {}", square.sqrt());
    assert!((mean - 1.0).abs() < 0.002 && square.sqrt() < 0.05, "mean {mean}, noise {}", square.sqrt());
}

#[test]
fn threads_do_not_matter() {
    let scene = TracedScene::new(Scene::load(&shipped("balls-2.glb")).unwrap());
    let framebuffer = seen(&scene, &scene.cameras[0], SIDE);
    let images = |threads: usize| {
        ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut gather = FinalGather::new(&scene, &framebuffer, &scene.rig, |_| true, 3, 0);
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

/// Of a biased and a noisy estimate, the combination is nearly as good as the better one, or better, and knows how
/// good.
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
        let known = (known.iter().sum::<f64>() / known.len() as f64).sqrt();
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

/// Where no surface is seen, the picture stays black however noisy its surroundings are.
#[test]
fn the_background_gets_nothing() {
    const WIDTH: usize = 64;
    let mut random = Random::new(6);
    let is_seen = |i: usize| i % WIDTH > 20 && i / WIDTH < 50;
    let mut image = |mean: f64| -> Vec<Vec3> {
        let mut value = |i| if is_seen(i) { Vec3::splat((mean + random.unit()) as f32) } else { Vec3::ZERO };
        (0..WIDTH * WIDTH).map(&mut value).collect()
    };
    let [biased, a, b] = [1.0, 2.0, 2.0].map(&mut image);
    let combination = Combination::new(WIDTH, &biased, [&a, &b]);
    let (change, errors2) = (combination.change(&biased, [&a, &b]), combination.errors2());
    for i in 0..WIDTH * WIDTH {
        assert_eq!([change[i] != Vec3::ZERO, errors2[i] > 0.0], [is_seen(i); 2], "{} {}", change[i], errors2[i]);
    }
    // The mean of what is seen is right, up to its noise.
    let mean =
        change.iter().map(|change| change.x).sum::<f32>() / (0..WIDTH * WIDTH).filter(|i| is_seen(*i)).count() as f32;
    assert!((mean - 1.0).abs() < 0.05, "{mean}");
}

/// Where less is known more rays are cast, and nowhere else; the rays of two gathers add up.
#[test]
fn rays_go_where_the_error_is() {
    let scene = TracedScene::new(Scene::load(&shipped("cornell-diffuse.glb")).unwrap());
    let framebuffer = seen(&scene, &scene.cameras[0], SIDE);
    let gathered = |seed: u64, focused: bool| {
        let mut gather = FinalGather::new(&scene, &framebuffer, &scene.rig, |_| true, seed, 0);
        (0..2).for_each(|_| gather.pass(&|| false));
        if focused {
            let errors2: Vec<f64> = (0..SIDE * SIDE).map(|i| if i % SIDE < 8 { 1.0 } else { 0.0 }).collect();
            gather.focus(&errors2);
        }
        (0..4).for_each(|_| gather.pass(&|| false));
        gather.estimate(0)
    };
    let estimate = gathered(1, true);
    for half in &estimate.rays {
        let [left, right] = [half[0], half[8]];
        assert!(left > right && right > 0, "{left} and {right} rays");
        assert!((0..).zip(half).all(|(i, &rays)| rays == if i % SIDE < 8 { left } else { right }));
    }
    let other = gathered(2, false);
    let joined = estimate.clone().joined(&other);
    for (half, i) in [(0, 0), (1, 20), (0, 500)] {
        let [a, b] = [&estimate, &other].map(|e| (e.halves[half][i], e.rays[half][i] as f32));
        let want = (a.0 * a.1 + b.0 * b.1) / (a.1 + b.1);
        assert!((joined.halves[half][i] - want).length() <= 1e-5 * want.length());
        assert_eq!(joined.rays[half][i], estimate.rays[half][i] + other.rays[half][i]);
    }
    assert_eq!(joined.passes, 12);
}

/// The parts of the error that lights have add up to all of it, at their scales in the picture.
#[test]
fn each_light_has_a_part_of_the_error() {
    let scene = TracedScene::new(Scene::load(&shipped("balls-2.glb")).unwrap());
    let framebuffer = seen(&scene, &scene.cameras[0], SIDE);
    let mut gather = FinalGather::new(&scene, &framebuffer, &scene.rig, |_| true, 1, 0);
    (0..4).for_each(|_| gather.pass(&|| false));
    let estimates = [0, 1].map(|source| gather.estimate(source));
    let black = vec![Vec3::ZERO; (SIDE * SIDE) as usize];
    let scales = [Vec3::new(1.0, 0.5, 0.0), Vec3::splat(3.0)];
    let lights = [0, 1].map(|i| (scales[i], &black[..], &estimates[i]));
    let refined = Refined::new(SIDE as usize, &lights);
    let strengths2 = scales.map(|scale| scale.as_dvec3().length_squared() / 3.0);
    let sum: f64 = refined.parts.iter().zip(strengths2).map(|(part, strength2)| part * strength2).sum();
    assert!((sum - 1.0).abs() < 1e-5 && refined.parts.iter().all(|part| *part > 0.0), "{sum}: {:?}", refined.parts);
}

/// What is added to the image of a light is there wherever that light shines as it stood, and nowhere else.
#[test]
fn changes_belong_to_lights_as_they_stand() {
    let gpu = gpu();
    let setup = Setup::new(SIDE, SIDE);
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let (camera, mut rig) = (scene.cameras[0].clone(), scene.rig.clone());
    rig.lights[1].radius = 0.1;
    let mut stage = Stage::new(scene, &camera, &rig, &setup);
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(64, 64, 32)));
    let mut relighter = stage.relighter(&gpu, &rig, &setup);
    let all = |relighter: &mut Relighter| pixels(relighter, Layers::All);
    let before = all(&mut relighter);

    for light in 0..2 {
        let unit = relighter.indirect(light).unwrap();
        let request = Request { picture: Picture::Light(light), layers: Layers::Indirect, ..Request::default() };
        let want = stage.relighter(&gpu, &rig, &setup).linear(request).unwrap().to_vec();
        for (unit, want) in unit.iter().zip(want).map(|(unit, want)| (*unit * rig.scale(light), Vec3::from(want))) {
            assert!((unit - want).length() <= 1e-4 * want.length(), "{unit}, want {want}");
        }
    }
    assert_eq!(all(&mut relighter), before, "a look aside");

    let change = vec![Vec3::new(0.25, 0.5, 1.0); (SIDE * SIDE) as usize];
    let mut changes = LightChanges::default();
    for light in 0..2 {
        changes.set(&gpu, &stage.framebuffer, (&rig, light), &change, 2).unwrap();
    }
    relighter.set_changes(&changes).unwrap();
    let changed = all(&mut relighter);
    let is_changed_by = |picture: &[[f32; 3]], plain: &[[f32; 3]], by: Vec3| {
        let change = picture.iter().zip(plain).map(|(a, b)| Vec3::from(*a) - Vec3::from(*b));
        change.into_iter().all(|change| (change - by).abs().max_element() <= 1e-5 * by.max_element())
    };
    assert!(is_changed_by(&changed, &before, (rig.scale(0) + rig.scale(1)) * change[0]));
    assert_eq!(pixels(&mut relighter, Layers::FirstHand), {
        let mut plain = stage.relighter(&gpu, &rig, &setup);
        pixels(&mut plain, Layers::FirstHand)
    });

    let mut recoloured = rig.clone();
    (recoloured.lights[0].color, recoloured.lights[1].enabled) = (Vec3::new(0.5, 1.0, 0.0), false);
    relighter.set_rig(&recoloured).unwrap();
    let plain = all(&mut stage.relighter(&gpu, &recoloured, &setup));
    assert!(is_changed_by(&all(&mut relighter), &plain, recoloured.scale(0) * change[0]));

    let mut moved = rig.clone();
    moved.lights.iter_mut().for_each(|light| light.position.x += 0.2);
    relighter.set_rig(&moved).unwrap();
    assert_eq!(all(&mut relighter), all(&mut stage.relighter(&gpu, &moved, &setup)));
    relighter.set_rig(&rig).unwrap();
    assert_eq!(all(&mut relighter), changed, "as it stood");
}
