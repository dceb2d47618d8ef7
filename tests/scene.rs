//! What importers make of files: glTF features, OBJ, rig files, export.

mod support;

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec2, Vec3, Vec4};
use relume::scene::{AlphaMode, Encoding, LightKind, Projection, Scene, Wrap};
use serde_json::json;
use support::*;

fn load(gltf: &Gltf) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    match Scene::load(&gltf.write(folder.path(), "scene.glb")) {
        Ok(scene) => scene,
        Err(e) => panic!("{e}: {:?}", std::error::Error::source(&e)),
    }
}

/// World positions of one triangle, to the micrometre.
fn world(scene: &Scene, triangle: usize) -> [DVec3; 3] {
    let position = |i: u32| scene.space.to_world(scene.mesh.positions[i as usize]);
    scene.mesh.triangles[triangle].map(|i| (position(i) * 1e6).round() / 1e6)
}

fn face_normal(scene: &Scene, triangle: usize) -> DVec3 {
    let [a, b, c] = world(scene, triangle);
    (b - a).cross(c - a).normalize()
}

fn assert_near(got: DVec3, want: DVec3, tolerance: f64) {
    assert!(got.distance(want) <= tolerance, "got {got}, want {want}");
}

#[test]
fn the_shared_scenes_have_their_triangles() {
    let shared = std::env::var("RELUME_SHARED").map(PathBuf::from);
    let shared = shared.unwrap_or_else(|_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"));
    // Triangles and lights as the scenes' README has them; 113 of the dragon's have two corners at one point.
    for (name, triangles, lights, size) in [
        ("cornell-glossy", 8_086, 1, [512, 512]),
        ("cornell-glossy-floor", 8_086, 1, [512, 512]),
        ("cornell-glossy-point", 8_086, 1, [512, 512]),
        ("cornell-diffuse", 8_086, 1, [512, 512]),
        ("buddha", 100_008, 1, [512, 512]),
        ("balls-2", 9_922, 2, [720, 480]),
        ("balls-16", 9_922, 16, [720, 480]),
        ("bunny-dragon-2", 287_273 - 113, 2, [720, 480]),
        ("bunny-dragon-16", 287_273 - 113, 16, [720, 480]),
    ] {
        let path = shared.join("scenes").join(format!("{name}.glb"));
        if !path.is_file() {
            println!("not run: there is no {}", path.display());
            continue;
        }
        let scene = Scene::load(&path).unwrap();
        assert_eq!(scene.mesh.triangles.len(), triangles, "{name}");
        assert_eq!(scene.mesh.triangle_materials.len(), triangles, "{name}");
        assert_eq!(scene.rig.lights.len(), lights, "{name}");
        assert_eq!(scene.image_size, Some(size), "{name}");
        assert_eq!(scene.cameras.len(), 1, "{name}");
        assert!(scene.mesh.uvs.iter().all(Vec::is_empty) && scene.mesh.tangents.is_empty(), "{name}");
        assert!(scene.mesh.normals.iter().all(|n| n.is_normalized()), "{name}");
        if name == "balls-2" {
            let spot = &scene.rig.lights[1];
            assert_eq!((spot.name.as_str(), spot.kind, spot.intensity), ("light_1_spot", LightKind::Spot, 60.0));
            assert_near(spot.position, DVec3::new(2.8, 3.8, 1.5), 1e-6);
            assert_near(spot.direction, DVec3::new(-0.592, -0.741, -0.317), 1e-3);
            assert!((spot.inner_angle.to_degrees() - 18.0).abs() < 1e-5);
            assert_near(scene.cameras[0].position, DVec3::new(0.0, 1.9, 5.2), 1e-6);
            assert!(matches!(scene.cameras[0].projection,
                Projection::Perspective { yfov } if (yfov.to_degrees() - 36.0).abs() < 1e-5));
        }
    }
}

#[test]
fn a_square() {
    let scene = load(&Gltf::square());
    assert_eq!(scene.mesh.triangles.len(), 2);
    assert_eq!(scene.mesh.positions.len(), 4);
    assert_eq!(scene.space.origin, DVec3::new(0.5, 0.5, 0.0));
    assert_eq!(scene.mesh.normals, [Vec3::Z; 4]);
    assert_eq!(face_normal(&scene, 0), DVec3::Z);
    assert_eq!(scene.materials.len(), 1);
    assert!(scene.mesh.colors.is_empty() && scene.cameras.is_empty() && scene.image_size.is_none());
}

#[test]
fn a_scene_far_from_its_origin_keeps_its_shape() {
    let mut gltf = Gltf::square();
    gltf.json["nodes"][0]["translation"] = json!([4_500_000.125, -10_000_000.0, 3.0]);
    let scene = load(&gltf);
    assert_eq!(scene.space.origin, DVec3::new(4_500_000.625, -9_999_999.5, 3.0));
    // Half the square's diagonal is the unit.
    assert_eq!(scene.space.unit, 0.5f64.sqrt());
    assert!(scene.mesh.positions[0].distance(Vec3::new(-0.5f32.sqrt(), -0.5f32.sqrt(), 0.0)) < 1e-7);
}

#[test]
fn transforms_accumulate_and_mirrors_turn_the_winding() {
    let mut gltf = Gltf::square();
    gltf.json["nodes"][0] = json!({"mesh": 0, "scale": [-2.0, 3.0, 1.0]});
    // A quarter turn about Y by matrix: x -> -z, z -> x; then up by 5.
    let quarter = [0., 0., -1., 0., 0., 1., 0., 0., 1., 0., 0., 0., 0., 5., 0., 1.];
    let parent = gltf.node(json!({"children": [0], "matrix": quarter}));
    gltf.json["scenes"][0]["nodes"] = json!([parent]);
    let scene = load(&gltf);
    let corners: Vec<DVec3> = (0..2).flat_map(|t| world(&scene, t)).collect();
    assert!(corners.contains(&DVec3::new(0.0, 8.0, 2.0)), "{corners:?}");
    // The normal is the inverse transpose's, and faces still go round it counter-clockwise.
    assert_near(face_normal(&scene, 0), DVec3::X, 1e-12);
    assert!(scene.mesh.normals[0].distance(Vec3::X) < 1e-6);
}

#[test]
fn instances() {
    let mut gltf = Gltf::square();
    gltf.root(json!({"mesh": 0, "translation": [3.0, 0.0, 0.0]}));
    let scene = load(&gltf);
    assert_eq!(scene.mesh.triangles.len(), 4);
    assert_eq!(scene.space.origin, DVec3::new(2.0, 0.5, 0.0));
}

#[test]
fn indices_of_every_kind() {
    for (component, bytes) in [
        (UNSIGNED_BYTE, vec![0, 1, 2, 0, 2, 3]),
        (UNSIGNED_SHORT, [0u16, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()).collect()),
        (UNSIGNED_INT, [0u32, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()).collect()),
    ] {
        let mut gltf = Gltf::square();
        let accessor = gltf.accessor(&bytes, component, "SCALAR", 6);
        gltf.json["meshes"][0]["primitives"][0]["indices"] = accessor.into();
        assert_eq!(load(&gltf).mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    }
}

#[test]
fn strips_fans_and_soup() {
    let mut gltf = Gltf::new();
    let fan = gltf.f32s(&SQUARE);
    let strip = gltf.f32s(&[SQUARE[0], SQUARE[1], SQUARE[3], SQUARE[2]]);
    let soup = gltf.f32s(&[SQUARE[0], SQUARE[1], SQUARE[2]]);
    for (mode, positions, triangles) in [(6, fan, 2), (5, strip, 2), (4, soup, 1)] {
        let mesh = gltf.mesh(json!({"attributes": {"POSITION": positions}, "mode": mode}));
        gltf.json["nodes"] = json!([{"mesh": mesh}]);
        gltf.json["scenes"][0]["nodes"] = json!([0]);
        let scene = load(&gltf);
        assert_eq!(scene.mesh.triangles.len(), triangles, "mode {mode}");
        for t in 0..triangles {
            assert_near(face_normal(&scene, t), DVec3::Z, 1e-6);
        }
    }
}

#[test]
fn points_and_lines_are_skipped() {
    let mut gltf = Gltf::square();
    for mode in 0..4 {
        let positions = gltf.f32s(&SQUARE);
        let primitives = gltf.json["meshes"][0]["primitives"].as_array_mut().unwrap();
        primitives.push(json!({"attributes": {"POSITION": positions}, "mode": mode}));
    }
    assert_eq!(load(&gltf).mesh.triangles.len(), 2);
}

#[test]
fn missing_normals_are_flat() {
    let mut gltf = Gltf::square();
    gltf.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("NORMAL");
    let scene = load(&gltf);
    assert_eq!(scene.mesh.positions.len(), 6);
    assert_eq!(scene.mesh.normals, [Vec3::Z; 6]);
}

#[test]
fn normals_of_zero_length_become_their_faces() {
    let mut gltf = Gltf::square();
    let normals = gltf.f32s(&[[0.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 5.0]]);
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = normals.into();
    assert_eq!(load(&gltf).mesh.normals, [Vec3::Z, Vec3::Z, Vec3::Y, Vec3::Z]);
}

#[test]
fn degenerate_triangles_are_dropped() {
    let mut gltf = Gltf::new();
    let line = [0.0, 0.0, 0.0, 0.1, 0.1, 0.1, 0.3, 0.3, 0.3];
    let mut positions = SQUARE.to_vec();
    positions.extend(line.chunks(3).map(|p| [p[0], p[1], p[2]]));
    // Far away and without area: must not move the origin.
    positions.push([1e9, 0.0, 0.0]);
    let positions = gltf.f32s(&positions);
    let indices = gltf.indices(&[0, 1, 2, 0, 0, 2, 4, 5, 6, 0, 2, 3, 7, 7, 7]);
    gltf.mesh(json!({"attributes": {"POSITION": positions}, "indices": indices}));
    gltf.root(json!({"mesh": 0}));
    let scene = load(&gltf);
    assert_eq!(scene.mesh.triangles.len(), 2);
    assert_eq!(scene.mesh.positions.len(), 6);
    assert_eq!(scene.space.origin, DVec3::new(0.5, 0.5, 0.0));
}

#[test]
fn sparse_accessors() {
    let mut gltf = Gltf::square();
    let at = gltf.view(&[2, 0]);
    let to = gltf.view(&[4.0f32, 5.0, 0.0].map(f32::to_le_bytes).concat());
    let accessor = gltf.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].as_u64().unwrap() as usize;
    gltf.json["accessors"][accessor]["sparse"] = json!({
        "count": 1,
        "indices": {"bufferView": at, "componentType": UNSIGNED_BYTE},
        "values": {"bufferView": to}
    });
    let scene = load(&gltf);
    assert_eq!(world(&scene, 0)[2], DVec3::new(4.0, 5.0, 0.0));
    // Nothing but sparse: zeros elsewhere.
    gltf.json["accessors"][accessor].as_object_mut().unwrap().remove("bufferView");
    let at = gltf.view(&[1, 2]);
    let to = gltf.view(&[1.0f32, 0.0, 0.0, 1.0, 1.0, 0.0].map(f32::to_le_bytes).concat());
    let sparse = &mut gltf.json["accessors"][accessor]["sparse"];
    (sparse["indices"]["bufferView"], sparse["values"]["bufferView"]) = (at.into(), to.into());
    sparse["count"] = 2.into();
    assert_eq!(load(&gltf).mesh.triangles.len(), 1);
}

#[test]
fn interleaved_attributes() {
    let mut gltf = Gltf::new();
    let bytes: Vec<u8> =
        SQUARE.iter().flat_map(|p| [p[0], p[1], p[2], 0.0, 0.0, 1.0]).flat_map(f32::to_le_bytes).collect();
    let view = gltf.view(&bytes);
    gltf.json["bufferViews"][view]["byteStride"] = 24.into();
    let accessor = |offset: usize| {
        json!({"bufferView": view, "byteOffset": offset, "componentType": FLOAT,
        "type": "VEC3", "count": 4})
    };
    let (positions, normals) = (gltf.push("accessors", accessor(0)), gltf.push("accessors", accessor(12)));
    gltf.mesh(json!({"attributes": {"POSITION": positions, "NORMAL": normals}, "mode": 6}));
    gltf.root(json!({"mesh": 0}));
    let scene = load(&gltf);
    assert_eq!(scene.mesh.triangles.len(), 2);
    assert_eq!(scene.mesh.normals, [Vec3::Z; 4]);
}

#[test]
fn quantised_attributes() {
    for (component, normalized, one, bytes_of) in [
        (BYTE, false, 1.0, 1),
        (BYTE, true, 1.0 / 127.0, 1),
        (UNSIGNED_BYTE, true, 1.0 / 255.0, 1),
        (SHORT, false, 1.0, 2),
        (SHORT, true, 1.0 / 32_767.0, 2),
        (UNSIGNED_SHORT, true, 1.0 / 65_535.0, 2),
    ] {
        let mut gltf = Gltf::new();
        let mut bytes = Vec::new();
        for p in SQUARE {
            for x in [p[0] as u8 * 100, p[1] as u8 * 100, p[2] as u8, 0] {
                bytes.push(x);
                bytes.resize(bytes.len() + bytes_of - 1, 0);
            }
        }
        let positions = gltf.accessor(&bytes, component, "VEC3", 4);
        gltf.json["accessors"][positions]["normalized"] = normalized.into();
        gltf.json["bufferViews"][0]["byteStride"] = (4 * bytes_of).into();
        let normals = gltf.accessor(&[0, 0, 127, 0].repeat(4), BYTE, "VEC3", 4);
        gltf.json["accessors"][normals]["normalized"] = true.into();
        gltf.json["bufferViews"][1]["byteStride"] = 4.into();
        gltf.mesh(json!({"attributes": {"POSITION": positions, "NORMAL": normals}, "mode": 6}));
        gltf.root(json!({"mesh": 0}));
        gltf.uses("KHR_mesh_quantization");
        gltf.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
        let scene = load(&gltf);
        let width = scene.space.unit as f32 * (scene.mesh.bounds().1 - scene.mesh.bounds().0).x;
        assert!((width - 100.0 * one).abs() < 1e-5 * width, "{component} {normalized}: {width}");
        assert_eq!(scene.mesh.normals, [Vec3::Z; 4]);
    }
}

#[test]
fn vertex_colours() {
    let half = |gltf: &mut Gltf, bytes: &[u8], component: u32, kind: &str| {
        let accessor = gltf.accessor(bytes, component, kind, 4);
        if component != FLOAT {
            gltf.json["accessors"][accessor]["normalized"] = true.into();
        }
        gltf.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = accessor.into();
        load(gltf).mesh.colors
    };
    let mut gltf = Gltf::square();
    let rgba = Vec4::new(0.2, 0.4, 0.6, 0.8);
    assert_eq!(half(&mut gltf, &[51, 102, 153, 204].repeat(4), UNSIGNED_BYTE, "VEC4"), [rgba; 4]);
    let bytes = [13_107u16, 26_214, 39_321, 52_428].map(u16::to_le_bytes).concat().repeat(4);
    assert_eq!(half(&mut gltf, &bytes, UNSIGNED_SHORT, "VEC4"), [rgba; 4]);
    let bytes = [0.2f32, 0.4, 0.6].map(f32::to_le_bytes).concat().repeat(4);
    assert_eq!(half(&mut gltf, &bytes, FLOAT, "VEC3"), [rgba.truncate().extend(1.0); 4]);
    // All white says nothing.
    assert!(half(&mut gltf, &[255; 16], UNSIGNED_BYTE, "VEC4").is_empty());
}

/// A square with texture coordinates and a material that uses one image.
fn textured() -> Gltf {
    let mut gltf = Gltf::square();
    let uvs = gltf.f32s(&[[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uvs.into();
    gltf.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    let image = png(2, 1, &[[255, 0, 0, 255], [0, 0, 188, 128]]);
    let view = gltf.view(&image);
    gltf.json["images"] = json!([{"bufferView": view, "mimeType": "image/png"}]);
    gltf.json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33648}]);
    gltf.json["textures"] = json!([{"source": 0, "sampler": 0}, {"source": 0}]);
    gltf.json["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
    gltf
}

#[test]
fn textures_are_decoded_once_for_each_use() {
    let mut gltf = textured();
    gltf.json["materials"] = json!([{
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.5, 1.0, 1.0, 1.0], "roughnessFactor": 0.5,
            "baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}
        },
        "emissiveTexture": {"index": 1}, "emissiveFactor": [1.0, 1.0, 1.0],
        "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 7.0},
            "KHR_materials_ior": {"ior": 1.33},
            "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [0.1, 0.2, 0.3],
                "specularTexture": {"index": 1}, "specularColorTexture": {"index": 0}}
        }
    }]);
    let scene = load(&gltf);
    assert_eq!(scene.textures.len(), 2);
    let material = &scene.materials[0];
    let base = material.base_color_texture.unwrap();
    assert_eq!(base.wrap, [Wrap::Clamp, Wrap::Mirror]);
    assert_eq!(scene.textures[base.texture].encoding, Encoding::Srgb);
    assert_eq!(material.emissive_texture.unwrap().texture, base.texture);
    assert_eq!(material.specular_color_texture.unwrap().texture, base.texture);
    let linear = material.metallic_roughness_texture.unwrap();
    assert_eq!(linear.wrap, [Wrap::Repeat; 2]);
    assert_eq!(scene.textures[linear.texture].encoding, Encoding::Linear);
    assert_eq!(material.specular_texture.unwrap().texture, linear.texture);
    assert_eq!(material.emissive, Vec3::splat(7.0));
    assert_eq!((material.ior, material.specular, material.specular_color), (1.33, 0.5, Vec3::new(0.1, 0.2, 0.3)));
    let right = material.evaluate(&scene.textures, [Vec2::new(0.75, 0.5); 2], [0.0; 2], Vec4::ONE);
    assert!((right.metallic - 188.0 / 255.0).abs() < 1e-6 && right.roughness == 0.0);
    assert!((right.base_color.z - 0.502_886_5).abs() < 1e-5, "{right:?}");
    assert!((right.specular - 0.5 * 128.0 / 255.0).abs() < 1e-6);
    let left = material.evaluate(&scene.textures, [Vec2::new(0.25, 0.5); 2], [0.0; 2], Vec4::ONE);
    assert_eq!(left.base_color, Vec3::new(0.5, 0.0, 0.0));
    assert_eq!(scene.mesh.uvs[0].len(), 4);
    assert!(scene.mesh.uvs[1].is_empty() && scene.mesh.tangents.is_empty());
}

