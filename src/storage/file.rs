//! Atomic file writes.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Writes `path` through `encode` to a temporary file next to it, then renames it: a failure leaves the previous file.
///
/// A file that is replaced keeps its permissions. A symbolic link is preserved and its target replaced; a device or
/// pipe is written directly. If the disk fails, the error is `Error::Io` with `path`, whatever error `encode` returns.
pub fn write_whole(path: &Path, encode: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    write_with(path, false, encode)
}

/// Writes `bytes` as the whole of `path`, which nobody but this user can read.
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, true, |out| out.write_all(bytes).map_err(Error::io("write", path)))
}

fn write_with(path: &Path, is_private: bool, encode: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    match fs::metadata(path) {
        Ok(kind) if kind.is_dir() => return Err(Error::io("write", path)(io::ErrorKind::IsADirectory.into())),
        // Renaming onto /dev/null or /dev/stdout would replace the device.
        Ok(kind) if !kind.is_file() => {
            let device = File::options().write(true).open(path).map_err(Error::io("open", path))?;
            return encode_into(path, &device, encode);
        }
        _ => {}
    }
    let target = fs::canonicalize(path).or_else(|_| fs::read_link(path).map(|to| folder_of(path).join(to)));
    let target = target.unwrap_or_else(|_| path.to_owned());
    let beside = temporary(is_private)
        .tempfile_in(folder_of(&target))
        .map_err(|e| Error::io("create", path)(without_path(e)))?;
    let _ = beside.as_file().try_lock(); // tells those who clean up that it is not abandoned
    encode_into(path, beside.as_file(), encode)?;
    if !is_private && let Ok(replaced) = fs::metadata(&target) {
        let _ = beside.as_file().set_permissions(replaced.permissions()); // not on all file systems
    }
    beside.as_file().sync_all().map_err(Error::io("write", path))?;
    beside.persist(&target).map_err(|failed| Error::io("rename a finished file to", path)(failed.error))?;
    Ok(())
}

/// Writes `bytes` as the whole of `path`, like [`write_whole`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_whole(path, |out| out.write_all(bytes).map_err(Error::io("write", path)))
}

/// Opens a regular file for reading and returns its length in bytes; any other kind of file (a pipe might never end) is
/// an error.
pub fn open(path: &Path) -> Result<(File, u64)> {
    let kind = fs::metadata(path).map_err(Error::io("open", path))?;
    if !kind.is_file() {
        return Err(Error::import(path, "not a regular file"));
    }
    let file = File::open(path).map_err(Error::io("open", path))?;
    Ok((file, kind.len()))
}

/// The folder that holds `path`; `.` if it is only a name.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Where `path` lies: absolute, without links, also if only its folder is there; else `path`.
pub fn without_links(path: &Path) -> PathBuf {
    let in_folder = || Some(folder_of(path).canonicalize().ok()?.join(path.file_name()?));
    path.canonicalize().ok().or_else(in_folder).unwrap_or_else(|| path.to_owned())
}

/// Marks a file of the cache as used now, so that pruning by age keeps it. Only its owner may do so.
pub fn mark_used(file: &File) {
    let _ = file.set_modified(std::time::SystemTime::now());
}

/// Whether a file name is that of a temporary file of [`write_whole`], in use or abandoned.
pub fn is_temporary(name: &str) -> bool {
    name.starts_with(PREFIX) && name.ends_with(SUFFIX)
}

const PREFIX: &str = ".relume-";
const SUFFIX: &str = ".part";

fn temporary(is_private: bool) -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    // tempfile's default is 0600; with this the kernel applies the umask, as for any new file.
    #[cfg(unix)]
    if !is_private {
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    }
    builder
}

/// The cause of a tempfile error, without the name of the temporary file.
fn without_path(error: io::Error) -> io::Error {
    let inner = error.get_ref().and_then(|e| e.source()).and_then(|e| e.downcast_ref::<io::Error>());
    inner.and_then(io::Error::raw_os_error).map_or(error, io::Error::from_raw_os_error)
}

fn encode_into(path: &Path, file: &File, encode: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    let mut watched = Watched { file, failure: None };
    let mut buffered = BufWriter::with_capacity(1 << 16, &mut watched);
    let encoded = encode(&mut buffered);
    let flushed = buffered.flush().map_err(Error::io("write", path));
    drop(buffered);
    match watched.failure {
        Some(failure) => Err(Error::io("write", path)(failure)),
        None => encoded.and(flushed),
    }
}

/// Records the first failure of the disk, which encoders wrap in errors of their own.
struct Watched<'a> {
    file: &'a File,
    failure: Option<io::Error>,
}

impl Watched<'_> {
    fn keep<T>(&mut self, outcome: io::Result<T>) -> io::Result<T> {
        outcome.map_err(|failure| {
            let kind = failure.kind();
            // The caller retries an interrupted write, so it is not a failure.
            if kind != io::ErrorKind::Interrupted {
                self.failure.get_or_insert(failure);
            }
            kind.into()
        })
    }
}

impl Write for Watched<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let outcome = self.file.write(bytes);
        self.keep(outcome)
    }

    fn flush(&mut self) -> io::Result<()> {
        let outcome = self.file.flush();
        self.keep(outcome)
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    #[test]
    fn permissions_and_links_stay() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, private] = ["file", "link", "private"].map(|name| folder.path().join(name));
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        symlink("file", &link).unwrap();
        write_bytes(&link, b"made by a link to nothing").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink() && file.exists());
        for bits in [0o600, 0o640] {
            fs::set_permissions(&file, fs::Permissions::from_mode(bits)).unwrap();
            write_bytes(&link, b"replaced").unwrap();
            assert_eq!((mode(&file), &*fs::read(&file).unwrap()), (bits, &b"replaced"[..]));
        }
        fs::write(&private, "").unwrap();
        write_private(&private, b"token").unwrap();
        assert_eq!(mode(&private), 0o600);
    }
}
