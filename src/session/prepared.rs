//! From gather samples and bounces to operators: computed, or restored from what parts of a bake share.

use std::borrow::Cow;
use std::path::Path;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::memory::check_free;
use super::plan::{BakeInput, ERROR, Form, TransferPlan};
use super::progress::{Progress, advance};
use super::report::BakeReport;
use crate::bake::DeepFramebuffer;
use crate::bake::baselines::thesis::Thesis;
use crate::bake::compression::{self, CompressionSettings, Compressor, Fitted, Operator, Part};
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::transfer::Transfer;
use crate::bake::transfer::blocks::check_addressable;
use crate::bake::transfer::sky::SkyTransfer;
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::{self, LightTransport};
use crate::error::Result;
use crate::scene::Scene;
use crate::storage::journal::Journal;

/// Random lights that compression learns from.
const LIGHTS: usize = 512;
/// Random skies that compression learns from.
const SKIES: usize = 192;
/// Error of light of the sky, as a multiple of the compressed operator's: what mirrors throw is a small part of a
/// picture, and the rest of it serves while a dome moves.
const SKY_ERROR: f64 = 2.0;

/// Gather samples and bounces among them, before the operator.
pub(super) enum Prepared<'a> {
    Robust { transport: Box<LightTransport<'a>>, form: Form, seed: u64, stored: Box<StoredCompressors> },
    Thesis { thesis: Box<Thesis<'a>>, input: BakeInput<'a>, bounces: u32 },
}

/// What parts of a bake share, in a file.
#[derive(Serialize, Deserialize)]
pub(super) struct Shared<'a> {
    pub transport: transport::Stored<'a>,
    pub direct: compression::Stored<'a>,
    /// Of light of the sky, if there is a dome and any of its light arrives: [`LightTransport::from_sky`], and what
    /// compresses it.
    pub sky: Option<(Cow<'a, CsrMatrix>, compression::Stored<'a>)>,
}

/// What was stored of compressors and is not used yet.
#[derive(Default)]
pub(super) struct StoredCompressors {
    pub direct: Option<compression::Stored<'static>>,
    /// The inner option: whether any light of the sky arrives.
    pub sky: Option<Option<(CsrMatrix, compression::Stored<'static>)>>,
}

impl TransferPlan {
    /// Bakes the operator, and light of the sky for rigs that have `domes`; keeps nothing in the cache.
    pub fn bake(
        &self,
        input: BakeInput,
        lobe: Lobe,
        domes: bool,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Transfer> {
        let mut prepared = self.prepare(input, report, progress);
        let transfer = prepared.bake(lobe, None, None, report, progress)?;
        let bake_sky = || prepared.bake_sky(lobe, None, None, report, progress);
        let sky = (domes && self.has_sky()).then(bake_sky).transpose()?;
        Ok(Transfer { sky, ..transfer })
    }

    /// What [`TransferPlan::prepare`] made, from a file that has light of the sky if `has_sky`.
    pub(super) fn restore<'a>(&'a self, input: BakeInput<'a>, shared: Shared<'static>, has_sky: bool) -> Prepared<'a> {
        let Self::Robust(settings, form) = self else { unreachable!("only our own method is stored") };
        let Shared { transport, direct, sky } = shared;
        let transport = Box::new(transport.restore(input.scene, input.framebuffer, settings));
        let sky = has_sky.then(|| sky.map(|(from_sky, stored)| (from_sky.into_owned(), stored)));
        let stored = Box::new(StoredCompressors { direct: Some(direct), sky });
        Prepared::Robust { transport, form: *form, seed: settings.seed, stored }
    }

    /// What operators are made from.
    pub(super) fn prepare<'a>(
        &'a self,
        BakeInput { scene, framebuffer }: BakeInput<'a>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Prepared<'a> {
        let advance = advance(progress);
        match self {
            Self::Robust(settings, form) => {
                progress.begin("bounces", settings.coarse_samples.min(settings.samples));
                let transport = report.stage("bounces", || LightTransport::new(scene, framebuffer, settings, &advance));
                progress.end();
                let radius = transport.certificate.spectral_radius;
                if radius > HARDLY_ABSORBED {
                    tracing::warn!(
                        "this scene absorbs hardly any light: each bounce keeps up to {radius:.5} of it; {:.3} % of all reflected light was removed",
                        100.0 * transport.certificate.capped
                    );
                }
                let stored = Box::default();
                Prepared::Robust { transport: Box::new(transport), form: *form, seed: settings.seed, stored }
            }
            Self::Thesis(settings) => {
                progress.begin("bounces", settings.samples);
                let thesis = report.stage("bounces", || Thesis::new(scene, framebuffer, settings, &advance));
                progress.end();
                Prepared::Thesis {
                    thesis: Box::new(thesis),
                    input: BakeInput { scene, framebuffer },
                    bounces: settings.bounces,
                }
            }
        }
    }
}

