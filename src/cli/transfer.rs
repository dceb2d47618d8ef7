//! Options of indirect light, and its bake.

use std::path::Path;

use clap::ValueEnum;
use glam::Vec3;
use relume::bake::Baked;
use relume::bake::brdf_factors::svd::Terms;
use relume::bake::compression::CompressionSettings;
use relume::bake::compression::validation::{self, Validation, ValidationError};
use relume::bake::transfer::baked::BakedTransfer;
use relume::bake::transfer::direct;
use relume::bake::transfer::rows::Lobe;
use relume::bake::transfer::thesis::{Thesis, ThesisSettings};
use relume::bake::transfer::{Outgoing, Transfer, TransferSettings};
use relume::scene::Scene;
use relume::shared::PackedLight;
use relume::storage::journal::Journal;
use relume::trace::bvh::Bvh;
use relume::{Error, Result};

use super::options::{Bounces, ViewOptions, parse_bounces};
use super::progress::Progress;
use super::session::{BakeReport, check_free};

/// How indirect light is computed.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Indirect light")]
pub struct TransferOptions {
    /// Indirect light: none, from gather samples that radiate equally in all directions, or with their gloss.
    #[arg(long, value_enum, default_value = "glossy")]
    pub gi: Gi,
    /// The thesis's method as printed, or ours.
    #[arg(long, value_enum, default_value = "robust")]
    pub method: MethodName,
    /// Gather samples [default: by pixels and --error, 2304 to 16384; 2304 in dense form; `relume plan` tells why].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub gather: Option<u32>,
    /// Rays a row of the operator, for --method robust [default: by pixels and --error, 128 to 4096; 1024 in dense form].
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub rays: Option<u32>,
    /// Outgoing light of a gather sample: sh1, sh4, sh9, sh16, sh25, sh36 or sh49 harmonics; svdN terms for --method thesis
    /// [default: what each material needs].
    #[arg(long, value_name = "BASIS", value_parser = parse_basis)]
    pub basis: Option<Basis>,
    /// How the operator is stored and applied.
    #[arg(long, value_enum, default_value = "auto")]
    pub transfer: Form,
    /// Relative error of the compressed operator, mean over point lights that it has not learned from.
    #[arg(long, value_name = "E", default_value_t = ERROR, value_parser = parse_error)]
    pub error: f64,
    /// Indirect bounces counted at the pixel, or inf [default: inf; 5 with --method thesis].
    #[arg(long, value_name = "N|inf", value_parser = parse_bounces)]
    pub bounces: Option<Bounces>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Gi {
    Off,
    Diffuse,
    Glossy,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    Thesis,
    Robust,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// Nested.
    Auto,
    /// As it is: for few gather samples and small pictures.
    Dense,
    /// Nested blocks of low rank.
    Nested,
    /// The largest wavelets of each row, the published form, to compare with; as many as --error asks for.
    Haar,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    Harmonics(u8),
    SingularValues(usize),
}

/// What is baked, decided.
#[derive(Clone, Debug, PartialEq)]
pub enum TransferPlan {
    Robust(TransferSettings, Stored),
    Thesis(ThesisSettings),
}

/// A scene, and what of it is seen.
#[derive(Clone, Copy)]
pub struct BakeInput<'a> {
    pub scene: &'a Scene,
    pub bvh: &'a Bvh,
    pub baked: &'a Baked,
}

/// How our operator is kept; compressed to a relative error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stored {
    Dense,
    Nested(f64),
    Haar(f64),
}

/// Gather samples of the thesis, and of the dense form [Yang 2007, Section 5.2].
const DENSE_SAMPLES: usize = 2304;
/// Gather samples of the compressed form at most; small pictures show less.
const SAMPLES: usize = 16_384;
/// Pixels for each of them, at the default error.
const PIXELS_A_SAMPLE: f64 = 4.0;
/// Rays a row: of the dense form, of small pictures at the default error.
const RAYS: u32 = 1024;
/// What --error may make of them.
const RAYS_BY_ERROR: [f64; 2] = [256.0, 4096.0];
/// Pixels beyond which neighbours share their noise: as many rays in all answer for as large a part of the picture.
const RAYS_PIXELS: usize = 100_000;
/// Share of the rays that remains in the largest picture. What noise hides is lost with it (docs/accuracy.md, "Rays of
/// a row").
const RAYS_LEAST: f64 = 0.5;
/// The default of --error.
const ERROR: f64 = 0.01;
/// Random lights that compression learns from.
const LIGHTS: usize = 512;
/// Gather samples among which light bounces on.
const COARSE_SAMPLES: usize = 2304;
/// Points of all gather samples at which light is looked at.
const POINTS: usize = 65_536;
/// Bounces of I + G + ... + G⁴ [Yang 2007, Eq. 4.6].
const THESIS_BOUNCES: u32 = 5;
/// Error that a BRDF's singular values may leave, where nobody says how many there are.
const THESIS_ERROR: f64 = 0.1;

