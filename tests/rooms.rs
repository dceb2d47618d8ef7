//! Indirect light of a furnished room: how much of it there is, against the path tracer.

mod common;

use common::ratio::Lit;
use common::{shared, transfer};
use glam::Vec3;
use relume::bake::transfer::TransferSettings;
use relume::scene::{Material, Scene};
use relume::trace::bvh::Bvh;

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

/// No light is lost among furniture, textures, gloss and double-sided faces: 17 % were, before samples lay where paths came
/// to. Lamps alone: the window's light is looked at elsewhere. Prints ratios, of the first bounce and of all.
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
        let bvh = Bvh::build(&scene);
        let lit = Lit { scene: &scene, bvh: &bvh, camera: &scene.cameras[0], rig: &scene.rig, size: [96, 64] };
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
