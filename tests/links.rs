//! Light linking: what a light lights, and what casts its shadow.

mod common;

use std::f64::consts::PI;

use common::stage::{Build, Setup, Stage, lambert, look, pixels, render, rig};
use common::{assert_near, gpu, transfer};
use glam::{DVec3, Vec3, Vec4};
use relume::bake::transport::TransferSettings;
use relume::reference::path_tracer::{Film, Filter, Half, Layer, PathTracer, Settings};
use relume::relight::{Detail, Layers, Request, VisibilityMethod};
use relume::scene::{AlphaMode, Camera, Light, LightKind, Links, Material, Projection, Rig, Scene};
use relume::trace::bvh::TracedScene;
use relume::trace::packet::{PACKET_SIZE, trace_packets};

const ALBEDO: f64 = 0.6;

/// A material that links name.
fn named(name: &str, material: Material) -> Material {
    Material { name: name.into(), ..material }
}

fn white() -> Material {
    lambert(Vec3::splat(ALBEDO as f32))
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.into()).collect()
}

/// A floor that the camera sees, and boards between it and the lights: some of "veil", some of "wood", some that blend.
fn stage(veil: bool) -> (Scene, Camera) {
    let mut build = Build::default();
    let floor = build.material(named("floor", white()));
    let wood = build.material(named("wood", white()));
    let glass = Material { base_color: Vec4::new(0.5, 0.5, 0.5, 0.4), alpha_mode: AlphaMode::Blend, ..white() };
    let glass = build.material(named("glass", glass));
    let boards = build.material(named("veil", white()));
    build.room(DVec3::ZERO, 2.0, floor);
    // Open above, for lights outside.
    build.quads.retain(|(corners, _)| corners.iter().any(|corner| corner.y < 0.0));
    for (i, material) in [wood, boards, boards, glass, boards, boards, boards].into_iter().enumerate() {
        let x = 0.35 * (i as f64 - 3.0);
        let center = DVec3::new(x, -0.8 + 0.2 * (i % 3) as f64, 0.2 * x);
        if material != boards || veil {
            build.quad(center, DVec3::new(0.25, 0.05, 0.0), DVec3::new(0.02, 0.1, -0.6), material);
        }
    }
    let projection = Projection::Perspective { yfov: 1.2 };
    (build.scene(), look(DVec3::new(0.0, -0.3, 1.9), DVec3::new(0.0, -2.0, 0.0), DVec3::Y, projection))
}

fn lights() -> [Light; 4] {
    let point = Light::point("point", DVec3::new(0.1, 1.5, 0.2));
    let spot = Light {
        name: "spot".into(),
        kind: LightKind::Spot,
        direction: DVec3::NEG_Y,
        inner_angle: 0.3,
        outer_angle: 0.8,
        position: DVec3::new(-0.4, 0.9, -0.3),
        ..point.clone()
    };
    let direction = DVec3::new(0.2, -1.0, 0.1).normalize();
    let sun = Light { name: "sun".into(), kind: LightKind::Directional, direction, ..point.clone() };
    // Traced with single rays.
    let far = Light { name: "far".into(), position: -300.0 * direction, ..point.clone() };
    [point, spot, sun, far]
}

fn without_veil(light: Light) -> Light {
    Light { links: Links { no_shadow_from: names(&["veil"]), ..Links::default() }, ..light }
}

