//! Hostile files: every one ends in an `Error` that names the file, none in a panic, a hang or an abort.

mod support;

use std::path::Path;

use glam::Vec3;
use proptest::prelude::*;
use relume::Error;
use relume::scene::{Rig, Scene, export_gltf};
use relume::trace::bvh::TracedScene;
use serde_json::{Value, json};
use support::*;

/// The error's own line and its causes.
fn chain(error: &Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

#[track_caller]
fn assert_refused(path: &Path, says: &str) {
    let Err(error) = Scene::load(path) else { panic!("{}: loaded, should say: {says}", path.display()) };
    let name = path.file_name().unwrap().to_str().unwrap();
    let text = chain(&error);
    assert!(error.to_string().contains(name), "\"{error}\" does not name {name}");
    assert!(!error.to_string().contains('\n'), "{error}");
    assert!(text.contains(says), "says: {text}\nnot: {says}");
}

#[track_caller]
fn assert_bytes_refused(name: &str, bytes: &[u8], says: &str) {
    let folder = tempfile::tempdir().unwrap();
    assert_refused(&write(folder.path(), name, bytes), says);
}

/// Changes a good file and expects a refusal.
#[track_caller]
fn assert_change_refused(says: &str, change: impl FnOnce(&mut Gltf)) {
    let mut gltf = full();
    change(&mut gltf);
    assert_bytes_refused("hostile.glb", &gltf.to_glb(), says);
}

/// A file with something of everything.
fn full() -> Gltf {
    let mut gltf = Gltf::square();
    let uvs = gltf.f32s(&[[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]);
    let colors = gltf.accessor(&[128; 16], UNSIGNED_BYTE, "VEC4", 4);
    gltf.json["accessors"][colors]["normalized"] = true.into();
    let sparse_at = gltf.view(&[0, 0]);
    let sparse_to = gltf.view(&[0; 12]);
    gltf.json["accessors"][0]["sparse"] = json!({"count": 1,
        "indices": {"bufferView": sparse_at, "componentType": UNSIGNED_BYTE}, "values": {"bufferView": sparse_to}});
    let image = png(2, 2, &[[1, 2, 3, 4]; 4]);
    let image = gltf.view(&image);
    let primitive = &mut gltf.json["meshes"][0]["primitives"][0];
    primitive["attributes"]["TEXCOORD_0"] = uvs.into();
    primitive["attributes"]["COLOR_0"] = colors.into();
    primitive["material"] = 0.into();
    gltf.json["images"] = json!([{"bufferView": image, "mimeType": "image/png"}]);
    gltf.json["samplers"] = json!([{}]);
    gltf.json["textures"] = json!([{"source": 0, "sampler": 0}]);
    gltf.json["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
        "normalTexture": {"index": 0}, "emissiveFactor": [0.0, 0.0, 0.0]}]);
    gltf.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]);
    gltf.light(json!({"type": "spot", "intensity": 5.0, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}}));
    gltf.root(json!({"name": "eye", "camera": 0}));
    gltf.root(json!({"name": "lamp", "extensions": {"KHR_lights_punctual": {"light": 0}}}));
    gltf
}

/// The same, with a rectangle, a point with an IES profile, and an environment.
fn full_of_lights() -> Gltf {
    let mut gltf = full();
    gltf.light_of("EXT_lights_area", json!({"type": "rect", "intensity": 5.0, "size": 2.0, "rect": {"aspect": 0.5}}));
    gltf.root(json!({"name": "panel", "extensions": {"EXT_lights_area": {"light": 0}}}));
    let ies = gltf.view(b"TILT=NONE\n1 -1 1 3 1 1 2 0 0 0 1 1 9 0 45 90 0 250 200 10\n");
    gltf.light_of("EXT_lights_ies", json!({"bufferView": ies, "mimeType": "application/x-ies-lm-63"}));
    let ies = json!({"EXT_lights_ies": {"light": 0, "multiplier": 2.0, "color": [1.0, 0.5, 0.25]}});
    gltf.root(json!({"name": "downlight", "extensions": ies}));
    let environment = gltf.environment(&[2, 2, 2, 2, 2, 2].map(|side| png(side, side, &[[1, 2, 3, 4]; 4])));
    environment["rotation"] = json!([0.1, 0.2, 0.3, 0.9]);
    environment["intensity"] = json!(2.0);
    gltf
}

#[test]
fn the_good_files_are_good() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::load(&full().write(folder.path(), "good.glb")).unwrap();
    assert_eq!((scene.mesh.triangles.len(), scene.textures.len(), scene.rig.lights.len()), (2, 2, 1));
    let scene = Scene::load(&full_of_lights().write(folder.path(), "good.glb")).unwrap();
    assert_eq!(scene.rig.lights.len(), 4);
    write(folder.path(), "x.mtl", MTL.as_bytes());
    write(folder.path(), "x.png", &png(1, 1, &[[1, 2, 3, 4]]));
    let scene = Scene::load(&write(folder.path(), "x.obj", OBJ.as_bytes())).unwrap();
    assert_eq!((scene.mesh.triangles.len(), scene.textures.len(), scene.materials.len()), (5, 2, 2));
}

#[test]
fn files_that_are_not_there_or_not_files() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["none.glb", "none.gltf", "none.obj"] {
        assert_refused(&folder.path().join(name), "cannot open");
        std::fs::create_dir(folder.path().join(format!("folder-{name}"))).unwrap();
        assert_refused(&folder.path().join(format!("folder-{name}")), "not a regular file");
    }
    assert_refused(&write(folder.path(), "scene.fbx", b"x"), "expected .glb, .gltf or .obj");
    assert_refused(&write(folder.path(), "scene", b"x"), "expected .glb, .gltf or .obj");
}

#[test]
fn containers() {
    let good = full().to_glb();
    let at = |at: usize, value: u32| {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    assert_bytes_refused("x.glb", b"", "does not begin with \"glTF\"");
    assert_bytes_refused("x.glb", b"glT", "does not begin with \"glTF\"");
    assert_bytes_refused("x.glb", b"PK\x03\x04 zip", "does not begin with \"glTF\"");
    assert_bytes_refused("x.glb", b"glTF\x02\0\0\0", "ends inside the .glb header");
    assert_bytes_refused("x.glb", &at(4, 1), "version 1");
    // Less than the header itself: where the gltf crate's own reader underflows.
    assert_bytes_refused("x.glb", &at(8, 0), "no JSON chunk");
    assert_bytes_refused("x.glb", &at(8, 11), "no JSON chunk");
    assert_bytes_refused("x.glb", &at(8, u32::MAX), "is cut off");
    assert_bytes_refused("x.glb", &at(12, u32::MAX), "chunk 0 claims 4294967295 bytes");
    assert_bytes_refused("x.glb", &at(12, 0), "");
    assert_bytes_refused("x.glb", &at(16, 7), "first chunk is not JSON");
    assert_bytes_refused("x.glb", &good[..good.len() - 1], "is cut off");
    for length in 0..good.len() {
        let folder = tempfile::tempdir().unwrap();
        assert_refused(&write(folder.path(), "cut.glb", &good[..length]), "");
    }
}

#[test]
fn json() {
    for (text, says) in [
        ("", "EOF"),
        ("{", "EOF"),
        ("[]", ""),
        ("null", ""),
        ("{}", "asset"),
        ("{\"asset\": {\"version\": 2}}", "expected a string"),
        ("{\"asset\": {\"version\": \"1.0\"}}", "is glTF 1.0"),
        ("{\"asset\": {\"version\": \"2.0\", \"minVersion\": \"2.1\"}}", "at least 2.1"),
        ("{\"asset\": {\"version\": \"2.0\"}, \"nodes\": 3}", ""),
        ("{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [{\"translation\": [1e999, 0, 0]}]}", "out of range"),
        ("{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [{\"mesh\": -1}]}", ""),
        ("{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [{\"mesh\": 1.5}]}", ""),
        ("{\"asset\": {\"version\": \"2.0\"}, \"scene\": 9}", "names scene 9"),
        ("\u{1}\u{2}", ""),
    ] {
        assert_bytes_refused("x.gltf", text.as_bytes(), says);
        assert_bytes_refused("x.glb", &glb(text.as_bytes(), b""), "");
    }
    assert_bytes_refused("x.gltf", &[0xff; 64], "");
    assert_bytes_refused("x.gltf", "[".repeat(1 << 20).as_bytes(), "");
    let deep =
        format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"extras\": {}1{}}}", "[".repeat(1 << 17), "]".repeat(1 << 17));
    // Extras mean nothing to us, however deep they are; their reader must not recurse.
    _ = Scene::load(&write(tempfile::tempdir().unwrap().path(), "x.gltf", deep.as_bytes()));
}

