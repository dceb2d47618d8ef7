//! Indirect light of a furnished room: how much of it there is, against the path tracer.

mod common;

use std::path::PathBuf;

use common::{drawn, shared, transfer};
use glam::{DVec3, Vec3};
use relume::bake::bvh::Bvh;
use relume::bake::transfer::rows::Lobe;
use relume::bake::transfer::{Outgoing, Transfer, TransferSettings};
use relume::bake::{BakeSettings, bake};
use relume::image::exr;
use relume::reference::gather;
use relume::reference::path_tracer::{Half, Layer, PathTracer, Settings};
use relume::scene::{Material, Scene};

const SIZE: [u32; 2] = [96, 64];

/// What is taken away from a scene's materials.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
enum Left {
    All,
    NoNormalMaps,
    NoRoughnessMaps,
    NoColorMaps,
    Lambert,
    SingleSided,
}

fn change(m: &mut Material, left: Left) {
    if left >= Left::NoNormalMaps {
        m.normal_texture = None;
    }
    if left >= Left::NoRoughnessMaps {
        m.metallic_roughness_texture = None;
    }
    if left >= Left::NoColorMaps {
        m.base_color_texture = None;
        m.base_color = m.base_color.min(Vec3::splat(0.8).extend(1.0));
    }
    if left >= Left::Lambert {
        (m.metallic, m.specular, m.roughness) = (0.0, 0.0, 1.0);
    }
    if left >= Left::SingleSided {
        m.double_sided = false;
    }
    m.emissive = Vec3::ZERO;
}

/// Mean of the first bounce over all pixels, by the path tracer; traced once, then read.
fn truth(scene: &Scene, bvh: &Bvh, name: &str, samples: u32, bounces: Option<u32>) -> DVec3 {
    let file = format!("room {name} {samples} {bounces:?}.exr").replace(' ', "-");
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("truth").join(file);
    if !path.exists() {
        let settings = Settings { max_bounces: bounces, ..drawn::tracing(SIZE[0], SIZE[1]) };
        let tracer = PathTracer::new(scene, bvh, &scene.cameras[0], &scene.rig, &settings);
        let film = tracer.trace(samples, &|| false, &|_| ());
        std::fs::create_dir_all(path.parent().expect("it is in a folder")).unwrap();
        exr::write(&path, &film.image(Half::Both, &[Layer::Indirect])).unwrap();
    }
    let image = exr::read(&path).unwrap();
    let pixels = &image.layer("indirect").unwrap().pixels;
    pixels.iter().map(|&p| Vec3::from(p).as_dvec3()).sum::<DVec3>() / pixels.len() as f64
}

/// The same by our operator.
fn ours(scene: &Scene, bvh: &Bvh, settings: &TransferSettings) -> DVec3 {
    let [width, height] = SIZE;
    let bake_settings = BakeSettings { width, height, layers: 4, samples: 1 };
    let baked = bake(scene, bvh, &scene.cameras[0], &scene.rig, &bake_settings, &|_| ());
    let transfer = Transfer::new(scene, bvh, &baked, settings, &|_| ());
    let mut direct = vec![DVec3::ZERO; transfer.fine.coefficient_count()];
    for light in &scene.rig.lights {
        let unit = gather::shade(scene, bvh, &transfer.fine, &light.pack(scene.space));
        direct.iter_mut().zip(unit).for_each(|(sum, x)| *sum += light.scale().as_dvec3() * x);
    }
    let all: Vec<u32> = (0..baked.samples.len() as u32).collect();
    let image = transfer.apply(&[direct], &all, Lobe::All, &|_| ()).remove(0);
    let mut sum = DVec3::ZERO;
    for (i, radiance) in image.into_iter().enumerate() {
        let weight = i.checked_sub(baked.pixel_stride()).map_or(Vec3::ONE, |extra| baked.extra_samples[extra].weight);
        sum += weight.as_dvec3() * radiance;
    }
    sum / f64::from(width * height)
}

#[test]
fn first_bounce_of_a_furnished_room() {
    let Some(path) = shared("scenes/rooms/living-room.glb") else { return };
    let spp: u32 = std::env::var("SPP").map_or(128, |s| s.parse().unwrap());
    let samples: usize = std::env::var("N").map_or(2048, |s| s.parse().unwrap());
    let only: Option<String> = std::env::var("ONLY").ok();
    for (name, left) in [
        ("as it is", Left::All),
        ("no normal maps", Left::NoNormalMaps),
        ("no roughness maps", Left::NoRoughnessMaps),
        ("no colour maps", Left::NoColorMaps),
        ("Lambert", Left::Lambert),
        ("single-sided", Left::SingleSided),
    ] {
        if only.as_ref().is_some_and(|o| !name.contains(o)) {
            continue;
        }
        let mut scene = Scene::load(&path).unwrap();
        scene.materials.iter_mut().for_each(|m| change(m, left));
        let bvh = Bvh::build(&scene);
        let start = std::time::Instant::now();
        let bounces = if std::env::var_os("ALL").is_some() { None } else { Some(1) };
        let want = truth(&scene, &bvh, name, spp, bounces);
        let traced = start.elapsed().as_secs_f64();
        let settings = TransferSettings {
            outgoing: Outgoing::Glossy { functions: None },
            bounces,
            points: (65536 / samples).clamp(1, 16),
            ..transfer::settings(samples, if bounces.is_some() { 64 } else { samples / 4 }, 1024)
        };
        if std::env::var_os("WHERE").is_some() {
            where_lost(&scene, &bvh, &settings);
        }
        let got = ours(&scene, &bvh, &settings);
        println!(
            "{name}: {:.4}, {} want {want} ({traced:.0} s, {:.0} s)",
            got.element_sum() / want.element_sum(),
            got / want,
            start.elapsed().as_secs_f64() - traced
        );
    }
}

