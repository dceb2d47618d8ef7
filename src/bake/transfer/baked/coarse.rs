//! A part of the compressed form, for pictures in a hurry: fewer directions of superclusters and tiles, fewer terms of light.

use glam::DVec3;
use rayon::prelude::*;

use super::BakedTransfer;
use crate::bake::compression::haar::Haar;
use crate::bake::transfer::blocks::{BlockMatrix, Dense};
use crate::shared::{PANEL_COLUMNS, Panel};

/// What is kept of a supercluster's directions, of a tile's, and of the terms of light. Reading V takes longest, so most of
/// it goes.
const DIRECTIONS: f64 = 0.5;
const TILE_DIRECTIONS: f64 = 0.5;
const TERMS: f64 = 0.33;
/// How light's squares grow with the span of a Haar term, between 0 for noise and 2 for what is smooth.
const SMOOTHNESS: f64 = 1.0;

impl BakedTransfer {
    /// With [`Self::coarse`], where the form has directions to leave out: the first ones are the fullest.
    pub fn with_coarse(mut self) -> Self {
        if let ([v, b, u], true) = (&self.chain[..], self.haar) {
            self.coarse = self.part(v, b, u);
        }
        self
    }

    fn part(&self, v: &BlockMatrix, b: &BlockMatrix, u: &BlockMatrix) -> Vec<BlockMatrix> {
        let first = self.first();
        let terms = first.last().map_or(0, |&end| end as usize);
        let spans = Haar::new(&first).spans(terms);
        let weight = |term: u32| f64::from(spans[term as usize]).powf(SMOOTHNESS);
        let first_columns = |columns: &[u32], share: f64| (0..kept(columns.len(), share)).collect::<Vec<_>>();
        vec![
            thinned(v, |block| {
                let rows = kept(block.rows.len(), DIRECTIONS);
                // Padding repeats the first column, with factors of zero.
                let power = |c: usize| {
                    let squares: f64 = (0..rows).map(|r| block.at(r, c).length_squared()).sum();
                    squares * weight(block.columns[c])
                };
                let powers: Vec<f64> = (0..block.columns.len()).map(power).collect();
                let mut columns: Vec<usize> = (0..powers.len()).collect();
                columns.sort_by(|&a, &b| powers[b].total_cmp(&powers[a]));
                columns.truncate(kept(columns.len(), TERMS));
                columns.sort_unstable();
                (rows, columns)
            }),
            thinned(b, |block| (block.rows.len(), first_columns(block.columns, DIRECTIONS))),
            thinned(u, |block| (block.rows.len(), first_columns(block.columns, TILE_DIRECTIONS))),
        ]
    }
}

/// A share of a number of columns or rows, in whole octets.
fn kept(count: usize, share: f64) -> usize {
    ((share * count as f64).ceil() as usize).next_multiple_of(PANEL_COLUMNS as usize).min(count)
}

/// Panels that share their columns.
struct Block<'a> {
    matrix: &'a BlockMatrix,
    panels: &'a [Panel],
    columns: &'a [u32],
    rows: Vec<u32>,
    /// Of each row: its panel, and its place there.
    places: Vec<(usize, usize)>,
}

impl<'a> Block<'a> {
    fn new(matrix: &'a BlockMatrix, panels: &'a [Panel]) -> Self {
        let first = panels[0].first_input as usize;
        let columns = &matrix.inputs[first..first + (panels[0].octet_count * PANEL_COLUMNS) as usize];
        let outputs = |p: &Panel| p.first_output as usize..(p.first_output + p.row_count) as usize;
        let rows = panels.iter().flat_map(|p| matrix.outputs[outputs(p)].iter().copied()).collect();
        let places = panels.iter().enumerate().flat_map(|(i, p)| (0..p.row_count as usize).map(move |r| (i, r)));
        Self { matrix, panels, columns, rows, places: places.collect() }
    }

    /// RGB.
    fn at(&self, row: usize, column: usize) -> DVec3 {
        let (panel, row) = self.places[row];
        let (octet, k) = (column / PANEL_COLUMNS as usize, column % PANEL_COLUMNS as usize);
        self.matrix.factors(&self.panels[panel], octet, row)[k] * f64::from(self.panels[panel].scale)
    }
}

/// Of each block of `matrix`, the first rows and those columns that `choose` names.
fn thinned(matrix: &BlockMatrix, choose: impl Fn(&Block) -> (usize, Vec<usize>) + Sync) -> BlockMatrix {
    let empty = || BlockMatrix::new(matrix.channels, matrix.input_count as usize, matrix.output_count as usize);
    let part = |panels: &[Panel]| {
        let block = Block::new(matrix, panels);
        let (rows, chosen) = choose(&block);
        let columns: Vec<u32> = chosen.iter().map(|&c| block.columns[c]).collect();
        let row = |channel: usize, r: usize| chosen.iter().map(|&c| block.at(r, c)[channel] as f32).collect::<Vec<_>>();
        let channels = 0..matrix.channels as usize;
        let values: Vec<f32> = channels.flat_map(|c| (0..rows).flat_map(|r| row(c, r)).collect::<Vec<_>>()).collect();
        let mut part = empty();
        part.push(&Dense { columns: &columns, rows: &block.rows[..rows], values: &values });
        part
    };
    let blocks: Vec<&[Panel]> = matrix.panels.chunk_by(|a, b| a.first_input == b.first_input).collect();
    let parts: Vec<BlockMatrix> = blocks.into_par_iter().map(part).collect();
    let mut all = empty();
    parts.into_iter().for_each(|part| all.append(part));
    all
}
