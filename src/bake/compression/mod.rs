//! Transfer as nested blocks of low rank.
//!
//! T maps coefficients of gather samples to view samples and is never formed explicitly. View samples are grouped by
//! position and normal into superclusters, and these are divided into tiles. Over all placements of lights, the images
//! of a supercluster's pixels lie close to a low-dimensional space, and those of a tile to one of still fewer
//! dimensions:
//!
//! ```text
//! y = V λ̂[J]    c = B y    pixel = u·c
//! ```
//!
//! λ̂ are the [Haar terms](haar) of direct light, J the terms that are significant for the supercluster. Most terms are
//! multiplied by tints first (`chain.rs`). The same for light of the sky (`operator.rs`). Differs from [Hasan 2006]:
//! nested bases instead of wavelets chosen per row.

mod adjoint;
pub mod bounces;
mod chain;
pub mod clusters;
pub mod fit;
pub mod haar;
pub mod inputs;
pub(super) mod largest;
pub mod lights;
mod noise_estimate;
mod operator;
mod parts;
pub(super) mod report;
mod skies;
mod terms;
pub mod training;
mod transposed;
pub mod validation;
pub mod vector_batch;

pub use self::operator::{Operator, sky_haar};
pub use self::parts::{MAX_PARTS, Part};
pub use self::report::FitReport;

use std::ops::Range;
use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::bounces::Bounces;
use self::chain::Chain;
use self::clusters::Clusters;
use self::fit::{Budget, Factors, Projected, RIDGE_LIGHTS, Resampled, RowProducts};
use self::inputs::{Inputs, StoredInputs};
use self::lights::Kind;
use self::report::Errors;
use self::training::{Bounced, Direct, Group, Trainer};
use self::vector_batch::{Compact, WIDTH};
use super::transfer::blocks::{BlockMatrix, check_addressable};
use super::transport::directions::Lobe;
use super::transport::emitted::{self, Emitted, EmitterLight, StoredEmitted};
use super::transport::rows::RowBuffers;
use super::transport::{LightTransport, direct};
use crate::error::{Error, Result};
use crate::physics::sequence::Points;
use crate::shared::PackedLight;
use crate::storage::journal::Journal;

/// Accuracy of the compression.
#[derive(Clone, Debug, PartialEq)]
pub struct CompressionSettings {
    /// Target relative error of the indirect image, root mean square over all pixels, averaged over point lights, in
    /// addition to the noise of the rows. Strong noise can hide a larger error.
    pub error: f64,
    /// Number of random training lights.
    pub lights: usize,
    pub lobe: Lobe,
    pub seed: u64,
}

/// Compresses one transfer: generates the training lights once, then fits one supercluster after another.
pub struct Compressor<'a> {
    operator: Operator<'a>,
    settings: CompressionSettings,
    pub clusters: Clusters,
    inputs: Inputs,
    emitted: Emitted<'a>,
    /// See [`Compressor::costs`].
    costs: OnceLock<Vec<f64>>,
}

/// What a [`Compressor`] computes before it fits, in a file.
#[derive(Serialize, Deserialize)]
pub struct Stored<'a> {
    inputs: StoredInputs<'a>,
    emitted: StoredEmitted<'a>,
    costs: Vec<f64>,
}

/// For each tile and validation light: squared error and square of the image; whole images have square 1.
pub type ValidationSums = Vec<Vec<[f64; 2]>>;

/// The compressed operator.
pub struct Compressed {
    /// From Haar terms of direct light to view samples, see `Chain`.
    pub chain: Vec<BlockMatrix>,
    /// Indirect light of emitters, uncompressed.
    pub emission: Vec<EmitterLight>,
    pub report: FitReport,
}

/// The fit of a supercluster, or of part of one.
#[derive(Serialize, Deserialize)]
pub struct Fitted {
    pub tiles: Range<usize>,
    pub factors: Factors,
    pub sums: ValidationSums,
    /// Square of the noise of the supercluster's rows, mean over deciding lights.
    pub noise: f64,
    /// Squared error of the light, noise excluded, and its allowed maximum.
    pub lost: f64,
    pub allowed: f64,
    /// Number of fits.
    pub rounds: usize,
    /// Indirect radiance, uncompressed: for each view sample that of all emitters.
    pub emission: Vec<Vec3>,
}

