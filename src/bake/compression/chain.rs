//! What is left of the operator: three block matrices, one applied after the other.

use std::ops::Range;

use half::f16;
use half::slice::HalfFloatSliceExt;

use super::fit::Factors;
use crate::bake::transfer::blocks::{BlockMatrix, Columns, Dense};

/// T as three products of small dense blocks: of light's Haar terms each supercluster of pixels makes y = V λ̂[J],
/// each of its tiles c = B y, each pixel of a tile u·c, channel by channel. B and the rows u serve all three channels.
/// So do V's columns for most terms, behind a tint of light; for the others V has columns for each channel.
///
/// All matrices read one vector: the Haar terms, then y of each supercluster and c of its tiles.
pub struct Chain {
    v: BlockMatrix,
    b: BlockMatrix,
    u: BlockMatrix,
    length: u32,
}

impl Chain {
    /// For as many `terms` of light as coefficients.
    pub fn new(terms: usize, view_samples: usize) -> Self {
        let [v, b] = [3, 1].map(|channels| BlockMatrix::new(channels, terms, terms));
        Self { v, b, u: BlockMatrix::new(1, terms, view_samples), length: terms as u32 }
    }

    /// Adds a supercluster whose view samples are `samples`; `tiles` has the range of each tile among them.
    pub fn push(&mut self, factors: &Factors, tiles: &[Range<usize>], samples: &[u32]) {
        let ys = self.take(factors.rank);
        let (own, tinted) = factors.list.split_at(factors.own);
        let of_own = 3 * ys.len() * own.len();
        let values = floats(&factors.v);
        self.v.push(&Dense {
            rows: &ys,
            own: Columns { inputs: own, values: &values[..of_own] },
            shared: Columns { inputs: tinted, values: &values[of_own..] },
            tints: &factors.tints[own.len()..],
        });
        // All tiles of a supercluster read the same.
        let cs = self.take(factors.tiles.iter().map(|tile| tile.rank).sum());
        let values: Vec<f32> = factors.tiles.iter().flat_map(|tile| floats(&tile.b)).collect();
        self.b.push(&Dense { rows: &cs, shared: Columns { inputs: &ys, values: &values }, ..Default::default() });
        let mut left = &cs[..];
        for (tile, rows) in factors.tiles.iter().zip(tiles) {
            let (columns, others) = left.split_at(tile.rank);
            let shared = Columns { inputs: columns, values: &tile.u };
            self.u.push(&Dense { rows: &samples[rows.clone()], shared, ..Default::default() });
            left = others;
        }
    }

    /// The next elements of the vector.
    fn take(&mut self, count: usize) -> Vec<u32> {
        let first = self.length;
        self.length += count as u32;
        (first..self.length).collect()
    }

    /// V, B and U, for vectors of the same length.
    pub fn finish(self) -> Vec<BlockMatrix> {
        let Self { mut v, mut b, mut u, length } = self;
        for matrix in [&mut v, &mut b, &mut u] {
            matrix.input_count = length;
        }
        (v.output_count, b.output_count) = (length, length);
        vec![v, b, u]
    }
}

fn floats(factors: &[f16]) -> Vec<f32> {
    let mut values = vec![0.0; factors.len()];
    factors.convert_to_f32_slice(&mut values);
    assert!(values.iter().all(|value| value.is_finite()), "a factor is beyond half precision");
    values
}
