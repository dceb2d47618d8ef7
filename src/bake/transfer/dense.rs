//! The dense form: explicit G* and Φ, for few gather samples.

use glam::{DVec3, UVec4, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Transfer, TransferReport};
use crate::bake::DeepFramebuffer;
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::transfer::blocks::{BlockMatrix, Columns, Dense};
use crate::bake::transport::LightTransport;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::emitted::{self, Emitted, EmitterLight};
use crate::bake::transport::rows::RowGatherer;
use crate::shared::Panel;
use crate::storage::journal::Journal;
use crate::storage::mapped::Elements;
use crate::storage::pods;
use crate::trace::packet::PACKET_SIZE;

impl Transfer {
    /// Our operator in dense form, to the view samples of `framebuffer`: G* explicitly, then Φ. Rows of Φ found in
    /// `journal` are reused. `progress` counts view samples.
    pub fn dense(
        transfer: &LightTransport,
        framebuffer: &DeepFramebuffer,
        lobe: Lobe,
        journal: &mut Journal,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Self {
        let fine = transfer.fine.coefficient_count();
        let further = transfer.further_bounces();
        let one_level = transfer.coarse.is_none();
        // With one level, Φ also receives the direct light of the same samples: the identity.
        let bounced = |row: usize, column: usize| {
            let itself = if one_level && row == column { 1.0 } else { 0.0 };
            further.each_ref().map(|matrix| (matrix[(row, column)] + itself) as f32)
        };
        let vector_length = fine + further[0].nrows();
        let bounce = explicit(fine, further[0].nrows(), bounced);
        let emitted = transfer.emitted(framebuffer, lobe);
        let offset = if one_level { fine as u32 } else { 0 };
        let none = transfer.bounces() == Some(0);
        let gatherer = RowGatherer { framebuffer, ..transfer.row_gatherer(lobe) };
        let gather = |samples: &[u32]| if none { CsrMatrix::empty(samples.len()) } else { gatherer.gather(samples) };
        let (last, emission) = last_matrix(framebuffer, vector_length, offset, &emitted, gather, journal, progress);
        let even = transfer.even_light();
        let of_even = |row: usize| {
            DVec3::from_array([0, 1, 2].map(|c: usize| (0..fine).map(|i| further[c][(row, i)] * even[i][c]).sum()))
        };
        let residual = transfer.residual(&(0..further[0].nrows()).map(of_even).collect::<Vec<_>>());
        let report = TransferReport::robust("dense", transfer, residual, None);
        let transfer = Self { emission, report, ..Self::new(&transfer.fine, vector_length, vec![bounce, last]) };
        transfer.with_packets()
    }
}

/// Rows of the explicit matrix that are packed together.
const ROWS_AT_ONCE: usize = 256;
/// View samples whose rows share a list of columns: a tile of pixels.
const ROWS_A_BLOCK: usize = PACKET_SIZE;
/// Number of blocks that are gathered together.
const BLOCKS_AT_ONCE: usize = 64;

/// A dense matrix from the first `columns` elements of the vector to the `rows` elements after them.
pub(in crate::bake) fn explicit(columns: usize, rows: usize, value: impl Fn(usize, usize) -> [f32; 3]) -> BlockMatrix {
    let all: Vec<u32> = (0..columns as u32).collect();
    let mut matrix = BlockMatrix::new(3, columns + rows, columns + rows);
    for first in (0..rows).step_by(ROWS_AT_ONCE) {
        let count = ROWS_AT_ONCE.min(rows - first);
        let mut values = vec![0.0; 3 * count * columns];
        for (row, column) in (0..count).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            for (channel, value) in value(first + row, column).into_iter().enumerate() {
                values[(channel * count + row) * columns + column] = value;
            }
        }
        let outputs: Vec<u32> = (0..count).map(|row| (columns + first + row) as u32).collect();
        matrix.push(&Dense { rows: &outputs, own: Columns { inputs: &all, values: &values }, ..Default::default() });
    }
    matrix
}

