//! Accuracy of the compressed operator for lights outside the training set.

use super::clusters::Clusters;
use super::{Fitted, OUT_OF_BASIS_SHARE, POINTS, SPOTS};

/// Errors against the rows that the operator was fitted to, root mean square over all view samples and channels.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FitReport {
    /// Relative error of the image, mean over held-out point lights and over held-out spots.
    pub point: f64,
    pub spot: f64,
    /// The largest error over these lights.
    pub worst: f64,
    /// Relative noise of the rows themselves under point lights: root mean square; for wavelets, mean. Most of `point`
    /// is discarded noise.
    pub noise: f64,
    /// Error of each tile over all held-out points, in units of the image's root mean square.
    pub tiles: Vec<f64>,
    /// Number of superclusters that were fitted more than once, and of those whose error beyond noise stays above the
    /// allowed one; 0 for wavelets.
    pub refined: usize,
    pub missed: usize,
    /// Squared error of those beyond the allowed one, as a share of the total allowed squared error.
    pub excess: f64,
}

impl FitReport {
    /// Whether the target error is exceeded by more than fits can correct.
    pub fn is_exceeded(&self) -> bool {
        self.excess > OUT_OF_BASIS_SHARE
    }

    /// From squared error and square of each validation light.
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

/// Accumulates squared errors.
pub(super) struct Errors<'a> {
    clusters: &'a Clusters,
    /// Squared error and square of each validation light.
    lights: Vec<[f64; 2]>,
    noise: f64,
    /// Allowed squared error of all superclusters, and the excess beyond it.
    allowed: f64,
    excess: f64,
    report: FitReport,
}

impl<'a> Errors<'a> {
    pub fn new(clusters: &'a Clusters) -> Self {
        let lights = vec![[0.0; 2]; SPOTS.end];
        Self { clusters, lights, noise: 0.0, allowed: 0.0, excess: 0.0, report: FitReport::default() }
    }

    pub fn add(&mut self, fitted: &Fitted) {
        for (sums, tile) in fitted.sums.iter().zip(fitted.tiles.clone()) {
            for (sum, e) in self.lights.iter_mut().zip(sums) {
                sum[0] += e[0];
                sum[1] += e[1];
            }
            let share = self.clusters.rows(&(tile..tile + 1)).len() as f64 / self.clusters.samples.len() as f64;
            self.report.tiles.push((mean(sums[POINTS].iter().map(|e| e[0])) / share).sqrt());
        }
        self.noise += fitted.noise;
        self.allowed += fitted.allowed;
        self.excess += fitted.excess();
        self.report.refined += usize::from(fitted.rounds > 1);
        self.report.missed += usize::from(!fitted.meets_target());
    }

    pub fn report(self) -> FitReport {
        let FitReport { tiles, refined, missed, .. } = self.report;
        let excess = if self.excess > 0.0 { self.excess / self.allowed } else { 0.0 };
        FitReport { tiles, refined, missed, excess, ..FitReport::new(&self.lights, self.noise.sqrt()) }
    }
}

/// Relative errors from pairs of squared error and squared image; lights without a visible image are skipped.
pub(in crate::bake) fn relative(squares: &[[f64; 2]]) -> impl Iterator<Item = f64> {
    squares.iter().filter(|[_, image]| *image > 0.0).map(|[error, image]| (error / image).sqrt())
}

/// The mean; 0 if there are no values.
pub(in crate::bake) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), x| (sum + x, count + 1));
    if count > 0 { sum / count as f64 } else { 0.0 }
}
