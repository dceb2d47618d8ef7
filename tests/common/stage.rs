//! Scenes made in code, and the whole way from a scene to its pictures.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use glam::{DVec3, Mat3, Vec2, Vec3, Vec4};
use relume::bake::transfer::Transfer;
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::relight::{Layers, RelightSettings, Relighter, Site, VisibilityMethod};
use relume::scene::rig::Rig;
use relume::scene::{Camera, Light, Material, MeshSpace, Object, Projection, Scene, Texture, TextureRef, Wrap};
use relume::trace::bvh::TracedScene;

use super::Gpu;

/// Quads in world space, on their way to a [`Scene`].
#[derive(Clone, Default)]
pub struct Build {
    pub quads: Vec<([DVec3; 4], usize)>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
}

impl Build {
    pub fn material(&mut self, material: Material) -> usize {
        self.materials.push(material);
        self.materials.len() - 1
    }

    /// For a material to look up; each quad shows all of it, u along its own u, v along its own v.
    pub fn texture(&mut self, texture: Texture) -> Option<TextureRef> {
        self.textures.push(texture);
        let texture = self.textures.len() - 1;
        Some(TextureRef { texture, uv_set: 0, uv_transform: Mat3::IDENTITY, wrap: [Wrap::Clamp; 2], is_nearest: false })
    }

    /// A parallelogram around `center`; its front is the side that u x v points to.
    pub fn quad(&mut self, center: DVec3, u: DVec3, v: DVec3, material: usize) -> &mut Self {
        self.quads.push(([center - u - v, center + u - v, center + u + v, center - u + v], material));
        self
    }

    /// A box around `center` with half the side `half`, seen from inside.
    pub fn room(&mut self, center: DVec3, half: f64, material: usize) -> &mut Self {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let (u, v) = (DVec3::new(axis.y, axis.z, axis.x), DVec3::new(axis.z, axis.x, axis.y));
            self.quad(center - axis * half, v * half, u * half, material);
            self.quad(center + axis * half, u * half, v * half, material);
        }
        self
    }

    /// Around the centre of its bounds, as importers do it.
    pub fn scene(&self) -> Scene {
        let corners = || self.quads.iter().flat_map(|(corners, _)| corners);
        let low = corners().copied().reduce(DVec3::min).expect("there is a quad");
        let high = corners().copied().reduce(DVec3::max).expect("there is a quad");
        let mut scene = Scene {
            path: "made-in-code.glb".into(),
            mesh: Default::default(),
            space: MeshSpace::around(low, high),
            materials: self.materials.clone(),
            objects: vec![Object::default()],
            textures: self.textures.clone(),
            cameras: Vec::new(),
            rig: rig(Vec::new()),
            image_size: None,
        };
        for (corners, material) in &self.quads {
            let first = scene.mesh.positions.len() as u32;
            let normal = (corners[1] - corners[0]).cross(corners[3] - corners[0]).normalize();
            scene.mesh.positions.extend(corners.map(|p| scene.space.from_world(p).as_vec3()));
            scene.mesh.normals.extend([normal.as_vec3(); 4]);
            if !self.textures.is_empty() {
                let tangent = (corners[1] - corners[0]).normalize().as_vec3();
                scene.mesh.uvs[0].extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
                scene.mesh.tangents.extend([tangent.extend(1.0); 4]);
            }
            scene.mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            scene.mesh.triangle_materials.extend([*material as u32; 2]);
        }
        scene
    }
}

