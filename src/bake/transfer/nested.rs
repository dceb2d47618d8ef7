//! The compressed form: Haar terms of direct light, then the nested bases of superclusters and tiles.

use glam::Vec3;
use half::f16;
use half::slice::HalfFloatSliceExt;

use super::{Transfer, TransferReport};
use crate::bake::compression::data::{Compressed, Supercluster};
use crate::bake::compression::{CompressionSettings, Compressor};
use crate::bake::transfer::blocks::{BlockMatrix, Columns, Dense};
use crate::bake::transport::LightTransport;
use crate::bake::transport::direct;
use crate::shared::PackedLight;
use crate::storage::journal::Journal;

impl Transfer {
    /// Our operator, compressed; what `journal` has is not done again. `progress` counts view samples.
    pub fn nested(
        transfer: &LightTransport,
        settings: &CompressionSettings,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Self {
        let direct = |light: &PackedLight| direct::shade(transfer.scene(), &transfer.fine, light);
        let compressor = Compressor::new(transfer, &direct, settings);
        let (compressed, held_out) = compressor.compress(journal, progress);
        let report = TransferReport::robust("nested", transfer, compressor.residual(), Some(held_out));
        let (vector_length, chain) = chain(&compressed, transfer.framebuffer().samples.len());
        let plain = Self::new(&transfer.fine, vector_length, chain);
        let mut emission = Vec::new();
        if !compressed.emission.is_empty() {
            emission.resize(transfer.framebuffer().samples.len(), Vec3::ZERO);
            let emitted = compressed.samples.iter().zip(&compressed.emission);
            emitted.for_each(|(&i, e)| emission[i as usize] = e.as_vec3());
        }
        Self { haar: true, emission, report, ..plain }
    }
}

/// V, B and U as block matrices on the vector [terms, y of all superclusters, c of all tiles]; and its length.
fn chain(compressed: &Compressed, view_samples: usize) -> (usize, Vec<BlockMatrix>) {
    let ranks = |s: &Supercluster| s.rank as usize;
    let first_c = compressed.coefficients + compressed.superclusters.iter().map(ranks).sum::<usize>();
    let length = first_c + compressed.tiles.iter().map(|t| t.rank as usize).sum::<usize>();
    let mut v = BlockMatrix::new(3, length, length);
    let mut b = BlockMatrix::new(1, length, length);
    let mut u = BlockMatrix::new(1, length, view_samples);
    let (mut y, mut c) = (compressed.coefficients as u32, first_c as u32);
    for supercluster in &compressed.superclusters {
        let terms = &compressed.terms[supercluster.first_term as usize..][..supercluster.terms as usize];
        let ys: Vec<u32> = (y..y + supercluster.rank).collect();
        let tints = &compressed.tints[supercluster.first_term as usize..][..terms.len()];
        let (own, tinted) = terms.split_at(supercluster.own as usize);
        let of_own = 3 * ys.len() * own.len();
        let values = floats(&compressed.v, supercluster.first_v, of_own + ys.len() * tinted.len(), 1.0);
        v.push(&Dense {
            rows: &ys,
            own: Columns { inputs: own, values: &values[..of_own] },
            shared: Columns { inputs: tinted, values: &values[of_own..] },
            tints: &tints[own.len()..],
        });
        y += supercluster.rank;
        let tiles = &compressed.tiles[supercluster.first_tile as usize..][..supercluster.tiles as usize];
        // All tiles of a supercluster read the same.
        let cs: Vec<u32> = (c..c + tiles.iter().map(|t| t.rank).sum::<u32>()).collect();
        let first_b = tiles.first().map_or(0, |t| t.first_b);
        let values = floats(&compressed.b, first_b, cs.len() * ys.len(), 1.0);
        b.push(&Dense { rows: &cs, shared: Columns { inputs: &ys, values: &values }, ..Default::default() });
        for tile in tiles {
            let columns: Vec<u32> = (c..c + tile.rank).collect();
            let rows = &compressed.samples[tile.first_sample as usize..][..tile.samples as usize];
            let values = floats(&compressed.u, tile.first_u, rows.len() * columns.len(), compressed.scale);
            u.push(&Dense { rows, shared: Columns { inputs: &columns, values: &values }, ..Default::default() });
            c += tile.rank;
        }
    }
    (length, vec![v, b, u])
}

fn floats(factors: &[f16], first: u64, count: usize, scale: f32) -> Vec<f32> {
    let mut values = vec![0.0; count];
    factors[first as usize..][..count].convert_to_f32_slice(&mut values);
    values.iter_mut().for_each(|v| *v *= scale);
    values
}
