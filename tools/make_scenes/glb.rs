//! A glTF 2.0 binary writer: float32 positions, normals and texture coordinates, metallic-roughness materials with PNG
//! textures.

use glam::{DQuat, DVec2, DVec3};
use serde_json::{Value, json};

use crate::mesh::Mesh;

/// What one .glb file holds; drawn and stored in this order.
pub struct Scene {
    pub name: &'static str,
    pub image_size: [u32; 2],
    pub camera: Camera,
    pub lights: Vec<Light>,
    pub objects: Vec<Object>,
    /// What materials look up by name.
    pub textures: Vec<Texture>,
}

pub struct Texture {
    pub name: &'static str,
    /// A PNG file.
    pub png: Vec<u8>,
}

pub struct Camera {
    pub position: DVec3,
    pub target: DVec3,
    pub yfov_deg: f64,
}

pub struct Light {
    pub position: DVec3,
    /// Linear Rec. 709.
    pub color: [f64; 3],
    /// Candela.
    pub intensity: f64,
    pub cone: Option<Cone>,
}

/// What makes a light a spot.
pub struct Cone {
    pub target: DVec3,
    pub inner_deg: f64,
    pub outer_deg: f64,
}

pub struct Object {
    pub name: String,
    pub mesh: Mesh,
    pub translation: DVec3,
    /// Turn about +Y.
    pub yaw_deg: f64,
    pub material: Material,
}

#[derive(Clone, Copy, PartialEq)]
pub struct Material {
    pub name: &'static str,
    pub base_color: [f64; 3],
    pub metallic: f64,
    pub roughness: f64,
    /// Linear Rec. 709 radiance; above 1 it takes `KHR_materials_emissive_strength`.
    pub emissive: [f64; 3],
    /// Of a texture; each multiplies the factor above.
    pub base_color_map: Option<&'static str>,
    pub metallic_roughness_map: Option<&'static str>,
    pub normal_map: Option<&'static str>,
    pub emissive_map: Option<&'static str>,
    /// Not there where alpha is below.
    pub alpha_cutoff: Option<f64>,
    pub double_sided: bool,
}

const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const FLOAT: u32 = 5126;
const U16: u32 = 5123;
const U32: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

impl Scene {
    pub fn triangle_count(&self) -> usize {
        self.objects.iter().map(|object| object.mesh.triangles.len()).sum()
    }

