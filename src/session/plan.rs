//! What is baked for indirect light, and why: samples, rays and bases chosen from the picture's size and the asked
//! error.

use serde::Serialize;

use super::progress::{Progress, advance};
use crate::bake::DeepFramebuffer;
use crate::bake::baselines::thesis::ThesisSettings;
use crate::bake::brdf_factors::harmonics::MAX_FUNCTIONS;
use crate::bake::brdf_factors::svd::Terms;
use crate::bake::compression::validation::{self, Validation, ValidationError};
use crate::bake::transfer::Transfer;
use crate::bake::transport::direct;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::{LightTransport, Outgoing, TransferSettings};
use crate::error::{Error, Result};
use crate::shared::PackedLight;
use crate::trace::bvh::TracedScene;

/// How indirect light is computed. What is `None` is chosen by the picture's size, and by the error that is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum IndirectSettings {
    /// Our method.
    Robust {
        outgoing: Outgoing,
        form: Form,
        /// Gather samples.
        gather: Option<u32>,
        /// Rays a row.
        rays: Option<u32>,
        /// Indirect bounces counted at the pixel; `None`: all of them.
        bounces: Option<u32>,
    },
    /// The thesis's method, dense, as printed [Yang 2007, Chapter 4].
    Thesis {
        outgoing: Outgoing,
        /// Terms of a BRDF's singular value decomposition.
        terms: Option<usize>,
        gather: Option<u32>,
        /// Its I + G + ... + G⁴ are 5 [Yang 2007, Eq. 4.6].
        bounces: u32,
    },
}

impl IndirectSettings {
    /// Whether it has all bounces: what final gathering estimates.
    pub fn has_all_bounces(&self) -> bool {
        matches!(self, Self::Robust { bounces: None, .. })
    }
}

/// How our operator is stored, the compressed forms to a relative error: mean over point lights.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Form {
    /// As it is: for few gather samples and small pictures.
    Dense,
    /// Nested blocks of low rank.
    Nested(f64),
    /// The largest wavelets of each row, the published form, to compare with [Ng 2003].
    Haar(f64),
}

/// What is baked, decided.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum TransferPlan {
    Robust(TransferSettings, Form),
    Thesis(ThesisSettings),
}

/// A scene, and what of it is seen.
#[derive(Clone, Copy)]
pub struct BakeInput<'a> {
    pub scene: &'a TracedScene,
    pub framebuffer: &'a DeepFramebuffer,
}

/// Gather samples of the thesis, and of the dense form [Yang 2007, Section 5.2].
const DENSE_SAMPLES: usize = 2304;
/// Gather samples of the compressed form at most; small pictures show less.
const SAMPLES: usize = 16_384;
/// Pixels for each gather sample of the compressed form, at the default error or a smaller one.
const PIXELS_A_SAMPLE: f64 = 4.0;
/// Rays a row: of the dense form, of small pictures at the default error.
const RAYS: u32 = 1024;
/// What another error may make of them.
const RAYS_BY_ERROR: [f64; 2] = [256.0, 4096.0];
/// Pixels beyond which neighbours share their noise: as many rays in all answer for as large a part of the picture.
const RAYS_PIXELS: usize = 100_000;
/// Share of the rays that remains in the largest picture. What noise hides is lost with it (docs/accuracy.md, "Rays of
/// a row").
const RAYS_LEAST: f64 = 0.5;
/// Error of the compressed operator by default.
pub const ERROR: f64 = 0.01;
/// Gather samples among which light bounces on.
const COARSE_SAMPLES: usize = 2304;
/// Points of all gather samples at which light is looked at.
const POINTS: usize = 65_536;
/// Bounces of I + G + ... + G⁴ [Yang 2007, Eq. 4.6].
pub const THESIS_BOUNCES: u32 = 5;
/// Error that a BRDF's singular values may leave, where nobody says how many there are.
const THESIS_ERROR: f64 = 0.1;

impl Default for IndirectSettings {
    fn default() -> Self {
        let outgoing = Outgoing::Glossy { functions: None };
        Self::Robust { outgoing, form: Form::Nested(ERROR), gather: None, rays: None, bounces: None }
    }
}

impl IndirectSettings {
    /// Refuses numbers that mean nothing.
    pub(super) fn check(&self) -> Result<()> {
        let refuse = |reason: &str| Err(Error::invalid("indirect light", reason));
        let (Self::Robust { outgoing, gather, .. } | Self::Thesis { outgoing, gather, .. }) = *self;
        if gather == Some(0) || matches!(self, Self::Robust { rays: Some(0), .. } | Self::Thesis { terms: Some(0), .. })
        {
            return refuse("gather samples, rays and terms must be at least 1");
        }
        if self.error().is_some_and(|error| !(error > 0.0 && error <= 1.0)) {
            return refuse("the error must be greater than 0, and at most 1");
        }
        match outgoing {
            Outgoing::Glossy { functions: Some(count) }
                if count.isqrt().pow(2) != count || !(1..=MAX_FUNCTIONS as u8).contains(&count) =>
            {
                refuse("the number of functions must be a square number from 1 to 49")
            }
            _ => Ok(()),
        }
    }

