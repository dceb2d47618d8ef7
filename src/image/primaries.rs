//! Colours of other primaries, by one matrix.

use glam::{DMat3, DVec2, DVec3};

/// Chromaticities of a colour space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Primaries {
    /// CIE 1931 xy of red, green and blue.
    pub rgb: [DVec2; 3],
    pub white: DVec2,
}

impl Default for Primaries {
    fn default() -> Self {
        Self::REC_709
    }
}

impl Primaries {
    /// [ITU-R BT.709-6, Section 1], the colours of relume.
    pub const REC_709: Self = Self {
        rgb: [DVec2::new(0.64, 0.33), DVec2::new(0.30, 0.60), DVec2::new(0.15, 0.06)],
        white: DVec2::new(0.3127, 0.3290),
    };
    /// [S-2014-004, Section 4].
    pub const ACES_CG: Self = Self {
        rgb: [DVec2::new(0.713, 0.293), DVec2::new(0.165, 0.830), DVec2::new(0.128, 0.044)],
        white: DVec2::new(0.32168, 0.33767),
    };

    /// Turns linear colours of Rec. 709 into these. White stays white [Lindbloom 2017].
    pub fn from_rec_709(&self) -> DMat3 {
        if *self == Self::REC_709 {
            return DMat3::IDENTITY;
        }
        self.to_xyz().inverse() * adaptation(Self::REC_709.white, self.white) * Self::REC_709.to_xyz()
    }

    /// [RP 177-1993].
    fn to_xyz(self) -> DMat3 {
        let columns = DMat3::from_cols_array_2d(&self.rgb.map(|xy| xyz(xy).to_array()));
        let scale = columns.inverse() * xyz(self.white);
        columns * DMat3::from_diagonal(scale)
    }
}

/// Of luminance 1.
fn xyz(xy: DVec2) -> DVec3 {
    DVec3::new(xy.x, xy.y, 1.0 - xy.x - xy.y) / xy.y
}

/// Bradford's chromatic adaptation in XYZ.
fn adaptation(from: DVec2, to: DVec2) -> DMat3 {
    let cones =
        DMat3::from_cols_array_2d(&[[0.8951, -0.7502, 0.0389], [0.2664, 1.7135, -0.0685], [-0.1614, 0.0367, 1.0296]]);
    cones.inverse() * DMat3::from_diagonal(cones * xyz(to) / (cones * xyz(from))) * cones
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The matrix of OpenColorIO's built-in configurations.
    #[test]
    fn acescg_is_that_of_opencolorio() {
        let rows = [
            [0.613097402, 0.339523146, 0.047379451],
            [0.070193722, 0.916353879, 0.013452399],
            [0.020615593, 0.109569773, 0.869814634],
        ];
        let matrix = Primaries::ACES_CG.from_rec_709();
        for (i, row) in rows.iter().enumerate() {
            let ours = matrix.row(i);
            assert!((ours - DVec3::from_array(*row)).abs().max_element() < 1e-6, "{ours} {row:?}");
        }
        assert_eq!(Primaries::REC_709.from_rec_709(), DMat3::IDENTITY);
    }
}
