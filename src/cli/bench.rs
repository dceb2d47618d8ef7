//! `relume bench`: each edit from the change of a light to the finished image in host memory.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use relume::gpu::{PassTime, Processor};
use relume::relight::output::exposure;
use relume::relight::roofline::Roofline;
use relume::relight::{Detail, Layers, Picture, Relighter, Request};
use relume::scene::{LightGroup, LightKind, Rig};
use relume::session::{Session, Transfers};
use relume::{Error, Result};
use serde_json::json;

use super::bench_rig::{light_like_scene, nudge};
use super::options::{Exposure, LightOptions, RecordOptions, SceneOptions};
use super::output_file::{make_parent, write_json};
use super::percentile::{median, percentile};
use super::stats::{self, sum_by_name};
use super::{bench_rays, progress, stdout};

#[derive(clap::Args)]
pub struct Args {
    /// Scenes, measured one after the other: .glb, .gltf or .obj files.
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Numbers of lights, separated by commas; everything is measured with each of them. Lights beyond those of the
    /// scene are placed by the seed [default: the lights of the scene].
    #[arg(long, value_name = "N,...", value_delimiter = ',', value_parser = parse_light_count)]
    lights: Vec<usize>,
    /// Frames to measure for each edit. A fifth as many run before them as a warm-up.
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Writes all measurements to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Rig file whose lights replace those of every scene.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    #[command(flatten)]
    record: RecordOptions,
    #[command(flatten)]
    scene_options: SceneOptions,
    #[command(flatten)]
    light_options: LightOptions,
}

pub const AFTER_HELP: &str = "\
Each measurement is from the change of a light to the finished image in host memory. If you give several scenes, put \
{scene} into the names of --stats and --trace: it is replaced by the name of each scene.";

#[derive(Clone, Copy, PartialEq)]
pub enum Edit {
    Color,
    Toggle,
    Move,
    /// Without indirect light.
    MoveDirect,
    Select,
    Group,
    Multi,
    None,
}

/// Edits and what they are called.
const EDITS: [(Edit, &str); 8] = [
    (Edit::Color, "color"),
    (Edit::Toggle, "toggle"),
    (Edit::Move, "move"),
    (Edit::MoveDirect, "move_direct"),
    (Edit::Select, "select"),
    (Edit::Group, "group"),
    (Edit::Multi, "multi"),
    (Edit::None, "none"),
];

/// One line of the table.
#[derive(serde::Serialize)]
pub struct Record {
    scene: String,
    pub lights: usize,
    pub edit: &'static str,
    pub edited_kind: LightKind,
    gi: &'static str,
    method: Option<String>,
    size: [u32; 2],
    pub visibility: &'static str,
    pub median_ms: f64,
    pub p95_ms: f64,
    pub best_ms: f64,
    pub passes: Vec<PassRecord>,
    /// Of each frame that counts, for --trace.
    #[serde(skip)]
    times: Vec<Vec<PassTime>>,
}

#[derive(serde::Serialize)]
pub struct PassRecord {
    pub name: &'static str,
    pub on: Processor,
    pub median_ms: f64,
    pub best_ms: f64,
}

