//! The crate's error type. Every variant names the failed action and its object, and retains the cause.

use std::path::{Path, PathBuf};

/// The cause of an error, whatever library it came from.
pub type Cause = Box<dyn std::error::Error + Send + Sync>;
/// A result whose error is [`Error`] by default.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// All errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be opened, read, written or renamed.
    #[error("cannot {action} {}", .path.display())]
    Io { action: &'static str, path: PathBuf, source: std::io::Error },

    /// A scene, rig or image file has invalid or unsupported content.
    #[error("{}: {reason}", .path.display())]
    Import { path: PathBuf, reason: String, source: Option<Cause> },

    /// An image, cache or report file could not be encoded.
    #[error("cannot encode {}", .path.display())]
    Export { path: PathBuf, source: Cause },

    /// The request cannot be carried out with this scene or on this machine.
    #[error("{what}: {reason}")]
    Invalid { what: String, reason: String },

    /// The caller cancelled the operation.
    #[error("cancelled")]
    Cancelled,

    /// No suitable Vulkan device was found.
    #[error("no Vulkan device: {reason}")]
    NoDevice { reason: String, source: Option<Cause> },

    /// There is no display, or it cannot open a window.
    #[error("cannot open a window; `relume render` makes pictures without one")]
    NoWindow { source: Cause },

    /// A Vulkan call failed.
    #[error("Vulkan could not {action}")]
    Vulkan { action: String, source: Cause },

    /// A shader did not compile, or its pipeline could not be created.
    #[error("shader {kernel}: {log}")]
    Shader { kernel: String, log: String },
}

impl Error {
    /// Wraps an I/O error: `action` is the verb that failed on `path`.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source }
    }

    /// An invalid file, without an underlying error.
    pub fn import(path: &Path, reason: impl Into<String>) -> Self {
        Self::Import { path: path.to_owned(), reason: reason.into(), source: None }
    }

    /// An invalid file, with the underlying error.
    pub fn import_from(path: &Path, reason: impl Into<String>, source: impl Into<Cause>) -> Self {
        Self::Import { path: path.to_owned(), reason: reason.into(), source: Some(source.into()) }
    }

    /// The error and its causes on one line.
    pub fn chain(&self) -> String {
        let causes = std::iter::successors(std::error::Error::source(self), |cause| cause.source());
        let text = causes.fold(self.to_string(), |text, cause| format!("{text}: {cause}"));
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    /// A request that cannot be carried out: `what` and why.
    pub fn invalid(what: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Invalid { what: what.into(), reason: reason.into() }
    }
}
