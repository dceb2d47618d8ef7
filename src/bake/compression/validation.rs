//! Errors of an operator, and of the rows it was fitted to, against rows resampled with more rays and other random
//! numbers.

use std::ops::Range;

use glam::DVec3;

use super::clusters::Clusters;
use super::lights::{Kind, RandomLights};
use super::training::Direct;
use crate::bake::transport::LightTransport;
use crate::bake::transport::directions::Lobe;
use crate::physics::sequence::Points;

/// Settings of a validation.
#[derive(Clone, Debug, PartialEq)]
pub struct Validation {
    /// Rays per resampled row.
    pub rays: u32,
    /// Share of all tiles that is validated, chosen at random.
    pub share: f64,
    /// Number of lights of each kind.
    pub lights: usize,
    pub lobe: Lobe,
    /// A seed that differs from the compressor's gives independent lights and rows.
    pub seed: u64,
}

/// Relative errors for lights of one kind, root mean square over all validated tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct ValidationError {
    /// Of the operator against resampled rows: mean and largest.
    pub error: f64,
    pub worst: f64,
    /// Of the original rows against resampled rows, mean: mostly the noise of the original rows.
    pub rows: f64,
    /// Of the operator against the original rows, mean.
    pub apart: f64,
}

/// Errors for point lights and for spots. `direct` computes coefficients of direct light, and `relight` an image from
/// them, one value per view sample. Memory use depends on the tile size, not on the picture. `progress` counts view
/// samples.
pub fn validate(
    transfer: &LightTransport,
    direct: &Direct,
    relight: impl Fn(&[DVec3]) -> Vec<DVec3>,
    validation: &Validation,
    progress: &dyn Fn(usize),
) -> [ValidationError; 2] {
    let clusters = Clusters::new(transfer.framebuffer());
    let tiles = validation.tiles(&clusters);
    if tiles.is_empty() || transfer.fine.samples.is_empty() {
        return Default::default();
    }
    let kinds = [Kind::Point, Kind::Spot].map(|kind| lights(transfer, direct, kind, validation));
    let bounced: Vec<Vec<DVec3>> = kinds.iter().flatten().map(|light| transfer.bounce(light).0).collect();
    let relit: Vec<Vec<DVec3>> = kinds.iter().flatten().map(|light| relight(light)).collect();
    // Squares of the image, of the operator's error, of the rows' error, and of the difference between operator and
    // rows.
    let mut sums = vec![[0.0; 4]; bounced.len()];
    for tile in tiles {
        let samples = &clusters.samples[tile];
        let mut gatherer = transfer.row_gatherer(validation.lobe);
        let rows = gatherer.gather(samples);
        (gatherer.rays, gatherer.seed) = (validation.rays, gatherer.seed ^ validation.seed.rotate_left(17) ^ 1 << 34);
        let resampled = gatherer.gather(samples);
        for ((bounced, relit), sums) in bounced.iter().zip(&relit).zip(&mut sums) {
            let (want, dense) = (resampled.multiply(bounced), rows.multiply(bounced));
            for ((want, dense), &sample) in want.into_iter().zip(dense).zip(samples) {
                let got = relit[sample as usize];
                let squares = [want, got - want, dense - want, got - dense].map(DVec3::length_squared);
                sums.iter_mut().zip(squares).for_each(|(sum, square)| *sum += square);
            }
        }
        progress(samples.len());
    }
    let mut sums = sums.into_iter();
    kinds.map(|lights| ValidationError::new(&sums.by_ref().take(lights.len()).collect::<Vec<_>>()))
}

impl Validation {
    /// View samples of the validated tiles, as ranges in the clusters' order.
    fn tiles(&self, clusters: &Clusters) -> Vec<Range<usize>> {
        let all: Vec<usize> = clusters.superclusters().flatten().collect();
        let wanted = (self.share * all.len() as f64).ceil() as usize;
        let points = Points::new(self.seed, 0);
        let number = |&tile: &usize| points.at(tile as u32, 0)[0];
        let mut picked = all;
        picked.sort_by(|a, b| number(a).total_cmp(&number(b)));
        picked.truncate(wanted);
        picked.into_iter().map(|tile| clusters.rows(&(tile..tile + 1))).collect()
    }
}

impl ValidationError {
    fn new(sums: &[[f64; 4]]) -> Self {
        // Lights without a visible image are skipped.
        let lit = || sums.iter().filter(|sums| sums[0] > 0.0);
        let errors = |which: usize| lit().map(move |sums| (sums[which] / sums[0]).sqrt());
        let mean = |which: usize| errors(which).sum::<f64>() / lit().count().max(1) as f64;
        Self { error: mean(1), worst: errors(1).fold(0.0, f64::max), rows: mean(2), apart: mean(3) }
    }
}

/// Minimum share of nonzero coefficients of a light.
const MIN_LIT_SHARE: f64 = 0.05;
/// Maximum number of candidates per requested light.
const ATTEMPTS: u32 = 50;

fn lights(transfer: &LightTransport, direct: &Direct, kind: Kind, validation: &Validation) -> Vec<Vec<DVec3>> {
    let random = RandomLights::new(transfer, validation.seed);
    let all =
        (0..validation.lights as u32 * ATTEMPTS).filter_map(|i| random.light(kind, i)).map(|light| direct(&light));
    let lit = |light: &Vec<DVec3>| {
        light.iter().filter(|x| **x != DVec3::ZERO).count() as f64 >= (MIN_LIT_SHARE * light.len() as f64).max(1.0)
    };
    all.filter(lit).take(validation.lights).collect()
}
