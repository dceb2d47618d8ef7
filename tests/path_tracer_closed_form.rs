//! The path tracer where the answer is known.

mod common;

use std::f64::consts::PI;

use common::stage::{Build, lambert, look, mirror, rig};
use glam::{DVec3, Vec3};
use relume::reference::path_tracer::{Film, Filter, Half, Layer, PathTracer, Settings};
use relume::scene::{Camera, Light, LightKind, Projection, Rig, Scene};
use relume::trace::bvh::TracedScene;

const ALBEDO: f64 = 0.6;

fn settings(size: u32) -> Settings {
    Settings {
        width: size,
        height: size,
        layers: 4,
        max_bounces: None,
        filter: Filter::Box,
        bounce_layers: 4,
        light_layers: false,
        seed: 1,
    }
}

fn trace(scene: &Scene, camera: &Camera, rig: &Rig, settings: &Settings, samples_a_half: u32) -> Film {
    let scene = &TracedScene::new(scene.clone());
    PathTracer::new(scene, camera, rig, settings).trace(samples_a_half, &|| false, &|_| ())
}

/// Mean of the red channel, and its standard error from the difference of the halves.
fn mean(film: &Film, layer: Layer) -> (f64, f64) {
    let [a, b] = [Half::A, Half::B].map(|half| film.layer(half, layer));
    let count = a.len() as f64;
    let pairs = || a.iter().zip(&b).map(|(a, b)| (f64::from(a[0]), f64::from(b[0])));
    let mean = pairs().map(|(a, b)| (a + b) / 2.0).sum::<f64>() / count;
    let error = pairs().map(|(a, b)| (a - b).powi(2) / 4.0).sum::<f64>().sqrt() / count;
    (mean, error)
}

/// Asserts a mean within four standard errors and a relative slack for what the geometry is off by.
#[track_caller]
fn assert_mean((got, error): (f64, f64), want: f64, slack: f64, what: &str) {
    println!("{what}: {got:.6}, want {want:.6}, off by {:+.1e}, standard error {:.1e}", got / want - 1.0, error / want);
    assert!((got - want).abs() <= 4.0 * error + slack * want, "{what}: got {got} +- {error}, want {want}");
    assert!(error < 5e-3 * want, "{what}: {error} is too much noise to tell anything");
}

fn grey(albedo: f64) -> relume::scene::Material {
    lambert(Vec3::splat(albedo as f32))
}

/// A cube blown up to a sphere of radius 1 around the origin, 132,300 triangles, seen from inside.
fn sphere(material: relume::scene::Material) -> Scene {
    const N: usize = 105;
    let mut build = Build::default();
    let material = build.material(material);
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let (u, v) = (DVec3::new(axis.y, axis.z, axis.x), DVec3::new(axis.z, axis.x, axis.y));
        for (side, across, down) in [(axis, u, v), (-axis, v, u)] {
            // Equal angles, so that no facet is much larger than another.
            let at = |i: usize, j: usize| {
                let place = |k: usize| ((k as f64 / N as f64 - 0.5) * PI / 2.0).tan();
                (side + place(i) * across + place(j) * down).normalize()
            };
            for (i, j) in (0..N).flat_map(|i| (0..N).map(move |j| (i, j))) {
                build.quads.push(([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], material));
            }
        }
    }
    let mut scene = build.scene();
    scene.mesh.normals = scene.mesh.positions.iter().map(|p| -p.normalize()).collect();
    scene
}

fn candela(light: Light, intensity: f64) -> Light {
    Light { intensity, ..light }
}

/// In a closed sphere every point sees every other alike: the irradiance
/// that came by k bounces is albedo^k times the flux over the area, wherever the light is.
#[test]
fn closed_sphere() {
    let scene = sphere(grey(ALBEDO));
    let rig = rig(vec![candela(Light::point("key", DVec3::new(0.3, -0.2, 0.4)), 2.0)]);
    let projection = Projection::Perspective { yfov: 2.0 };
    let camera = look(DVec3::new(0.1, 0.0, 0.2), DVec3::new(-1.0, 0.3, 0.0), DVec3::Y, projection);
    let film = trace(&scene, &camera, &rig, &settings(32), 256);
    let reflected = |irradiance: f64| ALBEDO / PI * irradiance;
    let per_area = 4.0 * PI * 2.0 / (4.0 * PI);
    // 3e-4: what the facets leave of a sphere's area and radius.
    for bounce in 1..=4 {
        let want = reflected(ALBEDO.powi(bounce) * per_area);
        assert_mean(mean(&film, Layer::Bounce(bounce as u32)), want, 3e-4, &format!("bounce {bounce}"));
    }
    let want = reflected(ALBEDO * per_area / (1.0 - ALBEDO));
    assert_mean(mean(&film, Layer::Indirect), want, 3e-4, "all bounces");
    // Everywhere: each eighth of the picture on its own.
    let [a, b] = [Half::A, Half::B].map(|half| film.layer(half, Layer::Indirect));
    for (i, (a, b)) in a.chunks(128).zip(b.chunks(128)).enumerate() {
        let values = || a.iter().zip(b).map(|(a, b)| (f64::from(a[0]), f64::from(b[0])));
        let mean = values().map(|(a, b)| (a + b) / 2.0).sum::<f64>() / 128.0;
        let error = values().map(|(a, b)| (a - b).powi(2) / 4.0).sum::<f64>().sqrt() / 128.0;
        assert!((mean - want).abs() < 4.5 * error + 3e-4 * want, "part {i}: {mean} +- {error}, want {want}");
    }
}