#[test]
fn extensions() {
    assert_change_refused("requires EXT_unknown, which is not supported", |g| {
        g.json["extensionsRequired"] = json!(["KHR_lights_punctual", "EXT_unknown"]);
    });
    assert_change_refused("requires EXT_one, EXT_two, which are not supported", |g| {
        g.json["extensionsRequired"] = json!(["EXT_one", "KHR_materials_sheen", "EXT_two"]);
    });
    assert_change_refused("image 0 is KTX2", |g| g.json["images"][0]["mimeType"] = "image/ktx2".into());
    assert_change_refused("texture 0 is KTX2", |g| {
        g.json["textures"][0] = json!({"extensions": {"KHR_texture_basisu": {"source": 0}}});
    });
}

#[test]
fn indices_out_of_range() {
    assert_change_refused("the scene names node 99, there are 3", |g| g.json["scenes"][0]["nodes"] = json!([99]));
    assert_change_refused("names scene 4", |g| g.json["scene"] = 4.into());
    assert_change_refused("node 0 names node 77", |g| g.json["nodes"][0]["children"] = json!([77]));
    assert_change_refused("node 0 names mesh 5", |g| g.json["nodes"][0]["mesh"] = 5.into());
    assert_change_refused("node 1 \"eye\" names camera 5", |g| g.json["nodes"][1]["camera"] = 5.into());
    assert_change_refused("node 2 \"lamp\" names light 5", |g| {
        g.json["nodes"][2]["extensions"]["KHR_lights_punctual"]["light"] = 5.into();
    });
    assert_change_refused("names material 8", |g| g.json["meshes"][0]["primitives"][0]["material"] = 8.into());
    assert_change_refused("names texture 8", |g| g.json["materials"][0]["normalTexture"]["index"] = 8.into());
    assert_change_refused("names image 8", |g| g.json["textures"][0]["source"] = 8.into());
    assert_change_refused("names sampler 8", |g| g.json["textures"][0]["sampler"] = 8.into());
    assert_change_refused("has no image that we can read", |g| g.json["textures"][0] = json!({}));
    assert_change_refused("image 0 names buffer view 88", |g| g.json["images"][0]["bufferView"] = 88.into());
    for attribute in ["POSITION", "NORMAL", "TEXCOORD_0", "COLOR_0", "TANGENT"] {
        let says = format!("mesh 0, primitive 0{} names accessor 66", if attribute == "POSITION" { "" } else { ": " });
        assert_change_refused(says.split(':').next().unwrap(), |g| {
            g.json["meshes"][0]["primitives"][0]["attributes"][attribute] = 66.into();
        });
    }
    assert_change_refused("names accessor 66", |g| g.json["meshes"][0]["primitives"][0]["indices"] = 66.into());
    assert_change_refused("names accessor 4294967295", |g| {
        g.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = u32::MAX.into();
    });
    assert_change_refused("names buffer view 55", |g| g.json["accessors"][0]["bufferView"] = 55.into());
    assert_change_refused("names buffer 3", |g| g.json["bufferViews"][0]["buffer"] = 3.into());
    assert_change_refused("sparse names buffer view 55", |g| {
        g.json["accessors"][0]["sparse"]["values"]["bufferView"] = 55.into();
    });
    assert_change_refused("index 4 is out of range, there are 4 vertices", |g| {
        let indices = g.indices(&[0, 1, 4]);
        g.json["meshes"][0]["primitives"][0]["indices"] = indices.into();
    });
    assert_change_refused("index 65535 is out of range", |g| {
        let indices = g.indices(&[0, 1, 65_535]);
        g.json["meshes"][0]["primitives"][0]["indices"] = indices.into();
    });
    assert_change_refused("index 200 is out of range, there are 4 elements", |g| {
        let at = g.view(&[200]);
        g.json["accessors"][0]["sparse"]["indices"]["bufferView"] = at.into();
    });
    assert_change_refused("7 indices are not a multiple of three", |g| {
        let indices = g.indices(&[0, 1, 2, 0, 2, 3, 0]);
        g.json["meshes"][0]["primitives"][0]["indices"] = indices.into();
    });
}

#[test]
fn accessors_that_overrun() {
    let huge = 1u64 << 60;
    for (key, value) in [
        ("count", json!(5)),
        ("count", json!(huge)),
        ("count", json!(u64::MAX)),
        ("byteOffset", json!(4)),
        ("byteOffset", json!(huge)),
        ("byteOffset", json!(u64::MAX)),
    ] {
        // Positions; then normals, which nothing counts before.
        for accessor in [0, 1] {
            assert_change_refused("", |g| g.json["accessors"][accessor][key] = value.clone());
        }
    }
    for (key, value) in [
        ("byteLength", json!(47)),
        ("byteLength", json!(u64::MAX)),
        ("byteOffset", json!(1u64 << 40)),
        ("byteOffset", json!(u64::MAX)),
    ] {
        assert_change_refused("overrun a", |g| g.json["bufferViews"][0][key] = value);
    }
    assert_change_refused("stride 4 is less than", |g| g.json["bufferViews"][0]["byteStride"] = 4.into());
    assert_change_refused("overrun a view", |g| g.json["bufferViews"][0]["byteStride"] = 16.into());
    assert_change_refused("overrun a view", |g| g.json["bufferViews"][0]["byteStride"] = json!(u64::MAX));
    assert_change_refused("sparse: 1000000 elements", |g| g.json["accessors"][0]["sparse"]["count"] = 1_000_000.into());
    assert_change_refused("elements and no buffer view", |g| {
        g.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        g.json["accessors"][0]["count"] = json!(40_000_000);
    });
    assert_change_refused("more than 134217728 corners", |g| {
        g.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        g.json["accessors"][0]["count"] = json!(u64::MAX);
    });
    assert_change_refused("buffer 0 claims 99999999 bytes", |g| {
        g.json["buffers"] = json!([{"byteLength": 99_999_999}]);
    });
    assert_change_refused("buffer 1 has neither", |g| {
        g.json["buffers"] = json!([{"byteLength": g.bin.len()}, {"byteLength": 4}]);
    });
}

