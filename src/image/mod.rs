//! Image files and image comparison.

pub mod compare;
pub mod cryptomatte;
pub mod display_view;
pub mod exr;
mod exr_read;
pub mod png;
pub mod primaries;

use glam::{DMat3, Vec3};
use rayon::prelude::*;

/// Layers of linear RGB, all of one size. Row 0 is the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    pub width: usize,
    pub height: usize,
    /// In file order. The unnamed layer is `""`; others have their name in the file, `direct` or `light.key`.
    pub layers: Vec<Layer>,
    /// Channels that are no colours: distances, normals, mattes. Only written, not read.
    pub data: Vec<DataChannel>,
}

/// A channel that is no colour.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataChannel {
    /// In the file, like `normal.X`.
    pub name: String,
    /// width * height, row by row.
    pub values: Vec<f32>,
}

/// One named layer of linear RGB.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layer {
    pub name: String,
    /// width * height, row by row.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// An image with only the unnamed layer; `pixels` are width * height, row by row.
    pub fn single(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Self {
        Self { width, height, ..Self::default() }.with_layer("", pixels)
    }

    /// Adds a layer and returns the image; the name must be new, and `pixels` must fill the image's size.
    pub fn with_layer(mut self, name: impl Into<String>, pixels: Vec<[f32; 3]>) -> Self {
        self.push_layer(name, pixels);
        self
    }

    /// Adds a layer; the name must be new, and `pixels` must fill the image's size.
    pub fn push_layer(&mut self, name: impl Into<String>, pixels: Vec<[f32; 3]>) {
        let name = name.into();
        assert_eq!(pixels.len(), self.width * self.height, "layer `{name}` of {}x{}", self.width, self.height);
        assert!(self.layers.iter().all(|layer| layer.name != name), "layer `{name}` exists already");
        self.layers.push(Layer { name, pixels });
    }

    /// Multiplies the colours of all layers by a matrix.
    fn map_pixels(&mut self, matrix: DMat3) {
        let map = |pixel: &mut [f32; 3]| *pixel = (matrix * Vec3::from_array(*pixel).as_dvec3()).as_vec3().to_array();
        self.layers.iter_mut().for_each(|layer| layer.pixels.par_iter_mut().for_each(map));
    }

    /// The layer called `name`; `beauty` is the unnamed layer unless a layer has this name.
    pub fn layer(&self, name: &str) -> Option<&Layer> {
        let exactly = |name: &str| self.layers.iter().find(|layer| layer.name == name);
        exactly(name).or_else(|| if name == "beauty" { exactly("") } else { None })
    }
}

impl Layer {
    /// Relative luminance of every pixel, row by row.
    pub fn luminance(&self) -> Vec<f32> {
        self.pixels.iter().copied().map(luminance).collect()
    }
}

/// Relative luminance of linear Rec. 709, in the unit of its channels [ITU-R BT.709-6, Section 3].
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}