pub fn run(args: &Args) -> Result<()> {
    args.json.iter().try_for_each(|path| make_parent(path))?;
    let files = files_of_scenes(args)?;
    let table = Table { matters: args.json.is_none() };
    let mut records = Vec::new();
    let mut limits = json!(null);
    let mut rates = Vec::new();
    let (mut slowest_segments, mut slowest_gather) = (f64::INFINITY, f64::INFINITY);
    let mut device = (String::new(), String::new());
    for (path, files) in args.scenes.iter().zip(&files) {
        let target = args.light_options.target(&args.scene_options.cache)?;
        let session = args.scene_options.open(path, args.rig.as_deref(), Some(target))?;
        let context = session.context(args.light_options.device.device.as_deref())?;
        device = (context.info.name.clone(), context.info.driver.clone());
        let mut measured = Roofline::new(&context, session.framebuffer.samples.len())?;
        let mut yardstick = Vec::new();
        let counts = match args.lights.as_slice() {
            [] => vec![session.rig.lights.len()],
            counts => counts.to_vec(),
        };
        table.line(format_args!("{}: {}", path.display(), describe(&session)))?;
        table.line(format_args!(
            "  {:>6} {:<11} {:<11} {:>8} {:>8} {:>8}  passes, median ms",
            "lights", "edit", "of", "best", "median", "p95"
        ))?;
        let (mut figures, mut edits) = (json!(null), Vec::new());
        for &count in &counts {
            let rig = light_like_scene(&session, count, args.scene_options.view.seed);
            let mut relighter = session.relighter(&context, &rig, &args.light_options.relight_settings())?;
            let timing = Timing { session: &session, frames: args.frames, shown: shown(args, &mut relighter)? };
            relighter.display(timing.shown.clone())?;
            if figures.is_null() {
                figures = stats::figures(&session, &relighter, relighter.times(), None);
            }
            for (edited, edit) in edits_of(&rig) {
                yardstick.push(measured.yardstick_ms()?);
                let mut record = timing.measure(&mut relighter, &rig, edited, edit)?;
                table.record(&record)?;
                let times = std::mem::take(&mut record.times);
                edits.extend(files.trace.is_some().then_some((record.edit, times)));
                records.push(record);
            }
        }
        files.write(|| figures, || stats::trace_edits(&session.bake.stages, &edits))?;
        let rays = bench_rays::measure(&session);
        let segments = bench_rays::segments_per_s_core(&session);
        slowest_segments = slowest_segments.min(segments);
        let gathered = bench_rays::gather_rays_per_s(&session);
        slowest_gather = slowest_gather.min(gathered);
        let copy = best_of(5, || measured.copy_gb_s())?;
        let fma = best_of(5, || measured.fma_gflop_s())?;
        let yard = yardstick.iter().copied().fold(f64::INFINITY, f64::min);
        table.line(format_args!(
            "  yardstick {yard:.2} ms best, {:.2} median; copy {copy:.1} GB/s, {fma:.1} Gflop/s",
            median(&mut yardstick)
        ))?;
        if let Some(line) = describe_transfer(&session, &records, copy) {
            table.line(format_args!("  {line}"))?;
        }
        table.line(format_args!("  shadow rays: {rays}"))?;
        table.line(format_args!("  path tracing: {:.2} million segments a CPU second", segments * 1e-6))?;
        table.line(format_args!("  final gathers: {:.2} million rays a second", gathered * 1e-6))?;
        table.line(format_args!("  load average {:.2}", load_average()))?;
        limits = json!({ "copy_gb_s": copy, "fma_gflop_s": fma, "yardstick_ms": yard });
        rates.push(json!({
            "scene": session.scene.name(), "shadow_rays": rays, "segments_per_s_core": segments,
            "gather_rays_per_s": gathered, "yardstick_ms": yard
        }));
    }
    if let Some(path) = &args.json {
        let all = json!({
            "schema": 1,
            "device": device.0,
            "driver": device.1,
            "load": load_average(),
            "limits": limits,
            // Of the scenes, the slowest.
            "rates": { "segments_per_s_core": slowest_segments, "gather_rays_per_s": slowest_gather, "scenes": rates },
            "records": records,
        });
        write_json(path, &all)?;
    }
    Ok(())
}

impl Edit {
    fn needed_lights(self) -> usize {
        match self {
            Self::None => 0,
            Self::Color | Self::Toggle | Self::Move | Self::MoveDirect => 1,
            Self::Select | Self::Group => 2,
            Self::Multi => SEVERAL,
        }
    }
}

/// Lights that [`Edit::Multi`] moves.
pub const SEVERAL: usize = 3;

/// What can be done to a rig's lights: to the first one of each kind, by its index.
pub fn edits_of(rig: &Rig) -> Vec<(usize, (Edit, &'static str))> {
    let edited = first_of_each_kind(rig);
    let possible = |&light: &usize| {
        let is_first = light == edited[0];
        let fits = move |edit: Edit| edit.needed_lights() <= rig.lights.len() && (edit != Edit::None || is_first);
        EDITS.into_iter().filter(move |(edit, _)| fits(*edit)).map(move |edit| (light, edit))
    };
    edited.iter().flat_map(possible).collect()
}

/// How edits are timed.
pub struct Timing<'a> {
    pub session: &'a Session,
    /// Frames that count; a fifth as many before do not.
    pub frames: u32,
    /// The picture that is made.
    pub shown: Request,
}

impl<'a> Timing<'a> {
    /// Of whole pictures.
    pub fn new(session: &'a Session, frames: u32) -> Self {
        Self { session, frames, shown: Request::default() }
    }

