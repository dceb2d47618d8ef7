//! Area lights where the answer is known: relit, and traced by the path tracer.

mod common;

use std::f64::consts::{FRAC_PI_2, PI};

use common::stage::{self, Build, Setup, Stage, lambert, look, mirror, rig};
use common::{Gpu, assert_near, gpu, shipped, transfer};
use glam::{DVec3, Vec3};
use relume::physics::sequence::fibonacci_lattice;
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::relight::{Detail, Layers, Picture, Request, VisibilityMethod};
use relume::scene::{AlphaMode, Camera, Light, LightKind, Material, Projection, Rig, Scene};
use relume::trace::bvh::TracedScene;

/// Asked of pictures at rest.
const AT_REST: f64 = 1e-3;
/// Asked of pictures while a light moves.
const MOVING: f64 = 3e-2;
const ALBEDO: f64 = 0.6;

/// A grey floor at y = 0 that reaches 4 m in each direction.
fn floor() -> Build {
    let mut build = Build::default();
    let material = build.material(lambert(Vec3::splat(ALBEDO as f32)));
    build.quad(DVec3::ZERO, 4.0 * DVec3::Z, 4.0 * DVec3::X, material);
    build
}

/// A spot of the floor a micrometre wide, from above.
fn at(point: DVec3) -> Camera {
    look(point + DVec3::Y, point, DVec3::NEG_Z, Projection::Orthographic { ymag: 1e-6 })
}

/// An area light, and the irradiance that it gives the floor at a point, from a formula.
struct Case {
    what: &'static str,
    light: Light,
    point: DVec3,
    irradiance: f64,
}

/// Irradiance from a disk parallel to the floor, of unit radiance, at `distance` from its axis.
fn of_disk(radius: f64, height: f64, distance: f64) -> f64 {
    let (r, h, d) = (radius * radius, height * height, distance * distance);
    FRAC_PI_2 * (1.0 - (h + d - r) / ((h + d + r).powi(2) - 4.0 * r * d).sqrt())
}

/// Irradiance at the origin on a floor facing +Y from a polygon of unit radiance above it [Lambert 1760].
fn of_polygon(corners: &[DVec3]) -> f64 {
    let edge = |i: usize| {
        let [a, b] = [corners[i].normalize(), corners[(i + 1) % corners.len()].normalize()];
        a.dot(b).acos() * a.cross(b).normalize().y
    };
    (0.5 * (0..corners.len()).map(edge).sum::<f64>()).abs()
}

fn cases() -> Vec<Case> {
    let light = |kind: LightKind, position: DVec3| Light {
        kind,
        direction: DVec3::NEG_Y,
        intensity: 5.0,
        ..Light::point("l", position)
    };
    let mut cases = Vec::new();
    for (radius, height, distance) in [(0.5, 2.0, 0.0), (0.5, 2.0, 1.5), (1.5, 1.0, 0.7), (0.01, 1.0, 0.3)] {
        let disk = Light { radius, ..light(LightKind::Disk, DVec3::Y * height) };
        let irradiance = 5.0 / (PI * radius * radius) * of_disk(radius, height, distance);
        cases.push(Case { what: "disk", light: disk, point: DVec3::X * distance, irradiance });
    }
    for (radius, height, distance) in [(0.3, 1.0, 0.0), (0.3, 1.0, 1.2), (0.001, 2.0, 0.5)] {
        let sphere = Light { radius, ..light(LightKind::Point, DVec3::Y * height) };
        let squared: f64 = height * height + distance * distance;
        let irradiance = 5.0 * height / squared.powf(1.5);
        cases.push(Case { what: "sphere", light: sphere, point: DVec3::X * distance, irradiance });
    }
    for (position, direction, size) in [
        (DVec3::new(0.0, 2.0, 0.0), DVec3::NEG_Y, [1.0, 0.5]),
        (DVec3::new(0.5, 1.0, -1.5), DVec3::new(-0.2, -0.3, 1.0).normalize(), [1.0, 0.8]),
        (DVec3::new(-1.0, 1.5, 0.2), DVec3::X, [2.0, 1.0]),
    ] {
        let rect = Light { direction, size, up: DVec3::new(0.1, 0.2, 1.0), ..light(LightKind::Rect, position) };
        let [u, v] = rect.axes();
        let [u, v] = [u * size[0] / 2.0, v * size[1] / 2.0];
        let irradiance = 5.0 / (size[0] * size[1])
            * of_polygon(&[position - u - v, position + u - v, position + u + v, position - u + v]);
        cases.push(Case { what: "rectangle", light: rect, point: DVec3::ZERO, irradiance });
    }
    for (direction, angle) in
        [(DVec3::NEG_Y, 0.5f64), (DVec3::new(0.6, -0.8, 0.0), 30.0), (DVec3::new(0.6, -0.8, 0.0), 0.0)]
    {
        let sun = Light { direction, angle: angle.to_radians(), ..light(LightKind::Directional, DVec3::ZERO) };
        cases.push(Case { what: "sun", light: sun, point: DVec3::ZERO, irradiance: -5.0 * direction.y });
    }
    let far = Light { radius: 0.2, ..light(LightKind::Disk, DVec3::Y * 200.0) };
    cases.push(Case { what: "far disk", light: far, point: DVec3::ZERO, irradiance: 5.0 / 4e4 });
    cases
}

