//! The window: lights follow keyboard and mouse, and the picture follows the lights.
//!
//! One thread waits at one place, winit's event loop. Whatever happened by then is taken in as one edit, one frame is
//! made of it, and at rest nothing is drawn. Scenes load and bake on another thread, behind a progress bar; indirect light is
//! baked while direct light can be edited already.

mod aids;
mod autosave;
mod compare;
mod controls;
mod converge;
mod describe;
pub mod desk;
mod gather;
mod gizmo;
mod graphics;
pub mod history;
mod input_state;
mod interface;
pub mod keys;
mod light_values;
mod lights_list;
mod load;
mod look;
mod overlay;
mod pace;
mod pick;
mod profile;
pub mod script;
pub mod shares;
mod snapshots;
mod stage;
mod still;
mod timings;
pub mod views;
mod window;
mod wipe;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

pub use self::load::Loader;
pub use self::window::run;
use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::gpu::{PassTime, Site, Validation, Vsync};
use crate::relight::{RelightSettings, ToneMap};
use crate::scene::Rig;
use crate::trace::bvh::TracedScene;

/// What a window needs to know before its scene is loaded.
pub struct ViewSettings {
    /// Of the scene, for the title.
    pub name: String,
    /// Where `save` writes; without it, it asks.
    pub rig_path: Option<PathBuf>,
    /// Stops; `None` takes them from the first picture.
    pub exposure: Option<f32>,
    pub device: Option<String>,
    pub validation: Validation,
    pub cache_dir: Option<PathBuf>,
    pub relight: RelightSettings,
    pub tone_map: ToneMap,
    pub vsync: Vsync,
    /// Events to play, and where to write those that happen.
    pub script: Option<script::Script>,
    pub record: Option<PathBuf>,
    /// What a frame may take while a hand drags; a picture that takes longer is made coarser, and finished at rest.
    pub frame_budget: Duration,
    /// View samples of a pixel on an edge once lights rest; 1: no more than while they move.
    pub rest_samples: u32,
    /// Whether [`ViewReport::trace`] is wanted: it grows with every frame.
    pub trace: bool,
}

/// A loaded and baked scene.
pub struct Opened {
    pub scene: Arc<TracedScene>,
    pub framebuffer: Arc<DeepFramebuffer>,
    /// Absent until it is baked, or where none is wanted.
    pub transfer: Option<Arc<Transfer>>,
    pub rig: Rig,
}

/// What a window did, for `--stats`.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ViewReport {
    pub device: String,
    pub driver: String,
    /// From the start to the first picture, and the part of it that device and pipelines took.
    pub first_picture_ms: Option<f64>,
    pub device_ms: f64,
    /// Frames drawn, and those among them that relit the picture.
    pub frames: usize,
    pub relit_frames: usize,
    /// Of these, those that were made coarsely to keep up with a hand.
    pub coarse_frames: usize,
    /// From a frame's first event to the return of its presentation, of frames that relit the picture.
    pub latency_ms: Option<Latency>,
    /// Median milliseconds of each pass of those frames.
    pub passes: Vec<PassReport>,
    /// When each frame began, in milliseconds since the start, and its passes; for `--trace`.
    #[serde(skip)]
    pub trace: Vec<(f64, Vec<PassTime>)>,
}

#[derive(Clone, Debug, serde::Serialize)]
pub struct PassReport {
    pub name: &'static str,
    pub on: Site,
    pub median_ms: f64,
}

#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Latency {
    pub best: f64,
    pub median: f64,
    pub p95: f64,
}