    /// Times the edits of a light.
    pub fn measure(
        &self,
        relighter: &mut Relighter,
        rig: &Rig,
        edited: usize,
        (edit, name): (Edit, &'static str),
    ) -> Result<Record> {
        let Self { session, frames, ref shown } = *self;
        let mut rig = rig.clone();
        if edit == Edit::Group {
            let group = LightGroup::new("half");
            rig.groups.push(group);
            let half = rig.lights.len() / 2;
            rig.lights.iter_mut().take(half).for_each(|light| light.group = Some(rig.groups.len() - 1));
        }
        let layers = if edit == Edit::MoveDirect { Layers::FirstHand } else { Layers::All };
        let shown = Request { layers, ..shown.clone() };
        relighter.set_rig(&rig)?;
        relighter.display(shown.clone())?;
        let original = rig.clone();
        let count = rig.lights.len();
        // Coprime to any even count: `select` meets every light, each far from the one before.
        let stride = (count / 2).saturating_sub(2) | 1;
        let warm_up = frames.div_ceil(5);
        let bar = progress::bar(name, (warm_up + frames) as usize);
        // As in the window: the first picture of an area light that moves is not its exact one.
        let hurried = Request { detail: Detail::Progressive, ..shown };
        let (mut all_ms, mut times) = (Vec::new(), Vec::new());
        for frame in 0..warm_up + frames {
            let odd = frame % 2 == 1;
            let step = f64::from(frame % 16);
            let start = Instant::now();
            match edit {
                Edit::Color => rig.lights[edited].color.x = 0.5 + step as f32 / 32.0,
                Edit::Toggle => rig.lights[edited].enabled = odd,
                Edit::Move | Edit::MoveDirect => {
                    nudge(&mut rig.lights[edited], &original.lights[edited], session, step)
                }
                Edit::Select => relighter.select(&[(edited + frame as usize * stride) % count]),
                Edit::Group => rig.groups.last_mut().expect("pushed above").stops = f64::from(u8::from(odd)),
                Edit::Multi => {
                    for light in [edited, (edited + 1) % count, (edited + (count / 2).max(2)) % count] {
                        nudge(&mut rig.lights[light], &original.lights[light], session, step);
                    }
                }
                Edit::None => {}
            }
            relighter.set_rig(&rig)?;
            relighter.display(hurried.clone())?;
            let ms = start.elapsed().as_secs_f64() * 1e3;
            bar.inc(1);
            if frame >= warm_up {
                all_ms.push(ms);
                times.push(relighter.times().to_vec());
            }
        }
        bar.finish_and_clear();
        let transfer = session.transfer.as_ref();
        Ok(Record {
            scene: session.scene.name(),
            lights: count,
            edit: name,
            edited_kind: rig.lights.get(edited).map_or(LightKind::Point, |light| light.kind),
            gi: if transfer.is_none() || edit == Edit::MoveDirect {
                "off"
            } else {
                session.transfers.as_ref().map_or("off", Transfers::gi)
            },
            method: transfer.map(|transfer| transfer.report.method.clone()),
            size: [session.framebuffer.tiling.width, session.framebuffer.tiling.height],
            visibility: stats::visibility_name(relighter.traces()),
            median_ms: median(&mut all_ms),
            p95_ms: percentile(&mut all_ms, 0.95),
            best_ms: percentile(&mut all_ms, 0.0),
            passes: passes_of(&times),
            times,
        })
    }
}

/// What passes of one name take in a frame.
fn passes_of(frames: &[Vec<PassTime>]) -> Vec<PassRecord> {
    let mut all_ms: Vec<(&'static str, Processor, Vec<f64>)> = Vec::new();
    for (name, processor, ms) in frames.iter().flat_map(|times| sum_by_name(times)) {
        match all_ms.iter_mut().find(|pass| pass.0 == name) {
            Some(pass) => pass.2.push(ms),
            None => all_ms.push((name, processor, vec![ms])),
        }
    }
    let record = |(name, on, mut ms): (&'static str, Processor, Vec<f64>)| {
        let [median_ms, best_ms] = [0.5, 0.0].map(|share| percentile(&mut ms, share));
        PassRecord { name, on, median_ms, best_ms }
    };
    all_ms.into_iter().map(record).collect()
}

/// The picture that the display options ask for; an automatic exposure is that of the lights as they are.
fn shown(args: &Args, relighter: &mut Relighter) -> Result<Request> {
    let options = &args.light_options.display;
    let exposure = match options.exposure {
        Exposure::Stops(stops) => stops,
        Exposure::Auto => exposure::automatic(relighter.linear(Picture::Whole)?),
    };
    Ok(Request { exposure, tone_map: options.tone_map(options.config()?.as_ref())?, ..Request::default() })
}

/// Where --stats and --trace of each scene go: {scene} in their names is replaced by its name. Two scenes for one file
/// are an error.
fn files_of_scenes(args: &Args) -> Result<Vec<RecordOptions>> {
    let filled = |template: &Option<PathBuf>, scene: &Path| {
        let name = scene.file_stem().unwrap_or_default().to_string_lossy();
        // Names that are not UTF-8 hold no placeholder and stay as they are.
        let fill = |path: &PathBuf| path.to_str().map_or_else(|| path.clone(), |p| p.replace("{scene}", &name).into());
        template.as_ref().map(fill)
    };
    let mut names = HashSet::new();
    let of_scene = |scene: &PathBuf| {
        let RecordOptions { stats, trace } = &args.record;
        let files = RecordOptions { stats: filled(stats, scene), trace: filled(trace, scene) };
        for path in files.stats.iter().chain(&files.trace) {
            if !names.insert(path.clone()) {
                let reason = "two files would have this name; put {scene} into it, and give scenes different names";
                return Err(Error::invalid(path.display().to_string(), reason));
            }
        }
        files.make_parents()?;
        Ok(files)
    };
    args.scenes.iter().map(of_scene).collect()
}

/// Records for people, on standard output.
struct Table {
    /// Without --json: the work ends when nobody reads on.
    matters: bool,
}

impl Table {
    fn line(&self, text: std::fmt::Arguments) -> Result<()> {
        match stdout::line(text) {
            Err(error) if !self.matters && stdout::reader_has_gone(&error) => Ok(()),
            outcome => outcome,
        }
    }

    fn record(&self, r: &Record) -> Result<()> {
        let passes: Vec<_> = r.passes.iter().map(|pass| format!("{} {:.2}", pass.name, pass.median_ms)).collect();
        let kind = format!("{:?}", r.edited_kind).to_lowercase();
        self.line(format_args!(
            "  {:>6} {:<11} {kind:<11} {:>8.2} {:>8.2} {:>8.2}  {}",
            r.lights,
            r.edit,
            r.best_ms,
            r.median_ms,
            r.p95_ms,
            passes.join(", ")
        ))
    }
}

fn describe(session: &Session) -> String {
    let tiling = session.framebuffer.tiling;
    let triangles = session.scene.mesh.triangles.len();
    format!("{triangles} triangles, {}x{}, view samples by layer {:?}", tiling.width, tiling.height, session.layers())
}

/// How long the transfer of a moved light takes, beside a copy of its bytes.
fn describe_transfer(session: &Session, records: &[Record], copy_gb_s: f64) -> Option<String> {
    let (bytes, multiply_adds) = session.transfer.as_ref()?.cost();
    let moved = records.iter().filter(|r| r.edit == "move" && r.scene == session.scene.name());
    let transfer = |record: &Record| -> f64 {
        let of_it = |pass: &&PassRecord| pass.name == "Haar transform" || pass.name.starts_with("transfer");
        record.passes.iter().filter(of_it).map(|pass| pass.best_ms).sum()
    };
    let best = moved.map(transfer).fold(f64::INFINITY, f64::min);
    let megabytes = bytes as f64 * 1e-6;
    Some(format!(
        "transfer: {megabytes:.1} MB, {:.0} million multiply-adds; best {best:.2} ms, {:.1} times its bytes at the rate of a copy",
        multiply_adds as f64 * 1e-6,
        best * copy_gb_s / megabytes
    ))
}

/// The first light of each kind that has a position or a direction; 0 if there is none.
fn first_of_each_kind(rig: &Rig) -> Vec<usize> {
    let is_first = |&at: &usize| {
        let kind = rig.lights[at].kind;
        !matches!(kind, LightKind::Emitter | LightKind::Dome)
            && rig.lights[..at].iter().all(|before| before.kind != kind)
    };
    let found: Vec<usize> = (0..rig.lights.len()).filter(is_first).collect();
    if found.is_empty() { vec![0] } else { found }
}

/// The largest of some measurements.
pub fn best_of(times: usize, mut measure: impl FnMut() -> Result<f64>) -> Result<f64> {
    (0..times).try_fold(0.0, |best: f64, _| Ok(best.max(measure()?)))
}

/// Mean number of running processes over the last minute; 0 where /proc does not tell.
pub fn load_average() -> f64 {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().next().and_then(|load| load.parse().ok()).unwrap_or(0.0)
}

/// Most lights that a bench places; each has images of its own or is shaded anew.
const MAX_LIGHTS: usize = 65_536;

fn parse_light_count(text: &str) -> Result<usize, String> {
    let count = text.parse().ok().filter(|&count| count <= MAX_LIGHTS);
    count.ok_or_else(|| format!("expected numbers of lights, each at most {MAX_LIGHTS}, like 2,16"))
}
