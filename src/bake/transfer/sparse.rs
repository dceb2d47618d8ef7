//! Sparse matrices with separate columns for each row.
//!
//! Rows are sliced as in [Kreutzer 2014]: those of a window are sorted by length, so that neighbouring threads process
//! rows of about equal length, and shorter rows are padded with zeros. A term has factors for R, G and B in float16 and
//! a 16-bit increment from the previous column: eight bytes, read two terms at a time.

use std::ops::Range;

use glam::{DVec3, UVec4};
use half::f16;
use rayon::prelude::*;

use super::blocks::{pieces, scale};
use crate::bake::csr_matrix::CsrMatrix;
use crate::shared::{GROUP_SIZE, Slice};

/// A sparse matrix for RGB vectors.
#[derive(Clone, Debug, Default)]
pub struct SellMatrix {
    /// Number of elements of the input vector.
    pub input_count: u32,
    /// Number of elements of the output vector.
    pub output_count: u32,
    pub slices: Vec<Slice>,
    /// Output of each row; all slices except the last are full.
    pub outputs: Vec<u32>,
    /// For each slice: `[terms / 2][row]`, two terms each: red and green, blue and increment, twice.
    pub values: Vec<UVec4>,
}

/// A range of slices of a matrix, with indices relative to the data stored here.
pub struct Piece<'a> {
    pub slices: Vec<Slice>,
    pub outputs: &'a [u32],
    pub values: &'a [UVec4],
}

/// Size of a term.
pub const TERM_BYTES: usize = size_of::<UVec4>() / 2;
/// Rows per slice.
const ROWS: usize = GROUP_SIZE as usize;

/// One term before packing: its column (or increment) and RGB.
type Term = (u32, [f32; 3]);

impl SellMatrix {
    /// A matrix without slices.
    pub fn new(input_count: usize, output_count: usize) -> Self {
        let [input_count, output_count] =
            [input_count, output_count].map(|n| u32::try_from(n).expect("indices are u32"));
        Self { input_count, output_count, ..Default::default() }
    }

    /// Adds a window of rows, where row r gives `outputs[r]`; rows without terms are omitted. All windows except the
    /// last should fill whole slices, otherwise there are more slices than necessary.
    pub fn push(&mut self, rows: &CsrMatrix, outputs: &[u32]) {
        let mut packed: Vec<(Vec<Term>, u32)> = (0..rows.len())
            .into_par_iter()
            .filter(|&r| rows.row(r).next().is_some())
            .map(|r| (stepwise(rows.row(r)), outputs[r]))
            .collect();
        packed.sort_by_key(|(terms, _)| std::cmp::Reverse(terms.len()));
        for slice in packed.chunks(ROWS) {
            let pairs = slice[0].0.len().div_ceil(2);
            let all = slice.iter().flat_map(|(terms, _)| terms).flat_map(|(_, factors)| factors);
            let scale = scale(all.fold(0.0f32, |m, v| m.max(v.abs())));
            let first_value = self.values.len();
            self.slices.push(Slice {
                first_value: first_value as u32,
                first_output: self.outputs.len() as u32,
                row_count: slice.len() as u32,
                pair_count: pairs as u32,
                scale,
            });
            self.values.resize(first_value + pairs * ROWS, UVec4::ZERO);
            for (r, (terms, output)) in slice.iter().enumerate() {
                for (pair, two) in terms.chunks(2).enumerate() {
                    self.values[first_value + pair * ROWS + r] = pack(two, scale);
                }
                self.outputs.push(*output);
            }
        }
    }

    /// Whether every index that a kernel follows is valid, and no output has two rows.
    pub fn is_consistent(&self) -> bool {
        let mut seen = vec![false; self.output_count as usize];
        let end = |s: &Slice| s.first_value as usize + s.pair_count as usize * ROWS;
        let inputs_exist = |slice: &Slice| {
            (0..slice.row_count as usize).all(|r| {
                let mut columns = self.columns(slice, r);
                columns.all(|(column, _)| column < u64::from(self.input_count))
            })
        };
        self.outputs.iter().all(|&o| o < self.output_count && !std::mem::replace(&mut seen[o as usize], true))
            && self.slices.windows(2).all(|s| {
                end(&s[0]) <= s[1].first_value as usize && s[0].first_output + s[0].row_count <= s[1].first_output
            })
            && self.slices.iter().all(|s| {
                s.row_count <= GROUP_SIZE
                    && s.first_output as usize + s.row_count as usize <= self.outputs.len()
                    && end(s) <= self.values.len()
            })
            && self.slices.par_iter().all(inputs_exist)
    }

    /// Ranges of slices with at most `bytes` of terms, or of a single slice.
    pub fn pieces(&self, bytes: usize) -> Vec<Range<usize>> {
        pieces(self.slices.iter().map(|slice| slice.pair_count as usize * ROWS * size_of::<UVec4>()), bytes)
    }

