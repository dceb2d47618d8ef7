//! What the thread that reads environment maps sends to the window.

use std::path::PathBuf;
use std::time::SystemTime;

use egui::ColorImage;

use crate::scene::SkyMap;
use crate::scene::light_filter::Attached;

/// What the thread did; errors say why it could not.
pub enum Answer {
    Listed(PathBuf, Result<Vec<MapFile>, String>),
    Read(MapFile, Result<ReadMap, String>),
}

/// A map that was read.
pub struct ReadMap {
    pub thumbnail: ColorImage,
    /// `None` if it was not to be kept.
    pub map: Option<Attached<SkyMap>>,
}

/// A file, and when it was written as far as the system tells. Equal files have equal content.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct MapFile {
    pub path: PathBuf,
    written: Option<SystemTime>,
}

impl MapFile {
    pub fn new(path: PathBuf) -> Self {
        let written = path.metadata().and_then(|metadata| metadata.modified()).ok();
        Self { path, written }
    }

    pub fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}