impl TransferOptions {
    /// For a picture of `size` pixels; `None` without indirect light, an error where options exclude each other.
    pub fn plan(&self, view: &ViewOptions, size: [u32; 2]) -> Result<Option<TransferPlan>> {
        let refuse = |option: &str, reason: &str| Err(Error::invalid(option, reason));
        let thesis = self.method == MethodName::Thesis;
        let compressed = match self.transfer {
            Form::Nested => Some("--transfer nested"),
            Form::Haar => Some("--transfer haar"),
            Form::Auto | Form::Dense => None,
        };
        if let Some(option) = compressed.filter(|_| thesis) {
            return refuse(option, "the thesis's operator is dense");
        }
        let dense = self.is_dense();
        let samples = self.samples(size).0;
        let diffuse = match self.gi {
            Gi::Off => return Ok(None),
            Gi::Diffuse => true,
            Gi::Glossy => false,
        };
        if diffuse && self.basis.is_some() {
            return refuse("--basis", "--gi diffuse has one function by its nature");
        }
        match (self.method, self.basis) {
            (MethodName::Robust, Some(Basis::SingularValues(_))) => refuse("--basis", "svdN needs --method thesis"),
            (MethodName::Thesis, Some(Basis::Harmonics(_))) => refuse("--basis", "shN needs --method robust"),
            (MethodName::Robust, basis) => {
                let functions = match basis {
                    Some(Basis::Harmonics(count)) => Some(count),
                    _ => None,
                };
                let settings = TransferSettings {
                    outgoing: if diffuse { Outgoing::Diffuse } else { Outgoing::Glossy { functions } },
                    samples,
                    // The compressed form inverts the matrix among them.
                    coarse_samples: if dense { COARSE_SAMPLES } else { COARSE_SAMPLES.min(samples / 2) },
                    points: (POINTS / samples).clamp(1, 16),
                    rays: self.rays(size).0,
                    layers: view.layers,
                    bounces: self.bounces.and_then(|bounces| bounces.0),
                    seed: view.seed,
                };
                let stored = match self.transfer {
                    Form::Dense => Stored::Dense,
                    Form::Auto | Form::Nested => Stored::Nested(self.error),
                    Form::Haar => Stored::Haar(self.error),
                };
                Ok(Some(TransferPlan::Robust(settings, stored)))
            }
            (MethodName::Thesis, basis) => Ok(Some(TransferPlan::Thesis(ThesisSettings {
                outgoing: if diffuse { Outgoing::Diffuse } else { Outgoing::Glossy { functions: None } },
                samples,
                terms: match basis {
                    Some(Basis::SingularValues(count)) => Terms::Count(count),
                    _ => Terms::Error(THESIS_ERROR),
                },
                bounces: match self.bounces {
                    None => THESIS_BOUNCES,
                    Some(Bounces(Some(count))) => count,
                    Some(Bounces(None)) => {
                        return refuse("--bounces inf", "the thesis's sum is truncated; give a number");
                    }
                },
                seed: view.seed,
            }))),
        }
    }
}

impl TransferOptions {
    fn is_dense(&self) -> bool {
        self.method == MethodName::Thesis || self.transfer == Form::Dense
    }

    /// How much closer than by default the operator is to be.
    fn closeness(&self) -> f64 {
        ERROR / self.error
    }

    /// Gather samples for a picture of `size` pixels, and why.
    fn samples(&self, size: [u32; 2]) -> (usize, String) {
        if let Some(samples) = self.gather {
            return (samples as usize, "--gather".into());
        }
        if self.is_dense() {
            return (DENSE_SAMPLES, "a dense matrix of more is too large".into());
        }
        let pixels = size[0] as usize * size[1] as usize;
        let pixels_each = (PIXELS_A_SAMPLE / self.closeness().min(1.0)).round() as usize;
        let samples = (pixels / pixels_each).clamp(DENSE_SAMPLES, SAMPLES);
        let bound = match samples {
            DENSE_SAMPLES => format!(", at least {DENSE_SAMPLES}"),
            SAMPLES => format!(", at most {SAMPLES}"),
            _ => String::new(),
        };
        (samples, format!("one for {pixels_each} of {pixels} pixels{bound}, with --error {}", self.error))
    }