impl Fitted {
    fn meets_target(&self) -> bool {
        self.lost <= self.allowed
    }

    /// Squared error of the light beyond the allowed one.
    fn excess(&self) -> f64 {
        (self.lost - self.allowed).max(0.0)
    }
}

impl<'a> Compressor<'a> {
    /// Makes training lights.
    pub fn new(operator: Operator<'a>, settings: &CompressionSettings) -> Self {
        let transport = operator.transport;
        let direct = |light: &PackedLight| direct::shade(transport.scene(), &transport.fine, light);
        let clusters = Clusters::new(transport.framebuffer());
        let inputs = training_inputs(operator, &direct, &clusters.samples, settings);
        let emitted = match operator.from_sky {
            Some(_) => Emitted::default(),
            None => transport.emitted(transport.framebuffer(), settings.lobe),
        };
        Self { operator, settings: settings.clone(), clusters, inputs, emitted, costs: OnceLock::new() }
    }

    /// As an earlier compressor of the same operator with the same settings.
    pub fn restore(operator: Operator<'a>, stored: Stored, settings: &CompressionSettings) -> Self {
        let framebuffer = operator.transport.framebuffer();
        Self {
            operator,
            settings: settings.clone(),
            clusters: Clusters::new(framebuffer),
            inputs: stored.inputs.restore(operator),
            emitted: operator.transport.restore_emitted(framebuffer, settings.lobe, stored.emitted),
            costs: OnceLock::from(stored.costs),
        }
    }

