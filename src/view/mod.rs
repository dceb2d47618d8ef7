//! The interactive window: keyboard and mouse edit the lights, and the picture is relit.
//!
//! One thread waits in winit's event loop. All pending events become one edit and one frame; at rest nothing is drawn.
//! Scenes load and bake on another thread, behind a progress bar. Direct light can be edited while indirect light
//! bakes.

mod autosave;
mod compare;
mod gather_marks;
mod graphics;
pub mod input;
mod interface;
mod light_view;
mod loading;
mod open_scene;
mod overlay;
mod panel;
mod refine;
mod remote;
mod serve;
pub mod shares;
mod shot_sheet;
mod still;
mod timings;
mod view_state;
pub mod views;
mod window;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use self::input::script::Script;
pub use self::loading::load::SceneSource;
pub use self::refine::gathered::GatheringState;
pub use self::serve::serve;
pub use self::window::run;
use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::gpu::{PassTime, Processor, Validation, Vsync};
use crate::image::display_view::DisplayConfig;
use crate::relight::{RelightSettings, ToneMap};
use crate::scene::Rig;
use crate::trace::bvh::TracedScene;

/// Settings of a window that are known before its scene is loaded.
pub struct ViewSettings {
    /// Name of the scene, for the title.
    pub name: String,
    /// File that `save` writes; `None` asks for a path.
    pub rig_path: Option<PathBuf>,
    pub pictures: PictureSettings,
    pub vsync: Vsync,
    /// Events to play.
    pub script: Option<Script>,
    /// File to which events are recorded.
    pub record: Option<PathBuf>,
    /// File that tells other programs how to connect; `None`: they cannot.
    pub listen: Option<PathBuf>,
    /// Time budget of a frame during a drag. A picture that exceeds it is drawn coarsely, and exactly at rest.
    pub frame_budget: Duration,
    /// View samples per pixel on edges once the lights rest; 1 adds none.
    pub rest_samples: u32,
    /// Error at which final gathering ends once the lights rest, relative to the mean luminance of the picture; `None`:
    /// nothing is gathered.
    pub final_error: Option<f64>,
    /// Whether [`ViewReport::trace`] is recorded; it grows with every frame.
    pub trace: bool,
}

/// How pictures are made and shown.
pub struct PictureSettings {
    /// Exposure in stops; `None` derives it from the first picture of all lights.
    pub exposure: Option<f32>,
    pub device: Option<String>,
    pub validation: Validation,
    pub cache_dir: Option<PathBuf>,
    pub relight: RelightSettings,
    pub tone_map: ToneMap,
    /// The configuration whose views the window offers.
    pub displays: Option<DisplayConfig>,
}

/// A loaded and baked scene.
#[derive(Clone)]
pub struct LoadedScene {
    pub scene: Arc<TracedScene>,
    pub framebuffer: Arc<DeepFramebuffer>,
    /// `None` until it is baked, or without indirect light.
    pub transfer: Option<Arc<Transfer>>,
    /// The lights of all shots, as they were loaded.
    pub rig: Rig,
    /// What changed since the last bake, if it had to be baked again.
    pub changed: Option<String>,
}

impl LoadedScene {
    /// Whether `transfer` is the one that is shown, not an equal one.
    fn has(&self, transfer: &Option<Arc<Transfer>>) -> bool {
        self.transfer.as_ref().map(Arc::as_ptr) == transfer.as_ref().map(Arc::as_ptr)
    }
}

/// Statistics of a window, for `--stats`.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ViewReport {
    pub device: String,
    pub driver: String,
    /// Time from the start to the first picture.
    pub first_picture_ms: Option<f64>,
    /// Time from the start to the first picture with indirect light.
    pub first_indirect_ms: Option<f64>,
    /// Part of the time to the first picture for the device and its pipelines.
    pub device_ms: f64,
    /// Number of frames drawn.
    pub frames: usize,
    /// Number of frames that relit the picture.
    pub relit_frames: usize,
    /// Number of relit frames that were coarse, to keep up with a drag.
    pub coarse_frames: usize,
    /// Latency of relit frames: from a frame's first event to the return of its presentation.
    pub latency_ms: Option<Latency>,
    /// Median times of the passes of relit frames.
    pub passes: Vec<PassReport>,
    /// Final gathering of the last picture.
    #[serde(rename = "final")]
    pub gathering: Option<GatheringState>,
    /// Start of each frame, in milliseconds since the window's start, and its passes; for `--trace`.
    #[serde(skip)]
    pub trace: Vec<(f64, Vec<PassTime>)>,
}

/// Median time of one pass.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PassReport {
    pub name: &'static str,
    pub on: Processor,
    pub median_ms: f64,
}

/// Statistics of latency, milliseconds.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Latency {
    pub best: f64,
    pub median: f64,
    pub p95: f64,
}