/// Packets and single rays pass what casts no shadow, as if it were not there, and blending surfaces in part.
#[test]
fn rays_pass_what_casts_no_shadow() {
    let (scene, camera) = stage(true);
    let opened = TracedScene::new(Scene { materials: Vec::clone(&scene.materials), ..stage(false).0 });
    let stage = Stage::new(scene, &camera, &Rig::default(), &Setup::new(64, 48));
    let mut differing = 0;
    for light in lights() {
        let packed = light.pack(stage.scene.space);
        let resolved = |links: Links| {
            let rig = rig(vec![Light { links, ..light.clone() }]);
            rig.resolve_links(&stage.scene).unwrap().remove(&0)
        };
        let links = resolved(without_veil(light.clone()).links);
        let lit_alone = resolved(Links { only: names(&["wood"]), ..Links::default() });
        let packets = &stage.framebuffer.packets;
        let [all, linked, open, lit_alone] = [
            stage.scene.linked(None),
            stage.scene.linked(links.as_ref()),
            opened.linked(None),
            stage.scene.linked(lit_alone.as_ref()),
        ]
        .map(|scene| {
            let mut visibility = vec![0; packets.len() * PACKET_SIZE];
            trace_packets(scene, &packed, packets, &mut visibility);
            visibility
        });
        assert_eq!(linked, open, "{}", light.name);
        assert_eq!(lit_alone, all, "what a light lights does not change its shadows");
        differing += linked.iter().zip(&all).filter(|(a, b)| a != b).count();
        for (packet, visibility) in packets.iter().zip(linked.chunks(PACKET_SIZE)) {
            for (lane, &visible) in visibility.iter().enumerate() {
                let share = packet.shadow_ray(&stage.scene.bvh, &packed, lane).map_or(0.0, |ray| {
                    stage.scene.linked(links.as_ref()).transmittance(ray.origin, ray.direction, ray.length)
                });
                assert!((255.0 * share - f32::from(visible)).abs() <= 1.0, "{}: {share}, {visible}", light.name);
            }
        }
    }
    assert!(differing > 500, "the veil casts shadows: {differing}");
}

fn settings(size: u32, max_bounces: Option<u32>) -> Settings {
    Settings {
        width: size,
        height: size,
        layers: 4,
        max_bounces,
        filter: Filter::Box,
        bounce_layers: 2,
        light_layers: false,
        seed: 1,
    }
}

fn trace(scene: &Scene, camera: &Camera, rig: &Rig, settings: &Settings, samples_a_half: u32) -> Film {
    let scene = &TracedScene::new(scene.clone());
    PathTracer::new(scene, camera, rig, settings).trace(samples_a_half, &|| false, &|_| ())
}

/// Mean over all pixels and channels.
fn mean(film: &Film, layer: Layer) -> f64 {
    let pixels = film.layer(Half::Both, layer);
    pixels.iter().flatten().map(|&x| f64::from(x)).sum::<f64>() / (3 * pixels.len()) as f64
}

/// In a sphere of which a light lights a half, the irradiance after k bounces is albedo^k times the flux on that half
/// over the area, everywhere. With a size, the light is also found by chance.
#[test]
fn what_is_not_lit_bounces_nothing() {
    let mut scene = common::stage::ball(48, named("upper", white()));
    scene.materials.push(named("lower", white()));
    let mesh = &mut scene.mesh;
    for (triangle, material) in mesh.triangles.iter().zip(&mut mesh.triangle_materials) {
        *material = u32::from(triangle.iter().map(|&v| mesh.positions[v as usize].y).sum::<f32>() < 0.0);
    }
    let camera = |y: f64| {
        let projection = Projection::Perspective { yfov: 0.6 };
        look(DVec3::new(0.3, 0.0, 0.0), DVec3::new(0.0, y, 0.0), DVec3::X, projection)
    };
    let factor = |name: &str, factor: f64| [(name.to_owned(), factor)].into();
    let cases = [
        (Links::default(), [1.0, 1.0]),
        (Links { only: names(&["upper"]), ..Links::default() }, [1.0, 0.0]),
        (Links { except: names(&["upper"]), ..Links::default() }, [0.0, 1.0]),
        (Links { factor: factor("lower", 1.5), ..Links::default() }, [1.0, 1.5]),
        (Links { except: names(&["lower"]), factor: factor("upper", 0.25), ..Links::default() }, [0.25, 0.0]),
    ];
    for (links, factors) in cases {
        for radius in [0.0, 0.3] {
            let light = Light { radius, intensity: 2.0, links: links.clone(), ..Light::point("a", DVec3::ZERO) };
            for (y, lit) in [(1.0, factors[0]), (-1.0, factors[1])] {
                let film = trace(&scene, &camera(y), &rig(vec![light.clone()]), &settings(8, Some(2)), 1024);
                let irradiance = 2.0 * (factors[0] + factors[1]) / 2.0;
                let reflected = |irradiance: f64| ALBEDO / PI * irradiance;
                let what = |of: &str| format!("{of} towards {y}, radius {radius}, {links:?}");
                assert_near(mean(&film, Layer::Direct), reflected(2.0 * lit), 5e-3, what("direct"));
                let [first, second] = [1, 2].map(|bounce| mean(&film, Layer::Bounce(bounce)));
                assert_near(first, reflected(ALBEDO * irradiance), 1e-2, what("first bounce"));
                assert_near(second, reflected(ALBEDO * ALBEDO * irradiance), 1e-2, what("second bounce"));
            }
        }
    }
}

