//! Pictures whose every pixel is known: from a scene made in code, through bake and relighting, to linear pixels.

mod common;

use std::f64::consts::PI;

use common::stage::{self, Build, Setup, emitter, lambert, look, mirror, pixels, render, rig};
use common::{assert_near, gpu, largest};
use glam::{DVec3, Vec3};
use relume::relight::{Layers, Picture, Relighter};
use relume::scene::{Camera, Encoding, Light, LightGroup, LightKind, Material, Projection, Rig, Scene, Texture};

/// Relative error of float32 on the way to a radiance: some 30 roundings.
const FLOAT: f64 = 2e-6;
const ALBEDO: Vec3 = Vec3::new(0.5, 0.25, 0.8);

/// A floor at y = 0 that reaches 2 m in each direction.
fn floor(material: Material) -> Build {
    let mut build = Build::default();
    let material = build.material(material);
    build.quad(DVec3::ZERO, 2.0 * DVec3::Z, 2.0 * DVec3::X, material);
    build
}

/// From `height` straight down, `half` metres to each side: right is +X, down is +Z.
fn overhead(height: f64, half: f64) -> Camera {
    look(DVec3::Y * height, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: half })
}

/// Where the ray through the centre of pixel (x, y) meets the plane through `point` facing `normal`.
fn seen(camera: &Camera, setup: &Setup, (x, y): (u32, u32), point: DVec3, normal: DVec3) -> DVec3 {
    let (width, height) = (f64::from(setup.width), f64::from(setup.height));
    let (origin, direction) = camera.ray((f64::from(x) + 0.5) / width, (f64::from(y) + 0.5) / height, width / height);
    origin + direction * ((point - origin).dot(normal) / direction.dot(normal))
}

fn each_pixel(setup: &Setup) -> impl Iterator<Item = (u32, u32)> {
    let width = setup.width;
    (0..setup.width * setup.height).map(move |i| (i % width, i / width))
}

/// Irradiance of a point light of one candela.
fn point_irradiance(light: DVec3, at: DVec3, normal: DVec3) -> f64 {
    let to_light = light - at;
    normal.dot(to_light.normalize()).max(0.0) / to_light.length_squared()
}

#[track_caller]
fn assert_pixel(got: [f32; 3], want: DVec3, tolerance: f64, what: impl std::fmt::Display) {
    for (channel, (got, want)) in got.iter().zip(want.to_array()).enumerate() {
        assert_near(f64::from(*got), want, tolerance, format!("{what}, channel {channel}"));
    }
}

fn lambert_radiance(irradiance: f64) -> DVec3 {
    ALBEDO.as_dvec3() / PI * irradiance
}

/// One pixel in the middle of `build` under each of `lights` in turn.
fn one_pixel(build: &Build, camera: &Camera, lights: &[Light]) -> Vec<[f32; 3]> {
    let gpu = gpu();
    let setup = Setup::new(1, 1);
    let all = rig(lights.to_vec());
    let stage = stage::Stage::new(build.scene(), camera, &all, &setup);
    let mut relighter = stage.relighter(&gpu, &all, &setup);
    (0..lights.len()).map(|i| relighter.linear(Picture::Light(i)).unwrap()[0]).collect()
}

#[test]
fn inverse_square() {
    let heights = [0.01, 0.1, 0.5, 1.0, 3.0, 100.0, 1e5];
    let light = |height: f64| Light { intensity: 7.0, stops: 1.0, ..Light::point("l", DVec3::Y * height) };
    let got = one_pixel(&floor(lambert(ALBEDO)), &overhead(1.0, 0.5), &heights.map(light));
    for (height, got) in heights.into_iter().zip(got) {
        assert_pixel(got, lambert_radiance(14.0 / (height * height)), FLOAT, format!("light at {height} m"));
    }
}

