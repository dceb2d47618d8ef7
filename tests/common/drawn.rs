//! Lights drawn in the free space of a scene, and the truth about the indirect light that they cast.

use std::path::PathBuf;

use glam::{DVec3, Vec3};
use relume::bake::gather_samples::is_back;
use relume::image::{Image, exr};
use relume::physics::sequence::Points;
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::scene::{Light, LightKind, Scene};
use relume::trace::bvh::TracedScene;

use super::shared;
use super::stage::rig;

/// A scene, and lights in it.
pub struct Drawn {
    pub scene: TracedScene,
    pub lights: Vec<Light>,
}

/// A shared scene with five lights drawn by seed 7. "-rougher" makes roughness 0.5477 of 0.3, so that 0.3 is alpha.
pub fn load(name: &str) -> Option<Drawn> {
    let file = name.trim_end_matches(ROUGHER);
    let mut scene = Scene::load(&shared(&format!("scenes/{file}.glb"))?).unwrap();
    if file != name {
        scene.path = format!("{name}.glb").into();
        scene.materials.iter_mut().filter(|m| m.roughness == 0.3).for_each(|m| m.roughness = 0.5477);
    }
    let scene = TracedScene::new(scene);
    let lights = lights(&scene, 7);
    Some(Drawn { scene, lights })
}

const ROUGHER: &str = "-rougher";

/// Three points, then two spots with half-angles of 15 to 35 degrees, at random in a scene's bounds: no nearer to any
/// surface than a twentieth of the bounds' diagonal, in no solid, and spots look at something.
fn lights(scene: &TracedScene, seed: u64) -> Vec<Light> {
    let (low, high) = scene.mesh.bounds();
    let points = Points::new(seed, 0);
    // How far it is to what lies there; 0 to a back, which only those see that stand in a solid or behind a wall.
    let sees = |at: Vec3, direction: Vec3| {
        let hit = scene.closest_hit(at, direction, f32::INFINITY);
        hit.map(|hit| if is_back(scene, &hit, direction) { 0.0 } else { hit.distance })
    };
    let is_free = |at: Vec3| {
        let directions = (0..256).map(|i| on_sphere(Points::new(1, 0).at(i, 0)));
        directions.filter_map(|d| sees(at, d)).all(|distance| distance > 0.1 * scene.bvh.radius)
    };
    let mut lights = Vec::new();
    for candidate in 0.. {
        let [x, y, z, _] = points.at(candidate, 0);
        let at = low + (high - low) * DVec3::new(x, y, z).as_vec3();
        let [u, v, angle, _] = points.at(candidate, 1);
        let direction = on_sphere([u, v, 0.0, 0.0]);
        if !is_free(at) || (lights.len() >= 3 && sees(at, direction).is_none()) {
            continue;
        }
        let mut light = Light::point(&format!("drawn {candidate}"), scene.space.to_world(at));
        if lights.len() >= 3 {
            let outer_angle = (15.0 + 20.0 * angle).to_radians();
            light = Light {
                kind: LightKind::Spot,
                direction: direction.as_dvec3().normalize(),
                inner_angle: 0.8 * outer_angle,
                outer_angle,
                ..light
            };
        }
        lights.push(light);
        if lights.len() == 5 {
            break;
        }
    }
    lights
}

fn on_sphere([u, v, ..]: [f64; 4]) -> Vec3 {
    let (sine, cosine) = (std::f64::consts::TAU * u).sin_cos();
    let z = 1.0 - 2.0 * v;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * cosine, r * sine, z).as_vec3()
}

/// How the path tracer makes the truth of a picture.
pub fn tracing(width: u32, height: u32) -> Settings {
    Settings {
        width,
        height,
        layers: 4,
        max_bounces: None,
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed: 1,
    }
}

/// Two halves with layers `direct` and `indirect`, row by row, of a light alone; traced once, then read.
pub fn truth(scene: &TracedScene, light: &Light, size: u32, samples: u32) -> [Image; 2] {
    let name = |half: &str| {
        let file = format!("{} {} {size} {samples} {half}.exr", scene.name(), light.name);
        PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("truth").join(file.replace(' ', "-"))
    };
    let paths = [name("a"), name("b")];
    if !paths.iter().all(|path| path.exists()) {
        let settings = tracing(size, size);
        let rig = rig(vec![light.clone()]);
        let tracer = PathTracer::new(scene, &scene.cameras[0], &rig, &settings);
        let film = tracer.trace(samples, &|| false, &|_| ());
        std::fs::create_dir_all(paths[0].parent().expect("it is in a folder")).unwrap();
        for (path, half) in paths.iter().zip([Half::A, Half::B]) {
            exr::write(path, &film.image(half, &[Layer::Direct, Layer::Indirect])).unwrap();
        }
    }
    paths.map(|path| exr::read(&path).unwrap())
}
