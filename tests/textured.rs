//! Indirect light of textured, glossy and double-sided surfaces: closed forms, and the path tracer.

mod common;

use std::f64::consts::PI;

use common::ratio::Lit;
use common::stage::{Build, ball, emitter, lambert, look, mirror, rig};
use common::{assert_near, transfer};
use glam::{DVec3, Vec3};
use relume::bake::brdf_factors::NEAR_MIRROR_ALPHA;
use relume::bake::gather_samples::{GatherSamples, Placement, Surfaces};
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::level::Level;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings, direct};
use relume::physics::brdf::Lobes;
use relume::physics::sequence::Points;
use relume::scene::{Camera, Encoding, Light, LightKind, Material, Projection, Rig, Scene, Texture};
use relume::shared::{Brdf, NO_BRDF};
use relume::trace::bvh::TracedScene;

fn double_sided(material: Material) -> Material {
    Material { double_sided: true, ..material }
}

fn grey(albedo: f32) -> Material {
    lambert(Vec3::splat(albedo))
}

fn inside(at: DVec3, to: DVec3) -> Camera {
    look(at, to, DVec3::Y, Projection::Perspective { yfov: 1.4 })
}

/// A box with half the sides `half`, seen from outside.
fn closed_box(build: &mut Build, center: DVec3, half: DVec3, material: usize) {
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let (u, v) = (DVec3::new(axis.y, axis.z, axis.x) * half, DVec3::new(axis.z, axis.x, axis.y) * half);
        build.quad(center + axis * half, u, v, material);
        build.quad(center - axis * half, v, u, material);
    }
}

/// First bounces of a scene against the path tracer's, whose mean over all pixels is right to a third of a percent.
fn ratio(scene: &Scene, camera: &Camera, rig: &Rig, samples: usize) -> f64 {
    let scene = &TracedScene::new(scene.clone());
    let lit = Lit { scene, camera, rig, size: [48, 32] };
    let settings = TransferSettings { bounces: Some(1), points: 16, ..transfer::settings(samples, 64, 1024) };
    let ratio = lit.mean(&settings) / lit.traced_mean(Some(1), 512);
    ratio.element_sum() / 3.0
}

/// Thin boards and boxes, all double-sided, in a double-sided room: the dark inside of none is read.
#[test]
fn closed_meshes_that_are_double_sided_keep_their_light() {
    let mut build = Build::default();
    let white = build.material(double_sided(grey(0.7)));
    let wood = build.material(double_sided(grey(0.5)));
    build.room(DVec3::ZERO, 1.0, white);
    for shelf in -2..=2 {
        closed_box(&mut build, DVec3::new(-0.7, 0.35 * f64::from(shelf), 0.2), DVec3::new(0.2, 0.015, 0.5), wood);
    }
    closed_box(&mut build, DVec3::new(0.4, -0.4, 0.5), DVec3::new(0.4, 0.02, 0.3), wood);
    for (x, z) in [(0.05, 0.25), (0.75, 0.25), (0.05, 0.75), (0.75, 0.75)] {
        closed_box(&mut build, DVec3::new(x, -0.71, z), DVec3::new(0.02, 0.289, 0.02), wood);
    }
    let light = Light::point("lamp", DVec3::new(0.2, 0.7, 0.1));
    let got = ratio(
        &build.scene(),
        &inside(DVec3::new(0.5, 0.1, -0.95), DVec3::new(-0.3, -0.1, 1.0)),
        &rig(vec![light]),
        2048,
    );
    println!("double-sided boxes: {got:.4}");
    assert_near(got, 1.0, 0.01, "double-sided boxes");
}

/// A room cut in two by a sheet, with the light on the other side.
#[test]
fn nothing_comes_through_a_sheet() {
    let mut build = Build::default();
    let white = build.material(grey(0.7));
    let sheet = build.material(double_sided(grey(0.7)));
    build.room(DVec3::ZERO, 1.0, white);
    build.quad(DVec3::ZERO, DVec3::X, DVec3::Y, sheet);
    let scene = TracedScene::new(build.scene());
    let rig = rig(vec![Light::point("lamp", DVec3::new(0.1, 0.2, -0.4))]);
    let settings = transfer::settings(2048, 256, 256);
    let seen = |camera: &Camera| Lit { scene: &scene, camera, rig: &rig, size: [48, 32] }.mean(&settings);
    let lit = seen(&inside(DVec3::new(0.3, 0.0, -0.9), DVec3::ZERO));
    let dark = seen(&inside(DVec3::new(0.3, 0.0, 0.9), DVec3::ZERO));
    assert!(lit.min_element() > 0.01 && dark == DVec3::ZERO, "lit {lit}, dark {dark}");
}

