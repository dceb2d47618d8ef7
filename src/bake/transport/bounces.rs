//! G: the contribution of the coefficients of gather samples to those of a level's samples in one bounce. It is
//! computed by final gathering with the projection onto the basis in place of the BRDF.
//!
//! Gathered rows conserve energy from the view of the receiver, but not of the sender: column sums are inaccurate, and
//! so is the light in a bright closed room. Therefore the geometric factors F are balanced. F is the share of a
//! sample's rays that hit each other sample directly or through mirrors. Rows and columns are scaled until each sample
//! receives the share of its rays that hit a surface and, by reciprocity, sends as much [Sinkhorn 1967]. Where the
//! numbers of rays that hit the areas of samples contradict reciprocity, column sums are corrected towards these
//! numbers.

use std::collections::BTreeMap;
use std::f32::consts::PI;
use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::level::Level;
use super::paths::{Encounter, Paths};
use super::rows::Row;
use super::sky;
use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::brdf_factors::harmonics::MAX_FUNCTIONS;
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::gather_samples::GatherSamples;
use crate::physics::brdf::cosine_direction;
use crate::physics::sequence::Points;
use crate::trace::point_tree::middle;

/// Maximum number of balancing iterations.
const ROUNDS: usize = 200;
/// Iterations stop when the relative error of all columns is below this.
const BALANCED: f64 = 1e-9;
/// Number of functions of a sending sample that are used: light is smoother after a further bounce, and the first
/// function has all energy.
const MAX_SENT: u32 = 16;
/// Relative standard deviation between a sample's area and the area of the surface nearest to it: cells and clusters
/// have different borders. In a closed box it is 0.13.
const MISFIT: f64 = 0.15;
/// Maximum scale of a row or column, and inverse of the minimum: columns hit by hardly any ray stay small.
const MAX_SCALE: f64 = 8.0;

/// One bounce from the coefficients of a level to those of the receiving level.
pub struct Bounce {
    /// One row per receiving coefficient, one column per sending coefficient.
    pub rows: CsrMatrix,
    /// Largest relative error of a column of geometric factors after balancing.
    pub imbalance: f64,
}

/// Gathers G.
pub struct BounceGatherer<'a> {
    pub paths: Paths<'a>,
    pub receivers: &'a Level,
    /// Rays per receiving sample.
    pub rays: u32,
    pub seed: u64,
}

/// Contributions of one sending level to one receiving sample.
#[derive(Default)]
struct SampleRows {
    /// Rows of G, one per coefficient of the receiver.
    rows: CsrMatrix,
    /// Row of F: the share of rays that hit each sending sample, directly or through mirrors.
    factors: Vec<(u32, f32)>,
    /// The same without interpolation: the share of rays that hit the area of each sending sample.
    hits: Vec<(u32, f32)>,
}