    /// For a picture of `size` pixels whose rays go on through at most `layers` mirrors.
    pub fn plan(&self, size: [u32; 2], layers: u32, seed: u64) -> TransferPlan {
        let samples = self.samples(size).0;
        match *self {
            Self::Robust { outgoing, form, bounces, .. } => {
                let settings = TransferSettings {
                    outgoing,
                    samples,
                    paths: TransferSettings::paths_for(samples),
                    // The compressed form inverts the matrix among them.
                    coarse_samples: if form == Form::Dense { COARSE_SAMPLES } else { COARSE_SAMPLES.min(samples / 2) },
                    points: (POINTS / samples).clamp(1, 16),
                    rays: self.rays(size).0,
                    layers,
                    bounces,
                    seed,
                };
                TransferPlan::Robust(settings, form)
            }
            Self::Thesis { outgoing, terms, bounces, .. } => {
                let terms = terms.map_or(Terms::Error(THESIS_ERROR), Terms::Count);
                TransferPlan::Thesis(ThesisSettings { outgoing, samples, terms, bounces, seed })
            }
        }
    }

    /// The error of a compressed form.
    fn error(&self) -> Option<f64> {
        match *self {
            Self::Robust { form: Form::Nested(error) | Form::Haar(error), .. } => Some(error),
            _ => None,
        }
    }

    /// Number of gather samples for a picture of `size` pixels, and why. With `--gather`: that number. Dense form and
    /// thesis: [`DENSE_SAMPLES`]. Else pixels divided by [`PIXELS_A_SAMPLE`], from [`DENSE_SAMPLES`] to [`SAMPLES`]; an
    /// error above [`ERROR`] divides it further, in proportion.
    fn samples(&self, size: [u32; 2]) -> (usize, String) {
        let (Self::Robust { gather, .. } | Self::Thesis { gather, .. }) = *self;
        if let Some(samples) = gather {
            return (samples as usize, "--gather".into());
        }
        let Some(error) = self.error() else {
            return (DENSE_SAMPLES, "a dense matrix of more is too large".into());
        };
        let pixels = size[0] as usize * size[1] as usize;
        let pixels_each = (PIXELS_A_SAMPLE / (ERROR / error).min(1.0)).round() as usize;
        let samples = (pixels / pixels_each).clamp(DENSE_SAMPLES, SAMPLES);
        let bound = match samples {
            DENSE_SAMPLES => format!(", at least {DENSE_SAMPLES}"),
            SAMPLES => format!(", at most {SAMPLES}"),
            _ => String::new(),
        };
        (samples, format!("one for {pixels_each} of {pixels} pixels{bound}, with --error {error}"))
    }

    /// Rays a row, and why. With `--rays`: that number. Dense form: [`RAYS`]. Else inversely proportional to the error,
    /// within [`RAYS_BY_ERROR`], and fewer in pictures of more than [`RAYS_PIXELS`].
    fn rays(&self, size: [u32; 2]) -> (u32, String) {
        if let Self::Robust { rays: Some(rays), .. } = *self {
            return (rays, "--rays".into());
        }
        let Some(error) = self.error() else {
            return (RAYS, "the dense form is not compressed".into());
        };
        let [least, most] = RAYS_BY_ERROR;
        let by_error = (f64::from(RAYS) * ERROR / error).clamp(least, most);
        let pixels = size[0] as usize * size[1] as usize;
        let share = (RAYS_PIXELS as f64 / pixels as f64).clamp(RAYS_LEAST, 1.0);
        let why = format!("{by_error:.0} with --error {error}, {share:.2} of them in {pixels} pixels");
        ((by_error * share).round() as u32, why)
    }

    /// What is chosen for a picture of `size` pixels, and why; for people, in the command line's words.
    pub fn reasons(&self, size: [u32; 2]) -> Vec<String> {
        let (samples, why_samples) = self.samples(size);
        let mut reasons = vec![format!("{samples} gather samples: {why_samples}")];
        if matches!(self, Self::Robust { .. }) {
            let (rays, why_rays) = self.rays(size);
            reasons.push(format!("{rays} rays a row: {why_rays}"));
        }
        reasons.push(match self {
            Self::Robust { outgoing: Outgoing::Diffuse, .. } | Self::Thesis { outgoing: Outgoing::Diffuse, .. } => {
                "1 function a sample: --gi diffuse".into()
            }
            Self::Robust { outgoing: Outgoing::Glossy { functions: None }, .. } => {
                "1 to 49 functions a sample: as its material's gloss needs".into()
            }
            Self::Thesis { terms: None, .. } => format!("singular values down to {THESIS_ERROR} of a BRDF"),
            _ => "functions a sample: --basis".into(),
        });
        reasons
    }
}

