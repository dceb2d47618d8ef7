//! Scene-linear Rec. 709 to display values. Twin of glsl/composite.comp, glsl/lib/color.glsl and glsl/lib/display.glsl.

use glam::{DVec3, UVec2, UVec3};

use crate::physics::tone_curve::{agx, pbr_neutral, srgb};
use crate::shared::*;

/// Output of composite.comp for a pixel's exposed sum and one of the `OUTPUT_` constants: linear values, or values of a
/// display in [0, 1]. `table` has the entries of OUTPUT_TABLE.
pub fn display(output: u32, sum: DVec3, table: &[UVec2]) -> DVec3 {
    match output {
        OUTPUT_LINEAR => sum,
        OUTPUT_AGX => agx(sum),
        OUTPUT_PBR_NEUTRAL => srgb(pbr_neutral(sum)),
        OUTPUT_TABLE => from_display_table(table, sum),
        _ => srgb(sum),
    }
}

/// Tetrahedral interpolation [Kasson 1995] in a [`DISPLAY_TABLE_SIDE`]³ table; red changes fastest.
fn from_display_table(table: &[UVec2], c: DVec3) -> DVec3 {
    let side = DISPLAY_TABLE_SIDE;
    let toe = f64::from(DISPLAY_TABLE_TOE);
    let end = f64::from(DISPLAY_TABLE_END);
    let steps = f64::from(side - 1) / (1.0 + end / toe).log2();
    let place = c.clamp(DVec3::ZERO, DVec3::splat(end)).map(|x| steps * (1.0 + x / toe).log2());
    let low = place.as_uvec3().min(UVec3::splat(side - 2));
    let fraction = place - low.as_dvec3();
    let entry = |at: UVec3| {
        let packed = table[((at.z * side + at.y) * side + at.x) as usize];
        DVec3::new((packed.x & 0xffff).into(), (packed.x >> 16).into(), packed.y.into()) / 65535.0
    };
    let mut axes = [0, 1, 2];
    axes.sort_by(|&a, &b| fraction[b].total_cmp(&fraction[a]));
    let mut at = low;
    let mut sum = (1.0 - fraction[axes[0]]) * entry(at);
    for (i, &axis) in axes.iter().enumerate() {
        at[axis] += 1;
        let next = axes.get(i + 1).map_or(0.0, |&next| fraction[next]);
        sum += (fraction[axis] - next) * entry(at);
    }
    sum
}
