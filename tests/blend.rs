//! Surfaces that blend: what is seen past them, what light they let through, in pictures and by the path tracer.

mod common;

use std::f64::consts::PI;

use common::random::Random;
use common::ratio::Lit;
use common::stage::{Build, Setup, Stage, lambert, look, mirror, pixels, render, rig};
use common::{assert_near, drawn, gpu, largest, transfer};
use glam::{DVec3, Mat3, Vec2, Vec3};
use relume::bake::transport::TransferSettings;
use relume::reference::path_tracer::{Half, Layer, PathTracer, Settings};
use relume::relight::{Layers, VisibilityMethod};
use relume::scene::{
    AlphaMode, Camera, Encoding, Light, LightKind, Material, Projection, Rig, Scene, Texture, TextureRef, Wrap,
};
use relume::trace::bvh::TracedScene;
use relume::trace::packet::common_origin::{CommonOriginPacket, trace_common_origin};
use relume::trace::packet::{PACKET_SIZE, SamplePacket, shadow_ray, trace_packets};

/// Of single precision on the way to a radiance.
const FLOAT: f64 = 2e-6;
/// Visibility has 8 bits.
const HALF_STEP: f64 = 0.5 / 255.0;

const WALL: Vec3 = Vec3::new(0.5, 0.25, 0.8);
const SHEET: Vec3 = Vec3::new(0.9, 0.1, 0.3);

fn blending(color: Vec3, alpha: f32) -> Material {
    Material { base_color: color.extend(alpha), alpha_mode: AlphaMode::Blend, double_sided: true, ..lambert(color) }
}

fn sun(direction: DVec3) -> Light {
    let direction = direction.normalize();
    Light { kind: LightKind::Directional, direction, intensity: PI, ..Light::point("sun", DVec3::ZERO) }
}

/// Straight down from 3 m, `half` metres to each side.
fn overhead(half: f64) -> Camera {
    look(DVec3::Y * 3.0, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: half })
}

/// A white floor at y = 0, and sheets over all of it at their heights.
fn sheets(over: &[(f64, Material)]) -> Build {
    let mut build = Build::default();
    let wall = build.material(lambert(WALL));
    build.quad(DVec3::ZERO, 2.0 * DVec3::Z, 2.0 * DVec3::X, wall);
    for (height, material) in over {
        let material = build.material(material.clone());
        build.quad(DVec3::Y * *height, 2.0 * DVec3::Z, 2.0 * DVec3::X, material);
    }
    build
}

/// The same picture baked and relit, and by the path tracer, which sees the same but for 8 bits of visibility.
fn both(scene: Scene, camera: &Camera, rig: &Rig, size: u32) -> [Vec<[f32; 3]>; 2] {
    let setup = Setup::new(size, size);
    let traced = traced(&scene, camera, rig, size);
    [render(&gpu(), scene, camera, rig, &setup, Layers::FirstHand), traced]
}

/// Direct light and reflections.
fn traced(scene: &Scene, camera: &Camera, rig: &Rig, size: u32) -> Vec<[f32; 3]> {
    let scene = &TracedScene::new(scene.clone());
    let settings = Settings { max_bounces: Some(0), ..drawn::tracing(size, size) };
    let film = PathTracer::new(scene, camera, rig, &settings).trace(1, &|| false, &|_| ());
    film.layer(Half::Both, Layer::Beauty)
}

#[track_caller]
fn assert_all(pixels: &[[f32; 3]], want: DVec3, absolute: f64, what: &str) {
    for (i, pixel) in pixels.iter().enumerate() {
        let got = Vec3::from(*pixel).as_dvec3();
        let off = (got - want).abs();
        assert!(largest((off - FLOAT * want).to_array()) <= absolute, "{what}, pixel {i}: {got}, want {want}");
    }
}

/// A quarter of the sheet and three quarters of what is behind it, however many there are.
#[test]
fn sheets_behind_each_other_are_blended() {
    let unshadowed = Light { shadows: false, ..sun(DVec3::NEG_Y) };
    let other = Vec3::new(0.2, 0.7, 0.4);
    for (alphas, name) in [(&[0.25f32][..], "one"), (&[0.25, 0.5], "two"), (&[0.1, 0.25, 0.5, 0.75], "four")] {
        let mut want = WALL.as_dvec3();
        let mut over = Vec::new();
        for (i, &alpha) in alphas.iter().enumerate() {
            let color = if i % 2 == 0 { SHEET } else { other };
            want = want.lerp(color.as_dvec3(), alpha.into());
            over.push((0.5 + 0.3 * i as f64, blending(color, alpha)));
        }
        let pictures = both(sheets(&over).scene(), &overhead(0.7), &rig(vec![unshadowed.clone()]), 9);
        for (pixels, how) in pictures.iter().zip(["baked", "traced"]) {
            assert_all(pixels, want, 0.0, &format!("{name}, {how}"));
        }
    }
}

