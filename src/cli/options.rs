//! Options that several subcommands take; defaults as in their help.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::ValueEnum;
use relume::gpu::Validation;
use relume::image::display_view::DisplayConfig;
use relume::relight::{RelightSettings, ToneMap, VisibilityMethod};
use relume::scene::{Light, Scene};
use relume::session::{OpenSettings, Target, check_size, user_cache_dir};
use relume::view::PictureSettings;
use relume::{Error, Result, Session, SessionSettings};
use serde_json::Value;

use super::output_file::{make_parent, write_json};
use super::progress::Terminal;
use super::transfer::TransferOptions;

/// Which scene, and how it is seen.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Scene and bake")]
pub struct ViewOptions {
    /// Image size in pixels [default: the size in the scene file; else 480 pixels high, in the aspect ratio of the
    /// camera; else 720x480].
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Name of the camera to look from [default: the camera of the rig, else the first one of the scene]. all: `relume
    /// render` and `relume bake` take one camera of the scene after the other.
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Layers of the deep framebuffer. The first layer is the surface that a pixel sees; the next layers are what
    /// mirrors show there, one after the other. 1 shows no mirror reflections.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=32))]
    pub layers: u32,
    /// Removes the diffuse reflection (the diffuse lobe) of every material.
    #[arg(long)]
    pub strip_diffuse: bool,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Number of CPU threads [default: all].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Option<u32>,
}

/// Where baked data is kept.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Scene and bake")]
pub struct CacheOptions {
    /// Folder for baked data [default: `relume` in the cache folder of the user, usually ~/.cache].
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Reads no baked data and stores none.
    #[arg(long, conflicts_with = "cache")]
    pub no_cache: bool,
}

/// Which scene, and how it is baked.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Scene and bake")]
pub struct SceneOptions {
    #[command(flatten)]
    pub view: ViewOptions,
    /// Anti-aliasing: number of view samples in a pixel on an edge. All other pixels have one [default: 1; `relume
    /// view` uses 8 when lights rest].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: Option<u32>,
    /// Also calculates what a bake leaves out because the scene does not need it: all mirror layers over all pixels, a
    /// BRDF and a specular lobe for each view sample. The picture is the same. docs/options.md tells what this does not
    /// cover.
    #[arg(long)]
    pub force_all: bool,
    #[command(flatten)]
    pub cache: CacheOptions,
    #[command(flatten)]
    pub transfer: TransferOptions,
}

/// How shadows are found.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Light and picture")]
pub struct ShadowOptions {
    /// How shadows are found. map: shadow maps with percentage-closer filtering. traced: exact rays on the CPU. auto:
    /// the faster one, measured once on each device; traced if a material blends.
    #[arg(long, value_enum, value_name = "METHOD", default_value = "auto", hide_possible_values = true)]
    pub visibility: Visibility,
    /// Width and height of a shadow map in texels.
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(16..=16384))]
    pub shadow_size: u32,
}

/// What the pictures are calculated on.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Light and picture")]
pub struct DeviceOptions {
    /// Vulkan device: its index in `relume devices`, or a part of its name [default: the fastest
    /// one, measured once on each device].
    #[arg(long, value_name = "NAME|INDEX")]
    pub device: Option<String>,
    /// Device memory for light images and for the transfer, like 2000000000, 500M or 2G [default: three quarters of the
    /// device's memory]. With a smaller budget the picture is the same, but slower. Without a GPU the transfer takes
    /// none.
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes)]
    pub budget: Option<u64>,
}

/// How scene-linear pictures are shown.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Light and picture")]
pub struct DisplayOptions {
    /// Shows PNG images and the window through an OpenColorIO configuration, not a tone curve: a file (.ocio, .ocioz),
    /// or a built-in one, like ocio://default, which is ACES 2.
    #[arg(long, value_name = "CONFIG", conflicts_with = "tonemap")]
    pub ocio: Option<String>,
    /// Display of that configuration [default: its first].
    #[arg(long, value_name = "NAME", requires = "ocio")]
    pub display: Option<String>,
    /// View of that display [default: its first].
    #[arg(long, value_name = "NAME", requires = "ocio")]
    pub view: Option<String>,
    /// Tone curve of PNG images and of the window. EXR images are always scene-linear.
    #[arg(long, value_enum, value_name = "CURVE", default_value = "agx")]
    pub tonemap: Tonemap,
    /// Exposure of PNG images and of the window, in stops. auto: relume chooses it once, from the first rig.
    #[arg(long, value_name = "STOPS|auto", default_value = "auto", allow_hyphen_values = true, value_parser = parse_exposure)]
    pub exposure: Exposure,
}

