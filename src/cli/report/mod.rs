//! `relume report`: errors against run time, and what an edit takes, measured and written down.

mod curves;
mod edits;
mod lab;
mod machine;
mod measurement_store;
mod scaling;
mod stability;
mod thesis;
mod truth;

use std::path::{Path, PathBuf};

use relume::relight::RelightSettings;
use relume::report::thesis::Thesis;
use relume::report::{self, Report, SceneReport};
use relume::scene::Scene;
use relume::session::Target;
use relume::{Error, Result};

use self::lab::Lab;
use self::measurement_store::MeasurementStore;
use super::options::{CacheOptions, DeviceOptions, ShadowOptions, ViewOptions};
use super::stdout::out;

#[derive(clap::Args)]
pub struct Args {
    /// Scenes: .glb, .gltf or .obj files [default: some of the folder `scenes`, the furnished room if it was made, and
    /// those of the thesis if RELUME_SHARED or ../shared has them].
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Folder to write: index.html, CSV files, pictures. Measurements that are in it already are not repeated.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Small pictures and short curves; takes minutes instead of hours.
    #[arg(long)]
    quick: bool,
    /// Rig file whose lights replace those of every scene.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    #[command(flatten)]
    view: ViewOptions,
    #[command(flatten)]
    cache: CacheOptions,
    #[command(flatten)]
    shadows: ShadowOptions,
    #[command(flatten)]
    device: DeviceOptions,
}

pub const AFTER_HELP: &str = "\
The page compares settings of indirect light with each other: methods, gather samples, rays, errors, forms. Therefore it \
takes no options for them. Pictures whose errors are measured always have traced shadows, as the reference has; \
--visibility chooses the shadows of the timed edits. --cache keeps only the bakes of the timed edits; all other bakes are \
timed, and therefore made anew.";

impl Args {
    /// How edits are relit.
    fn relight_settings(&self) -> RelightSettings {
        self.shadows.relight_settings(&self.device)
    }

    fn target(&self) -> Result<Target> {
        self.shadows.target(&self.device, &self.cache)
    }
}

/// How much is measured.
pub struct Extent {
    /// Longest side of the pictures whose errors are told, in pixels, where --size does not say.
    side: u32,
    /// Samples a pixel of the truth.
    truth: u32,
    /// Samples a pixel of path tracing.
    samples: &'static [u32],
    /// Gather samples of the thesis's method.
    thesis: &'static [u32],
    /// Gather samples of ours.
    gather: &'static [u32],
    /// Rays a row.
    rays: &'static [u32],
    /// Errors that nested blocks are compressed to.
    errors: &'static [f64],
    /// Errors that wavelets are to keep.
    wavelets: &'static [f64],
    /// Longest side of the pictures of the thesis's scenes, in pixels.
    preview_side: u32,
    /// Numbers of lights to time edits among.
    lights: &'static [usize],
    /// Longest sides of pictures to time edits in, in pixels.
    sides: &'static [u32],
    /// Triangles to time edits with, at most.
    triangles: usize,
    /// Frames of an edit.
    frames: u32,
    /// Whether edits are timed in pictures of the scene's own size.
    whole_edits: bool,
}

const QUICK: Extent = Extent {
    side: 96,
    truth: 512,
    samples: &[2, 8, 32, 128],
    thesis: &[144, 576],
    gather: &[64, 256, 1024],
    rays: &[64, 256, 1024],
    errors: &[0.1, 0.03, 0.01],
    wavelets: &[0.1, 0.03],
    preview_side: 240,
    lights: &[2, 16, 128],
    sides: &[64, 128, 256],
    triangles: 100_000,
    frames: 20,
    whole_edits: false,
};

const FULL: Extent = Extent {
    side: 256,
    truth: 1024,
    samples: &[2, 4, 8, 16, 32, 64, 128, 256],
    thesis: &[144, 576, 2304],
    gather: &[256, 1024, 4096],
    rays: &[64, 256, 1024, 4096],
    errors: &[0.1, 0.03, 0.01, 0.003],
    wavelets: &[0.3, 0.1, 0.03],
    preview_side: 720,
    lights: &[2, 4, 16, 64, 256, 1024],
    sides: &[128, 256, 512, 1024],
    triangles: 5_000_000,
    frames: 60,
    whole_edits: true,
};