/// Nothing behind: the sheet's own share alone.
#[test]
fn a_sheet_before_nothing() {
    let mut build = Build::default();
    let sheet = build.material(blending(SHEET, 0.25));
    build.quad(DVec3::ZERO, DVec3::Z, DVec3::X, sheet);
    for pixels in both(build.scene(), &overhead(0.5), &rig(vec![sun(DVec3::NEG_Y)]), 8) {
        assert_all(&pixels, 0.25 * SHEET.as_dvec3(), 0.0, "before nothing");
    }
}

/// Seen in a mirror, and a mirror through a sheet: two panes there and back.
#[test]
fn sheets_before_a_mirror() {
    let mut build = Build::default();
    let shiny = build.material(mirror(Vec3::ONE, 1.0));
    let sheet = build.material(blending(SHEET, 0.25));
    let wall = build.material(lambert(WALL));
    // The camera looks down through the sheet at the mirror, and sees what is above itself through the sheet again.
    build.quad(DVec3::ZERO, 2.0 * DVec3::Z, 2.0 * DVec3::X, shiny);
    build.quad(DVec3::Y, 2.0 * DVec3::Z, 2.0 * DVec3::X, sheet);
    build.quad(DVec3::Y * 4.0, 2.0 * DVec3::X, 2.0 * DVec3::Z, wall);
    let lights = [sun(DVec3::NEG_Y), sun(DVec3::Y)].map(|light| Light { shadows: false, ..light });
    let (sheet, wall) = (SHEET.as_dvec3(), WALL.as_dvec3());
    let want = 0.25 * sheet + 0.75 * (0.25 * sheet + 0.75 * wall);
    for pixels in both(build.scene(), &overhead(0.7), &rig(lights.to_vec()), 8) {
        assert_all(&pixels, want, 0.0, "through the sheet, twice");
    }
}

/// More sheets than get samples of their own: each by chance, right on average over pixels.
#[test]
fn many_sheets_are_right_on_average() {
    let over: Vec<_> = (0..40).map(|i| (0.1 + 0.02 * f64::from(i), blending(SHEET, 0.05))).collect();
    let unshadowed = Light { shadows: false, ..sun(DVec3::NEG_Y) };
    let want = SHEET.as_dvec3().lerp(WALL.as_dvec3(), 0.95f64.powi(40));
    for pixels in both(sheets(&over).scene(), &overhead(1.5), &rig(vec![unshadowed]), 128) {
        let mean = pixels.iter().map(|&p| Vec3::from(p).as_dvec3()).sum::<DVec3>() / pixels.len() as f64;
        // What is left to chance after 16 sheets is 0.44 of a pixel, 0.13 of it the wall's: 4 standard errors.
        let error = 4.0 * 0.44 * (0.29 * 0.71f64).sqrt() / 128.0;
        let off = (mean - want).abs() / (SHEET - WALL).abs().as_dvec3();
        assert!(largest(off.to_array()) < error, "{mean}, want {want}");
    }
}

/// The floor under sheets that the camera does not see: 1 - a of the light for each of them.
#[test]
fn shadows_let_their_share_through() {
    let lights = [
        ("sun", sun(DVec3::new(0.1, -1.0, 0.2))),
        ("point", Light { intensity: 30.0, ..Light::point("point", DVec3::new(0.2, 2.0, 0.1)) }),
        ("far point", Light { intensity: 1e7, ..Light::point("far", DVec3::new(20.0, 1e3, 50.0)) }),
    ];
    for alphas in [&[0.25f32][..], &[0.5, 0.5], &[0.9, 0.1, 0.4], &[0.75, 1.0]] {
        let build = |alphas: &[f32]| {
            let over: Vec<_> =
                alphas.iter().enumerate().map(|(i, &a)| (1.0 + 0.2 * i as f64, blending(SHEET, a))).collect();
            sheets(&over).scene()
        };
        let left: f64 = alphas.iter().map(|a| 1.0 - f64::from(*a)).product();
        let below = look(DVec3::Y * 0.5, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 0.4 });
        for (name, light) in &lights {
            let rig = rig(vec![light.clone()]);
            // As many sheets, so that the scene is as large.
            let open = both(build(&vec![0.0; alphas.len()]), &below, &rig, 8);
            let dimmed = both(build(alphas), &below, &rig, 8);
            for (how, (open, dimmed)) in open.iter().zip(&dimmed).enumerate() {
                for (open, dimmed) in open.iter().flatten().zip(dimmed.iter().flatten()) {
                    let (open, got) = (f64::from(*open), f64::from(*dimmed));
                    let slack = if how == 0 { HALF_STEP + 1e-5 } else { 1e-5 };
                    assert!((got - left * open).abs() <= slack * open, "{name}, {alphas:?}: {got} of {open}");
                    assert!(open > 0.0);
                }
            }
        }
    }
}