/// In a closed sphere that glows, radiance is the same everywhere: emission / (1 - albedo). Found by chance and by
/// looking for it, weighed against each other.
#[test]
fn glowing_sphere() {
    let material = relume::scene::Material { emissive: Vec3::splat(0.8), ..grey(ALBEDO) };
    let scene = sphere(material);
    let projection = Projection::Perspective { yfov: 1.5 };
    let camera = look(DVec3::new(0.5, 0.0, 0.2), DVec3::new(-1.0, 0.3, 0.0), DVec3::Y, projection);
    let film = trace(&scene, &camera, &rig(vec![]), &settings(16), 64);
    assert_mean(mean(&film, Layer::Emission), 0.8 / (1.0 - ALBEDO), 3e-4, "emission");
    assert_eq!(mean(&film, Layer::Indirect).0, 0.0, "emitters' light belongs to their layer");
}

/// Mean irradiance over the six walls of a closed room of side 2, through one bounce or more.
fn room_indirect(rig: &Rig) -> (f64, f64) {
    let mut build = Build::default();
    let wall = build.material(grey(ALBEDO));
    let scene = build.room(DVec3::ZERO, 1.0, wall).scene();
    let mut sum = (0.0, 0.0);
    for axis in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z] {
        // Sees exactly one wall, from just before the one behind.
        let up = DVec3::new(axis.y, axis.z, axis.x);
        let camera = look(-0.99 * axis, axis, up, Projection::Orthographic { ymag: 1.0 });
        let (mean, error) = mean(&trace(&scene, &camera, rig, &settings(16), 512), Layer::Indirect);
        sum = (sum.0 + mean, sum.1 + error * error);
    }
    (sum.0 / 6.0 * PI / ALBEDO, sum.1.sqrt() / 6.0 * PI / ALBEDO)
}

/// Whatever leaves a light in a closed room is absorbed by its walls: their area-weighted mean irradiance is
/// flux / (area (1 - albedo)), of which albedo times as much came by bounces.
#[test]
fn closed_room() {
    let area = 24.0;
    let want = |flux: f64| ALBEDO * flux / (area * (1.0 - ALBEDO));
    let corner = rig(vec![candela(Light::point("corner", DVec3::new(-0.85, 0.8, 0.85)), 3.0)]);
    assert_mean(room_indirect(&corner), want(4.0 * PI * 3.0), 0.0, "point light in a corner");

    let (inner, outer) = (0.3f64, 0.9f64);
    let spot = Light {
        kind: LightKind::Spot,
        direction: DVec3::new(0.6, -0.5, 0.2).normalize(),
        inner_angle: inner,
        outer_angle: outer,
        ..candela(Light::point("edge", DVec3::new(-0.8, 0.8, 0.0)), 5.0)
    };
    // The cone's smoothing is the square of a ramp in the cosine: a third of its width counts.
    let solid_angle = 2.0 * PI * ((1.0 - inner.cos()) + (inner.cos() - outer.cos()) / 3.0);
    assert_mean(room_indirect(&rig(vec![spot])), want(5.0 * solid_angle), 0.0, "spot at the edge of a wall");
}

/// A lit square seen by a point above its centre, the lower half of a pair of patches that face each other.
#[test]
fn two_facing_patches() {
    let mut build = Build::default();
    let material = build.material(grey(ALBEDO));
    let half = 0.5;
    build.quad(DVec3::ZERO, DVec3::Z * half, DVec3::X * half, material);
    build.quad(DVec3::Y, DVec3::X * half, DVec3::Z * half, material);
    let scene = build.scene();
    let slope = DVec3::new(3.0, -1.0, 0.0).normalize();
    let sun =
        Light { kind: LightKind::Directional, direction: slope, intensity: 10.0, ..Light::point("sun", DVec3::ZERO) };
    // A speck around the centre of the upper patch, from between the two.
    let speck = Projection::Orthographic { ymag: 1e-4 };
    let camera = look(DVec3::new(0.0, 0.5, 0.0), DVec3::Y, DVec3::X, speck);
    let settings = Settings { max_bounces: Some(1), ..settings(16) };
    let film = trace(&scene, &camera, &rig(vec![sun]), &settings, 256);
    // Form factor of a rectangle from a point above one of its corners, four times.
    let x = half / (1.0 + half * half).sqrt();
    let form_factor = 4.0 * (2.0 * x * x.atan()) / (2.0 * PI);
    let radiosity = ALBEDO * 10.0 * -slope.y;
    assert_mean(mean(&film, Layer::Indirect), ALBEDO / PI * radiosity * form_factor, 0.0, "one bounce");
    assert_eq!(mean(&film, Layer::Beauty), mean(&film, Layer::Indirect), "the upper patch is not lit");
}

