//! Maps of differences: absolute differences, and false colours with a legend.

use super::Pictures;
use super::blocks::{Blocks, Pixel};
use super::legend::{self, DECADES, GROUND};
use crate::image::png::{self, srgb8_from_linear};

/// Colours of non-finite values, one for each kind of map; magma contains neither.
const MAGENTA: [u8; 3] = [255, 0, 255];
const CYAN: [u8; 3] = [0, 255, 255];

impl Pictures {
    /// |x - r| * scale per channel, clamped to [0, 1] and then sRGB-encoded: the maps of Figures 5.1 and 5.2, where
    /// `scale` is 2 [Yang 2007].
    ///
    /// `scale` is in 1 / radiance; x and r are means of `block` x `block` pixels. Magenta where a value is not finite,
    /// black outside the mask.
    pub fn difference_map(&self, block: usize, scale: f32) -> Vec<[u8; 3]> {
        let color = |difference: [f64; 3]| difference.map(|d| srgb8_from_linear((d.abs() * f64::from(scale)) as f32));
        self.map(&Blocks::new(self, block), color, [0; 3], MAGENTA)
    }

    /// Mean of |x - r| over RGB in the colours of magma, on a logarithmic scale of three decades up to 1 / `scale`,
    /// where [`Self::difference_map`] is white.
    ///
    /// A legend below shows the scale, also in % of the mean of r; narrow images are widened for it. Cyan where a value
    /// is not finite, grey outside the mask.
    pub fn false_color(&self, block: usize, scale: f32) -> png::Pixels {
        let blocks = Blocks::new(self, block);
        let magma = magma();
        let color = |difference: [f64; 3]| {
            let error = difference.iter().map(|d| d.abs()).sum::<f64>() / 3.0;
            // Negative below the lowest decade, and -inf where there is no error.
            let place = 1.0 + (error * f64::from(scale)).log10() / f64::from(DECADES);
            magma[(place.clamp(0.0, 1.0) * 255.0).round() as usize]
        };
        let map = self.map(&blocks, color, GROUND, CYAN);
        let note = (blocks.non_finite + blocks.reference_non_finite > 0).then_some("cyan: not finite");
        let legend = legend::draw(self.width, 1.0 / f64::from(scale), blocks.mean_reference(), note, &magma);

        let width = self.width.max(legend.width);
        let rows = map.chunks(self.width).chain(legend.pixels.chunks(legend.width));
        let padded = rows.flat_map(|row| row.iter().chain(std::iter::repeat(&GROUND)).take(width));
        let rgba: Vec<_> = padded.map(|&[r, g, b]| [r, g, b, 255]).collect();
        png::Pixels { width, height: rgba.len() / width, rgba }
    }

    /// Colours every pixel by x - r of its block.
    fn map(
        &self,
        blocks: &Blocks,
        color: impl Fn([f64; 3]) -> [u8; 3],
        masked: [u8; 3],
        not_finite: [u8; 3],
    ) -> Vec<[u8; 3]> {
        let pixel = |index: usize| match self.pixel(index).0 {
            Pixel::Counts => color(blocks.around(index % self.width, index / self.width).differences()),
            Pixel::Masked => masked,
            Pixel::NonFinite | Pixel::ReferenceNonFinite => not_finite,
        };
        (0..self.image.len()).map(pixel).collect()
    }
}

/// 256 colours from black through violet and orange to pale yellow, perceptually uniform.
fn magma() -> Vec<[u8; 3]> {
    nv_flip::magma_lut().to_vec().as_chunks().0.to_vec()
}