    /// The given slices as a separate matrix.
    pub fn piece(&self, slices: Range<usize>) -> Piece<'_> {
        let slices = &self.slices[slices];
        let [first, last] = [&slices[0], &slices[slices.len() - 1]];
        let (value, output) = (first.first_value, first.first_output);
        let of_piece =
            |s: &Slice| Slice { first_value: s.first_value - value, first_output: s.first_output - output, ..*s };
        Piece {
            slices: slices.iter().map(of_piece).collect(),
            outputs: &self.outputs[output as usize..(last.first_output + last.row_count) as usize],
            values: &self.values[value as usize..last.first_value as usize + last.pair_count as usize * ROWS],
        }
    }

    /// Bytes read by a multiplication: terms and indices.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.values[..]) + size_of_val(&self.outputs[..]) + size_of_val(&self.slices[..])
    }

    /// Multiply-adds of all three channels, padding included.
    pub fn multiply_adds(&self) -> u64 {
        self.slices.iter().map(|s| 6 * u64::from(s.row_count) * u64::from(s.pair_count)).sum()
    }

    /// The column of each term.
    pub fn inputs(&self) -> impl Iterator<Item = u32> {
        let rows = self.slices.iter().flat_map(|slice| (0..slice.row_count as usize).map(move |row| (slice, row)));
        rows.flat_map(|(slice, row)| self.columns(slice, row)).map(|(column, _)| column as u32)
    }

    /// The product with `vector`, in double precision; twin of multiply_sparse.comp.
    pub fn multiply(&self, vector: &[DVec3]) -> Vec<DVec3> {
        self.sum_rows(|factor, i| factor * vector[i])
    }

    /// The same with magnitudes of all terms, for bounds on rounding errors.
    pub fn multiply_magnitudes(&self, vector: &[DVec3]) -> Vec<DVec3> {
        self.sum_rows(|factor, i| (factor * vector[i]).abs())
    }

    /// Sums of `term(factor, input)` over each row.
    fn sum_rows(&self, term: impl Fn(DVec3, usize) -> DVec3 + Sync) -> Vec<DVec3> {
        let slice = |slice: &Slice| {
            let row = |r: usize| {
                let sum = self.terms(slice, r).map(|(column, factor)| term(factor, column as usize)).sum::<DVec3>();
                (self.outputs[slice.first_output as usize + r], sum * f64::from(slice.scale))
            };
            (0..slice.row_count as usize).map(row).collect::<Vec<_>>()
        };
        let mut result = vec![DVec3::ZERO; self.output_count as usize];
        for (output, sum) in self.slices.par_iter().flat_map_iter(slice).collect::<Vec<_>>() {
            result[output as usize] = sum;
        }
        result
    }

    /// Column and factors of each term of a row, before the slice's scale.
    fn terms(&self, slice: &Slice, row: usize) -> impl Iterator<Item = (u64, DVec3)> {
        self.columns(slice, row).map(|(column, words)| {
            let [red, green, blue, _]: [f16; 4] = bytemuck::cast(words);
            (column, DVec3::new(red.to_f64(), green.to_f64(), blue.to_f64()))
        })
    }

    /// Column of each term of a row, and its packed words.
    fn columns(&self, slice: &Slice, row: usize) -> impl Iterator<Item = (u64, [u32; 2])> {
        let first = slice.first_value as usize + row;
        let halves = (0..slice.pair_count as usize).flat_map(move |pair| {
            let words = self.values[first + pair * ROWS].to_array();
            [[words[0], words[1]], [words[2], words[3]]]
        });
        halves.scan(0u64, |column, words| {
            *column += u64::from(words[1] >> 16);
            Some((*column, words))
        })
    }
}

/// Replaces columns by increments; zero terms are inserted where an increment exceeds 16 bits.
fn stepwise(row: impl Iterator<Item = Term>) -> Vec<Term> {
    let mut terms = Vec::with_capacity(row.size_hint().0);
    let mut last = 0;
    for (column, factors) in row {
        let mut step = column - last;
        while step > u16::MAX.into() {
            terms.push((u16::MAX.into(), [0.0; 3]));
            step -= u32::from(u16::MAX);
        }
        terms.push((step, factors));
        last = column;
    }
    terms
}

/// Packs one or two terms, with factors divided by `scale`.
fn pack(terms: &[Term], scale: f32) -> UVec4 {
    let mut words = [[0u32; 2]; 2];
    for (words, (step, factors)) in words.iter_mut().zip(terms) {
        let [red, green, blue] = factors.map(|f| u32::from(f16::from_f32(f / scale).to_bits()));
        *words = [red | green << 16, blue | step << 16];
    }
    UVec4::from_array(bytemuck::cast(words))
}