/// At rest; and while a light moves, when few points shade.
#[test]
fn irradiance() {
    let gpu = gpu();
    for Case { what, light, point, irradiance } in cases() {
        let setup = Setup::new(1, 1);
        let all = rig(vec![light.clone()]);
        let stage = stage::Stage::new(floor().scene(), &at(point), &all, &setup);
        for (detail, tolerance) in [(Detail::Exact, AT_REST), (Detail::Coarse, MOVING)] {
            let mut relighter = stage.relighter(&gpu, &all, &setup);
            let request = Request { detail, ..Picture::Light(0).into() };
            let got = f64::from(relighter.linear(request).unwrap()[0][0]);
            let want = ALBEDO / PI * irradiance;
            println!("{what}, {detail:?}: {got:.6}, want {want:.6}, off by {:+.1e}", got / want - 1.0);
            assert_near(got, want, tolerance, format!("{what} {light:?}"));
        }
    }
}

/// Pictures of lights that move, all light of them, beside those at rest. The worst 0.1 % of pixels are left out.
#[test]
fn pictures_while_moving() {
    let gpu = gpu();
    // The middle of a picture of twice the size, whose pixels see as small a part of the scene.
    let setup = Setup::new(135, 90);
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let mut camera = scene.cameras[0].clone();
    let Projection::Perspective { yfov } = &mut camera.projection else { panic!("it is a perspective") };
    *yfov = 2.0 * (0.5 * (0.5 * *yfov).tan()).atan();
    let base = Light {
        radius: 0.3,
        size: [1.2, 0.6],
        up: DVec3::Z,
        outer_angle: 0.8,
        angle: 0.1,
        direction: DVec3::new(-0.3, -0.9, -0.2).normalize(),
        intensity: 20.0,
        ..Light::point("l", DVec3::new(0.6, 2.2, 0.8))
    };
    let kinds = [LightKind::Point, LightKind::Spot, LightKind::Disk, LightKind::Rect, LightKind::Directional];
    let mut lights: Vec<Light> = kinds.map(|kind| Light { kind, ..base.clone() }).to_vec();
    lights.push(Light { kind: LightKind::Rect, spread: 1.0, two_sided: true, ..base.clone() });
    let mut stage = Stage::new(scene, &camera, &rig(lights.clone()), &setup);
    // With 400 gather samples, their noise alone would be a bias of half a percent.
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(1600, 80, 64)));
    for light in lights {
        let all = rig(vec![light.clone()]);
        let picture = |detail: Detail| {
            let request = Request { detail, ..Request::default() };
            stage.relighter(&gpu, &all, &setup).linear(request).unwrap().to_vec()
        };
        let (moving, exact) = (picture(Detail::Coarse), picture(Detail::Exact));
        let difference = |(a, b): (&[f32; 3], &[f32; 3])| Vec3::from(*a).as_dvec3() - Vec3::from(*b).as_dvec3();
        let pairs = || moving.iter().zip(&exact);
        let mut errors: Vec<f64> = pairs().map(difference).map(DVec3::length_squared).collect();
        errors.sort_by(f64::total_cmp);
        let error: f64 = errors[..errors.len() * 999 / 1000].iter().sum();
        let values = || exact.iter().flatten().map(|x| f64::from(*x));
        let sum: f64 = values().sum();
        let error = (error / values().map(|x| x * x).sum::<f64>()).sqrt();
        let bias = pairs().map(difference).map(DVec3::element_sum).sum::<f64>() / sum;
        println!("{:?}: error {error:.4}, bias {bias:+.4}", light.kind);
        // Of a beam the parts send much different light to a place, and all count as much for its shadow.
        let is_beam = light.kind == LightKind::Spot || light.spread < 2.0;
        let [largest, most] = if is_beam { [0.1, 0.02] } else { [0.06, 0.01] };
        assert!(sum > 0.0 && error < largest && bias.abs() < most, "{:?}: error {error}, bias {bias}", light.kind);
    }
}