/// How a baked scene is lit and shown.
#[derive(clap::Args, Clone)]
pub struct LightOptions {
    #[command(flatten)]
    pub shadows: ShadowOptions,
    #[command(flatten)]
    pub device: DeviceOptions,
    #[command(flatten)]
    pub display: DisplayOptions,
}

/// Where a run tells about itself.
#[derive(clap::Args, Clone)]
pub struct RecordOptions {
    /// Writes figures of the run to this file, as JSON: times, sizes, errors.
    #[arg(long, value_name = "FILE")]
    pub stats: Option<PathBuf>,
    /// Writes a trace to this file: when each step ran. Open it in Perfetto or chrome://tracing.
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Visibility {
    Auto,
    Map,
    Traced,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Tonemap {
    None,
    Agx,
    PbrNeutral,
    /// One colour for each stop of luminance. Middle grey is grey.
    FalseColor,
}

#[derive(Clone, Copy, PartialEq)]
pub enum Exposure {
    Auto,
    Stops(f32),
}

impl From<Visibility> for VisibilityMethod {
    fn from(v: Visibility) -> Self {
        match v {
            Visibility::Auto => Self::Auto,
            Visibility::Map => Self::Map,
            Visibility::Traced => Self::Traced,
        }
    }
}

impl DisplayOptions {
    /// The OpenColorIO configuration, if one is asked for. Fails if it cannot be read.
    pub fn config(&self) -> Result<Option<DisplayConfig>> {
        self.ocio.as_deref().map(DisplayConfig::load).transpose()
    }

    /// The tone curve, or the view of `config`. Fails if there is no such view.
    pub fn tone_map(&self, config: Option<&DisplayConfig>) -> Result<ToneMap> {
        Ok(match (config, self.tonemap) {
            (Some(config), _) => ToneMap::View(Arc::new(config.view(self.display.as_deref(), self.view.as_deref())?)),
            (None, Tonemap::None) => ToneMap::None,
            (None, Tonemap::Agx) => ToneMap::Agx,
            (None, Tonemap::PbrNeutral) => ToneMap::PbrNeutral,
            (None, Tonemap::FalseColor) => ToneMap::FalseColor,
        })
    }
}

impl ViewOptions {
    /// The options as they are given on a command line, without camera and threads.
    pub fn arguments(&self) -> Vec<String> {
        let size = self.size.map(|[width, height]| format!("--size={width}x{height}"));
        let strip_diffuse = self.strip_diffuse.then(|| "--strip-diffuse".to_owned());
        let numbers = [format!("--layers={}", self.layers), format!("--seed={}", self.seed)];
        size.into_iter().chain(strip_diffuse).chain(numbers).collect()
    }

    pub fn settings(&self) -> OpenSettings {
        OpenSettings { size: self.size, camera: self.camera.clone(), strip_diffuse: self.strip_diffuse }
    }

    /// The names of all cameras of a scene, if all are asked for.
    pub fn all_cameras(&self, scene: &Path) -> Result<Vec<String>> {
        if self.camera.as_deref() != Some("all") {
            return Ok(Vec::new());
        }
        let cameras: Vec<String> = Scene::load(scene)?.cameras.into_iter().map(|camera| camera.name).collect();
        if cameras.is_empty() {
            return Err(Error::import(scene, "has no cameras"));
        }
        Ok(cameras)
    }

    /// Before any work is done.
    pub fn use_threads(&self) {
        let Some(threads) = self.threads else { return };
        // Fails only if the pool is running already, with the number that an earlier call chose.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global();
    }
}

impl ShadowOptions {
    pub fn relight_settings(&self, device: &DeviceOptions) -> RelightSettings {
        RelightSettings {
            visibility: self.visibility.into(),
            shadow_size: self.shadow_size,
            budget_bytes: device.budget,
            ..RelightSettings::default()
        }
    }

    /// Fails if there is no such device.
    pub fn target(&self, device: &DeviceOptions, cache: &CacheOptions) -> Result<Target> {
        Target::new(device.device.as_deref(), cache.dir().as_deref(), self.relight_settings(device))
    }
}

impl LightOptions {
    pub fn relight_settings(&self) -> RelightSettings {
        self.shadows.relight_settings(&self.device)
    }

    pub fn target(&self, cache: &CacheOptions) -> Result<Target> {
        self.shadows.target(&self.device, cache)
    }

    /// For pictures that are edited.
    pub fn picture_settings(&self, cache_dir: Option<PathBuf>) -> Result<PictureSettings> {
        let displays = self.display.config()?;
        Ok(PictureSettings {
            exposure: match self.display.exposure {
                Exposure::Auto => None,
                Exposure::Stops(stops) => Some(stops),
            },
            device: self.device.device.clone(),
            validation: if cfg!(debug_assertions) { Validation::On } else { Validation::Off },
            cache_dir,
            relight: self.relight_settings(),
            tone_map: self.display.tone_map(displays.as_ref())?,
            displays,
        })
    }
}

impl CacheOptions {
    /// The cache folder, or `None` if nothing is kept.
    pub fn dir(&self) -> Option<PathBuf> {
        if self.no_cache { None } else { self.cache.clone().or_else(user_cache_dir) }
    }
}

impl RecordOptions {
    pub fn is_wanted(&self) -> bool {
        self.stats.is_some() || self.trace.is_some()
    }

    /// Makes the folders of the files, before any work is done.
    pub fn make_parents(&self) -> Result<()> {
        self.files().try_for_each(make_parent)
    }

    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.stats.iter().chain(&self.trace).map(PathBuf::as_path)
    }

    /// Writes what is asked for.
    pub fn write(&self, stats: impl FnOnce() -> Value, trace: impl FnOnce() -> Value) -> Result<()> {
        if let Some(path) = &self.stats {
            write_json(path, &stats())?;
        }
        self.trace.as_ref().map_or(Ok(()), |path| write_json(path, &trace()))
    }
}

impl SceneOptions {
    pub fn settings(&self) -> Result<SessionSettings> {
        Ok(SessionSettings {
            open: self.view.settings(),
            layers: self.view.layers,
            samples: self.samples.unwrap_or(1),
            force_all: self.force_all,
            seed: self.view.seed,
            cache_dir: self.cache.dir(),
            indirect: self.transfer.settings()?,
            target: None,
            other_lights: Vec::new(),
        })
    }

