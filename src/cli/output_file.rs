//! Files that commands write: their folders, and JSON.

use std::path::Path;

use relume::storage::file::write_bytes;
use relume::{Error, Result};

/// Makes the folder that a file goes to, and refuses to write a file where a folder is.
pub fn make_parent(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Error::io("write", path)(std::io::ErrorKind::IsADirectory.into()));
    }
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => {
            std::fs::create_dir_all(parent).map_err(Error::io("create", parent))
        }
        _ => Ok(()),
    }
}

/// A name with nothing in it that would mean something to a file system.
pub fn as_file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_alphanumeric() || "-_".contains(c) { c } else { '_' }).collect()
}

/// Writes JSON as the whole of `path`.
pub fn write_json(path: &Path, json: &serde_json::Value) -> Result<()> {
    write_bytes(path, format!("{json:#}\n").as_bytes())
}
