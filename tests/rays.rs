//! Rays against brute force in double precision: none slips through, whatever the ray's direction.

mod common;

use common::assert_near;
use common::random::Random;
use common::stage::{Build, lambert};
use glam::{DVec3, Vec3};
use relume::bake::{BakeSettings, bake};
use relume::scene::{Light, LightKind, Scene};
use relume::trace::bvh::TracedScene;
use relume::trace::packet::common_origin::{CommonOriginPacket, trace_common_origin};
use relume::trace::packet::{PACKET_SIZE, trace_packets};

/// Triangles all over a ball, some long and thin, some flat along an axis.
fn shards(random: &mut Random, count: usize) -> Scene {
    let mut build = Build::default();
    let material = build.material(lambert(Vec3::ONE));
    for _ in 0..count {
        let center = random.vector(-1.0, 1.0);
        let u = random.direction() * random.magnitude(0.01, 0.5);
        let v = match random.below(3) {
            0 => u.cross(random.pick(&[DVec3::X, DVec3::Y, DVec3::Z])) * 0.1,
            _ => u.cross(random.direction()) * 0.5,
        };
        let axis = random.pick(&[DVec3::X, DVec3::Y, DVec3::Z]);
        let flatten = random.below(2) == 0;
        let [u, v] = [u, v].map(|e| if flatten { e - axis * e.dot(axis) } else { e });
        if u.cross(v).length() > 1e-6 {
            build.quad(center, u, v, material);
        }
    }
    build.scene()
}

/// Distance along the ray to each triangle, and how far inside of it the ray passes, as a share of its size.
fn all_hits(scene: &Scene, origin: Vec3, direction: Vec3) -> Vec<(f64, f64)> {
    let (origin, direction) = (origin.as_dvec3(), direction.as_dvec3());
    let hit = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|i| scene.mesh.positions[i as usize].as_dvec3());
        let normal = (b - a).cross(c - a);
        let along = normal.dot(direction);
        let distance = normal.dot(a - origin) / along;
        let p = origin + distance * direction;
        let weights = [(b, c), (c, a), (a, b)].map(|(s, e)| (e - s).cross(p - s).dot(normal) / normal.length_squared());
        let inside = weights.into_iter().fold(f64::INFINITY, f64::min);
        (along != 0.0 && distance.is_finite()).then_some((distance, inside))
    };
    scene.mesh.triangles.iter().filter_map(hit).collect()
}

/// Directions that make trouble: along axes with either sign of zero, nearly so, short, long.
fn direction(random: &mut Random) -> Vec3 {
    let zero = random.pick(&[0.0, -0.0, 1e-9, -1e-9, 1e-20]);
    let sign = random.pick(&[1.0, -1.0]);
    let along = [Vec3::new(sign, zero, -zero), Vec3::new(zero, sign, zero), Vec3::new(-zero, zero, sign)];
    let anywhere = random.direction().as_vec3();
    match random.below(4) {
        0 => random.pick(&along),
        1 => Vec3::new(anywhere.x, zero, anywhere.z),
        2 => anywhere * random.magnitude(1e-6, 1e6) as f32,
        _ => anywhere,
    }
}

#[test]
fn closest_hits_are_those_of_brute_force() {
    let mut random = Random::new(11);
    for _ in 0..4 {
        let scene = TracedScene::new(shards(&mut random, 500));
        let mut hits = 0;
        for _ in 0..4000 {
            let direction = direction(&mut random);
            let length = f64::from(direction.length());
            let origin = random.vector(-0.5, 0.5).as_vec3();
            let got = scene.closest_hit(origin, direction, f32::INFINITY);
            let all = all_hits(&scene, origin, direction);
            // Within this of an edge or of the origin, float32 may decide either way.
            let unsure = 1e-4;
            let closest = |margin: f64, near: f64| {
                let ahead = all.iter().filter(|(d, inside)| d * length > near && *inside > margin);
                ahead.map(|hit| hit.0).fold(f64::INFINITY, f64::min)
            };
            let (sure, possible) = (closest(unsure, 1e-5), closest(-unsure, -1e-5));
            match got {
                None => assert_eq!(sure, f64::INFINITY, "missed, {origin} along {direction:?}"),
                Some(hit) => {
                    hits += 1;
                    let distance = f64::from(hit.distance);
                    let slack = 1e-5 * (distance + 1.0 / length);
                    let fits = distance <= sure + slack && distance >= possible - slack;
                    assert!(fits, "{distance}, not {possible} .. {sure}, {origin} along {direction:?}");
                    let p = |i: usize| scene.mesh.positions[scene.mesh.triangles[hit.triangle as usize][i] as usize];
                    let (u, v) = (hit.barycentric.x, hit.barycentric.y);
                    let point = p(0) * (1.0 - u - v) + p(1) * u + p(2) * v;
                    let off = (point - (origin + direction * hit.distance)).length();
                    assert!(f64::from(off) < 1e-4, "barycentric point is {off} m off");
                }
            }
            let any = scene.occluded(origin, direction, f32::INFINITY);
            assert_eq!(any, got.is_some(), "occluded agrees with closest_hit");
            if let Some(hit) = got {
                let before = scene.occluded(origin, direction, hit.distance * 0.999);
                let behind = scene.occluded(origin, direction, hit.distance * 1.001);
                assert!(!before && behind, "occluded at {}, limits 0.999 and 1.001 of it", hit.distance);
            }
        }
        assert!(hits > 1000, "{hits} hits");
    }
}

