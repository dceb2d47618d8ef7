//! Automatic exposure, needed because exported intensities span six orders of magnitude; and stops for false colour.

use crate::image::luminance;
use crate::shared::{MIDDLE_GREY, MIDDLE_STOP, STOP_COLORS, STOP_COUNT};

/// Stops of a luminance above middle grey; minus infinity for 0.
pub fn stops(luminance: f32) -> f32 {
    (luminance / MIDDLE_GREY).log2()
}

/// False colour, sRGB, of a luminance `stops` above middle grey; see [`crate::relight::ToneMap::FalseColor`].
pub fn stop_color(stops: f32) -> [u8; 3] {
    let band = (stops + 0.5).floor() + MIDDLE_STOP as f32;
    let [r, g, b, _] = STOP_COLORS[band.clamp(0.0, (STOP_COUNT - 1) as f32) as usize].to_le_bytes();
    [r, g, b]
}

/// Exposure in stops that maps the geometric mean of the lit pixels' luminance to middle grey [Reinhard 2002, Eq. 1 and
/// 2]; 0 if no pixel is lit.
pub fn automatic(pixels: &[[f32; 3]]) -> f32 {
    let mut luminances: Vec<f64> =
        pixels.iter().map(|&pixel| f64::from(luminance(pixel))).filter(|&y| y.is_finite() && y > 0.0).collect();
    if luminances.is_empty() {
        return 0.0;
    }
    // Pixels a thousand times darker than the 99th percentile do not count as lit.
    luminances.sort_by(f64::total_cmp);
    let bright = luminances[(luminances.len() - 1) * 99 / 100];
    let lit = &luminances[luminances.partition_point(|&y| y < 1e-3 * bright)..];
    let mean = lit.iter().map(|y| y.log2()).sum::<f64>() / lit.len() as f64;
    (f64::from(MIDDLE_GREY).log2() - mean) as f32
}