#[test]
fn cosine_law() {
    let angles = [0.0f64, 30.0, 60.0, 85.0, 89.0, 89.99, 90.01, 120.0, 180.0];
    let towards = |degrees: f64| DVec3::new(degrees.to_radians().sin(), degrees.to_radians().cos(), 0.0);
    let point = angles.map(|a| Light::point("l", 3.0 * towards(a)));
    let sun = angles.map(|a| Light {
        kind: LightKind::Directional,
        direction: -towards(a),
        ..Light::point("l", DVec3::ZERO)
    });
    let got = one_pixel(&floor(lambert(ALBEDO)), &overhead(1.0, 0.5), &[point, sun].concat());
    for (i, got) in got.into_iter().enumerate() {
        let (degrees, falloff) = (angles[i % angles.len()], if i < angles.len() { 9.0 } else { 1.0 });
        let cosine = degrees.to_radians().cos().max(0.0);
        // At grazing angles the cosine is what float32 directions leave of it.
        let tolerance = FLOAT + 2e-7 / cosine.max(1e-9);
        assert_pixel(got, lambert_radiance(cosine / falloff), tolerance, format!("light {i} at {degrees} degrees"));
    }
}

/// A pixel a texel: each shows its own colour.
#[test]
fn textures_colour_pixels() {
    const SIDE: usize = 8;
    // Four roundings of a coordinate move it by so much of the way to the next texel.
    const MOVED: f64 = 4.0 * SIDE as f64 / 16_777_216.0;
    let texel = |i: usize| [(55 + i * 37 % 200) as u8, (55 + i * 101 % 200) as u8, (255 - i) as u8, 255];
    let texels: Vec<_> = (0..SIDE * SIDE).map(texel).collect();
    let mut build = Build::default();
    let texture = Texture::new("colours".into(), SIDE, SIDE, texels.clone(), Encoding::Linear);
    let base_color_texture = build.texture(texture);
    let material = build.material(Material { base_color_texture, ..lambert(ALBEDO) });
    build.quad(DVec3::ZERO, 2.0 * DVec3::X, -2.0 * DVec3::Z, material);
    let direction = DVec3::NEG_Y;
    let sun = Light { kind: LightKind::Directional, direction, ..Light::point("sun", DVec3::ZERO) };
    let (camera, setup) = (overhead(1.0, 2.0), Setup::new(SIDE as u32, SIDE as u32));
    let got = render(&gpu(), build.scene(), &camera, &rig(vec![sun]), &setup, Layers::All);
    // The picture's last row of pixels is the texture's first: up is -Z, as v is.
    for (i, (got, texel)) in got.chunks(SIDE).rev().flatten().zip(texels).enumerate() {
        let color = DVec3::from_slice(&texel.map(|t| f64::from(t) / 255.0));
        let tolerance = FLOAT + MOVED / color.min_element();
        assert_pixel(*got, color * lambert_radiance(1.0), tolerance, format!("texel {i}"));
    }
}

#[test]
fn sun_is_in_lux() {
    let direction = DVec3::new(0.6, -0.8, 0.0);
    let sun = Light { kind: LightKind::Directional, direction, intensity: 1e5, ..Light::point("sun", DVec3::ZERO) };
    let got = one_pixel(&floor(lambert(ALBEDO)), &overhead(1.0, 0.5), &[sun]);
    assert_pixel(got[0], lambert_radiance(0.8e5), FLOAT, "sun");
}

/// [KHR_lights_punctual], its reference code for spots and its formula for ranges.
#[test]
fn spot_cones() {
    let gpu = gpu();
    let height = 1.5;
    for (inner, outer) in [(20.0f64, 30.0f64), (0.0, 45.0), (30.0, 30.0), (29.99, 30.0), (0.0, 0.01), (0.0, 90.0)] {
        let (inner, outer) = (inner.to_radians(), outer.to_radians());
        let position = DVec3::Y * height;
        let light = Light {
            kind: LightKind::Spot,
            direction: DVec3::NEG_Y,
            inner_angle: inner,
            outer_angle: outer,
            ..Light::point("spot", position)
        };
        let half = (1.2 * height * outer.tan()).min(1.9);
        let (camera, setup) = (overhead(1.0, half), Setup::new(64, 64));
        let build = floor(lambert(ALBEDO));
        let got = render(&gpu, build.scene(), &camera, &rig(vec![light]), &setup, Layers::All);
        let (mut full, mut between, mut black) = (0, 0, 0);
        for ((x, y), got) in each_pixel(&setup).zip(got) {
            let at = seen(&camera, &setup, (x, y), DVec3::ZERO, DVec3::Y);
            let angle = (at.x.hypot(at.z) / height).atan();
            let scale = 1.0 / (inner.cos() - outer.cos()).max(0.001);
            let attenuation = |angle: f64| {
                // 1 - cos, exact: cos(angle) * scale - cos(outer) * scale.
                let versine = |angle: f64| 2.0 * (angle / 2.0).sin().powi(2);
                ((versine(outer) - versine(angle)) * scale).clamp(0.0, 1.0).powi(2)
            };
            // Float32 moves the point by 4 roundings of the scene's 2 m, and so the angle.
            let moved = 4.0 * 2.0 * f64::exp2(-24.0) / height + f64::exp2(-22.0);
            let radiance = lambert_radiance(point_irradiance(position, at, DVec3::Y));
            let low = radiance * attenuation(angle + moved) * (1.0 - FLOAT);
            let high = radiance * attenuation((angle - moved).max(0.0)) * (1.0 + FLOAT);
            let got = DVec3::from(got.map(f64::from));
            let inside = low.cmple(got).all() && got.cmple(high).all();
            assert!(inside, "{inner}..{outer} at {angle}: {got} is not in {low} .. {high}");
            full += usize::from(radiance.cmple(1.00001 * low).all());
            black += usize::from(high == DVec3::ZERO);
            between += usize::from(high != DVec3::ZERO && (1.00001 * high).cmplt(radiance).all());
        }
        assert!(full + between > 500, "{full} pixels fully lit, {between} partly");
        assert!(black > 500 || outer > 1.5, "{black} pixels outside of the cone");
    }
}

