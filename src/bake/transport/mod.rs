//! Indirect light as a linear map of direct light at gather samples [Yang 2007, Chapter 4; Hasan 2006].
//!
//! λ0 are the coefficients of gather samples under direct light. G is one bounce among gather samples, and Φ maps their
//! coefficients to view samples:
//!
//! ```text
//! indirect = Φ (I + G + G² + ...) λ0 = Φ_f λ0 + Φ_c S λ0,    S = (I - G_cc)⁻¹ G_cf
//! ```
//!
//! Direct light is represented at a fine level of samples (f), further bounces at a coarse one (c). With a single level
//! both are the same samples, and the map is Φ (I - G)⁻¹ λ0. Rows of G and Φ are final gathers: there is no division by
//! a squared distance, and no row sum exceeds the albedo. Samples are placed where the picture [needs
//! them](importance).

pub mod bounces;
mod bright_spots;
mod caustics;
pub mod cells;
pub mod direct;
pub mod directions;
pub mod emitted;
pub mod fan;
pub mod importance;
pub mod level;
pub mod paths;
pub mod rows;
pub mod sky;
pub mod solve;
mod stored;

use std::sync::{Arc, OnceLock};

pub use self::stored::Stored;

use faer::Mat;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::bounces::{Bounce, BounceGatherer};
use self::directions::Lobe;
use self::emitted::{Emitted, StoredEmitted};
use self::importance::Importance;
use self::level::Level;
use self::paths::Paths;
use self::rows::RowGatherer;
use self::solve::Resolvent;
use super::DeepFramebuffer;
use super::brdf_factors::harmonics::MAX_FUNCTIONS;
use super::brdf_factors::{ALBEDO_CAP, HarmonicProjection};
use super::csr_matrix::CsrMatrix;
use super::gather_samples::{GatherSample, GatherSamples, Placement};
use crate::shared::Brdf;
use crate::trace::bvh::TracedScene;

/// Directional distribution of the light that leaves gather samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Outgoing {
    /// Equally in all directions, with the BRDF's hemispherical albedo [Yang 2007, Section 4.2].
    Diffuse,
    /// In harmonics: as many as a material needs, or a fixed square number up to 49 [Yang 2007, Section 4.3].
    Glossy { functions: Option<u8> },
}

/// Settings of the transfer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TransferSettings {
    pub outgoing: Outgoing,
    /// Number of gather samples.
    pub samples: usize,
    /// Number of eye paths, which determine where samples are placed: see [`TransferSettings::paths_for`].
    pub paths: usize,
    /// Number of gather samples for further bounces; if not smaller than `samples`, there is only one level.
    pub coarse_samples: usize,
    /// Points per sample at which direct light is evaluated, 1 to 16.
    pub points: usize,
    /// Rays per row of Φ and of G.
    pub rays: u32,
    /// Maximum number of mirrors along a ray.
    pub layers: u32,
    /// Number of indirect bounces, counted at the pixel; `None`: all.
    pub bounces: Option<u32>,
    /// Parts of a bake derive their seeds from it, as `seed ^ n << 32` with small numbers n.
    pub seed: u64,
}

impl TransferSettings {
    /// Eye paths that place a number of gather samples well.
    pub fn paths_for(samples: usize) -> usize {
        (PATHS_A_SAMPLE * samples).max(MIN_PATHS)
    }
}

/// Figures that tell how reliable the solution is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Largest absolute eigenvalue of G, by power iteration; after scaling.
    pub spectral_radius: f64,
    /// Largest relative error of a column of geometric factors after balancing.
    pub imbalance: f64,
    /// Share of all reflected light, under uniform illumination, that is removed so that no bounce reflects more than
    /// [`ALBEDO_CAP`].
    pub capped: f64,
    /// Mean share of a sample's rays that hit no reflecting or emitting surface.
    pub escaped: f64,
    /// Share of all surface area that no pixel sees, even after bounces: it has no samples.
    pub unseen: f64,
}

/// The transfer of one scene and camera.
pub struct LightTransport<'a> {
    scene: &'a TracedScene,
    framebuffer: &'a DeepFramebuffer,
    settings: TransferSettings,
    pub fine: Level,
    /// `None` with a single level.
    pub coarse: Option<Level>,
    /// G_cc; with a single level, G.
    pub bounce_matrix: CsrMatrix,
    /// G_cf; `None` with a single level.
    pub from_fine: Option<CsrMatrix>,
    pub certificate: Certificate,
    /// Those of all bounces, made when they are first needed.
    resolvents: OnceLock<Arc<[Mat<f32>; 3]>>,
}

