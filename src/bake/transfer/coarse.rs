//! A part of the compressed form, for pictures in a hurry: fewer directions of superclusters.

use super::Transfer;

/// What is kept of a supercluster's directions, to which light takes longest. The way on to pixels takes as long with half of
/// each tile's, since it is their radiance that is read and written; and without a third of the terms of light pictures were
/// further off than without four fifths of the directions.
const DIRECTIONS: f64 = 0.2;

impl Transfer {
    /// With [`Self::coarse`], where the form has directions to leave out: the first ones are the fullest.
    pub fn with_coarse(mut self) -> Self {
        if let ([v, b, _], true) = (&self.chain[..], self.haar) {
            self.coarse = vec![v.leading(DIRECTIONS, 1.0), b.leading(1.0, DIRECTIONS)];
        }
        self
    }
}
