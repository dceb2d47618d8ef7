//! `relume bake`

use std::path::PathBuf;

use relume::bake::cache;
use relume::bake::compression::Report;
use relume::bake::compression::validation::ValidationError;
use relume::bake::transfer::TransferReport;
use relume::{Error, Result};
use serde_json::json;

use super::options::{RecordOptions, SceneOptions};
use super::progress::Terminal;
use super::stats;
use super::stdout::out;

#[derive(clap::Args)]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    #[arg(required_unless_present_any = ["list", "prune"])]
    scene: Option<PathBuf>,
    /// Rig file, or USD file, whose lights replace those of the scene. They matter only with --samples, which smooths the edges of their
    /// shadows.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Measures the error of the transfer: a tenth of its rows are calculated again with eight times as many rays, under 20
    /// point lights and 20 spots.
    #[arg(long)]
    verify: bool,
    #[command(flatten)]
    record: RecordOptions,
    /// Bakes nothing; lists what the cache holds.
    #[arg(long, conflicts_with_all = ["scene", "stats", "trace"])]
    list: bool,
    /// Bakes nothing; removes all baked data from the cache.
    #[arg(long, conflicts_with_all = ["scene", "list", "stats", "trace"])]
    prune: bool,
    #[command(flatten)]
    options: SceneOptions,
}

pub fn run(args: &Args) -> Result<()> {
    let dir = args.options.cache.dir();
    let no_cache = || Error::invalid("--no-cache", "without a cache there is nothing to list or to remove");
    if args.list {
        let dir = dir.ok_or_else(no_cache)?;
        for cache::Entry { path, scene, what, size, bytes } in cache::list(&dir)? {
            out!("{:9.1} MB  {what:<16}  {size:>11}  {scene}  {}", bytes as f64 * 1e-6, path.display())?;
        }
        return Ok(());
    }
    if args.prune {
        let dir = dir.ok_or_else(no_cache)?;
        let (files, bytes) = cache::prune(&dir)?;
        out!("removed {files} files, {:.1} MB, from {}", bytes as f64 * 1e-6, dir.display())?;
        return Ok(());
    }
    args.record.make_parents()?;
    let scene = args.scene.as_ref().expect("clap requires it");
    let session = args.options.open(scene, args.rig.as_deref(), None)?;
    // Other commands do without a cache that cannot be written; this one is there to fill it.
    if let Some(error) = session.bake.not_stored {
        return Err(error);
    }
    let report = &session.bake;
    if let Some(changed) = &report.because {
        out!("baked again, because of what changed since: {changed}")?;
    }
    for stage in &report.stages {
        out!("{:<20} {:9.1} ms", stage.name, 1e3 * stage.seconds)?;
    }
    let cached = if report.cached { " (deep framebuffer from the cache)" } else { "" };
    out!("{:<20} {:9.1} ms, {:.2} CPU seconds{cached}", "all", 1e3 * report.seconds, report.cpu_seconds)?;
    out!("view samples by layer: {:?}", session.layers())?;
    if let Some(transfer) = &session.transfer {
        let (bytes, multiply_adds) = transfer.cost();
        let TransferReport { method, form, spectral_radius, residual, held_out, .. } = &transfer.report;
        out!("transfer: {} gather samples, {method}, {form}, {:.1} MB", transfer.sample_count(), bytes as f64 * 1e-6)?;
        let residual = residual.map_or(String::new(), |residual| format!("; residual of all bounces: {residual:.0e}"));
        out!("spectral radius: {spectral_radius:.4}{residual}")?;
        if let Some(held_out) = held_out {
            let Report { point, spot, worst, noise, refined, missed, excess, .. } = held_out;
            out!(
                "against its own rows: points {}, spots {}, worst {}",
                percent(*point),
                percent(*spot),
                percent(*worst)
            )?;
            out!(
                "noise of the rows: {}; superclusters refined {refined}, missed {missed} by {} of all squares",
                percent(*noise),
                percent(*excess)
            )?;
        }
        let costs = [bytes as f64, multiply_adds as f64].map(|cost| cost / session.framebuffer.pixel_stride() as f64);
        out!("a pixel: {:.0} multiply-adds, {:.0} bytes", costs[1], costs[0])?;
    }
    // Which of rays and maps it will be is the device's choice.
    let mut figures = stats::figures_of_bake(&session, false);
    if args.verify {
        for (kind, validation) in ["point", "spot"].into_iter().zip(session.verify(&Terminal::default())?) {
            figures["transfer"]["held_out"]["anew"][kind] = json!(validation);
            let ValidationError { error, worst, rows, apart } = validation;
            let [error, worst, rows, apart] = [error, worst, rows, apart].map(percent);
            out!(
                "{kind}s: {error} from rows gathered anew, worst {worst}; its own rows {rows}; apart from these {apart}"
            )?;
        }
    }
    args.record.write(|| figures, || stats::trace(&session.bake.stages, &[]))
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}
