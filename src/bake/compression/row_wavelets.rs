//! Each row's own wavelets, the published form that ours is compared with [Hasan 2006].
//!
//! A row of T in Haar terms has few large ones, elsewhere for each pixel; these are kept. Light varies slowly, so a term
//! counts for more the more samples it spans: what is compared is |t| times their number, as in the area-weighted
//! selection of [Ng 2003].
//!
//! Differs from [Hasan 2006]: bounces among gather samples are no matrix of their own but part of each row, wavelets run
//! along our tree, where theirs lie in a square image, each function of a glossy sample has its own, and how many are kept
//! follows from `--error`.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::bounces::{Bounces, Thinned};
use super::haar::Haar;
use super::lights::Kind;
use super::panels::{self, Panel, Panels, WIDTH};
use super::training::{Direct, Group, Trainer};
use super::{BIAS, CompressionSettings, DECIDING, POINTS, Report, SPOTS, THINNED};
use crate::bake::transfer::Transfer;
use crate::bake::transfer::rows::{RowGatherer, Rows};
use crate::bake::transfer::sparse::SparseMatrix;
use crate::sequence::Points;
use crate::shared::NO_BRDF;

/// Cuts the rows of one transfer.
pub struct RowWavelets<'a> {
    gatherer: RowGatherer<'a>,
    bounces: Thinned,
    haar: Haar,
    /// Square of each term's weight.
    weights: Vec<f32>,
    /// Lights to decide by and to check with: what rows of Φ multiply, and Haar terms.
    lights: [Panels; 2],
    /// What rows of Φ multiply for the light of emitters; absent without any.
    emitted: Option<Vec<DVec3>>,
    /// View samples that reflect anything.
    pub samples: Vec<u32>,
    /// Share of a row's weighted energy that is left out at most.
    pub left_out: f64,
    /// Terms of a row that are kept, mean over a few.
    pub kept: f64,
    /// Relative noise of the rows under deciding lights.
    noise: f64,
}

/// View samples that tell how bright lights' images are, and how noisy.
const SCOUTS: usize = 2048;
/// Those of them by which it is decided how much is left out.
const CUT: usize = 256;
/// Halvings of the range in which that is looked for, and its ends.
const HALVINGS: usize = 10;
const LEFT_OUT: [f64; 2] = [1e-9, 1.0];
/// Rows that are looked at at once, whole panels of them.
const AT_ONCE: usize = 4 * WIDTH;
/// Rows that are sorted by length together.
const WINDOW: usize = 32 * AT_ONCE;
/// One of so many pieces is checked with held-out lights.
const CHECKED: usize = 8;

impl<'a> RowWavelets<'a> {
    /// `direct` gives the coefficients of direct light.
    pub fn new(transfer: &'a Transfer<'a>, direct: &Direct, settings: &CompressionSettings) -> Self {
        let bounces = Bounces::new(transfer);
        let haar = Haar::new(&transfer.fine.first);
        let all = &transfer.baked().samples;
        let samples: Vec<u32> = (0..all.len() as u32).filter(|&i| all[i as usize].brdf != NO_BRDF).collect();
        let seed = |purpose: u64| settings.seed ^ (32 + purpose) << 32;
        let points = Points::new(seed(0), 0);
        let scout = |i: usize| samples[(points.at(i as u32, 0)[0] * samples.len() as f64) as usize];
        let scouts: Vec<u32> = (0..SCOUTS.min(samples.len())).map(scout).collect();
        let mut gatherer = transfer.row_gatherer(settings.lobe);
        let rows = gatherer.gather(&scouts);
        gatherer.seed ^= 1 << 33;
        let anew = gatherer.gather(&scouts);
        gatherer.seed ^= 1 << 33;

        let share = scouts.len() as f64 / samples.len().max(1) as f64;
        let trainer = Trainer { transfer, bounces: &bounces, direct, scouts: &rows, share };
        let group = |kind, count, purpose| Group { kind, count, seed: seed(purpose) };
        let spots = settings.lights / 4;
        let learned = trainer.lights(&[group(Kind::Point, settings.lights - spots, 1), group(Kind::Spot, spots, 2)]);
        let checks = trainer.lights(&[
            group(Kind::Point, DECIDING.len(), 3),
            group(Kind::Point, POINTS.len(), 4),
            group(Kind::Spot, SPOTS.len(), 5),
        ]);
        let bounced = bounces.seen(&checks.direct, &checks.further);
        let [learned, terms] = [learned.direct, checks.direct].map(|mut light| {
            light.for_each_mut(|_, panel| haar.transform(panel));
            light
        });
        // As closely as for nested blocks.
        let power = [0, 1, 2].map(|channel| learned.row_squares(channel));
        let bounces = bounces.thinned(&haar, &power, (THINNED * settings.error).powi(2));
        let emission = transfer.emission();
        let emitted = emission.iter().any(|e| *e != DVec3::ZERO).then(|| transfer.bounce(&emission).0);
        let weight = |span: u32| (span as f32).powi(2);
        let weights = haar.spans(transfer.fine.coefficient_count()).into_iter().map(weight).collect();
        let (left_out, kept, noise) = (0.0, 0.0, 0.0);
        let lights = [bounced, terms];
        let mut made = Self { gatherer, bounces, haar, weights, lights, emitted, samples, left_out, kept, noise };
        made.decide(&rows, &anew, &scouts[..CUT.min(scouts.len())], settings.error);
        made
    }