#[test]
fn range_falls_to_zero() {
    // At its range itself single precision may leave 1e-7.
    let heights = [0.1f64, 0.5, 1.0, 1.9, 1.999, 2.0 + 1e-6, 2.001, 50.0];
    let light = |height: f64| Light { range: Some(2.0), ..Light::point("l", DVec3::Y * height) };
    let got = one_pixel(&floor(lambert(ALBEDO)), &overhead(1.0, 0.5), &heights.map(light));
    for (height, got) in heights.into_iter().zip(got) {
        let window = (1.0 - (height / 2.0).powi(4)).clamp(0.0, 1.0);
        // What is left of 1 carries the rounding of 1.
        let tolerance = FLOAT + 4e-7 / window.max(1e-9);
        assert_pixel(got, lambert_radiance(window / (height * height)), tolerance, format!("light at {height} m"));
    }
}

/// A mirror floor seen at `degrees` off its normal; the mirror direction leads to a matt screen 1 m away, and half-way
/// there is a light of 1 cd. Returns (direct, reflection).
fn mirror_floor(material: Material, degrees: f64) -> ([f32; 3], [f32; 3]) {
    let gpu = gpu();
    let (sine, cosine) = degrees.to_radians().sin_cos();
    let (eye, reflected) = (DVec3::new(-sine, cosine, 0.0), DVec3::new(sine, cosine, 0.0));
    let mut build = floor(material);
    let screen = build.material(lambert(ALBEDO));
    let across = DVec3::new(cosine, -sine, 0.0);
    build.quad(reflected, 0.02 * across, 0.02 * DVec3::Z, screen);
    let setup = Setup::new(1, 1);
    let camera = look(0.75 * eye, DVec3::ZERO, DVec3::Z, Projection::Orthographic { ymag: 0.001 });
    let rig = rig(vec![Light::point("l", 0.5 * reflected)]);
    let stage = stage::Stage::new(build.scene(), &camera, &rig, &setup);
    let mut relighter = stage.relighter(&gpu, &rig, &setup);
    (pixels(&mut relighter, Layers::Direct)[0], pixels(&mut relighter, Layers::Reflection)[0])
}

#[test]
fn half_mirror_weighs_by_fresnel() {
    for degrees in [0.0f64, 30.0, 60.0, 80.0, 88.0] {
        let cosine = degrees.to_radians().cos();
        let fresnel = 0.04 + 0.96 * (1.0 - cosine).powi(5);
        let (direct, reflection) = mirror_floor(mirror(Vec3::splat(0.75), 0.0), degrees);
        // Half a metre off: 1/d² = 4. The half vector is the normal, so both lobes have one Fresnel term.
        let screen = lambert_radiance(4.0);
        // Schlick's fifth power and the cosine, each from float32 directions.
        let tolerance = FLOAT + 5e-7 / cosine;
        assert_pixel(reflection, screen * fresnel, tolerance, format!("reflection at {degrees} degrees"));
        let diffuse = 0.75 / PI * (1.0 - fresnel) * cosine * 4.0;
        assert_pixel(direct, DVec3::splat(diffuse), tolerance / (1.0 - fresnel), format!("floor at {degrees} degrees"));
    }
}