impl BounceGatherer<'_> {
    /// G from each of `senders` and, for each receiving sample, the share of its rays that hit no reflecting or
    /// emitting surface.
    pub fn gather(&self, senders: &[&Level], progress: &(dyn Fn(usize) + Sync)) -> (Vec<Bounce>, Vec<f64>) {
        let most = senders.iter().map(|level| level.samples.len()).max().unwrap_or(0);
        let singles: Vec<u32> = (0..=most as u32).collect();
        let per_sample: Vec<(Vec<SampleRows>, f64)> = (0..self.receivers.samples.len())
            .into_par_iter()
            .map_init(
                || Scratch::new(senders, &singles),
                |scratch, sample| {
                    let found = self.gather_sample(sample, senders, scratch);
                    progress(1);
                    found
                },
            )
            .collect();
        let met: Vec<f64> = per_sample.iter().map(|(_, met)| met / f64::from(self.rays)).collect();
        let mut by_sender: Vec<Vec<SampleRows>> = senders.iter().map(|_| Vec::new()).collect();
        for (found, _) in per_sample {
            by_sender.iter_mut().zip(found).for_each(|(list, found)| list.push(found));
        }
        let bounces = by_sender.into_iter().zip(senders).map(|(found, sender)| self.join(found, sender, &met));
        (bounces.collect(), met.iter().map(|met| (1.0 - met).max(0.0)).collect())
    }

    /// Also returns the number of rays that hit a reflecting or emitting surface; rays through mirrors are weighted by
    /// the reflectance. Unweighted rays are counted exactly: in a closed room the escaped share must be exactly 0
    /// [Grassmann 1985].
    fn gather_sample(&self, sample: usize, senders: &[&Level], scratch: &mut Scratch) -> (Vec<SampleRows>, f64) {
        let share = 1.0 / self.rays as f32;
        let mut met = 0.0;
        self.cast(sample, |k, encounter| {
            let Encounter::Surface(arrival) = encounter else { return };
            // Upper bound over the channels.
            let reach = arrival.tint.max_element();
            let mut is_black = true;
            for (level, to) in senders.iter().zip(&mut scratch.levels) {
                let cell = level.cell(&arrival.place);
                let Some(nearest) = cell.nearest() else { continue };
                is_black = false;
                to.hits.add(nearest, &[1.0], Vec3::splat(share * reach));
                level.read(&cell, arrival.wo, |sender, weight, _, values| {
                    to.factors.add(sender, &[weight], Vec3::splat(share * reach));
                    let light = arrival.tint * (weight * share * PI);
                    to.rows.iter_mut().zip(k).for_each(|(row, k)| row.add(sender, values, *k * light));
                });
            }
            if !is_black {
                met += f64::from(reach);
            }
        });
        (scratch.take(self.receivers.coefficients(sample).len()), met)
    }

    /// Rows of the sky's light that receiving samples reflect, straight or by mirrors, to their coefficients: one per
    /// receiving coefficient, with the [columns](sky) of the sky.
    pub fn gather_sky(&self) -> CsrMatrix {
        let gather = |rows: &mut Vec<Row>, sample: usize| {
            self.cast(sample, |k, encounter| {
                let Encounter::Sky(escape) = encounter else { return };
                let light = escape.tint * (PI / self.rays as f32);
                rows.iter_mut().zip(k).for_each(|(row, k)| row.add(sky::column(&escape), &[1.0], *k * light));
            });
            let mut found = CsrMatrix::empty(0);
            for row in &mut rows[..self.receivers.coefficients(sample).len()] {
                row.take(0, &mut found);
                found.first.push(found.columns.len());
            }
            found
        };
        let scratch = || (0..MAX_FUNCTIONS).map(|_| Row::of_sky()).collect();
        let all = (0..self.receivers.samples.len()).into_par_iter().map_init(scratch, gather);
        CsrMatrix::concatenated(all.collect())
    }

    /// Casts the rays of a receiving sample, with a density proportional to the cosine. `meet` gets the receiver's
    /// coefficients for unit irradiance from the direction of a ray, and what the ray meets.
    fn cast(&self, sample: usize, mut meet: impl FnMut(&[Vec3], Encounter)) {
        let samples = &self.receivers.samples;
        let gather_sample = &samples.samples[sample];
        let frames: Vec<[Vec3; 3]> = samples.points_of(sample).iter().map(|p| p.frame(gather_sample)).collect();
        let points = Points::new(self.seed, sample as u64);
        let mut k = [Vec3::ZERO; MAX_FUNCTIONS];
        let k = &mut k[..self.receivers.coefficients(sample).len()];
        for ray in 0..self.rays {
            let which = ray as usize % frames.len();
            let (point, frame) = (&samples.points_of(sample)[which], &frames[which]);
            let [u, v, ..] = points.at(ray, 0);
            let wi = cosine_direction(u, v).as_vec3().max(Vec3::new(-1.0, -1.0, 1e-6));
            let direction = (frame[0] * wi.x + frame[1] * wi.y + frame[2] * wi.z).normalize();
            HarmonicProjection::get().project(&gather_sample.brdf, wi, k);
            let random = |layer: u32| {
                let [u, v, w, _] = points.at(ray, 1 + layer);
                [u, v, w]
            };
            self.paths.follow(point.position, point.geometric_normal, direction, random, |met| meet(k, met));
        }
    }

    /// Balances the contributions of one sending level and joins them to one matrix.
    fn join(&self, found: Vec<SampleRows>, sender: &Level, met: &[f64]) -> Bounce {
        let area = |level: &Level, sample: usize| f64::from(level.samples.samples[sample].area);
        // By reciprocity a sample sends to others the share of its own rays that hit them.
        let received: Vec<f64> = met.iter().enumerate().map(|(i, met)| area(self.receivers, i) * met).collect();
        let mut sent: Vec<f64> = if std::ptr::eq(sender, self.receivers) {
            received.clone()
        } else {
            let met = interpolated(self.receivers, met, sender);
            (0..sender.samples.len()).map(|i| area(sender, i) * met[i]).collect()
        };
        // Column sums that rays found, and the sum of squares of what all rays contribute to them.
        let mut found_sums = vec![0.0; sent.len()];
        let mut squares = 0.0;
        for (i, found) in found.iter().enumerate() {
            let ray = area(self.receivers, i) / f64::from(self.rays);
            for &(j, share) in &found.hits {
                let value = f64::from(share) * area(self.receivers, i);
                found_sums[j as usize] += value;
                squares += ray * value;
            }
        }
        let all = found_sums.iter().sum::<f64>();
        scale_to(&mut sent, all);
        let ray = squares / all.max(f64::MIN_POSITIVE);
        for members in by_group(&sender.samples) {
            let found: Vec<f64> = members.iter().map(|&j| found_sums[j]).collect();
            let mut expected: Vec<f64> = members.iter().map(|&j| sent[j]).collect();
            correct(&mut expected, &found, ray);
            members.iter().zip(expected).for_each(|(&j, expected)| sent[j] = expected);
        }
        scale_to(&mut sent, received.iter().sum());
        let factors: Vec<Vec<(u32, f64)>> = found
            .par_iter()
            .enumerate()
            .map(|(i, found)| found.factors.iter().map(|&(j, f)| (j, f64::from(f) * area(self.receivers, i))).collect())
            .collect();
        let (row_scales, column_scales, imbalance) = balance(&factors, &received, &sent);

        let entries = found.iter().map(|found| found.rows.columns.len()).sum();
        let mut rows = CsrMatrix::with_capacity(entries);
        let mut scale_of_column = vec![0.0; sender.coefficient_count()];
        for (i, &scale) in column_scales.iter().enumerate() {
            scale_of_column[sender.coefficients(i)].fill(scale);
        }
        for (found, row_scale) in found.into_iter().zip(row_scales) {
            let start = rows.columns.len();
            rows.first.extend(found.rows.first[1..].iter().map(|end| start + end));
            rows.values.extend(found.rows.columns.iter().zip(&found.rows.values).map(|(&column, value)| {
                let scale = row_scale * scale_of_column[column as usize];
                value.map(|v| (f64::from(v) * scale) as f32)
            }));
            rows.columns.extend(found.rows.columns);
        }
        Bounce { rows, imbalance }
    }
}

