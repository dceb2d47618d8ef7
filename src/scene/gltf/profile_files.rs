//! The IES files of `EXT_lights_ies`, and how rigs name those that lie within a glTF file.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::container::Container;
use super::document::Document;
use crate::error::Result;
use crate::scene::files;

impl Document {
    pub fn profile_bytes(&self, index: usize, asked_by: &str) -> Result<Cow<'_, [u8]>> {
        let entry = self.item(self.profiles(), index, "IES light", asked_by)?;
        let what = format!("IES light {index}");
        match (&entry.uri, entry.buffer_view) {
            (Some(uri), _) => Ok(files::read_uri(&self.path, uri, &what)?.into()),
            (None, Some(view)) => Ok(self.view(view, &what)?.into()),
            (None, None) => Err(self.error(format!("{what} has neither a URI nor a buffer view"))),
        }
    }

    /// The path of profile `index`: that of its file, or `scene.glb#0` if it has none of its own.
    pub fn profile_path(&self, index: usize) -> PathBuf {
        let uri = self.profiles().get(index).and_then(|entry| entry.uri.as_deref());
        let file = uri.filter(|uri| !uri.starts_with("data:")).and_then(|uri| files::relative_path(uri).ok());
        match file {
            Some(file) => self.path.parent().unwrap_or(Path::new("")).join(file),
            None => path_in_file(&self.path, index),
        }
    }
}

/// `scene.glb#0`.
pub fn path_in_file(file: &Path, index: usize) -> PathBuf {
    let mut path = file.as_os_str().to_owned();
    path.push(format!("#{index}"));
    path.into()
}

/// The file and the index of [`path_in_file`].
pub fn file_and_index(name: &str) -> Option<(&str, usize)> {
    let (file, index) = name.rsplit_once('#')?;
    let is_gltf = [".glb", ".gltf"].iter().any(|end| file.to_ascii_lowercase().ends_with(end));
    Some((file, index.parse().ok().filter(|_| is_gltf)?))
}

/// Reads profile `index` of the glTF file at `path`.
pub fn read_profile(path: &Path, index: usize) -> Result<Vec<u8>> {
    Ok(Document::parse(path, &Container::read(path)?)?.profile_bytes(index, "the rig")?.into_owned())
}