/// Φ in dense blocks, from its sparse rows, whose columns start at `offset` in the vector; and the light of emitters.
pub(in crate::bake) fn last_matrix(
    framebuffer: &DeepFramebuffer,
    vector_length: usize,
    offset: u32,
    emitted: &Emitted,
    gather: impl Fn(&[u32]) -> CsrMatrix,
    journal: &mut Journal,
    progress: &(dyn Fn(usize) + Sync),
) -> (BlockMatrix, Vec<EmitterLight>) {
    let empty = || BlockMatrix::new(3, vector_length, framebuffer.samples.len());
    let mut matrix = empty();
    let mut emission = emitted.images(framebuffer.samples.len());
    for piece in framebuffer.reflecting().chunks(ROWS_A_BLOCK * BLOCKS_AT_ONCE) {
        let make = || {
            let rows = gather(piece);
            let block = |(block, samples): (usize, &[u32])| {
                let mut part = empty();
                push_block(&mut part, &rows, block * ROWS_A_BLOCK, samples, offset);
                part
            };
            let blocks: Vec<_> = piece.par_chunks(ROWS_A_BLOCK).enumerate().map(block).collect();
            let mut all = empty();
            blocks.into_iter().for_each(|block| all.append(block));
            Recorded::new(&all, emitted.radiance(&rows, piece))
        };
        let is_of = |record: &Recorded| {
            let part = record.matrix(empty());
            part.is_consistent()
                && part.outputs.iter().all(|output| piece.binary_search(output).is_ok())
                && record.emission.len() == piece.len() * emitted.count()
        };
        let record = journal.next(is_of, make);
        matrix.append(record.matrix(empty()));
        emitted::place(&mut emission, piece, &record.emission);
        progress(piece.len());
    }
    (matrix, emission)
}

/// Some rows of a matrix in a journal, and the light of emitters there.
#[derive(Serialize, Deserialize)]
struct Recorded {
    #[serde(with = "pods")]
    panels: Vec<Panel>,
    #[serde(with = "pods")]
    inputs: Vec<u32>,
    #[serde(with = "pods")]
    outputs: Vec<u32>,
    #[serde(with = "pods")]
    values: Vec<UVec4>,
    emission: Vec<Vec3>,
}

impl Recorded {
    fn new(matrix: &BlockMatrix, emission: Vec<Vec3>) -> Self {
        Self {
            panels: matrix.panels.clone(),
            inputs: matrix.inputs.clone(),
            outputs: matrix.outputs.clone(),
            values: matrix.values.to_vec(),
            emission,
        }
    }

    /// The rows as a part of a matrix with the shape of `empty`.
    fn matrix(&self, empty: BlockMatrix) -> BlockMatrix {
        BlockMatrix {
            panels: self.panels.clone(),
            tints: vec![Vec3::ONE; self.inputs.len()],
            inputs: self.inputs.clone(),
            outputs: self.outputs.clone(),
            values: Elements::from(self.values.clone()),
            ..empty
        }
    }
}

/// Adds the rows of `samples`, from row `first` on, with the union of their columns.
fn push_block(matrix: &mut BlockMatrix, rows: &CsrMatrix, first: usize, samples: &[u32], offset: u32) {
    let listed = (0..samples.len()).flat_map(|r| rows.row(first + r));
    let mut columns: Vec<u32> = listed.map(|(column, _)| column).collect();
    columns.sort_unstable();
    columns.dedup();
    let mut values = vec![0.0; 3 * samples.len() * columns.len()];
    for r in 0..samples.len() {
        for (column, value) in rows.row(first + r) {
            let c = columns.binary_search(&column).expect("it was listed");
            for (channel, value) in value.into_iter().enumerate() {
                values[(channel * samples.len() + r) * columns.len() + c] = value;
            }
        }
    }
    columns.iter_mut().for_each(|c| *c += offset);
    matrix.push(&Dense { rows: samples, own: Columns { inputs: &columns, values: &values }, ..Default::default() });
}
