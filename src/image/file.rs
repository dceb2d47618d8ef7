//! Files that are whole or not there.

use std::io::Write;
use std::path::Path;

use crate::error::Result;

/// Writes `path` through `encode` into a file beside it, then renames: a failure leaves what was there before.
pub fn write_whole(path: &Path, encode: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    let _ = (path, encode);
    todo!()
}

pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    let _ = (path, bytes);
    todo!()
}
