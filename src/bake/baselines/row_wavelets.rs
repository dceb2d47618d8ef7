//! Wavelet compression of each row, the published method that ours is compared with [Hasan 2006].
//!
//! A row of T has few large Haar terms, different ones for each pixel; only these are stored. Light varies slowly, so
//! terms that span more samples are more important. Terms are ranked by |t| times the number of samples, as in the
//! area-weighted selection of [Ng 2003].
//!
//! Differs from [Hasan 2006]: bounces among gather samples are included in each row instead of a separate matrix;
//! wavelets are defined on our tree instead of a square image; each function of a glossy sample has its own wavelets;
//! and the number of terms is determined by `--error`.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::bake::compression::inputs::Inputs;
use crate::bake::compression::largest::largest;
use crate::bake::compression::report::{FitReport, mean, relative};
use crate::bake::compression::training::Direct;
use crate::bake::compression::vector_batch::{self, VectorBatch, WIDTH};
use crate::bake::compression::{
    CompressionSettings, DECIDING, LOST_LIGHT_SHARE, Operator, SPOTS, random_subset, training_inputs,
};
use crate::bake::transfer::{Transfer, TransferReport};
use crate::bake::transport::{LightTransport, direct};
use crate::error::Result;
use crate::shared::PackedLight;

use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::transfer::sparse::{SellMatrix, TERM_BYTES};
use crate::bake::transport::emitted::{self, Emitted, EmitterLight};
use crate::bake::transport::rows::RowGatherer;
use crate::storage::journal::Journal;

/// Compresses the rows of one transfer.
pub struct RowWavelets<'a> {
    gatherer: RowGatherer<'a>,
    inputs: Inputs,
    /// Square of each term's weight.
    weights: Vec<f32>,
    emitted: Emitted<'a>,
    /// View samples that reflect light.
    pub samples: Vec<u32>,
    /// Maximum omitted share of a row's weighted energy.
    pub omitted_share: f64,
    /// Mean number of terms stored per row, over a few rows.
    pub kept: f64,
    /// Relative noise of the rows under deciding lights.
    noise: f64,
}

/// Compressed rows.
#[derive(Serialize, Deserialize)]
struct Cut {
    rows: CsrMatrix,
    /// Indirect radiance, uncompressed: for each row that of all emitters.
    emission: Vec<Vec3>,
    /// For each validation light: squared error and square of the image of the checked rows.
    found: Vec<[f64; 2]>,
}

/// View samples from which the noise of rows is estimated.
const PROBES: usize = 2048;
/// The first of these, from which the omitted share is determined.
const CUT: usize = 256;
/// Iterations of the bisection for the omitted share, and its initial range.
const HALVINGS: usize = 10;
const OMITTED_RANGE: [f64; 2] = [1e-9, 1.0];
/// Rows that are processed together: whole panels.
const ROWS_AT_ONCE: usize = 4 * WIDTH;
/// Rows that are sorted by length together.
const WINDOW: usize = 32 * ROWS_AT_ONCE;
/// One in this many pieces is checked with held-out lights.
const CHECKED: usize = 8;

impl<'a> RowWavelets<'a> {
    /// `direct` computes the coefficients of direct light.
    pub fn new(transfer: &'a LightTransport<'a>, direct: &Direct, settings: &CompressionSettings) -> Self {
        let samples = transfer.framebuffer().reflecting();
        let inputs = training_inputs(Operator { transport: transfer, from_sky: None }, direct, &samples, settings);
        let probes = random_subset(&samples, PROBES, settings.seed ^ 32 << 32);
        let mut gatherer = transfer.row_gatherer(settings.lobe);
        let rows = gatherer.gather(&probes);
        gatherer.seed ^= 1 << 33;
        let resampled = gatherer.gather(&probes);
        gatherer.seed ^= 1 << 33;
        let emitted = transfer.emitted(transfer.framebuffer(), settings.lobe);
        let weight = |span: u32| (span as f32).powi(2);
        let weights = inputs.haar.spans(transfer.fine.coefficient_count()).into_iter().map(weight).collect();
        let (omitted_share, kept, noise) = (0.0, 0.0, 0.0);
        let mut made = Self { gatherer, inputs, weights, emitted, samples, omitted_share, kept, noise };
        made.decide(&rows, &resampled, &probes[..CUT.min(probes.len())], settings.error);
        made
    }

    /// See [`LightTransport::residual`].
    pub fn residual(&self) -> Option<f64> {
        self.inputs.residual
    }

