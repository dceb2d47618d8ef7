//! A reduced compressed form for fast previews: fewer directions of superclusters.

use super::Transfer;

/// Retained share of a supercluster's directions, on which most time is spent. Omitting half of each tile's directions
/// too saves no time, as the step to pixels is bound by reading and writing radiance. Omitting a third of the terms of
/// light increased the error more than omitting four fifths of the directions.
const DIRECTIONS: f64 = 0.2;

impl Transfer {
    /// Adds [`Self::coarse`] if the form is compressed: retains the first directions, which have the largest energy.
    pub fn with_coarse(mut self) -> Self {
        if let ([v, b, _], true) = (&self.chain[..], self.haar) {
            self.coarse = vec![v.leading(DIRECTIONS, 1.0), b.leading(1.0, DIRECTIONS)];
        }
        self
    }
}
