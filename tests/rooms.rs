//! Indirect light of a furnished room: how much of it there is, against the path tracer.

mod common;

use common::ratio::Lit;
use common::{shared, stage, transfer};
use glam::{DVec3, Vec3};
use relume::bake::gather_samples::Place;
use relume::bake::transport::paths::Paths;
use relume::bake::transport::{LightTransport, TransferSettings};
use relume::physics::brdf::{cosine_direction, reflected};
use relume::physics::light::incident;
use relume::physics::sequence::Points;
use relume::scene::{Light, LightKind, Material, Projection, Scene};
use relume::trace::bvh::TracedScene;
use relume::trace::packet::shadow_ray;

/// Takes something away from a material.
type Take = fn(&mut Material);

/// What is taken away, each with all before it.
const LESS: [(&str, Take); 6] = [
    ("as it is", |_| ()),
    ("no normal maps", |m| m.normal_texture = None),
    ("no roughness maps", |m| m.metallic_roughness_texture = None),
    ("no colour maps", |m| {
        m.base_color_texture = None;
        m.base_color = m.base_color.min(Vec3::splat(0.8).extend(1.0));
    }),
    ("Lambert", |m| (m.metallic, m.specular, m.roughness) = (0.0, 0.0, 1.0)),
    ("single-sided", |m| m.double_sided = false),
];

/// No light is lost among furniture, textures, gloss and double-sided faces: 17 % were, before samples lay where paths
/// came to. Lamps alone: the window's light is looked at elsewhere. Prints ratios, of the first bounce and of all.
#[test]
fn a_furnished_room_keeps_its_light() {
    let Some(path) = shared("scenes/rooms/living-room.glb") else { return };
    let full = std::env::var_os("RELUME_FULL").is_some();
    let spp = if full { 512 } else { 64 };
    for last in 0..LESS.len() {
        if !full && !["as it is", "Lambert"].contains(&LESS[last].0) {
            continue;
        }
        let mut scene = Scene::load(&path).unwrap();
        for material in &mut scene.materials {
            LESS[..=last].iter().for_each(|(_, take)| take(material));
            material.emissive = Vec3::ZERO;
        }
        scene.rig.lights.retain(|light| light.kind != LightKind::Emitter);
        let scene = TracedScene::new(scene);
        let lit = Lit { scene: &scene, camera: &scene.cameras[0], rig: &scene.rig, size: [96, 64] };
        for (bounces, samples) in [(Some(1), 2048), (Some(1), 8192), (None, 8192)] {
            if !full && samples != 2048 {
                continue;
            }
            let settings = TransferSettings {
                bounces,
                points: (65_536 / samples).min(16),
                ..transfer::settings(samples, 1024, 1024)
            };
            let ratio = lit.mean(&settings) / lit.traced_mean(bounces, spp);
            let mean = ratio.element_sum() / 3.0;
            println!("{}, {bounces:?} bounces, N = {samples}: {mean:.4} {ratio:.4}", LESS[last].0);
            // What is still lost, docs/accuracy.md: bounces among white walls multiply it.
            let bound = if bounces.is_some() { 0.03 } else { 0.05 };
            assert!((mean - 1.0).abs() < bound, "{}: {mean}", LESS[last].0);
        }
    }
}

