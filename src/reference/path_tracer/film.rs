//! Film: sums of samples for two independent halves of an image, stored by tile of pixels.

use glam::DVec3;

use crate::bake::framebuffer::view_samples::Tiling;
use crate::image::{Image, luminance};
use crate::shared::TILE_SIZE;

/// Pixels of a tile, padding included.
pub(super) const TILE_PIXELS: usize = (TILE_SIZE * TILE_SIZE) as usize;

// Indices of the sums of each pixel.
pub(super) const DIRECT: usize = 0;
pub(super) const REFLECTION: usize = 1;
pub(super) const INDIRECT: usize = 2;
pub(super) const INDIRECT_GLOSSY: usize = 3;
pub(super) const EMISSION: usize = 4;
/// Squares of the beauty, for its variance.
const SQUARES: usize = 5;
/// First of the sums for each bounce that has a layer; those for each light follow.
const BOUNCES: usize = 6;

/// A layer of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// Sum of direct, reflection, indirect and emission.
    Beauty,
    Direct,
    Reflection,
    Indirect,
    /// The part of `Indirect` that the pixel's specular lobe reflects.
    IndirectGlossy,
    Emission,
    /// Variance of the beauty's mean, per channel, assuming independent samples. An upper bound, since the samples are
    /// stratified.
    Variance,
    /// Light after exactly so many bounces, from 1.
    Bounce(u32),
    /// Contribution of one light of the rig, by its index.
    Light(u32),
}

/// Selection of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    A,
    B,
    /// The mean of both.
    Both,
}

/// Sums of one tile.
pub(super) struct Tile {
    /// `[half][pixel][sum]`.
    sums: Vec<DVec3>,
    /// Samples per pixel of each half.
    pub counts: [u32; 2],
}

/// One sample of a pixel: a value for each of its sums.
#[derive(Clone)]
pub(super) struct Sample {
    values: Vec<DVec3>,
    /// Index of the first light's value.
    lights: usize,
}

/// All tiles, in the order of `tiling`.
pub struct Film {
    pub(super) tiling: Tiling,
    pub(super) tiles: Vec<Tile>,
    bounce_layers: u32,
    /// Names of the lights that have layers.
    lights: Vec<String>,
}

/// Standard errors of a picture, estimated from the difference of its halves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandardErrors {
    /// Mean luminance.
    pub mean: f64,
    /// Standard error of the mean luminance, relative to it.
    pub of_mean: f64,
    /// Standard error of a pixel's luminance, root mean square over pixels, relative to the mean luminance.
    pub of_pixel: f64,
}

impl Tile {
    pub fn pixel(&mut self, half: usize, pixel: usize) -> &mut [DVec3] {
        let width = self.sums.len() / (2 * TILE_PIXELS);
        &mut self.sums[(half * TILE_PIXELS + pixel) * width..][..width]
    }
}

impl Sample {
    pub fn new(bounce_layers: u32, lights: usize) -> Self {
        let at = BOUNCES + bounce_layers as usize;
        Self { values: vec![DVec3::ZERO; at + lights], lights: at }
    }

    /// Adds light of the light with index `source` in the rig to the sum `part` of all lights, and to the light's own
    /// sum.
    pub fn add_light(&mut self, part: usize, source: usize, light: DVec3) {
        self.values[part] += light;
        if let Some(own) = self.values.get_mut(self.lights + source) {
            *own += light;
        }
    }

    pub fn add_bounce(&mut self, bounce: u32, light: DVec3) {
        if let Some(sum) = self.values[BOUNCES..self.lights].get_mut(bounce as usize - 1) {
            *sum += light;
        }
    }

    pub fn clear(&mut self) {
        self.values.fill(DVec3::ZERO);
    }

    pub fn copy_from(&mut self, other: &Self) {
        self.values.copy_from_slice(&other.values);
    }

    /// Adds all values to a pixel's sums.
    pub fn add_to(&mut self, sums: &mut [DVec3]) {
        let beauty = self[DIRECT] + self[REFLECTION] + self[INDIRECT] + self[EMISSION];
        self[SQUARES] = beauty * beauty;
        sums.iter_mut().zip(&self.values).for_each(|(sum, value)| *sum += *value);
    }
}

impl std::ops::Index<usize> for Sample {
    type Output = DVec3;

    fn index(&self, part: usize) -> &DVec3 {
        &self.values[part]
    }
}

impl std::ops::IndexMut<usize> for Sample {
    fn index_mut(&mut self, part: usize) -> &mut DVec3 {
        &mut self.values[part]
    }
}

impl Film {
    /// Memory of a film with layers for so many bounces and lights, bytes.
    pub fn bytes(width: u32, height: u32, bounce_layers: u32, lights: usize) -> u64 {
        let sums = 2 * (BOUNCES as u64 + u64::from(bounce_layers) + lights as u64);
        Tiling { width, height }.len() as u64 * sums * size_of::<DVec3>() as u64
    }