/// Accumulators of one thread, for each sending level.
struct Scratch<'a> {
    levels: Vec<LevelScratch<'a>>,
}

/// Where [`SampleRows`] of a sending level add up.
struct LevelScratch<'a> {
    rows: Vec<Row<'a>>,
    factors: Row<'a>,
    hits: Row<'a>,
}

impl<'a> Scratch<'a> {
    /// `singles` has the values 0, 1, ...: in F each sample has one coefficient.
    fn new(senders: &[&'a Level], singles: &'a [u32]) -> Self {
        let of = |level: &&'a Level| {
            let of_samples = || Row::new(&singles[..=level.samples.len()], 1);
            LevelScratch {
                rows: (0..MAX_FUNCTIONS).map(|_| Row::new(&level.first, MAX_SENT)).collect(),
                factors: of_samples(),
                hits: of_samples(),
            }
        };
        Self { levels: senders.iter().map(of).collect() }
    }

    /// Moves out the contributions to a receiver of `count` coefficients.
    fn take(&mut self, count: usize) -> Vec<SampleRows> {
        let shares = |from: &mut Row| {
            let mut row = CsrMatrix::default();
            from.take(0, &mut row);
            row.columns.iter().copied().zip(row.values.iter().map(|v| v[0])).collect()
        };
        let take = |level: &mut LevelScratch| {
            let mut rows = CsrMatrix::empty(0);
            for row in &mut level.rows[..count] {
                row.take(0, &mut rows);
                rows.first.push(rows.columns.len());
            }
            SampleRows { rows, factors: shares(&mut level.factors), hits: shares(&mut level.hits) }
        };
        self.levels.iter_mut().map(take).collect()
    }
}

/// Shares of the receiving level's rays, interpolated at the samples of another level.
fn interpolated(receivers: &Level, shares: &[f64], level: &Level) -> Vec<f64> {
    let nearest = super::cells::Neighbours::new(&receivers.samples);
    let share = |s: &crate::bake::gather_samples::GatherSample| {
        nearest.cell(s.position, s.normal, s.material).read().map(|(i, weight)| f64::from(weight) * shares[i]).sum()
    };
    level.samples.samples.par_iter().map(share).collect()
}

/// Samples by material group, each list in tree order.
fn by_group(samples: &GatherSamples) -> Vec<Vec<usize>> {
    let mut lists = BTreeMap::<u32, Vec<usize>>::new();
    for (i, sample) in samples.samples.iter().enumerate() {
        lists.entry(samples.group(sample.material)).or_default().push(i);
    }
    lists.into_values().collect()
}

/// Scales values to a sum; zeros stay.
fn scale_to(values: &mut [f64], sum: f64) {
    let before = values.iter().sum::<f64>();
    if before > 0.0 {
        values.iter_mut().for_each(|value| *value *= sum / before);
    }
}