#[test]
fn accessors_of_the_wrong_kind() {
    let set = |accessor: usize, key: &'static str, value: Value| {
        move |g: &mut Gltf| g.json["accessors"][accessor][key] = value
    };
    assert_change_refused("POSITION: accessor 0: the type is not defined by glTF", set(0, "type", json!("VEC9")));
    assert_change_refused("is not of type Vec3", set(0, "type", json!("MAT4")));
    assert_change_refused("the component type is not defined by glTF", set(0, "componentType", json!(5124)));
    assert_change_refused("holds U32, which is not allowed", set(0, "componentType", json!(UNSIGNED_INT)));
    assert_change_refused("holds I16 without KHR_mesh_quantization", set(0, "componentType", json!(SHORT)));
    assert_change_refused("holds U16, which is not allowed", set(1, "componentType", json!(UNSIGNED_SHORT)));
    assert_change_refused("holds F32, which is not allowed", set(2, "componentType", json!(FLOAT)));
    assert_change_refused("holds U8, which is not allowed", set(4, "normalized", json!(false)));
    assert_change_refused("3 of NORMAL for 4 of POSITION", set(1, "count", json!(3)));
    assert_change_refused("the mode is not defined by glTF", |g| {
        g.json["meshes"][0]["primitives"][0]["mode"] = 7.into();
    });
}