impl Prepared<'_> {
    /// The operator; `fits` are those that parts made; `journal` is where it keeps what it would go on from if it was
    /// stopped.
    pub fn bake(
        &mut self,
        lobe: Lobe,
        fits: Option<Vec<Fitted>>,
        journal: Option<&Path>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Transfer> {
        let advance = advance(progress);
        let mut journal = journal.map_or_else(Journal::default, Journal::open);
        let made = match self {
            Self::Robust { transport, form, seed, stored } => {
                let (scene, framebuffer) = (transport.scene(), transport.framebuffer());
                if *form == Form::Dense {
                    check_dense(framebuffer, transport.column_count(), scene)?;
                }
                progress.begin("transfer", framebuffer.samples.len());
                let to = |error| CompressionSettings { error, lights: LIGHTS, lobe, seed: *seed };
                let make = || match *form {
                    Form::Dense => Ok(Transfer::dense(transport, framebuffer, lobe, &mut journal, &advance)),
                    Form::Nested(error) => {
                        let compressor = compressor(transport, None, &to(error), stored.direct.take());
                        Transfer::compressed(&compressor, fits, &mut journal, &advance)
                    }
                    Form::Haar(error) => {
                        let fits = |bytes| check_wavelets(bytes, scene);
                        Transfer::haar(transport, &to(error), fits, &mut journal, &advance)
                    }
                };
                let made = report.stage("transfer", make);
                progress.end();
                let made = made.inspect_err(|_| journal.remove())?;
                if let (Form::Nested(error), Some(held_out)) = (*form, &made.report.held_out)
                    && held_out.is_exceeded()
                {
                    tracing::warn!(
                        "the compressed transfer misses --error {error} in {} parts of the picture; their summed squared error is {:.0} % above the target",
                        held_out.missed,
                        100.0 * held_out.excess
                    );
                }
                made
            }
            Self::Thesis { thesis, input: BakeInput { scene, framebuffer }, bounces } => {
                check_dense(framebuffer, thesis.column_count(), scene)?;
                if scene.materials.iter().any(|material| material.emissive != Vec3::ZERO) {
                    tracing::warn!("--method thesis has no indirect light of emissive materials");
                }
                if thesis.spectral_radius >= 1.0 {
                    tracing::warn!(
                        "the series of --method thesis does not converge here: its spectral radius is {:.3}; the picture has its first {bounces} terms",
                        thesis.spectral_radius,
                    );
                }
                progress.begin("transfer", framebuffer.samples.len());
                let make = || Transfer::thesis(thesis, framebuffer, lobe, &mut journal, &advance);
                let dense = report.stage("transfer", make);
                progress.end();
                dense
            }
        };
        journal.remove();
        Ok(made)
    }

    /// Light of the sky, compressed in nested blocks in any form of the operator. Arguments as of [`Prepared::bake`].
    ///
    /// Panics if the plan [has none](TransferPlan::has_sky).
    pub fn bake_sky(
        &mut self,
        lobe: Lobe,
        fits: Option<Vec<Fitted>>,
        journal: Option<&Path>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<SkyTransfer> {
        let Self::Robust { transport, form, seed, stored } = self else { unreachable!("see has_sky") };
        let advance = advance(progress);
        let mut journal = journal.map_or_else(Journal::default, Journal::open);
        progress.begin("light of the sky", transport.framebuffer().samples.len());
        let make = || {
            let (from_sky, stored) = match stored.sky.take() {
                Some(stored) => stored.unzip(),
                None => (transport.from_sky(), None),
            };
            let Some(from_sky) = from_sky else { return Ok(SkyTransfer::default()) };
            let compressor = compressor(transport, Some(&from_sky), &of_sky(*form, lobe, *seed), stored);
            SkyTransfer::compressed(&compressor, fits, &mut journal, &advance)
        };
        let made = report.stage("light of the sky", make);
        progress.end();
        journal.remove();
        if made.as_ref().is_ok_and(|sky| sky.chain.is_empty()) {
            tracing::warn!("hardly any light of the sky arrives: the scene is closed");
        }
        made
    }

    /// Computes what parts of the bake share, and gives it to `keep`.
    ///
    /// Panics unless the plan [is divisible](TransferPlan::is_divisible), as do the next two.
    pub fn share<R>(&self, lobe: Lobe, has_sky: bool, keep: impl FnOnce(&Shared) -> R) -> R {
        let (transport, settings, of_sky) = self.divisible(lobe);
        let direct = compressor(transport, None, &settings, None);
        let from_sky = if has_sky { transport.from_sky() } else { None };
        let sky = from_sky.as_ref().map(|from_sky| compressor(transport, Some(from_sky), &of_sky, None));
        // Training made a part of what is stored of the transport.
        let transport = transport::Stored::of(transport);
        let sky = from_sky.as_ref().map(Cow::Borrowed).zip(sky.as_ref().map(Compressor::stored));
        keep(&Shared { transport, direct: direct.stored(), sky })
    }

    /// Fits the superclusters of one part of the operator. `journal`: see [`Prepared::bake`].
    pub fn bake_part(
        &mut self,
        lobe: Lobe,
        part: Part,
        journal: &Path,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Vec<Fitted>> {
        let Self::Robust { stored, .. } = self else { unreachable!("see is_divisible") };
        let stored = stored.direct.take();
        let (transport, settings, _) = self.divisible(lobe);
        let compressor = || compressor(transport, None, &settings, stored);
        fit_part("transfer", compressor, part, journal, report, progress)
    }

    /// [`Prepared::bake_part`] for light of the sky; nothing, if none arrives.
    pub fn bake_part_of_sky(
        &mut self,
        lobe: Lobe,
        part: Part,
        journal: &Path,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Vec<Fitted>> {
        let Self::Robust { stored, .. } = self else { unreachable!("see is_divisible") };
        let stored = stored.sky.take();
        let (transport, _, settings) = self.divisible(lobe);
        let (from_sky, stored) = match stored {
            Some(stored) => stored.unzip(),
            None => (transport.from_sky(), None),
        };
        let Some(from_sky) = from_sky else { return Ok(Vec::new()) };
        let compressor = || compressor(transport, Some(&from_sky), &settings, stored);
        fit_part("light of the sky", compressor, part, journal, report, progress)
    }

    /// The transport, and how it and light of the sky are compressed.
    fn divisible(&self, lobe: Lobe) -> (&LightTransport<'_>, CompressionSettings, CompressionSettings) {
        let &Self::Robust { ref transport, form: form @ Form::Nested(error), seed, .. } = self else {
            unreachable!("see is_divisible")
        };
        (transport, CompressionSettings { error, lights: LIGHTS, lobe, seed }, of_sky(form, lobe, seed))
    }

    /// The view samples and the scene of our own method.
    pub fn input(&self) -> BakeInput<'_> {
        let Self::Robust { transport, .. } = self else { unreachable!("see has_sky") };
        BakeInput { scene: transport.scene(), framebuffer: transport.framebuffer() }
    }
}

/// How light of the sky is compressed.
fn of_sky(form: Form, lobe: Lobe, seed: u64) -> CompressionSettings {
    let error = match form {
        Form::Nested(error) | Form::Haar(error) => error,
        Form::Dense => ERROR,
    };
    CompressionSettings { error: SKY_ERROR * error, lights: SKIES, lobe, seed }
}

/// From what was stored of it, or computed.
fn compressor<'b>(
    transport: &'b LightTransport,
    from_sky: Option<&'b CsrMatrix>,
    settings: &CompressionSettings,
    stored: Option<compression::Stored>,
) -> Compressor<'b> {
    let operator = Operator { transport, from_sky };
    match stored {
        Some(stored) => Compressor::restore(operator, stored, settings),
        None => Compressor::new(operator, settings),
    }
}