#[test]
fn irradiance_in_the_path_tracer() {
    for Case { what, light, point, irradiance } in cases() {
        let settings = Settings {
            width: 1,
            height: 1,
            layers: 4,
            max_bounces: Some(0),
            filter: Filter::Box,
            bounce_layers: 0,
            light_layers: false,
            seed: 1,
        };
        let scene = TracedScene::new(floor().scene());
        let (camera, rig) = (at(point), rig(vec![light]));
        let film = PathTracer::new(&scene, &camera, &rig, &settings).trace(1 << 14, &|| false, &|_| ());
        let got = f64::from(film.layer(Half::Both, Layer::Direct)[0][0]);
        assert_near(got, ALBEDO / PI * irradiance, AT_REST, what);
    }
}

/// A punctual light is the light that it was, to the last bit.
#[test]
fn no_size_is_no_change() {
    let gpu = gpu();
    let spot = Light {
        kind: LightKind::Spot,
        direction: DVec3::new(0.3, -0.9, 0.1).normalize(),
        ..Light::point("spot", DVec3::new(0.2, 1.0, 0.3))
    };
    let sun = Light { kind: LightKind::Directional, direction: DVec3::NEG_Y, ..Light::point("sun", DVec3::ZERO) };
    let picture = |lights: Vec<Light>| {
        let setup = Setup::new(32, 32);
        let all = rig(lights);
        let camera = look(DVec3::new(0.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.0 });
        let stage = stage::Stage::new(floor().scene(), &camera, &all, &setup);
        stage.relighter(&gpu, &all, &setup).linear(Picture::Whole).unwrap().to_vec()
    };
    let lights = vec![Light::point("point", DVec3::new(-0.5, 0.7, 0.0)), spot, sun];
    // What only other kinds use.
    let others = lights.iter().map(|light| Light { size: [3.0; 2], up: DVec3::X, spread: 0.5, ..light.clone() });
    assert_eq!(picture(lights.clone()), picture(others.collect()));
}

/// Where part of a sun is behind a straight edge, the floor gets what the visible segment of its disk gives.
#[test]
fn penumbra_of_a_sun() {
    let gpu = gpu();
    let angle = 4f64.to_radians();
    let mut build = Build::default();
    let [grey, black] = [ALBEDO as f32, 0.0].map(|albedo| build.material(lambert(Vec3::splat(albedo))));
    build.quad(DVec3::ZERO, 0.2 * DVec3::Z, 0.2 * DVec3::X, grey);
    // Shades all of x > 0 from straight above.
    build.quad(DVec3::new(0.1, 1.0, 0.0), 0.1 * DVec3::X, 0.2 * DVec3::NEG_Z, black);
    let sun = Light {
        kind: LightKind::Directional,
        direction: DVec3::NEG_Y,
        angle,
        intensity: 2.0,
        ..Light::point("sun", DVec3::ZERO)
    };
    let all = rig(vec![sun]);
    let radius = (angle / 2.0).tan();
    // What 256 points can tell of an edge; a map is drawn for each of them, whose texels are a tenth of the penumbra.
    let shares = [-1.1, -0.8, -0.5, 0.0, 0.4, 0.9, 1.1];
    let methods = [(VisibilityMethod::Traced, 8e-3), (VisibilityMethod::Map, 4e-2)];
    for (share, (visibility, tolerance)) in shares.into_iter().flat_map(|share| methods.map(|method| (share, method))) {
        let point = DVec3::X * (share * radius);
        let setup = Setup { visibility, shadow_size: 256, ..Setup::new(1, 1) };
        let mut camera = at(point);
        camera.position.y = 0.5; // below the edge
        let stage = stage::Stage::new(build.scene(), &camera, &all, &setup);
        let got = f64::from(stage.relighter(&gpu, &all, &setup).linear(Picture::Light(0)).unwrap()[0][0]);
        let x = f64::clamp(-share, -1.0, 1.0);
        // Area of the disk's segment, of the disk.
        let visible = 0.5 + (x * (1.0 - x * x).sqrt() + x.asin()) / PI;
        let want = ALBEDO / PI * 2.0 * visible;
        assert!((got - want).abs() < tolerance * ALBEDO / PI * 2.0, "{share}: {got}, want {want}");
    }
}