#[test]
fn numbers_that_are_none() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_change_refused("POSITION: vertex 1 is not finite", |g| {
            g.bin[12..16].copy_from_slice(&bad.to_le_bytes());
        });
        assert_change_refused("COLOR_0: vertex 0 is not finite", |g| {
            let colors = g.f32s(&[[bad, 0.0, 0.0]; 4]);
            g.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = colors.into();
        });
    }
    assert_change_refused("too large", |g| g.json["nodes"][0]["scale"] = json!([1e30, 1e30, 1e30]));
    // Each scale fits single precision, their product no precision.
    let blow_up = |g: &mut Gltf, node: usize| {
        let first = (0..11).fold(node, |child, _| g.node(json!({"children": [child], "scale": [1e30, 1e30, 1e30]})));
        g.json["scenes"][0]["nodes"] = json!([first]);
    };
    assert_change_refused("node 0: its transform is not finite", |g| blow_up(g, 0));
    assert_change_refused("node 0: the last row of its matrix", |g| {
        g.json["nodes"][0]["matrix"] = json!([1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    });
    assert_change_refused("node 0: its rotation is not a quaternion", |g| {
        g.json["nodes"][0]["rotation"] = json!([0, 0, 0, 0]);
    });
    assert_change_refused("out of range", |g| g.json["nodes"][0]["rotation"] = json!([1e300, 0, 0, 1e300]));
    assert_change_refused("", |g| g.json["nodes"][0]["translation"] = json!([0, 0]));
    for (node, what) in [(1, "camera 0 of node 1 \"eye\""), (2, "light 0 of node 2 \"lamp\"")] {
        assert_change_refused(what, |g| {
            g.json["nodes"][node]["translation"] = json!([1, 0, 0]);
            blow_up(g, node);
            g.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(0.into());
        });
    }
}

#[test]
fn a_singular_node_above_nothing_does_not_matter() {
    let mut gltf = full();
    let child = gltf.node(json!({"name": "bone"}));
    gltf.root(json!({"children": [child], "scale": [0, 0, 0]}));
    let folder = tempfile::tempdir().unwrap();
    assert!(Scene::load(&gltf.write(folder.path(), "x.glb")).is_ok());
}

#[test]
fn nodes_that_are_no_tree() {
    let ancestor = "is its own ancestor or has two parents";
    assert_change_refused(ancestor, |g| g.json["nodes"][0]["children"] = json!([0]));
    assert_change_refused(ancestor, |g| {
        g.json["nodes"][0]["children"] = json!([1]);
        g.json["nodes"][1]["children"] = json!([0]);
        g.json["scenes"][0]["nodes"] = json!([0]);
    });
    assert_change_refused(ancestor, |g| g.json["scenes"][0]["nodes"] = json!([0, 0]));
    // Each level twice the one before: 2^64 nodes if it were believed.
    assert_change_refused(ancestor, |g| {
        let nodes: Vec<Value> =
            (0..64).map(|i| json!({"children": [i + 1, i + 1]})).chain([json!({"mesh": 0})]).collect();
        g.json["nodes"] = nodes.into();
        g.json["scenes"][0]["nodes"] = json!([0]);
    });
}

/// Changes a good file and expects so many triangles, lights and cameras.
#[track_caller]
fn assert_change_opens(counts: [usize; 3], change: impl FnOnce(&mut Gltf)) {
    let mut gltf = full();
    change(&mut gltf);
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::load(&gltf.write(folder.path(), "odd.glb")).unwrap_or_else(|e| panic!("{}", chain(&e)));
    assert_eq!([scene.mesh.triangles.len(), scene.rig.lights.len(), scene.cameras.len()], counts);
    // Rays find nothing in an empty scene, and do find that out.
    let scene = TracedScene::new(scene);
    if counts[0] == 0 {
        assert_eq!(scene.closest_hit(Vec3::Z, Vec3::NEG_Z, f32::INFINITY), None);
    }
}

#[test]
fn scenes_with_nothing_to_see_open() {
    assert_change_opens([0, 1, 1], |g| g.json["scenes"][0]["nodes"] = json!([1, 2]));
    assert_change_opens([0, 1, 1], |g| g.json["meshes"][0]["primitives"] = json!([]));
    assert_change_opens([0, 1, 1], |g| g.bin[..48].fill(0));
    assert_change_opens([0, 1, 1], |g| g.json["meshes"][0]["primitives"][0]["mode"] = 0.into());
    assert_change_opens([0, 1, 1], |g| {
        g.json["meshes"][0]["primitives"][0]["attributes"] = json!({"NORMAL": 1});
    });
    assert_change_opens([0, 0, 0], |g| g.json["scenes"] = json!([{}, {"nodes": [0]}]));
    assert_change_opens([2, 1, 1], |g| g.json["scenes"].as_array_mut().unwrap().push(json!({"name": "empty"})));
    // Without a scene, a ring has no root.
    assert_change_opens([0, 0, 0], |g| {
        g.json["nodes"] = json!([{"children": [1], "mesh": 0}, {"children": [0]}]);
        g.json.as_object_mut().unwrap().remove("scenes");
        g.json.as_object_mut().unwrap().remove("scene");
    });
}

#[test]
fn objects_of_no_size_vanish() {
    for scale in [json!([0, 1, 1]), json!([0, 0, 0])] {
        assert_change_opens([0, 1, 1], |g| g.json["nodes"][0]["scale"] = scale);
    }
    // The square is flat along z anyway.
    assert_change_opens([2, 1, 1], |g| g.json["nodes"][0]["scale"] = json!([1, 1, 0]));
    assert_change_opens([0, 1, 1], |g| {
        g.json["nodes"][0]["matrix"] = json!([1, 2, 3, 0, 2, 4, 6, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    });
    assert_change_opens([2, 1, 0], |g| g.json["nodes"][1]["scale"] = json!([0, 0, 0]));
    assert_change_opens([2, 0, 1], |g| g.json["nodes"][2]["scale"] = json!([0, 0, 0]));
}

#[test]
fn what_is_clear_all_the_same_opens() {
    assert_change_opens([2, 1, 1], |g| {
        g.json["animations"] = json!([{"channels": [{"sampler": 0, "target": {"path": "pointer"}}], "samplers": []}]);
        g.json["scene"] = json!(0.0);
        g.json["accessors"][0]["count"] = json!(4.0);
    });
    assert_change_opens([2, 1, 1], |g| {
        g.json["extensions"]["KHR_lights_punctual"]["lights"][0]["intensity"] = json!(-5.0);
    });
    assert_change_opens([2, 1, 1], |g| {
        g.json["materials"][0]["extensions"] = json!({"KHR_materials_ior": {"ior": 0.9}});
    });
}

#[test]
fn a_small_file_that_means_too_much() {
    let mut gltf = Gltf::new();
    let positions = gltf.push("accessors", json!({"componentType": FLOAT, "type": "VEC3", "count": 1 << 24}));
    gltf.mesh(json!({"attributes": {"POSITION": positions}, "mode": 5}));
    for _ in 0..1_000 {
        gltf.root(json!({"mesh": 0}));
    }
    assert_bytes_refused("x.glb", &gltf.to_glb(), "corners of triangles");
}

/// Files that would take quadratic time if each item looked at all before it.
#[test]
fn many_alike() {
    let folder = tempfile::tempdir().unwrap();
    let mut gltf = Gltf::square();
    gltf.light(json!({"type": "point", "name": "same"}));
    for _ in 0..100_000 {
        gltf.root(json!({"extensions": {"KHR_lights_punctual": {"light": 0}}}));
    }
    let scene = Scene::load(&gltf.write(folder.path(), "x.glb")).unwrap();
    assert_eq!(scene.rig.lights[99_999].name, "same_100000");
    assert_bytes_refused("x.obj", "\\\n".repeat(1 << 20).as_bytes(), "no triangles");
    assert_bytes_refused("x.obj", "usemtl a\n".repeat(1 << 18).as_bytes(), "no triangles");
    let nested = write(folder.path(), "x.toml", format!("a = {}", "[".repeat(1 << 18)).as_bytes());
    assert!(Rig::load(&nested).unwrap_err().to_string().contains("x.toml"));
    let nested = write(folder.path(), "y.toml", format!("a{} = 1", ".a".repeat(1 << 18)).as_bytes());
    assert!(Rig::load(&nested).unwrap_err().to_string().contains("y.toml"));
}

#[test]
fn materials() {
    let set = |key: &'static str, value: Value| move |g: &mut Gltf| g.json["materials"][0][key] = value;
    assert_change_refused("the alpha mode is not defined by glTF", set("alphaMode", json!("GLASS")));
    assert_change_refused(
        "material 0 \"material0\": a factor",
        set("pbrMetallicRoughness", json!({"metallicFactor": -1})),
    );
    assert_change_refused("out of range", set("pbrMetallicRoughness", json!({"roughnessFactor": 1e300})));
    assert_change_refused("a colour", set("pbrMetallicRoughness", json!({"baseColorFactor": [-1, 0, 0, 1]})));
    assert_change_refused("a colour", |g| {
        g.json["materials"][0]["emissiveFactor"] = json!([1e38, 0, 0]);
        g.json["materials"][0]["extensions"] = json!({"KHR_materials_emissive_strength": {"emissiveStrength": 1e38}});
    });
    assert_change_refused("refraction", set("extensions", json!({"KHR_materials_ior": {"ior": -0.5}})));
    assert_change_refused(
        "transform",
        set("normalTexture", json!({"index": 0, "extensions": {"KHR_texture_transform": {"rotation": "x"}}})),
    );
    assert_change_refused(
        "out of range",
        set("normalTexture", json!({"index": 0, "extensions": {"KHR_texture_transform": {"scale": [1e39, 1]}}})),
    );
    assert_change_refused("the wrapping mode is not defined by glTF", |g| g.json["samplers"][0]["wrapS"] = 5.into());
}

#[test]
fn images() {
    let cannot = "image 0 cannot be decoded";
    let replace = |bytes: Vec<u8>| {
        move |g: &mut Gltf| {
            let view = g.view(&bytes);
            g.json["images"][0]["bufferView"] = view.into();
        }
    };
    let good = png(2, 2, &[[1, 2, 3, 4]; 4]);
    assert_change_refused(cannot, replace(b"no picture".to_vec()));
    assert_change_refused(cannot, replace(Vec::new()));
    assert_change_refused(cannot, replace(good[..good.len() / 2].to_vec()));
    assert_change_refused(cannot, replace(b"\xff\xd8\xff\xe0\0\x10JFIF\0".to_vec()));
    // Claims 2^31 - 1 pixels a side.
    let mut bomb = good.clone();
    bomb[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
    assert_change_refused(cannot, replace(bomb));
    // An empty 8192 x 8192 picture is a few kilobytes; nine of them are more than fits.
    let empty = png(8_192, 8_192, &vec![[0; 4]; 1 << 26]);
    assert_change_refused("texels together", |g| {
        let view = g.view(&empty);
        g.json["images"] = (0..9).map(|_| json!({"bufferView": view, "mimeType": "image/png"})).collect();
        g.json["textures"] = (0..9).map(|i| json!({"source": i})).collect();
        g.json["materials"] =
            (0..9).map(|i| json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}})).collect();
        let primitive = g.json["meshes"][0]["primitives"][0].clone();
        let with = |i: usize| {
            let mut primitive = primitive.clone();
            primitive["material"] = i.into();
            primitive
        };
        g.json["meshes"][0]["primitives"] = (0..9).map(with).collect();
    });
    assert_change_refused("is of type image/avif", |g| g.json["images"][0]["mimeType"] = "image/avif".into());
    assert_change_refused("has neither a URI nor a buffer view", |g| g.json["images"][0] = json!({}));
}

#[test]
fn uris() {
    let uri = |uri: &'static str| move |g: &mut Gltf| g.json["images"][0] = json!({"uri": uri});
    assert_change_refused("image 0: cannot read \"none.png\"", uri("none.png"));
    for outside in ["../secret.png", "%2e%2e/secret.png", "a/../../secret.png", "/etc/passwd"] {
        assert_change_refused("leads out of the scene's folder", uri(outside));
    }
    assert_change_refused("has a scheme", uri("file:///etc/passwd"));
    assert_change_refused("has a scheme", uri("https://example.org/x.png"));
    assert_change_refused("is not UTF-8", uri("%ff.png"));
    assert_change_refused("zero byte", uri("a%00.png"));
    assert_change_refused("is empty", uri(""));
    assert_change_refused("without a comma", uri("data:image/png;base64"));
    assert_change_refused("base64", uri("data:image/png;base64,*"));
    assert_change_refused("cannot be decoded", uri("data:image/png;base64,AAAA"));
    assert_change_refused("buffer 0: cannot read \"none.bin\"", |g| {
        g.json["buffers"] = json!([{"byteLength": 4, "uri": "none.bin"}]);
    });
    assert_change_refused("buffer 0 claims 400 bytes and holds 3", |g| {
        g.json["buffers"] = json!([{"byteLength": 400, "uri": "data:;base64,AAAA"}]);
    });
}

#[test]
fn lights_and_cameras() {
    let light = |value: Value| move |g: &mut Gltf| g.json["extensions"]["KHR_lights_punctual"]["lights"][0] = value;
    let what = "light 0 of node 2 \"lamp\": ";
    assert_change_refused(&format!("{what}type \"area\""), light(json!({"type": "area"})));
    assert_change_refused(&format!("{what}its intensity"), light(json!({"type": "point", "intensity": 1e300})));
    assert_change_refused(&format!("{what}its colour"), light(json!({"type": "point", "color": [-1, 0, 0]})));
    assert_change_refused(&format!("{what}its range"), light(json!({"type": "point", "range": 0})));
    for (inner, outer) in [(0.5, 0.4), (-0.1, 0.4), (0.1, 1.6)] {
        let spot = json!({"type": "spot", "spot": {"innerConeAngle": inner, "outerConeAngle": outer}});
        assert_change_refused("cone angles", light(spot));
    }
    let camera = |value: Value| move |g: &mut Gltf| g.json["cameras"][0] = value;
    let what = "camera 0 of node 1 \"eye\": ";
    for yfov in [0.0, -1.0, 3.2] {
        let value = json!({"type": "perspective", "perspective": {"yfov": yfov, "znear": 1}});
        assert_change_refused(&format!("{what}yfov"), camera(value));
    }
    let orthographic = json!({"xmag": 1, "ymag": 0, "znear": 0, "zfar": 1});
    assert_change_refused("ymag", camera(json!({"type": "orthographic", "orthographic": orthographic})));
    assert_change_refused("neither a perspective", camera(json!({"type": "perspective"})));
    assert_change_refused("", camera(json!({"type": "fisheye"})));
}

#[test]
fn area_and_ies_lights() {
    let refused = |says: &str, change: &dyn Fn(&mut Gltf)| {
        let mut gltf = full_of_lights();
        change(&mut gltf);
        assert_bytes_refused("hostile.glb", &gltf.to_glb(), says);
    };
    let area = |value: Value| move |g: &mut Gltf| g.json["extensions"]["EXT_lights_area"]["lights"][0] = value.clone();
    let what = "area light 0 of node 3 \"panel\": ";
    refused(&format!("{what}type \"sphere\""), &area(json!({"type": "sphere"})));
    refused(&format!("{what}its intensity"), &area(json!({"type": "rect", "intensity": 1e300})));
    refused(&format!("{what}its colour"), &area(json!({"type": "disk", "color": [1, -1, 1]})));
    for rect in [json!({"size": 0}), json!({"size": -1.0}), json!({"rect": {"aspect": -2.0}})] {
        let mut value = json!({"type": "rect"});
        value.as_object_mut().unwrap().extend(rect.as_object().unwrap().clone());
        refused(&format!("{what}its size or aspect is not positive"), &area(value));
    }
    for size in [1e-200, 1e200] {
        let value = json!({"type": "disk", "size": size});
        refused(&format!("{what}its size is too small or too large"), &area(value));
    }
    refused("node 3 \"panel\" names area light 7, there are 1", &|g| {
        g.json["nodes"][3]["extensions"]["EXT_lights_area"]["light"] = 7.into();
    });
    let ies = |value: Value| move |g: &mut Gltf| g.json["extensions"]["EXT_lights_ies"]["lights"][0] = value.clone();
    refused("IES light 0 has neither a URI nor a buffer view", &ies(json!({})));
    refused("IES light 0: cannot read \"none.ies\"", &ies(json!({"uri": "none.ies"})));
    refused("IES light 0: URI \"../lamp.ies\" leads out", &ies(json!({"uri": "../lamp.ies"})));
    refused("IES light 0: the file has no line", &ies(json!({"uri": "data:,TILT"})));
    refused("IES light 0 names buffer view 99", &ies(json!({"bufferView": 99})));
    let instance =
        |value: Value| move |g: &mut Gltf| g.json["nodes"][4]["extensions"]["EXT_lights_ies"] = value.clone();
    let what = "IES light 0 of node 4 \"downlight\": ";
    refused(&format!("{what}its intensity"), &instance(json!({"light": 0, "multiplier": 1e300})));
    refused(&format!("{what}its colour"), &instance(json!({"light": 0, "color": [-1, 0, 0]})));
    refused("node 4 \"downlight\" names IES light 1, there are 1", &instance(json!({"light": 1})));
    let folder = tempfile::tempdir().unwrap();
    let mut gltf = full_of_lights();
    gltf.json["extensions"]["EXT_lights_area"]["lights"][0]["intensity"] = json!(-5.0);
    gltf.json["nodes"][4]["extensions"]["EXT_lights_ies"]["multiplier"] = json!(-1.0);
    gltf.json["extensions"]["EXT_lights_image_based"]["lights"][0]["intensity"] = json!(-1.0);
    let rig = Scene::load(&gltf.write(folder.path(), "dark.glb")).unwrap().rig;
    assert_eq!(rig.lights[1..].iter().map(|light| light.intensity).collect::<Vec<_>>(), [0.0; 3]);
    gltf.json["nodes"][3]["scale"] = json!([1, 1, 0]);
    gltf.json["nodes"][4]["scale"] = json!([0, 0, 0]);
    assert_eq!(Scene::load(&gltf.write(folder.path(), "flat.glb")).unwrap().rig.lights.len(), 2);
}

#[test]
fn environments() {
    let refused = |says: &str, change: &dyn Fn(&mut Gltf)| {
        let mut gltf = full_of_lights();
        change(&mut gltf);
        assert_bytes_refused("hostile.glb", &gltf.to_glb(), says);
    };
    let with = |key: &'static str, value: Value| {
        move |g: &mut Gltf| g.json["extensions"]["EXT_lights_image_based"]["lights"][0][key] = value.clone()
    };
    let what = "image-based light 0";
    refused("the scene names image-based light 7, there are 1", &|g| {
        g.json["scenes"][0]["extensions"]["EXT_lights_image_based"]["light"] = 7.into();
    });
    refused(&format!("{what}: its intensity"), &with("intensity", json!(1e300)));
    for rotation in [json!([0, 0, 0, 0]), json!([1e300, 0, 0, 1]), json!([1e-300, 0, 0, 0])] {
        refused(&format!("{what}: its rotation is not a quaternion"), &with("rotation", rotation));
    }
    for (faces, count) in
        [(json!([]), 0), (json!([[]]), 0), (json!([[1, 1, 1, 1, 1]]), 5), (json!([[1, 1, 1, 1, 1, 1, 1]]), 7)]
    {
        refused(
            &format!("{what}: the first of its specularImages has {count} faces, not 6"),
            &with("specularImages", faces),
        );
    }
    refused(&format!("{what} names image 99, there are 7"), &with("specularImages", json!([[1, 1, 1, 1, 1, 99]])));
    for wrong in [json!([[1, 1, 1, 1, 1, -1]]), json!([[1, 1, 1, 1, 1, null]]), json!([1, 1, 1, 1, 1, 1]), json!(3)] {
        refused("is not the JSON of a glTF", &with("specularImages", wrong));
    }
    for wrong in [json!([0, 0, 1]), json!([0, 0, null, 1]), json!("east")] {
        refused("is not the JSON of a glTF", &with("rotation", wrong));
    }
    for (width, height) in [(4, 2), (2, 4), (1, 1), (4, 4)] {
        refused(&format!("{what}: image 3 has {width} x {height} texels, expected 2 x 2"), &|g| {
            let view = g.view(&png(width, height, &vec![[1; 4]; (width * height) as usize]));
            g.json["images"][3]["bufferView"] = view.into();
        });
    }
    let image = |value: Value| move |g: &mut Gltf| g.json["images"][3] = value.clone();
    refused("image 3 has neither a URI nor a buffer view", &image(json!({})));
    refused("image 3: cannot read \"none.png\"", &image(json!({"uri": "none.png"})));
    refused("image 3: URI \"../sky.png\" leads out", &image(json!({"uri": "../sky.png"})));
    refused("image 3 cannot be decoded", &image(json!({"uri": "data:,PNG"})));
    refused("image 3 is KTX2", &image(json!({"uri": "data:,%ABKTX%2020%BB%0D%0A%1A%0A"})));
    // Only the shown scene counts.
    let mut gltf = full_of_lights();
    gltf.json["scenes"][0]["extensions"] = json!({});
    with("specularImages", json!([[99]]))(&mut gltf);
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(Scene::load(&gltf.write(folder.path(), "unlit.glb")).unwrap().rig.lights.len(), 3);
}

