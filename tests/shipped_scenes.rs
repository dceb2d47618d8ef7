//! The scenes in `scenes/` are what their generator makes, and what the README there says.

#[path = "../tools/make_scenes/glb.rs"]
mod glb;
#[path = "../tools/make_scenes/mesh.rs"]
mod mesh;
#[path = "../tools/make_scenes/scenes.rs"]
mod scenes;
#[path = "../tools/make_scenes/statues.rs"]
mod statues;

use std::collections::HashMap;
use std::path::Path;

use glam::Vec3;
use mesh::Mesh;

#[test]
fn committed_scenes_can_be_made_again_byte_by_byte() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    for scene in scenes::small() {
        let path = dir.join(format!("{}.glb", scene.name));
        let committed = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert!(
            committed == scene.to_glb(),
            "{} differs: cargo run --release --example make_scenes -- scenes small",
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
