//! Files that commands write: their folders, and JSON.

use std::path::{Path, PathBuf};

use relume::storage::file::{folder_of, without_links, write_bytes};
use relume::{Error, Result};

/// Makes the folder that a file goes to, and refuses to write a file where a folder is.
pub fn make_parent(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Error::io("write", path)(std::io::ErrorKind::IsADirectory.into()));
    }
    let folder = folder_of(path);
    std::fs::create_dir_all(folder).map_err(Error::io("create", folder))
}

/// Refuses, before any work is done, outputs that would replace an input or each other.
pub fn check_outputs<'a>(
    inputs: impl IntoIterator<Item = &'a Path>,
    outputs: impl IntoIterator<Item = &'a Path>,
) -> Result<()> {
    let inputs: Vec<PathBuf> = inputs.into_iter().map(without_links).collect();
    let mut seen = Vec::new();
    for output in outputs {
        // Devices and pipes take several.
        if output.exists() && !output.is_file() {
            continue;
        }
        let at = without_links(output);
        let refuse = |reason: &str| Err(Error::invalid(output.display().to_string(), reason));
        if inputs.contains(&at) {
            return refuse("is read by this command and would be written over; choose another name");
        }
        if seen.contains(&at) {
            return refuse("would be written twice; choose different names");
        }
        seen.push(at);
    }
    Ok(())
}

/// A name with nothing in it that would mean something to a file system.
pub fn as_file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_alphanumeric() || "-_".contains(c) { c } else { '_' }).collect()
}

/// Writes JSON as the whole of `path`.
pub fn write_json(path: &Path, json: &serde_json::Value) -> Result<()> {
    write_bytes(path, format!("{json:#}\n").as_bytes())
}
