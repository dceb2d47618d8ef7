//! The scenes that ship with relume.

use std::f64::consts::TAU;

use glam::{DVec3, dvec3};

use crate::glb::{Camera, Cone, Light, Material, Object, Scene};
use crate::mesh::{Mesh, cuboid, quad, sphere};
use crate::{room, statues};

/// Small enough to be kept in git.
pub fn small() -> Vec<Scene> {
    vec![
        cornell("cornell-diffuse", WHITE, matte("block", [0.73, 0.73, 0.73]), matte("ball", [0.25, 0.35, 0.75])),
        cornell("cornell-glossy", WHITE, GLOSSY_METAL, GLOSSY_PLASTIC),
        cornell("cornell-glossy-floor", GLOSSY_FLOOR, GLOSSY_METAL, GLOSSY_PLASTIC),
        balls("balls-2", key_and_rim()),
        balls("balls-16", ROUND_THE_BALLS.lights()),
    ]
}

/// Too large for git: made when first wanted.
pub fn large() -> Vec<Scene> {
    let (figure, knot) = (statues::figure(), statues::knot());
    vec![
        statues("statues-2", raking(), figure.clone(), knot.clone()),
        statues("statues-16", BEFORE_THE_STATUES.lights(), figure, knot),
        room::scene(false),
        room::scene(true),
    ]
}

const ROUND_THE_BALLS: Arc = Arc {
    target: dvec3(0.0, 0.4, 0.0),
    radius: 3.2,
    heights: [2.2, 3.0, 3.8],
    start_deg: 0.0,
    step_deg: 22.5,
    point: 4.0,
    spot: 12.0,
};
/// In front of the back wall.
const BEFORE_THE_STATUES: Arc = Arc {
    target: dvec3(0.0, 0.45, 0.0),
    radius: 1.9,
    heights: [1.35, 1.7, 2.05],
    start_deg: -8.0,
    step_deg: 196.0 / 15.0,
    point: 0.7,
    spot: 4.0,
};

const WHITE: Material = matte("white", [0.73, 0.73, 0.73]);
/// Roughness² = 0.3 = alpha.
const GLOSSY_FLOOR: Material =
    Material { name: "glossy_floor", base_color: [0.7, 0.7, 0.7], metallic: 0.6, roughness: 0.5477, ..Material::PLAIN };
const GLOSSY_METAL: Material =
    Material { name: "glossy_metal", base_color: [0.9, 0.85, 0.75], metallic: 1.0, roughness: 0.3, ..Material::PLAIN };
const GLOSSY_PLASTIC: Material = Material {
    name: "glossy_plastic",
    base_color: [0.25, 0.35, 0.75],
    metallic: 0.0,
    roughness: 0.3,
    ..Material::PLAIN
};

const fn matte(name: &'static str, base_color: [f64; 3]) -> Material {
    Material { name, base_color, metallic: 0.0, roughness: 1.0, ..Material::PLAIN }
}

fn placed(name: &'static str, mesh: Mesh, translation: DVec3, yaw_deg: f64, material: Material) -> Object {
    Object { name: name.into(), mesh, translation, yaw_deg, material }
}

fn fixed(name: &'static str, mesh: Mesh, material: Material) -> Object {
    placed(name, mesh, DVec3::ZERO, 0.0, material)
}

/// A two-metre box, open towards the camera, with a block and a ball.
fn cornell(name: &'static str, floor: Material, block: Material, ball: Material) -> Scene {
    let (x, y, z) = (2.0 * DVec3::X, 2.0 * DVec3::Y, 2.0 * DVec3::Z);
    let red = matte("red", [0.65, 0.05, 0.05]);
    let green = matte("green", [0.12, 0.45, 0.15]);
    Scene {
        name,
        image_size: [512, 512],
        textures: Vec::new(),
        camera: Camera { position: dvec3(0.0, 1.0, 3.6), target: dvec3(0.0, 1.0, 0.0), yfov_deg: 42.0 },
        lights: vec![Light {
            position: dvec3(0.0, 1.95, 0.0),
            color: [1.0; 3],
            intensity: 7.0,
            cone: Some(Cone { target: DVec3::ZERO, inner_deg: 40.0, outer_deg: 80.0 }),
        }],
        objects: vec![
            fixed("floor", quad(dvec3(-1.0, 0.0, -1.0), z, x), floor),
            fixed("ceiling", quad(dvec3(-1.0, 2.0, -1.0), x, z), WHITE),
            fixed("back_wall", quad(dvec3(-1.0, 0.0, -1.0), x, y), WHITE),
            fixed("left_wall", quad(dvec3(-1.0, 0.0, -1.0), y, z), red),
            fixed("right_wall", quad(dvec3(1.0, 0.0, -1.0), z, y), green),
            placed("block", cuboid(dvec3(-0.3, 0.0, -0.3), dvec3(0.3, 1.2, 0.3)), dvec3(-0.35, 0.0, -0.3), 18.0, block),
            placed("ball", sphere(0.36, 64, 64), dvec3(0.42, 0.36, 0.32), 0.0, ball),
        ],
    }
}

