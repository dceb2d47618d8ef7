//! Images in and out, and how they differ.

pub mod compare;
pub mod exr;
pub mod file;
pub mod png;

/// Layers of linear RGB, all of one size. Row 0 is the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    pub width: usize,
    pub height: usize,
    /// In file order. The unnamed layer is `""`; others are called as in the file, `direct` or `light.key`.
    pub layers: Vec<Layer>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layer {
    pub name: String,
    /// width * height, row by row.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    pub fn layer(&self, name: &str) -> Option<&Layer> {
        self.layers.iter().find(|layer| layer.name == name)
    }
}