/// A black board out of sight hides each light, and casts no shadow; the floor is glossy, so area lights are
/// found by chance as often as by looking for them.
#[test]
fn the_path_tracer_passes_what_casts_no_shadow() {
    let scene = |board: bool| {
        let mut build = Build::default();
        let floor = Material { roughness: 0.3, metallic: 1.0, ..white() };
        let floor = build.material(floor);
        let black = build.material(named("board", Material { double_sided: true, ..lambert(Vec3::ZERO) }));
        build.quad(DVec3::ZERO, DVec3::Z, DVec3::X, floor);
        if board {
            build.quad(DVec3::new(0.0, 0.6, -0.5), DVec3::X, DVec3::Z * 0.3, black);
        }
        // Equal bounds.
        build.quad(DVec3::new(0.0, 2.0, -3.0), DVec3::X * 0.1, DVec3::Y * 0.1, black);
        build.scene()
    };
    let camera =
        look(DVec3::new(0.0, 0.4, 0.9), DVec3::new(0.0, 0.0, 0.1), DVec3::Y, Projection::Perspective { yfov: 0.5 });
    let links = Links { no_shadow_from: names(&["board"]), ..Links::default() };
    let point = Light { links, ..Light::point("a", DVec3::new(0.0, 1.0, -0.8)) };
    let sun = Light {
        kind: LightKind::Directional,
        direction: DVec3::new(0.0, -0.8, 0.6).normalize(),
        angle: 0.2,
        ..point.clone()
    };
    for light in [point.clone(), Light { radius: 0.2, ..point }, sun] {
        let size = (light.radius, light.angle);
        let plain = Light { links: Links::default(), ..light.clone() };
        let shadowless = Light { shadows: false, ..plain.clone() };
        let cases = [(false, &light), (true, &light), (true, &shadowless), (true, &plain)];
        let [open, linked, shadowless, hidden] = cases.map(|(board, light)| {
            let rig = rig(vec![light.clone()]);
            let scene = if board { scene(true) } else { Scene { materials: scene(true).materials, ..scene(false) } };
            mean(&trace(&scene, &camera, &rig, &settings(16, Some(1)), 256), Layer::Direct)
        });
        assert_near(linked, open, 5e-3, format!("{size:?}, links"));
        assert_near(shadowless, open, 5e-3, format!("{size:?}, no shadows"));
        assert!(hidden < 0.8 * open, "{size:?}: the board hides the light: {hidden}, {open}");
    }
}