#[test]
fn metal_mirror_shows_the_screen_and_nothing_of_its_own() {
    let color = Vec3::new(0.9, 0.6, 0.3);
    for degrees in [0.0f64, 45.0, 85.0] {
        let schlick = (1.0 - degrees.to_radians().cos()).powi(5);
        let fresnel = color.as_dvec3().lerp(DVec3::ONE, schlick);
        let (direct, reflection) = mirror_floor(mirror(color, 1.0), degrees);
        assert_eq!(direct, [0.0; 3]);
        let tolerance = FLOAT + 5e-7 / degrees.to_radians().cos();
        assert_pixel(reflection, lambert_radiance(4.0) * fresnel, tolerance, format!("mirror at {degrees} degrees"));
    }
}

/// Between two mirrors, three bounces lead to a matt ceiling: it is layer 4.
#[test]
fn parallel_mirrors_end_with_the_layers() {
    let gpu = gpu();
    let mut build = Build::default();
    let metal = build.material(mirror(Vec3::splat(0.8), 1.0));
    let matt = build.material(lambert(ALBEDO));
    build.quad(DVec3::NEG_X, 3.0 * DVec3::Y, 3.0 * DVec3::Z, metal);
    build.quad(DVec3::X, 3.0 * DVec3::Z, 3.0 * DVec3::Y, metal);
    build.quad(2.0 * DVec3::Y, DVec3::X, DVec3::Z, matt);
    let direction = DVec3::new(3.0, 1.0, 0.0).normalize();
    let camera = look(DVec3::ZERO, direction, DVec3::Y, Projection::Perspective { yfov: 0.01 });
    // The path is at heights 1/3, 1 and 5/3 on the mirrors and meets the ceiling above the light.
    let rig = rig(vec![Light::point("l", DVec3::Y)]);
    let fresnel = 0.8 + 0.2 * (1.0 - direction.x).powi(5);
    for layers in 1..=6 {
        let setup = Setup { layers, ..Setup::new(1, 1) };
        let got = render(&gpu, build.scene(), &camera, &rig, &setup, Layers::All)[0];
        if layers < 4 {
            assert_eq!(got, [0.0; 3], "{layers} layers");
        } else {
            assert_pixel(got, lambert_radiance(fresnel.powi(3)), 2.0 * FLOAT, format!("{layers} layers"));
        }
    }
}

#[test]
fn single_sided_is_black_from_behind_and_blocks() {
    let gpu = gpu();
    let setup = Setup::new(1, 1);
    // From below, lit from below or from above.
    let camera = look(DVec3::NEG_Y, DVec3::ZERO, DVec3::Z, Projection::Orthographic { ymag: 0.5 });
    for (double_sided, height, want) in [(false, -0.5, 0.0), (false, 0.5, 0.0), (true, -0.5, 4.0), (true, 0.5, 0.0)] {
        let build = floor(Material { double_sided, ..lambert(ALBEDO) });
        let rig = rig(vec![Light::point("l", DVec3::Y * height)]);
        let got = render(&gpu, build.scene(), &camera, &rig, &setup, Layers::All)[0];
        assert_pixel(got, lambert_radiance(want), FLOAT, format!("double-sided {double_sided}, light at {height}"));
    }
    // A single-sided sheet between light and floor casts its shadow whichever way it faces.
    for (u, v) in [(DVec3::X, DVec3::Z), (DVec3::Z, DVec3::X)] {
        let mut build = floor(lambert(ALBEDO));
        build.quad(0.5 * DVec3::Y, 0.1 * u, 0.1 * v, 0);
        let lights = |shadows: bool| rig(vec![Light { shadows, ..Light::point("l", DVec3::Y) }]);
        let camera = overhead(0.4, 0.01);
        assert_eq!(render(&gpu, build.scene(), &camera, &lights(true), &setup, Layers::All)[0], [0.0; 3]);
        let unblocked = render(&gpu, build.scene(), &camera, &lights(false), &setup, Layers::All)[0];
        assert_pixel(unblocked, lambert_radiance(1.0), FLOAT, "a light without shadows");
    }
}

