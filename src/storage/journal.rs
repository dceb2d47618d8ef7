//! Progress of a long bake: an interrupted bake resumes from it, with the same result.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Records in the order of their creation, each with a checksum; the default journal stores nothing.
///
/// A failure ends the journal, never the bake.
#[derive(Default)]
pub struct Journal {
    open: Option<(PathBuf, File)>,
    /// Number of records read from an earlier bake, and whether all have been read.
    replayed: usize,
    is_at_end: bool,
}

impl Journal {
    /// Opens the journal at `path`, which belongs to this bake alone; stores nothing if another process runs the same
    /// bake.
    pub fn open(path: &Path) -> Self {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).ok();
        let file = file.filter(|file| file.try_lock().is_ok());
        Self { open: file.map(|file| (path.to_owned(), file)), replayed: 0, is_at_end: false }
    }

    /// The next record of an interrupted bake. `None` after the last record, or at one that is damaged or not
    /// `as_expected`; everything from there on is discarded.
    pub fn replay<T: DeserializeOwned>(&mut self, as_expected: impl Fn(&T) -> bool) -> Option<T> {
        let (_, file) = self.open.as_mut()?;
        if self.is_at_end {
            return None;
        }
        let start = file.stream_position().ok()?;
        let record = read(file).and_then(|bytes| postcard::from_bytes(&bytes).ok()).filter(as_expected);
        self.replayed += usize::from(record.is_some());
        if record.is_none() {
            self.is_at_end = true;
            if self.replayed > 0 {
                tracing::info!("resumes an interrupted bake: {} parts are done", self.replayed);
            }
            if file.seek(SeekFrom::Start(start)).and_then(|_| file.set_len(start)).is_err() {
                self.open = None;
            }
        }
        record
    }

    /// [`Self::replay`], or else the result of `make`, which is added.
    pub fn next<T: Serialize + DeserializeOwned>(
        &mut self,
        as_expected: impl Fn(&T) -> bool,
        make: impl FnOnce() -> T,
    ) -> T {
        self.replay(as_expected).unwrap_or_else(|| {
            let record = make();
            self.add(&record);
            record
        })
    }

    /// Appends a record.
    pub fn add<T: Serialize>(&mut self, record: &T) {
        let Some((path, file)) = &mut self.open else { return };
        let written = postcard::to_stdvec(record).map_err(io::Error::other).and_then(|bytes| write(file, &bytes));
        if let Err(error) = written {
            tracing::info!("{}: progress is no longer saved: {error}", path.display());
            self.remove();
        }
    }

    /// Deletes the journal; the bake cannot be resumed any more.
    pub fn remove(&mut self) {
        if let Some((path, _)) = self.open.take() {
            // A file that remains is overwritten by the next bake.
            let _ = std::fs::remove_file(path);
        }
    }
}

/// Reads length, checksum and bytes; `None` if they are incomplete or damaged.
fn read(file: &mut File) -> Option<Vec<u8>> {
    let left = file.metadata().ok()?.len() - file.stream_position().ok()?;
    let (mut length, mut checksum) = ([0; 8], [0; blake3::OUT_LEN]);
    file.read_exact(&mut length).ok()?;
    file.read_exact(&mut checksum).ok()?;
    let length = u64::from_le_bytes(length);
    if length > left {
        return None;
    }
    let mut bytes = vec![0; length as usize];
    file.read_exact(&mut bytes).ok()?;
    (*blake3::hash(&bytes).as_bytes() == checksum).then_some(bytes)
}

fn write(file: &mut File, bytes: &[u8]) -> io::Result<()> {
    let length = (bytes.len() as u64).to_le_bytes();
    file.write_all(&[&length, &blake3::hash(bytes).as_bytes()[..], bytes].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn replay(journal: &mut Journal) -> Option<String> {
        journal.replay(|record: &String| record != "unexpected")
    }

    /// The records that a second process finds in the first one's journal after `damage`.
    fn found(damage: impl Fn(&mut Vec<u8>)) -> Vec<String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal");
        let mut journal = Journal::open(&path);
        assert_eq!(replay(&mut journal), None);
        ["one", "two", "three"].iter().for_each(|record| journal.add(record));
        assert_eq!(replay(&mut Journal::open(&path)), None, "another process has it");
        drop(journal);
        let mut bytes = std::fs::read(&path).unwrap();
        damage(&mut bytes);
        std::fs::write(&path, bytes).unwrap();
        let mut journal = Journal::open(&path);
        let found: Vec<String> = std::iter::from_fn(|| replay(&mut journal)).collect();
        journal.add(&"last");
        drop(journal);
        let mut journal = Journal::open(&path);
        let again: Vec<String> = std::iter::from_fn(|| replay(&mut journal)).collect();
        assert_eq!(again[..found.len()], found[..]);
        assert_eq!(again[found.len()..], ["last"]);
        journal.remove();
        assert!(!path.exists());
        found
    }

    /// The bytes of a journal of another bake.
    fn other_record() -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal");
        Journal::open(&path).add(&"unexpected");
        std::fs::read(path).unwrap()
    }

    #[test]
    fn goes_on_after_the_last_whole_record() {
        assert_eq!(found(|_| ()), ["one", "two", "three"]);
        assert_eq!(found(|bytes| bytes.truncate(bytes.len() - 1)), ["one", "two"]);
        assert_eq!(found(|bytes| bytes.truncate(20)), [""; 0]);
        assert_eq!(found(|bytes| *bytes.last_mut().unwrap() ^= 1), ["one", "two"]);
        assert_eq!(found(|bytes| bytes[0] ^= 1), [""; 0]);
        assert_eq!(found(|bytes| bytes.splice(44.., other_record()).for_each(drop)), ["one"]);
        assert_eq!(found(|bytes| bytes[7] ^= 0x80), [""; 0]); // a length larger than any memory
    }
}