/// One diffuse and four mirror balls on the ground: 5 x 1,984 + 2 = 9,922 triangles, as in [Hasan 2006].
fn balls(name: &'static str, lights: Vec<Light>) -> Scene {
    let mirror = |name, base_color| Material { name, base_color, metallic: 1.0, roughness: 0.0, ..Material::PLAIN };
    let ball = |name, radius, x, z, material| placed(name, sphere(radius, 32, 32), dvec3(x, radius, z), 0.0, material);
    Scene {
        name,
        image_size: [720, 480],
        textures: Vec::new(),
        camera: Camera { position: dvec3(0.0, 1.9, 5.2), target: dvec3(0.0, 0.45, 0.0), yfov_deg: 36.0 },
        lights,
        objects: vec![
            fixed(
                "ground",
                quad(dvec3(-6.0, 0.0, -6.0), 12.0 * DVec3::Z, 12.0 * DVec3::X),
                matte("ground", [0.6, 0.6, 0.58]),
            ),
            ball("ball_diffuse", 0.60, 0.0, 0.0, matte("diffuse_ball", [0.75, 0.25, 0.15])),
            ball("ball_silver", 0.50, -1.35, 0.35, mirror("silver", [0.95, 0.95, 0.95])),
            ball("ball_gold", 0.50, 1.35, 0.35, mirror("gold", [0.95, 0.80, 0.50])),
            ball("ball_steel", 0.55, -0.72, -1.25, mirror("steel", [0.60, 0.80, 0.95])),
            ball("ball_copper", 0.35, 0.78, 1.05, mirror("copper", [0.90, 0.60, 0.60])),
        ],
    }
}

/// Two sculptures on a half-mirror floor between three walls.
fn statues(name: &'static str, lights: Vec<Light>, figure: Mesh, knot: Mesh) -> Scene {
    let (x, y, z) = (4.4 * DVec3::X, 2.2 * DVec3::Y, 4.0 * DVec3::Z);
    let mirror_floor = Material {
        name: "mirror_floor",
        base_color: [0.75, 0.75, 0.72],
        metallic: 0.25,
        roughness: 0.0,
        ..Material::PLAIN
    };
    let marble =
        Material { name: "marble", base_color: [0.78, 0.74, 0.68], metallic: 0.0, roughness: 0.9, ..Material::PLAIN };
    let jade =
        Material { name: "jade", base_color: [0.20, 0.55, 0.30], metallic: 0.0, roughness: 0.35, ..Material::PLAIN };
    Scene {
        name,
        image_size: [720, 480],
        textures: Vec::new(),
        camera: Camera { position: dvec3(0.0, 1.1, 3.5), target: dvec3(0.0, 0.5, 0.0), yfov_deg: 32.0 },
        lights,
        objects: vec![
            fixed("floor", quad(dvec3(-2.2, 0.0, -1.5), z, x), mirror_floor),
            fixed("back_wall", quad(dvec3(-2.2, 0.0, -1.5), x, y), WHITE),
            fixed("left_wall", quad(dvec3(-2.2, 0.0, -1.5), y, z), matte("warm", [0.70, 0.45, 0.25])),
            fixed("right_wall", quad(dvec3(2.2, 0.0, -1.5), z, y), matte("cool", [0.25, 0.45, 0.65])),
            placed("figure", figure, dvec3(-0.58, 0.0, 0.2), 18.0, marble),
            placed("knot", knot, dvec3(0.58, 0.0, -0.1), -20.0, jade),
        ],
    }
}

/// A low warm lamp on the left that brings out folds, a cool spot from above right.
fn raking() -> Vec<Light> {
    vec![
        Light { position: dvec3(-1.9, 1.25, 0.75), color: [1.0, 0.90, 0.78], intensity: 4.0, cone: None },
        Light {
            position: dvec3(1.9, 2.1, 0.7),
            color: [0.80, 0.90, 1.0],
            intensity: 9.0,
            cone: Some(Cone { target: dvec3(-0.1, 0.45, 0.0), inner_deg: 20.0, outer_deg: 34.0 }),
        },
    ]
}

/// A warm point light on the left and a cool spot on the right.
fn key_and_rim() -> Vec<Light> {
    vec![
        Light { position: dvec3(-2.5, 3.5, 2.5), color: [1.0, 0.95, 0.9], intensity: 30.0, cone: None },
        Light {
            position: dvec3(2.8, 3.8, 1.5),
            color: [0.85, 0.92, 1.0],
            intensity: 60.0,
            cone: Some(Cone { target: dvec3(0.0, 0.3, 0.0), inner_deg: 18.0, outer_deg: 28.0 }),
        },
    ]
}

/// Eight point lights and eight spots by turns, in the colours of the wheel, evenly along part of a circle.
struct Arc {
    target: DVec3,
    radius: f64,
    heights: [f64; 3],
    /// From +X towards +Z.
    start_deg: f64,
    step_deg: f64,
    /// Candela.
    point: f64,
    spot: f64,
}

impl Arc {
    fn lights(&self) -> Vec<Light> {
        (0..16).map(|i| self.light(i)).collect()
    }

    fn light(&self, i: usize) -> Light {
        let (sin, cos) = (self.start_deg + self.step_deg * i as f64).to_radians().sin_cos();
        let hue = TAU * i as f64 / 16.0;
        let is_spot = i % 2 == 1;
        Light {
            position: dvec3(self.radius * cos, self.heights[i % 3], self.radius * sin),
            color: [0.0, 1.0, 2.0].map(|third| 0.55 + 0.45 * (hue - TAU * third / 3.0).cos()),
            intensity: if is_spot { self.spot } else { self.point },
            cone: is_spot.then_some(Cone { target: self.target, inner_deg: 12.0, outer_deg: 26.0 }),
        }
    }
}
