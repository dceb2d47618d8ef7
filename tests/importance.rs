//! Where gather samples are needed: what paths from the eye find.

mod common;

use common::stage::{Build, Setup, Stage, lambert, look, mirror, rig};
use common::{assert_near, transfer};
use glam::{DVec3, Vec2, Vec3};
use relume::bake::brdf_factors::harmonics::MAX_FUNCTIONS;
use relume::bake::gather_samples::{GatherSamples, Patch, Placement};
use relume::bake::transport::direct;
use relume::bake::transport::importance::Importance;
use relume::bake::transport::{LightTransport, TransferSettings};
use relume::scene::{Light, Material, Projection};

/// What a camera sees.
fn stage(build: &Build, from: DVec3, to: DVec3) -> Stage {
    let camera = look(from, to, DVec3::Y, Projection::Perspective { yfov: 1.0 });
    Stage::new(build.scene(), &camera, &rig(Vec::new()), &Setup::new(64, 64))
}

fn importance(stage: &Stage) -> Importance {
    Importance::new(&stage.scene, &stage.framebuffer, 4, 16_384, 1)
}

/// Square metres.
fn area(stage: &Stage, samples: &GatherSamples) -> f64 {
    samples.area() * stage.scene.space.unit.powi(2)
}

fn samples(stage: &Stage, importance: &Importance) -> GatherSamples {
    let clustered = Placement::Clustered { points: 4 };
    GatherSamples::place(&stage.scene, &importance.surfaces, clustered, 2000, 1)
}

/// Two closed rooms, the eye in one.
fn two_rooms() -> Stage {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::splat(0.7)));
    build.room(DVec3::ZERO, 1.0, white).room(DVec3::X * 5.0, 1.0, white);
    stage(&build, DVec3::new(0.2, 0.1, -0.9), DVec3::ZERO)
}

/// The other room gets nothing, and this one's area is all there.
#[test]
fn what_no_light_comes_from_gets_no_samples() {
    let stage = two_rooms();
    let importance = importance(&stage);
    assert_near(importance.unseen, 0.5, 1e-9, "unseen");
    let samples = samples(&stage, &importance);
    assert_near(area(&stage, &samples), 24.0, 1e-4, "area");
    assert!(samples.samples.iter().all(|s| stage.scene.space.to_world(s.position).x < 1.1));
}

/// Where no samples lie rays of a light bring nothing to those that lie elsewhere.
#[test]
fn light_where_nobody_looks_is_lost() {
    let stage = two_rooms();
    let transfer = LightTransport::new(&stage.scene, &stage.framebuffer, &transfer::settings(2000, 100, 16), &|_| ());
    let received = |x: f64| {
        let light = Light::point("near the floor", DVec3::new(x, -0.98, 0.1)).pack(stage.scene.space);
        direct::shade(&stage.scene, &transfer.fine, &light).iter().map(|c| c.length()).sum::<f64>()
    };
    assert!(received(0.0) > 0.0);
    assert_eq!(received(5.0), 0.0);
}

/// Through a mirror, and round a corner that only light gets around, surfaces are seen.
#[test]
fn mirrors_and_bounces_lead_to_surfaces() {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::splat(0.7)));
    let silver = build.material(mirror(Vec3::ONE, 1.0));
    build.quad(DVec3::Z, DVec3::Y, DVec3::X, silver); // faces the eye, and what lies behind that
    build.quad(DVec3::Z * -5.0, DVec3::X, DVec3::Y, white);
    build.quad(DVec3::new(9.0, 0.0, -2.0), DVec3::Z, DVec3::Y, white); // sees the other, no mirror
    let stage = stage(&build, DVec3::ZERO, DVec3::Z);
    let importance = importance(&stage);
    assert_near(importance.unseen, 0.0, 0.0, "unseen");
    assert_near(area(&stage, &samples(&stage, &importance)), 8.0, 1e-4, "area without the mirror");
}