#[test]
fn obj() {
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\n";
    for (text, says) in [
        ("", "no triangles"),
        (square, "no triangles"),
        ("v 0 0\n", "line 1: \"0 0\" is not a vertex"),
        ("v 0 0 nan\n", "line 1: nan is not finite"),
        ("v 0 0 1e99\n", "line 1"),
        ("v 0 0 x\n", "line 1: \"x\" is not a number"),
        ("v 0 0 0 0\n", "line 1"),
        ("v 1e9 0 0 1e-308\n", "line 1: inf is not finite"),
        ("v 0 0 0 1 1\n", "line 1"),
        ("v 0 0 0 1 1 inf\n", "line 1: inf is not finite"),
        ("f 1 2 3\n", "line 1: vertex 3 is out of range, there are 0"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 4\n", "line 4: vertex 4 is out of range, there are 3"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 0\n", "line 4: \"0\" is not a face corner"),
        ("v 0 0 0\nf 1 1 -2\n", "line 2: \"-2\" counts back past the first"),
        ("v 0 0 0\nf 1 1 -9223372036854775808\n", "line 2"),
        ("v 0 0 0\nf 1 1 99999999999999999999\n", "line 2"),
        ("v 0 0 0\nf 1/1 1/1 1/1\n", "line 2: texture coordinate 1 is out of range"),
        ("v 0 0 0\nf 1//9223372036854775807 1 1\n", "normal 9223372036854775807 is out of range"),
        // These three overflow when tripled.
        ("v 0 0 0\nvn 0 0 1\nf 1//6148914691236517205 1 1\n", "normal 6148914691236517205 is out of range"),
        ("v 0 0 0\nvn 0 0 1\nf 1//6148914691236517207 1 1\n", "normal 6148914691236517207 is out of range"),
        ("v 0 0 0\nvn 0 0 1\nf 1//-6148914691236517206 1 1\n", "counts back past the first"),
        ("v 0 0 0\nvn 0 0 1\nf 1//-2 1 1\n", "line 3: \"1//-2\" counts back past the first"),
        ("v 0 0 0\nf 1/1/1/1 1 1\n", "line 2"),
        ("v 0 0 0\nf /1 1 1\n", "line 2: \"/1\" is not a face corner"),
        ("v 0 0 0\nf 1 1 1.5\n", "line 2: \"1.5\" is not a face corner"),
        ("v 0 0 0\nf\n", "line 2: a face of 0 corners"),
        ("v 0 0 0\nf 1 1\n", "line 2: a face of 2 corners"),
        ("v 0 0 0\nf 1 1 1\n", "no triangles except 1 of zero area"),
        ("vt\n", "line 1"),
        ("vn 1 2\n", "line 1"),
        ("\\", "no triangles"),
    ] {
        assert_bytes_refused("x.obj", text.as_bytes(), says);
    }
    assert_bytes_refused("x.obj", format!("{square}f {}\n", "1 2 3 ".repeat(100_000)).as_bytes(), "300000 corners");
    assert_bytes_refused("x.obj", &[0xff; 100], "no triangles");
    assert_bytes_refused("x.obj", "v 0 0 0\nl 1 1 1\nl 1 7\np 9\n".as_bytes(), "no triangles");
    // Star polygons of the most corners: none of a hundred costs more than a moment.
    let corners = |step: usize| (0..1_024).map(|i| (i * step % 1_024 + 1).to_string() + " ").collect::<String>();
    let mut stars: String = (0..1_024).map(|i| (i as f32).sin_cos()).map(|(x, y)| format!("v {x} {y} 0\n")).collect();
    stars.extend((0..100).map(|i| format!("f {}\n", corners(10 * i + 1))));
    _ = Scene::load(&write(tempfile::tempdir().unwrap().path(), "x.obj", stars.as_bytes()));
}