    /// Finds how much may be left out, so that on average over deciding lights what rows make of them is as far off as is
    /// asked for, and as the noise of `rows` is, which those gathered `anew` tell.
    fn decide(&mut self, rows: &Rows, anew: &Rows, samples: &[u32], error: f64) {
        let [bounced, lights] = &self.lights;
        let far = |images: &Panels, others: &Panels| mean(&compare(images, others)[DECIDING]);
        // Both have the same noise.
        let noise = 0.5f64.sqrt() * far(&panels::multiply(rows, bounced), &panels::multiply(anew, bounced));
        let rows = self.gatherer.gather(samples);
        let (images, terms) = (panels::multiply(&rows, bounced), self.terms(&rows));
        let [mut low, mut high] = LEFT_OUT.map(f64::ln);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            let kept = self.largest(&terms, middle.exp());
            let enough = far(&images, &panels::multiply(&kept, lights)) <= noise.hypot(BIAS * error);
            *(if enough { &mut low } else { &mut high }) = middle;
        }
        let left_out = low.exp();
        self.kept = self.largest(&terms, left_out).columns.len() as f64 / rows.len().max(1) as f64;
        (self.left_out, self.noise) = (left_out, noise);
    }

    /// Rows of all view samples that reflect anything; indirect radiance of emitters at all view samples, exactly, or
    /// nothing without any; and how the rows do. `progress` counts view samples.
    pub fn compress(&self, progress: &dyn Fn(usize)) -> (SparseMatrix, Vec<Vec3>, Report) {
        let all = self.gatherer.baked.samples.len();
        let mut matrix = SparseMatrix::new(self.weights.len(), all);
        let mut emission = vec![Vec3::ZERO; if self.emitted.is_some() { all } else { 0 }];
        let mut errors = Errors(vec![[0.0; 2]; SPOTS.end]);
        for window in self.samples.chunks(WINDOW) {
            let mut parts = Vec::new();
            for (i, samples) in window.chunks(AT_ONCE).enumerate() {
                let rows = self.gatherer.gather(samples);
                let kept = self.largest(&self.terms(&rows), self.left_out);
                if i % CHECKED == 0 {
                    let [want, got] =
                        [(&rows, 0), (&kept, 1)].map(|(rows, of)| panels::multiply(rows, &self.lights[of]));
                    errors.add(&want, &got);
                }
                if let Some(emitted) = &self.emitted {
                    let emitted = rows.multiply(emitted);
                    samples.iter().zip(emitted).for_each(|(&i, e)| emission[i as usize] = e.as_vec3());
                }
                parts.push(kept);
                progress(samples.len());
            }
            matrix.push(&Rows::concatenated(parts), window);
        }
        (matrix, emission, errors.report(self.noise))
    }

    /// Rows of T in Haar terms, as vectors.
    fn terms(&self, rows: &Rows) -> Panels {
        let columns = self.gatherer.levels.iter().map(|level| level.coefficient_count()).sum();
        let mut gathered = Panels::zeros(columns, rows.len());
        for r in 0..rows.len() {
            for (channel, panels) in gathered.channels.iter_mut().enumerate() {
                let panel = &mut panels[r / WIDTH];
                rows.row(r).for_each(|(column, value)| panel[column as usize][r % WIDTH] = value[channel]);
            }
        }
        self.bounces.terms(&self.haar, gathered)
    }

    /// The fewest terms of each vector that leave out no more than a share of its weighted energy.
    fn largest(&self, terms: &Panels, left_out: f64) -> Rows {
        let panel = |p: usize| {
            let count = WIDTH.min(terms.count - p * WIDTH);
            largest(&[0, 1, 2].map(|channel| &terms.channels[channel][p]), &self.weights, left_out, count)
        };
        Rows::concatenated((0..terms.channels[0].len()).into_par_iter().map(panel).collect())
    }
}

