//! Small glTF files made in code.

// Every test binary compiles this for itself and uses its own part of it.
#![allow(dead_code)]

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

pub const BYTE: u32 = 5120;
pub const UNSIGNED_BYTE: u32 = 5121;
pub const SHORT: u32 = 5122;
pub const UNSIGNED_SHORT: u32 = 5123;
pub const UNSIGNED_INT: u32 = 5125;
pub const FLOAT: u32 = 5126;

/// A glTF under construction: JSON to change at will, and one buffer.
pub struct Gltf {
    pub json: Value,
    pub bin: Vec<u8>,
}

impl Gltf {
    /// An empty scene.
    pub fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [], "meshes": [], "accessors": [], "bufferViews": []
        });
        Self { json, bin: Vec::new() }
    }

    /// A unit square in the plane z = 0 that faces +Z: four vertices with normals, six indices, node 0.
    pub fn square() -> Self {
        let mut gltf = Self::new();
        let positions = gltf.f32s(&SQUARE);
        let normals = gltf.f32s(&[[0.0, 0.0, 1.0]; 4]);
        let indices = gltf.indices(&[0, 1, 2, 0, 2, 3]);
        gltf.mesh(json!({"attributes": {"POSITION": positions, "NORMAL": normals}, "indices": indices}));
        gltf.root(json!({"mesh": 0}));
        gltf
    }

    /// That square, lit by a point and seen by a camera; changed.
    pub fn lit_square(change: impl FnOnce(&mut Self)) -> Self {
        let mut gltf = Self::square();
        gltf.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]);
        gltf.root(json!({"name": "eye", "camera": 0, "translation": [0.5, 0.5, 2.0]}));
        let lamp = gltf.light(json!({"type": "point", "intensity": 3.0}));
        let lamp = json!({ "KHR_lights_punctual": { "light": lamp } });
        gltf.root(json!({"name": "lamp", "translation": [0.3, 0.7, 1.0], "extensions": lamp}));
        change(&mut gltf);
        gltf
    }

    /// Adds bytes as a buffer view.
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        self.bin.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    /// Adds an accessor over bytes that it fills.
    pub fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.view(bytes);
        self.push("accessors", json!({"bufferView": view, "componentType": component, "type": kind, "count": count}))
    }

    pub fn f32s<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(&bytes, FLOAT, ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1], values.len())
    }

    pub fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(&bytes, UNSIGNED_SHORT, "SCALAR", values.len())
    }

    /// Adds a mesh of one primitive.
    pub fn mesh(&mut self, primitive: Value) -> usize {
        self.push("meshes", json!({"primitives": [primitive]}))
    }

    pub fn node(&mut self, node: Value) -> usize {
        self.push("nodes", node)
    }

    /// Adds a node to the scene's roots.
    pub fn root(&mut self, node: Value) -> usize {
        let index = self.node(node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(index.into());
        index
    }

    /// Adds a punctual light.
    pub fn light(&mut self, light: Value) -> usize {
        self.light_of("KHR_lights_punctual", light)
    }

    /// Adds a light to the list of `extension`.
    pub fn light_of(&mut self, extension: &str, light: Value) -> usize {
        if self.json["extensions"][extension]["lights"].is_null() {
            self.json["extensions"][extension]["lights"] = json!([]);
            self.uses(extension);
        }
        let lights = self.json["extensions"][extension]["lights"].as_array_mut().unwrap();
        lights.push(light);
        lights.len() - 1
    }

    /// Gives the scene an image-based light with six images as faces, +x first; returns the light's JSON to change.
    pub fn environment(&mut self, faces: &[Vec<u8>; 6]) -> &mut Value {
        let extension = "EXT_lights_image_based";
        let faces = faces.each_ref().map(|file| {
            let view = self.view(file);
            self.push("images", json!({"bufferView": view, "mimeType": "image/png"}))
        });
        let black = [[0.0; 3]; 9];
        let light = json!({"specularImages": [faces], "specularImageSize": 2, "irradianceCoefficients": black});
        let index = self.light_of(extension, light);
        self.json["scenes"][0]["extensions"][extension] = json!({ "light": index });
        &mut self.json["extensions"][extension]["lights"][index]
    }

    pub fn uses(&mut self, extension: &str) {
        self.push("extensionsUsed", extension.into());
    }

    pub fn push(&mut self, key: &str, value: Value) -> usize {
        if self.json[key].is_null() {
            self.json[key] = json!([]);
        }
        let array = self.json[key].as_array_mut().unwrap();
        array.push(value);
        array.len() - 1
    }

    pub fn to_glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if !self.bin.is_empty() && json["buffers"].is_null() {
            json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        }
        glb(json.to_string().as_bytes(), &self.bin)
    }

    pub fn write(&self, folder: &Path, name: &str) -> PathBuf {
        write(folder, name, &self.to_glb())
    }
}

pub const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

pub fn glb(json: &[u8], bin: &[u8]) -> Vec<u8> {
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, content, padding) in [(b"JSON", json, b' '), (b"BIN\0", bin, 0)] {
        let length = content.len().next_multiple_of(4);
        bytes.extend((length as u32).to_le_bytes());
        bytes.extend(kind);
        let end = bytes.len() + length;
        bytes.extend(content);
        bytes.resize(end, padding);
    }
    let total = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&total.to_le_bytes());
    bytes
}

pub fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// A PNG of 8-bit RGBA texels.
pub fn png(width: u32, height: u32, texels: &[[u8; 4]]) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let image = image::RgbaImage::from_raw(width, height, texels.as_flattened().to_vec()).unwrap();
    image.write_to(&mut file, image::ImageFormat::Png).unwrap();
    file.into_inner()
}