const OBJ: &str = "mtllib x.mtl\nv 0 0 0\nv 1 0 0 1 0 0\nv 1 1 0\nv 0 1 0 1\nvt 0 0\nvt 1 0\nvn 0 0 1\n\
    usemtl a\nf 1/1/1 2/2/1 3/1/1 4/2/1\nusemtl b\nf -4 -3 \\\n-2 # tip\nf 1//1 2//1 3//1 4//1\nl 1 2 3\n";
const MTL: &str = "newmtl a\nKd 0.5 0.5 0.5\nKs 1 1 1\nNs 9\nPr 0.5\nmap_Kd -s 2 2 -o 0 1 x.png\nnorm x.png\n\
    newmtl b\nKd 0.5\nillum 3\nKe 1 1 1\nd -halo 1\nbump -bm 2 x.png\n";

#[test]
fn mtl() {
    let folder = tempfile::tempdir().unwrap();
    let obj = b"mtllib x.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl a\nf 1 2 3\n";
    let obj = write(folder.path(), "x.obj", obj);
    // A missing library is only a warning.
    assert!(Scene::load(&obj).is_ok());
    ["broken.png", "broken.tga", "layers.psd"].iter().for_each(|name| drop(write(folder.path(), name, b"8BPS")));
    for (text, says) in [
        ("newmtl a\nKd\n", "line 2: Kd: numbers are missing"),
        ("newmtl a\nKs x\n", "line 2: Ks: \"x\" is not a number"),
        ("newmtl a\nNs nan\n", "line 2: Ns"),
        ("newmtl a\nKd spectral a.rfl\n", "line 2: Kd: \"spectral\" is not a number"),
        ("newmtl a\nPr\n", "line 2: Pr"),
        ("newmtl a\nmap_Kd\n", "line 2: map_Kd: names no file"),
        ("newmtl a\nmap_Kd -s 1 2\n", "line 2: map_Kd: names no file"),
        ("newmtl a\nmap_Kd -what x.png\n", "option -what is unknown"),
        ("newmtl a\nmap_Kd broken.png\n", "\"broken.png\" cannot be decoded"),
        ("newmtl a\nmap_Kd broken.tga\n", "\"broken.tga\" cannot be decoded"),
    ] {
        write(folder.path(), "x.mtl", text.as_bytes());
        let Err(error) = Scene::load(&obj) else { panic!("loaded: {text}") };
        assert!(error.to_string().contains("x.mtl"), "{error}");
        assert!(chain(&error).contains(says), "says: {}\nnot: {says}", chain(&error));
    }
    // Textures that are not there, or not to be read, leave their materials grey; names may be missing.
    let unread = ["none.png", "../../secret.png", "layers.psd"].map(|file| format!("newmtl a\nmap_Kd {file}\n"));
    for text in unread.into_iter().chain(["newmtl\nKd 1 0 0\n".to_owned()]) {
        write(folder.path(), "x.mtl", text.as_bytes());
        assert!(Scene::load(&obj).unwrap().textures.is_empty(), "{text}");
    }
    // Short colours that make other readers panic; the wildest values that are numbers.
    write(folder.path(), "x.mtl", b"Kd 1 1 1\nnewmtl a\nKd 1e30 -5\nKs 0.5\nNs -7\nPr 9\nPm -3\nillum 77\nNi 0\n");
    let scene = Scene::load(&obj).unwrap();
    let material = &scene.materials[0];
    assert!((0.0..=1.0).contains(&material.roughness) && (0.0..=1.0).contains(&material.metallic));
}