#[test]
fn shadow_edges_are_exact() {
    let gpu = gpu();
    let (low, high) = (DVec3::new(-0.2, 1.0, -0.25), DVec3::new(0.31, 1.0, 0.17));
    let mut build = floor(lambert(ALBEDO));
    build.quad((low + high) / 2.0, (high - low) / 2.0 * DVec3::Z, (high - low) / 2.0 * DVec3::X, 0);
    let light = DVec3::new(0.1, 2.0, 0.05);
    // In a light's cone, in sunlight of the same direction everywhere, and all around.
    let sun = DVec3::new(0.2, -1.0, -0.1).normalize();
    let lights = [
        Light::point("point", light),
        Light { kind: LightKind::Spot, direction: DVec3::NEG_Y, outer_angle: 1.2, ..Light::point("spot", light) },
        Light { kind: LightKind::Directional, direction: sun, ..Light::point("sun", DVec3::ZERO) },
    ];
    let (camera, setup) = (overhead(0.5, 0.9), Setup::new(203, 151));
    let all = rig(lights.to_vec());
    let stage = stage::Stage::new(build.scene(), &camera, &all, &setup);
    let mut relighter = stage.relighter(&gpu, &all, &setup);
    for (index, kind) in lights.iter().map(|l| l.kind).enumerate() {
        let got = relighter.linear(Picture::Light(index)).unwrap();
        let (mut dark, mut unsure) = (0, 0);
        for ((x, y), got) in each_pixel(&setup).zip(got) {
            let at = seen(&camera, &setup, (x, y), DVec3::ZERO, DVec3::Y);
            let crossing = if kind == LightKind::Directional { at - sun / sun.y.abs() } else { (at + light) / 2.0 };
            let outside = (low - crossing).max(crossing - high);
            let margin = outside.x.max(outside.z);
            // Rays end off the floor by 2^-17 of the scene, and coordinates are rounded.
            if margin.abs() < 3e-5 {
                unsure += 1;
                continue;
            }
            dark += usize::from(margin < 0.0);
            assert_eq!(got[0] > 0.0, margin > 0.0, "{kind:?} at {at}, {margin} m outside of the shadow: {got:?}");
        }
        assert!(dark > 1000 && unsure < 40, "{dark} pixels in the shadow, {unsure} on its edge");
    }
}

/// What a matt room of half side `half` around the origin shows, by pixel: (point, normal), or nothing on its edges.
fn room_walls(camera: &Camera, setup: &Setup, half: f64) -> Vec<Option<(DVec3, DVec3)>> {
    let wall = |pixel| {
        let (width, height) = (f64::from(setup.width), f64::from(setup.height));
        let (x, y): (u32, u32) = pixel;
        let (origin, direction) =
            camera.ray((f64::from(x) + 0.5) / width, (f64::from(y) + 0.5) / height, width / height);
        let distances = (DVec3::splat(half).copysign(direction) - origin) / direction;
        let distance = distances.min_element();
        let axis = (0..3).find(|&axis| distances[axis] == distance)?;
        let mut normal = DVec3::ZERO;
        normal[axis] = -direction[axis].signum();
        let second = (0..3).filter(|&other| other != axis).map(|other| distances[other]).fold(f64::INFINITY, f64::min);
        (second - distance > 1e-4 * half).then_some((origin + direction * distance, normal))
    };
    each_pixel(setup).map(wall).collect()
}

fn matt_room() -> Build {
    let mut build = Build::default();
    let material = build.material(lambert(ALBEDO));
    build.room(DVec3::ZERO, 1.0, material);
    build
}

/// Sizes that are a point, a line, not whole tiles.
#[test]
fn inside_a_closed_box() {
    let gpu = gpu();
    let light = DVec3::new(0.3, -0.2, 0.5);
    let eye = DVec3::new(0.11, 0.23, 0.91);
    let camera = look(eye, DVec3::new(0.1, -0.1, -1.0), DVec3::Y, Projection::Perspective { yfov: 1.9 });
    for (width, height) in [(1, 1), (13, 7), (1, 9), (17, 1), (8, 8), (61, 67)] {
        let setup = Setup::new(width, height);
        let got = render(&gpu, matt_room().scene(), &camera, &rig(vec![Light::point("l", light)]), &setup, Layers::All);
        assert_eq!(got.len() as u32, width * height);
        for ((pixel, got), wall) in each_pixel(&setup).zip(got).zip(room_walls(&camera, &setup, 1.0)) {
            // On a seam nobody knows which wall is seen, but one of them is.
            assert!(got[0] > 0.0, "{width}x{height}, pixel {pixel:?} is black");
            let Some((at, normal)) = wall else { continue };
            // A point moved by 3e-7 m, half a metre from the light.
            let want = lambert_radiance(point_irradiance(light, at, normal));
            assert_pixel(got, want, 3.0 * FLOAT, format!("{width}x{height}, pixel {pixel:?} at {at}"));
        }
    }
}