fn fit_part<'b>(
    name: &'static str,
    compressor: impl FnOnce() -> Compressor<'b>,
    part: Part,
    journal: &Path,
    report: &mut BakeReport,
    progress: &dyn Progress,
) -> Result<Vec<Fitted>> {
    let compressor = report.stage("restore", compressor);
    let mut journal = Journal::open(journal);
    progress.begin(name, compressor.rows_of(part));
    let made = report.stage(name, || compressor.fit_part(part, &mut journal, &advance(progress)));
    progress.end();
    made
}

/// Refuses a dense operator that cannot fit this machine: float16 RGB, on the host and on the device, and G* once more.
fn check_dense(framebuffer: &DeepFramebuffer, columns: usize, scene: &Scene) -> Result<()> {
    let bytes = 12.0 * (framebuffer.samples.len() as f64 + 4.0 * columns as f64) * columns as f64;
    check_addressable((6 * framebuffer.samples.len() * columns) as u64)?;
    let what =
        format!("a dense transfer of {columns} coefficients to {} view samples takes", framebuffer.samples.len());
    check_free(
        bytes,
        &what,
        "choose a smaller --size, a smaller --gather, or a --basis with fewer functions",
        &scene.path,
    )
}

/// Refuses wavelets that cannot fit this machine.
fn check_wavelets(bytes: f64, scene: &Scene) -> Result<()> {
    check_addressable(bytes as u64 / 2)?;
    let what = "the wavelets that --error needs take";
    check_free(bytes, what, "choose a larger --error, a smaller --size, or a smaller --gather", &scene.path)
}

/// Spectral radius from which light bounces some thousand times: a thousandth more or less reflected halves or doubles
/// it.
const HARDLY_ABSORBED: f64 = 0.999;
