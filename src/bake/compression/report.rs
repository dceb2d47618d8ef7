//! How well the compressed operator does on lights that it has not learned from.

use super::clusters::Clusters;
use super::{Fitted, OUTSIDE, POINTS, SPOTS};

/// Errors against the rows that the operator was made of, root mean square over all view samples and channels.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Report {
    /// Relative error of the image, mean over held-out point lights and over held-out spots.
    pub point: f64,
    pub spot: f64,
    /// The worst of these lights.
    pub worst: f64,
    /// Relative noise of the rows themselves under point lights: root mean square, of wavelets mean. Most of `point` is noise left
    /// out.
    pub noise: f64,
    /// Of each tile, over all held-out points, in units of the image's own root mean square.
    pub tiles: Vec<f64>,
    /// Superclusters that had to be fitted again, and those whose error beyond noise stayed larger than allowed; wavelets have none.
    pub refined: usize,
    pub missed: usize,
    /// What those lose too much, squared, as a share of what all may lose.
    pub excess: f64,
}

impl Report {
    /// Whether the error that was asked for is exceeded by more than fits can mend.
    pub fn is_exceeded(&self) -> bool {
        self.excess > OUTSIDE
    }

    /// From squared error and square of each light to check with.
    pub(in crate::bake) fn new(lights: &[[f64; 2]], noise: f64) -> Self {
        let worst = relative(&lights[POINTS.start..SPOTS.end]).fold(0.0, f64::max);
        Self {
            point: mean(relative(&lights[POINTS])),
            spot: mean(relative(&lights[SPOTS])),
            worst,
            noise,
            ..Self::default()
        }
    }
}

/// Squared errors so far.
pub(super) struct Errors<'a> {
    clusters: &'a Clusters,
    /// Of each light to check with: squared error and square.
    lights: Vec<[f64; 2]>,
    noise: f64,
    /// What all superclusters may lose, squared, and what some lose beyond that.
    allowed: f64,
    excess: f64,
    report: Report,
}

impl<'a> Errors<'a> {
    pub fn new(clusters: &'a Clusters) -> Self {
        let lights = vec![[0.0; 2]; SPOTS.end];
        Self { clusters, lights, noise: 0.0, allowed: 0.0, excess: 0.0, report: Report::default() }
    }

    pub fn add(&mut self, fitted: &Fitted) {
        for (found, tile) in fitted.found.iter().zip(fitted.tiles.clone()) {
            for (sum, e) in self.lights.iter_mut().zip(found) {
                sum[0] += e[0];
                sum[1] += e[1];
            }
            let share = self.clusters.rows(&(tile..tile + 1)).len() as f64 / self.clusters.samples.len() as f64;
            self.report.tiles.push((mean(found[POINTS].iter().map(|e| e[0])) / share).sqrt());
        }
        self.noise += fitted.noise;
        self.allowed += fitted.allowed;
        self.excess += fitted.excess();
        self.report.refined += usize::from(fitted.rounds > 1);
        self.report.missed += usize::from(!fitted.is_enough());
    }

    pub fn report(self) -> Report {
        let Report { tiles, refined, missed, .. } = self.report;
        let excess = if self.excess > 0.0 { self.excess / self.allowed } else { 0.0 };
        Report { tiles, refined, missed, excess, ..Report::new(&self.lights, self.noise.sqrt()) }
    }
}

/// Relative errors from squared ones and squares; lights that nothing is seen of say nothing.
pub(in crate::bake) fn relative(squares: &[[f64; 2]]) -> impl Iterator<Item = f64> {
    squares.iter().filter(|[_, image]| *image > 0.0).map(|[error, image]| (error / image).sqrt())
}

/// 0 of nothing.
pub(in crate::bake) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), x| (sum + x, count + 1));
    if count > 0 { sum / count as f64 } else { 0.0 }
}
