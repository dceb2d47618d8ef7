//! Shadow maps or traced rays. `Auto` measures once per device which of them is faster.

use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::shadow_map::ShadowMaps;
use crate::bake::{BakeSettings, bake};
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frames, Measurements};
use crate::physics::sequence::Points;
use crate::relight::RelightSettings;
use crate::scene::{Camera, Light, Material, Mesh, MeshSpace, Object, Projection, Rig, Scene};
use crate::trace::bvh::TracedScene;
use crate::trace::packet::{PACKET_SIZE, trace_all};

/// How visibility is determined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VisibilityMethod {
    /// Rays if a material blends, else what is faster on the device: see [`VisibilityTimes`].
    Auto,
    /// Shadow maps with percentage-closer filtering [Reeves 1987].
    Map,
    /// Exact rays on the CPU.
    Traced,
}

/// What a [`VisibilityMethod`] comes to for one scene on one device.
pub struct VisibilityChoice {
    /// Whether rays are traced; otherwise shadow maps are drawn.
    pub traced: bool,
    /// Why, for `--stats` and the log.
    pub reason: String,
}

/// Milliseconds that the visibility of one point light takes in a small scene, with all threads of the pool.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct VisibilityTimes {
    /// To draw a shadow map of default size on the device, and to look it up.
    pub map_ms: f64,
    /// To trace rays on the CPU.
    pub traced_ms: f64,
}

impl VisibilityMethod {
    /// Shadow maps render blended surfaces stochastically, with noise, so `Auto` traces scenes that have any.
    pub fn choose(self, context: &Arc<Context>, scene: &TracedScene) -> VisibilityChoice {
        let choice = |traced, reason: &str| VisibilityChoice { traced, reason: reason.into() };
        match self {
            Self::Map => choice(false, "as asked"),
            Self::Traced => choice(true, "as asked"),
            Self::Auto if scene.bvh.has_blends => choice(true, "a material blends"),
            Self::Auto => {
                match context.measurements.get(&VisibilityTimes::name(), || VisibilityTimes::measure(context)) {
                    Ok(times) => choice(times.traced(), &format!("measured: {times}")),
                    // Its memory may be too small for the measurement, and large enough for the picture.
                    Err(error) => choice(context.is_cpu(), &format!("by kind of device; not measured: {error}")),
                }
            }
        }
    }
}

impl VisibilityTimes {
    /// Those that are kept.
    pub fn kept(measurements: &Measurements) -> Option<Self> {
        measurements.kept(&Self::name())
    }

    /// Rays take longer with fewer threads.
    fn name() -> String {
        format!("visibility, {} threads", rayon::current_num_threads())
    }

    /// Whether tracing is faster.
    pub fn traced(self) -> bool {
        self.traced_ms < self.map_ms
    }

    fn measure(context: &Arc<Context>) -> Result<Self> {
        let scene = TracedScene::new(room());
        let camera = Camera::look_at(CAMERA, DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.0 })
            .expect("the camera looks from one place to another");
        let settings = BakeSettings { width: SIDE, height: SIDE, layers: 1, samples: 1 };
        let framebuffer = bake(&scene, &camera, &scene.rig, &settings, &|_| ());
        let samples = Buffer::from_slice(context, "measured view samples", &framebuffer.samples)?;
        let words = framebuffer.packets.len() * PACKET_SIZE / 4;
        let mut visibility = Buffer::new(context, "measured visibility", Access::HostWrites, words)?;
        let mut maps = ShadowMaps::new(context, &scene, RelightSettings::default().shadow_size)?;
        let mut frames = Frames::new(context)?;
        let light = Light::point("measured", LIGHT);
        let packed = light.pack(scene.space);
        let mut times = Self { map_ms: f64::INFINITY, traced_ms: f64::INFINITY };
        for _ in 0..RUNS {
            let start = Instant::now();
            let mut frame = frames.begin()?;
            maps.run(&mut frame, &light, &packed, &[(&samples, &visibility); REPEATS]);
            frame.finish()?;
            times.map_ms = times.map_ms.min(1e3 * start.elapsed().as_secs_f64());
            let start = Instant::now();
            (0..REPEATS).for_each(|_| {
                trace_all(&scene, &packed, &framebuffer.packets, bytemuck::cast_slice_mut(visibility.host_mut()))
            });
            times.traced_ms = times.traced_ms.min(1e3 * start.elapsed().as_secs_f64());
        }
        Ok(times)
    }
}

impl std::fmt::Display for VisibilityTimes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { map_ms, traced_ms } = self;
        write!(f, "a light takes {traced_ms:.2} ms with rays, {map_ms:.2} ms with a shadow map")
    }
}

/// The best of some runs counts; the first one also warms up.
const RUNS: usize = 3;
/// Width and height of the measured picture in pixels.
const SIDE: u32 = 256;
/// How often each view sample counts: together about as many as in a picture of default size. With fewer samples,
/// drawing the map would weigh too much.
const REPEATS: usize = 4;
const CAMERA: DVec3 = DVec3::new(0.2, 0.1, 0.5);
const LIGHT: DVec3 = DVec3::new(0.1, 0.45, 0.05);
/// Half the side of the room: mesh space has a radius of 1.
const HALF: f32 = 0.577;
/// Triangles in the room.
const OBSTACLES: u32 = 500;

/// A closed room with small triangles at random places.
fn room() -> Scene {
    let mut mesh = Mesh::default();
    let mut add = |corners: [Vec3; 3]| {
        let first = mesh.positions.len() as u32;
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        mesh.positions.extend(corners);
        mesh.normals.extend([normal; 3]);
        mesh.triangles.push([first, first + 1, first + 2]);
        mesh.triangle_materials.push(0);
    };
    for (axis, u, v) in [(Vec3::X, Vec3::Y, Vec3::Z), (Vec3::Y, Vec3::Z, Vec3::X), (Vec3::Z, Vec3::X, Vec3::Y)] {
        for (wall, u, v) in [(-axis, u, v), (axis, v, u)] {
            let corner = |s: f32, t: f32| HALF * (wall + s * u + t * v);
            add([corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0)]);
            add([corner(-1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)]);
        }
    }
    let points = Points::new(1, 0);
    for i in 0..OBSTACLES {
        let [center, u, v] = [0, 1, 2].map(|set| {
            let [x, y, z, _] = points.at(i, set);
            DVec3::new(x - 0.5, y - 0.5, z - 0.5).as_vec3()
        });
        add([center, center + 0.2 * u, center + 0.2 * v]);
    }
    Scene {
        path: "measured".into(),
        mesh,
        space: MeshSpace::WORLD,
        materials: vec![Material::default()],
        objects: vec![Object::default()],
        textures: Vec::new(),
        cameras: Vec::new(),
        rig: Rig::default(),
        image_size: None,
    }
}