#[test]
fn light_a_micrometre_off_a_wall() {
    let gpu = gpu();
    let eye = DVec3::new(-0.6, 0.1, 0.3);
    let (camera, setup) =
        (look(eye, DVec3::new(1.0, -0.3, -0.2), DVec3::Y, Projection::Perspective { yfov: 2.6 }), Setup::new(64, 64));
    let walls = room_walls(&camera, &setup, 1.0);
    for off in [1e-6, -1e-6] {
        // Positions on the far side are rounded to 1.2e-7 m: they stay on their side of the wall.
        let light = DVec3::new(-1.0 + off, 0.1, 0.2);
        let got = render(&gpu, matt_room().scene(), &camera, &rig(vec![Light::point("l", light)]), &setup, Layers::All);
        let mut lit = 0;
        for (got, wall) in got.into_iter().zip(&walls) {
            assert!(got.iter().all(|x| x.is_finite() && *x >= 0.0), "{got:?}");
            let &Some((at, normal)) = wall else { continue };
            if off < 0.0 {
                assert_eq!(got, [0.0; 3], "light from behind the wall at {at}");
            } else if normal != DVec3::X {
                lit += 1;
                // Where the wall meets the next one the cosine is small too: errors are 3e-7 m off the light's wall.
                let tolerance = 3.0 * FLOAT + 3e-7 / (at - light).dot(DVec3::X).abs().max(1e-6);
                let want = lambert_radiance(point_irradiance(light, at, normal));
                assert_pixel(got, want, tolerance, format!("light on the wall, seen at {at}"));
            }
        }
        assert!(off < 0.0 || lit > 2000, "{lit} pixels of other walls");
    }
}

/// A little of everything: matt floor, glossy and half-mirror walls, a metal mirror, a floating sheet; three lights.
fn still_life(scale: f64, offset: DVec3) -> (Scene, Camera, Rig) {
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z) * scale + offset;
    let mut build = Build::default();
    let matt = build.material(lambert(ALBEDO));
    let glossy = build.material(Material {
        base_color: ALBEDO.extend(1.0),
        metallic: 0.3,
        roughness: 0.4,
        ..Default::default()
    });
    let half = build.material(mirror(ALBEDO, 0.25));
    let metal = build.material(mirror(Vec3::new(0.9, 0.8, 0.7), 1.0));
    let (x, y, z) = (DVec3::X * scale, DVec3::Y * scale, DVec3::Z * scale);
    build.quad(at(0.0, 0.0, 0.0), z, x, matt);
    build.quad(at(0.0, 1.0, -1.0), x, y, glossy);
    build.quad(at(-1.0, 1.0, 0.0), y, z, half);
    build.quad(at(0.41, 0.35, -0.32), 0.3 * x + 0.1 * z, 0.3 * y, metal);
    build.quad(at(-0.3, 0.6, 0.2), 0.2 * z, 0.2 * x + 0.1 * y, glossy);
    let camera = look(at(0.3, 1.2, 3.1), at(0.0, 0.6, 0.0), DVec3::Y, Projection::Perspective { yfov: 0.7 });
    let unit = |intensity: f64, light: Light| Light { intensity: intensity * scale * scale, ..light };
    let spot = Light {
        kind: LightKind::Spot,
        direction: DVec3::new(-0.4, -1.0, -0.3).normalize(),
        inner_angle: 0.2,
        outer_angle: 0.6,
        range: Some(6.0 * scale),
        ..Light::point("spot", at(0.9, 2.1, 0.8))
    };
    let sun = Light {
        kind: LightKind::Directional,
        direction: DVec3::new(0.3, -0.9, -0.5).normalize(),
        ..Light::point("sun", DVec3::ZERO)
    };
    let lights = vec![unit(4.0, Light::point("point", at(-0.7, 1.7, 1.3))), unit(9.0, spot), sun];
    (build.scene(), camera, rig(lights))
}

