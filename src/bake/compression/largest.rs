//! The terms of vectors that matter most.

use rayon::prelude::*;

use super::vector_batch::{Panel, VectorBatch, WIDTH};
use crate::bake::csr_matrix::CsrMatrix;

/// Of each vector the fewest terms that leave out no more than a share of its energy; a term has the sum of its channels'
/// squares, each times its weight. Rows of the terms that are kept, one a vector; terms of nothing never are.
pub fn largest(terms: &VectorBatch, weights: [&[f32]; 3], left_out: f64) -> CsrMatrix {
    let panel = |p: usize| {
        let count = WIDTH.min(terms.count - p * WIDTH);
        of_panel([0, 1, 2].map(|channel| &terms.channels[channel][p]), weights, left_out, count)
    };
    CsrMatrix::concatenated((0..terms.channels[0].len()).into_par_iter().map(panel).collect())
}

/// Classes of energies of a float's first bits: eight an octave, which tells terms apart well enough.
const CLASSES: usize = 1 << 11;
const CLASS_SHIFT: u32 = 20;

/// The terms of the highest classes, of each of the first `count` vectors of a panel a channel.
fn of_panel(panels: [&Panel; 3], weights: [&[f32]; 3], left_out: f64, count: usize) -> CsrMatrix {
    let energies = |i: usize| -> [f32; WIDTH] {
        let [red, green, blue] = panels.map(|panel| &panel[i]);
        let [r, g, b] = weights.map(|weights| weights[i]);
        std::array::from_fn(|v| r * red[v] * red[v] + g * green[v] * green[v] + b * blue[v] * blue[v])
    };
    let class = |energy: f32| (energy.to_bits() >> CLASS_SHIFT) as usize;
    let mut by_class = vec![[0.0f64; WIDTH]; CLASSES];
    for i in 0..weights[0].len() {
        for (v, energy) in energies(i).into_iter().enumerate() {
            by_class[class(energy)][v] += f64::from(energy);
        }
    }
    let least: [usize; WIDTH] = std::array::from_fn(|v| {
        let allowed = left_out * by_class.iter().map(|sums| sums[v]).sum::<f64>();
        let mut sum = 0.0;
        let fits = |sums: &&[f64; WIDTH]| {
            sum += sums[v];
            sum <= allowed
        };
        by_class.iter().take_while(fits).count().max(1)
    });
    let mut kept: Vec<(Vec<u32>, Vec<[f32; 3]>)> = vec![Default::default(); count];
    for i in 0..weights[0].len() {
        for (v, energy) in energies(i).into_iter().enumerate().take(count) {
            if class(energy) >= least[v] {
                kept[v].0.push(i as u32);
                kept[v].1.push(panels.map(|panel| panel[i][v]));
            }
        }
    }
    let row =
        |(columns, values): (Vec<u32>, Vec<[f32; 3]>)| CsrMatrix { first: vec![0, columns.len()], columns, values };
    CsrMatrix::concatenated(kept.into_iter().map(row).collect())
}
