//! Files as people have them: each opens, within bounds, or is refused for the right reason.
//!
//! They lie outside the repository, so these tests run where they are.

mod common;
mod support;

use std::path::Path;
use std::time::{Duration, Instant};

use common::shared;
use glam::DVec3;
use relume::Error;
use relume::scene::{AlphaMode, Projection, Scene};
use relume::trace::bvh::TracedScene;

/// What a file is expected to do.
enum Expected {
    /// Open with so many triangles.
    Opens(usize),
    /// Be refused; the error or its causes say this.
    Refused(&'static str),
}

use Expected::{Opens, Refused};

const FILES: &[(&str, Expected)] = &[
    ("hang_bvh_quadratic_75000_coincident_triangles.obj", Opens(74_996)),
    ("hang_bvh_quadratic_8000_coincident_triangles_3s.obj", Opens(8_000)),
    ("memory_1.5MB_4GB_27s_before_corner_limit.gltf", Refused("more than 134217728 corners of triangles")),
    ("memory_44KB_png_16384_3.7GB_34s.gltf", Refused("16384 x 16384 texels in 32697 bytes are implausible")),
    ("memory_781B_zeros_1.7GB_13s.gltf", Opens(0)),
    ("memory_80KB_png_22000_5GB_over_60s.gltf", Refused("22000 x 22000 texels in 58900 bytes are implausible")),
    ("refused_animation_target_without_node_minimal.gltf", Opens(1)),
    ("refused_blender_animation_pointer_target_without_node.glb", Opens(12)),
    ("refused_blender_obj_textures_elsewhere/tex_AUTO.obj", Opens(12)),
    ("refused_blender_obj_textures_elsewhere/tex_RELATIVE.obj", Opens(12)),
    ("refused_blender_second_scene_empty_no_nodes_key.glb", Opens(12)),
    ("refused_draco.glb", Opens(12)),
    ("refused_ext_mesh_gpu_instancing_required.glb", Opens(12 * 11)),
    ("refused_ior_0.9.glb", Opens(12)),
    // The first of its files that is missing; the one that is there is KTX2.
    ("refused_ktx2_message_does_not_say_ktx2/AnisotropyBarnLamp.gltf", Refused("AnisotropyBarnLamp_")),
    ("refused_meshopt.glb", Opens(1_068 / 3)),
    ("refused_negative_light_energy.glb", Opens(12)),
    ("refused_obj_newmtl_without_name/empty_mat.obj", Opens(256)),
    ("refused_one_object_with_zero_scale.glb", Opens(0)),
    ("refused_primitive_without_position.gltf", Opens(1)),
    ("refused_scene_without_nodes_minimal.gltf", Opens(1)),
    ("refused_texcoord_2.glb", Opens(12)),
    // Its integers are read; that buffers of one byte lie nowhere is another matter.
    ("refused_valid_integer_written_as_float.gltf", Refused("buffer 0 has neither a URI nor a binary chunk")),
    ("refused_webp.glb", Opens(12)),
    ("refused_zero_scale_minimal.gltf", Opens(1)),
    ("scene_for_rigs.glb", Opens(1)),
    ("wrong_camera_aspectRatio_ignored_720x480.glb", Opens(12)),
    ("wrong_obj_d_map_d_map_Pr_map_Ks_silently_ignored/obj_m_d.obj", Opens(1)),
    ("wrong_obj_d_map_d_map_Pr_map_Ks_silently_ignored/obj_m_mapd.obj", Opens(1)),
    ("wrong_obj_d_map_d_map_Pr_map_Ks_silently_ignored/obj_m_mapks.obj", Opens(1)),
    ("wrong_skin_SimpleSkin_node_translation_applied.gltf", Opens(8)),
    ("wrong_skin_fbx_armature_scale_0.01_is_a_dot.glb", Opens(12)),
    ("wrong_skin_posed_armature_half_size.glb", Opens(12)),
];

fn chain(error: &Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

fn load(name: &str) -> Option<Scene> {
    let path = shared(&format!("assets/{name}"))?;
    Some(Scene::load(&path).unwrap_or_else(|e| panic!("{}", chain(&e))))
}

/// Low and high corners in world space.
fn bounds(scene: &Scene) -> [DVec3; 2] {
    let (low, high) = scene.mesh.bounds();
    [low, high].map(|corner| scene.space.to_world(corner))
}

#[track_caller]
fn assert_bounds(scene: &Scene, low: [f64; 3], high: [f64; 3]) {
    let [got_low, got_high] = bounds(scene);
    // Single precision in mesh space, and in the file.
    let near = |got: DVec3, want: [f64; 3]| got.distance(want.into()) < 1e-5;
    assert!(near(got_low, low) && near(got_high, high), "{got_low} to {got_high}, want {low:?} to {high:?}");
}

/// Kilobytes that this process took at most; `None` where the system does not tell.
fn peak_kib() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    text.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse().ok())
}