/// Largest difference of a channel over the mean of `b`, and how many pixels differ by more than a thousandth of it.
fn differences(a: &[[f32; 3]], b: &[[f32; 3]]) -> (f64, usize) {
    assert_eq!(a.len(), b.len());
    let mean = b.iter().flatten().map(|&x| f64::from(x)).sum::<f64>() / (3 * b.len()) as f64;
    let error = |(a, b): (&[f32; 3], &[f32; 3])| largest([0, 1, 2].map(|c| f64::from((a[c] - b[c]).abs()))) / mean;
    let errors: Vec<f64> = a.iter().zip(b).map(error).collect();
    (largest(errors.iter().copied()), errors.iter().filter(|&&e| e > 1e-3).count())
}

#[test]
fn scale_and_place_do_not_matter() {
    let gpu = gpu();
    let setup = Setup::new(120, 80);
    let picture = |scale: f64, offset: DVec3| {
        let (scene, camera, rig) = still_life(scale, offset);
        render(&gpu, scene, &camera, &rig, &setup, Layers::All)
    };
    let here = picture(1.0, DVec3::ZERO);
    assert!(here.iter().filter(|p| p[0] > 0.0).count() > 5000, "most pixels are lit");
    for (scale, offset) in
        [(1e-3, DVec3::ZERO), (1e3, DVec3::ZERO), (1.0, DVec3::new(1e7, -2e6, 3e6)), (1e-3, DVec3::splat(100.0))]
    {
        let (largest, differing) = differences(&picture(scale, offset), &here);
        assert!(differing == 0, "scale {scale}, offset {offset}: {differing} pixels differ, by up to {largest:.1e}");
    }
}

#[test]
fn perspective_and_orthographic_agree_far_away() {
    let gpu = gpu();
    let (scene, _, lights) = still_life(1.0, DVec3::ZERO);
    let (scene_again, _, _) = still_life(1.0, DVec3::ZERO);
    let setup = Setup::new(60, 40);
    let direction = DVec3::new(0.1, 0.4, 1.0).normalize();
    let target = DVec3::new(0.0, 0.6, 0.0);
    let distance: f64 = 1e6;
    let far = look(
        target + distance * direction,
        target,
        DVec3::Y,
        Projection::Perspective { yfov: 2.0 * (1.2 / distance).atan() },
    );
    let flat = look(target + 10.0 * direction, target, DVec3::Y, Projection::Orthographic { ymag: 1.2 });
    let a = render(&gpu, scene, &far, &lights, &setup, Layers::All);
    let b = render(&gpu, scene_again, &flat, &lights, &setup, Layers::All);
    // The rays differ by up to 2e-6 m on their way through the scene: a pixel on an edge may fall to the other side.
    let (_, differing) = differences(&a, &b);
    assert!(differing <= 2, "{differing} of {} pixels differ", a.len());
}

fn relit(relighter: &mut Relighter) -> Vec<[f32; 3]> {
    relighter.linear(Picture::Whole).unwrap().to_vec()
}

#[test]
fn no_light_is_black_but_for_emitters() {
    let gpu = gpu();
    let setup = Setup::new(13, 7);
    let (scene, camera, _) = still_life(1.0, DVec3::ZERO);
    let got = render(&gpu, scene, &camera, &rig(Vec::new()), &setup, Layers::All);
    assert!(got.iter().all(|&p| p == [0.0; 3]), "black without lights");

    let build = floor(stage::emitter(Vec3::new(3.0, 2.0, 1.0)));
    let got = render(&gpu, build.scene(), &overhead(1.0, 0.5), &rig(Vec::new()), &setup, Layers::All);
    assert!(got.iter().all(|&p| p == [3.0, 2.0, 1.0]), "emitters as seen");
}

