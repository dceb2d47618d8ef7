//! The one error type. Every variant says what was being done to what; causes are kept, never folded.

use std::path::{Path, PathBuf};

/// The cause of an error, whatever library it came from.
pub type Cause = Box<dyn std::error::Error + Send + Sync>;
pub type Result<T, E = Error> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be opened, read, written or renamed.
    #[error("cannot {action} {}", .path.display())]
    Io { action: &'static str, path: PathBuf, source: std::io::Error },

    /// A scene, rig or image file says something that we cannot use.
    #[error("{}: {reason}", .path.display())]
    Import { path: PathBuf, reason: String, source: Option<Cause> },

    /// An image, cache or report file could not be encoded.
    #[error("cannot encode {}", .path.display())]
    Export { path: PathBuf, source: Cause },

    /// What was asked for cannot be done with this scene or on this machine.
    #[error("{what}: {reason}")]
    Invalid { what: String, reason: String },

    /// Who waited for the work waits no more.
    #[error("cancelled")]
    Cancelled,

    /// No Vulkan device fits.
    #[error("no Vulkan device: {reason}")]
    NoDevice { reason: String, source: Option<Cause> },

    /// There is no display, or it opens no window.
    #[error("cannot open a window; `relume render` makes pictures without one")]
    NoWindow { source: Cause },

    /// A Vulkan call failed.
    #[error("Vulkan could not {action}")]
    Vulkan { action: String, source: Cause },

    /// A shader did not compile, or a pipeline could not be made of it.
    #[error("shader {kernel}: {log}")]
    Shader { kernel: String, log: String },
}

impl Error {
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source }
    }

    pub fn import(path: &Path, reason: impl Into<String>) -> Self {
        Self::Import { path: path.to_owned(), reason: reason.into(), source: None }
    }

    pub fn import_from(path: &Path, reason: impl Into<String>, source: impl Into<Cause>) -> Self {
        Self::Import { path: path.to_owned(), reason: reason.into(), source: Some(source.into()) }
    }

    pub fn invalid(what: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Invalid { what: what.into(), reason: reason.into() }
    }
}
