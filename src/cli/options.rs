//! Options that several subcommands take; defaults as in their help.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use relume::relight::{RelightSettings, ToneMap, VisibilityMethod};
use relume::session::{OpenSettings, check_size, user_cache_dir};
use relume::{Error, Result, Session, SessionSettings};

use super::progress::Terminal;
use super::transfer::TransferOptions;

/// Which scene, and how it is seen.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Scene and bake")]
pub struct ViewOptions {
    /// Image size in pixels [default: the scene's own, else 480 rows of the camera's aspect ratio, else 720x480].
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Camera node to look from, by name [default: the rig's camera, else the first].
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Mirror layers; 1 has no reflections.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=32))]
    pub layers: u32,
    /// Removes the diffuse lobe of every material.
    #[arg(long)]
    pub strip_diffuse: bool,
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// CPU threads [default: all].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Option<u32>,
}

/// Which scene, and how it is baked.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Scene and bake")]
pub struct SceneOptions {
    #[command(flatten)]
    pub view: ViewOptions,
    /// View samples a pixel; more than one only where edges lie [default: 1; of a window 8, once lights rest].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: Option<u32>,
    /// Leaves nothing of the deep framebuffer out: all mirror layers over all pixels, a BRDF and a specular lobe for each view
    /// sample, an image of emission. The picture is the same.
    #[arg(long)]
    pub force_all: bool,
    /// Where baked data lives [default: relume in the user's cache directory, ~/.cache as a rule].
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Bakes anew and stores nothing.
    #[arg(long, conflicts_with = "cache")]
    pub no_cache: bool,
    #[command(flatten)]
    pub transfer: TransferOptions,
}

/// How a baked scene is lit.
#[derive(clap::Args, Clone)]
#[command(next_help_heading = "Light and picture")]
pub struct LightOptions {
    /// Shadow maps with percentage-closer filtering, or exact rays on the CPU; auto: what is faster on the device.
    #[arg(long, value_enum, value_name = "METHOD", default_value = "auto")]
    pub visibility: Visibility,
    /// Side of a shadow map in texels.
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(16..=16384))]
    pub shadow_size: u32,
    /// Vulkan device, by index or part of its name [default: the best real GPU, else the CPU].
    #[arg(long, value_name = "NAME|INDEX")]
    pub device: Option<String>,
    /// Device memory for light images and factors of indirect light, as 2000000000, 500M or 2G [default: three quarters of
    /// the device's].
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes)]
    pub budget: Option<u64>,
    /// Tone curve of PNG images; EXR is always scene-linear.
    #[arg(long, value_enum, value_name = "CURVE", default_value = "agx")]
    pub tonemap: Tonemap,
    /// Exposure of PNG images in stops, or `auto`: fixed once, from the first rig as loaded.
    #[arg(long, value_name = "STOPS|auto", default_value = "auto", allow_hyphen_values = true, value_parser = parse_exposure)]
    pub exposure: Exposure,
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
    /// A colour a stop of luminance; middle grey is grey.
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

impl From<Tonemap> for ToneMap {
    fn from(t: Tonemap) -> Self {
        match t {
            Tonemap::None => Self::None,
            Tonemap::Agx => Self::Agx,
            Tonemap::PbrNeutral => Self::PbrNeutral,
            Tonemap::FalseColor => Self::FalseColor,
        }
    }
}

impl ViewOptions {
    pub fn settings(&self) -> OpenSettings {
        OpenSettings { size: self.size, camera: self.camera.clone(), strip_diffuse: self.strip_diffuse }
    }

    /// Before any work is done.
    pub fn use_threads(&self) {
        let Some(threads) = self.threads else { return };
        // Fails only if the pool is running already, with the number that an earlier call chose.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global();
    }
}

impl LightOptions {
    pub fn relight_settings(&self) -> RelightSettings {
        RelightSettings { visibility: self.visibility.into(), shadow_size: self.shadow_size, budget_bytes: self.budget }
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
            cache_dir: self.cache_dir(),
            indirect: self.transfer.settings()?,
        })
    }

    /// Opens and bakes all of a scene.
    pub fn open(&self, path: &Path, rig: Option<&Path>) -> Result<Session> {
        self.view.use_threads();
        Session::open(path, rig, &self.settings()?, &Terminal::default())
    }

    /// The cache directory, or `None` if nothing is kept.
    pub fn cache_dir(&self) -> Option<PathBuf> {
        if self.no_cache { None } else { self.cache.clone().or_else(user_cache_dir) }
    }
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let parsed = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let size: [u32; 2] = parsed.ok_or("expected WIDTHxHEIGHT, like 720x480")?;
    check_size(size).map(|()| size)
}

/// From candles to suns and back is 50 stops; a factor of 2^100 times any sane radiance still is a number.
const MAX_STOPS: f32 = 100.0;

fn parse_bytes(text: &str) -> Result<u64, String> {
    let (digits, factor) = match text.to_ascii_uppercase().trim_end_matches('B') {
        t if t.ends_with('G') => (t.trim_end_matches('G').to_owned(), 1e9),
        t if t.ends_with('M') => (t.trim_end_matches('M').to_owned(), 1e6),
        t if t.ends_with('K') => (t.trim_end_matches('K').to_owned(), 1e3),
        t => (t.to_owned(), 1.0),
    };
    let number: f64 = digits.parse().map_err(|_| "expected a number of bytes, like 2G")?;
    if number >= 0.0 && number.is_finite() { Ok((number * factor) as u64) } else { Err("not a size".into()) }
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
            Err(Error::invalid(path.display().to_string(), format!("expected a name in .{}", extensions.join(" or ."))))
        }
    }
}