/// Maximum relative residual of the solution in each channel.
const TOLERANCE: f64 = 1e-7;

impl<'a> LightTransport<'a> {
    /// Places gather samples and gathers G; `progress` counts samples of the coarse level, or of the only one.
    pub fn new(
        scene: &'a TracedScene,
        framebuffer: &'a DeepFramebuffer,
        settings: &TransferSettings,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Self {
        let TransferSettings { layers, paths, seed, .. } = *settings;
        let importance = Importance::new(scene, framebuffer, layers, paths, seed ^ 4 << 32);
        let level = |count: usize, points: usize, seed: u64, choices: &[u8], limit: usize| {
            let placement = Placement::Clustered { points };
            let mut samples = GatherSamples::place(scene, &importance.surfaces, placement, count, seed);
            if settings.outgoing == Outgoing::Diffuse {
                for sample in &mut samples.samples {
                    sample.brdf = lambert(&sample.brdf);
                    sample.direct_brdf = lambert(&sample.direct_brdf);
                }
            }
            let dropped = |s: &GatherSample| DROPPED / importance.shares[s.material as usize];
            let wanted = |s: &GatherSample| functions(&settings.outgoing, &s.brdf, dropped(s));
            let mut functions: Vec<u8> = samples.samples.par_iter().map(wanted).collect();
            let fits = |&most: &u8| functions.iter().map(|&f| usize::from(f.min(most))).sum::<usize>() <= limit;
            let most = choices.iter().copied().find(fits).unwrap_or(1);
            functions.iter_mut().for_each(|f| *f = most.min(*f));
            let most = functions.iter().copied().max().unwrap_or(1);
            if let Outgoing::Glossy { functions: Some(asked) } = settings.outgoing
                && most < asked
            {
                tracing::warn!("{asked} harmonics for each of {count} gather samples are too many, {most} are used");
            }
            Level::new(scene, samples, &functions)
        };
        let limit = max_coefficients(settings.samples, MAX_FUNCTIONS);
        let fine = level(settings.samples, settings.points, settings.seed, &FINE_FUNCTIONS, limit);
        let coarse = (settings.coarse_samples < settings.samples).then(|| {
            let (count, seed) = (settings.coarse_samples.max(1), settings.seed ^ 1 << 32);
            level(count, RAY_POINTS, seed, &COARSE_FUNCTIONS, MAX_COARSE_COEFFICIENTS)
        });
        let receivers = coarse.as_ref().unwrap_or(&fine);
        let gatherer = bounce_gatherer(scene, settings, receivers);
        let (bounces, escaped) = match &coarse {
            Some(coarse) => gatherer.gather(&[coarse, &fine], progress),
            None => gatherer.gather(&[&fine], progress),
        };
        let imbalance = bounces.iter().map(|b| b.imbalance).fold(0.0, f64::max);
        let mut bounces = bounces.into_iter().map(|Bounce { rows, .. }| rows);
        let mut bounce_matrix = bounces.next().expect("one a sender");
        let found = solve::spectral_radius(&bounce_matrix);
        // Rows of few rays through mirrors can have a spectral radius above 1.
        let kept = (f64::from(ALBEDO_CAP) / found).min(1.0);
        if kept < 1.0 {
            bounce_matrix.scale(kept);
        }
        let certificate = Certificate {
            spectral_radius: kept * found,
            imbalance,
            capped: 1.0 - kept * (1.0 - capped(&receivers.samples)),
            escaped: escaped.iter().sum::<f64>() / escaped.len().max(1) as f64,
            unseen: importance.unseen,
        };
        let from_fine = bounces.next();
        let mut settings = settings.clone();
        settings.bounces = settings.bounces.map(|n| n.min(solve::bounces_that_matter(certificate.spectral_radius)));
        let resolvents = OnceLock::new();
        Self { scene, framebuffer, settings, fine, coarse, bounce_matrix, from_fine, certificate, resolvents }
    }

    /// Number of columns of [`Self::rows`]: coefficients of the fine level, then of the coarse one.
    pub fn column_count(&self) -> usize {
        self.fine.coefficient_count() + self.coarse.as_ref().map_or(0, Level::coefficient_count)
    }

    /// Number of indirect bounces, counted at the pixel; `None`: all. Omits bounces that have no effect.
    pub fn bounces(&self) -> Option<u32> {
        self.settings.bounces
    }

    /// Rows of Φ for view samples, given by index into [`DeepFramebuffer::samples`]. One row per view sample,
    /// [`Self::column_count`] columns, RGB entries in 1/√sr, for coefficients in radiance times √sr. Gathered in every
    /// call; deterministic.
    pub fn rows(&self, view_samples: &[u32], lobe: Lobe) -> CsrMatrix {
        self.row_gatherer(lobe).gather(view_samples)
    }

    pub fn scene(&self) -> &'a TracedScene {
        self.scene
    }

