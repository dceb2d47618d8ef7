//! Size and place do not matter: the same file under a root node that scales or moves it.

#[path = "../support/mod.rs"]
mod support;

use glam::{DVec3, Vec3};
use relume::reference::path_tracer::{Half, Layer, PathTracer};
use relume::scene::Scene;
use relume::trace::bvh::TracedScene;
use serde_json::json;

use self::support::Gltf;
use crate::common::drawn::tracing;
use crate::common::stage::{Build, Setup};
use crate::common::{Gpu, gpu};
use crate::even::shining;
use crate::lights::Relit;
use crate::table::{Row, check};

/// A room with a box in it, a point and a spot, seen by a camera; all below one root node.
fn room(scale: f64, offset: DVec3) -> Scene {
    let mut build = Build::default();
    build.room(DVec3::ZERO, 1.0, 0);
    build.quad(DVec3::new(0.3, -0.6, 0.1), 0.3 * DVec3::Z, DVec3::new(0.3, 0.1, 0.0), 0);
    build.quad(DVec3::new(-0.4, -0.3, -0.4), DVec3::new(0.2, 0.0, 0.1), 0.5 * DVec3::Y, 0);
    let mut gltf = Gltf::new();
    let positions: Vec<[f32; 3]> =
        build.quads.iter().flat_map(|(corners, _)| corners.map(|p| p.as_vec3().into())).collect();
    let indices: Vec<u16> =
        (0..build.quads.len() as u16).flat_map(|q| [0, 1, 2, 0, 2, 3].map(|corner| 4 * q + corner)).collect();
    let (positions, indices) = (gltf.f32s(&positions), gltf.indices(&indices));
    gltf.json["materials"] = json!([{
        "pbrMetallicRoughness": { "baseColorFactor": [0.7, 0.5, 0.3, 1.0], "metallicFactor": 0.2, "roughnessFactor": 0.45 }
    }]);
    gltf.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices, "material": 0 }));
    gltf.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 1.2, "znear": 0.1 } }]);
    let [point, spot] = [json!({ "type": "point" }), json!({ "type": "spot", "spot": { "outerConeAngle": 0.6 } })]
        .map(|light| gltf.light(light))
        .map(|light| json!({ "KHR_lights_punctual": { "light": light } }));
    let children = [
        gltf.node(json!({ "mesh": 0 })),
        gltf.node(json!({ "camera": 0, "translation": [0.1, 0.1, 0.9], "rotation": [0.05, 0.1, 0.02, 0.9935] })),
        gltf.node(json!({ "name": "p", "translation": [-0.3, 0.5, 0.3], "extensions": point })),
        gltf.node(json!({ "name": "s", "translation": [0.4, 0.6, 0.4], "extensions": spot })),
    ];
    gltf.root(json!({ "children": children, "scale": [scale, scale, scale], "translation": offset.to_array() }));
    let folder = tempfile::tempdir().unwrap();
    Scene::load(&gltf.write(folder.path(), "room.glb")).unwrap()
}

/// First-hand, indirect and path-traced indirect light, times the square of the scale that distances have.
fn pictures(gpu: &Gpu, scale: f64, offset: DVec3) -> [Vec<DVec3>; 3] {
    let scene = room(scale, offset);
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    let traced = TracedScene::new(scene.clone());
    let film = PathTracer::new(&traced, &camera, &rig, &tracing(48, 36)).trace(16, &|| false, &|_| ());
    let traced = film.image(Half::A, &[Layer::Indirect]).layers.remove(0).pixels;
    let relit = Relit::with(scene, &camera, &rig, &Setup::new(48, 36), 192);
    let linear = |image: Vec<[f32; 3]>| image.into_iter().map(|p| Vec3::from(p).as_dvec3() * (scale * scale)).collect();
    let [first, indirect] = relit.pictures(gpu, &rig);
    [first, indirect, traced].map(linear)
}

/// Root mean square of the difference over that of `b`.
pub fn relative(a: &[DVec3], b: &[DVec3]) -> f64 {
    let error: f64 = a.iter().zip(b).map(|(a, b)| (*a - *b).length_squared()).sum();
    (error / b.iter().map(|b| b.length_squared()).sum::<f64>()).sqrt()
}

#[test]
fn size_and_place_do_not_matter() {
    let gpu = gpu();
    let here = pictures(&gpu, 1.0, DVec3::ZERO);
    assert!(here.iter().all(|image| image.iter().filter(|p| p.x > 0.0).count() > 1000), "most pixels are lit");
    let mut rows = Vec::new();
    let far = DVec3::new(1e6, -1e6, 1e6);
    for (scale, offset) in
        [(1e-6, DVec3::ZERO), (1e-3, DVec3::ZERO), (1e3, DVec3::ZERO), (1e6, DVec3::ZERO), (1.0, far), (1e6, 1e6 * far)]
    {
        let there = pictures(&gpu, scale, offset);
        let case = match offset == DVec3::ZERO {
            true => format!("scaled by {scale:.0e}"),
            false => format!("scaled by {scale:.0e} and moved by {:.0e} m along each axis", offset.x),
        };
        let [first, indirect, traced] = [0, 1, 2].map(|i| relative(&there[i], &here[i]));
        rows.push(Row::new(case.clone(), "the same first-hand light", 1e-3, first));
        rows.push(Row::new(case.clone(), "the same indirect light", 1e-3, indirect));
        rows.push(Row::new(case, "the same path-traced indirect light, noise and all", 1e-3, traced));
    }
    check("place", &rows);
}

#[test]
fn closed_rooms_of_any_size() {
    let mut rows = Vec::new();
    for scale in [1e-6, 1e6] {
        let mut build = Build::default();
        let material = build.material(shining(0.9));
        build.room(DVec3::ZERO, scale, material);
        let errors = crate::even::errors(&crate::even::Stage::inside(build.scene()), 0.9);
        rows.extend(errors.rows(&format!("closed box of side {:.0e} m", 2.0 * scale), 0.9, None));
    }
    check("size", &rows);
}
