//! Scene: what an importer passes to the bake. Plain data in mesh space, no handles.
//!
//! World space is the file's space, in double precision. [Mesh space](MeshSpace) is recentred and of unit size, in
//! single precision. Lights and cameras stay in world space.

pub mod camera;
pub mod emitters;
pub mod light;
pub mod light_filter;
pub mod light_unit;
pub mod links;
pub mod material;
pub mod texture;

pub(crate) mod files;
mod gltf;
mod gltf_export;
pub mod memory;
mod mesh_builder;
mod mesh_part;
mod mesh_space;
mod obj;
pub mod rig;
pub mod sky_map;
mod tangents;
pub mod usd;
mod wide_light;

use std::path::{Path, PathBuf};

use glam::{Vec2, Vec3, Vec4};

pub use camera::{Camera, Projection};
pub use emitters::Emitters;
pub use gltf_export::export_gltf;
pub use light::{Light, LightGroup, LightKind};
pub use light_filter::{LightFilter, RigFiles};
pub use light_unit::LightUnit;
pub use links::{Links, ObjectSet, ResolvedLinks};
pub use material::{AlphaMode, Material, Surface, TextureRef};
pub use mesh_space::MeshSpace;
pub use rig::Rig;
pub use sky_map::{DomeMap, PhysicalSky, SkyMap};
pub use texture::{Encoding, Texture, Wrap};
pub use wide_light::WideLight;

use crate::error::{Error, Result};

/// Largest side of a picture, pixels: more is a mistake rather than a picture.
pub const MAX_IMAGE_SIDE: u32 = 16_384;

/// An imported scene file, ready to bake.
#[derive(Clone)]
pub struct Scene {
    pub path: PathBuf,
    pub mesh: Mesh,
    /// Mesh space of the mesh's bounds.
    pub space: MeshSpace,
    /// Never empty: index 0 is glTF's default material if the file has none.
    pub materials: Vec<Material>,
    /// Never empty: the first is the scene itself, without a name. Parents precede their children.
    pub objects: Vec<Object>,
    pub textures: Vec<Texture>,
    /// In file order; may be empty.
    pub cameras: Vec<Camera>,
    /// The lights of the file, and its emitters.
    pub rig: Rig,
    /// `extras.width/height` of the shown scene.
    pub image_size: Option<[u32; 2]>,
}

/// All triangles of a scene in mesh space, nodes flattened; one index addresses all attributes.
///
/// Optional attributes are empty if no material needs them.
#[derive(Clone, Default)]
pub struct Mesh {
    pub positions: Vec<Vec3>,
    /// Unit length; flat-shaded faces do not share vertices.
    pub normals: Vec<Vec3>,
    /// TEXCOORD_0 and TEXCOORD_1.
    pub uvs: [Vec<Vec2>; 2],
    /// COLOR_0, linear RGBA, multiplies the base colour.
    pub colors: Vec<Vec4>,
    /// xyz unit tangent, w the bitangent's sign (+1 or -1); only with normal maps.
    pub tangents: Vec<Vec4>,
    /// Counter-clockwise from the front; triangles of zero area are removed at import.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle, an index into [`Scene::materials`].
    pub triangle_materials: Vec<u32>,
    /// Per triangle, an index into [`Scene::objects`]; empty if all are of the first.
    pub triangle_objects: Vec<u32>,
}

/// A named node. Nodes that no name distinguishes are one object: those with equal names and one parent. A node without
/// a name belongs to its parent's object.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Object {
    pub name: String,
    /// Index into [`Scene::objects`].
    pub parent: u32,
}

impl Scene {
    /// Imports `.glb`, `.gltf` or `.obj`, by extension.
    pub fn load(path: &Path) -> Result<Self> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        let mut scene = match extension.as_str() {
            "glb" | "gltf" => gltf::load(path),
            "obj" => obj::load(path),
            _ => Err(Error::import(path, "not a scene: expected .glb, .gltf or .obj")),
        }?;
        scene.rig = Emitters::of(&scene).complete(&scene.rig).into_owned();
        Ok(scene)
    }

    /// Whether any surface is a perfect mirror somewhere.
    pub fn has_mirrors(&self) -> bool {
        (0..self.materials.len() as u32).any(|material| self.may_mirror(material))
    }

    /// Whether a material is a perfect mirror somewhere.
    pub fn may_mirror(&self, material: u32) -> bool {
        self.materials[material as usize].least_roughness(&self.textures) == 0.0
    }

    /// Default image size through `camera`: the scene's own, else 480 rows with the camera's aspect ratio, else
    /// 720x480.
    pub fn default_size(&self, camera: Option<&Camera>) -> [u32; 2] {
        let of_aspect = |aspect: f64| [(480.0 * aspect).round().clamp(1.0, f64::from(MAX_IMAGE_SIDE)) as u32, 480];
        let of_camera = || camera.and_then(|camera| camera.aspect).map(of_aspect);
        self.image_size.or_else(of_camera).unwrap_or([720, 480])
    }

    /// File stem, the value of `{scene}` in messages and tables.
    pub fn name(&self) -> String {
        self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }
}

impl Mesh {
    /// Bounding box (min, max) of all vertices that triangles use; zeros if there are none.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let mut used = self.triangles.iter().flatten().map(|&i| self.positions[i as usize]);
        let Some(first) = used.next() else { return (Vec3::ZERO, Vec3::ZERO) };
        used.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p)))
    }

    /// Index of a triangle's object.
    pub fn object(&self, triangle: u32) -> usize {
        self.triangle_objects.get(triangle as usize).map_or(0, |&object| object as usize)
    }
}
