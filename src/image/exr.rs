use std::path::Path;

use super::Image;
use crate::error::Result;

/// Reads every RGB layer.
pub fn read(path: &Path) -> Result<Image> {
    let _ = path;
    todo!()
}

/// Writes float32 layers, beside and renamed.
pub fn write(path: &Path, image: &Image) -> Result<()> {
    let _ = (path, image);
    todo!()
}
