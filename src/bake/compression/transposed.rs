//! Sparse rows sorted by column, for repeated products with the transpose.

use bytemuck::{Pod, Zeroable};
use half::bf16;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::vector_batch::{COLUMNS, Panel, Task, VectorBatch, add_multiples, tasks};
use crate::bake::csr_matrix::CsrMatrix;
use crate::physics::sequence::mix;
use crate::storage::pods;

/// A matrix of sparse rows.
#[derive(Clone, Serialize, Deserialize)]
#[serde(bound = "E: Entry")]
pub struct Transposed<E> {
    pub columns: usize,
    pub parts: Vec<TransposedPart<E>>,
}

/// Rows per part: what they multiply of a panel stays in the second-level cache, and columns have several entries.
pub const PART: usize = 512;

/// A range of the rows.
#[derive(Clone, Serialize, Deserialize)]
#[serde(bound = "E: Entry")]
pub struct TransposedPart<E> {
    /// Number of rows in preceding parts.
    before: usize,
    /// Entries of column c: `first[c]..first[c + 1]`.
    #[serde(with = "pods")]
    first: Vec<u32>,
    #[serde(with = "pods")]
    entries: Vec<E>,
}

/// How an entry is stored.
pub trait Entry: Pod + Send + Sync {
    /// `row` is the row within the part, and `random` are uniform bits.
    fn new(row: u16, value: [f32; 3], random: u32) -> Self;

    fn row(&self) -> usize;

    fn value(&self) -> [f32; 3];
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Exact {
    row: u32,
    value: [f32; 3],
}

/// In bf16, for estimates that are multiplied often: products are limited by memory. Values are rounded at random
/// [Croci 2022], so that sums of equal entries have no bias.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Rounded {
    row: u16,
    value: [bf16; 3],
}

impl Entry for Exact {
    fn new(row: u16, value: [f32; 3], _: u32) -> Self {
        Self { row: row.into(), value }
    }

    #[inline(always)]
    fn row(&self) -> usize {
        self.row as usize
    }

    #[inline(always)]
    fn value(&self) -> [f32; 3] {
        self.value
    }
}

impl Entry for Rounded {
    fn new(row: u16, value: [f32; 3], random: u32) -> Self {
        // One number for all channels: grey entries stay grey.
        Self { row, value: value.map(|x| narrowed(x, random)) }
    }

    #[inline(always)]
    fn row(&self) -> usize {
        self.row.into()
    }

    #[inline(always)]
    fn value(&self) -> [f32; 3] {
        self.value.map(widened)
    }
}

impl<E: Entry> TransposedPart<E> {
    /// Rows after the first `before` ones.
    pub fn new(rows: &CsrMatrix, before: usize, columns: usize) -> Self {
        assert!(rows.len() <= 1 << 16, "{} rows, and 65,536 at most", rows.len());
        assert!(rows.columns.len() <= u32::MAX as usize, "{} entries, whose indices are u32", rows.columns.len());
        let mut first = vec![0; columns + 1];
        rows.columns.iter().for_each(|&column| first[column as usize + 1] += 1);
        (0..columns).for_each(|column| first[column + 1] += first[column]);
        let mut next = first.clone();
        let mut entries = vec![E::zeroed(); rows.columns.len()];
        for row in 0..rows.len() {
            for (column, value) in rows.row(row) {
                let random = mix(((before + row) as u64) << 32 | u64::from(column)) as u32;
                let next = &mut next[column as usize];
                entries[*next as usize] = E::new(row as u16, value, random);
                *next += 1;
            }
        }
        Self { before, first, entries }
    }
}

/// Rounds away from zero with a probability equal to the part of a step that truncation drops, for uniform bits
/// `random`. `x` is far from overflow.
fn narrowed(x: f32, random: u32) -> bf16 {
    bf16::from_bits((x.to_bits().wrapping_add(random >> 16) >> 16) as u16)
}

/// Without the test for NaN of [`bf16::to_f32`].
#[inline(always)]
fn widened(x: bf16) -> f32 {
    f32::from_bits(u32::from(x.to_bits()) << 16)
}

impl<E: Entry> Transposed<E> {
    /// Adds the product of the transposed matrix with `vectors`, panels of each channel, to the first rows of `sums`:
    /// one row per matrix column.
    pub fn add_product(&self, vectors: [&[Panel]; 3], sums: &mut VectorBatch) {
        tasks(vectors, sums, self.columns, COLUMNS).into_par_iter().enumerate().for_each(|(piece, tasks)| {
            pulp::Arch::new().dispatch(MultiplyTransposed { parts: &self.parts, first: piece * COLUMNS, tasks });
        });
    }
}

/// The products of one piece of columns with all panels.
struct MultiplyTransposed<'a, E> {
    parts: &'a [TransposedPart<E>],
    /// First column of the piece.
    first: usize,
    tasks: Vec<Task<'a>>,
}

