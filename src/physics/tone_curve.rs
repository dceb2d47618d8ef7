//! Tone curves: exposed linear Rec. 709 to display values.

use glam::{DMat3, DVec3};

/// Encodes linear values, clamped to [0, 1] [IEC 61966-2-1, 5.2].
pub fn srgb(c: DVec3) -> DVec3 {
    c.clamp(DVec3::ZERO, DVec3::ONE)
        .map(|x| if x < 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 })
}

/// AgX [Sobotka 2022]: log2 encoding from -12.47 to 4.03 in inset primaries, then a sigmoid approximated by a
/// sixth-degree polynomial [Wrensch 2023]. Returns sRGB.
pub fn agx(c: DVec3) -> DVec3 {
    const COEFFICIENTS: [f64; 7] = [15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232];
    const EV: [f64; 2] = [-12.47393, 4.026069];
    // Rows sum to 1 within 1e-4, so grey stays grey.
    let inset = DMat3::from_cols_array(&[
        0.842479062253094,
        0.0423282422610123,
        0.0423756549057051,
        0.0784335999999992,
        0.878468636469772,
        0.0784336,
        0.0792237451477643,
        0.0791661274605434,
        0.879142973793104,
    ]);
    let sigmoid = |x: f64| COEFFICIENTS.iter().fold(0.0, |sum, c| sum * x + c);
    let encoded = (inset * c).map(|x| ((x.max(1e-10).log2() - EV[0]) / (EV[1] - EV[0])).clamp(0.0, 1.0));
    (inset.inverse() * encoded.map(sigmoid)).clamp(DVec3::ZERO, DVec3::ONE)
}

/// Khronos PBR Neutral [Khronos 2024]. Returns linear Rec. 709.
pub fn pbr_neutral(c: DVec3) -> DVec3 {
    const F90: f64 = 0.04;
    const START: f64 = 0.8 - F90;
    const DESATURATION: f64 = 0.15;
    // The curve would brighten negative values.
    let c = c.max(DVec3::ZERO);
    let low = c.min_element();
    let offset = if low <= 2.0 * F90 { low - low * low / (4.0 * F90) } else { F90 };
    let c = c - offset;
    let peak = c.max_element();
    if peak <= START {
        return c;
    }
    let room = 1.0 - START;
    let new_peak = 1.0 - room * room / (peak + room - START);
    let grey = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    (c * (new_peak / peak)).lerp(DVec3::splat(new_peak), grey)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels can be slightly negative, since compressed indirect light can be.
    #[test]
    fn nothing_below_black_is_bright() {
        for dark in [0.0, -1e-3, -0.16, -10.0] {
            assert_eq!(pbr_neutral(DVec3::splat(dark)), DVec3::ZERO);
            let red = pbr_neutral(DVec3::new(0.5, dark, dark));
            assert_eq!(red, pbr_neutral(DVec3::X * 0.5), "{dark}");
        }
    }
}
