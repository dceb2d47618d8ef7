use std::path::Path;

use crate::error::Result;

/// Writes 8-bit sRGB pixels (RGB or RGBA by `CHANNELS`), beside and renamed.
pub fn write<const CHANNELS: usize>(path: &Path, width: usize, height: usize, pixels: &[[u8; CHANNELS]]) -> Result<()> {
    let _ = (path, width, height, pixels);
    todo!()
}