/// Corrects the column sums `expected`, which follow from reciprocity, with the sums `found` by rays. The samples'
/// areas are wrong where others see only part of them, as in the folds of a sofa. The sums found are noisy: each ray
/// contributes `ray`. So sums over all samples are compared, then over halves, quarters and so on. At each depth they
/// take a share of the differences. The share is larger if noise explains less of them, similar to [Efron 1973].
fn correct(expected: &mut [f64], found: &[f64], ray: f64) {
    let mut nodes: Vec<Range<usize>> = std::iter::once(0..expected.len()).collect();
    while !nodes.is_empty() {
        let (mut squares, mut variances) = (0.0, 0.0);
        for node in &nodes {
            let [sum, found_sum] = [&*expected, found].map(|sums| sums[node.clone()].iter().sum::<f64>());
            let misfit = expected[node.clone()].iter().map(|e| (MISFIT * e).powi(2)).sum::<f64>();
            let weight = if sum > 0.0 { sum.recip() } else { 0.0 };
            squares += weight * (found_sum - sum).powi(2);
            variances += weight * (ray * sum + misfit);
        }
        // Without the square, areas that are clearly wrong would keep too much weight (docs/accuracy.md, "Column
        // sums").
        let share = if squares > variances { 1.0 - (variances / squares).powi(2) } else { 0.0 };
        for node in &nodes {
            let [sum, found_sum] = [&*expected, found].map(|sums| sums[node.clone()].iter().sum::<f64>());
            scale_to(&mut expected[node.clone()], sum + share * (found_sum - sum));
        }
        let halves = |node: &Range<usize>| {
            let middle = middle(node.start, node.end);
            [node.start..middle, middle..node.end]
        };
        nodes = nodes.iter().filter(|node| node.len() > 1).flat_map(halves).collect();
    }
}

/// Scales of the rows and columns of a matrix such that their sums are `row_sums` and `column_sums`, and the remaining
/// relative error of columns; rows are exact.
fn balance(rows: &[Vec<(u32, f64)>], row_sums: &[f64], column_sums: &[f64]) -> (Vec<f64>, Vec<f64>, f64) {
    let mut by_row = vec![1.0; rows.len()];
    let mut by_column = vec![1.0; column_sums.len()];
    let limited = |scale: f64| if scale.is_finite() { scale.clamp(1.0 / MAX_SCALE, MAX_SCALE) } else { 1.0 };
    let mut imbalance = 0.0;
    for _ in 0..ROUNDS {
        let mut sums = vec![0.0; column_sums.len()];
        for (row, scale) in rows.iter().zip(&by_row) {
            row.iter().for_each(|&(j, value)| sums[j as usize] += scale * value);
        }
        imbalance = 0.0;
        for ((scale, sum), want) in by_column.iter_mut().zip(&sums).zip(column_sums) {
            if *sum > 0.0 {
                let new = limited(want / sum);
                imbalance = f64::max(imbalance, (*scale / new - 1.0).abs());
                *scale = new;
            }
        }
        by_row = rows
            .par_iter()
            .zip(row_sums)
            .map(|(row, want)| want / row.iter().map(|&(j, value)| by_column[j as usize] * value).sum::<f64>())
            .map(|scale| if scale.is_finite() { scale } else { 1.0 })
            .collect();
        if imbalance < BALANCED {
            break;
        }
    }
    (by_row, by_column, imbalance)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of the samples are seen a fifth less than their areas predict, all with noise of a tenth.
    #[test]
    fn differences_beyond_noise_correct_column_sums() {
        let seen = |i: usize| if i < 128 { 0.8 } else { 1.0 };
        let found: Vec<f64> = (0..256).map(|i| seen(i) + if i % 2 == 0 { 0.1 } else { -0.1 }).collect();
        let mut expected = vec![1.0; 256];
        correct(&mut expected, &found, 0.01);
        for (i, expected) in expected.iter().enumerate() {
            assert!((expected - seen(i)).abs() < 1e-3, "{i}: {expected}");
        }
        let few_rays = 10.0;
        let mut expected = vec![1.0; 256];
        correct(&mut expected, &found, few_rays);
        assert_eq!(expected, vec![1.0; 256]);
    }

    #[test]
    fn column_sums_stay_finite() {
        let corrected = |expected: &[f64], found: &[f64]| {
            let mut sums = expected.to_vec();
            correct(&mut sums, found, 1e-3);
            sums
        };
        assert!(corrected(&[1.0; 5], &[0.0; 5]).iter().all(|sum| (0.0..1e-3).contains(sum)));
        assert_eq!(corrected(&[0.0; 5], &[1.0; 5]), [0.0; 5]);
        assert!((corrected(&[1.0], &[3.0])[0] - 3.0).abs() < 1e-3);
        assert_eq!(corrected(&[], &[]), [0.0; 0]);
    }
}