/// Classes of energies of a float's first bits: eight an octave, which tells terms apart well enough.
const CLASSES: usize = 1 << 11;
const CLASS_SHIFT: u32 = 20;

/// Of each of the first `count` vectors of a panel, one for each channel, the terms of the highest classes.
fn largest(panels: &[&Panel; 3], weights: &[f32], left_out: f64, count: usize) -> Rows {
    let energies = |i: usize| -> [f32; WIDTH] {
        let [red, green, blue] = panels.map(|panel| &panel[i]);
        std::array::from_fn(|v| weights[i] * (red[v] * red[v] + green[v] * green[v] + blue[v] * blue[v]))
    };
    let class = |energy: f32| (energy.to_bits() >> CLASS_SHIFT) as usize;
    let mut by_class = vec![[0.0f64; WIDTH]; CLASSES];
    for i in 0..weights.len() {
        for (v, energy) in energies(i).into_iter().enumerate() {
            by_class[class(energy)][v] += f64::from(energy);
        }
    }
    let least: [usize; WIDTH] = std::array::from_fn(|v| {
        let allowed = left_out * by_class.iter().map(|sums| sums[v]).sum::<f64>();
        let mut sum = 0.0;
        // Terms of nothing are never kept.
        let fits = |sums: &&[f64; WIDTH]| {
            sum += sums[v];
            sum <= allowed
        };
        by_class.iter().take_while(fits).count().max(1)
    });
    let mut kept: Vec<(Vec<u32>, Vec<[f32; 3]>)> = vec![Default::default(); count];
    for i in 0..weights.len() {
        for (v, energy) in energies(i).into_iter().enumerate().take(count) {
            if class(energy) >= least[v] {
                kept[v].0.push(i as u32);
                kept[v].1.push(panels.map(|panel| panel[i][v]));
            }
        }
    }
    let row = |(columns, values): (Vec<u32>, Vec<[f32; 3]>)| Rows { first: vec![0, columns.len()], columns, values };
    Rows::concatenated(kept.into_iter().map(row).collect())
}

/// Square of each image's distance from another, and its own.
fn compare(images: &Panels, others: &Panels) -> Vec<[f64; 2]> {
    let mut difference = others.clone();
    for (channel, images) in difference.channels.iter_mut().zip(&images.channels) {
        for (panel, image) in channel.iter_mut().zip(images) {
            panel.as_flattened_mut().iter_mut().zip(image.as_flattened()).for_each(|(a, b)| *a -= b);
        }
    }
    difference.squares().into_iter().zip(images.squares()).map(<[f64; 2]>::from).collect()
}

/// Relative errors from squared ones and squares; lights that nothing is seen of say nothing.
fn relative(squares: &[[f64; 2]]) -> Vec<f64> {
    squares.iter().filter(|[_, image]| *image > 0.0).map(|[error, image]| (error / image).sqrt()).collect()
}

/// Mean relative error.
fn mean(squares: &[[f64; 2]]) -> f64 {
    let errors = relative(squares);
    errors.iter().sum::<f64>() / errors.len().max(1) as f64
}

/// Of what was checked, light by light.
struct Errors(Vec<[f64; 2]>);

impl Errors {
    fn add(&mut self, want: &Panels, got: &Panels) {
        self.0.iter_mut().zip(compare(want, got)).for_each(|(sum, [e, w])| *sum = [sum[0] + e, sum[1] + w]);
    }

    fn report(self, noise: f64) -> Report {
        let worst = relative(&self.0[POINTS.start..SPOTS.end]).into_iter().fold(0.0, f64::max);
        Report { point: mean(&self.0[POINTS]), spot: mean(&self.0[SPOTS]), worst, noise, ..Default::default() }
    }
}
