//! Scene-linear Rec. 709 to display values. Twin of glsl/composite.comp and glsl/lib/color.glsl.

use glam::DVec3;

use crate::physics::tone_curve::{agx, pbr_neutral, srgb};
use crate::shared::{OUTPUT_AGX, OUTPUT_LINEAR, OUTPUT_PBR_NEUTRAL};

/// Output of composite.comp for a pixel's sum and one of the `OUTPUT_` constants: linear values, or sRGB in [0, 1].
/// `exposure` is a linear factor.
pub fn display(output: u32, exposure: f64, sum: DVec3) -> DVec3 {
    match output {
        OUTPUT_LINEAR => sum,
        OUTPUT_AGX => agx(exposure * sum),
        OUTPUT_PBR_NEUTRAL => srgb(pbr_neutral(exposure * sum)),
        _ => srgb(exposure * sum),
    }
}