/// Pixels along each side of the pictures below.
const SIDE: u32 = 64;

/// A layer of a scene under one light of unit intensity, relit and traced.
fn both(gpu: &Gpu, scene: Scene, camera: &Camera, light: &Light, layer: Layer) -> [Vec<[f32; 3]>; 2] {
    let setup = Setup { layers: 2, ..Setup::new(SIDE, SIDE) };
    let all = rig(vec![light.clone()]);
    let stage = Stage::new(scene, camera, &all, &setup);
    let layers = if layer == Layer::Direct { Layers::Direct } else { Layers::Reflection };
    let relit = stage.relighter(gpu, &all, &setup).linear(layers).unwrap().to_vec();
    let settings = Settings {
        width: SIDE,
        height: SIDE,
        layers: 2,
        max_bounces: Some(1),
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed: 1,
    };
    let film = PathTracer::new(&stage.scene, camera, &all, &settings).trace(512, &|| false, &|_| ());
    [relit, film.layer(Half::Both, layer)]
}

/// Lights of unit intensity that shine down from two metres.
fn shapes() -> impl Iterator<Item = Light> {
    [LightKind::Point, LightKind::Disk, LightKind::Rect].into_iter().map(|kind| Light {
        kind,
        direction: DVec3::NEG_Y,
        radius: 0.4,
        size: [1.0, 0.5],
        up: DVec3::Z,
        ..Light::point("l", DVec3::new(0.0, 2.0, 0.0))
    })
}

/// Whether a light of [`shapes`] covers a point of its plane.
fn is_inside(light: &Light, x: f64, z: f64) -> bool {
    match light.kind {
        LightKind::Rect => x.abs() < 0.5 && z.abs() < 0.25,
        _ => x.hypot(z) < 0.4,
    }
}

/// Mirrors show the shape of a light at its radiance, and nothing beside it.
#[test]
fn mirrors_show_lights() {
    let gpu = gpu();
    let mut build = Build::default();
    let material = build.material(mirror(Vec3::ONE, 1.0));
    build.quad(DVec3::ZERO, 4.0 * DVec3::Z, 4.0 * DVec3::X, material);
    let camera = look(DVec3::Y, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 1.0 });
    for light in shapes() {
        let radiance = 1.0 / light.projected_area().unwrap();
        for picture in both(&gpu, build.scene(), &camera, &light, Layer::Reflection) {
            for (i, pixel) in picture.iter().enumerate() {
                let [x, z] = [i as u32 % SIDE, i as u32 / SIDE].map(|i| (f64::from(i) + 0.5) / 32.0 - 1.0);
                let want = if is_inside(&light, x, z) { radiance } else { 0.0 };
                assert_near(f64::from(pixel[0]), want, 1e-5, format!("{:?} {x} {z}", light.kind));
            }
        }
    }
}

/// A pane that covers half of what is behind it halves a light in a mirror, unless the light casts no shadows: then all
/// of it is seen, once.
#[test]
fn mirrors_show_lights_through_panes() {
    let gpu = gpu();
    let mut build = Build::default();
    let shiny = build.material(mirror(Vec3::ONE, 1.0));
    build.quad(DVec3::ZERO, 4.0 * DVec3::Z, 4.0 * DVec3::X, shiny);
    let pane = Material { alpha_mode: AlphaMode::Blend, double_sided: true, ..lambert(Vec3::ZERO) };
    let pane = build.material(Material { base_color: pane.base_color.with_w(0.5), ..pane });
    build.quad(1.5 * DVec3::Y, 4.0 * DVec3::Z, 4.0 * DVec3::X, pane);
    let camera = look(DVec3::Y, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 0.1 });
    for (light, shadows) in shapes().flat_map(|light| [(light.clone(), true), (light, false)]) {
        let light = Light { shadows, ..light };
        let want = if shadows { 0.5 } else { 1.0 } / light.projected_area().unwrap();
        for picture in both(&gpu, build.scene(), &camera, &light, Layer::Reflection) {
            assert_near(f64::from(picture[0][0]), want, 1e-5, format!("{:?}, shadows {shadows}", light.kind));
        }
    }
}