/// A double-sided ball with a light in it, and in a room with a light beside it.
#[test]
fn double_sided_balls_from_either_side() {
    let scene = ball(12, double_sided(grey(0.6)));
    let lamp = |at: DVec3| rig(vec![Light::point("lamp", at)]);
    let got = ratio(&scene, &inside(DVec3::new(0.0, 0.1, -0.8), DVec3::ZERO), &lamp(DVec3::new(0.3, 0.4, 0.2)), 2048);
    println!("ball from inside: {got:.4}");
    assert_near(got, 1.0, 0.01, "ball from inside");

    // The room around it.
    let mut build = Build::default();
    let white = build.material(grey(0.7));
    build.room(DVec3::ZERO, 2.0, white);
    let mut both = build.scene();
    let first = both.mesh.positions.len() as u32;
    let into = |p: &Vec3| both.space.from_world(scene.space.to_world(*p)).as_vec3();
    let positions: Vec<Vec3> = scene.mesh.positions.iter().map(into).collect();
    both.mesh.positions.extend(positions);
    both.mesh.normals.extend(&scene.mesh.normals);
    both.mesh.triangles.extend(scene.mesh.triangles.iter().map(|t| t.map(|v| v + first)));
    both.mesh.triangle_materials.extend(scene.mesh.triangle_materials.iter().map(|m| m + 1));
    both.materials.extend(scene.materials.iter().cloned());
    let camera = inside(DVec3::new(0.4, 0.3, -1.9), DVec3::ZERO);
    let got = ratio(&both, &camera, &lamp(DVec3::new(1.5, 1.5, -1.0)), 2048);
    println!("ball from outside: {got:.4}");
    assert_near(got, 1.0, 0.01, "ball from outside");
}

fn checker(side: usize, values: [u8; 2]) -> Texture {
    let texel = |i: usize| {
        let value = values[(i % side + i / side) % 2];
        [value, value, value, 255]
    };
    Texture::new("checker".into(), side, side, (0..side * side).map(texel).collect(), Encoding::Linear)
}

/// All walls glow alike and reflect 0.2 or 0.8 in squares: of light from everywhere each point reflects its own albedo,
/// and all of them together the mean: indirect light is albedo e / (1 - mean).
#[test]
fn a_furnace_with_checkered_walls() {
    let mut build = Build::default();
    // Interpolation between texels keeps the mean.
    let base_color_texture = build.texture(checker(64, [51, 204]));
    let walls = build.material(Material { base_color_texture, emissive: Vec3::ONE, ..grey(1.0) });
    build.room(DVec3::ZERO, 1.0, walls);
    let scene = TracedScene::new(build.scene());
    let camera = inside(DVec3::new(0.3, 0.1, -0.9), DVec3::ZERO);
    let lit = Lit { scene: &scene, camera: &camera, rig: &rig(Vec::new()), size: [48, 32] };
    let framebuffer = lit.bake();
    let transfer = LightTransport::new(&scene, &framebuffer, &transfer::settings(4096, 1024, 512), &|_| ());
    let emitted = transfer.emitted(&framebuffer, Lobe::All);
    assert_eq!(emitted.count(), 1, "walls glow");
    let all: Vec<u32> =
        (0..framebuffer.samples.len() as u32).filter(|&i| framebuffer.samples[i as usize].brdf != NO_BRDF).collect();
    let got = emitted.radiance(&transfer.rows(&all, Lobe::All), &all);
    let (mut sum, mut count) = (0.0, 0.0);
    for (&i, radiance) in all.iter().zip(got) {
        let albedo = framebuffer.brdfs[framebuffer.samples[i as usize].brdf as usize].diffuse.x;
        let ratio = f64::from(radiance.x / albedo);
        // Gather samples hold the mean of some of their squares, a ray reads a few of these; in the edge between two
        // walls all rays read the same.
        let mut heights = framebuffer.samples[i as usize].position.abs().to_array();
        heights.sort_by(f32::total_cmp);
        let tolerance = if heights[2] - heights[1] < 0.01 { 0.1 } else { 0.03 };
        assert_near(ratio, 2.0, tolerance, format!("sample {i} of albedo {albedo}"));
        (sum, count) = (sum + ratio, count + 1.0);
    }
    println!("checkered furnace: {:.4}", sum / count / 2.0);
    assert_near(sum / count, 2.0, 0.005, "mean");
}