    /// The view samples of the rows.
    pub fn framebuffer(&self) -> &'a DeepFramebuffer {
        self.framebuffer
    }

    /// The gatherer for [`Self::rows`]. With another seed the rows differ by their noise.
    pub fn row_gatherer(&self, lobe: Lobe) -> RowGatherer<'_> {
        RowGatherer {
            paths: Paths::new(self.scene, self.settings.layers),
            framebuffer: self.framebuffer,
            sky: false,
            levels: [Some(&self.fine), self.coarse.as_ref()].into_iter().flatten().collect(),
            rays: self.settings.rays,
            lobe,
            seed: self.settings.seed ^ 3 << 32,
        }
    }

    /// The gatherer of rows for light of the [sky], which have its columns first, then those of the coarse level or of
    /// the only one.
    pub fn sky_row_gatherer(&self, lobe: Lobe) -> RowGatherer<'_> {
        let rays = self.settings.rays.div_ceil(SKY_RAYS_DIVISOR);
        RowGatherer { sky: true, levels: vec![self.bouncing()], rays, ..self.row_gatherer(lobe) }
    }

    /// G_cs: what gather samples reflect of the light of the [sky]. `None` if hardly any of their rays leaves the
    /// scene.
    pub fn from_sky(&self) -> Option<CsrMatrix> {
        let gatherer = bounce_gatherer(self.scene, &self.settings, self.bouncing());
        let rows = gatherer.gather_sky();
        let rays = self.settings.rays as usize * rows.len();
        // Without samples, nobody knows.
        (rays == 0 || rows.columns.len() as f64 > CLOSED * rays as f64).then_some(rows)
    }

    /// The level among whose samples light bounces on.
    fn bouncing(&self) -> &Level {
        self.coarse.as_ref().unwrap_or(&self.fine)
    }

    /// The operand of Φ for direct light at the fine level: λ0 and, with two levels, S λ0; with one, the sum of all
    /// bounces. Also returns the residual of the solution, 0 for a fixed number of bounces.
    pub fn bounce(&self, direct: &[DVec3]) -> (Vec<DVec3>, f64) {
        self.bounce_times(direct, self.settings.bounces)
    }

    /// Adds light that samples of the level among which light bounces on reflect, and its `bounces` there, to an
    /// operand of Φ.
    fn add_reflected(&self, operand: &mut [DVec3], reflected: &[DVec3], bounces: Option<u32>) {
        let sum = match bounces {
            Some(bounces) => solve::sum_of_powers(&self.bounce_matrix, reflected, bounces),
            None => solve::solve(&self.bounce_matrix, reflected, TOLERANCE).coefficients,
        };
        let first = operand.len() - sum.len();
        operand[first..].iter_mut().zip(sum).for_each(|(operand, sum)| *operand += sum);
    }

    /// [`Self::bounce`] with another number of bounces.
    fn bounce_times(&self, direct: &[DVec3], bounces: Option<u32>) -> (Vec<DVec3>, f64) {
        let first = self.from_fine.as_ref().map_or_else(|| direct.to_vec(), |g| g.multiply(direct));
        // With one level the first term is λ0 itself; with two it is G_cf λ0, which reaches the pixel after a second
        // bounce.
        let terms = |bounces: u32| if self.coarse.is_some() { bounces.saturating_sub(1) } else { bounces };
        let (bounced, residual) = match bounces.map(terms) {
            Some(terms) => (solve::sum_of_powers(&self.bounce_matrix, &first, terms), 0.0),
            None => {
                let solution = solve::solve(&self.bounce_matrix, &first, TOLERANCE);
                (solution.coefficients, solution.residual)
            }
        };
        let mut all = if self.coarse.is_some() { direct.to_vec() } else { Vec::new() };
        if bounces == Some(0) {
            all.fill(DVec3::ZERO);
        }
        all.extend(bounced);
        (all, residual)
    }

    /// S, or with one level G (I - G)⁻¹, as one dense matrix per channel: all further bounces of direct light, or the
    /// fixed number. Only for few samples: takes three matrices of coarse x fine coefficients in double precision.
    pub fn further_bounces(&self) -> [Mat<f64>; 3] {
        let right = self.from_fine.as_ref().unwrap_or(&self.bounce_matrix);
        let terms = self.settings.bounces.unwrap_or(0).saturating_sub(1);
        let resolvents = Resolvent::new(&self.bounce_matrix, self.settings.bounces.is_none());
        let of_channel = |channel: usize| {
            resolvents[channel].times(right.to_dense(self.fine.coefficient_count(), channel).as_ref(), terms)
        };
        let channels: Vec<_> = (0..3).into_par_iter().map(of_channel).collect();
        channels.try_into().expect("there are three")
    }

    /// Of each channel the matrix that maps light at the level among whose samples light bounces on to all bounces
    /// there; where their number is limited, to `terms` of them.
    pub fn resolvents(&self, terms: u32) -> Arc<[Mat<f32>; 3]> {
        let all = self.settings.bounces.is_none();
        let make = || {
            let matrix = |resolvent: Resolvent| resolvent.matrix(self.bounce_matrix.len(), terms);
            Arc::new(Resolvent::new(&self.bounce_matrix, all).map(matrix))
        };
        if all { self.resolvents.get_or_init(make).clone() } else { make() }
    }

    /// Relative residual of `further`, a solution for all further bounces of [uniform light](Self::even_light): |b - (I
    /// - G) x| / |b|, maximum over the channels. `None` for a fixed number of bounces.
    pub fn residual(&self, further: &[DVec3]) -> Option<f64> {
        let even = self.even_light();
        let b = self.from_fine.as_ref().unwrap_or(&self.bounce_matrix).multiply(&even);
        self.settings.bounces.is_none().then(|| solve::relative_residual(&self.bounce_matrix, &b, further))
    }

    /// λ0 with which all samples emit uniform radiance 1.
    pub fn even_light(&self) -> Vec<DVec3> {
        self.radiating(|_| DVec3::ONE)
    }

    /// Indirect radiance of view samples under several lights, given their direct light at the fine level. Φ is
    /// gathered once, a few rows at a time, without storing it. `progress` counts view samples.
    pub fn apply(
        &self,
        direct: &[Vec<DVec3>],
        view_samples: &[u32],
        lobe: Lobe,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Vec<Vec<DVec3>> {
        let coefficients: Vec<Vec<DVec3>> = direct.iter().map(|light| self.bounce(light).0).collect();
        let pieces = self.row_gatherer(lobe).map(view_samples, |rows| {
            let piece: Vec<_> = coefficients.iter().map(|coefficients| rows.multiply_here(coefficients)).collect();
            progress(rows.len());
            piece
        });
        let image = |light: usize| pieces.iter().flat_map(|piece| piece[light].iter().copied()).collect();
        (0..direct.len()).map(image).collect()
    }

    /// λ0 of all emitters, which act as one more light.
    pub fn emission(&self) -> Vec<DVec3> {
        self.radiating(|sample| sample.emission.as_dvec3())
    }

    /// Indirect light of emitters at view samples of `framebuffer`.
    pub fn emitted<'b>(&'b self, framebuffer: &'b DeepFramebuffer, lobe: Lobe) -> Emitted<'b> {
        Emitted::new(self, framebuffer, lobe)
    }

    /// The same as it was [stored](Emitted::stored).
    pub fn restore_emitted<'b>(
        &'b self,
        framebuffer: &'b DeepFramebuffer,
        lobe: Lobe,
        stored: StoredEmitted,
    ) -> Emitted<'b> {
        Emitted::restore(self, framebuffer, lobe, stored)
    }

    /// Coefficients of samples that emit the given radiance uniformly.
    fn radiating(&self, radiance: impl Fn(&GatherSample) -> DVec3) -> Vec<DVec3> {
        let mut coefficients = vec![DVec3::ZERO; self.fine.coefficient_count()];
        for (i, sample) in self.fine.samples.samples.iter().enumerate() {
            // Uniform radiance L is a multiple of the first function, 1/sqrt(pi).
            coefficients[self.fine.coefficients(i).start] = radiance(sample) * std::f64::consts::PI.sqrt();
        }
        coefficients
    }
}