/// A mirror shows a dome where it shows no surface, whether these stop the dome's light or not.
#[test]
fn mirrors_show_domes_behind_surfaces() {
    let gpu = gpu();
    let mut build = Build::default();
    let shiny = build.material(mirror(Vec3::ONE, 1.0));
    build.quad(DVec3::ZERO, 4.0 * DVec3::Z, 4.0 * DVec3::X, shiny);
    let black = build.material(Material { double_sided: true, ..lambert(Vec3::ZERO) });
    build.quad(DVec3::new(4.0, 1.5, 0.0), 4.0 * DVec3::Z, 4.0 * DVec3::X, black);
    let camera = look(DVec3::Y, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 1.0 });
    for shadows in [true, false] {
        let dome = Light { kind: LightKind::Dome, shadows, ..Light::point("dome", DVec3::ZERO) };
        let [relit, traced] = both(&gpu, build.scene(), &camera, &dome, Layer::Reflection);
        for (i, pair) in relit.iter().zip(&traced).enumerate() {
            let want = if i as u32 % SIDE < SIDE / 2 { 1.0 } else { 0.0 };
            for pixel in [pair.0, pair.1] {
                assert_near(f64::from(pixel[0]), want, 1e-5, format!("pixel {i}, shadows {shadows}"));
            }
        }
    }
}

/// The camera sees a light that is visible, at its radiance, where no surface is before it; no other light.
#[test]
fn visible_lights_are_seen() {
    let gpu = gpu();
    let mut build = floor();
    let material = build.material(lambert(Vec3::ZERO));
    // Hides all of x > 0.2.
    build.quad(DVec3::new(2.2, 1.0, 0.0), 2.0 * DVec3::X, 4.0 * DVec3::Z, material);
    let camera = look(DVec3::Y * 0.5, DVec3::Y * 4.0, DVec3::Z, Projection::Orthographic { ymag: 1.0 });
    for (light, visible) in shapes().flat_map(|light| [(light.clone(), true), (light, false)]) {
        let light = Light { visible, ..light };
        let radiance = 1.0 / light.projected_area().unwrap();
        for picture in both(&gpu, build.scene(), &camera, &light, Layer::Direct) {
            for (i, pixel) in picture.iter().enumerate() {
                let [x, down] = [i as u32 % SIDE, i as u32 / SIDE].map(|i| (f64::from(i) + 0.5) / 32.0 - 1.0);
                let z = -down;
                let want = if visible && x < 0.2 && is_inside(&light, x, z) { radiance } else { 0.0 };
                assert_near(f64::from(pixel[0]), want, 1e-5, format!("{:?} {x} {z}", light.kind));
            }
        }
    }
}

/// Highlights have the shape of the light, also in lobes much narrower than the distance between the points of a light.
#[test]
fn highlights_have_the_shape_of_the_light() {
    let gpu = gpu();
    for roughness in [0.03, 0.1, 0.2, 0.29, 0.35] {
        let mut build = Build::default();
        let material = build.material(Material { roughness, ..mirror(Vec3::splat(0.9), 1.0) });
        build.quad(DVec3::ZERO, 4.0 * DVec3::Z, 4.0 * DVec3::X, material);
        let camera = look(DVec3::new(0.3, 1.0, 2.0), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.0 });
        let sun = Light {
            kind: LightKind::Directional,
            direction: DVec3::new(0.0, -1.0, 2.0).normalize(),
            angle: 0.3,
            ..Light::point("sun", DVec3::ZERO)
        };
        for light in shapes().chain([sun]) {
            let [relit, traced] = both(&gpu, build.scene(), &camera, &light, Layer::Direct);
            let pairs =
                || relit.iter().flatten().zip(traced.iter().flatten()).map(|(a, b)| (f64::from(*a), f64::from(*b)));
            let all: f64 = pairs().map(|(_, b)| b).sum();
            let squares: f64 = pairs().map(|(_, b)| b * b).sum();
            let error = (pairs().map(|(a, b)| (a - b).powi(2)).sum::<f64>() / squares).sqrt();
            let bias = pairs().map(|(a, b)| a - b).sum::<f64>() / all;
            println!("{:?}, roughness {roughness}: {error:.4}, bias {bias:+.5}", light.kind);
            assert!(all > 0.0 && error < 0.02 && bias.abs() < 2e-3, "{light:?} at {roughness}: {error}, bias {bias}");
        }
    }
}