/// Rays from one point, 64 at a time, meet what single rays meet, or something as near; lanes without a ray meet
/// nothing.
#[test]
fn fans_are_single_rays() {
    let mut random = Random::new(17);
    for _ in 0..4 {
        let scene = TracedScene::new(shards(&mut random, 500));
        let (mut hits, mut differences) = (0, 0);
        for _ in 0..100 {
            let origin = random.vector(-0.5, 0.5).as_vec3();
            let mut packets = [CommonOriginPacket::default(), CommonOriginPacket::default()];
            let directions: Vec<Vec3> = (0..PACKET_SIZE + 40).map(|_| direction(&mut random)).collect();
            for (i, direction) in directions.iter().enumerate() {
                packets[i / PACKET_SIZE].set(i % PACKET_SIZE, *direction);
            }
            trace_common_origin(&scene, origin, &mut packets);
            assert!((40..PACKET_SIZE).all(|lane| packets[1].hit(lane).is_none()), "an empty lane hit something");
            for (i, direction) in directions.into_iter().enumerate() {
                let single = scene.closest_hit(origin, direction, f32::INFINITY);
                let Some((hit, behind)) = packets[i / PACKET_SIZE].hit(i % PACKET_SIZE) else {
                    differences += u32::from(single.is_some());
                    continue;
                };
                hits += 1;
                let near = |other: f32| (hit.distance - other).abs() * direction.length() < 1e-4;
                differences += u32::from(single.is_none_or(|single| !near(single.distance)));
                let [a, b, c] =
                    scene.mesh.triangles[hit.triangle as usize].map(|v| scene.mesh.positions[v as usize].as_dvec3());
                let along = (b - a).cross(c - a).normalize().dot(direction.as_dvec3().normalize());
                assert!(behind == (along > 0.0) || along.abs() < 1e-5, "behind {behind}, {along}");
                let (u, v) = (f64::from(hit.barycentric.x), f64::from(hit.barycentric.y));
                let met = origin.as_dvec3() + direction.as_dvec3() * f64::from(hit.distance);
                let off = met.distance(a * (1.0 - u - v) + b * u + c * v);
                assert!(off < 1e-4, "barycentric point is {off} m off");
            }
        }
        // At edges, which both may decide either way.
        assert!(hits > 1000 && differences < 3, "{differences} of {hits} differ");
    }
}