/// With shadow maps, a light from which something casts no shadow is traced; and its image follows its links.
#[test]
fn pictures_pass_what_casts_no_shadow() {
    let gpu = gpu();
    let (scene, camera) = stage(true);
    let open = Scene { materials: scene.materials.clone(), ..stage(false).0 };
    for light in lights() {
        let (plain, linked) = (rig(vec![light.clone()]), rig(vec![without_veil(light.clone())]));
        let setup = Setup { width: 48, height: 32, ..Setup::new(48, 32) };
        let want = render(&gpu, open.clone(), &camera, &plain, &setup, Layers::Direct);
        // The veil itself is in the picture: pixels of the floor are compared.
        let stage = Stage::new(scene.clone(), &camera, &linked, &setup);
        let floor = stage.framebuffer.packets.iter().zip(0..).flat_map(|(packet, first)| {
            (0..PACKET_SIZE)
                .filter(|&lane| packet.geometric_normal[1][lane] == 1.0)
                .map(move |lane| first * PACKET_SIZE + lane)
        });
        let at: Vec<usize> = floor
            .map(|sample| stage.framebuffer.tiling.pixel(sample))
            .filter(|&at| stage.framebuffer.tiling.contains(at))
            .map(|(x, y)| (y * 48 + x) as usize)
            .collect();
        for visibility in [VisibilityMethod::Map, VisibilityMethod::Traced] {
            let setup = Setup { visibility, ..setup.clone() };
            let mut relighter = stage.relighter(&gpu, &plain, &setup);
            let hidden = pixels(&mut relighter, Layers::Direct);
            relighter.set_rig(&linked).unwrap();
            let got = pixels(&mut relighter, Layers::Direct);
            let differing = |pixels: &[[f32; 3]]| at.iter().filter(|&&i| pixels[i] != want[i]).count();
            assert_eq!(differing(&got), 0, "{}, {visibility:?}", light.name);
            assert!(differing(&hidden) > 20, "{}, {visibility:?}", light.name);
            let coarse = Request { detail: Detail::Coarse, ..Layers::Direct.into() };
            relighter.set_rig(&plain).unwrap();
            relighter.set_rig(&linked).unwrap();
            let coarse = relighter.linear(coarse).unwrap().to_vec();
            let error =
                |pixels: &[[f32; 3]]| at.iter().map(|&i| (pixels[i][0] - want[i][0]).powi(2)).sum::<f32>().sqrt();
            let [moving, hidden] = [error(&coarse), error(&hidden)];
            assert!(moving < 0.7 * hidden, "{}, {visibility:?}: {moving}, {hidden} without links", light.name);
            let unknown = Light { links: Links { only: names(&["viel"]), ..Links::default() }, ..light.clone() };
            let error = relighter.set_rig(&rig(vec![unknown])).unwrap_err().to_string();
            assert!(error.contains("did you mean \"veil\"?"), "{error}");
        }
    }
}

/// A narrow spot through a veil that casts no shadow: its rays light the veil and the floor behind it. Where samples
/// lie in its small cone is left to chance, so the picture is a mean over seeds; with 1,000 samples, whose distance is
/// the width of the cone, it would be 5 % too bright.
#[test]
fn light_rays_pass_what_casts_no_shadow() {
    const SEEDS: u64 = 4;
    let gpu = gpu();
    let mut build = Build::default();
    let wall = build.material(named("wall", white()));
    let veil = build.material(named("veil", Material { double_sided: true, ..white() }));
    build.room(DVec3::ZERO, 1.0, wall);
    build.quad(DVec3::new(0.3, -0.2, 0.0), DVec3::Z * 0.3, DVec3::X * 0.3, veil);
    let scene = build.scene();
    let projection = Projection::Perspective { yfov: 1.5 };
    let camera = look(DVec3::new(-0.5, 0.3, 0.9), DVec3::new(0.3, -0.4, 0.0), DVec3::Y, projection);
    let spot = Light {
        kind: LightKind::Spot,
        direction: DVec3::NEG_Y,
        inner_angle: 0.05,
        outer_angle: 0.06,
        intensity: 1e3,
        ..Light::point("spot", DVec3::new(0.3, 0.5, 0.0))
    };
    let all = rig(vec![without_veil(spot)]);
    let setup = Setup::new(32, 32);
    let mut stage = Stage::new(scene.clone(), &camera, &all, &setup);
    let of_seed = |seed| {
        let settings = TransferSettings { seed, ..transfer::settings(4000, 400, 256) };
        stage.transfer = Some(transfer::dense(&stage, &settings));
        let got = pixels(&mut stage.relighter(&gpu, &all, &setup), Layers::Indirect);
        let mean = got.iter().flatten().map(|&x| f64::from(x)).sum::<f64>() / (3 * got.len()) as f64;
        println!("seed {seed}: {mean:.5}");
        mean
    };
    let got = (1..=SEEDS).map(of_seed).sum::<f64>() / SEEDS as f64;
    let want = mean(&trace(&scene, &camera, &all, &settings(32, None), 64), Layer::Indirect);
    println!("mean {got:.5}, want {want:.5}");
    assert_near(got, want, 0.03, "indirect light");
}