#[test]
fn groups_and_switches() {
    let gpu = gpu();
    let setup = Setup::new(13, 7);
    let (scene, camera, mut all) = still_life(1.0, DVec3::ZERO);
    all.groups = vec![LightGroup::new("g")];
    let stage = stage::Stage::new(scene, &camera, &all, &setup);
    let mut relighter = stage.relighter(&gpu, &all, &setup);
    let whole = relit(&mut relighter);
    let parts: Vec<Vec<[f32; 3]>> = (0..3).map(|i| relighter.linear(Picture::Light(i)).unwrap().to_vec()).collect();

    all.lights.iter_mut().for_each(|light| light.group = Some(0));
    all.groups[0].enabled = false;
    relighter.set_rig(&all).unwrap();
    assert!(relit(&mut relighter).iter().all(|&p| p == [0.0; 3]), "all lights are in a group that is off");
    assert!(relighter.linear(Picture::Light(1)).unwrap().iter().all(|&p| p == [0.0; 3]));

    all.groups[0] =
        LightGroup { name: "g".into(), stops: 1.0, color: Vec3::new(1.0, 0.5, 0.0), enabled: true, solo: false };
    relighter.set_rig(&all).unwrap();
    for (got, plain) in relit(&mut relighter).iter().zip(&whole) {
        // Twice, halved red-green-blue: exact but for the order of sums.
        let want = DVec3::new(2.0, 1.0, 0.0) * DVec3::from(plain.map(f64::from));
        let error = (DVec3::from(got.map(f64::from)) - want).abs();
        assert!(error.cmple(1e-6 * want).all(), "group: {got:?}, not {want}");
    }

    all.groups[0] = LightGroup::new("g");
    all.lights[0].enabled = false;
    all.lights[2].enabled = false;
    relighter.set_rig(&all).unwrap();
    assert_eq!(relit(&mut relighter), parts[1], "one light left");
}

/// A coarse ball with smooth normals, seen from outside; its triangles are a tenth of its radius from the sphere.
fn coarse_ball(material: Material) -> Scene {
    let mut scene = stage::ball(3, material);
    let mesh = &mut scene.mesh;
    mesh.normals = mesh.positions.iter().map(|p| p.normalize()).collect();
    mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    scene
}

/// A mesh that shadows itself is black where its smooth normals face the light, triangle by triangle [Hanika 2021].
#[test]
fn coarse_balls_are_lit_up_to_their_terminator() {
    let gpu = gpu();
    let setup = Setup::new(64, 64);
    let camera = look(3.0 * DVec3::Z, DVec3::ZERO, DVec3::Y, Projection::Orthographic { ymag: 1.0 });
    for (name, direction) in [("side", DVec3::NEG_X), ("above", DVec3::new(-0.5, -1.0, 0.1).normalize())] {
        let all = rig(vec![Light { kind: LightKind::Directional, direction, ..Light::point("sun", DVec3::ZERO) }]);
        let got = render(&gpu, coarse_ball(lambert(ALBEDO)), &camera, &all, &setup, Layers::All);
        for (i, (x, y)) in each_pixel(&setup).enumerate() {
            let at = seen(&camera, &setup, (x, y), DVec3::ZERO, DVec3::Z);
            // Within all triangles, whose edges cut into the disc.
            if at.length() > 0.85 {
                continue;
            }
            let normal = DVec3::new(at.x, at.y, (1.0 - at.length_squared()).sqrt());
            let want = lambert_radiance(-normal.dot(direction));
            // Interpolated normals are off by some degrees.
            if want.y > 0.1 * f64::from(ALBEDO.y) / PI {
                assert_pixel(got[i], want, 0.25, format!("pixel ({x}, {y}), light from the {name}"));
            }
        }
    }
}

/// All of a white mirror shows the room around it, also where interpolated normals face away from the eye or would send
/// its ray into the mirror.
#[test]
fn silhouettes_of_coarse_mirror_balls_are_not_black() {
    let gpu = gpu();
    let setup = Setup::new(64, 64);
    let mut scene = coarse_ball(mirror(Vec3::ONE, 1.0));
    let mut walls = Build::default();
    let material = walls.material(emitter(Vec3::ONE));
    let walls = walls.room(DVec3::ZERO, 4.0, material).scene();
    let first = scene.mesh.positions.len() as u32;
    // Both lie around the origin; the ball is one unit of its own space wide.
    let unit = scene.space.unit;
    scene.mesh.positions.extend(walls.mesh.positions.iter().map(|p| *p * (walls.space.unit / unit) as f32));
    scene.mesh.normals.extend(&walls.mesh.normals);
    scene.mesh.triangles.extend(walls.mesh.triangles.iter().map(|t| t.map(|v| v + first)));
    scene.mesh.triangle_materials.extend(walls.mesh.triangles.iter().map(|_| 1));
    scene.materials.extend(walls.materials);
    let camera = look(3.0 * DVec3::Z, DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.8 });
    let got = render(&gpu, scene, &camera, &rig(Vec::new()), &setup, Layers::All);
    for (i, pixel) in got.into_iter().enumerate() {
        assert_pixel(pixel, DVec3::ONE, 1e-5, format!("pixel {i}"));
    }
}