fn bounce_gatherer<'b>(
    scene: &'b TracedScene,
    settings: &TransferSettings,
    receivers: &'b Level,
) -> BounceGatherer<'b> {
    let paths = Paths::new(scene, settings.layers);
    BounceGatherer { paths, receivers, rays: settings.rays, seed: settings.seed ^ 2 << 32 }
}

/// Rows for the sky have fewer rays: they serve while it turns, and light that mirrors throw.
const SKY_RAYS_DIVISOR: u32 = 4;
/// Share of all rays that leave a scene by its cracks.
pub const CLOSED: f64 = 1e-4;
/// Eye paths per sample, which determine where samples are placed.
const PATHS_A_SAMPLE: usize = 16;
/// Minimum number of eye paths: they also detect hidden sides, and a sample's BRDF is a mean over places that they met.
const MIN_PATHS: usize = 1 << 19;
/// Points per coarse sample from which its rays start.
const RAY_POINTS: usize = 16;

/// The Lambertian BRDF with the same hemispherical albedo, and the same perfect mirror.
fn lambert(brdf: &Brdf) -> Brdf {
    let diffuse = HarmonicProjection::get().hemispherical_albedo(brdf, ALBEDO_CAP);
    let (f0, f90) = if brdf.has_lobe() { (Vec3::ZERO, 0.0) } else { (brdf.f0, brdf.f90) };
    Brdf { diffuse, alpha: 0.0, f0, f90, dielectric_f0: 0.0, dielectric_f90: 0.0 }
}

