//! Colour temperature as linear Rec. 709.
//!
//! [Krystek 1985]: M. Krystek, An algorithm to calculate correlated colour temperature, Color Research & Application
//! 10(1).

use std::ops::RangeInclusive;

use glam::{DVec2, DVec3, Vec3};

/// Temperatures in kelvin for which [Krystek 1985] is valid.
pub const KELVIN: RangeInclusive<f64> = 1_000.0..=15_000.0;
/// Within it a colour temperature is meaningful: at most 0.05 off the Planckian locus, a tint of 2.5.
pub const TINT: RangeInclusive<f64> = -1.0..=1.0;

/// Distance in CIE 1960 (u, v) of a tint of one.
const UV_PER_TINT: f64 = 0.02;
/// Distance in (u, v) below which colours are the same: single precision has 1e-7.
const SAME_UV: f64 = 1e-5;

/// Chromaticity of a black body at `kelvin` as linear Rec. 709 of luminance 1, clipped to the gamut.
///
/// `tint` in [`TINT`] shifts it off the Planckian locus, along the locus's normal in CIE 1960 (u, v): positive is
/// greener, negative more magenta.
pub fn kelvin_to_rgb(kelvin: f64, tint: f64) -> Vec3 {
    rgb(kelvin, tint).as_vec3()
}

fn rgb(kelvin: f64, tint: f64) -> DVec3 {
    let uv = planckian_locus(kelvin) + normal(kelvin) * UV_PER_TINT * tint;
    let denominator = 2.0 * uv.x - 8.0 * uv.y + 4.0;
    let (x, y) = (3.0 * uv.x / denominator, 2.0 * uv.y / denominator);
    let rgb = xyz_to_rgb(DVec3::new(x / y, 1.0, (1.0 - x - y) / y)).max(DVec3::ZERO);
    rgb / LUMINANCE.dot(rgb)
}

/// CIE 1931 XYZ as linear Rec. 709 with white D65 [IEC 61966-2-1]; negative outside of the gamut.
pub fn xyz_to_rgb(xyz: DVec3) -> DVec3 {
    DVec3::new(
        DVec3::new(3.2404542, -1.5371385, -0.4985314).dot(xyz),
        DVec3::new(-0.9692660, 1.8760108, 0.0415560).dot(xyz),
        DVec3::new(0.0556434, -0.2040259, 1.0572252).dot(xyz),
    )
}

/// Inverts [`kelvin_to_rgb`] to 0.1 % and 0.001: the temperature within [`KELVIN`] of nearest chromaticity, and the
/// distance to it as a tint within [`TINT`]. Black is treated as white.
///
/// Below 1,900 K black bodies are outside of Rec. 709. Their clipped colours have no tint.
pub fn kelvin_and_tint_of(color: Vec3) -> (f64, f64) {
    let uv = chromaticity(if color.max_element() > 0.0 { color.as_dvec3() } else { DVec3::ONE });
    let clipped = nearest(uv, |kelvin| chromaticity(rgb(kelvin, 0.0)));
    if chromaticity(rgb(clipped, 0.0)).distance(uv) < SAME_UV {
        return (clipped, 0.0);
    }
    let kelvin = nearest(uv, planckian_locus);
    let tint = (uv - planckian_locus(kelvin)).dot(normal(kelvin)) / UV_PER_TINT;
    (kelvin, tint.clamp(*TINT.start(), *TINT.end()))
}

/// The temperature within [`KELVIN`] at which `curve` is nearest to `uv`.
fn nearest(uv: DVec2, curve: impl Fn(f64) -> DVec2) -> f64 {
    let distance = |mired: f64| curve(1e6 / mired).distance_squared(uv);
    // Near the gamut's edge the distance may have several local minima: a grid finds the lowest, then the search
    // refines it.
    let (lo, hi) = (1e6 / KELVIN.end(), 1e6 / KELVIN.start());
    let step = (hi - lo) / 64.0;
    let best = (0..=64).map(|i| lo + f64::from(i) * step).min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
    let (mut a, mut b) = best.map_or((lo, hi), |best| ((best - step).max(lo), (best + step).min(hi)));
    while b - a > 1e-6 {
        let third = (b - a) / 3.0;
        if distance(a + third) < distance(b - third) { b -= third } else { a += third }
    }
    2e6 / (a + b)
}

/// Luminance of linear Rec. 709.
const LUMINANCE: DVec3 = DVec3::new(0.2126729, 0.7151522, 0.0721750);

/// CIE 1960 (u, v) of linear Rec. 709.
fn chromaticity(rgb: DVec3) -> DVec2 {
    let xyz = DVec3::new(
        DVec3::new(0.4124564, 0.3575761, 0.1804375).dot(rgb),
        LUMINANCE.dot(rgb),
        DVec3::new(0.0193339, 0.1191920, 0.9503041).dot(rgb),
    );
    DVec2::new(4.0 * xyz.x, 6.0 * xyz.y) / (xyz.x + 15.0 * xyz.y + 3.0 * xyz.z)
}