    /// What takes long to compute, for [`Compressor::restore`].
    pub fn stored(&self) -> Stored<'_> {
        Stored {
            inputs: StoredInputs::of(&self.inputs),
            emitted: self.emitted.stored(self.operator.transport),
            costs: self.costs().to_vec(),
        }
    }

    /// What all view samples come from.
    pub fn transport(&self) -> &LightTransport<'a> {
        self.operator.transport
    }

    /// See [`LightTransport::residual`].
    pub fn residual(&self) -> Option<f64> {
        self.inputs.residual
    }

    /// The superclusters of one part of the bake, for [`Compressor::compress`]. Arguments as there.
    pub fn fit_part(&self, part: Part, journal: &mut Journal, progress: &dyn Fn(usize)) -> Result<Vec<Fitted>> {
        self.fit_all(&self.superclusters_of(part), 0, journal, progress)
    }

    /// Number of view samples in a part.
    pub fn rows_of(&self, part: Part) -> usize {
        self.superclusters_of(part).iter().map(|tiles| self.clusters.rows(tiles).len()).sum()
    }

    fn superclusters_of(&self, part: Part) -> Vec<Range<usize>> {
        let all: Vec<_> = self.clusters.superclusters().collect();
        part.of(self.costs()).into_iter().map(|item| all[item].clone()).collect()
    }

    /// About what the fit of each supercluster takes, in any unit: what its rows have in entries, and a constant.
    fn costs(&self) -> &[f64] {
        let cost = |tiles: Range<usize>| {
            let samples = &self.clusters.samples[self.clusters.rows(&tiles)];
            let count = COST_ROWS.min(samples.len());
            let some: Vec<u32> = (0..count).map(|i| samples[i * samples.len() / count]).collect();
            let entries = self.operator.row_gatherer(self.settings.lobe).gather(&some).columns.len();
            samples.len() as f64 * (ENTRIES_A_ROW + entries as f64 / count as f64)
        };
        let superclusters: Vec<_> = self.clusters.superclusters().collect();
        self.costs.get_or_init(|| superclusters.into_par_iter().map(cost).collect())
    }

    /// Whether these are the fits of all superclusters, in order.
    fn is_complete(&self, fitted: &[Fitted]) -> bool {
        let all = self.clusters.superclusters();
        fitted.len() == all.count()
            && self.clusters.superclusters().zip(fitted).all(|(tiles, fitted)| self.is_of(fitted, &tiles))
    }

    /// Compresses all view samples that reflect light; `progress` counts them. `made` are the fits of all
    /// superclusters, in order, or `None`. Fits found in `journal` are reused. Fails if `made` is something else, and
    /// once there are more factors than offsets can address.
    pub fn compress(
        &self,
        made: Option<Vec<Fitted>>,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Compressed> {
        check_addressable(packed_bytes(made.iter().flatten()))?;
        let mut fit_all = |ranges: &[Range<usize>], others| self.fit_all(ranges, others, journal, progress);
        let mut fitted = match made {
            Some(made) if self.is_complete(&made) => made,
            Some(_) => {
                return Err(Error::invalid(
                    "parts of a bake",
                    "superclusters are missing, or a part belongs to another bake",
                ));
            }
            None => fit_all(&self.clusters.superclusters().collect::<Vec<_>>(), 0)?,
        };
        loop {
            let halves = take_halves(&mut fitted);
            if halves.is_empty() {
                break;
            }
            let others = packed_bytes(&fitted);
            fitted.extend(fit_all(&halves, others)?);
        }
        fitted.sort_by_key(|f| f.tiles.start);
        let view_samples = self.operator.transport.framebuffer().samples.len();
        let mut chain = Chain::new(self.operator.coefficient_count(), view_samples);
        let mut emission = self.emitted.images(view_samples);
        let mut errors = Errors::new(&self.clusters);
        for fitted in fitted {
            errors.add(&fitted);
            let samples = &self.clusters.samples[self.clusters.rows(&fitted.tiles)];
            if !fitted.meets_target() {
                progress(samples.len());
            }
            emitted::place(&mut emission, samples, &fitted.emission);
            chain.push(&fitted.factors, &self.within(&fitted.tiles), samples);
        }
        Ok(Compressed { chain: chain.finish(), emission, report: errors.report() })
    }

    /// Fits ranges of tiles; `bytes` are those of all other factors. `progress` counts the view samples of fits that
    /// are accurate enough.
    fn fit_all(
        &self,
        ranges: &[Range<usize>],
        mut bytes: u64,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Vec<Fitted>> {
        let count =
            |fitted: &Fitted| progress(if fitted.meets_target() { self.clusters.rows(&fitted.tiles).len() } else { 0 });
        let mut all = Vec::new();
        while let Some(fitted) = ranges.get(all.len()).and_then(|tiles| journal.replay(|f| self.is_of(f, tiles))) {
            bytes += fitted.factors.packed_bytes();
            count(&fitted);
            all.push(fitted);
        }
        for some in ranges[all.len()..].chunks(rayon::current_num_threads()) {
            let fitted: Vec<Fitted> = some.par_iter().map(|tiles| self.fit(tiles)).collect();
            for fitted in fitted {
                bytes += fitted.factors.packed_bytes();
                check_addressable(bytes)?;
                journal.add(&fitted);
                count(&fitted);
                all.push(fitted);
            }
        }
        Ok(all)
    }

    /// Whether a fit read from a file has the shape of these tiles' factors.
    fn is_of(&self, fitted: &Fitted, tiles: &Range<usize>) -> bool {
        let Fitted { factors, sums, emission, .. } = fitted;
        let rows = self.within(tiles);
        let samples: usize = rows.iter().map(|rows| rows.len()).sum();
        fitted.tiles == *tiles
            && factors.tiles.len() == rows.len()
            && factors
                .tiles
                .iter()
                .zip(&rows)
                .all(|(tile, rows)| [tile.b.len(), tile.u.len()] == [tile.rank * factors.rank, tile.rank * rows.len()])
            && factors.per_channel_count <= factors.list.len()
            && factors.v.len() == factors.rank * (2 * factors.per_channel_count + factors.list.len())
            && factors.tints.len() == factors.list.len()
            && factors.list.iter().all(|&term| (term as usize) < self.operator.coefficient_count())
            && sums.len() == rows.len()
            && sums.iter().all(|lights| lights.len() == SPOTS.end)
            && emission.len() == samples * self.emitted.count()
    }

    /// Gathers the rows of a supercluster once and fits it to the allowed error, not much more accurately.
    fn fit(&self, tiles: &Range<usize>) -> Fitted {
        let rows = self.clusters.rows(tiles);
        let (projected, emission) = self.project(&self.clusters.samples[rows]);
        let allowed = (1.0 - OUT_OF_BASIS_SHARE) * projected.allowed;
        let within = self.within(tiles);
        let mut scale = INITIAL_BUDGET_SCALE;
        let mut best: Option<(f64, Factors, ValidationSums)> = None;
        let mut rounds = 0;
        for round in 1..=ROUNDS {
            let [rank, terms, tiles] = SHARES.map(|share| share * scale * allowed);
            let factors = projected.fit(&within, &Budget { rank, terms, tiles });
            let (sums, (light, noise)) = projected.check(&factors, &within);
            let error = light - NOISE_CREDIT * noise;
            let enough = error <= allowed;
            // A fit that is not accurate enough must reduce the error enough for its size.
            let better = best
                .as_ref()
                .is_none_or(|(before, ..)| error < if *before > allowed { MAX_ERROR_RATIO * before } else { 0.0 });
            if !enough && !better {
                break;
            }
            best = Some((error, factors, sums));
            rounds = round;
            if enough && error >= 0.5 * allowed {
                break;
            }
            scale *= (0.9 * allowed / error.max(0.01 * allowed)).clamp(0.2, 3.0);
        }
        let (error, factors, sums) = best.expect("there is a round");
        // Light outside the basis is lost too. It was discarded with the noise, and part of it was credited as noise.
        let lost = (error + (1.0 + NOISE_CREDIT) * projected.outside).max(0.0);
        let (allowed, noise) = (projected.allowed, projected.estimate.noise);
        Fitted { tiles: tiles.clone(), factors, sums, noise, lost, allowed, rounds, emission }
    }

    /// Products of a supercluster's rows with lights and with emitters.
    fn project(&self, samples: &[u32]) -> (Projected<'_>, Vec<Vec3>) {
        let pixels: Vec<usize> = (0..RESAMPLED_ROWS.min(samples.len()))
            .map(|i| (2 * i + 1) * samples.len() / (2 * RESAMPLED_ROWS.min(samples.len())))
            .collect();
        let again: Vec<u32> = pixels.iter().map(|&p| samples[p]).collect();
        let mut gatherer = self.operator.row_gatherer(self.settings.lobe);
        let (mut seen, mut emission) = (RowProducts::new(&self.inputs), Vec::new());
        let mut buffers = RowBuffers::default();
        for some in samples.chunks(ROWS_AT_ONCE) {
            gatherer.gather_to(some, &mut buffers);
            seen.push(&self.inputs, &buffers.rows);
            emission.extend(self.emitted.radiance(&buffers.rows, some));
        }
        gatherer.seed ^= 1 << 33;
        drop(buffers);
        let resampled = Resampled { rows: &gatherer.gather(&again), pixels: &pixels };
        let share = samples.len() as f64 / self.clusters.samples.len() as f64;
        let allowed = |energy: f64, noise: f64| {
            // Half of the error is distributed by brightness, half uniformly.
            let (noise, all) = (noise.sqrt(), (0.5 * (share + energy)).sqrt());
            (noise + LOST_LIGHT_SHARE * self.settings.error * all).powi(2) - noise.powi(2)
        };
        (Projected::new(&self.inputs, seen, &resampled, allowed), emission)
    }

    /// Rows of each tile, relative to the first row of the range.
    fn within(&self, tiles: &Range<usize>) -> Vec<Range<usize>> {
        let first = self.clusters.rows(tiles).start;
        let of = |tile: usize| self.clusters.rows(&(tile..tile + 1));
        tiles.clone().map(of).map(|rows| rows.start - first..rows.end - first).collect()
    }
}

/// Removes the fits with the largest excess error if the total excess is above [`OUT_OF_BASIS_SHARE`] of the total
/// allowed error. Returns their halves, each of which gets its own basis.
fn take_halves(fitted: &mut Vec<Fitted>) -> Vec<Range<usize>> {
    let too_much: f64 = fitted.iter().map(Fitted::excess).sum();
    if too_much <= OUT_OF_BASIS_SHARE * fitted.iter().map(|f| f.allowed).sum::<f64>() {
        return Vec::new();
    }
    fitted.sort_by(|f, g| g.excess().total_cmp(&f.excess()));
    let halved = fitted.extract_if(.., |f| !f.meets_target() && f.tiles.len() > 1).take(MAX_HALVED);
    let halves = |Fitted { tiles: Range { start, end }, .. }| {
        let middle = usize::midpoint(start, end);
        [start..middle, middle..end]
    };
    halved.flat_map(halves).collect()
}

/// Share of the target error by which lost light may increase the norm of the rows' noise. The total stays below the
/// target, as part of the noise is discarded too.
pub(super) const LOST_LIGHT_SHARE: f64 = 0.5;
/// Lost light that is accepted per unit of discarded noise. At 1 the operator would be as far from the exact transfer
/// as its rows, but its error would be the same in all pictures.
const NOISE_CREDIT: f64 = 0.5;
/// Relative error of each row of the first bounce, as a multiple of the target error: hundreds of rows add up to each
/// pixel, and their errors are independent.
const BOUNCE_ERROR_RATIO: f64 = 0.5;
/// Rows of a supercluster that are gathered before they are sorted by column: each has thousands of entries.
const ROWS_AT_ONCE: usize = 512;
/// Rows of each supercluster that are gathered twice, to separate light from noise.
const RESAMPLED_ROWS: usize = 128;
/// View samples from which the brightness of a light's image is estimated.
const PROBES: usize = 512;
/// Rows of each supercluster that tell what its fit takes, and how many entries cost as much as all that does not
/// depend on their number (docs/farm.md, "Equal parts").
const COST_ROWS: usize = 32;
const ENTRIES_A_ROW: f64 = 3000.0;
/// Random combinations of lights, in each channel, whose images span those of all lights.
const COMBINATIONS: usize = 3 * WIDTH;
/// Shares of the allowed error for omitted directions of a supercluster, omitted terms of light, and omitted directions
/// of tiles.
const SHARES: [f64; 3] = [0.4, 0.3, 0.3];
/// Validation lights: points that decide whether a fit is accurate enough, and points and spots that are used only to
/// report errors.
pub(super) const DECIDING: Range<usize> = 0..24;
const POINTS: Range<usize> = 24..44;
pub(super) const SPOTS: Range<usize> = 44..64;
/// Superclusters that are split in half per iteration.
const MAX_HALVED: usize = 4;
/// Initial sum of the steps' budgets as a multiple of the allowed error: the steps mostly lose less than their budgets.
const INITIAL_BUDGET_SCALE: f64 = 1.3;
/// Share of the allowed error reserved for light outside a basis, which no fit can reduce. Compensating for it by a
/// closer fit took a third more multiply-adds at the same error.
const OUT_OF_BASIS_SHARE: f64 = 0.1;
/// Maximum ratio of errors after and before a fit that is worth its size.
const MAX_ERROR_RATIO: f64 = 0.9;
/// Maximum number of fits of a supercluster.
const ROUNDS: usize = 5;

/// Generates training and validation lights; their brightness is measured at view samples `samples`.
pub(super) fn training_inputs<'a>(
    operator: Operator<'a>,
    direct: &Direct,
    samples: &[u32],
    settings: &CompressionSettings,
) -> Inputs {
    let bounces = Bounces::new(operator);
    let residual = operator.from_sky.is_none().then(|| bounces.residual(operator.transport)).flatten();
    let haar = operator.haar();
    let seed = |purpose: u64| settings.seed ^ (16 + purpose) << 32;
    let probes = random_subset(samples, PROBES, seed(0));
    let rows = operator.row_gatherer(settings.lobe).gather(&probes);
    let share = probes.len() as f64 / samples.len().max(1) as f64;
    let trainer = Trainer { operator, bounces: &bounces, direct, probes: &rows, share };
    let group = |kind, count, purpose| Group { kind, count, seed: seed(purpose) };
    let groups = |count: usize, purpose| {
        let spots = count / 4;
        [group(Kind::Point, count - spots, purpose), group(Kind::Spot, spots, purpose + 1)]
    };
    // Regression uses only the first lights, so these are a full set of points and spots.
    let first = settings.lights.min(RIDGE_LIGHTS);
    let mut training = trainer.lights(&[groups(first, 1), groups(settings.lights - first, 7)].concat());
    let validation = trainer.lights(&[
        group(Kind::Point, DECIDING.len(), 3),
        group(Kind::Point, POINTS.len(), 4),
        group(Kind::Spot, SPOTS.len(), 5),
    ]);
    training.scale(&vec![(settings.lights.max(1) as f32).sqrt().recip(); settings.lights]);
    let seen = |lights: &Bounced| bounces.seen(&lights.direct, &lights.further);
    let (combinations, validation_operands) = (seen(&training.combine(COMBINATIONS, seed(6))), seen(&validation));
    let (mut training_terms, mut validation_terms) = (training.direct, validation.direct);
    training_terms.for_each_mut(|_, panel| haar.transform(panel));
    validation_terms.for_each_mut(|_, panel| haar.transform(panel));
    let power = [0, 1, 2].map(|channel| training_terms.row_squares(channel));
    let training_terms = Compact::new(training_terms);
    let bounces = bounces.thinned(&haar, &power, (BOUNCE_ERROR_RATIO * settings.error).powi(2));
    Inputs {
        bounces,
        residual,
        haar,
        combinations,
        validation_operands,
        training_terms,
        power,
        validation_terms,
        deciding: DECIDING,
    }
}

