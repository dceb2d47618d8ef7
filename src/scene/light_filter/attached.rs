//! Files that a rig refers to: IES profiles and images.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Deref;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use super::Profile;
use crate::error::{Error, Result};
use crate::scene::files;
use crate::scene::gltf::image_lights::read_sky_map;
use crate::scene::gltf::profile_files::{file_and_index, path_in_file, read_profile};
use crate::scene::texture::{Encoding, Image, TexelCount, Texture};
use crate::scene::{DomeMap, Light, SkyMap};
use crate::storage::file::without_links;

/// A decoded file and where it lies.
pub struct Attached<T> {
    path: PathBuf,
    hash: blake3::Hash,
    content: Arc<T>,
}

impl<T> Attached<T> {
    /// `path` may be relative to the current folder.
    pub fn new(path: &Path, bytes: &[u8], content: T) -> Self {
        Self { path: without_links(path), hash: blake3::hash(bytes), content: Arc::new(content) }
    }

    /// Absolute, without links. Ends in `#` and a number if the file is one of those in a glTF file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the file lies in `folder` or below.
    pub fn is_within(&self, folder: &Path) -> bool {
        self.path_from(folder).components().all(|part| matches!(part, Component::Normal(_)))
    }

    /// The path as a rig in `folder` writes it: relative, unless nothing leads there.
    pub fn path_from(&self, folder: &Path) -> PathBuf {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let Ok(folder) = folder.canonicalize().or_else(|_| std::path::absolute(folder)) else {
            return self.path.clone();
        };
        let common = self.path.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
        if !matches!(self.path.components().take(common).last(), Some(Component::RootDir | Component::Normal(_))) {
            return self.path.clone();
        }
        let up = folder.components().skip(common).map(|_| Component::ParentDir);
        up.chain(self.path.components().skip(common)).collect()
    }

    /// As the rig in the glTF file `scene` names it: `#0`, if the file is the first of those in `scene` itself.
    pub fn in_scene(self, scene: &Path) -> Self {
        let own = self.path.to_str().and_then(file_and_index);
        let own = own.filter(|(file, _)| scene.canonicalize().is_ok_and(|scene| scene == Path::new(file)));
        match own {
            Some((_, index)) => Self { path: path_in_file(Path::new(""), index), ..self },
            None => self,
        }
    }
}

impl<T> Clone for Attached<T> {
    fn clone(&self) -> Self {
        Self { path: self.path.clone(), hash: self.hash, content: self.content.clone() }
    }
}

/// Equal files.
impl<T> PartialEq for Attached<T> {
    fn eq(&self, other: &Self) -> bool {
        self.hash == other.hash && self.path == other.path
    }
}

impl<T> std::fmt::Debug for Attached<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.path.fmt(f)
    }
}

impl<T> Deref for Attached<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.content
    }
}

/// Reads the files of one rig, each once.
pub struct RigFiles<'a> {
    folder: &'a Path,
    /// The glTF file that contains the rig. It is untrusted, so files outside the folder are refused.
    scene: Option<&'a Path>,
    profiles: HashMap<PathBuf, Attached<Profile>>,
    images: HashMap<PathBuf, Attached<Texture>>,
    sky_maps: HashMap<PathBuf, Attached<SkyMap>>,
}

/// Finer levels of images are discarded: 2048 texels across a spot are finer than its shadows.
const MAX_SIDE: usize = 2048;

impl<'a> RigFiles<'a> {
    /// Paths are relative to `folder`.
    pub fn new(folder: &'a Path) -> Self {
        Self { folder, scene: None, profiles: HashMap::new(), images: HashMap::new(), sky_maps: HashMap::new() }
    }

    /// The files of the rig in the glTF file `scene`: those in its folder or below, and no others. `sky_maps` are
    /// known.
    pub fn of_scene(scene: &'a Path, sky_maps: impl Iterator<Item = Attached<SkyMap>>) -> Self {
        let sky_maps = sky_maps.map(|map| (map.path.clone(), map)).collect();
        Self { scene: Some(scene), sky_maps, ..Self::new(scene.parent().unwrap_or(Path::new(""))) }
    }

    /// The same, with the files of `light` already read: they need not exist any more.
    #[must_use]
    pub fn with_files_of(mut self, light: &Light) -> Self {
        let file = |path: &Path| path.to_owned();
        self.profiles.extend(light.filter.ies.iter().map(|ies| (file(ies.path()), ies.clone())));
        self.images.extend(light.filter.gobo.iter().map(|gobo| (file(gobo.image.path()), gobo.image.clone())));
        let map = light.map.as_ref().and_then(DomeMap::as_file);
        self.sky_maps.extend(map.map(|map| (file(map.path()), map.clone())));
        self
    }

    fn find(&self, name: &str) -> Result<PathBuf> {
        let path = self.folder.join(name);
        if self.scene.is_some() {
            let inside = files::inside(name).map_err(|reason| Error::import(&path, reason))?;
            files::below(self.folder, &self.folder.join(inside))?;
        }
        path.canonicalize().map_err(Error::io("read", &path))
    }

