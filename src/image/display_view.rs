//! Views of OpenColorIO configurations: from scene-linear Rec. 709 to the values of a display. They are evaluated by
//! the crate `ocio`, a port of the library to Rust.

use std::fmt;
use std::path::Path;

use ocio::config::config_utils::identify_interchange_space;
use ocio::config::logging::LogGuard;
use ocio::{Config, CpuProcessor, LoggingLevel, TransformDirection};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::storage::file;

/// Our radiance, by its name in the built-in configuration.
const SCENE_LINEAR: &str = "lin_rec709_srgb";
/// Pixels that a thread transforms at a time. 4096: 48 KiB, half of a second-level cache.
const CHUNK_PIXELS: usize = 4096;

/// An OpenColorIO configuration: displays, and the views of each.
pub struct DisplayConfig {
    /// As the user named it.
    name: String,
    config: Config,
    /// Defines [`SCENE_LINEAR`].
    builtin: Config,
}

/// A view of a display.
pub struct DisplayView {
    display: String,
    view: String,
    processor: CpuProcessor,
}

impl DisplayConfig {
    /// Reads a configuration: a file (.ocio or .ocioz), or a built-in one by its URI, such as `ocio://default`. Fails
    /// if there is no such configuration, or it is malformed.
    pub fn load(name: &str) -> Result<Self> {
        let path = Path::new(name);
        if !name.starts_with("ocio://") {
            file::open(path)?; // with the system's own reason if it cannot be read
        }
        let config = warned(|| Config::create_from_file(name))
            .map_err(|cause| Error::import_from(path, "not a readable OpenColorIO configuration", cause))?;
        let builtin = Config::create_from_file("ocio://default").expect("it is part of the library");
        Ok(Self { name: name.to_owned(), config, builtin })
    }

    /// Names of the displays, the default one first.
    pub fn displays(&self) -> Vec<String> {
        (0..self.config.num_displays()).map(|index| self.config.display(index)).collect()
    }

    /// Names of the views of a display, the default one first; none if there is no such display.
    pub fn views(&self, display: &str) -> Vec<String> {
        (0..self.config.num_views(display)).map(|index| self.config.view(display, index)).collect()
    }

    /// The view of a display; `None` is the configuration's default display, and the display's default view. Fails if
    /// there is none of that name, a file of it cannot be read, or the configuration does not tell how its colours
    /// relate to Rec. 709.
    pub fn view(&self, display: Option<&str>, view: Option<&str>) -> Result<DisplayView> {
        let display = self.chosen("display", display, &self.displays())?;
        let view = self.chosen("view", view, &self.views(&display))?;
        let Self { config, builtin, .. } = self;
        let processor = warned(|| {
            let (interchange, of_builtin) = identify_interchange_space(config, "", builtin, SCENE_LINEAR)?;
            Config::get_processor_from_configs_display_view_interchange(
                builtin,
                SCENE_LINEAR,
                &of_builtin,
                config,
                &display,
                &view,
                &interchange,
                TransformDirection::Forward,
            )
        });
        let processor = processor.map_err(|cause| {
            Error::import_from(Path::new(&self.name), format!("cannot make the view {view:?} of {display:?}"), cause)
        })?;
        Ok(DisplayView { display, view, processor: processor.default_cpu_processor() })
    }

    /// The asked name, as the configuration spells it, or the first.
    fn chosen(&self, what: &str, asked: Option<&str>, names: &[String]) -> Result<String> {
        let found = match asked {
            Some(asked) => names.iter().find(|name| name.eq_ignore_ascii_case(asked)),
            None => names.first(),
        };
        found.cloned().ok_or_else(|| {
            let reason = match asked {
                Some(asked) => format!("has no {what} {asked:?}; it has {}", names.join(", ")),
                None => format!("has no {what}"),
            };
            Error::import(Path::new(&self.name), reason)
        })
    }
}

/// The outcome of `work`, with the library's warnings among ours.
fn warned<T>(work: impl FnOnce() -> T) -> T {
    let log = LogGuard::with_level(LoggingLevel::Warning);
    let outcome = work();
    for line in log.output().lines() {
        tracing::warn!("{line}");
    }
    outcome
}

impl DisplayView {
    /// Transforms exposed scene-linear Rec. 709, in place, to values of the display; those that it can show are in [0,
    /// 1].
    pub fn apply(&self, pixels: &mut [[f32; 3]]) {
        pixels.par_chunks_mut(CHUNK_PIXELS).for_each(|chunk| self.processor.apply_rgb_slice(chunk.as_flattened_mut()));
    }

    pub fn display(&self) -> &str {
        &self.display
    }

    pub fn name(&self) -> &str {
        &self.view
    }

    /// Whether its values are sRGB.
    pub fn is_srgb(&self) -> bool {
        self.display.to_ascii_lowercase().starts_with("srgb")
    }
}

impl fmt::Debug for DisplayView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.view, self.display)
    }
}

/// Two views are equal if they are the same one, not if they do the same.
impl PartialEq for DisplayView {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }
}