#[test]
fn export_of_a_file_that_has_changed_since() {
    let folder = tempfile::tempdir().unwrap();
    let path = full().write(folder.path(), "x.glb");
    let scene = Scene::load(&path).unwrap();
    for bytes in [&b"glTF"[..], b"", &glb(b"[]", b"")] {
        std::fs::write(&path, bytes).unwrap();
        let error = export_gltf(&scene, &scene.rig, &folder.path().join("out.glb")).unwrap_err();
        assert!(error.to_string().contains("x.glb"), "{error}");
    }
    assert!(!folder.path().join("out.glb").exists());
}

fn cases() -> u32 {
    if std::env::var_os("RELUME_FULL").is_some() { 10_000 } else { 2_000 }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), ..ProptestConfig::default() })]

    /// Loads or refuses; what loads can be exported or is refused.
    #[test]
    fn damaged_files_never_panic(
        flips in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 0..6),
        cut in proptest::option::of(any::<proptest::sample::Index>()),
    ) {
        let mut bytes = full_of_lights().to_glb();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = write(folder.path(), "damaged.glb", &bytes);
        match Scene::load(&path) {
            Ok(scene) => {
                let vertices = scene.mesh.positions.len();
                prop_assert!(scene.mesh.triangles.iter().flatten().all(|&i| (i as usize) < vertices));
                prop_assert!(scene.mesh.positions.iter().all(|p| p.is_finite()));
                prop_assert!(scene.mesh.normals.iter().all(|n| n.is_normalized()));
                _ = export_gltf(&scene, &Rig::default(), &folder.path().join("out.gltf"));
            }
            Err(error) => prop_assert!(error.to_string().contains("damaged.glb"), "{}", error),
        }
    }

    /// The same for the JSON alone, a word replaced at a time: it gets further than single bytes do.
    #[test]
    fn damaged_json_never_panics(
        edits in proptest::collection::vec((any::<proptest::sample::Index>(), 0usize..16), 1..4),
    ) {
        let values = [
            json!(null), json!(-1), json!(0), json!(1), json!(7), json!(255), json!(u32::MAX), json!(u64::MAX),
            json!(1e300), json!(-1e-300), json!(0.5), json!(""), json!([]), json!({}), json!([0, 0, 0]), json!(5121),
        ];
        let mut gltf = full_of_lights();
        gltf.json["buffers"] = json!([{"byteLength": gltf.bin.len()}]);
        for (at, value) in edits {
            let mut leaves = Vec::new();
            pointers(&gltf.json, String::new(), &mut leaves);
            let pointer = &leaves[at.index(leaves.len())];
            *gltf.json.pointer_mut(pointer).unwrap() = values[value].clone();
        }
        let folder = tempfile::tempdir().unwrap();
        let path = gltf.write(folder.path(), "damaged.glb");
        match Scene::load(&path) {
            Ok(scene) => _ = export_gltf(&scene, &scene.rig, &folder.path().join("out.glb")),
            Err(error) => prop_assert!(error.to_string().contains("damaged.glb"), "{}", error),
        }
    }

    #[test]
    fn damaged_obj_and_mtl_never_panic(
        flips in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 0..6),
        swaps in proptest::collection::vec((any::<proptest::sample::Index>(), 0usize..16), 0..3),
        cut in proptest::option::of(any::<proptest::sample::Index>()),
    ) {
        let words = ["", "-1", "0", "1", "5", "nan", "1e39", "1/", "//1", "f", "v", "Kd", "usemtl", "newmtl", "-s",
            "6148914691236517205"];
        let mut text = format!("{OBJ}\0{MTL}");
        for (at, word) in swaps {
            let starts: Vec<usize> = text.split(' ').map(|w| w.as_ptr() as usize - text.as_ptr() as usize).collect();
            let start = starts[at.index(starts.len())];
            let end = text[start..].find([' ', '\n', '\0']).map_or(text.len(), |n| start + n);
            text.replace_range(start..end, words[word]);
        }
        let (obj, mtl) = text.split_once('\0').unwrap();
        let (mut obj, mut mtl) = (obj.as_bytes().to_vec(), mtl.as_bytes().to_vec());
        for (at, value) in flips {
            let at = at.index(obj.len() + mtl.len());
            let length = obj.len();
            *obj.get_mut(at).unwrap_or_else(|| &mut mtl[at - length]) = value;
        }
        if let Some(cut) = cut {
            let at = cut.index(obj.len() + mtl.len());
            if at < obj.len() { obj.truncate(at) } else { mtl.truncate(at - obj.len()) }
        }
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "x.mtl", &mtl);
        write(folder.path(), "x.png", &png(1, 1, &[[1, 2, 3, 4]]));
        match Scene::load(&write(folder.path(), "x.obj", &obj)) {
            Ok(scene) => {
                let mesh = &scene.mesh;
                prop_assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < mesh.positions.len()));
                prop_assert!(mesh.positions.iter().all(|p| p.is_finite()));
                prop_assert!(mesh.normals.iter().all(|n| n.is_normalized()));
                prop_assert!(scene.materials.iter().all(|m| (0.0..=1.0).contains(&m.roughness) && m.emissive.is_finite()));
            }
            Err(error) => prop_assert!(error.to_string().contains("x.obj") || error.to_string().contains("x.mtl"), "{}", error),
        }
    }

    #[test]
    fn damaged_text_never_panics(
        lines in proptest::collection::vec(".{0,20}|v( [0-9.e-]{1,5}){3}|f( -?[0-9]{1,2}(/[0-9]?){0,2}){3,9}|vt 0 1|vn 0 0 1", 0..30),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let text = lines.join("\n");
        _ = Scene::load(&write(folder.path(), "x.obj", text.as_bytes()));
        _ = Rig::load(&write(folder.path(), "x.toml", text.as_bytes()));
    }
}