    /// A file that exists, and the index in it if `name` is like `scene.glb#0`.
    fn find_in_gltf(&self, name: &str) -> Result<(PathBuf, Option<usize>)> {
        let in_gltf = file_and_index(name).filter(|_| !self.folder.join(name).exists());
        let path = self.find(in_gltf.map_or(name, |(file, _)| file))?;
        Ok((path, in_gltf.map(|(_, index)| index)))
    }

    /// Reads an IES profile: a file, or `scene.glb#0` for the first of `EXT_lights_ies` in a glTF file.
    pub fn profile(&mut self, name: &str) -> Result<Attached<Profile>> {
        if let Some(known) = self.profiles.get(&self.folder.join(name)) {
            return Ok(known.clone());
        }
        let (path, index) = self.find_in_gltf(name)?;
        let decode = |bytes: &[u8]| Profile::parse(bytes).map_err(|reason| Error::import(&path, reason));
        match index {
            Some(index) => {
                let named = path_in_file(&path, index);
                attach(&mut self.profiles, &named, || read_profile(&path, index), decode)
            }
            None => attach(&mut self.profiles, &path, || files::read(&path), decode),
        }
    }

    /// Reads an environment map: EXR, Radiance, PNG, JPEG or WebP, or `scene.glb#0` for the first of
    /// `EXT_lights_image_based` in a glTF file. In the rig of a scene, `#0` is that of the scene itself.
    pub fn sky_map(&mut self, name: &str) -> Result<Attached<SkyMap>> {
        if let Some(known) = self.sky_maps.get(&self.folder.join(name)) {
            return Ok(known.clone());
        }
        let scene = self.scene.filter(|_| name.starts_with('#')).and_then(|scene| scene.file_name()?.to_str());
        let (path, index) = self.find_in_gltf(&format!("{}{name}", scene.unwrap_or_default()))?;
        let Some(index) = index else {
            return attach(&mut self.sky_maps, &path, || files::read(&path), |bytes| SkyMap::read(&path, bytes));
        };
        match self.sky_maps.entry(path_in_file(&path, index)) {
            Entry::Occupied(known) => Ok(known.get().clone()),
            Entry::Vacant(new) => Ok(new.insert(read_sky_map(&path, index)?).clone()),
        }
    }

    /// The [path](Attached::path) of the environment map `name`, which is not read.
    pub fn sky_map_path(&self, name: &str) -> Result<PathBuf> {
        let (path, index) = self.find_in_gltf(name)?;
        Ok(index.map_or(path.clone(), |index| path_in_file(&path, index)))
    }

    /// Reads an image, sRGB; see [`Image::decode`].
    pub fn image(&mut self, name: &str) -> Result<Attached<Texture>> {
        if let Some(known) = self.images.get(&self.folder.join(name)) {
            return Ok(known.clone());
        }
        let path = self.find(name)?;
        let decode = |bytes: &[u8]| {
            TexelCount::default().add(bytes, &path).map_err(|refusal| refusal.at(&path, "the image"))?;
            let image = Image::decode(bytes, &path);
            let image = image.map_err(|cause| Error::import_from(&path, "the image cannot be decoded", cause))?;
            let mut texture = Texture::of(String::new(), image, Encoding::Srgb);
            let is_fine = |level: &crate::scene::texture::MipLevel| level.width.max(level.height) > MAX_SIDE;
            let too_fine = texture.levels.iter().filter(|level| is_fine(level)).count();
            texture.levels.drain(..too_fine);
            Ok(texture)
        };
        attach(&mut self.images, &path, || files::read(&path), decode)
    }
}

fn attach<T>(
    known: &mut HashMap<PathBuf, Attached<T>>,
    path: &Path,
    read: impl FnOnce() -> Result<Vec<u8>>,
    decode: impl FnOnce(&[u8]) -> Result<T>,
) -> Result<Attached<T>> {
    if let Some(attached) = known.get(path) {
        return Ok(attached.clone());
    }
    let bytes = read()?;
    let attached = Attached::new(path, &bytes, decode(&bytes)?);
    known.insert(path.to_owned(), attached.clone());
    Ok(attached)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_to_the_rig() {
        let at = |path: &str| Attached { path: path.into(), hash: blake3::hash(b""), content: Arc::new(()) };
        let from = |path: &str, folder: &str| at(path).path_from(Path::new(folder));
        assert_eq!(from("/a/b/lamp.ies", "/a/b"), Path::new("lamp.ies"));
        assert_eq!(from("/a/b/c/lamp.ies", "/a/b"), Path::new("c/lamp.ies"));
        assert_eq!(from("/a/lamp.ies", "/a/b/c"), Path::new("../../lamp.ies"));
        assert_eq!(from("/z/lamp.ies", "/a/b"), Path::new("../../z/lamp.ies"));
    }
}
