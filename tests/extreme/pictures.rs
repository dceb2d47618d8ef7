//! Cameras, sizes and materials at the ends of their ranges, and scenes of one triangle or of millions.

#[path = "../command/mod.rs"]
mod command;

use glam::{DVec3, Vec3};
use relume::scene::{Camera, Light, Material, Projection, Scene};

use self::command::{folder, relume};
use crate::common::stage::{Build, Setup, ball, lambert, look, rig};
use crate::common::{gpu, not_run};
use crate::even::{Stage, errors_with, settings, shining};
use crate::lights::{Relit, negative};
use crate::table::{Row, check, full};

const ALBEDO: f32 = 0.9;

fn room() -> Build {
    let mut build = Build::default();
    let material = build.material(shining(ALBEDO));
    build.room(DVec3::ZERO, 1.0, material);
    build
}

fn view(yfov: f64) -> Camera {
    look(DVec3::ZERO, DVec3::new(0.2, -0.1, 1.0), DVec3::Y, Projection::Perspective { yfov })
}

#[test]
fn cameras_and_sizes() {
    let mut rows = Vec::new();
    let plain = settings(512, 128, 64);
    let mut cases = vec![
        ("a field of view of 0.1 degrees", view(0.1f64.to_radians()), [32, 32], plain.clone()),
        ("a field of view of 179 degrees", view(179f64.to_radians()), [32, 32], plain.clone()),
        ("512x1 pixels", view(1.5), [512, 1], plain.clone()),
        ("1x512 pixels", view(1.5), [1, 512], plain.clone()),
        ("1x1 pixel", view(1.5), [1, 1], plain.clone()),
        ("1x1 pixel, 2,000 gather samples", view(1.5), [1, 1], settings(2000, 500, 64)),
        ("one gather sample", view(1.5), [32, 32], settings(1, 1, 64)),
        ("two gather samples, one coarse", view(1.5), [32, 32], settings(2, 1, 64)),
        ("one ray a row", view(1.5), [32, 32], settings(512, 128, 1)),
    ];
    let corner = look(DVec3::splat(-1.0 + 1e-6), DVec3::ONE, DVec3::Y, Projection::Perspective { yfov: 1.5 });
    cases.push(("a camera 1e-6 m off three walls", corner, [32, 32], plain));
    for (case, camera, size, settings) in cases {
        let stage = Stage::new(room().scene(), &camera, size);
        let errors = errors_with(&stage, ALBEDO, &settings);
        let few = case.starts_with("a camera 1e-6 m off").then_some("few photons land in the cells beside the camera");
        rows.extend(errors.rows(case, ALBEDO, few));
    }
    check("cameras and sizes", &rows);
}

/// Every end of glTF's ranges, all in one room.
#[test]
fn materials() {
    let gpu = gpu();
    let mut rows = Vec::new();
    for (what, roughness) in [("0", 0.0), ("1e-6", 1e-6), ("1", 1.0)] {
        let mut build = Build::default();
        build.room(DVec3::ZERO, 1.0, 0);
        for (quad, (color, metallic)) in
            (0..).zip([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.5), (1.0, 0.5)])
        {
            let base_color = Vec3::splat(color).extend(1.0);
            build.quads[quad].1 = build.materials.len();
            build.material(Material { base_color, metallic, roughness, ..Material::default() });
        }
        let camera =
            look(DVec3::new(0.9, 0.5, 0.9), DVec3::splat(-0.3), DVec3::Y, Projection::Perspective { yfov: 1.5 });
        let lights = rig(vec![Light::point("l", DVec3::new(0.1, 0.3, -0.2))]);
        let relit = Relit::new(build.scene(), &camera, &lights, &Setup::new(48, 48));
        let mut pictures = relit.pictures(&gpu, &lights).to_vec();
        pictures.extend(relit.gathered(&lights, 4));
        let most: f64 = pictures.iter().map(|image| negative(image)).sum();
        let case = format!("roughness {what}, base colours and metallic 0 and 1");
        rows.push(Row::new(case, "finite, hardly any of it below 0", 1e-4, most));
    }
    check("materials", &rows);
}