#[test]
fn texture_transforms_turn_counter_clockwise() {
    let mut gltf = textured();
    let half_pi = std::f64::consts::FRAC_PI_2;
    // The extension's own example: the lower left quadrant, turned.
    let transform = json!({"offset": [0.0, 1.0], "rotation": half_pi, "scale": [0.5, 0.5], "texCoord": 1});
    let info = json!({"index": 0, "extensions": {"KHR_texture_transform": transform}});
    gltf.json["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": info}, "normalTexture": info}]);
    let uvs = gltf.f32s(&[[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = uvs.into();
    let scene = load(&gltf);
    for texture in [scene.materials[0].base_color_texture.unwrap(), scene.materials[0].normal_texture.unwrap()] {
        assert_eq!(texture.uv_set, 1);
        let uv = (texture.uv_transform * Vec3::new(1.0, 0.0, 1.0)).truncate();
        assert!(uv.distance(Vec2::new(0.0, 0.5)) < 1e-6, "{uv}");
        let uv = (texture.uv_transform * Vec3::new(0.0, 1.0, 1.0)).truncate();
        assert!(uv.distance(Vec2::new(0.5, 1.0)) < 1e-6, "{uv}");
    }
    assert!(scene.mesh.uvs[0].is_empty());
    assert_eq!(scene.mesh.uvs[1].len(), 4);
}

#[test]
fn tangents_for_normal_maps() {
    let mut gltf = textured();
    gltf.json["materials"] = json!([{"normalTexture": {"index": 0, "scale": 0.5}}]);
    let scene = load(&gltf);
    // u grows along +X, the image stands upright: bitangent = cross(N, T) points up.
    assert_eq!(scene.mesh.tangents.len(), 4);
    for t in &scene.mesh.tangents {
        assert!(t.distance(Vec4::new(1.0, 0.0, 0.0, 1.0)) < 1e-6, "{t}");
    }
    assert_eq!(scene.materials[0].normal_scale, 0.5);
    // The second triangle mirrored: the shared edge's vertices are doubled.
    let uvs = gltf.f32s(&[[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [2.0, 1.0]]);
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uvs.into();
    let scene = load(&gltf);
    let signs: Vec<Vec<f32>> =
        (scene.mesh.triangles.iter()).map(|t| t.iter().map(|&i| scene.mesh.tangents[i as usize].w).collect()).collect();
    assert_eq!(signs, [vec![1.0; 3], vec![-1.0; 3]]);
    assert_eq!(scene.mesh.positions.len(), 6);
    for (tangent, normal) in scene.mesh.tangents.iter().zip(&scene.mesh.normals) {
        assert!(tangent.truncate().is_normalized() && tangent.truncate().dot(*normal).abs() < 1e-6);
    }
}

#[test]
fn tangents_from_the_file_follow_mirrors() {
    let mut gltf = textured();
    gltf.json["materials"] = json!([{"normalTexture": {"index": 0}}]);
    let tangents = gltf.f32s(&[[1.0, 0.0, 0.0, 1.0]; 4]);
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = tangents.into();
    gltf.json["nodes"][0]["scale"] = json!([-3.0, 1.0, 1.0]);
    assert_eq!(load(&gltf).mesh.tangents, [Vec4::new(-1.0, 0.0, 0.0, -1.0); 4]);
}

#[test]
fn material_modes() {
    let mut gltf = Gltf::square();
    gltf.json["meshes"][0]["primitives"][0]["material"] = 2.into();
    gltf.json["materials"] = json!([{}, {}, {"alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true}]);
    let scene = load(&gltf);
    assert_eq!(scene.materials.len(), 1);
    assert_eq!(scene.materials[0].alpha_mode, AlphaMode::Mask { cutoff: 0.25 });
    assert!(scene.materials[0].double_sided);
    gltf.json["materials"][2] =
        json!({"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1.0, 1.0, 1.0, 0.25]}});
    let pane = &load(&gltf).materials[0];
    assert_eq!((pane.alpha_mode, pane.base_color.w), (AlphaMode::Blend, 0.25));
    // All of it is there: that is opaque, unless vertices say otherwise.
    gltf.json["materials"][2] = json!({"alphaMode": "BLEND"});
    assert_eq!(load(&gltf).materials[0].alpha_mode, AlphaMode::Opaque);
    let colors = gltf.f32s(&[[1.0, 1.0, 1.0, 0.5]; 4]);
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = colors.into();
    assert_eq!(load(&gltf).materials[0].alpha_mode, AlphaMode::Blend);
}

#[test]
fn external_files_and_data_uris() {
    let mut gltf = textured();
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("my files")).unwrap();
    write(folder.path(), "my files/buffer é.bin", &gltf.bin);
    write(folder.path(), "image.png", &png(1, 1, &[[0, 255, 0, 255]]));
    gltf.json["buffers"] = json!([{"byteLength": gltf.bin.len(), "uri": "my%20files/x/../buffer%20%C3%A9.bin"}]);
    gltf.json["images"] = json!([{"uri": "image.png"}]);
    let path = write(folder.path(), "scene.gltf", gltf.json.to_string().as_bytes());
    let scene = Scene::load(&path).unwrap();
    assert_eq!(scene.mesh.triangles.len(), 2);
    assert_eq!(scene.textures[0].levels[0].texels, [[0, 255, 0, 255]]);
    // A triangle as text.
    let json = r#"{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36,
            "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;
    let path = write(folder.path(), "text.gltf", format!("\u{feff}{json}").as_bytes());
    assert_eq!(Scene::load(&path).unwrap().mesh.triangles.len(), 1);
}

#[test]
fn lights() {
    let mut gltf = Gltf::square();
    gltf.light(json!({"type": "point"}));
    gltf.light(json!({"type": "spot", "name": "key.light", "intensity": 60.1, "color": [1.0, 0.5, 0.25],
        "range": 10.0, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.7}}));
    gltf.light(json!({"type": "directional", "intensity": 3.0}));
    gltf.light(json!({"type": "spot", "spot": {}}));
    let light = |index: usize| json!({"KHR_lights_punctual": {"light": index}});
    gltf.root(json!({"extensions": light(0), "translation": [0.1, 0.2, 0.3]}));
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    // A quarter turn about X: -Z becomes +Y... scaled, which changes no intensity.
    let child = gltf.node(json!({"extensions": light(1), "translation": [1.0, 0.0, 0.0]}));
    gltf.root(json!({"children": [child], "rotation": [quarter, 0.0, 0.0, quarter], "scale": [2.0, 3.0, 0.1]}));
    gltf.root(json!({"extensions": light(2), "name": "sun", "translation": [9.0, 9.0, 9.0]}));
    gltf.root(json!({"extensions": light(3), "name": "sun"}));
    let scene = load(&gltf);
    let [point, spot, sun, bare] = &scene.rig.lights[..] else { panic!("{:?}", scene.rig.lights) };
    assert_eq!(
        (point.name.as_str(), point.kind, point.intensity, point.node),
        ("light0", LightKind::Point, 1.0, Some(1))
    );
    assert_eq!(point.position, DVec3::new(0.1, 0.2, 0.3));
    assert_eq!((spot.name.as_str(), spot.intensity, spot.node, spot.range), ("key_light", 60.1, Some(2), Some(10.0)));
    assert_eq!((spot.inner_angle, spot.outer_angle, spot.color), (0.2, 0.7, Vec3::new(1.0, 0.5, 0.25)));
    assert_near(spot.position, DVec3::new(2.0, 0.0, 0.0), 1e-12);
    assert_near(spot.direction, DVec3::Y, 1e-12);
    assert_eq!((sun.name.as_str(), sun.kind, sun.direction), ("sun", LightKind::Directional, DVec3::NEG_Z));
    assert_eq!((bare.name.as_str(), bare.inner_angle), ("sun_2", 0.0));
    assert_eq!(bare.outer_angle, std::f64::consts::FRAC_PI_4);
}

#[test]
fn cameras_have_no_scale() {
    let mut gltf = Gltf::square();
    gltf.json["cameras"] = json!([
        {"type": "orthographic", "orthographic": {"xmag": 2.0, "ymag": 1.5, "znear": 0.1, "zfar": 10.0}},
        {"type": "perspective", "name": "main", "perspective": {"yfov": 0.7, "znear": 0.1}}
    ]);
    gltf.root(json!({"camera": 1, "translation": [0.0, 1.0, 4.0], "scale": [2.0, 0.5, 3.0]}));
    gltf.root(json!({"camera": 0, "name": "side", "scale": [-1.0, 1.0, 1.0]}));
    let scene = load(&gltf);
    let [main, side] = &scene.cameras[..] else { panic!() };
    assert_eq!((main.name.as_str(), main.position), ("main", DVec3::new(0.0, 1.0, 4.0)));
    assert_eq!(main.world_from_camera, glam::DMat3::IDENTITY);
    assert_eq!(main.projection, Projection::Perspective { yfov: 0.7 });
    assert_eq!((side.name.as_str(), side.projection), ("side", Projection::Orthographic { ymag: 1.5 }));
    assert!((side.world_from_camera.determinant() - 1.0).abs() < 1e-12);
}

#[test]
fn the_default_scene_is_shown() {
    let mut gltf = Gltf::square();
    gltf.node(json!({"mesh": 0, "translation": [0.0, 0.0, 7.0]}));
    gltf.json["scenes"] = json!([
        {"nodes": [0], "extras": {"width": 64, "height": 48}},
        {"nodes": [1], "extras": {"width": 320.0, "height": 200}}
    ]);
    assert_eq!(load(&gltf).image_size, Some([64, 48]));
    gltf.json["scene"] = 1.into();
    let scene = load(&gltf);
    assert_eq!((scene.image_size, scene.space.origin.z), (Some([320, 200]), 7.0));
    gltf.json["scenes"][1]["extras"]["width"] = json!(-5);
    assert_eq!(load(&gltf).image_size, None);
    gltf.json["scene"] = json!(null);
    assert_eq!(load(&gltf).space.origin.z, 0.0);
}

#[test]
fn a_deep_chain_of_nodes() {
    let mut gltf = Gltf::square();
    for i in 0..100_000 {
        gltf.node(json!({"children": [i], "translation": [0.0, 0.0, 1.0]}));
    }
    gltf.json["scenes"][0]["nodes"] = json!([100_000]);
    assert_eq!(load(&gltf).space.origin.z, 100_000.0);
}

#[test]
fn extensions_that_may_be_ignored_are() {
    let mut gltf = Gltf::square();
    gltf.uses("KHR_materials_clearcoat");
    gltf.uses("VENDOR_unheard_of");
    gltf.json["extensions"]["VENDOR_unheard_of"] = json!({"lights": 3});
    gltf.json["animations"] = json!([{"channels": [], "samplers": []}]);
    assert_eq!(load(&gltf).mesh.triangles.len(), 2);
}

fn load_obj(obj: &str, mtl: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "my materials.mtl", mtl.as_bytes());
    write(folder.path(), "two texels.png", &png(2, 1, &[[255, 0, 0, 255], [0, 255, 0, 255]]));
    Scene::load(&write(folder.path(), "scene.obj", obj.as_bytes())).unwrap()
}

const OBJ_SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[test]
fn obj_faces() {
    // Negative indices, a pentagon, a continued line, a comment, a polyline that is no polygon.
    let obj = format!("{OBJ_SQUARE}v 0.5 2 0 # tip\nl 1 2 3\nf -5 -4 \\\n -3 -1 -2\nf 1//1 2//1 3//1\nvn 0 0 2\n");
    let scene = load_obj(&obj, "");
    assert_eq!(scene.mesh.triangles.len(), 4);
    let area: f64 = (0..3)
        .map(|t| {
            let [a, b, c] = world(&scene, t);
            (b - a).cross(c - a).z / 2.0
        })
        .sum();
    // The face with normals comes first, so the pentagon's 1.5 lacks its last triangle here.
    assert!(area > 0.5 && (0..4).all(|t| face_normal(&scene, t).z > 0.99));
    assert!(scene.cameras.is_empty() && scene.rig.lights.is_empty());
    assert_eq!((scene.materials[0].roughness, scene.materials[0].metallic), (1.0, 0.0));
    assert_eq!(scene.space.origin, DVec3::new(0.5, 1.0, 0.0));
}

#[test]
fn obj_faces_of_several_kinds() {
    // Only some faces have normals or texture coordinates, only some vertices colours; indices point forward.
    let obj = format!(
        "mtllib my materials.mtl\n{OBJ_SQUARE}v 2 2 2 0.5 0 1\nv 4 0 0 2\nusemtl a\nf 1/2/1 2/1/1 3/3/2\nf 1 3 4\n\
         f 1//1 2//1 5//1\nf 2 6 5\nf 1/2 2/1 3/3\nvn 1 0 0\nvn 0 1 0\nvt 0.25\nvt 0.5 0.75 9\nvt 1 1\n"
    );
    let scene = load_obj(&obj, "newmtl a\nKd 1 1 1\nd -halo 0.5\nKa 1\nmap_Kd two texels.png\n");
    let mut corners = std::collections::HashMap::new();
    for (triangle, vertices) in scene.mesh.triangles.iter().enumerate() {
        let of = world(&scene, triangle).map(|p| p.to_array().map(|x| x as i32));
        let uvs = vertices.map(|i| scene.mesh.uvs[0][i as usize].to_array());
        let normals = vertices.map(|i| scene.mesh.normals[i as usize]);
        let colors = vertices.map(|i| scene.mesh.colors[i as usize].truncate());
        corners.entry(of).or_insert_with(Vec::new).push((normals, uvs, colors));
    }
    let [a, b, c, d, tip, far] = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 2, 2], [2, 0, 0]];
    // Vertex colours are sRGB.
    let (white, purple, none) = ([Vec3::ONE; 3], Vec3::new(0.21404114, 0.0, 1.0), [[0.0, 1.0]; 3]);
    let uvs = [[0.5, 0.25], [0.25, 1.0], [1.0, 0.0]];
    let given = [Vec3::X, Vec3::X, Vec3::Y];
    assert_eq!(corners[&[a, b, c]], [(given, uvs, white), ([Vec3::Z; 3], uvs, white)]);
    assert_eq!(corners[&[a, c, d]], [([Vec3::Z; 3], none, white)]);
    assert_eq!(corners[&[a, b, tip]], [([Vec3::X; 3], none, [Vec3::ONE, Vec3::ONE, purple])]);
    assert_eq!(corners[&[b, far, tip]][0].2, [Vec3::ONE, Vec3::ONE, purple]);
}

#[test]
fn obj_materials() {
    let obj = format!(
        "mtllib my materials.mtl\n{OBJ_SQUARE}vt 0 0\nvt 1 0\nvt 1 1\n\
         usemtl shiny one\nf 1/1 2/2 3/3\nusemtl mirror\nf 1 2 3\nusemtl physical\nf 1 2 3\nusemtl missing\nf 1 2 3\n\
         usemtl lambert\nf 1 2 3\n"
    );
    let mtl = "newmtl shiny one\nKd 0.5 0.25 1\nKs 0.5 0.5 0.5\nNs 198\nmap_Kd -s 2 1 1 -clamp on two texels.png\n\
               newmtl mirror\nKd 0.1 0.1 0.1\nKs 0.9 0.8 0.7\nillum 3\n\
               newmtl physical\nKd .8\nPr 0.3\nPm 1\nKe 2 1 0\n\
               newmtl lambert\nKd 0.5 0.5 0.5\nKs 0 0 0\n";
    let scene = load_obj(&obj, mtl);
    let [shiny, mirror, physical, missing, lambert] = &scene.materials[..] else { panic!() };
    // alpha² = 2 / 200.
    assert!((shiny.roughness.powi(4) - 0.01).abs() < 1e-6);
    assert_eq!((shiny.base_color, shiny.specular_color), (Vec4::new(0.5, 0.25, 1.0, 1.0), Vec3::ONE));
    let texture = shiny.base_color_texture.unwrap();
    assert_eq!((scene.textures[texture.texture].name.as_str(), texture.wrap[0]), ("two texels.png", Wrap::Clamp));
    assert_eq!((mirror.roughness, mirror.metallic), (0.0, 1.0));
    assert_eq!(mirror.base_color, Vec4::new(0.9, 0.8, 0.7, 1.0));
    assert_eq!((physical.roughness, physical.metallic, physical.emissive), (0.3, 1.0, Vec3::new(2.0, 1.0, 0.0)));
    assert_eq!(physical.base_color, Vec4::new(0.8, 0.8, 0.8, 1.0));
    assert_eq!((missing.roughness, missing.metallic, missing.base_color), (1.0, 0.0, Vec4::ONE));
    assert_eq!(lambert.specular, 0.0);
    // v grows upwards in OBJ.
    assert_eq!(scene.mesh.uvs[0][0], Vec2::new(0.0, 1.0));
    let uv = (texture.uv_transform * Vec3::new(0.5, 1.0, 1.0)).truncate();
    assert!(uv.distance(Vec2::new(1.0, 1.0)) < 1e-6, "{uv}");
}

/// Names with the sign of comments, an image that only its name says what it is, and a normal that is no number.
#[test]
fn obj_files_of_other_programs() {
    let folder = tempfile::tempdir().unwrap();
    let mut tga = vec![0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 24, 0x20];
    tga.extend([10, 20, 30]); // blue first
    write(folder.path(), "brick#3.tga", &tga);
    let mtl = "newmtl Material #25 # both\nKd 0.1 0.1 0.1\nnewmtl Material #26\nmap_Kd brick#3.tga\n";
    write(folder.path(), "lib #1.mtl", mtl.as_bytes());
    let obj = format!(
        "mtllib lib #1.mtl\n{OBJ_SQUARE}vn nan 0 1\nvt 0 0\n\
         usemtl Material #25 # both\nf 1//1 2//1 3//1 # tip\nusemtl Material #26\nf 1/1 3/1 4/1\n"
    );
    let scene = Scene::load(&write(folder.path(), "scene.obj", obj.as_bytes())).unwrap();
    assert_eq!(scene.materials[0].base_color, Vec4::new(0.1, 0.1, 0.1, 1.0));
    assert!(scene.materials[1].base_color_texture.is_some());
    let texture = &scene.textures[0];
    let texel = texture.sample(Vec2::ZERO, [Wrap::Repeat; 2], 0.0);
    let red = ((30.0f32 / 255.0 + 0.055) / 1.055).powf(2.4);
    assert!((texel.x - red).abs() < 1e-4 && texel.z < texel.x, "{texel}");
    assert_eq!(scene.mesh.normals[0], Vec3::Z);
}

/// Marks of encodings, line ends of old Macs, colours from 0 to 255, and a library at a path of another machine.
#[test]
fn obj_files_in_other_encodings() {
    let text = "newmtl m\nKd 0.25 0.5 0.75\n";
    let wide: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
    let utf_16 = [&[0xfe, 0xff][..], &wide].concat();
    let utf_8 = ["\u{feff}", text].concat().into_bytes();
    for mtl in [utf_8, utf_16, text.replace('\n', "\r").into_bytes()] {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "a.mtl", &mtl);
        let obj = format!(
            "\u{feff}mtllib C:\\scans\\a.mtl # by hand\nusemtl m\n{}f 1 2 3\n",
            OBJ_SQUARE.replace("v 0 0 0\n", "v 0 0 0 255 0 51\n")
        );
        let scene = Scene::load(&write(folder.path(), "scene.obj", obj.as_bytes())).unwrap();
        assert_eq!(scene.materials[0].base_color, Vec4::new(0.25, 0.5, 0.75, 1.0));
        let color = scene.mesh.colors.iter().find(|color| color.y == 0.0).unwrap();
        assert!(color.x == 1.0 && (color.z - 0.0331).abs() < 1e-4, "{color}");
    }
}

#[test]
fn cameras_say_how_wide_their_picture_is() {
    let mut gltf = Gltf::square();
    gltf.json["cameras"] = json!([
        {"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1, "aspectRatio": 0.5}},
        {"type": "orthographic", "orthographic": {"xmag": 3.0, "ymag": 2.0, "znear": 0, "zfar": 1}},
        {"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1, "aspectRatio": 1e9}}]);
    (0..3).for_each(|camera| _ = gltf.root(json!({ "camera": camera })));
    let scene = load(&gltf);
    let sizes = scene.cameras.iter().map(|camera| scene.default_size(Some(camera)));
    assert_eq!(sizes.collect::<Vec<_>>(), [[240, 480], [720, 480], [720, 480]]);
    assert_eq!(scene.cameras[1].aspect, Some(1.5));
    gltf.json["scenes"][0]["extras"] = json!({"width": 100, "height": 50});
    let scene = load(&gltf);
    assert_eq!(scene.default_size(Some(&scene.cameras[0])), [100, 50]);
}

/// Half of each of two joints: one stays, one turns by 90 degrees about x and goes up by 1. The node's own place says
/// nothing.
#[test]
fn skins_blend_their_joints() {
    let mut gltf = Gltf::square();
    let joints = gltf.accessor(&[0, 1, 0, 0].repeat(4), UNSIGNED_BYTE, "VEC4", 4);
    let weights = gltf.accessor(&[128, 128, 0, 0].repeat(4), UNSIGNED_BYTE, "VEC4", 4);
    gltf.json["accessors"][weights]["normalized"] = true.into();
    let attributes = &mut gltf.json["meshes"][0]["primitives"][0]["attributes"];
    (attributes["JOINTS_0"], attributes["WEIGHTS_0"]) = (joints.into(), weights.into());
    let inverse_binds = gltf.accessor(
        &[glam::Mat4::IDENTITY, glam::Mat4::from_translation(Vec3::Y)]
            .iter()
            .flat_map(|m| m.to_cols_array())
            .flat_map(f32::to_le_bytes)
            .collect::<Vec<u8>>(),
        FLOAT,
        "MAT4",
        2,
    );
    let still = gltf.root(json!({"name": "still"}));
    let half = 0.5f64.sqrt();
    let turned = gltf.root(json!({"name": "turned", "rotation": [half, 0.0, 0.0, half]}));
    gltf.json["skins"] = json!([{"joints": [still, turned], "inverseBindMatrices": inverse_binds}]);
    gltf.json["nodes"][0]["skin"] = 0.into();
    gltf.json["nodes"][0]["translation"] = json!([100.0, 0.0, 0.0]);
    gltf.json["nodes"][0]["scale"] = json!([0.0, 0.0, 0.0]);
    let scene = load(&gltf);
    // (x, y, 0) and (x, 0, y + 1), the turned one.
    let [a, b, c] = world(&scene, 0);
    assert_near(a, DVec3::new(0.0, 0.0, 0.5), 1e-6);
    assert_near(b, DVec3::new(1.0, 0.0, 0.5), 1e-6);
    assert_near(c, DVec3::new(1.0, 0.5, 1.0), 1e-6);
    // Halfway between +z and -y.
    assert!(scene.mesh.normals[0].distance(Vec3::new(0.0, -half as f32, half as f32)) < 1e-6);
    assert_near(face_normal(&scene, 0), DVec3::new(0.0, -half, half), 1e-6);
}

#[test]
fn morph_targets_are_weighted_and_added() {
    let mut gltf = Gltf::square();
    let up = gltf.f32s(&[[0.0, 2.0, 0.0]; 4]);
    let tilt = gltf.f32s(&[[1.0, 0.0, 0.0]; 4]);
    let none = gltf.push("accessors", json!({"componentType": FLOAT, "type": "VEC3", "count": 4}));
    gltf.json["meshes"][0]["primitives"][0]["targets"] =
        json!([{"POSITION": up}, {"POSITION": none, "NORMAL": tilt}, {"POSITION": up}]);
    gltf.json["meshes"][0]["weights"] = json!([1.0, 0.0, 0.0]);
    assert_near(world(&load(&gltf), 0)[0], DVec3::new(0.0, 2.0, 0.0), 1e-6);
    // The node's weights go first; what lacks a weight has none.
    gltf.json["nodes"][0]["weights"] = json!([0.25, 1.0]);
    let scene = load(&gltf);
    assert_near(world(&scene, 0)[0], DVec3::new(0.0, 0.5, 0.0), 1e-6);
    let half = 0.5f32.sqrt();
    assert!(scene.mesh.normals[0].distance(Vec3::new(half, 0.0, half)) < 1e-6);
}

#[test]
fn copies_stand_where_their_attributes_say() {
    let mut gltf = Gltf::square();
    let translations = gltf.f32s(&[[0.0; 3], [10.0, 0.0, 0.0]]);
    let scales = gltf.f32s(&[[1.0; 3], [2.0, 3.0, 1.0]]);
    // A half turn about z, as normalised 16-bit integers.
    let rotations: Vec<u8> = [0i16, 0, 0, 32_767, 0, 0, 32_767, 0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let rotations = gltf.accessor(&rotations, SHORT, "VEC4", 2);
    gltf.json["accessors"][rotations]["normalized"] = true.into();
    let attributes = json!({"TRANSLATION": translations, "SCALE": scales, "ROTATION": rotations});
    gltf.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    gltf.json["nodes"][0]["translation"] = json!([0.0, 0.0, 5.0]);
    let scene = load(&gltf);
    assert_eq!(scene.mesh.triangles.len(), 4);
    assert_near(world(&scene, 0)[1], DVec3::new(1.0, 0.0, 5.0), 1e-5);
    // Corner (1, 1, 0): scaled, turned, moved.
    assert_near(world(&scene, 2)[2], DVec3::new(8.0, -3.0, 5.0), 1e-5);
}

/// Two materials that read sets 2 and 5 of one mesh each, and one that reads three.
#[test]
fn any_set_of_texture_coordinates() {
    let mut gltf = Gltf::square();
    let image = gltf.view(&png(1, 1, &[[255; 4]]));
    gltf.json["images"] = json!([{"bufferView": image, "mimeType": "image/png"}]);
    gltf.json["textures"] = json!([{"source": 0}]);
    let texture = |set: u32| json!({"index": 0, "texCoord": set});
    gltf.json["materials"] = json!([
        {"pbrMetallicRoughness": {"baseColorTexture": texture(2)}},
        {"pbrMetallicRoughness": {"baseColorTexture": texture(5)}, "emissiveTexture": texture(1)},
        {"pbrMetallicRoughness": {"baseColorTexture": texture(0), "metallicRoughnessTexture": texture(3)},
            "emissiveTexture": texture(4)}]);
    let mut primitive = gltf.json["meshes"][0]["primitives"][0].clone();
    for set in 0..6u16 {
        let uvs = gltf.f32s(&[[f32::from(set), 0.5]; 4]);
        primitive["attributes"][format!("TEXCOORD_{set}")] = uvs.into();
    }
    let with = |material: usize| {
        let mut primitive = primitive.clone();
        primitive["material"] = material.into();
        primitive
    };
    gltf.json["meshes"][0]["primitives"] = (0..3).map(with).collect();
    let scene = load(&gltf);
    let read = |material: usize, texture: &Option<relume::scene::TextureRef>| {
        let vertex = scene.mesh.triangles[2 * material][0] as usize;
        texture.as_ref().map(|t| scene.mesh.uvs[t.uv_set][vertex].x)
    };
    let [two, five, three] = &scene.materials[..] else { panic!("{} materials", scene.materials.len()) };
    assert_eq!(read(0, &two.base_color_texture), Some(2.0));
    assert_eq!((read(1, &five.base_color_texture), read(1, &five.emissive_texture)), (Some(5.0), Some(1.0)));
    // The third of three has no room.
    assert_eq!((read(2, &three.base_color_texture), read(2, &three.emissive_texture)), (Some(0.0), None));
    assert_eq!(read(2, &three.metallic_roughness_texture), Some(3.0));
}

/// Of older files: reflectance is a colour, and alpha is glossiness.
#[test]
fn specular_glossiness_becomes_roughness() {
    let mut gltf = textured();
    let glossy = |gltf: &mut Gltf, values: serde_json::Value| {
        gltf.json["materials"] = json!([{ "extensions": { "KHR_materials_pbrSpecularGlossiness": values } }]);
        load(gltf)
    };
    let factors = json!({ "diffuseFactor": [0.5, 0.25, 0.125, 1.0], "specularFactor": [0.04, 0.5, 1.0],
        "glossinessFactor": 0.75 });
    let material = glossy(&mut gltf, factors).materials[0].clone();
    assert_eq!((material.base_color, material.metallic), (Vec4::new(0.5, 0.25, 0.125, 1.0), 0.0));
    assert_eq!((material.roughness, material.specular_color), (0.25, Vec3::new(1.0, 12.5, 25.0)));
    let scene = glossy(&mut gltf, json!({ "glossinessFactor": 0.5, "specularGlossinessTexture": { "index": 0 } }));
    let material = &scene.materials[0];
    let texture = material.metallic_roughness_texture.unwrap().texture;
    // The image is opaque.
    assert_eq!(
        (material.roughness, scene.textures[texture].sample(Vec2::new(0.25, 0.5), [Wrap::Repeat; 2], 0.0).y),
        (1.0, 128.0 / 255.0)
    );
    assert_ne!(material.specular_color_texture.unwrap().texture, texture);
}

#[test]
fn unlit_materials_emit_their_base_colour() {
    let mut gltf = Gltf::square();
    gltf.json["materials"] = json!([{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1.0, 1.0]},
        "emissiveFactor": [1, 1, 1], "extensions": {"KHR_materials_unlit": {}}}]);
    gltf.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    let material = load(&gltf).materials[0].clone();
    assert_eq!(material.emissive, Vec3::new(0.5, 0.25, 1.0));
    assert_eq!((material.base_color.truncate(), material.specular, material.metallic), (Vec3::ZERO, 0.0, 0.0));
}

/// A closed tetrahedron, its faces turned inwards, alone and around another one.
#[test]
fn closed_surfaces_of_obj_that_face_inwards_are_turned() {
    let tetrahedron = |size: f64, first: usize, faces: [[usize; 3]; 4]| {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        // Its middle is the origin's, whatever its size.
        let corner = |c: [f64; 3]| c.map(|x| format!("{}", (x - 0.25) * size)).join(" ");
        let vertices: String = corners.map(|c| format!("v {}\n", corner(c))).concat();
        vertices + &faces.map(|f| format!("f {} {} {}\n", f[0] + first, f[1] + first, f[2] + first)).concat()
    };
    let outwards = [[1, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]];
    let inwards = outwards.map(|[a, b, c]| [a, c, b]);
    let volume = |text: String| {
        let folder = tempfile::tempdir().unwrap();
        let scene = Scene::load(&write(folder.path(), "x.obj", text.as_bytes())).unwrap();
        let of = |t: usize| world(&scene, t)[0].dot(world(&scene, t)[1].cross(world(&scene, t)[2]));
        (0..scene.mesh.triangles.len()).map(of).sum::<f64>()
    };
    assert!((volume(tetrahedron(1.0, 0, outwards)) - 1.0).abs() < 1e-5);
    assert!((volume(tetrahedron(1.0, 0, inwards)) - 1.0).abs() < 1e-5);
    // Open: as it is.
    let open = tetrahedron(1.0, 0, inwards).rsplit_once("f ").unwrap().0.to_owned();
    assert!(volume(open) < 0.0);
    // A room around something stays, and so does the inside of a vessel.
    let room = tetrahedron(10.0, 0, inwards) + &tetrahedron(1.0, 4, outwards);
    assert!((volume(room) - (1.0 - 1000.0)).abs() < 1e-2);
    let vessel = tetrahedron(1.0, 0, outwards) + &tetrahedron(0.8, 4, inwards);
    assert!((volume(vessel) - (1.0 - 0.512)).abs() < 1e-4);
}