    /// Rays a row, and why.
    fn rays(&self, size: [u32; 2]) -> (u32, String) {
        if let Some(rays) = self.rays {
            return (rays, "--rays".into());
        }
        if self.is_dense() {
            return (RAYS, "the dense form is not compressed".into());
        }
        let [least, most] = RAYS_BY_ERROR;
        let by_error = (f64::from(RAYS) * self.closeness()).clamp(least, most);
        let pixels = size[0] as usize * size[1] as usize;
        let share = (RAYS_PIXELS as f64 / pixels as f64).clamp(RAYS_LEAST, 1.0);
        let why = format!("{by_error:.0} with --error {}, {share:.2} of them in {pixels} pixels", self.error);
        ((by_error * share).round() as u32, why)
    }

    /// What is chosen for a picture of `size` pixels, and why; for people.
    pub fn reasons(&self, size: [u32; 2]) -> Vec<String> {
        let (samples, why_samples) = self.samples(size);
        let mut reasons = vec![format!("{samples} gather samples: {why_samples}")];
        if self.method == MethodName::Robust {
            let (rays, why_rays) = self.rays(size);
            reasons.push(format!("{rays} rays a row: {why_rays}"));
        }
        reasons.push(match (self.gi, self.basis, self.method) {
            (Gi::Diffuse, ..) => "1 function a sample: --gi diffuse".into(),
            (_, Some(_), _) => "functions a sample: --basis".into(),
            (_, None, MethodName::Robust) => "1 to 49 functions a sample: as its material's gloss needs".into(),
            (_, None, MethodName::Thesis) => format!("singular values down to {THESIS_ERROR} of a BRDF"),
        });
        reasons
    }
}

impl TransferPlan {
    /// For people.
    pub fn describe(&self) -> String {
        match self {
            Self::Robust(settings, stored) => {
                let TransferSettings { samples, rays, bounces, .. } = settings;
                let bounces = bounces.map_or("all bounces".into(), |bounces| format!("{bounces} bounces"));
                let form = match stored {
                    Stored::Dense => "dense".into(),
                    Stored::Nested(error) => format!("compressed to an error of {error}"),
                    Stored::Haar(error) => format!("the wavelets of each row to an error of {error}"),
                };
                format!("{samples} gather samples, {rays} rays a row, {bounces}, {form}")
            }
            Self::Thesis(ThesisSettings { samples, bounces, .. }) => {
                format!("{samples} gather samples as in the thesis, {bounces} bounces, dense")
            }
        }
    }

    /// Whether rows baked to one sample a pixel can serve further samples.
    pub fn spreads(&self) -> bool {
        !matches!(self, Self::Robust(_, Stored::Haar(_)))
    }

    /// What takes seconds and tells where the light goes; for a compressed form.
    pub fn coarse(&self) -> Option<Self> {
        let Self::Robust(settings, Stored::Nested(error) | Stored::Haar(error)) = self else { return None };
        let samples = settings.samples.min(1024);
        let coarse_samples = settings.coarse_samples.min(samples / 4);
        let rays = settings.rays.min(64);
        let settings = TransferSettings { samples, coarse_samples, points: 4, rays, ..settings.clone() };
        Some(Self::Robust(settings, Stored::Nested(error.max(0.05))))
    }

    /// How far an operator of ours is from rows gathered anew, under points and spots.
    pub fn verify(
        &self,
        BakeInput { scene, bvh, baked }: BakeInput,
        operator: &BakedTransfer,
        progress: &dyn Progress,
    ) -> Result<[ValidationError; 2]> {
        let Self::Robust(settings, _) = self else {
            return Err(Error::invalid("--verify", "rows are gathered anew for --method robust only"));
        };
        progress.begin("bounces", settings.coarse_samples.min(settings.samples));
        let transfer = Transfer::new(scene, bvh, baked, settings, &|count| progress.advance(count));
        progress.end();
        let direct = |light: &PackedLight| direct::shade(scene, bvh, &transfer.fine, light);
        let rays = RAYS_ANEW * settings.rays;
        let validation = Validation { rays, share: 0.1, lights: 20, lobe: Lobe::All, seed: settings.seed ^ 5 << 32 };
        progress.begin("verifying", (validation.share * baked.samples.len() as f64) as usize);
        let errors = validation::validate(&transfer, &direct, |light| operator.apply(light), &validation, &|count| {
            progress.advance(count);
        });
        progress.end();
        Ok(errors)
    }

