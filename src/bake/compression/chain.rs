//! The compressed operator: three block matrices, applied one after another.

use std::ops::Range;

use half::f16;
use half::slice::HalfFloatSliceExt;

use super::fit::Factors;
use crate::bake::transfer::blocks::{BlockMatrix, Columns, Dense};

/// T as three products of small dense blocks, channel by channel. Each supercluster computes y = V λ̂[J] from the Haar
/// terms of light, each of its tiles c = B y, and each pixel of a tile u·c. All three channels share B and the rows u.
/// They also share V's columns for most terms, which are first multiplied by a tint; for the other terms V has one
/// column per channel.
///
/// All matrices read one vector: the Haar terms, then y of each supercluster and c of its tiles.
pub struct Chain {
    v: BlockMatrix,
    b: BlockMatrix,
    u: BlockMatrix,
    length: u32,
}

impl Chain {
    /// `terms` is the number of Haar terms of light, equal to the number of coefficients.
    pub fn new(terms: usize, view_samples: usize) -> Self {
        let [v, b] = [3, 1].map(|channels| BlockMatrix::new(channels, terms, terms));
        Self { v, b, u: BlockMatrix::new(1, terms, view_samples), length: terms as u32 }
    }

    /// Adds a supercluster with view samples `samples`; `tiles` has the range of each tile among them.
    pub fn push(&mut self, factors: &Factors, tiles: &[Range<usize>], samples: &[u32]) {
        let ys = self.take(factors.rank);
        let (per_channel, tinted) = factors.list.split_at(factors.per_channel_count);
        let per_channel_value_count = 3 * ys.len() * per_channel.len();
        let values = floats(&factors.v);
        self.v.push(&Dense {
            rows: &ys,
            own: Columns { inputs: per_channel, values: &values[..per_channel_value_count] },
            shared: Columns { inputs: tinted, values: &values[per_channel_value_count..] },
            tints: &factors.tints[per_channel.len()..],
        });
        // All tiles of a supercluster read the same y.
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

    /// Allocates the next `count` elements of the vector.
    fn take(&mut self, count: usize) -> Vec<u32> {
        let first = self.length;
        self.length += count as u32;
        (first..self.length).collect()
    }

    /// V, B and U, for vectors of equal length.
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