    /// Determines the omitted share of energy such that, averaged over deciding lights, the relative error of images
    /// equals the noise of `rows` plus a share of the target error. The noise is estimated by comparison with
    /// `resampled`.
    fn decide(&mut self, rows: &CsrMatrix, resampled: &CsrMatrix, samples: &[u32], error: f64) {
        let Inputs { validation_operands: bounced, validation_terms: lights, .. } = &self.inputs;
        let far = |images: &VectorBatch, others: &VectorBatch| mean(relative(&compare(images, others)[DECIDING]));
        // Both have equal noise.
        let noise =
            0.5f64.sqrt() * far(&vector_batch::multiply(rows, bounced), &vector_batch::multiply(resampled, bounced));
        let rows = self.gatherer.gather(samples);
        let (images, terms) = (vector_batch::multiply(&rows, bounced), self.terms(&rows));
        let [mut low, mut high] = OMITTED_RANGE.map(f64::ln);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            let kept = self.largest(&terms, middle.exp());
            let enough = far(&images, &vector_batch::multiply(&kept, lights)) <= noise + LOST_LIGHT_SHARE * error;
            *(if enough { &mut low } else { &mut high }) = middle;
        }
        let omitted_share = low.exp();
        self.kept = self.largest(&terms, omitted_share).columns.len() as f64 / rows.len().max(1) as f64;
        (self.omitted_share, self.noise) = (omitted_share, noise);
    }

    /// Rows of all view samples that reflect light, indirect light of emitters, and an error report. Rows found in
    /// `journal` are reused. `progress` counts view samples.
    pub fn compress(
        &self,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> (SellMatrix, Vec<EmitterLight>, FitReport) {
        let all = self.gatherer.framebuffer.samples.len();
        let mut matrix = SellMatrix::new(self.weights.len(), all);
        let mut emission = self.emitted.images(all);
        let mut errors = vec![[0.0; 2]; SPOTS.end];
        for window in self.samples.chunks(WINDOW) {
            let is_of = |cut: &Cut| {
                cut.rows.is_consistent(window.len(), self.weights.len())
                    && cut.emission.len() == window.len() * self.emitted.count()
                    && cut.found.len() == SPOTS.end
            };
            let cut = journal.next(is_of, || self.cut(window));
            add(&mut errors, cut.found);
            emitted::place(&mut emission, window, &cut.emission);
            matrix.push(&cut.rows, window);
            progress(window.len());
        }
        (matrix, emission, FitReport::new(&errors, self.noise))
    }

    /// Compresses some rows.
    fn cut(&self, window: &[u32]) -> Cut {
        let mut found = vec![[0.0; 2]; SPOTS.end];
        let (mut parts, mut emission) = (Vec::new(), Vec::new());
        for (i, samples) in window.chunks(ROWS_AT_ONCE).enumerate() {
            let rows = self.gatherer.gather(samples);
            let kept = self.largest(&self.terms(&rows), self.omitted_share);
            if i % CHECKED == 0 {
                let Inputs { validation_operands: operands, validation_terms: terms, .. } = &self.inputs;
                let [want, got] =
                    [(&rows, operands), (&kept, terms)].map(|(rows, lights)| vector_batch::multiply(rows, lights));
                add(&mut found, compare(&want, &got));
            }
            emission.extend(self.emitted.radiance(&rows, samples));
            parts.push(kept);
        }
        Cut { rows: CsrMatrix::concatenated(parts), emission, found }
    }

    /// Rows of T in Haar terms, as vectors.
    fn terms(&self, rows: &CsrMatrix) -> VectorBatch {
        let columns = self.gatherer.levels.iter().map(|level| level.coefficient_count()).sum();
        let mut terms = VectorBatch::from_rows(rows, 0..rows.len(), columns);
        self.inputs.bounces.to_terms(&self.inputs.haar, &mut terms);
        terms
    }

    /// The fewest terms of each vector such that the omitted ones have at most the share `omitted_share` of its
    /// weighted energy.
    fn largest(&self, terms: &VectorBatch, omitted_share: f64) -> CsrMatrix {
        largest(terms, [&self.weights; 3].map(Vec::as_slice), omitted_share)
    }
}

/// Squared distance of each image from the corresponding other one, and its own square.
fn compare(images: &VectorBatch, others: &VectorBatch) -> Vec<[f64; 2]> {
    let mut difference = others.clone();
    for (channel, images) in difference.channels.iter_mut().zip(&images.channels) {
        for (panel, image) in channel.iter_mut().zip(images) {
            panel.as_flattened_mut().iter_mut().zip(image.as_flattened()).for_each(|(a, b)| *a -= b);
        }
    }
    difference.squares().into_iter().zip(images.squares()).map(<[f64; 2]>::from).collect()
}

/// Adds squares for each light.
fn add(sums: &mut [[f64; 2]], found: Vec<[f64; 2]>) {
    sums.iter_mut().zip(found).for_each(|(sum, found)| *sum = [0, 1].map(|i| sum[i] + found[i]));
}

impl Transfer {
    /// Our operator, with the largest wavelets of each row. `fits` decides whether the given number of bytes is
    /// available, before most of the work. Rows found in `journal` are reused; `progress` counts view samples.
    pub fn haar(
        transfer: &LightTransport,
        settings: &CompressionSettings,
        fits: impl Fn(f64) -> Result<()>,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Self> {
        let direct = |light: &PackedLight| direct::shade(transfer.scene(), &transfer.fine, light);
        let wavelets = RowWavelets::new(transfer, &direct, settings);
        // On the host and on the device.
        fits(2.0 * (TERM_BYTES * wavelets.samples.len()) as f64 * wavelets.kept)?;
        let residual = wavelets.residual();
        let (sparse, emission, held_out) = wavelets.compress(journal, progress);
        let report = TransferReport::robust("haar", transfer, residual, Some(held_out));
        let plain = Self::new(&transfer.fine, transfer.fine.coefficient_count(), Vec::new());
        Ok(Self { haar: true, sparse: Some(sparse), emission, report, ..plain })
    }
}