/// What is not there at all changes nothing, to the last bit; what is all there is opaque, to the last bit.
#[test]
fn nothing_and_all() {
    let lights = rig(vec![sun(DVec3::new(0.3, -1.0, 0.2)), Light::point("lamp", DVec3::new(0.7, 1.6, 0.3))]);
    let camera = look(DVec3::new(0.5, 3.0, 2.0), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.6 });
    let build = |sheet: Option<Material>| {
        let mut build = Build::default();
        let wall = build.material(lambert(WALL));
        let shiny = build.material(mirror(Vec3::splat(0.8), 1.0));
        build.quad(DVec3::ZERO, 2.0 * DVec3::Z, 2.0 * DVec3::X, wall);
        build.quad(DVec3::new(-0.5, 0.5, 0.0), 0.5 * DVec3::Y, 0.7 * DVec3::Z, shiny);
        // Holds the bounds where they are.
        build.quad(DVec3::new(1.9, 1.9, 1.9), 0.1 * DVec3::Y, 0.1 * DVec3::Z, wall);
        if let Some(sheet) = sheet {
            let sheet = build.material(sheet);
            build.quad(DVec3::Y, 0.4 * DVec3::Z, 0.5 * DVec3::X, sheet);
        }
        build.scene()
    };
    let opaque = Material { double_sided: true, ..lambert(SHEET) };
    let pairs = [(None, blending(SHEET, 0.0), "nothing"), (Some(opaque), blending(SHEET, 1.0), "all")];
    for (plain, blending, what) in pairs {
        let [framebuffer, traced] = both(build(plain), &camera, &lights, 48);
        let [with, traced_with] = both(build(Some(blending)), &camera, &lights, 48);
        assert!(framebuffer == with, "baked: {what}");
        assert!(traced == traced_with, "traced: {what}");
    }
}

/// A leaf: alpha from a texture, a pixel a texel, above a floor on which its shadow falls.
#[test]
fn a_leaf_with_an_alpha_texture() {
    const SIDE: usize = 8;
    let mut random = Random::new(3);
    let texels: Vec<[u8; 4]> =
        (0..SIDE * SIDE).map(|_| [230, 26, 77, random.pick(&[0, 0, 64, 128, 200, 255, 255])]).collect();
    let mut build = Build::default();
    let base_color_texture = build.texture(Texture::new("leaf".into(), SIDE, SIDE, texels.clone(), Encoding::Linear));
    let wall = build.material(lambert(WALL));
    let leaf = build.material(Material { base_color_texture, ..blending(Vec3::ONE, 1.0) });
    build.quad(DVec3::ZERO, 2.0 * DVec3::X, -2.0 * DVec3::Z, wall);
    build.quad(DVec3::Y, DVec3::X, -DVec3::Z, leaf);
    let color = |texel: &[u8; 4]| DVec3::from_slice(&texel.map(|t| f64::from(t) / 255.0));
    let rig = rig(vec![sun(DVec3::NEG_Y)]);
    let below = look(DVec3::Y * 0.5, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 1.0 });
    for (camera, is_above) in [(overhead(1.0), true), (below, false)] {
        for pixels in both(build.scene(), &camera, &rig, SIDE as u32) {
            for (i, (got, texel)) in pixels.chunks(SIDE).rev().flatten().zip(&texels).enumerate() {
                let alpha = f64::from(texel[3]) / 255.0;
                let floor = (1.0 - alpha) * WALL.as_dvec3();
                let want = if is_above { (1.0 - alpha) * floor + alpha * color(texel) } else { floor };
                let got = Vec3::from(*got).as_dvec3();
                assert!(largest((got - want).abs().to_array()) < HALF_STEP + 1e-5, "texel {i}: {got}, want {want}");
            }
        }
    }
}

