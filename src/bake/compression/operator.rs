//! The map that is compressed: from direct light at gather samples, or from the sky, to view samples.

use super::haar::Haar;
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::rows::RowGatherer;
use crate::bake::transport::{LightTransport, sky};
use crate::physics::sky_cells;

/// The transform of the sky's columns. Straight light and that of mirrors do not mix, so that where there is only one
/// of them, the other adds nothing.
pub fn sky_haar() -> Haar {
    Haar::new(&sky::FIRST[..=sky_cells::COUNT]).twice(sky_cells::COUNT as u32)
}

/// A map from coefficients of light to view samples, in two factors: rows of Φ, and [bounces](super::bounces).
#[derive(Clone, Copy)]
pub struct Operator<'a> {
    pub transport: &'a LightTransport<'a>,
    /// [`LightTransport::from_sky`], for light of the sky with [`sky::COLUMNS`] coefficients. `None` for direct light
    /// at the fine level.
    pub from_sky: Option<&'a CsrMatrix>,
}

impl<'a> Operator<'a> {
    /// Number of coefficients that it maps.
    pub fn coefficient_count(&self) -> usize {
        if self.from_sky.is_some() { sky::COLUMNS } else { self.transport.fine.coefficient_count() }
    }

    /// The transform of these coefficients.
    pub fn haar(&self) -> Haar {
        if self.from_sky.is_some() { sky_haar() } else { Haar::new(&self.transport.fine.first) }
    }

    /// The gatherer of rows whose first columns are those coefficients; light after further bounces follows.
    pub fn row_gatherer(&self, lobe: Lobe) -> RowGatherer<'a> {
        if self.from_sky.is_some() { self.transport.sky_row_gatherer(lobe) } else { self.transport.row_gatherer(lobe) }
    }
}
