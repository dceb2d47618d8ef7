//! Atomic file writes.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::error::{Error, Result};

/// Writes `path` through `encode` to a temporary file next to it, then renames it: a failure leaves the previous file.
///
/// A symbolic link is preserved and its target replaced; a device or pipe is written directly. If the disk fails, the
/// error is `Error::Io` with `path`, whatever error `encode` returns.
pub fn write_whole(path: &Path, encode: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    write_with(path, &temporary(), encode)
}

/// Writes `bytes` as the whole of `path`, which nobody but this user can read.
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut private = tempfile::Builder::new(); // its default permissions are 0600
    private.prefix(PREFIX).suffix(SUFFIX);
    write_with(path, &private, |out| out.write_all(bytes).map_err(Error::io("write", path)))
}

fn write_with(
    path: &Path,
    temporary: &tempfile::Builder,
    encode: impl FnOnce(&mut dyn Write) -> Result<()>,
) -> Result<()> {
    match fs::metadata(path) {
        Ok(kind) if kind.is_dir() => return Err(Error::io("write", path)(io::ErrorKind::IsADirectory.into())),
        // Renaming onto /dev/null or /dev/stdout would replace the device.
        Ok(kind) if !kind.is_file() => {
            let device = File::options().write(true).open(path).map_err(Error::io("open", path))?;
            return encode_into(path, &device, encode);
        }
        _ => {}
    }
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let folder = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let beside = temporary.tempfile_in(folder).map_err(|e| Error::io("create", path)(without_path(e)))?;
    let _ = beside.as_file().try_lock(); // tells those who clean up that it is not abandoned
    encode_into(path, beside.as_file(), encode)?;
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

fn temporary() -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    // tempfile's default is 0600; with this the kernel applies the umask, as for any new file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
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