/// JSON pointers to everything below `value`.
fn pointers(value: &Value, here: String, all: &mut Vec<String>) {
    match value {
        Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                pointers(item, format!("{here}/{i}"), all);
            }
        }
        Value::Object(items) => {
            for (key, item) in items {
                pointers(item, format!("{here}/{key}"), all);
            }
        }
        _ => {}
    }
    if !here.is_empty() {
        all.push(here);
    }
}

/// Links are followed within the scene's folder only.
#[cfg(unix)]
#[test]
fn links_that_lead_out() {
    let outside = tempfile::tempdir().unwrap();
    let secret = write(outside.path(), "secret.png", &png(1, 1, &[[1, 2, 3, 4]]));
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(&secret, folder.path().join("link.png")).unwrap();
    std::os::unix::fs::symlink(outside.path(), folder.path().join("sub")).unwrap();
    let obj = write(folder.path(), "x.obj", b"mtllib x.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl a\nf 1 2 3\n");
    for uri in ["link.png", "sub/secret.png"] {
        let mut gltf = full();
        gltf.json["images"][0] = json!({"uri": uri});
        assert_refused(&gltf.write(folder.path(), "x.glb"), "leads out of the scene's folder");
        write(folder.path(), "x.mtl", format!("newmtl a\nmap_Kd {uri}\n").as_bytes());
        let Err(error) = Scene::load(&obj) else { panic!("{uri} was read") };
        assert!(chain(&error).contains("leads out of the scene's folder"), "{}", chain(&error));
    }
    // Within the folder they are as good as files.
    std::fs::copy(&secret, folder.path().join("mine.png")).unwrap();
    std::os::unix::fs::symlink(folder.path().join("mine.png"), folder.path().join("inner.png")).unwrap();
    let mut gltf = full();
    gltf.json["images"][0] = json!({"uri": "inner.png"});
    assert!(Scene::load(&gltf.write(folder.path(), "y.glb")).is_ok());
}

#[test]
fn small_files_do_not_fill_memory() {
    // Zeros without a buffer view, twelve million in three accessors.
    assert_change_refused("elements together have no buffer view", |g| {
        for i in 0..3 {
            let at = g.view(&[i]);
            let to = g.view(&[0; 12]);
            let sparse = json!({"count": 1, "indices": {"bufferView": at, "componentType": UNSIGNED_BYTE},
                "values": {"bufferView": to}});
            let zeros = json!({"componentType": FLOAT, "type": "VEC3", "count": 3_999_999, "sparse": sparse});
            let zeros = g.push("accessors", zeros);
            g.mesh(json!({"attributes": {"POSITION": zeros}}));
            g.root(json!({"mesh": i + 1}));
        }
    });
    // Five thousand texels square, all alike: 25 million of them in a few kilobytes.
    let image = png(5_000, 5_000, &vec![[0, 0, 0, 255]; 25_000_000]);
    let image = &image[..image.len().min(10_000)];
    assert_change_refused("are implausible", |g| {
        let view = g.view(image);
        g.json["images"][0]["bufferView"] = view.into();
    });
}

#[test]
fn packed_geometry_that_is_damaged() {
    let with = |extension: Value| {
        move |g: &mut Gltf| g.json["bufferViews"][0]["extensions"] = json!({"EXT_meshopt_compression": extension})
    };
    let good = json!({"buffer": 0, "byteLength": 48, "byteStride": 12, "count": 4, "mode": "ATTRIBUTES"});
    let change = |key: &str, value: Value| {
        let mut extension = good.clone();
        extension[key] = value;
        with(extension)
    };
    assert_change_refused("buffer view 0: EXT_meshopt_compression", with(json!({})));
    assert_change_refused("which is not the header of packed attributes", with(good.clone()));
    assert_change_refused("which is not the header of packed triangles", {
        let mut extension = good.clone();
        (extension["mode"], extension["byteStride"], extension["count"]) = (json!("TRIANGLES"), json!(2), json!(3));
        with(extension)
    });
    assert_change_refused("cannot be packed as", change("byteStride", json!(3)));
    assert_change_refused("mode FASTER is not defined by the extension", change("mode", json!("FASTER")));
    assert_change_refused("cannot be packed in 48 bytes", change("count", json!(1u64 << 40)));
    assert_change_refused("overruns buffer 0", change("byteOffset", json!(u64::MAX)));
    assert_change_refused("names buffer 7", change("buffer", json!(7)));
    let draco = |extension: Value| {
        move |g: &mut Gltf| {
            g.json["meshes"][0]["primitives"][0]["extensions"] = json!({"KHR_draco_mesh_compression": extension});
        }
    };
    let what = "mesh 0, primitive 0: KHR_draco_mesh_compression";
    assert_change_refused(what, draco(json!({})));
    assert_change_refused(what, draco(json!({"bufferView": 0, "attributes": {"POSITION": 0}})));
    assert_change_refused("names buffer view 99", draco(json!({"bufferView": 99, "attributes": {}})));
}

#[test]
fn skins_and_copies_that_are_wrong() {
    let skinned = |change: fn(&mut Gltf)| {
        move |g: &mut Gltf| {
            let joints = g.accessor(&[0; 16], UNSIGNED_BYTE, "VEC4", 4);
            let weights = g.f32s(&[[1.0, 0.0, 0.0, 0.0]; 4]);
            let attributes = &mut g.json["meshes"][0]["primitives"][0]["attributes"];
            (attributes["JOINTS_0"], attributes["WEIGHTS_0"]) = (joints.into(), weights.into());
            g.json["nodes"][0]["skin"] = 0.into();
            g.json["skins"] = json!([{"joints": [1]}]);
            change(g);
        }
    };
    assert_change_opens([2, 1, 1], skinned(|_| ()));
    assert_change_refused("names skin 4", skinned(|g| g.json["nodes"][0]["skin"] = 4.into()));
    assert_change_refused("skin 0 names joint 77", skinned(|g| g.json["skins"][0]["joints"] = json!([77])));
    assert_change_refused("vertex 0 names joint 0, there are 0", skinned(|g| g.json["skins"][0]["joints"] = json!([])));
    assert_change_refused("is not in the scene", skinned(|g| g.json["scenes"][0]["nodes"] = json!([0])));
    assert_change_refused("is not of type Mat4", skinned(|g| g.json["skins"][0]["inverseBindMatrices"] = 0.into()));
    let copies = |change: fn(&mut Gltf)| {
        move |g: &mut Gltf| {
            let at = g.f32s(&[[0.0; 3], [2.0, 0.0, 0.0]]);
            let attributes = json!({ "TRANSLATION": at });
            g.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
            change(g);
        }
    };
    assert_change_opens([4, 1, 1], copies(|_| ()));
    assert_change_refused(
        "4 values for 2 copies",
        copies(|g| {
            g.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = 0.into();
        }),
    );
    assert_change_refused(
        "not a quaternion",
        copies(|g| {
            let zero = g.f32s(&[[0.0; 4]; 2]);
            g.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["ROTATION"] = zero.into();
        }),
    );
    // Points have no triangles, so that no number of copies is too many.
    assert_change_refused(
        "overrun a view",
        copies(|g| {
            let turns = g.f32s(&[[0.0, 0.0, 0.0, 1.0]]);
            g.json["accessors"][turns]["count"] = (1u64 << 60).into();
            g.json["meshes"][0]["primitives"][0]["mode"] = 0.into();
            g.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = json!({ "ROTATION": turns });
        }),
    );
}