/// One gather sample is a floor whose bright half is lit, and whose dark half lies in the shadow of a board.
#[test]
fn light_on_bright_texels_is_reflected() {
    let side = 64;
    let texel = |i: usize| if i % side < side / 2 { [204, 204, 204, 255] } else { [13, 13, 13, 255] };
    let halves = Texture::new("halves".into(), side, side, (0..side * side).map(texel).collect(), Encoding::Linear);
    let mut build = Build::default();
    let base_color_texture = build.texture(halves);
    let floor = build.material(Material { base_color_texture, ..grey(1.0) });
    let board = build.material(grey(0.0));
    build.quad(DVec3::ZERO, DVec3::X, DVec3::NEG_Z, floor);
    build.quad(DVec3::new(0.5, 1.0, 0.0), DVec3::X * 0.5, DVec3::NEG_Z, board);
    let scene = TracedScene::new(build.scene());
    let samples = GatherSamples::place(&scene, &Surfaces::even(&scene), Placement::Clustered { points: 16 }, 1, 1);
    assert_eq!(samples.len(), 1);
    let level = Level::new(&scene, samples, &[1]);
    let sun = Light { kind: LightKind::Directional, direction: DVec3::NEG_Y, ..Light::point("sun", DVec3::ZERO) };
    let got = direct::shade(&scene, &level, &sun.pack(scene.space))[0].x / PI.sqrt();
    println!("of the light on bright texels {:.3} is reflected", got / (0.5 * 0.8 / PI));
    assert_near(got, 0.5 * 0.8 / PI, 0.1, "radiance");
}

/// A floor whose roughness map has two values, and one of two materials.
#[test]
fn a_roughness_map_of_two_values_is_two_materials() {
    let metal = |roughness: f32| Material { roughness, ..mirror(Vec3::splat(0.9), 1.0) };
    let picture = |mapped: bool| {
        let mut build = Build::default();
        let white = build.material(grey(0.7));
        build.room(DVec3::ZERO, 1.0, white);
        build.quads.remove(2); // the floor
        let texels = (0..64).map(|i| [255, if i < 32 { 77 } else { 179 }, 255, 255]).collect();
        let texture = build.texture(Texture::new("two".into(), 64, 1, texels, Encoding::Linear));
        if mapped {
            let floor = build.material(Material { metallic_roughness_texture: texture, ..metal(1.0) });
            build.quad(DVec3::NEG_Y, DVec3::X, DVec3::NEG_Z, floor);
        } else {
            for (x, value) in [(-0.5, 77.0), (0.5, 179.0)] {
                let half = build.material(metal(value / 255.0));
                build.quad(DVec3::new(x, -1.0, 0.0), 0.5 * DVec3::X, DVec3::NEG_Z, half);
            }
        }
        let scene = TracedScene::new(build.scene());
        let camera = inside(DVec3::new(0.1, 0.3, 0.95), DVec3::new(0.0, -0.4, 0.0));
        let spot = Light {
            kind: LightKind::Spot,
            direction: DVec3::NEG_Y,
            outer_angle: 0.8,
            ..Light::point("lamp", DVec3::new(0.1, 0.6, -0.2))
        };
        let lit = Lit { scene: &scene, camera: &camera, rig: &rig(vec![spot]), size: [48, 32] };
        lit.mean(&transfer::settings(4096, 512, 512)).x
    };
    let (mapped, two) = (picture(true), picture(false));
    println!("roughness map {mapped:.5}, two materials {two:.5}: {:.4}", mapped / two);
    assert_near(mapped, two, 0.01, "mean of indirect light");
}

/// A mirror floor whose normal map leans everywhere the same way: what it shows and throws on is what the path tracer
/// finds.
#[test]
fn a_normal_mapped_mirror_floor() {
    let mut build = Build::default();
    let white = build.material(grey(0.7));
    let red = build.material(lambert(Vec3::new(0.7, 0.2, 0.1)));
    build.room(DVec3::ZERO, 1.0, white);
    build.quads[0].1 = red;
    let texel = [165, 128, 247, 255];
    let normal_texture = build.texture(Texture::new("leaning".into(), 1, 1, vec![texel], Encoding::Linear));
    let floor = build.material(Material { normal_texture, ..mirror(Vec3::splat(0.9), 1.0) });
    build.quad(DVec3::NEG_Y * 0.98, 0.9 * DVec3::X, 0.9 * DVec3::NEG_Z, floor);
    let camera = inside(DVec3::new(0.1, 0.4, 0.95), DVec3::new(0.0, -0.6, 0.0));
    let light = Light::point("lamp", DVec3::new(0.2, 0.5, -0.3));
    let got = ratio(&build.scene(), &camera, &rig(vec![light]), 2048);
    println!("normal-mapped mirror: {got:.4}");
    assert_near(got, 1.0, 0.01, "normal-mapped mirror");
}

