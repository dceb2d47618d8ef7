//! The scenes in `scenes/` are what their generator makes, and what the README there says.

#[path = "../tools/make_scenes/glb.rs"]
mod glb;
#[path = "../tools/make_scenes/mesh.rs"]
mod mesh;
#[path = "../tools/make_scenes/noise.rs"]
mod noise;
#[path = "../tools/make_scenes/room/mod.rs"]
mod room;
#[path = "../tools/make_scenes/scenes.rs"]
mod scenes;
#[path = "../tools/make_scenes/statues.rs"]
mod statues;

use std::collections::HashMap;
use std::path::Path;

use glam::Vec3;
use mesh::Mesh;
use relume::scene::{AlphaMode, Material};

#[test]
fn committed_scenes_can_be_made_again_byte_by_byte() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    for scene in scenes::small() {
        let path = dir.join(format!("{}.glb", scene.name));
        let committed = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert!(
            committed == scene.to_glb(),
            "{} differs: cargo run --release --bin make_scenes -- scenes small",
            path.display()
        );
    }
}

#[test]
fn triangles_are_as_many_as_the_readme_says() {
    let readme = include_str!("../scenes/README.md");
    for scene in scenes::small().iter().chain(&scenes::large()) {
        let count = scene.triangle_count();
        let written = format!("{},{:03}", count / 1000, count % 1000);
        let row = readme.lines().find(|line| line.contains(&format!("{}.glb`", scene.name)));
        let row = row.unwrap_or_else(|| panic!("{} is not in scenes/README.md", scene.name));
        assert!(row.contains(&written), "{} has {written} triangles; scenes/README.md says {row}", scene.name);
    }
}

#[test]
fn solids_are_closed_and_no_triangle_is_empty() {
    check_solid("ball", &mesh::sphere(0.36, 64, 64));
    check_solid("figure", &statues::figure());
    check_solid("knot", &statues::knot());
}

/// In single precision, as the file has it: areas above zero, unit normals, and each edge passed as often one way as
/// the other.
fn check_solid(name: &str, mesh: &Mesh) {
    let positions: Vec<Vec3> = mesh.positions.iter().map(|p| p.as_vec3()).collect();
    let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| positions[i as usize]);
        assert!((b - a).cross(c - a).length() > 0.0, "{name}: triangle {triangle:?} is empty");
        for side in 0..3 {
            let (from, to) = (triangle[side], triangle[(side + 1) % 3]);
            *balance.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
        }
    }
    let open = balance.values().filter(|sum| **sum != 0).count();
    assert_eq!(open, 0, "{name}: edges without a counterpart");
    for normal in &mesh.normals {
        assert!((normal.length() - 1.0).abs() < 1e-6, "{name}: normal {normal} is not unit");
    }
}

#[test]
fn the_room_is_the_same_each_time() {
    let bytes = room::scene(false).to_glb();
    assert!(bytes == room::scene(false).to_glb(), "two runs differ");
    assert!(bytes.len() < 25 << 20, "{} bytes", bytes.len());
}

#[test]
fn the_room_loads_whole_and_without_a_warning() {
    let made = room::scene(false);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.glb");
    std::fs::write(&path, made.to_glb()).unwrap();
    let scene = relume::scene::Scene::load(&path).unwrap();

    // None was dropped for want of area.
    assert_eq!(scene.mesh.triangles.len(), made.triangle_count());
    assert!((80_000..120_000).contains(&made.triangle_count()), "{} triangles", made.triangle_count());
    assert_eq!(scene.textures.len(), made.textures.len(), "each texture is used, and one way");
    assert_eq!((scene.rig.lights.len(), scene.cameras.len()), (7, 1), "two of the lights are emitters");
    assert_eq!(scene.image_size, Some([720, 480]));
    let count = |what: fn(&Material) -> bool| scene.materials.iter().filter(|m| what(m)).count();
    assert_eq!(count(|m| m.alpha_mode == AlphaMode::Mask { cutoff: 0.5 }), 1, "leaves");
    assert_eq!(count(|m| m.emissive != Vec3::ZERO && m.emissive_texture.is_some()), 2, "the shade and the garden");
    assert_eq!(count(|m| m.roughness == 0.0), 1, "the mirror");
    let double_sided = count(|m| m.double_sided);
    assert!(2 * double_sided > scene.materials.len(), "{double_sided} of {}", scene.materials.len());
    assert!(double_sided < scene.materials.len(), "all are double-sided");

    let rig = folder.path().join("rig.toml");
    let relume =
        std::process::Command::new(env!("CARGO_BIN_EXE_relume")).arg("rig").arg(&path).arg("-o").arg(&rig).output();
    let relume = relume.unwrap();
    assert!(relume.status.success() && relume.stderr.is_empty(), "{}", String::from_utf8_lossy(&relume.stderr));
}

/// In single precision: areas above zero, unit normals on the side that the triangle is seen from.
#[test]
fn nothing_in_the_room_is_empty_or_inside_out() {
    for object in [false, true].map(room::scene).iter().flat_map(|scene| &scene.objects) {
        let (name, mesh) = (&object.name, &object.mesh);
        let positions: Vec<Vec3> = mesh.positions.iter().map(|p| p.as_vec3()).collect();
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| positions[i as usize]);
            let face = (b - a).cross(c - a);
            assert!(face.length() > 1e-12, "{name}: the triangle {a}, {b}, {c} is empty");
            let normal: Vec3 = triangle.iter().map(|&i| mesh.normals[i as usize].as_vec3()).sum();
            assert!(face.dot(normal) > 0.0, "{name}: the triangle {a}, {b}, {c} faces away from its normals");
        }
        for normal in &mesh.normals {
            assert!((normal.length() - 1.0).abs() < 1e-6, "{name}: normal {normal} is not unit");
        }
    }
}