    /// Bakes the operator; `journal` is where it keeps what it would go on from if it was stopped.
    pub fn bake(
        &self,
        BakeInput { scene, bvh, baked }: BakeInput,
        lobe: Lobe,
        journal: Option<&Path>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<BakedTransfer> {
        let advance = |count| progress.advance(count);
        let mut journal = journal.map_or_else(Journal::default, Journal::open);
        let baked = match self {
            Self::Robust(settings, stored) => {
                progress.begin("bounces", settings.coarse_samples.min(settings.samples));
                let transfer = report.stage("bounces", || Transfer::new(scene, bvh, baked, settings, &advance));
                progress.end();
                let radius = transfer.certificate.spectral_radius;
                if radius > HARDLY_ABSORBED {
                    tracing::warn!(
                        "hardly any light is absorbed here: of its bounces each leaves up to {radius:.5}, {:.3} % were taken away",
                        100.0 * transfer.certificate.capped
                    );
                }
                if *stored == Stored::Dense {
                    check_dense(baked, transfer.column_count(), scene)?;
                }
                progress.begin("transfer", baked.samples.len());
                let to = |error| CompressionSettings { error, lights: LIGHTS, lobe, seed: settings.seed };
                let made = report.stage("transfer", || match *stored {
                    Stored::Dense => Ok(BakedTransfer::dense(&transfer, baked, lobe, &mut journal, &advance)),
                    Stored::Nested(error) => Ok(BakedTransfer::nested(&transfer, &to(error), &mut journal, &advance)),
                    Stored::Haar(error) => {
                        let fits = |bytes| check_wavelets(bytes, scene);
                        BakedTransfer::haar(&transfer, &to(error), fits, &mut journal, &advance)
                    }
                });
                progress.end();
                let made = made.inspect_err(|_| journal.remove())?;
                if let (&Stored::Nested(error), Some(held_out)) = (stored, &made.report.held_out)
                    && held_out.is_exceeded()
                {
                    tracing::warn!(
                        "indirect light exceeds --error {error} in {} parts of the picture; the square of what all of them lose is {:.0} % above what that allows",
                        held_out.missed,
                        100.0 * held_out.excess
                    );
                }
                made
            }
            Self::Thesis(settings) => {
                progress.begin("bounces", settings.samples);
                let thesis = report.stage("bounces", || Thesis::new(scene, bvh, baked, settings, &advance));
                progress.end();
                check_dense(baked, thesis.column_count(), scene)?;
                if scene.materials.iter().any(|material| material.emissive != Vec3::ZERO) {
                    tracing::warn!("the thesis's method has no emitters: what their light does to surfaces is missing");
                }
                if thesis.spectral_radius >= 1.0 {
                    tracing::warn!(
                        "the thesis's series has no sum here: its spectral radius is {:.3}; shown are its first {} terms",
                        thesis.spectral_radius,
                        settings.bounces
                    );
                }
                progress.begin("transfer", baked.samples.len());
                let make = || BakedTransfer::thesis(&thesis, baked, lobe, &mut journal, &advance);
                let dense = report.stage("transfer", make);
                progress.end();
                dense
            }
        };
        journal.remove();
        Ok(baked)
    }
}

/// Spectral radius from which light bounces some thousand times: a thousandth more or less reflected halves or doubles it.
const HARDLY_ABSORBED: f64 = 0.999;

/// Rays of rows gathered anew, for each of the operator's own.
const RAYS_ANEW: u32 = 8;

/// Refuses a dense operator that cannot fit this machine: float16 RGB, on the host and on the device, and G* once more.
fn check_dense(baked: &Baked, columns: usize, scene: &Scene) -> Result<()> {
    let bytes = 12.0 * (baked.samples.len() as f64 + 4.0 * columns as f64) * columns as f64;
    let what = format!("a dense transfer of {columns} coefficients to {} view samples takes", baked.samples.len());
    check_free(bytes, &what, "choose a smaller --size, fewer --gather, or a --basis of fewer functions", &scene.path)
}

/// Refuses wavelets that cannot fit this machine.
fn check_wavelets(bytes: f64, scene: &Scene) -> Result<()> {
    let what = "the wavelets that --error asks for take";
    check_free(bytes, what, "choose a larger --error, a smaller --size, or fewer --gather", &scene.path)
}

fn parse_error(text: &str) -> std::result::Result<f64, String> {
    let error = text.parse().ok().filter(|error| (1e-6..=1.0).contains(error));
    error.ok_or_else(|| "expected a share from 0.000001 to 1, like 0.01".into())
}

fn parse_basis(text: &str) -> Result<Basis, String> {
    let count = |prefix: &str| text.strip_prefix(prefix).and_then(|count| count.parse::<usize>().ok());
    if let Some(count) = count("sh").filter(|count| [1, 4, 9, 16, 25, 36, 49].contains(count)) {
        return Ok(Basis::Harmonics(count as u8));
    }
    if let Some(count) = count("svd").filter(|count| (1..=812).contains(count)) {
        return Ok(Basis::SingularValues(count));
    }
    Err("expected sh1, sh4, sh9, sh16, sh25, sh36, sh49 or svd1 to svd812".into())
}
