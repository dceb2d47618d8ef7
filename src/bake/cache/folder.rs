//! A cache folder: what is in it, and what of it may go. Several processes use it at a time, on several machines.
//!
//! Correct use needs no locks: files are written aside and renamed, and content names them. Locks only tell what is in
//! use.

use std::cmp::Reverse;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use super::{Reader, files, is_bake};
use crate::error::{Error, Result};
use crate::storage::file::{is_temporary, open};
use crate::storage::mapped::Mapping;

/// One file of the cache.
#[derive(Clone, Debug)]
pub struct Entry {
    pub path: PathBuf,
    pub bytes: u64,
    /// Since a bake was last used, or the file was written.
    pub age: Duration,
    /// Of a finished bake.
    pub scene: String,
    /// "deep framebuffer", "transfer" or "light of the sky"; of what is not finished: what it is.
    pub what: String,
    pub size: String,
}

/// What a cache folder keeps when it is pruned.
#[derive(Clone, Copy, Debug, Default)]
pub struct Keep {
    /// Files that were used in this time.
    pub younger_than: Option<Duration>,
    /// The files that were used last, up to so many bytes together.
    pub bytes: Option<u64>,
}

/// What pruning did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pruned {
    /// Files and their bytes.
    pub removed: (usize, u64),
    /// Files that would have gone, if no process used them.
    pub in_use: usize,
}

/// All files of bakes in a cache folder, those that were used last first. Reads only headers.
pub fn list(dir: &Path) -> Result<Vec<Entry>> {
    let mut entries: Vec<Entry> = ours(dir)?.iter().filter_map(|path| entry(path)).collect();
    entries.sort_by(|a, b| a.age.cmp(&b.age).then_with(|| a.path.cmp(&b.path)));
    Ok(entries)
}

/// Removes what `keep` does not name, but for files in use. A bake that is removed is made again when it is needed. If
/// some file cannot be removed, all others are, and the error names it.
pub fn prune(dir: &Path, keep: Keep) -> Result<Pruned> {
    let mut pruned = Pruned::default();
    let mut found: Vec<(SystemTime, u64, PathBuf)> = ours(dir)?.into_iter().filter_map(state).collect();
    found.sort_by_key(|(used, ..)| Reverse(*used));
    let (mut sum, mut failure) = (0, None);
    for (used, bytes, path) in found {
        sum += bytes;
        let is_young = keep.younger_than.is_some_and(|time| age(used) < time);
        let is_within = keep.bytes.is_some_and(|most| sum <= most);
        let goes = match (keep.younger_than, keep.bytes) {
            (Some(_), Some(_)) => !is_young || !is_within,
            _ => !is_young && !is_within,
        };
        if goes {
            match remove(&path, used) {
                Ok(Outcome::Removed) => pruned.removed = (pruned.removed.0 + 1, pruned.removed.1 + bytes),
                Ok(Outcome::InUse) => pruned.in_use += 1,
                Ok(Outcome::Gone) => {}
                Err(error) => _ = failure.get_or_insert(error),
            }
        }
    }
    failure.map_or(Ok(pruned), Err)
}

/// Finished bakes, interrupted ones, parts, and files that are being written.
fn ours(dir: &Path) -> Result<Vec<PathBuf>> {
    files(dir, |name| name.starts_with("bake-") || is_temporary(name))
}

/// When a file was last used, and its bytes; `None` if it has gone.
fn state(path: PathBuf) -> Option<(SystemTime, u64, PathBuf)> {
    let metadata = path.metadata().ok()?;
    Some((metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH), metadata.len(), path))
}

fn age(used: SystemTime) -> Duration {
    SystemTime::now().duration_since(used).unwrap_or_default()
}

/// What became of a file that was to be removed.
enum Outcome {
    Removed,
    /// It is in use, or was used since.
    InUse,
    /// Another process removed it.
    Gone,
}

/// Removes a file that was last used at `used`.
fn remove(path: &Path, used: SystemTime) -> Result<Outcome> {
    // Who uses a file holds a lock on it. Locks over NFS need a file that is open for writing.
    let opened = File::options().read(true).write(true).open(path).or_else(|_| File::open(path));
    if let Ok(file) = &opened {
        let was_used = file.metadata().and_then(|metadata| metadata.modified()).is_ok_and(|now| now > used);
        if was_used || matches!(file.try_lock(), Err(std::fs::TryLockError::WouldBlock)) {
            return Ok(Outcome::InUse);
        }
    }
    match std::fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Outcome::Gone),
        removed => removed.map(|()| Outcome::Removed).map_err(Error::io("remove", path)),
    }
}

/// `None` if the file has gone.
fn entry(path: &Path) -> Option<Entry> {
    let (used, bytes, path) = state(path.to_owned())?;
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let described = |scene: String, what: String, size: String| {
        Some(Entry { path: path.clone(), bytes, age: age(used), scene, what, size })
    };
    if !is_bake(name) {
        let what = match name.rsplit_once('.').map_or("", |(_, extension)| extension) {
            _ if is_temporary(name) => "being written",
            "journal" => "interrupted bake",
            "part" => "part of a bake",
            "shared" => "shared by parts",
            _ => "?",
        };
        return described(String::new(), what.to_owned(), String::new());
    }
    let reader = open(&path).ok().and_then(|(file, _)| Reader::new(Mapping::new(&file).ok()?));
    let field = |name: &str| reader.as_ref().and_then(|r| r.text(name)).unwrap_or("?").to_owned();
    let what = match &reader {
        Some(reader) if reader.text("relume") == Some(super::FORMAT) => field("what"),
        Some(_) => format!("{} of another version", field("what")),
        None => "damaged".to_owned(),
    };
    described(field("scene"), what, format!("{}x{}", field("width"), field("height")))
}