#[test]
fn every_file_opens_or_says_why_not_within_bounds() {
    for (name, expected) in FILES {
        let Some(path) = shared(&format!("assets/{name}")) else { return };
        let start = Instant::now();
        match (Scene::load(&path), expected) {
            (Ok(scene), Opens(triangles)) => {
                assert_eq!(scene.mesh.triangles.len(), *triangles, "{name}");
                TracedScene::new(scene);
            }
            (Err(error), Refused(says)) => assert!(chain(&error).contains(says), "{name}: {}", chain(&error)),
            (Ok(_), Refused(says)) => panic!("{name} opened, should say: {says}"),
            (Err(error), Opens(_)) => panic!("{name}: {}", chain(&error)),
        }
        assert!(start.elapsed() < Duration::from_secs(10), "{name} took {:?}", start.elapsed());
    }
    // All of them in one process, with the other tests beside.
    assert!(peak_kib().is_none_or(|kib| kib < 1 << 20), "{:?} KiB", peak_kib());
}

/// A file that nobody expects anything of would not be tested.
#[test]
fn every_file_is_expected_to_do_something() {
    let Some(folder) = shared("assets") else { return };
    let is_scene = |path: &Path| path.extension().is_some_and(|e| ["gltf", "glb", "obj"].iter().any(|s| e == *s));
    let mut open = vec![folder.clone()];
    let elsewhere =
        ["wrong_ext_mesh_gpu_instancing_optional_copies_vanish.glb", "wrong_obj_inside_out_black_no_warning.obj"];
    while let Some(folder_or_file) = open.pop() {
        if folder_or_file.is_dir() {
            open.extend(std::fs::read_dir(&folder_or_file).unwrap().map(|entry| entry.unwrap().path()));
        } else if is_scene(&folder_or_file) {
            let name = folder_or_file.strip_prefix(&folder).unwrap().to_str().unwrap();
            assert!(FILES.iter().any(|(known, _)| *known == name) || elsewhere.contains(&name), "{name}");
        }
    }
}

#[test]
fn the_camera_says_how_wide_its_picture_is() {
    let Some(scene) = load("wrong_camera_aspectRatio_ignored_720x480.glb") else { return };
    let camera = &scene.cameras[0];
    assert!((camera.aspect.unwrap() - 16.0 / 9.0).abs() < 1e-12);
    assert!(matches!(camera.projection, Projection::Perspective { .. }));
    assert_eq!(scene.default_size(Some(camera)), [853, 480]);
    assert_eq!(scene.default_size(None), [720, 480]);
}

#[test]
fn skins_stand_where_their_joints_are() {
    // A cube of two metres under an armature in centimetres: each vertex is where the joint takes it.
    let Some(scene) = load("wrong_skin_fbx_armature_scale_0.01_is_a_dot.glb") else { return };
    assert_bounds(&scene, [-1.0; 3], [1.0; 3]);
    // An armature of half the size, posed: the mesh is stored that small.
    assert_bounds(&load("wrong_skin_posed_armature_half_size.glb").unwrap(), [-0.5; 3], [0.5; 3]);
    // Both inverse bind matrices move by -0.5 and -1, both joints by 1 up.
    let scene = load("wrong_skin_SimpleSkin_node_translation_applied.gltf").unwrap();
    assert_bounds(&scene, [-0.5, 0.0, 0.0], [0.5, 2.0, 0.0]);
}

#[test]
fn copies_are_there() {
    let Some(scene) = load("wrong_ext_mesh_gpu_instancing_optional_copies_vanish.glb") else { return };
    let single = load("refused_blender_second_scene_empty_no_nodes_key.glb").unwrap();
    assert!(scene.mesh.triangles.len() >= 9 * single.mesh.triangles.len(), "{}", scene.mesh.triangles.len());
}

#[test]
fn inside_out_surfaces_are_turned() {
    let Some(scene) = load("wrong_obj_inside_out_black_no_warning.obj") else { return };
    let mesh = &scene.mesh;
    // Six times the volume of all faces together, and how far normals agree with faces.
    let (mut volume, mut agreement) = (0.0, 0.0);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| mesh.positions[i as usize].as_dvec3());
        volume += a.dot(b.cross(c));
        agreement += (b - a).cross(c - a).dot(mesh.normals[triangle[0] as usize].as_dvec3());
    }
    assert!(volume > 0.0 && agreement > 0.0, "{volume} {agreement}");
}

#[test]
fn masks_and_maps_of_mtl_are_read() {
    let Some(masked) = load("wrong_obj_d_map_d_map_Pr_map_Ks_silently_ignored/obj_m_mapd.obj") else { return };
    assert_eq!(masked.materials[0].alpha_mode, AlphaMode::Mask { cutoff: 0.5 });
    assert!(masked.materials[0].base_color_texture.is_some());
    let mapped = load("wrong_obj_d_map_d_map_Pr_map_Ks_silently_ignored/obj_m_mapks.obj").unwrap();
    let material = &mapped.materials[0];
    assert!(material.specular_color_texture.is_some() && material.metallic_roughness_texture.is_some());
    assert_eq!(material.roughness, 1.0);
}
