//! The map that is compressed: from direct light at gather samples, or from the sky, to view samples.

use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::rows::RowGatherer;
use crate::bake::transport::{LightTransport, sky};

/// A map from coefficients of light to view samples, in two factors: rows of Φ, and [bounces](super::bounces).
#[derive(Clone, Copy)]
pub struct Operator<'a> {
    pub transport: &'a LightTransport<'a>,
    /// [`LightTransport::from_sky`], for light of the sky with [`sky::COLUMNS`] coefficients. `None` for direct light at
    /// the fine level.
    pub from_sky: Option<&'a CsrMatrix>,
}

impl<'a> Operator<'a> {
    /// Number of coefficients that it maps.
    pub fn coefficient_count(&self) -> usize {
        *self.first().last().expect("one more than samples") as usize
    }

    /// Coefficients of sample i, or of a column of the sky: `first[i]..first[i + 1]`.
    pub fn first(&self) -> &'a [u32] {
        if self.from_sky.is_some() { &sky::FIRST } else { &self.transport.fine.first }
    }

    /// The gatherer of rows whose first columns are those coefficients; light after further bounces follows.
    pub fn row_gatherer(&self, lobe: Lobe) -> RowGatherer<'a> {
        if self.from_sky.is_some() { self.transport.sky_row_gatherer(lobe) } else { self.transport.row_gatherer(lobe) }
    }
}