    /// The bytes of the .glb file.
    pub fn to_glb(&self) -> Vec<u8> {
        let mut buffer = Buffer::default();
        let mut nodes = Vec::new();
        let mut meshes = Vec::new();
        let mut materials: Vec<Material> = Vec::new();
        for object in &self.objects {
            let material = materials.iter().position(|m| *m == object.material).unwrap_or_else(|| {
                materials.push(object.material);
                materials.len() - 1
            });
            let mut node = json!({"name": object.name, "mesh": meshes.len()});
            if object.translation != DVec3::ZERO {
                node["translation"] = single(object.translation.to_array());
            }
            if object.yaw_deg != 0.0 {
                node["rotation"] = single(DQuat::from_rotation_y(object.yaw_deg.to_radians()).to_array());
            }
            nodes.push(node);
            let mut attributes = json!({
                "POSITION": buffer.push_vectors(&object.mesh.positions, Bounds::Stored),
                "NORMAL": buffer.push_vectors(&object.mesh.normals, Bounds::Omitted),
            });
            if object.material.maps().next().is_some() {
                attributes["TEXCOORD_0"] = json!(buffer.push_uvs(&object.mesh.uvs));
            }
            meshes.push(json!({"name": object.name, "primitives": [{
                "attributes": attributes,
                "indices": buffer.push_triangles(&object.mesh),
                "material": material,
            }]}));
        }
        let mut lights = Vec::new();
        for light in &self.lights {
            let kind = if light.cone.is_some() { "spot" } else { "point" };
            let name = format!("{kind}{}", lights.len());
            let mut node = json!({
                "name": name,
                "translation": single(light.position.to_array()),
                "extensions": {"KHR_lights_punctual": {"light": lights.len()}},
            });
            let mut entry = json!({
                "name": name, "type": kind, "color": single(light.color), "intensity": light.intensity as f32,
            });
            if let Some(cone) = &light.cone {
                node["rotation"] = single(look_along(cone.target - light.position).to_array());
                entry["spot"] = json!({
                    "innerConeAngle": cone.inner_deg.to_radians() as f32,
                    "outerConeAngle": cone.outer_deg.to_radians() as f32,
                });
            }
            nodes.push(node);
            lights.push(entry);
        }
        nodes.push(json!({
            "name": "camera",
            "camera": 0,
            "translation": single(self.camera.position.to_array()),
            "rotation": single(look_along(self.camera.target - self.camera.position).to_array()),
        }));
        let [width, height] = self.image_size;
        let images: Vec<Value> = self.textures.iter().map(|t| buffer.push_image(t)).collect();
        let mut extensions = vec!["KHR_lights_punctual"];
        if materials.iter().any(|m| m.emissive_strength() > 1.0) {
            extensions.push("KHR_materials_emissive_strength");
        }
        let mut document = json!({
            "asset": {"version": "2.0", "generator": "relume make_scenes"},
            "scene": 0,
            "scenes": [{
                "name": self.name,
                "nodes": (0..nodes.len()).collect::<Vec<_>>(),
                "extras": {"width": width, "height": height},
            }],
            "nodes": nodes,
            "meshes": meshes,
            "materials": materials.iter().map(|m| m.json(&self.textures)).collect::<Vec<_>>(),
            "cameras": [{"name": "camera", "type": "perspective", "perspective": {
                "aspectRatio": (f64::from(width) / f64::from(height)) as f32,
                "yfov": self.camera.yfov_deg.to_radians() as f32,
                "znear": 0.05f32,
                "zfar": 100.0f32,
            }}],
            "extensionsUsed": extensions,
            "extensions": {"KHR_lights_punctual": {"lights": lights}},
            "buffers": [{"byteLength": buffer.bytes.len()}],
            "bufferViews": buffer.views,
            "accessors": buffer.accessors,
        });
        if !images.is_empty() {
            document["samplers"] = json!([{"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR}]);
            document["textures"] = (0..images.len()).map(|i| json!({"sampler": 0, "source": i})).collect();
            document["images"] = Value::Array(images);
        }
        pack(document.to_string().into_bytes(), buffer.bytes)
    }
}

impl Material {
    /// Grey of 0.5, rough, opaque.
    pub const PLAIN: Self = Self {
        name: "plain",
        base_color: [0.5; 3],
        metallic: 0.0,
        roughness: 1.0,
        emissive: [0.0; 3],
        base_color_map: None,
        metallic_roughness_map: None,
        normal_map: None,
        emissive_map: None,
        alpha_cutoff: None,
        double_sided: false,
    };

    fn maps(&self) -> impl Iterator<Item = &'static str> {
        [self.base_color_map, self.metallic_roughness_map, self.normal_map, self.emissive_map].into_iter().flatten()
    }

    /// What the emissive factor, at most 1, is multiplied by.
    fn emissive_strength(&self) -> f64 {
        self.emissive.into_iter().fold(1.0, f64::max)
    }

    /// # Panics
    /// If a map is none of `textures`.
    fn json(&self, textures: &[Texture]) -> Value {
        let map = |name: &str| {
            let index = textures.iter().position(|t| t.name == name);
            json!({"index": index.unwrap_or_else(|| panic!("{}: there is no texture {name}", self.name))})
        };
        let [r, g, b] = self.base_color.map(|c| c as f32);
        let mut material = json!({"name": self.name, "pbrMetallicRoughness": {
            "baseColorFactor": [r, g, b, 1.0],
            "metallicFactor": self.metallic as f32,
            "roughnessFactor": self.roughness as f32,
        }});
        if let Some(name) = self.base_color_map {
            material["pbrMetallicRoughness"]["baseColorTexture"] = map(name);
        }
        if let Some(name) = self.metallic_roughness_map {
            material["pbrMetallicRoughness"]["metallicRoughnessTexture"] = map(name);
        }
        if let Some(name) = self.normal_map {
            material["normalTexture"] = map(name);
        }
        if self.emissive != [0.0; 3] {
            let strength = self.emissive_strength();
            material["emissiveFactor"] = single(self.emissive.map(|e| e / strength));
            if strength > 1.0 {
                let entry = json!({"emissiveStrength": strength as f32});
                material["extensions"] = json!({"KHR_materials_emissive_strength": entry});
            }
        }
        if let Some(name) = self.emissive_map {
            material["emissiveTexture"] = map(name);
        }
        if let Some(cutoff) = self.alpha_cutoff {
            material["alphaMode"] = json!("MASK");
            material["alphaCutoff"] = json!(cutoff as f32);
        }
        if self.double_sided {
            material["doubleSided"] = json!(true);
        }
        material
    }
}

/// The binary chunk and the JSON that points into it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

#[derive(PartialEq)]
enum Bounds {
    Stored,
    Omitted,
}

impl Buffer {
    /// Returns the accessor's index.
    fn push_vectors(&mut self, vectors: &[DVec3], bounds: Bounds) -> usize {
        let bytes = vectors.iter().flat_map(|v| v.as_vec3().to_array()).flat_map(f32::to_le_bytes).collect();
        let mut accessor = json!({"componentType": FLOAT, "count": vectors.len(), "type": "VEC3"});
        if bounds == Bounds::Stored {
            accessor["min"] = single(vectors.iter().copied().reduce(DVec3::min).unwrap_or_default().to_array());
            accessor["max"] = single(vectors.iter().copied().reduce(DVec3::max).unwrap_or_default().to_array());
        }
        self.push(bytes, ARRAY_BUFFER, accessor)
    }

    /// Returns the accessor's index.
    fn push_uvs(&mut self, uvs: &[DVec2]) -> usize {
        let bytes = uvs.iter().flat_map(|uv| uv.as_vec2().to_array()).flat_map(f32::to_le_bytes).collect();
        let accessor = json!({"componentType": FLOAT, "count": uvs.len(), "type": "VEC2"});
        self.push(bytes, ARRAY_BUFFER, accessor)
    }

    /// Returns the image's entry.
    fn push_image(&mut self, texture: &Texture) -> Value {
        let view = self.push_bytes(texture.png.clone(), None);
        json!({"name": texture.name, "mimeType": "image/png", "bufferView": view})
    }

    /// Returns the accessor's index. 65,535 is glTF's restart value and stays unused.
    fn push_triangles(&mut self, mesh: &Mesh) -> usize {
        let indices = mesh.triangles.iter().flatten();
        let (bytes, component_type) = if mesh.positions.len() < 65_536 {
            (indices.flat_map(|&i| (i as u16).to_le_bytes()).collect(), U16)
        } else {
            (indices.flat_map(|&i| i.to_le_bytes()).collect(), U32)
        };
        let accessor = json!({"componentType": component_type, "count": mesh.triangles.len() * 3, "type": "SCALAR"});
        self.push(bytes, ELEMENT_ARRAY_BUFFER, accessor)
    }

    fn push(&mut self, bytes: Vec<u8>, target: u32, mut accessor: Value) -> usize {
        accessor["bufferView"] = json!(self.push_bytes(bytes, Some(target)));
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Returns the view's index.
    fn push_bytes(&mut self, bytes: Vec<u8>, target: Option<u32>) -> usize {
        let mut view = json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()});
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }
}

/// JSON numbers in single precision: the last bits of a sine differ between C libraries, committed bytes must not.
/// Adding zero turns -0 into 0.
fn single<const N: usize>(values: [f64; N]) -> Value {
    json!(values.map(|v| v as f32 + 0.0).to_vec())
}

/// Turns -Z along `direction`, keeping +Y as near to up as can be. Square roots only, see [`single`].
fn look_along(direction: DVec3) -> DQuat {
    let forward = direction.normalize();
    let up = if forward.y.abs() > 0.999 { DVec3::NEG_Z } else { DVec3::Y };
    let right = forward.cross(up).normalize();
    DQuat::from_mat3(&glam::DMat3::from_cols(right, right.cross(forward), -forward)).normalize()
}

/// Header, JSON chunk padded with spaces, binary chunk padded with zeros.
fn pack(mut json: Vec<u8>, binary: Vec<u8>) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF".to_vec();
    for word in [2, 12 + 8 + json.len() + 8 + binary.len(), json.len()] {
        glb.extend((word as u32).to_le_bytes());
    }
    glb.extend(b"JSON");
    glb.extend(json);
    glb.extend((binary.len() as u32).to_le_bytes());
    glb.extend(b"BIN\0");
    glb.extend(binary);
    glb
}
