//! The environment maps of a folder.

use std::io::BufReader;
use std::path::{Path, PathBuf};

use image::ImageReader;

use crate::error::{Error, Result};
use crate::storage::file;

/// The files in `folder` that may be environment maps, by name: HDR and EXR files, and PNG, JPEG and WebP files that
/// are twice as wide as high. Of these, headers are read. Fails if the folder cannot be read.
pub fn maps_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(Error::io("read", folder))?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut maps: Vec<PathBuf> = paths.filter(|path| may_be_map(path)).collect();
    maps.sort();
    Ok(maps)
}

fn may_be_map(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    match extension.to_str() {
        Some("hdr" | "exr") => path.is_file(),
        Some("png" | "jpg" | "jpeg" | "webp") => size(path).is_some_and(|[width, height]| width == 2 * height),
        _ => false,
    }
}

/// Width and height that the header of an image claims.
fn size(path: &Path) -> Option<[u64; 2]> {
    let (file, _) = file::open(path).ok()?;
    let reader = ImageReader::new(BufReader::new(file)).with_guessed_format().ok()?;
    let (width, height) = reader.into_dimensions().ok()?;
    Some([width, height].map(u64::from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_found_by_name_or_by_shape() {
        let folder = tempfile::tempdir().expect("there is room");
        let at = |name: &str| folder.path().join(name);
        for name in ["b.hdr", "a.EXR", "c.txt", "d.hdr.part", "broken.png"] {
            std::fs::write(at(name), "no image").expect("there is room");
        }
        std::fs::create_dir(at("folder.exr")).expect("there is room");
        for (name, width) in [("wide.png", 4), ("square.png", 2)] {
            crate::image::png::write(&at(name), width, 2, &vec![[0u8; 3]; 2 * width]).expect("there is room");
        }
        assert_eq!(maps_in(folder.path()).expect("it is a folder"), ["a.EXR", "b.hdr", "wide.png"].map(at));
        assert!(maps_in(&at("none")).is_err());
    }
}