/// Where light is lost: what hits of first rays see, and what samples tell of it, by material and side.
fn where_lost(scene: &Scene, bvh: &Bvh, settings: &TransferSettings) {
    use relume::bake::bvh::Hit;
    use relume::bake::octahedral;
    use relume::bake::surface::SurfacePoint;
    use relume::brdf::{self, Lobes};
    use relume::sequence::Points;
    use std::collections::BTreeMap;
    let [width, height] = SIZE;
    let bake_settings = BakeSettings { width, height, layers: 4, samples: 1 };
    let baked = bake(scene, bvh, &scene.cameras[0], &scene.rig, &bake_settings, &|_| ());
    let transfer = Transfer::new(scene, bvh, &baked, settings, &|_| ());
    let mut direct = vec![DVec3::ZERO; transfer.fine.coefficient_count()];
    let lights: Vec<_> = scene.rig.lights.iter().map(|l| (l.pack(scene.space), l.scale().as_dvec3())).collect();
    for (light, scale) in &lights {
        let unit = gather::shade(scene, bvh, &transfer.fine, light);
        direct.iter_mut().zip(unit).for_each(|(sum, x)| *sum += *scale * x);
    }
    let paths = relume::bake::transfer::paths::Paths::new(scene, bvh, 4);
    let mut table: BTreeMap<(String, bool), [f64; 4]> = BTreeMap::new();
    for (i, view) in baked.samples.iter().enumerate() {
        if view.brdf == relume::shared::NO_BRDF {
            continue;
        }
        let weight = i.checked_sub(baked.pixel_stride()).map_or(1.0, |e| f64::from(baked.extra_samples[e].weight.y));
        let numbers = Points::new(77, i as u64);
        let b = &baked.brdfs[view.brdf as usize];
        let (n, wo) = (
            octahedral::decode(view.normal).as_dvec3().normalize(),
            octahedral::decode(view.wo).as_dvec3().normalize(),
        );
        let Some(lobes) = Lobes::new(b, n, wo) else { continue };
        for k in 0..64 {
            let [u, v, w, _] = numbers.at(k, 0);
            let Some(wi) = lobes.sample([u, v, w]) else { continue };
            let at = lobes.at(wi);
            let w = weight * at.sum().y / at.density;
            let random = |layer: u32| {
                let [u, v, w, _] = numbers.at(k, 1 + layer);
                [u, v, w]
            };
            paths.follow(view.position, baked.geometric_normals[i], wi.as_vec3(), random, |arrival| {
                let p = arrival.place;
                let hit = Hit { triangle: p.triangle, barycentric: p.barycentric, distance: arrival.distance };
                let s = SurfacePoint::new(scene, &hit, -arrival.wo, 0.0);
                let mut truth = 0.0;
                for (light, scale) in &lights {
                    let Some(incident) = relume::reference::light::incident(light, s.position.as_dvec3()) else {
                        continue;
                    };
                    let f = brdf::reflected(&s.brdf, s.normal.as_dvec3(), incident.wi, arrival.wo.as_dvec3());
                    if f.y <= 0.0 || incident.irradiance == 0.0 {
                        continue;
                    }
                    let to = light.position - s.position;
                    let d = to.length();
                    if bvh.occluded(scene, s.leave(to / d, bvh.shadow_offset(d)), to / d, d * 0.9999) {
                        continue;
                    }
                    truth += f.y * incident.irradiance * scale.y;
                }
                let mut read = 0.0;
                transfer.fine.read(&p, arrival.wo, |_, weight, first, values| {
                    for (c, v) in values.iter().enumerate() {
                        read += f64::from(weight * v) * direct[first as usize + c].y
                    }
                });
                let name = scene.materials[s.material as usize].name.clone();
                let entry = table.entry((name, p.back)).or_default();
                let w = w * f64::from(arrival.tint.y);
                entry[0] += w * truth;
                entry[1] += w * read;
                entry[2] += w;
                entry[3] += 1.0;
            });
        }
    }
    let all: f64 = table.values().map(|e| e[0]).sum();
    let mut sorted: Vec<_> = table.iter().collect();
    sorted.sort_by(|a, b| (b.1[1] - b.1[0]).abs().total_cmp(&(a.1[1] - a.1[0]).abs()));
    println!("   all {:.4}", table.values().map(|e| e[1]).sum::<f64>() / all);
    for ((name, back), e) in sorted.iter().take(14) {
        println!(
            "   {name} {}: {:.4} of it, ratio {:.3}, lost {:+.4}, hits {}",
            if *back { "back" } else { "front" },
            e[0] / all,
            e[1] / e[0],
            (e[1] - e[0]) / all,
            e[3]
        );
    }
}
