//! `relume view`

use std::path::PathBuf;
use std::time::Duration;

use relume::gpu::{Validation, Vsync};
use relume::session::BakeInput;
use relume::view::script::Script;
use relume::view::{Opened, ViewSettings, keys};
use relume::{Result, Session, SessionSettings};
use serde_json::json;

use super::options::{Exposure, LightOptions, SceneOptions};
use super::output;
use super::stats;

#[derive(clap::Args)]
#[command(after_help = help_on_keys())]
pub struct Args {
    /// Scene: .glb, .gltf or .obj.
    scene: PathBuf,
    /// Rig file that replaces the scene's lights; `save` writes it.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Plays key and mouse events with times: lines like `0.5 key Ctrl+Z`, `1 press A`, `2 release A`, `2 mouse 320 240`.
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Writes the events that happen, for --script.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Shows pictures at once, whether or not the display tears them.
    #[arg(long)]
    no_vsync: bool,
    /// Writes what frames took as JSON, when the window closes.
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// Writes a trace of every frame's passes, for Perfetto or chrome://tracing.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Milliseconds that a frame may take while a light is dragged: a picture that takes longer is made coarser, and
    /// finished when the hand rests. 0 never makes it coarser.
    #[arg(long, value_name = "MS", default_value_t = 33.0, value_parser = parse_budget)]
    frame_budget: f64,
    #[command(flatten)]
    scene_options: SceneOptions,
    #[command(flatten)]
    light_options: LightOptions,
}

pub fn run(args: &Args) -> Result<()> {
    args.stats.iter().chain(&args.record).chain(&args.trace).try_for_each(|path| output::make_parent(path))?;
    let script = args.script.as_deref().map(Script::load).transpose()?;
    let view_settings = ViewSettings {
        name: args.scene.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        rig_path: args.rig.clone(),
        exposure: match args.light_options.exposure {
            Exposure::Auto => None,
            Exposure::Stops(stops) => Some(stops),
        },
        device: args.light_options.device.clone(),
        validation: if cfg!(debug_assertions) { Validation::On } else { Validation::Off },
        cache_dir: args.scene_options.cache_dir(),
        relight: args.light_options.relight_settings(),
        tone_map: args.light_options.tonemap.into(),
        vsync: if args.no_vsync { Vsync::Off } else { Vsync::On },
        script,
        record: args.record.clone(),
        frame_budget: Duration::from_secs_f64(args.frame_budget * 1e-3),
        rest_samples: args.scene_options.samples.unwrap_or(REST_SAMPLES),
        trace: args.trace.is_some(),
    };
    let (path, rig) = (args.scene.clone(), args.rig.clone());
    args.scene_options.view.use_threads();
    let settings = SessionSettings { samples: 1, ..args.scene_options.settings()? };
    let report = relume::view::run(view_settings, move |loader| {
        let session = Session::open_direct(&path, rig.as_deref(), &settings, loader)?;
        let Session { scene, framebuffer, rig, transfers, .. } = session;
        loader.show(Opened { scene: scene.clone(), framebuffer: framebuffer.clone(), transfer: None, rig });
        match transfers {
            Some(transfers) => {
                let seen = BakeInput { scene: &scene, framebuffer: &framebuffer };
                transfers.refine(seen, loader, |transfer| loader.show_transfer(transfer.with_coarse()))
            }
            None => Ok(()),
        }
    })?;
    if let Some(path) = &args.stats {
        output::write_json(path, &json!({ "schema": 1, "relume": env!("CARGO_PKG_VERSION"), "view": report }))?;
    }
    if let Some(path) = &args.trace {
        output::write_json(path, &stats::trace_frames(&report.trace))?;
    }
    Ok(())
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