/// A box of a metre on open ground of a hectare, seen from near: even samples would be ten within four metres.
#[test]
fn samples_gather_where_the_picture_needs_them() {
    let mut build = Build::default();
    let white = build.material(lambert(Vec3::splat(0.7)));
    build.quad(DVec3::ZERO, DVec3::Z * 50.0, DVec3::X * 50.0, white);
    for (axis, sign) in [(DVec3::X, 1.0), (DVec3::X, -1.0), (DVec3::Z, 1.0), (DVec3::Z, -1.0), (DVec3::Y, 1.0)] {
        let (u, v) = (0.5 * DVec3::new(axis.y, axis.z, axis.x), 0.5 * sign * DVec3::new(axis.z, axis.x, axis.y));
        build.quad(DVec3::Y * 0.5 + axis * (0.5 * sign), v, u, white);
    }
    let stage = stage(&build, DVec3::new(2.0, 1.5, 3.0), DVec3::Y * 0.5);
    let importance = importance(&stage);
    let samples = samples(&stage, &importance);
    let near = |s: &Vec3| stage.scene.space.to_world(*s).length() < 4.0;
    let count = samples.samples.iter().filter(|s| near(&s.position)).count();
    assert!(count > 150, "{count} of {} samples lie within 4 m of the box", samples.len());
    // The back of the box and the ground behind it count as well: light from there reaches what is seen.
    assert!(importance.unseen < 0.2, "{} unseen", importance.unseen);
    let ground = samples.samples.iter().filter(|s| s.normal.y > 0.9).map(|s| s.area).sum::<f32>();
    let ground = f64::from(ground) * stage.scene.space.unit.powi(2);
    assert_near(ground, 1e4 * (1.0 - importance.unseen), 0.05, "area of the ground");
}

/// Of two metals as rough the floor gets many functions, a trinket fewer.
#[test]
fn materials_that_hardly_count_get_fewer_functions() {
    let mut build = Build::default();
    let metal = |roughness: f32| Material { roughness, ..mirror(Vec3::splat(0.9), 1.0) };
    let (floor, trinket) = (build.material(metal(0.5)), build.material(metal(0.5)));
    let white = build.material(lambert(Vec3::splat(0.7)));
    build.room(DVec3::ZERO, 1.0, white);
    build.quad(DVec3::Y * -0.99, DVec3::Z, DVec3::X, floor);
    build.quad(DVec3::new(0.85, -0.95, 0.85), DVec3::Z * 0.1, DVec3::X * 0.1, trinket);
    let stage = stage(&build, DVec3::new(0.0, 0.2, -0.9), DVec3::ZERO);
    let settings = TransferSettings { layers: 1, ..transfer::settings(2000, 100, 16) };
    let transfer = LightTransport::new(&stage.scene, &stage.framebuffer, &settings, &|_| ());
    let level = &transfer.fine;
    let functions = |material: usize| {
        let of = |i: &usize| level.samples.samples[*i].material as usize == material;
        (0..level.samples.len()).filter(of).map(|i| level.coefficients(i).len()).max().unwrap()
    };
    assert!(functions(floor) > functions(trinket), "{} and {}", functions(floor), functions(trinket));
    assert!(functions(floor) <= MAX_FUNCTIONS && functions(white) == 1);
}

/// Quarters of quarters around a point: each is a part of the one before, and points of one quarter have it in common.
#[test]
fn patches_lie_within_patches() {
    let deepest = |u: f32, v: f32| Patch::around(6, Vec2::new(u, v), Patch::DEEPEST).part;
    for (u, v) in [(0.1, 0.1), (0.7, 0.2), (0.2, 0.7), (0.3, 0.4), (0.5, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0)] {
        for depth in 0..=Patch::DEEPEST {
            let patch = Patch::around(6, Vec2::new(u, v), depth);
            assert_eq!((patch.side, patch.part), (6, deepest(u, v) >> (2 * (Patch::DEEPEST - depth))));
        }
    }
    let quarter = |u: f32, v: f32| Patch::around(6, Vec2::new(u, v), 1).part;
    assert_eq!([quarter(0.2, 0.2), quarter(0.7, 0.2), quarter(0.2, 0.7), quarter(0.4, 0.4)], [4, 5, 6, 7]);
}
