//! FLIP, the perceived difference between two alternating images, with NVIDIA's implementation [Andersson 2020].

use rayon::prelude::*;

use super::blocks::{Blocks, Sample};
use crate::image::png::srgb8_from_linear;

/// FLIP's default: a 0.7 m wide screen of 3840 pixels at a distance of 0.7 m.
const PIXELS_PER_DEGREE: f32 = nv_flip::DEFAULT_PIXELS_PER_DEGREE;
/// Rows per strip, which one thread processes, and rows beyond it that FLIP's filters read: the wider filter, for
/// contrast, has a radius of three standard deviations, 3 sqrt(0.04 / (2 pi²)) degrees.
const STRIP: usize = 128;
const HALO: usize = 10;

/// Mean error over the blocks that count, between the values that `reference` and `test` select.
pub(super) fn mean(
    blocks: &Blocks,
    exposure: f64,
    reference: fn(&Sample) -> [f64; 3],
    test: fn(&Sample) -> [f64; 3],
) -> f64 {
    let displayed = |of: fn(&Sample) -> [f64; 3]| -> Vec<[u8; 3]> {
        blocks.all().map(|sample| of(&sample).map(|value| display(exposure * value))).collect()
    };
    let errors = error_map(blocks.columns, &displayed(reference), &displayed(test));
    let counting = errors.iter().zip(blocks.counts()).filter(|&(_, counts)| counts);
    let (sum, count) = counting.fold((0.0, 0.0), |(sum, count), (&error, _)| (sum + f64::from(error), count + 1.0));
    sum / count
}

/// Error of every pixel of 8-bit sRGB images, in [0, 1], row by row; does not depend on the number of threads.
pub fn error_map(width: usize, reference: &[[u8; 3]], test: &[[u8; 3]]) -> Vec<f32> {
    assert_eq!(reference.len(), test.len(), "pixels of the reference and of the picture");
    let height = reference.len() / width;
    let strip = |index: usize| {
        let (top, bottom) = (index * STRIP, height.min((index + 1) * STRIP));
        let (first, end) = (top.saturating_sub(HALO), height.min(bottom + HALO));
        let picture = |pixels: &[[u8; 3]]| {
            let rows = pixels[first * width..end * width].as_flattened();
            nv_flip::FlipImageRgb8::with_data(width as u32, (end - first) as u32, rows)
        };
        let map = nv_flip::flip(picture(reference), picture(test), PIXELS_PER_DEGREE).to_vec();
        map[(top - first) * width..(bottom - first) * width].to_vec()
    };
    (0..height.div_ceil(STRIP)).into_par_iter().flat_map(strip).collect()
}

/// Images as displayed for FLIP: times `exposure`, through the ACES fit of [Narkowicz 2015], 8-bit sRGB.
pub fn displayed(pixels: &[[f32; 3]], exposure: f64) -> Vec<[u8; 3]> {
    pixels.iter().map(|pixel| pixel.map(|value| display(exposure * f64::from(value)))).collect()
}

/// Applies the ACES fit and encodes as 8-bit sRGB [Narkowicz 2015]; negative values become black.
fn display(exposed: f64) -> u8 {
    let x = exposed.max(0.0);
    srgb8_from_linear(((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)) as f32)
}