/// A plane under a spot, its cone seen whole, and the same in a mirror.
#[test]
fn lit_plane_straight_and_in_a_mirror() {
    let (inner, outer, intensity) = (0.3f64, 0.6f64, 7.0);
    let spot = Light {
        kind: LightKind::Spot,
        direction: DVec3::NEG_Y,
        inner_angle: inner,
        outer_angle: outer,
        ..candela(Light::point("spot", DVec3::new(0.0, 2.0, 0.0)), intensity)
    };
    let radiance = |at: DVec3| {
        let d = DVec3::new(0.0, 2.0, 0.0) - at;
        let cosine = d.y / d.length();
        let ramp = ((cosine - outer.cos()) / (inner.cos() - outer.cos())).clamp(0.0, 1.0);
        ALBEDO / PI * intensity * ramp * ramp * cosine / d.length_squared()
    };
    let mut build = Build::default();
    let matt = build.material(grey(ALBEDO));
    let shiny = build.material(mirror(Vec3::splat(0.8), 1.0));
    build.quad(DVec3::ZERO, DVec3::Z * 4.0, DVec3::X * 4.0, matt);
    // Stands upright at x = 3, faces -X.
    build.quad(DVec3::new(3.0, 1.5, 0.0), DVec3::Z, DVec3::Y, shiny);
    let scene = build.scene();
    let settings = Settings { filter: Filter::Centre, ..settings(32) };

    let above = look(DVec3::new(0.0, 5.0, 0.0), DVec3::ZERO, DVec3::X, Projection::Perspective { yfov: 0.5 });
    let film = trace(&scene, &above, &rig(vec![spot.clone()]), &settings, 1);
    let (mut lit, mut edge) = (0, 0);
    for (i, got) in film.layer(Half::Both, Layer::Direct).iter().enumerate() {
        let (origin, direction) =
            above.ray((i % 32) as f64 / 32.0 + 1.0 / 64.0, (i / 32) as f64 / 32.0 + 1.0 / 64.0, 1.0);
        let want = radiance(origin - direction * (origin.y / direction.y));
        // 1e-6: positions in single precision, where the ramp is steepest.
        assert!((f64::from(got[0]) - want).abs() < 1e-6, "pixel {i}: {}, want {want}", got[0]);
        lit += usize::from(want > 0.0);
        edge += usize::from(want == 0.0);
    }
    assert!(lit > 100 && edge > 100, "{lit} lit, {edge} beyond the cone");

    let aside =
        look(DVec3::new(-1.0, 1.5, 0.0), DVec3::new(3.0, 1.2, 0.0), DVec3::Y, Projection::Perspective { yfov: 0.3 });
    let film = trace(&scene, &aside, &rig(vec![spot]), &settings, 1);
    let mut lit = 0;
    for (i, got) in film.layer(Half::Both, Layer::Reflection).iter().enumerate() {
        let (origin, mut direction) =
            aside.ray((i % 32) as f64 / 32.0 + 1.0 / 64.0, (i / 32) as f64 / 32.0 + 1.0 / 64.0, 1.0);
        let on_mirror = origin + direction * ((3.0 - origin.x) / direction.x);
        let fresnel = 0.8 + 0.2 * (1.0 - direction.x).powi(5);
        direction.x = -direction.x;
        let at = on_mirror - direction * (on_mirror.y / direction.y);
        let want = if direction.y < 0.0 && at.x.abs() < 4.0 { fresnel * radiance(at) } else { 0.0 };
        // 5e-5: a ray leaves the mirror 5e-5 m before it, where radiance changes by up to 0.7 a metre.
        assert!((f64::from(got[0]) - want).abs() < 5e-5, "pixel {i}: {}, want {want}", got[0]);
        lit += usize::from(want > 0.0);
    }
    assert!(lit > 100, "only {lit} pixels see the light in the mirror");
}

/// A room that glows, one wall of which is a perfect mirror: it shows what the others do, so radiance is as in a room
/// without. Emitters are found straight and through the mirror, where only chance finds them.
#[test]
fn glowing_room_with_a_mirror() {
    let mut build = Build::default();
    let glow = build.material(relume::scene::Material { emissive: Vec3::splat(0.8), ..grey(ALBEDO) });
    let perfect = build.material(mirror(Vec3::ONE, 1.0));
    build.room(DVec3::ZERO, 1.0, glow);
    let right = build.quads.iter_mut().find(|(corners, _)| corners.iter().all(|corner| corner.x > 0.99));
    right.expect("a room has a right wall").1 = perfect;
    let scene = build.scene();
    for target in [DVec3::new(-1.0, 0.3, 0.2), DVec3::new(1.0, 0.3, 0.2)] {
        let camera = look(DVec3::ZERO, target, DVec3::Y, Projection::Perspective { yfov: 0.8 });
        let film = trace(&scene, &camera, &rig(vec![]), &settings(16), 64);
        assert_mean(mean(&film, Layer::Emission), 0.8 / (1.0 - ALBEDO), 0.0, "emission");
    }
}