impl<E: Entry> pulp::NullaryFnOnce for MultiplyTransposed<'_, E> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for Task { panels, mut sums } in self.tasks {
            for part in self.parts {
                let panels = panels.map(|panel| &panel[part.before..]);
                for (column, entries) in part.first[self.first..].windows(2).enumerate().take(sums[0].len()) {
                    let mut all = sums.each_ref().map(|of_channel| of_channel[column]);
                    for entry in &part.entries[entries[0] as usize..entries[1] as usize] {
                        let x = panels.map(|panel| &panel[entry.row()]);
                        add_multiples(&mut all, entry.value(), x);
                    }
                    sums.iter_mut().zip(all).for_each(|(of_channel, sum)| of_channel[column] = sum);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::vector_batch::WIDTH;
    use super::*;
    use crate::physics::sequence::Points;

    fn random(i: usize, j: usize) -> f32 {
        Points::new(5, 0).at(i as u32, j as u32)[0] as f32 - 0.5
    }

    /// `row` returns columns and values.
    fn matrix(rows: std::ops::Range<usize>, row: impl Fn(usize) -> Vec<(usize, [f32; 3])>) -> CsrMatrix {
        let mut matrix = CsrMatrix::empty(0);
        for r in rows {
            for (column, value) in row(r) {
                matrix.columns.push(column as u32);
                matrix.values.push(value);
            }
            matrix.first.push(matrix.columns.len());
        }
        matrix
    }

    /// More columns than a task has, more vectors than a panel, two parts, empty rows and a full one. Values are exact
    /// in bf16.
    #[test]
    fn products_are_those_of_the_rows() {
        let (row_count, columns, vectors) = (70, 2 * COLUMNS + 3, WIDTH + 1);
        let value = |r: usize, column: usize| {
            [1, 2, 3].map(|channel| bf16::from_f32(random(r, channel * 10_000 + column)).to_f32())
        };
        let row = |r: usize| {
            let is_kept = |column: &usize| r != 3 && (r == 4 || random(r, *column) > 0.4);
            (0..columns).filter(is_kept).map(|column| (column, value(r, column))).collect::<Vec<_>>()
        };
        let part = |rows: std::ops::Range<usize>| {
            TransposedPart::<Rounded>::new(&matrix(rows.clone(), row), rows.start, columns)
        };
        let batch =
            VectorBatch::from_fn(row_count, vectors, |channel, r, vector| random(5000 + r, 100 * channel + vector));
        let mut products = VectorBatch::zeros(columns, vectors);
        Transposed { columns, parts: vec![part(0..30), part(30..row_count)] }
            .add_product(batch.panels(), &mut products);
        let mut want = vec![[[0.0f64; 3]; WIDTH + 1]; columns];
        for r in 0..row_count {
            for (column, value) in row(r) {
                for (vector, c) in (0..vectors).flat_map(|v| [0, 1, 2].map(|c| (v, c))) {
                    want[column][vector][c] += f64::from(value[c]) * f64::from(batch.get(c, r, vector));
                }
            }
        }
        for (column, vector) in (0..columns).flat_map(|column| (0..vectors).map(move |v| (column, v))) {
            for (channel, want) in want[column][vector].iter().enumerate() {
                let off = f64::from(products.get(channel, column, vector)) - want;
                assert!(off.abs() < 1e-5, "{channel} {column} {vector}: {off}");
            }
        }
    }

    /// Equal entries. The bf16 number nearest to the first is 0.4 % off, so to the nearest all sums would be.
    #[test]
    fn rounding_has_no_bias() {
        let (row_count, columns) = (PART, 600);
        let values = [1.0 + 0.499 / 128.0, -0.7, 0.0];
        let rows = matrix(0..row_count, |_| (0..columns).map(|column| (column, values)).collect());
        let ones = vec![[1.0; WIDTH]; row_count];
        let mut sums = VectorBatch::zeros(columns, 1);
        let rows = Transposed { columns, parts: vec![TransposedPart::<Rounded>::new(&rows, 0, columns)] };
        rows.add_product([std::slice::from_ref(&ones); 3], &mut sums);
        for (channel, value) in values.into_iter().enumerate() {
            let means: Vec<f32> = (0..columns).map(|j| sums.get(channel, j, 0) / row_count as f32).collect();
            let mean = means.iter().sum::<f32>() / columns as f32;
            assert!((mean - value).abs() <= 5e-5, "channel {channel}: {mean} instead of {value}");
            for (column, mean) in means.into_iter().enumerate() {
                // Five standard deviations.
                assert!((mean - value).abs() <= 9e-4, "channel {channel}, column {column}: {mean} instead of {value}");
            }
        }
    }
}