/// Unit normal of the Planckian locus in (u, v), towards green.
fn normal(kelvin: f64) -> DVec2 {
    let tangent = (planckian_locus(kelvin * 1.001) - planckian_locus(kelvin * 0.999)).normalize();
    // u decreases along the locus with temperature; green is above the locus.
    DVec2::new(tangent.y, -tangent.x)
}

/// Planckian locus in CIE 1960 (u, v), accurate to 9e-5 [Krystek 1985].
fn planckian_locus(t: f64) -> DVec2 {
    let u =
        (0.860117757 + 1.54118254e-4 * t + 1.28641212e-7 * t * t) / (1.0 + 8.42420235e-4 * t + 7.08145163e-7 * t * t);
    let v =
        (0.317398726 + 4.22806245e-5 * t + 4.20481691e-8 * t * t) / (1.0 - 2.89741816e-5 * t + 1.61456053e-7 * t * t);
    DVec2::new(u, v)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn xy(t: f64) -> DVec2 {
        let uv = planckian_locus(t);
        DVec2::new(3.0 * uv.x, 2.0 * uv.y) / (2.0 * uv.x - 8.0 * uv.y + 4.0)
    }

    #[test]
    fn illuminant_a_and_6500_k() {
        // CIE standard illuminant A; the tolerance is Krystek's 9e-5 in (u, v), which is up to three times as much in
        // (x, y).
        assert!((xy(2855.5) - DVec2::new(0.44757, 0.40745)).length() < 5e-4, "{}", xy(2855.5));
        assert!((xy(6500.0) - DVec2::new(0.3135, 0.3237)).length() < 5e-4, "{}", xy(6500.0));
    }

    #[test]
    fn temperature_and_tint_of_a_colour_are_those_that_made_it() {
        for kelvin in [1_000.0, 1_500.0, 2_000.0, 2_700.0, 3_500.0, 4_300.0, 5_400.0, 6_504.0, 8_000.0, 15_000.0] {
            for tint in [-1.0, -0.4, -0.01, 0.0, 0.02, 0.5, 1.0] {
                let color = kelvin_to_rgb(kelvin, tint);
                // A clipped colour is not the one that was asked for, except of a black body.
                if color.min_element() == 0.0 && tint != 0.0 {
                    continue;
                }
                let (kelvin_back, tint_back) = kelvin_and_tint_of(color * 7.0);
                let is_near = (kelvin_back / kelvin - 1.0).abs() < 1e-3 && (tint_back - tint).abs() < 1e-3;
                assert!(is_near, "{kelvin} {tint}: {kelvin_back} {tint_back}");
            }
        }
        let (kelvin, tint) = kelvin_and_tint_of(Vec3::ONE);
        assert!((kelvin - 6_504.0).abs() < 30.0 && (0.0..0.2).contains(&tint), "{kelvin} {tint}");
        for color in [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(1.0, 0.0, 1.0)] {
            let (kelvin, tint) = kelvin_and_tint_of(color);
            assert!(KELVIN.contains(&kelvin) && TINT.contains(&tint), "{color}: {kelvin} {tint}");
        }
        assert_eq!((kelvin_and_tint_of(Vec3::Y).1, kelvin_and_tint_of(Vec3::new(1.0, 0.0, 1.0)).1), (1.0, -1.0));
    }

    /// As somebody drags the temperature in the panel, which reads it from the colour each time.
    #[test]
    fn a_change_of_temperature_keeps_the_tint() {
        for (first, last, tint) in [(6_500.0, 2_700.0, 0.25), (6_500.0, 2_000.0, -0.5), (5_000.0, 1_000.0, 0.0)] {
            let mut color = kelvin_to_rgb(first, tint);
            for i in 0..=100 {
                let kelvin = first + (last - first) * f64::from(i) / 100.0;
                color = kelvin_to_rgb(kelvin, kelvin_and_tint_of(color).1);
            }
            let (kelvin, kept) = kelvin_and_tint_of(color);
            assert!((kelvin / last - 1.0).abs() < 1e-3 && (kept - tint).abs() < 2e-3, "{tint}: {kelvin} {kept}");
        }
    }

    #[test]
    fn luminance_is_one_and_warm_is_red() {
        for kelvin in [1_000.0, 1_900.0, 4_300.0, 6_504.0, 15_000.0] {
            for tint in [-1.0, 0.0, 1.0] {
                let rgb = kelvin_to_rgb(kelvin, tint);
                let luminance = rgb.dot(Vec3::new(0.2126729, 0.7151522, 0.072175));
                assert!((luminance - 1.0).abs() < 1e-5 && rgb.min_element() >= 0.0, "{kelvin} {tint}: {rgb}");
            }
        }
        assert!(kelvin_to_rgb(2_700.0, 0.0).x > 2.0 * kelvin_to_rgb(2_700.0, 0.0).z);
        assert!(kelvin_to_rgb(10_000.0, 0.0).z > kelvin_to_rgb(10_000.0, 0.0).x);
        assert!((kelvin_to_rgb(6_504.0, 0.0) - Vec3::ONE).abs().max_element() < 0.06);
        assert!(kelvin_to_rgb(5_000.0, 1.0).y > kelvin_to_rgb(5_000.0, 0.0).y);
    }
}