/// Within a solid only backs are seen.
#[test]
fn inside_of_a_solid() {
    let gpu = gpu();
    let mut build = room();
    let solid = build.material(lambert(Vec3::splat(ALBEDO)));
    let mut inner = Build::default();
    inner.room(DVec3::ZERO, 0.3, solid);
    build.quads.extend(inner.quads.into_iter().map(|(mut corners, material)| {
        corners.reverse();
        (corners, material)
    }));
    let lights = rig(vec![Light::point("l", DVec3::splat(0.6)), Light::point("m", DVec3::splat(0.1))]);
    let relit = Relit::new(build.scene(), &view(1.0), &lights, &Setup::new(32, 32));
    let most = relit.pictures(&gpu, &lights).iter().flatten().flatten().map(|x| f64::from(x.abs())).sum();
    check("inside", &[Row::new("a camera inside an object, lights within and without", "black", 0.0, most)]);
}

/// What is broken is named: the pass that left it, and those behind.
#[test]
fn broken_values_are_counted_by_pass() {
    let gpu = gpu();
    let lights = rig(vec![Light::point("l", DVec3::splat(0.3))]);
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(0.5)));
    build.room(DVec3::ZERO, 1.0, grey);
    let mut relit = Relit::new(build.scene(), &view(1.0), &lights, &Setup::new(16, 16));
    let counts =
        |relit: &Relit| -> Vec<u32> { relit.non_finite(&gpu, &lights).into_iter().map(|(_, count)| count).collect() };
    assert_eq!(counts(&relit), [0; 6]);
    let names: Vec<&str> = relit.non_finite(&gpu, &lights).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["shade light", "transfer", "resolve", "seen lights", "sum lights", "composite"]);
    let sound = relit.baked().1.samples.clone();
    relit.baked().1.samples.iter_mut().for_each(|sample| sample.brdf.diffuse = Vec3::NAN);
    let transfer = counts(&relit);
    assert!(transfer[0] == 0 && transfer[1] == 3 * 256 && transfer[5] > 0, "{transfer:?}");
    relit.baked().1.samples = sound;
    relit.baked().0.brdfs[0].diffuse.y = f32::INFINITY;
    let shading = counts(&relit);
    assert!(shading[0] == 256 && shading[1] == 256 && shading[5] > 0, "{shading:?}");
}

fn triangle() -> Scene {
    let mut build = Build::default();
    let material = build.material(lambert(Vec3::splat(ALBEDO)));
    let mut scene = build.quad(DVec3::ZERO, DVec3::X, DVec3::Y, material).scene();
    scene.mesh.triangles.truncate(1);
    scene.mesh.triangle_materials.truncate(1);
    scene
}

#[test]
fn numbers_of_triangles() {
    let gpu = gpu();
    let camera = look(3.0 * DVec3::Z, DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.8 });
    let lights = rig(vec![Light::point("l", DVec3::Z)]);
    let [first, indirect] = Relit::new(triangle(), &camera, &lights, &Setup::new(32, 32)).pictures(&gpu, &lights);
    assert!(first.iter().any(|p| p[0] > 0.0) && negative(&first) == 0.0);
    let most = indirect.iter().flatten().map(|x| f64::from(x.abs())).sum();
    let mut rows = vec![Row::new("one triangle", "no indirect light", 0.0, most)];
    for cuts in if full() { vec![65, 646] } else { vec![65] } {
        let scene = ball(cuts, shining(ALBEDO));
        let case = format!("a ball of {} triangles", scene.mesh.triangles.len());
        let stage = Stage::inside(scene);
        let errors = errors_with(&stage, ALBEDO, &settings(512, 128, 64));
        rows.extend(errors.rows(&case, ALBEDO, None));
    }
    check("numbers of triangles", &rows);
}

/// A picture as large as there is, or one line that says what is missing.
#[test]
fn the_largest_picture() {
    if !full() {
        return not_run("8192x8192 pixels take gigabytes: RELUME_FULL=1");
    }
    let folder = folder();
    let out = folder.path().join("a.png");
    let scene = crate::common::shipped("balls-2.glb");
    let mut render = relume();
    render.arg("render").arg(scene).arg("-o").arg(&out).args(["--size", "8192x8192", "--gi", "off", "--no-cache"]);
    let run = command::Run::of(&mut render);
    let done = run.code == Some(0) && out.exists();
    if !done {
        run.failed(&["8192x8192", "GB"]);
    }
    let asked = "the picture, or one line that says what it takes";
    check("the largest picture", &[Row::new("8192x8192 pixels without indirect light", asked, 0.0, 0.0)]);
}
