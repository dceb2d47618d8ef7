//! `relume bake`

use std::path::{Path, PathBuf};
use std::time::Duration;

use relume::bake::cache;
use relume::bake::compression::validation::ValidationError;
use relume::bake::compression::{FitReport, Part};
use relume::bake::transfer::TransferReport;
use relume::{Error, Result};
use serde_json::json;

use super::options::{RecordOptions, SceneOptions, parse_bytes};
use super::output_file::{check_outputs, make_parent};
use super::progress::Terminal;
use super::stats;
use super::stdout::out;

#[derive(clap::Args, Clone)]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    #[arg(required_unless_present_any = ["list", "prune"])]
    scene: Option<PathBuf>,
    /// Rig file, or USD file, whose lights replace those of the scene. They matter only if they have a dome, and with
    /// --samples, which smooths the edges of their shadows.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Measures the error of the transfer: a tenth of its rows are calculated again with eight times as many rays,
    /// under 20 point lights and 20 spots.
    #[arg(long)]
    verify: bool,
    /// Makes what all parts of the bake need, and keeps it in the cache. Parts that find it there do not make it again.
    #[arg(long, conflicts_with_all = ["verify", "part", "join"])]
    shared: bool,
    /// Bakes one of N parts, with a number I from 1 to N, and prints the name of its file. Parts can be baked at the
    /// same time, on this machine or on others.
    #[arg(long, value_name = "I/N", conflicts_with_all = ["verify", "join"])]
    part: Option<Part>,
    /// File of the part [default: a file in the cache].
    #[arg(short, long, value_name = "PART", requires = "part")]
    output: Option<PathBuf>,
    /// Makes the bake from its parts: these files, or all parts in the cache. It has the same bytes as if it was baked
    /// at once.
    #[arg(long, value_name = "PART", num_args = 0..)]
    join: Option<Vec<PathBuf>>,
    #[command(flatten)]
    record: RecordOptions,
    /// Bakes nothing; lists what the cache holds.
    #[arg(long, conflicts_with_all = ["scene", "shared", "part", "join", "stats", "trace"])]
    list: bool,
    /// Bakes nothing; removes all baked data from the cache but for files that other processes use now.
    #[arg(long, conflicts_with_all = ["scene", "list", "shared", "part", "join", "stats", "trace"])]
    prune: bool,
    /// With --prune: keeps files that were used in this time, like 12h or 30d.
    #[arg(long, value_name = "AGE", requires = "prune", conflicts_with = "list", value_parser = parse_age)]
    older_than: Option<Duration>,
    /// With --prune: keeps the files that were used last, up to so many bytes together, like 20G.
    #[arg(long, value_name = "BYTES", requires = "prune", conflicts_with = "list", value_parser = parse_bytes)]
    keep: Option<u64>,
    #[command(flatten)]
    options: SceneOptions,
}

pub fn run(args: &Args) -> Result<()> {
    let dir = args.options.cache.dir();
    let no_cache = || Error::invalid("--no-cache", "without a cache there is nothing to list or to remove");
    if args.list {
        let dir = dir.ok_or_else(no_cache)?;
        let entries = cache::list(&dir)?;
        for cache::Entry { path, bytes, age, scene, what, size } in &entries {
            let (megabytes, age) = (*bytes as f64 * 1e-6, words_of(*age));
            out!("{megabytes:9.1} MB  {age:>5}  {what:<16}  {size:>11}  {scene}  {}", path.display())?;
        }
        let bytes: u64 = entries.iter().map(|entry| entry.bytes).sum();
        if !entries.is_empty() {
            out!("{:9.1} MB in {} files of {}", bytes as f64 * 1e-6, entries.len(), dir.display())?;
        }
        return Ok(());
    }
    if args.prune {
        let dir = dir.ok_or_else(no_cache)?;
        let keep = cache::Keep { younger_than: args.older_than, bytes: args.keep };
        let cache::Pruned { removed: (files, bytes), in_use } = cache::prune(&dir, keep)?;
        let in_use = if in_use > 0 { format!("; {in_use} are in use") } else { String::new() };
        out!("removed {files} files, {:.1} MB, from {}{in_use}", bytes as f64 * 1e-6, dir.display())?;
        return Ok(());
    }
    let scene = args.scene.as_ref().expect("clap requires it");
    let cameras = args.options.view.all_cameras(scene)?;
    if cameras.is_empty() {
        return bake(args, scene);
    }
    let names_parts = args.output.is_some() || args.join.as_ref().is_some_and(|parts| !parts.is_empty());
    if names_parts || args.record.is_wanted() {
        let reason = "files of parts, --stats and --trace are of one camera: leave them out, or name the camera";
        return Err(Error::invalid("--camera all", reason));
    }
    for camera in cameras {
        out!("camera {camera}")?;
        let mut args = args.clone();
        args.options.view.camera = Some(camera);
        bake(&args, scene)?;
    }
    Ok(())
}

/// Bakes what one camera sees.
fn bake(args: &Args, scene: &Path) -> Result<()> {
    args.record.make_parents()?;
    check_outputs([scene], args.output.as_deref().into_iter().chain(args.record.files()))?;
    args.output.as_deref().map_or(Ok(()), make_parent)?;
    let progress = Terminal::default();
    let options = &args.options;
    let mut session = match args.shared || args.part.is_some() || args.join.is_some() {
        true => options.open_direct(scene, args.rig.as_deref(), &progress)?,
        false => options.open(scene, args.rig.as_deref(), None)?,
    };
    if args.shared {
        session.share(&progress)?;
    } else if let Some(part) = args.part {
        match session.bake_part(part, args.output.as_deref(), &progress)? {
            Some(path) => out!("{}", path.display())?,
            None => tracing::warn!("the cache has the whole bake"),
        }
        return args
            .record
            .write(|| stats::figures_of_bake(&session, false), || stats::trace(&session.bake.stages, &[]));
    } else if let Some(parts) = &args.join {
        session.join(parts, &progress)?;
    }
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
            let FitReport { point, spot, worst, noise, refined, missed, excess, .. } = held_out;
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

/// Seconds in each unit of a time.
const UNITS: [(&str, f64); 4] = [("s", 1.0), ("m", 60.0), ("h", 3600.0), ("d", 86400.0)];

/// A time in its largest whole unit, like 3h.
fn words_of(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    let (unit, length) = UNITS.into_iter().rev().find(|(_, length)| seconds >= *length).unwrap_or(UNITS[0]);
    format!("{:.0}{unit}", (seconds / length).floor())
}

fn parse_age(text: &str) -> std::result::Result<Duration, String> {
    let parsed = UNITS.iter().find_map(|(unit, length)| Some(text.strip_suffix(unit)?.parse::<f64>().ok()? * length));
    let age = parsed.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    age.ok_or_else(|| "expected a time with its unit: s, m, h or d, like 12h".into())
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}