impl TransferPlan {
    /// For people.
    pub fn describe(&self) -> String {
        match self {
            Self::Robust(settings, form) => {
                let TransferSettings { samples, rays, bounces, .. } = settings;
                let bounces = bounces.map_or("all bounces".into(), |bounces| format!("{bounces} bounces"));
                let form = match form {
                    Form::Dense => "dense".into(),
                    Form::Nested(error) => format!("compressed to an error of {error}"),
                    Form::Haar(error) => format!("the wavelets of each row to an error of {error}"),
                };
                format!("{samples} gather samples, {rays} rays a row, {bounces}, {form}")
            }
            Self::Thesis(ThesisSettings { samples, bounces, .. }) => {
                format!("{samples} gather samples as in the thesis, {bounces} bounces, dense")
            }
        }
    }

    /// Gather samples, points of each, and the most functions of each.
    pub(super) fn gather(&self) -> (usize, usize, usize) {
        match self {
            Self::Robust(TransferSettings { samples, points, outgoing, .. }, _) => {
                let functions = match outgoing {
                    Outgoing::Diffuse => 1,
                    Outgoing::Glossy { functions } => functions.map_or(MAX_FUNCTIONS, usize::from),
                };
                (*samples, *points, functions)
            }
            // Nobody knows the terms that an error needs.
            Self::Thesis(ThesisSettings { samples, terms, .. }) => {
                (*samples, 1, if let Terms::Count(terms) = terms { *terms } else { 1 })
            }
        }
    }

    /// Whether rows baked to one sample a pixel can serve further samples.
    pub fn spreads(&self) -> bool {
        !matches!(self, Self::Robust(_, Form::Haar(_)))
    }

    /// What takes about a second: for a compressed form, as a first look.
    pub fn first(&self) -> Option<Self> {
        let Self::Robust(settings, Form::Nested(_) | Form::Haar(_)) = self else { return None };
        let settings = TransferSettings {
            outgoing: Outgoing::Diffuse,
            samples: settings.samples.min(512),
            paths: 1 << 15,
            coarse_samples: settings.coarse_samples.min(256),
            points: 2,
            rays: settings.rays.min(64),
            ..settings.clone()
        };
        Some(Self::Robust(settings, Form::Dense))
    }

    /// What takes seconds and tells where the light goes; for a compressed form.
    pub fn coarse(&self) -> Option<Self> {
        let Self::Robust(settings, Form::Nested(error) | Form::Haar(error)) = self else { return None };
        let samples = settings.samples.min(1024);
        let coarse_samples = settings.coarse_samples.min(samples / 4);
        let rays = settings.rays.min(64);
        let paths = TransferSettings::paths_for(samples);
        let settings = TransferSettings { samples, paths, coarse_samples, points: 4, rays, ..settings.clone() };
        Some(Self::Robust(settings, Form::Nested(error.max(0.05))))
    }

    /// How far an operator of ours is from rows gathered anew, under points and spots.
    pub fn verify(
        &self,
        BakeInput { scene, framebuffer }: BakeInput,
        operator: &Transfer,
        progress: &dyn Progress,
    ) -> Result<[ValidationError; 2]> {
        let Self::Robust(settings, _) = self else {
            return Err(Error::invalid("--verify", "works only with --method robust"));
        };
        progress.begin("bounces", settings.coarse_samples.min(settings.samples));
        let transfer = LightTransport::new(scene, framebuffer, settings, &advance(progress));
        progress.end();
        let direct = |light: &PackedLight| direct::shade(scene, &transfer.fine, light);
        let rays = RAYS_ANEW * settings.rays;
        let validation = Validation { rays, share: 0.1, lights: 20, lobe: Lobe::All, seed: settings.seed ^ 5 << 32 };
        progress.begin("verifying", (validation.share * framebuffer.samples.len() as f64) as usize);
        let errors =
            validation::validate(&transfer, &direct, |light| operator.apply(light), &validation, &advance(progress));
        progress.end();
        Ok(errors)
    }

    /// Whether there is light of the sky: with our own method.
    pub(super) fn has_sky(&self) -> bool {
        matches!(self, Self::Robust(..))
    }

    /// Whether it can be baked in parts.
    pub fn is_divisible(&self) -> bool {
        matches!(self, Self::Robust(_, Form::Nested(_)))
    }
}

/// Rays of rows gathered anew, for each of the operator's own.
const RAYS_ANEW: u32 = 8;