/// Highlights in narrow lobes while a light moves have the light of those at rest.
#[test]
fn highlights_while_moving() {
    let gpu = gpu();
    let setup = Setup::new(SIDE, SIDE);
    let spot = Light { outer_angle: 1.0, ..shapes().next().expect("there are some") };
    let spot = Light { kind: LightKind::Spot, ..spot };
    for roughness in [0.1, 0.2] {
        let mut build = Build::default();
        let material = build.material(Material { roughness, ..mirror(Vec3::splat(0.9), 1.0) });
        build.quad(DVec3::ZERO, 4.0 * DVec3::Z, 4.0 * DVec3::X, material);
        let camera = look(DVec3::new(0.3, 1.0, 2.0), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.0 });
        for light in shapes().chain([spot.clone()]) {
            let all = rig(vec![light.clone()]);
            let stage = Stage::new(build.scene(), &camera, &all, &setup);
            let [moving, exact] = [Detail::Coarse, Detail::Exact].map(|detail| {
                let request = Request { detail, ..Picture::Light(0).into() };
                let mut relighter = stage.relighter(&gpu, &all, &setup);
                relighter.linear(request).unwrap().iter().map(|pixel| f64::from(pixel[0])).sum::<f64>()
            });
            println!("{:?}, roughness {roughness}: {:+.4}", light.kind, moving / exact - 1.0);
            assert_near(moving, exact, MOVING, format!("{:?}, roughness {roughness}", light.kind));
        }
    }
}

/// Direct, mirrored and indirect light of a spot with a radius is that of 256 spots in its place; and pictures with
/// ever more of its points end in the same one, to the last bit.
#[test]
fn a_light_is_the_mean_of_its_points() {
    let gpu = gpu();
    let setup = Setup::new(32, 24);
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let (camera, space) = (scene.cameras[0].clone(), scene.space);
    let spot = Light {
        kind: LightKind::Spot,
        direction: DVec3::new(-0.5, -0.8, -0.3).normalize(),
        outer_angle: 0.7,
        radius: 0.2,
        intensity: 30.0,
        ..Light::point("spot", DVec3::new(0.6, 1.6, 0.5))
    };
    let points = (0..256).map(|i| {
        let point = spot.pack_point(space, fibonacci_lattice(i, 256), None);
        let position = space.to_world(point.position);
        Light { name: format!("spot{i}"), position, radius: 0.0, intensity: 30.0 / 256.0, ..spot.clone() }
    });
    let [one, many] = [rig(vec![spot.clone()]), rig(points.collect())];
    let mut stage = Stage::new(scene, &camera, &one, &setup);
    // With 400 gather samples, their noise alone would be a bias of half a percent.
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(1600, 80, 64)));
    for layers in [Layers::All, Layers::Indirect] {
        let picture = |rig: &Rig| stage.relighter(&gpu, rig, &setup).linear(layers).unwrap().to_vec();
        let (got, want) = (picture(&one), picture(&many));
        let sum = |of: &dyn Fn(f32, f32) -> f32| {
            let pairs = got.iter().flatten().zip(want.iter().flatten());
            pairs.map(|(a, b)| f64::from(of(*a, *b)).powi(2)).sum::<f64>().sqrt()
        };
        let (error, all) = (sum(&|a, b| a - b), sum(&|_, b| b));
        assert!(all > 0.0 && error < 1e-4 * all, "{layers:?}: {error} of {all}");
    }
    let mut relighter = stage.relighter(&gpu, &one, &setup);
    let exact = relighter.linear(Layers::All).unwrap().to_vec();
    let mut relighter = stage.relighter(&gpu, &one, &setup);
    let progressive = Request { detail: Detail::Progressive, ..Request::default() };
    let mut pictures = 0;
    loop {
        let picture = relighter.linear(progressive.clone()).unwrap().to_vec();
        pictures += 1;
        if !relighter.is_coarse() {
            assert_eq!(picture, exact);
            break;
        }
    }
    assert!(pictures > 10, "{pictures} pictures");
}