/// Whatever the roughness and however few functions hold its lobe, a floor sends on all that it reflects of a lamp.
#[test]
fn lobes_keep_the_light_of_lamps() {
    for roughness in [0.1f32, 0.2, 0.3, 0.5] {
        let mut by_functions = Vec::new();
        for functions in [1, 4, 16] {
            let mut build = Build::default();
            let floor = build.material(Material { roughness, ..mirror(Vec3::splat(0.8), 1.0) });
            let black = build.material(emitter(Vec3::ZERO));
            let white = build.material(grey(0.5));
            build.quad(DVec3::ZERO, DVec3::Z, DVec3::X, floor);
            build.quad(DVec3::Y * 2.0, DVec3::X * 4.0, DVec3::Z * 4.0, white);
            build.quad(DVec3::NEG_Y, DVec3::Z * 4.0, DVec3::X * 4.0, black);
            let scene = TracedScene::new(build.scene());
            let at = DVec3::new(0.3, 1.0, -0.2);
            let spot =
                Light { kind: LightKind::Spot, direction: DVec3::NEG_Y, outer_angle: 0.3, ..Light::point("spot", at) };
            let camera =
                look(DVec3::new(0.0, 1.0, 1.5), DVec3::Y * 2.0, DVec3::Z, Projection::Perspective { yfov: 2.0 });
            let lit = Lit { scene: &scene, camera: &camera, rig: &rig(vec![spot.clone()]), size: [48, 32] };
            let framebuffer = lit.bake();
            let outgoing = Outgoing::Glossy { functions: Some(functions) };
            let settings = TransferSettings { outgoing, points: 16, ..transfer::settings(16_384, 64, 64) };
            let transfer = LightTransport::new(&scene, &framebuffer, &settings, &|_| ());
            let direct = lit.direct(&transfer);
            let mut sent = 0.0;
            for (i, sample) in
                transfer.fine.samples.samples.iter().enumerate().filter(|(_, s)| s.material == floor as u32)
            {
                // The first function is 1/sqrt(pi), the only one with a mean.
                sent += f64::from(sample.area) * direct[transfer.fine.coefficients(i).start].x * PI.sqrt();
            }
            sent *= scene.space.unit.powi(2);
            let want = reflected(&spot, (roughness * roughness).max(NEAR_MIRROR_ALPHA), 0.8);
            println!("roughness {roughness}, {functions} functions: {:.4}", sent / want);
            // What is left is how well points add the spot's light up.
            assert_near(sent, want, 0.01, format!("roughness {roughness}, {functions} functions"));
            by_functions.push(sent);
        }
        // More functions sharpen a lobe, and add nothing to it.
        by_functions
            .iter()
            .for_each(|sent| assert_near(*sent, by_functions[0], 1e-5, format!("roughness {roughness}")));
    }
}

/// What a metal floor at y = 0 reflects of a spot's light, by summing over its circle.
fn reflected(spot: &Light, alpha: f32, f0: f32) -> f64 {
    let brdf =
        Brdf { diffuse: Vec3::ZERO, alpha, f0: Vec3::splat(f0), f90: 1.0, dielectric_f0: 0.0, dielectric_f90: 0.0 };
    let height = spot.position.y;
    let rings = 64;
    let scale = 1.0 / (spot.inner_angle.cos() - spot.outer_angle.cos());
    let ring = |i: u32| {
        let radius = (f64::from(i) + 0.5) / f64::from(rings) * height * spot.outer_angle.tan();
        let width = height * spot.outer_angle.tan() / f64::from(rings);
        let cosine = height / height.hypot(radius);
        let wi = DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        let lobes = Lobes::new(&brdf, DVec3::Z, wi).expect("it reflects");
        let points = Points::new(1, 0);
        let count = 4096;
        let draw = |i: u32| {
            let [u, v, w, _] = points.at(i, 0);
            lobes.sample([u, v, w]).map_or(0.0, |wo| {
                let at = lobes.at(wo);
                at.sum().x / at.density
            })
        };
        let albedo = (0..count).map(draw).sum::<f64>() / f64::from(count);
        let attenuation = ((cosine - spot.outer_angle.cos()) * scale).clamp(0.0, 1.0).powi(2);
        attenuation * cosine / (height * height + radius * radius) * albedo * 2.0 * PI * radius * width
    };
    (0..rings).map(ring).sum()
}