/// A floor under a sheet whose texture has seven alphas to a side, repeated or mirrored, in maps and traced.
#[test]
fn masks_have_their_holes_in_shadow_maps() {
    const SIDE: usize = 7;
    let mut random = Random::new(9);
    let texels: Vec<[u8; 4]> = (0..SIDE * SIDE).map(|_| [255, 255, 255, random.pick(&[0, 90, 160, 255])]).collect();
    let lights = [
        sun(DVec3::new(0.2, -1.0, 0.1)),
        Light { intensity: 30.0, ..Light::point("point", DVec3::new(0.3, 2.5, 0.2)) },
        Light {
            kind: LightKind::Spot,
            direction: DVec3::NEG_Y,
            outer_angle: 0.7,
            ..Light::point("spot", DVec3::new(0.1, 2.5, 0.0))
        },
    ];
    let below = look(DVec3::Y * 0.5, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 1.0 });
    for (wrap, scale) in [(Wrap::Clamp, 1.0), (Wrap::Repeat, 1.7), (Wrap::Mirror, -2.3)] {
        let mut build = Build::default();
        let texture = Texture::new("holes".into(), SIDE, SIDE, texels.clone(), Encoding::Linear);
        let texture = build.texture(texture).map(|t| TextureRef {
            uv_transform: Mat3::from_scale(Vec2::new(scale, scale)),
            wrap: [wrap, Wrap::Repeat],
            ..t
        });
        let wall = build.material(lambert(WALL));
        let sheet = build.material(Material {
            base_color_texture: texture,
            alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
            ..blending(Vec3::ONE, 0.9)
        });
        let solid = build.material(lambert(WALL));
        build.quad(DVec3::ZERO, 2.0 * DVec3::X, -2.0 * DVec3::Z, wall);
        build.quad(DVec3::Y, 1.2 * DVec3::X, -1.2 * DVec3::Z, sheet);
        build.quad(DVec3::new(0.9, 0.7, 0.9), 0.2 * DVec3::X, -0.2 * DVec3::Z, solid);
        for light in &lights {
            const SIZE: usize = 96;
            let rig = rig(vec![light.clone()]);
            let exact = Setup::new(SIZE as u32, SIZE as u32);
            let maps = Setup { visibility: VisibilityMethod::Map, ..exact.clone() };
            let gpu = gpu();
            let [traced, mapped] = [&exact, &maps].map(|setup| {
                render(&gpu, build.scene(), &below, &rig, setup, Layers::Direct)
                    .iter()
                    .map(|p| p[0])
                    .collect::<Vec<_>>()
            });
            let brightest = traced.iter().copied().fold(0.0, f32::max);
            let (mut lit, mut dark) = (0, 0);
            for (x, y) in (1..SIZE - 1).flat_map(|y| (1..SIZE - 1).map(move |x| (x, y))) {
                let i = y * SIZE + x;
                let around =
                    [i - SIZE - 1, i - SIZE, i - SIZE + 1, i - 1, i, i + 1, i + SIZE - 1, i + SIZE, i + SIZE + 1];
                if around.iter().any(|&j| (traced[j] > 0.0) != (traced[i] > 0.0)) {
                    continue; // an edge, which a filter blurs
                }
                // The weights of a filtered map have 8 bits; a wrong tap is a ninth.
                let off = (mapped[i] - traced[i]).abs();
                assert!(off <= 3.0 / 255.0 * brightest, "{wrap:?}, {}, pixel {x}, {y}: off by {off}", light.name);
                (lit, dark) = (lit + usize::from(traced[i] > 0.0), dark + usize::from(traced[i] == 0.0));
            }
            assert!(lit > 1000 && dark > 1000, "{wrap:?}, {}: {lit} lit, {dark} dark", light.name);
        }
    }
}

