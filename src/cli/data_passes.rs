//! What pixels see, as EXR channels: depth, normals, positions, colours, mattes.

use relume::bake::channels::Channel;
use relume::bake::{DeepFramebuffer, Thing};
use relume::image::DataChannel;
use relume::image::cryptomatte::Cryptomatte;
use relume::trace::bvh::TracedScene;

/// Data of the surface at the centre of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Data {
    /// Distance from the camera, metres.
    Depth,
    /// World space, normal map included.
    Normal,
    /// World space, metres.
    Position,
}

/// Depth of pixels that see nothing, as Blender has it: far away for every compositor.
const NOTHING: f32 = 1e10;

impl Data {
    pub fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Normal => "normal",
            Self::Position => "position",
        }
    }
}

/// What the pixels of a view see.
pub struct Surfaces<'a> {
    pub scene: &'a TracedScene,
    pub framebuffer: &'a DeepFramebuffer,
}

impl Surfaces<'_> {
    /// Width and height, pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.framebuffer.tiling.width as usize, self.framebuffer.tiling.height as usize)
    }

    pub fn channels(&self, data: Data) -> Vec<DataChannel> {
        let (channel, letters, nothing) = match data {
            Data::Depth => (Channel::Distance, &["Z"][..], NOTHING),
            Data::Normal => (Channel::Normal, &["X", "Y", "Z"][..], 0.0),
            Data::Position => (Channel::Position, &["X", "Y", "Z"][..], 0.0),
        };
        let values = self.framebuffer.channel(channel, 0, self.scene.space);
        let of_letter = |(index, letter): (usize, &&str)| DataChannel {
            name: format!("{}.{letter}", data.name()),
            values: values.iter().map(|value| value.map_or(nothing, |value| value[index])).collect(),
        };
        letters.iter().enumerate().map(of_letter).collect()
    }

    /// Base colours, linear Rec. 709; black where nothing is seen.
    pub fn albedo(&self) -> Vec<[f32; 3]> {
        let values = self.framebuffer.channel(Channel::BaseColor, 0, self.scene.space);
        values.into_iter().map(|value| value.unwrap_or_default().to_array()).collect()
    }

    /// Of objects, and of materials.
    pub fn cryptomattes(&self) -> [Cryptomatte; 2] {
        let objects: Vec<String> = self.scene.objects.iter().map(|object| object.name.clone()).collect();
        let materials: Vec<String> = self.scene.materials.iter().map(|material| material.name.clone()).collect();
        [("CryptoObject", objects, Thing::Object), ("CryptoMaterial", materials, Thing::Material)]
            .map(|(layer, names, of)| Cryptomatte::new(layer, &names, &self.framebuffer.coverage(self.scene, of)))
    }
}