/// Number of functions of a material; they may omit the share `dropped` of its energy.
fn functions(outgoing: &Outgoing, brdf: &Brdf, dropped: f32) -> u8 {
    match *outgoing {
        Outgoing::Diffuse => 1,
        Outgoing::Glossy { functions: Some(count) } => {
            assert_eq!(count.isqrt().pow(2), count, "harmonics come by whole degrees");
            count.clamp(1, MAX_FUNCTIONS as u8)
        }
        Outgoing::Glossy { functions: None } => {
            let energy = HarmonicProjection::get().energy_by_degree(brdf);
            let all: f32 = energy.iter().sum();
            let enough = |functions: &u8| {
                let degrees = functions.isqrt() as usize;
                all == 0.0 || energy[degrees..].iter().sum::<f32>() <= dropped * all
            };
            EVEN_DEGREES.into_iter().find(enough).unwrap_or(MAX_FUNCTIONS as u8)
        }
    }
}

/// Maximum share of a material's energy in omitted functions, times its share of the picture's indirect light.
const DROPPED: f32 = 0.0015;
/// Numbers of functions up to an even degree; a material gets the smallest sufficient one. In a furnished room
/// expansions that end with an odd degree are less accurate (docs/accuracy.md, "How many functions").
const EVEN_DEGREES: [u8; 4] = [1, 9, 25, MAX_FUNCTIONS as u8];
/// Limits of the functions per fine sample, which represent direct light and the highlights it casts; the first that
/// fits is used.
const FINE_FUNCTIONS: [u8; 7] = [MAX_FUNCTIONS as u8, 36, 25, 16, 9, 4, 1];
/// Maximum number of coefficients of the fine level, or six per sample if that is more: hundreds of training lights are
/// stored, each with this many values.
const MAX_FINE_COEFFICIENTS: usize = 150_000;

/// Maximum number of coefficients of direct light at `samples` gather samples with at most `functions` functions each.
pub fn max_coefficients(samples: usize, functions: usize) -> usize {
    (functions * samples).min(MAX_FINE_COEFFICIENTS.max(6 * samples))
}

/// Limits of the functions per coarse sample: light is smoother after further bounces.
const COARSE_FUNCTIONS: [u8; 2] = [9, 1];
/// Maximum number of coefficients of the coarse level: compression factorizes the matrix among them.
pub const MAX_COARSE_COEFFICIENTS: usize = 6_000;

fn capped(samples: &GatherSamples) -> f64 {
    let (mut kept, mut all) = (0.0, 0.0);
    for sample in &samples.samples {
        let reflected =
            |cap: f32| f64::from(HarmonicProjection::get().hemispherical_albedo(&sample.brdf, cap).element_sum());
        kept += f64::from(sample.area) * reflected(ALBEDO_CAP);
        all += f64::from(sample.area) * reflected(f32::INFINITY);
    }
    if all > 0.0 { 1.0 - kept / all } else { 0.0 }
}