/// What blends leaves out texels by chance: the mean of the floor's light is right.
#[test]
fn sheets_dim_shadow_maps_on_average() {
    let over = [(0.8, blending(SHEET, 0.25)), (1.0, blending(SHEET, 0.5))];
    let below = look(DVec3::Y * 0.5, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 0.8 });
    let setup = Setup { visibility: VisibilityMethod::Map, ..Setup::new(128, 128) };
    for light in [sun(DVec3::new(0.2, -1.0, 0.1)), Light::point("lamp", DVec3::new(0.3, 2.0, 0.2))] {
        let mean = |over: &[(f64, Material)]| {
            let picture =
                render(&gpu(), sheets(over).scene(), &below, &rig(vec![light.clone()]), &setup, Layers::Direct);
            picture.iter().map(|p| f64::from(p[0])).sum::<f64>() / picture.len() as f64
        };
        let [dimmed, open] =
            [
                mean(&over),
                mean(&over.clone().map(|(at, sheet)| {
                    (at, Material { base_color: sheet.base_color.truncate().extend(0.0), ..sheet })
                })),
            ];
        // Pixels see about as many texels of their own as there are pixels: 4 standard errors.
        let error = 4.0 * (0.375 * 0.625f64).sqrt() / 128.0 / 0.375;
        println!("{}: {:.4} of 0.375", light.name, dimmed / open);
        assert_near(dimmed / open, 0.75 * 0.5, error, &light.name);
    }
}

/// Rays through sheets are stopped by each as often as its coverage tells; packets dim as the product tells.
#[test]
fn rays_pass_by_chance_and_packets_by_product() {
    let scene =
        sheets(&[(0.5, blending(SHEET, 0.25)), (1.0, blending(SHEET, 0.5)), (1.5, blending(SHEET, 0.125))]).scene();
    let scene = TracedScene::new(scene);
    let mut random = Random::new(5);
    let (mut counts, mut cast) = ([0usize; 4], 0.0);
    let origin = scene.space.from_world(DVec3::Y * 2.5).as_vec3();
    for _ in 0..400 {
        let mut packet = CommonOriginPacket::default();
        for lane in 0..PACKET_SIZE {
            let side = |r: &mut Random| r.between(-0.5, 0.5) as f32;
            packet.set(lane, Vec3::new(side(&mut random), -1.0, side(&mut random)));
        }
        let mut packets = [packet];
        trace_common_origin(&scene, origin, &mut packets);
        for lane in 0..PACKET_SIZE {
            let direction = packets[0].direction(lane);
            let (hit, _) = packets[0].hit(lane).expect("the floor stops all");
            let single = scene.closest_hit(origin, direction, f32::INFINITY).expect("the floor stops all");
            assert_eq!(hit.triangle, single.triangle, "packets and single rays draw alike");
            assert!(scene.occluded(origin, direction, f32::INFINITY));
            counts[scene.mesh.triangle_materials[hit.triangle as usize] as usize] += 1;
            cast += 1.0;
        }
    }
    let (of_0, of_1, of_2, of_3) = (0.875 * 0.5 * 0.75, 0.875 * 0.5 * 0.25, 0.875 * 0.5, 0.125);
    for (count, share) in counts.into_iter().zip([of_0, of_1, of_2, of_3]) {
        let error = f64::sqrt(share * (1.0 - share) / cast);
        assert!((count as f64 / cast - share).abs() < 4.0 * error, "{count} of {cast}, want {share}");
    }

    let light = Light::point("lamp", DVec3::new(0.1, 2.5, 0.3)).pack(scene.space);
    let mut packet = SamplePacket::default();
    for lane in 0..PACKET_SIZE {
        // Along a diagonal, which both triangles of a sheet have, and anywhere.
        let at = random.vector(-1.0, 1.0) * DVec3::new(1.0, 0.0, 1.0);
        let at = scene.space.from_world(if lane % 2 == 0 { DVec3::new(at.x, 0.0, at.x) } else { at });
        for axis in 0..3 {
            packet.position[axis][lane] = at.as_vec3()[axis];
            packet.normal[axis][lane] = Vec3::Y[axis];
            packet.geometric_normal[axis][lane] = Vec3::Y[axis];
        }
    }
    let above = Light::point("lamp", DVec3::Y * 2.5).pack(scene.space);
    for light in [light, above, sun(DVec3::NEG_Y).pack(scene.space)] {
        let mut visibility = [0; PACKET_SIZE];
        trace_packets(&scene, &light, std::slice::from_ref(&packet), &mut visibility);
        assert_eq!(visibility, [(255.0f64 * 0.75 * 0.5 * 0.875).round() as u8; PACKET_SIZE]);
        for lane in 0..PACKET_SIZE {
            let position = Vec3::from([0, 1, 2].map(|axis| packet.position[axis][lane]));
            let ray = shadow_ray(&scene.bvh, &light, position, Vec3::Y, Vec3::Y).expect("it faces the light");
            let share = scene.transmittance(ray.origin, ray.direction, ray.length);
            assert_eq!(share, 0.75 * 0.5 * 0.875, "lane {lane}");
        }
    }
}