/// A ball of flat triangles, seen from inside: the walls of a room cut up `cuts` times each way and blown up.
pub fn ball(cuts: usize, material: Material) -> Scene {
    let mut walls = Build::default();
    let material = walls.material(material);
    walls.room(DVec3::ZERO, 1.0, material);
    let mut build = Build { quads: Vec::new(), ..walls.clone() };
    // Even angles rather than even lengths.
    let along = |i: usize| 0.5 + 0.5 * ((i as f64 / cuts as f64 - 0.5) * FRAC_PI_2).tan();
    for (corners, _) in &walls.quads {
        let at = |i: usize, j: usize| {
            let (low, high) = (corners[0].lerp(corners[1], along(i)), corners[3].lerp(corners[2], along(i)));
            low.lerp(high, along(j)).normalize()
        };
        for (i, j) in (0..cuts).flat_map(|i| (0..cuts).map(move |j| (i, j))) {
            build.quads.push(([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], material));
        }
    }
    let mut scene = build.scene();
    // Quads are not quite flat: each triangle gets its own corners and normal.
    let mesh = &mut scene.mesh;
    let corners: Vec<[Vec3; 3]> = mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize])).collect();
    mesh.normals = corners.iter().flat_map(|[a, b, c]| [(b - a).cross(c - a).normalize(); 3]).collect();
    mesh.triangles = (0..corners.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    mesh.positions = corners.into_flattened();
    scene
}

/// Pure Lambert: `KHR_materials_specular` with a factor of 0.
pub fn lambert(albedo: Vec3) -> Material {
    Material { base_color: albedo.extend(1.0), metallic: 0.0, specular: 0.0, ..Default::default() }
}

pub fn mirror(color: Vec3, metallic: f32) -> Material {
    Material { base_color: color.extend(1.0), metallic, roughness: 0.0, ..Default::default() }
}

pub fn emitter(radiance: Vec3) -> Material {
    Material { base_color: Vec4::new(0.0, 0.0, 0.0, 1.0), emissive: radiance, ..lambert(Vec3::ZERO) }
}

pub fn rig(lights: Vec<Light>) -> Rig {
    Rig { lights, ..Rig::default() }
}

pub fn look(from: DVec3, to: DVec3, up: DVec3, projection: Projection) -> Camera {
    Camera::look_at(from, to, up, projection).expect("the pose is not degenerate")
}

/// How a picture is made.
#[derive(Clone)]
pub struct Setup {
    pub width: u32,
    pub height: u32,
    pub layers: u32,
    pub samples: u32,
    pub visibility: VisibilityMethod,
    pub shadow_size: u32,
    pub budget_bytes: Option<u64>,
    pub site: Option<Site>,
}

impl Setup {
    /// One sample a pixel, four layers, exact shadows.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            layers: 4,
            samples: 1,
            visibility: VisibilityMethod::Traced,
            shadow_size: 2048,
            budget_bytes: None,
            site: None,
        }
    }
}

/// A scene, baked.
pub struct Stage {
    pub scene: Arc<TracedScene>,
    pub framebuffer: Arc<DeepFramebuffer>,
    pub transfer: Option<Arc<Transfer>>,
}

impl Stage {
    pub fn new(scene: Scene, camera: &Camera, rig: &Rig, setup: &Setup) -> Self {
        let scene = TracedScene::new(scene);
        let settings =
            BakeSettings { width: setup.width, height: setup.height, layers: setup.layers, samples: setup.samples };
        let framebuffer = bake(&scene, camera, rig, &settings, &|_| ());
        Self { scene: Arc::new(scene), framebuffer: Arc::new(framebuffer), transfer: None }
    }

    pub fn relighter(&self, gpu: &Gpu, rig: &Rig, setup: &Setup) -> Relighter {
        let settings = RelightSettings {
            visibility: setup.visibility,
            shadow_size: setup.shadow_size,
            budget_bytes: setup.budget_bytes,
            site: setup.site,
            ..Default::default()
        };
        Relighter::new(gpu, &self.scene, &self.framebuffer, self.transfer.as_ref(), rig, &settings)
            .expect("the device has room")
    }
}

/// Linear pixels of the chosen layers under all lights.
pub fn pixels(relighter: &mut Relighter, layers: Layers) -> Vec<[f32; 3]> {
    relighter.linear(layers).expect("frames run").to_vec()
}

/// All the way: bakes `scene`, lights it, returns linear pixels.
pub fn render(gpu: &Gpu, scene: Scene, camera: &Camera, rig: &Rig, setup: &Setup, layers: Layers) -> Vec<[f32; 3]> {
    let stage = Stage::new(scene, camera, rig, setup);
    pixels(&mut stage.relighter(gpu, rig, setup), layers)
}