/// What a light lights and what it does not sum to all of it, in direct and indirect light; factors scale both; and the
/// path tracer agrees.
#[test]
fn pictures_follow_what_a_light_lights() {
    let gpu = gpu();
    let (scene, camera) = stage(true);
    let setup = Setup::new(48, 32);
    let light = || lights()[0].clone();
    let mut stage = Stage::new(scene.clone(), &camera, &rig(vec![light()]), &setup);
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(1000, 100, 64)));
    let linked = |links: Links| rig(vec![Light { links, ..light() }]);
    let sets = [
        Links { only: names(&["floor", "glass"]), ..Links::default() },
        Links { except: names(&["floor", "glass"]), ..Links::default() },
        Links { factor: [("floor".into(), 0.25), ("veil".into(), 3.0)].into(), ..Links::default() },
    ];
    for layers in [Layers::Direct, Layers::Indirect] {
        for visibility in [VisibilityMethod::Traced, VisibilityMethod::Map] {
            let setup = Setup { visibility, ..setup.clone() };
            let picture = |rig: &Rig| pixels(&mut stage.relighter(&gpu, rig, &setup), layers);
            let whole = picture(&linked(Links::default()));
            let [listed, others, scaled] = sets.each_ref().map(|links| picture(&linked(links.clone())));
            let brightest = whole.iter().flatten().fold(0f32, |m, &x| m.max(x));
            let mut lit = [0, 0];
            for (i, want) in whole.iter().enumerate() {
                let sum = listed[i][0] + others[i][0];
                let allowed = 1e-3 * want[0] + 1e-4 * brightest;
                assert!((sum - want[0]).abs() <= allowed, "{layers:?}: {sum}, want {}", want[0]);
                lit = [lit[0] + usize::from(listed[i][0] > 0.0), lit[1] + usize::from(others[i][0] > 0.0)];
            }
            assert!(lit.iter().all(|&lit| lit > 50), "{layers:?}: {lit:?}");
            if layers == Layers::Direct && visibility == VisibilityMethod::Traced {
                let settings = Settings { width: 48, height: 32, filter: Filter::Centre, ..settings(48, Some(0)) };
                let film = trace(&scene, &camera, &linked(sets[2].clone()), &settings, 1);
                let traced = film.layer(Half::Both, Layer::Direct);
                for (got, want) in scaled.iter().zip(&traced) {
                    assert!((got[0] - want[0]).abs() <= 1e-3 * brightest, "{}, want {}", got[0], want[0]);
                }
            }
        }
    }
    // Links that come and go in one relighter.
    let mut relighter = stage.relighter(&gpu, &linked(Links::default()), &setup);
    let before = pixels(&mut relighter, Layers::All);
    relighter.set_rig(&linked(sets[2].clone())).unwrap();
    let scaled = pixels(&mut relighter, Layers::All);
    assert_eq!(scaled, pixels(&mut stage.relighter(&gpu, &linked(sets[2].clone()), &setup), Layers::All));
    relighter.set_rig(&linked(Links::default())).unwrap();
    assert_eq!(pixels(&mut relighter, Layers::All), before);
}