/// Walls and a sheet between them glow and reflect alike: whatever the sheet lets through, radiance is the same
/// everywhere.
#[test]
fn a_furnace_with_a_sheet() {
    let albedo = 0.6;
    let glow = |alpha: f32| Material { emissive: Vec3::splat(0.8), ..blending(Vec3::splat(albedo), alpha) };
    let mut build = Build::default();
    let wall = build.material(glow(1.0));
    let sheet = build.material(glow(0.3));
    build.room(DVec3::ZERO, 1.0, wall);
    build.quad(DVec3::new(0.0, 0.1, 0.0), DVec3::new(0.9, 0.3, 0.0), DVec3::Z * 0.8, sheet);
    let scene = build.scene();
    let camera = look(DVec3::new(0.3, 0.8, -0.8), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.2 });
    let want = 0.8 / (1.0 - f64::from(albedo));

    let settings = drawn::tracing(16, 16);
    let film = PathTracer::new(&TracedScene::new(scene.clone()), &camera, &rig(vec![]), &settings).trace(
        256,
        &|| false,
        &|_| (),
    );
    let mean = |pixels: Vec<[f32; 3]>| pixels.iter().map(|p| f64::from(p[0])).sum::<f64>() / pixels.len() as f64;
    let traced = mean(film.layer(Half::Both, Layer::Emission));
    println!("furnace, traced: {:.5}", traced / want);
    assert_near(traced, want, 0.003, "traced");

    let setup = Setup::new(32, 32);
    let mut stage = Stage::new(scene, &camera, &rig(vec![]), &setup);
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(2048, 512, 512)));
    let picture = pixels(&mut stage.relighter(&gpu(), &rig(vec![]), &setup), Layers::All);
    for (i, pixel) in picture.iter().enumerate() {
        assert_near(pixel[0].into(), want, 0.01, format!("baked, pixel {i}"));
    }
    println!("furnace, baked: {:.5}", mean(picture.clone()) / want);
    assert_near(mean(picture), want, 0.003, "baked");
}

/// A room with a curtain across it, a plain one or one with holes of its own, lit from behind.
fn curtained(curtain: impl FnOnce(&mut Build) -> Material) -> Scene {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::splat(0.7)));
    let red = build.material(lambert(Vec3::new(0.7, 0.2, 0.1)));
    build.room(DVec3::ZERO, 1.0, white);
    build.quads[0].1 = red;
    let material = curtain(&mut build);
    let curtain = build.material(material);
    build.quad(DVec3::new(0.0, 0.1, 0.1), DVec3::X * 0.9, DVec3::Y * 0.8, curtain);
    build.scene()
}

/// Indirect light of such rooms against the path tracer's.
#[test]
fn indirect_light_through_curtains() {
    let stripes = |build: &mut Build, mode: AlphaMode, alphas: [u8; 2]| {
        let texels = (0..16 * 16).map(|i| [150, 180, 200, alphas[i % 16 / 2 % 2]]).collect();
        let base_color_texture = build.texture(Texture::new("stripes".into(), 16, 16, texels, Encoding::Linear));
        Material { base_color_texture, alpha_mode: mode, ..blending(Vec3::ONE, 1.0) }
    };
    let scenes = [
        ("thin", curtained(|_| blending(SHEET, 0.3))),
        ("thick", curtained(|_| blending(Vec3::splat(0.8), 0.8))),
        ("striped", curtained(|build| stripes(build, AlphaMode::Blend, [40, 220]))),
    ];
    for (name, scene) in scenes {
        let scene = TracedScene::new(scene);
        for lamp in [DVec3::new(0.2, 0.3, 0.6), DVec3::new(0.2, 0.3, -0.3)] {
            let camera = look(DVec3::new(0.3, 0.0, -0.9), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.4 });
            let rig = rig(vec![Light::point("lamp", lamp)]);
            let lit = Lit { scene: &scene, camera: &camera, rig: &rig, size: [48, 32] };
            for (bounces, most) in [(Some(1), 0.01), (None, 0.015)] {
                let settings = TransferSettings { bounces, points: 16, ..transfer::settings(2048, 512, 512) };
                let ratio = (lit.mean(&settings) / lit.traced_mean(bounces, 256)).element_sum() / 3.0;
                println!("{name}, lamp at {lamp}, bounces {bounces:?}: {ratio:.4}");
                assert_near(ratio, 1.0, most, format!("{name}, lamp at {lamp}, bounces {bounces:?}"));
            }
        }
    }
}