/// What rays from the picture's surfaces read of one lamp's light after its first bounce, against what is there: tells
/// where light is lost, by the material that sends it and by the one that receives it. Prints the largest losses.
#[test]
fn first_bounces_are_read_as_they_are() {
    let Some(path) = shared("scenes/rooms/living-room.glb") else { return };
    let mut scene = Scene::load(&path).unwrap();
    scene.materials.iter_mut().for_each(|material| material.emissive = Vec3::ZERO);
    let scene = TracedScene::new(scene);
    // Not the file's own camera and lamps.
    let position = DVec3::new(1.9, 1.5, 2.3);
    let projection = Projection::Perspective { yfov: 0.96 };
    let camera = stage::look(position, DVec3::new(-1.2, 0.8, -1.2), DVec3::Y, projection);
    let lamp = Light { intensity: 30.0, ..Light::point("pendant", DVec3::new(0.2, 2.2, 0.3)) };
    let rig = stage::rig(vec![lamp]);
    let lit = Lit { scene: &scene, camera: &camera, rig: &rig, size: [96, 64] };
    let framebuffer = lit.bake();
    let settings = TransferSettings { points: 8, ..transfer::settings(8192, 512, 64) };
    let transfer = LightTransport::new(&scene, &framebuffer, &settings, &|_| ());
    let direct = lit.direct(&transfer);
    let packed = rig.lights[0].pack(scene.space);
    let intensity = rig.lights[0].scale().as_dvec3();

    let paths = Paths::new(&scene, 0);
    let material_of = |triangle: u32| scene.mesh.triangle_materials[triangle as usize] as usize;
    // Read and there, by material.
    let mut sums = [vec![[0.0; 2]; scene.materials.len()], vec![[0.0; 2]; scene.materials.len()]];
    for i in framebuffer.reflecting().into_iter().filter(|&i| (i as usize) < framebuffer.pixel_stride()) {
        let (position, normal) = (framebuffer.samples[i as usize].position, framebuffer.geometric_normals[i as usize]);
        let Some(seen) = scene.closest_hit(position + 1e-3 * normal, -normal, 1.0) else { continue };
        let numbers = Points::new(7, i.into());
        let (s, t) = normal.any_orthonormal_pair();
        for ray in 0..64 {
            let [u, v, ..] = numbers.at(ray, 0);
            let d = cosine_direction(u, v).as_vec3();
            let direction = (s * d.x + t * d.y + normal * d.z).normalize();
            let Some((hit, back)) = paths.first_hit(position, normal, direction) else { continue };
            let place = Place { triangle: hit.triangle, barycentric: hit.barycentric, back };
            let surface = place.surface(&scene, 0.0);
            let mut read = DVec3::ZERO;
            transfer.fine.read(&transfer.fine.cell(&place), -direction, |_, weight, first, values| {
                read += (values.iter().enumerate())
                    .map(|(k, value)| f64::from(weight * value) * direct[first as usize + k])
                    .sum::<DVec3>();
            });
            let is_lit = |wi: Vec3| {
                let ray = shadow_ray(&scene.bvh, &packed, surface.lifted(), surface.normal, surface.geometric_normal);
                wi.dot(surface.geometric_normal) > 0.0
                    && surface.normal.dot(-direction) > 0.0
                    && ray.is_some_and(|ray| !scene.occluded(ray.origin, ray.direction, ray.length))
            };
            let arriving = incident(&packed, surface.position.as_dvec3()).filter(|a| is_lit(a.wi.as_vec3()));
            let there = arriving.map_or(DVec3::ZERO, |a| {
                let (normal, wo) = (surface.normal.as_dvec3(), -direction.as_dvec3());
                intensity * a.irradiance * reflected(&surface.brdf, normal, a.wi, wo)
            });
            for (of, material) in sums.iter_mut().zip([material_of(hit.triangle), material_of(seen.triangle)]) {
                of[material][0] += read.element_sum();
                of[material][1] += there.element_sum();
            }
        }
    }
    let [read, there] = [0, 1].map(|k| sums[0].iter().map(|sum| sum[k]).sum::<f64>());
    println!("read {:.4} of what is there", read / there);
    for (what, of) in ["from", "to"].into_iter().zip(&sums) {
        let mut order: Vec<usize> = (0..of.len()).collect();
        order.sort_by(|&a, &b| (of[b][0] - of[b][1]).abs().total_cmp(&(of[a][0] - of[a][1]).abs()));
        for &m in &order[..5] {
            let (name, [read_here, there_here]) = (&scene.materials[m].name, of[m]);
            let (ratio, share) = (read_here / there_here, there_here / there);
            println!("  {what} {name}: {ratio:.4} of {:.1} % of the light", 100.0 * share);
        }
    }
    assert!((read / there - 1.0).abs() < 0.02, "{}", read / there);
}
