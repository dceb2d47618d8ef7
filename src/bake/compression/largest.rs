//! Selection of the most significant terms of vectors.

use rayon::prelude::*;

use super::vector_batch::{Panel, VectorBatch, WIDTH};
use crate::bake::csr_matrix::CsrMatrix;

/// For each vector the fewest terms such that the omitted ones have at most the share `left_out` of its energy. The
/// energy of a term is the weighted sum of its squares over the channels. Returns one row of retained terms per vector;
/// zero terms are never retained.
pub fn largest(terms: &VectorBatch, weights: [&[f32]; 3], left_out: f64) -> CsrMatrix {
    let panel = |p: usize| {
        let count = WIDTH.min(terms.count - p * WIDTH);
        of_panel([0, 1, 2].map(|channel| &terms.channels[channel][p]), weights, left_out, count)
    };
    CsrMatrix::concatenated((0..terms.channels[0].len()).into_par_iter().map(panel).collect())
}

/// Classes of energies by the leading bits of a float: eight per octave, which is fine enough to rank terms.
const CLASSES: usize = 1 << 11;
const CLASS_SHIFT: u32 = 20;

/// The terms of the highest classes for the first `count` vectors, of one panel per channel.
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
