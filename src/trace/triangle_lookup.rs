//! The triangles on which baked points lie.

use glam::Vec3;
use rayon::prelude::*;

use super::bvh::TracedScene;

/// Minimum cosine between a point's geometric normal and that of its triangle: allows for rounding.
const SAME_NORMAL: f32 = 0.99;

/// The triangle of each point, given by position and geometric normal: the first along the normal's opposite that has
/// this normal, starting just above the point, which may be lifted from its surface. 0 for points that are on no
/// surface.
pub fn triangles_at(scene: &TracedScene, points: impl IndexedParallelIterator<Item = (Vec3, Vec3)>) -> Vec<u32> {
    let mesh = &scene.mesh;
    let above = scene.bvh.shadow_offset(0.0);
    let at = |(position, normal): (Vec3, Vec3)| {
        let differs = |triangle: u32| {
            let [a, b, c] = mesh.triangles[triangle as usize].map(|v| mesh.positions[v as usize]);
            let cosine = (b - a).cross(c - a).normalize_or_zero().dot(normal);
            let material = &scene.materials[mesh.triangle_materials[triangle as usize] as usize];
            SAME_NORMAL > if material.double_sided { cosine.abs() } else { cosine }
        };
        let hit = scene.closest_hit_unless(position + above * normal, -normal, |hit| differs(hit.triangle));
        hit.map_or(0, |hit| hit.triangle)
    };
    points.map(at).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use glam::Vec2;

    use super::*;
    use crate::scene::{AlphaMode, Scene};
    use crate::trace::bvh::Hit;
    use crate::trace::surface::SurfacePoint;

    /// Alpha does not matter: masked points have a triangle too.
    #[test]
    fn points_find_their_triangles() {
        for (name, masked) in [("cornell-diffuse", false), ("balls-2", false), ("balls-2", true)] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.glb"));
            let mut scene = Scene::load(&path).expect("the scene is here");
            for material in scene.materials.iter_mut().filter(|_| masked) {
                material.alpha_mode = AlphaMode::Mask { cutoff: 0.5 };
                material.base_color.w = 0.0;
                material.double_sided = true;
            }
            let scene = TracedScene::new(scene);
            let places = [Vec2::new(0.3, 0.3), Vec2::new(0.02, 0.9), Vec2::new(0.6, 0.1)];
            let triangles = (0..scene.mesh.triangles.len() as u32).flat_map(|triangle| places.map(|at| (triangle, at)));
            let (want, points): (Vec<u32>, Vec<_>) = triangles
                .flat_map(|(triangle, barycentric)| {
                    [false, true].map(|lifted| {
                        let hit = Hit { triangle, barycentric, distance: 0.0 };
                        let surface = SurfacePoint::new(&scene, &hit, Vec3::NEG_Y, 0.0);
                        let position = if lifted { surface.lifted() } else { surface.position };
                        (triangle, (position, surface.geometric_normal))
                    })
                })
                .unzip();
            let got = triangles_at(&scene, points.into_par_iter());
            let wrong = want.iter().zip(&got).filter(|(want, got)| want != got).count();
            assert_eq!(wrong, 0, "{name}, {masked}: of {} points", want.len());
        }
    }
}