pub fn run(args: &Args) -> Result<()> {
    args.view.use_threads();
    let extent = if args.quick { &QUICK } else { &FULL };
    let scenes = if args.scenes.is_empty() { default_scenes(args.quick)? } else { args.scenes.clone() };
    // A mistake in the last name shows at once.
    let names = scenes.iter().map(|path| Ok(Scene::load(path)?.name())).collect::<Result<Vec<_>>>()?;
    if let Some(twice) = (0..names.len()).find(|&i| names[..i].contains(&names[i])) {
        let reason = "two scenes have this name, and would overwrite the files of each other";
        return Err(Error::invalid(scenes[twice].display().to_string(), reason));
    }
    std::fs::create_dir_all(&args.output).map_err(Error::io("create", &args.output))?;
    let mut kept = MeasurementStore::open(&args.output)?;
    let mut machine = Vec::new();
    let mut reports: Vec<SceneReport> = Vec::new();
    let (mut growth, mut layers, mut glossy_alone, mut stability) = (Vec::new(), None, None, Default::default());
    for path in &scenes {
        let mut lab = Lab::open(path, &args.view, args, extent, &mut kept)?;
        if machine.is_empty() {
            machine = machine::describe(&lab.context, args.view.seed)?;
        }
        let mut report = lab.measure()?;
        // The first scene stands for all.
        if reports.is_empty() {
            growth = lab.scaling()?;
            stability = (report.name.clone(), lab.stability()?);
        }
        // So does the first with mirrors, and the first with gloss.
        if layers.is_none() {
            layers = lab.against_layers()?;
        }
        if glossy_alone.is_none() && lab.is_glossy() {
            glossy_alone = thesis::glossy_alone(path, args, extent, &mut kept)?;
            report.skipped.extend(glossy_alone.iter_mut().flat_map(|(_, skipped)| std::mem::take(skipped)));
        }
        reports.push(report);
    }
    // Those are the default scenes' company.
    let thesis = if args.scenes.is_empty() { thesis::measure_all(args, extent, &mut kept)? } else { Thesis::default() };
    growth.extend(layers);
    machine.push(["load average at the end".into(), machine::load()]);
    let report = Report {
        when: format!("{} to {}", kept.since(), machine::now()),
        command: command(),
        quick: args.quick,
        machine,
        scenes: reports,
        thesis,
        glossy_alone: glossy_alone.map(|(alone, _)| alone),
        growth,
        stability,
        extreme: include_str!("../../../docs/extreme.md").into(),
        known_limits: known_limits(),
    };
    report::write(&args.output, &report)?;
    out!("{}", args.output.join("index.html").display())
}

/// Ours, the furnished room among them where `make_scenes` has made it, and the thesis's where they are at hand.
fn default_scenes(quick: bool) -> Result<Vec<PathBuf>> {
    let shipped = ["cornell-diffuse", "cornell-glossy", "balls-2"].map(|name| Path::new("scenes").join(name));
    let mut scenes: Vec<PathBuf> = shipped.iter().map(|path| path.with_extension("glb")).collect();
    if let Some(missing) = scenes.iter().find(|path| !path.exists()) {
        let reason = "is not here; name the scenes to measure, or start relume in its own folder";
        return Err(Error::invalid(missing.display().to_string(), reason));
    }
    scenes.extend(Some(PathBuf::from("scenes/generated/room.glb")).filter(|room| room.exists()));
    let theirs = ["buddha", "bunny-dragon-2"].iter().filter(|_| !quick).filter_map(|name| thesis::shared_scene(name));
    scenes.extend(theirs);
    Ok(scenes)
}

/// As it was given, so that it can be given again.
fn command() -> String {
    let plain = |word: &str| word.chars().all(|c| c.is_alphanumeric() || "-_./=,:+".contains(c)) && !word.is_empty();
    let quoted = |word: String| if plain(&word) { word } else { format!("'{}'", word.replace('\'', "'\\''")) };
    let words = std::env::args_os().skip(1).map(|word| quoted(word.to_string_lossy().into_owned()));
    std::iter::once("relume".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

/// Those of the documentation.
fn known_limits() -> String {
    let page = include_str!("../../../docs/limits.md");
    page[page.find("- ").expect("the page is a list")..].trim().to_owned()
}