    /// Opens and bakes all of a scene, for pictures on `target`.
    pub fn open(&self, path: &Path, rig: Option<&Path>, target: Option<Target>) -> Result<Session> {
        self.open_for(path, rig, Vec::new(), target)
    }

    /// The same for pictures of other lights too.
    pub fn open_for(
        &self,
        path: &Path,
        rig: Option<&Path>,
        other_lights: Vec<Light>,
        target: Option<Target>,
    ) -> Result<Session> {
        self.view.use_threads();
        let settings = SessionSettings { target, other_lights, ..self.settings()? };
        Session::open(path, rig, &settings, &Terminal::default())
    }

    /// Opens and bakes all but indirect light.
    pub fn open_direct(&self, path: &Path, rig: Option<&Path>, progress: &Terminal) -> Result<Session> {
        self.view.use_threads();
        Session::open_direct(path, rig, &self.settings()?, progress)
    }
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let parsed = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let size: [u32; 2] = parsed.ok_or("expected WIDTHxHEIGHT in pixels, like 720x480")?;
    check_size(size).map(|()| size)
}

/// From candles to suns and back is 50 stops; a factor of 2^100 times any sane radiance still is a number.
const MAX_STOPS: f32 = 100.0;

pub fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| *seconds > 0.0 && *seconds <= 1e8);
    seconds.ok_or("expected a time in seconds: more than 0, at most 1e8".into())
}

pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let (digits, factor) = match text.to_ascii_uppercase().trim_end_matches('B') {
        t if t.ends_with('G') => (t.trim_end_matches('G').to_owned(), 1e9),
        t if t.ends_with('M') => (t.trim_end_matches('M').to_owned(), 1e6),
        t if t.ends_with('K') => (t.trim_end_matches('K').to_owned(), 1e3),
        t => (t.to_owned(), 1.0),
    };
    let number: f64 = digits.parse().map_err(|_| "expected a number of bytes, like 2G")?;
    if number >= 0.0 && number.is_finite() {
        Ok((number * factor) as u64)
    } else {
        Err("expected a number of bytes that is not negative, like 2G".into())
    }
}

fn parse_exposure(text: &str) -> Result<Exposure, String> {
    match text {
        "auto" => Ok(Exposure::Auto),
        _ => text
            .parse::<f32>()
            .ok()
            .filter(|stops| stops.abs() <= MAX_STOPS)
            .map(Exposure::Stops)
            .ok_or(format!("expected auto, or stops from -{MAX_STOPS} to {MAX_STOPS}, like -1.5")),
    }
}

/// Refuses an output whose extension is none of `extensions`, before any work is done.
pub fn check_extension(path: &Path, extensions: &[&str]) -> Result<()> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extensions.contains(&extension.as_str()) {
        true => Ok(()),
        false => {
            let reason = format!("the file name must end in .{}", extensions.join(" or ."));
            Err(Error::invalid(path.display().to_string(), reason))
        }
    }
}
