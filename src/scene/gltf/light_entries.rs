//! Lights as the JSON of a glTF file has them. The form of `EXT_lights_area` is that of the extension's draft, which
//! Babylon.js reads and writes.

use serde::Deserialize;

/// `KHR_lights_punctual`.
#[derive(Deserialize)]
pub struct LightEntry {
    pub name: Option<String>,
    #[serde(rename = "type")]
    pub kind: String,
    pub color: Option<[f32; 3]>,
    pub intensity: Option<f64>,
    pub range: Option<f64>,
    #[serde(default)]
    pub spot: Spot,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase")]
pub struct Spot {
    pub inner_cone_angle: Option<f64>,
    pub outer_cone_angle: Option<f64>,
}

/// `EXT_lights_area`.
#[derive(Deserialize)]
pub struct AreaLightEntry {
    pub name: Option<String>,
    #[serde(rename = "type")]
    pub kind: String,
    pub color: Option<[f32; 3]>,
    /// Nits.
    pub intensity: Option<f64>,
    /// Height of a rectangle, diameter of a disk.
    pub size: Option<f64>,
    #[serde(default)]
    pub rect: AreaRect,
}

#[derive(Deserialize, Default)]
pub struct AreaRect {
    /// Width relative to height.
    pub aspect: Option<f64>,
}

/// `EXT_lights_ies`: an IES file.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct ProfileEntry {
    pub name: Option<String>,
    pub uri: Option<String>,
    pub buffer_view: Option<usize>,
}

/// `EXT_lights_ies` of a node.
#[derive(Deserialize)]
pub struct ProfileInstance {
    pub light: usize,
    pub multiplier: Option<f64>,
    pub color: Option<[f32; 3]>,
}

/// `EXT_lights_image_based`. Its other fields follow from the images.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct ImageLightEntry {
    pub name: Option<String>,
    /// x, y, z, w.
    pub rotation: Option<[f64; 4]>,
    pub intensity: Option<f64>,
    /// Indices of images: mip levels, finest first, with six faces each.
    #[serde(default)]
    pub specular_images: Vec<Vec<usize>>,
}