    pub(super) fn new(tiling: Tiling, bounce_layers: u32, lights: &[String]) -> Self {
        let mut film = Self { tiling, tiles: Vec::new(), bounce_layers, lights: lights.to_vec() };
        let tile = || Tile { sums: vec![DVec3::ZERO; 2 * TILE_PIXELS * film.width()], counts: [0; 2] };
        film.tiles = (0..tiling.len() / TILE_PIXELS).map(|_| tile()).collect();
        film
    }

    /// Number of sums per pixel.
    fn width(&self) -> usize {
        BOUNCES + self.bounce_layers as usize + self.lights.len()
    }

    /// Minimum and maximum samples per pixel of both halves together. They differ if the trace was stopped.
    pub fn samples(&self) -> [u32; 2] {
        let counts = || self.tiles.iter().map(|tile| tile.counts[0] + tile.counts[1]);
        [counts().min().unwrap_or(0), counts().max().unwrap_or(0)]
    }

    /// Pixels of a layer, row by row.
    pub fn layer(&self, half: Half, layer: Layer) -> Vec<[f32; 3]> {
        let (width, height) = (self.tiling.width, self.tiling.height);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let value = |(x, y)| {
            let [a, b] = [0, 1].map(|half| self.value(half, self.tiling.index(x, y), layer));
            let value = match (half, layer) {
                (Half::A, _) => a,
                (Half::B, _) => b,
                (Half::Both, Layer::Variance) => (a + b) / 4.0,
                (Half::Both, _) => (a + b) / 2.0,
            };
            value.as_vec3().to_array()
        };
        pixels.map(value).collect()
    }

    /// Several layers as one image; the beauty layer is unnamed.
    pub fn image(&self, half: Half, layers: &[Layer]) -> Image {
        let (width, height) = (self.tiling.width as usize, self.tiling.height as usize);
        let empty = Image { width, height, ..Image::default() };
        layers.iter().fold(empty, |image, layer| image.with_layer(layer.name(&self.lights), self.layer(half, *layer)))
    }

    fn value(&self, half: usize, index: usize, layer: Layer) -> DVec3 {
        let tile = &self.tiles[index / TILE_PIXELS];
        let sums = &tile.sums[(half * TILE_PIXELS + index % TILE_PIXELS) * self.width()..][..self.width()];
        let count = f64::from(tile.counts[half].max(1));
        let mean = |sum: usize| sums[sum] / count;
        let beauty = || mean(DIRECT) + mean(REFLECTION) + mean(INDIRECT) + mean(EMISSION);
        match layer {
            Layer::Beauty => beauty(),
            Layer::Direct => mean(DIRECT),
            Layer::Reflection => mean(REFLECTION),
            Layer::Indirect => mean(INDIRECT),
            Layer::IndirectGlossy => mean(INDIRECT_GLOSSY),
            Layer::Emission => mean(EMISSION),
            Layer::Variance if tile.counts[half] < 2 => DVec3::ZERO, // unknown
            Layer::Variance => (mean(SQUARES) - beauty() * beauty()).max(DVec3::ZERO) / (count - 1.0),
            Layer::Bounce(bounce) if bounce > self.bounce_layers => DVec3::ZERO,
            Layer::Bounce(bounce) => mean(BOUNCES + bounce as usize - 1),
            Layer::Light(light) if light as usize >= self.lights.len() => DVec3::ZERO,
            Layer::Light(light) => mean(BOUNCES + (self.bounce_layers + light) as usize),
        }
    }

    /// Errors of the beauty layer; relative errors are 0 for a black picture.
    pub fn standard_errors(&self) -> StandardErrors {
        let [a, b] = [Half::A, Half::B].map(|half| self.layer(half, Layer::Beauty));
        let count = a.len() as f64;
        let (mut sum, mut squares) = (0.0, 0.0);
        for (a, b) in a.into_iter().zip(b) {
            let [a, b] = [a, b].map(|pixel| f64::from(luminance(pixel)));
            sum += (a + b) / 2.0;
            squares += (a - b).powi(2) / 4.0;
        }
        let mean = sum / count;
        if mean <= 0.0 {
            return StandardErrors { mean, of_mean: 0.0, of_pixel: 0.0 };
        }
        StandardErrors { mean, of_mean: squares.sqrt() / count / mean, of_pixel: (squares / count).sqrt() / mean }
    }
}

impl Layer {
    /// Name of the layer in EXR files; `lights` are the names of the rig's lights.
    pub fn name(&self, lights: &[String]) -> String {
        match self {
            Self::Beauty => String::new(),
            Self::Direct => "direct".into(),
            Self::Reflection => "reflection".into(),
            Self::Indirect => "indirect".into(),
            Self::IndirectGlossy => "indirect_glossy".into(),
            Self::Emission => "emission".into(),
            Self::Variance => "variance".into(),
            Self::Bounce(bounce) => format!("bounce.{bounce}"),
            Self::Light(light) => format!("light.{}", lights[*light as usize]),
        }
    }
}
