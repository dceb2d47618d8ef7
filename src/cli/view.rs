//! `relume view`

use std::path::PathBuf;
use std::time::Duration;

use relume::gpu::Vsync;
use relume::scene::usd;
use relume::view::input::keys;
use relume::view::input::script::Script;
use relume::view::{SceneSource, ViewSettings};
use relume::{Result, SessionSettings};
use serde_json::json;

use super::final_gather::parse_error;
use super::options::{LightOptions, RecordOptions, SceneOptions};
use super::output_file::{check_outputs, make_parent};
use super::stats;

#[derive(clap::Args)]
#[command(after_help = help_on_keys())]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    scene: PathBuf,
    /// Rig file, or USD file, whose lights replace those of the scene. Saving in the window writes a rig file back.
    /// Without --rig, the window asks for a file name when you save.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Plays keyboard and mouse events from this file. Each line has a time in seconds and an event: `0.5 key Ctrl+Z`,
    /// `1 press A`, `2 release A`, `2 mouse 320 240`.
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Writes all keyboard and mouse events to this file. --script plays it.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Lets other programs of this user read and edit the lights, and writes to this file how they connect.
    /// docs/protocol.md tells what they can say.
    #[arg(long, value_name = "FILE")]
    listen: Option<PathBuf>,
    /// Does not wait for the display: pictures appear sooner, but may tear.
    #[arg(long)]
    no_vsync: bool,
    #[command(flatten)]
    files: RecordOptions,
    /// Time in milliseconds that a frame may take while a light is dragged. If a frame takes longer, relume shows
    /// coarser pictures during the drag, and the exact picture after it. 0: never coarser.
    #[arg(long, value_name = "MS", default_value_t = 33.0, value_parser = parse_budget)]
    frame_budget: f64,
    /// Once the lights rest, gathers their indirect light anew until the expected error of a pixel, relative to the
    /// mean of the picture, is at most this: a fraction, or percent with %. off: never. Never with --bounces
    /// or --method thesis, because it gathers all bounces.
    #[arg(id = "final", long, value_name = "ERROR", default_value = "1%", value_parser = parse_at_rest)]
    final_error: AtRest,
    #[command(flatten)]
    scene_options: SceneOptions,
    #[command(flatten)]
    light_options: LightOptions,
}

pub fn run(args: &Args) -> Result<()> {
    args.files.make_parents()?;
    args.record.iter().chain(&args.listen).try_for_each(|path| make_parent(path))?;
    let read = [&args.scene].into_iter().chain(&args.rig).chain(&args.script).map(PathBuf::as_path);
    let written = args.record.iter().chain(&args.listen).map(PathBuf::as_path).chain(args.files.files());
    check_outputs(read, written)?;
    let script = args.script.as_deref().map(Script::load).transpose()?;
    let target = Some(args.light_options.target(&args.scene_options.cache)?);
    let settings = SessionSettings { samples: 1, target, ..args.scene_options.settings()? };
    let indirect = settings.indirect.as_ref();
    let view_settings = ViewSettings {
        name: args.scene.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        // A USD file may have more than lights: saving asks for a name.
        rig_path: args.rig.clone().filter(|path| !usd::is_usd(path)),
        pictures: args.light_options.picture_settings(args.scene_options.cache.dir())?,
        vsync: if args.no_vsync { Vsync::Off } else { Vsync::On },
        script,
        record: args.record.clone(),
        listen: args.listen.clone(),
        frame_budget: Duration::from_secs_f64(args.frame_budget * 1e-3),
        rest_samples: args.scene_options.samples.unwrap_or(REST_SAMPLES),
        final_error: args.final_error.0.filter(|_| indirect.is_some_and(|indirect| indirect.has_all_bounces())),
        trace: args.files.trace.is_some(),
    };
    args.scene_options.view.use_threads();
    let source = SceneSource { path: args.scene.clone(), rig: args.rig.clone(), settings };
    let report = relume::view::run(view_settings, source)?;
    let figures = || json!({ "schema": 1, "relume": env!("CARGO_PKG_VERSION"), "view": report });
    args.files.write(figures, || stats::trace_frames(&report.trace))
}

/// Error to gather down to, if any.
#[derive(Clone, Copy)]
struct AtRest(Option<f64>);

fn parse_at_rest(text: &str) -> std::result::Result<AtRest, String> {
    let error = |text| parse_error(text).map_err(|reason| reason + ", or off");
    if text == "off" { Ok(AtRest(None)) } else { error(text).map(|error| AtRest(Some(error))) }
}

/// View samples of a pixel on an edge, once lights rest.
const REST_SAMPLES: u32 = 8;

fn parse_budget(text: &str) -> std::result::Result<f64, String> {
    let ms = text.parse().ok().filter(|ms| (0.0..=60_000.0).contains(ms));
    ms.ok_or_else(|| "expected milliseconds from 0 to 60000, like 33".into())
}

/// Every key, below the options.
fn help_on_keys() -> String {
    let mut text = String::from("Keys:\n");
    for binding in keys::SECTIONS.iter().flat_map(|section| section.bindings) {
        text += &format!("  {:<24} {}\n", binding.keys_text(), binding.text);
    }
    text + "\n" + keys::STEPS_TEXT
}