/// A room of 6 x 8 x 8 quads: from inside, every ray hits, along seams too, and straight through corners where
/// coordinates are round. Where they are not, some rays of ten thousand that aim at a corner itself pass between its
/// triangles.
#[test]
fn no_ray_leaves_a_closed_room() {
    let mut random = Random::new(12);
    for round in [true, false] {
        let mut build = Build::default();
        let material = build.material(lambert(Vec3::ONE));
        let cells = 8;
        let side = 1.0 / f64::from(cells);
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let (u, v) = (DVec3::new(axis.y, axis.z, axis.x), DVec3::new(axis.z, axis.x, axis.y));
            for (i, j) in (0..cells).flat_map(|i| (0..cells).map(move |j| (i, j))) {
                let at = |k: i32| f64::from(2 * k + 1) * side - 1.0;
                for sign in [-1.0, 1.0] {
                    let center = axis * sign + u * at(i) + v * at(j);
                    build.quad(center, u * side, v * side, material);
                }
            }
        }
        let mut scene = build.scene();
        if round {
            let unit = scene.space.unit as f32;
            scene.mesh.positions.iter_mut().for_each(|p| *p = (*p * unit * 8.0).round() / 16.0);
        }
        let scene = TracedScene::new(scene);
        let corners = &scene.mesh.positions;
        let mut escaped = Vec::new();
        let mut cast = 0;
        for _ in 0..300 {
            let inside = random.vector(-0.5, 0.5);
            // Somewhere, at the centre, above an edge of cells, on a diagonal.
            let origin = random.pick(&[inside, DVec3::ZERO, DVec3::new(0.125, 0.25, 0.05), DVec3::splat(0.3)]);
            let origin = origin.as_vec3();
            let mut packets = [CommonOriginPacket::default(), CommonOriginPacket::default()];
            for lane in 0..100 {
                let [a, b] = [0; 2].map(|_| corners[random.below(corners.len())]);
                let edge = random.below(corners.len() / 4) * 4;
                let along = corners[edge].lerp(corners[edge + 1], random.unit() as f32);
                let target = random.pick(&if round { [a, b, (a + b) / 2.0, along] } else { [along; 4] });
                let direction = if target == origin { Vec3::X } else { target - origin };
                let sign = random.pick(&[1.0, -1.0]);
                let parallel = random.pick(&[Vec3::X, Vec3::Y, Vec3::Z]) * sign;
                let direction = random.pick(&[direction, direction, direction.normalize(), parallel]);
                cast += 1;
                packets[lane / PACKET_SIZE].set(lane % PACKET_SIZE, direction);
                if scene.closest_hit(origin, direction, f32::INFINITY).is_none() {
                    escaped.push((origin, direction));
                }
                if !scene.occluded(origin, direction, f32::INFINITY) {
                    escaped.push((origin, direction));
                }
            }
            trace_common_origin(&scene, origin, &mut packets);
            for (packet, lane) in (0..100).map(|lane| (&packets[lane / PACKET_SIZE], lane % PACKET_SIZE)) {
                if packet.hit(lane).is_none() {
                    escaped.push((origin, packet.direction(lane)));
                }
            }
        }
        let first = escaped.first();
        assert!(escaped.is_empty(), "{} of {cast} rays left the room: {first:?}", escaped.len());
    }
}

#[test]
fn radius_is_half_the_diagonal() {
    let mut build = Build::default();
    let material = build.material(lambert(Vec3::ONE));
    build.room(DVec3::splat(7.0), 2.0, material);
    let scene = TracedScene::new(build.scene());
    assert_near(scene.bvh.radius.into(), 1.0, 1e-6, "radius");
}

/// A point light as far as a star casts the shadows of the sun in that direction, contact shadows too.
#[test]
fn far_point_lights_shadow_like_the_sun() {
    let scene = TracedScene::new(Scene::load(&common::shipped("balls-2.glb")).unwrap());
    let settings = BakeSettings { width: 120, height: 80, layers: 1, samples: 1 };
    let framebuffer = bake(&scene, &scene.cameras[0], &scene.rig, &settings, &|_| ());
    let direction = DVec3::new(-0.4, -0.8, -0.3).normalize();
    let sun = Light { kind: LightKind::Directional, direction, ..Light::point("sun", DVec3::ZERO) };
    let seen = |light: &Light| {
        let mut visibility = vec![0; framebuffer.packets.len() * PACKET_SIZE];
        trace_packets(&scene, &light.pack(scene.space), &framebuffer.packets, &mut visibility);
        visibility
    };
    let want = seen(&sun);
    let lit = want.iter().filter(|v| **v > 0).count();
    assert!(lit > 1000 && lit < 8600, "{lit} of 9,600 samples are lit: the test shows no shadows");
    // At a distance d parallax moves shadows by size²/d: from 1e5 m on by less than these pixels tell.
    for distance in [1e5, 1e7, 1e9] {
        let star = Light::point("star", scene.space.origin - direction * distance);
        let differing = seen(&star).iter().zip(&want).filter(|(a, b)| a != b).count();
        assert!(differing <= 5, "{differing} samples differ at {distance} m");
    }
}