/// Bytes of the factors of several fits.
fn packed_bytes<'a>(fitted: impl IntoIterator<Item = &'a Fitted>) -> u64 {
    fitted.into_iter().map(|fitted| fitted.factors.packed_bytes()).sum()
}

/// `count` random elements of `samples`, or as many as `samples` has; some may occur twice.
pub(super) fn random_subset(samples: &[u32], count: usize, seed: u64) -> Vec<u32> {
    let points = Points::new(seed, 0);
    let pick = |i: usize| samples[(points.at(i as u32, 0)[0] * samples.len() as f64) as usize];
    (0..count.min(samples.len())).map(pick).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fitted(tiles: Range<usize>, lost: f64) -> Fitted {
        let (sums, emission) = (Vec::new(), Vec::new());
        Fitted { tiles, factors: Factors::default(), sums, noise: 0.0, lost, allowed: 1.0, rounds: 1, emission }
    }

    #[test]
    fn those_that_lose_most_are_halved_while_they_lose_too_much() {
        let mut all = vec![fitted(0..4, 1.1), fitted(4..8, 0.1), fitted(8..12, 1.1)];
        assert!(take_halves(&mut all).is_empty(), "0.2 of 3");
        assert_eq!(all.len(), 3);
        all[0].lost = 1.4;
        assert_eq!(take_halves(&mut all), [0..2, 2..4, 8..10, 10..12], "0.5 of 3");

        let lost = [1.5, 9.0, 0.5, 2.0, 3.0, 1.1, 4.0];
        let mut all: Vec<Fitted> = lost.iter().enumerate().map(|(i, &lost)| fitted(5 * i..5 * i + 5, lost)).collect();
        all.push(fitted(35..36, 100.0));
        let halves = take_halves(&mut all);
        assert_eq!(halves, [5..7, 7..10, 30..32, 32..35, 20..22, 22..25, 15..17, 17..20], "no tile is halved");
        let mut left: Vec<usize> = all.into_iter().map(|f| f.tiles).chain(halves).flatten().collect();
        left.sort_unstable();
        assert_eq!(left, (0..36).collect::<Vec<_>>());

        let mut tile = vec![fitted(0..1, 2.0)];
        assert!(take_halves(&mut tile).is_empty());
        assert_eq!(tile.len(), 1);
    }
}
