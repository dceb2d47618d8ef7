//! Texture files of MTL: found, decoded once, and combined if one of our textures needs several.

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use image::ImageFormat;

use super::texture_map::TextureMap;
use crate::error::{Error, Result};
use crate::scene::texture::{Image, TexelCount};
use crate::scene::{Encoding, Texture, files};

/// What a texture is made from: the file of each group of channels, and the encoding.
type Recipe = (Vec<Option<PathBuf>>, Encoding);

/// Textures made so far, and the images that they are made from.
#[derive(Default)]
pub struct Images {
    textures: Vec<Texture>,
    made: HashMap<Recipe, usize>,
    images: HashMap<PathBuf, Rc<Image>>,
    texels: TexelCount,
    /// Ignored files, each reported once.
    ignored: Vec<String>,
}

impl Images {
    pub fn into_textures(self) -> Vec<Texture> {
        self.textures
    }

    /// Finds the file of `map`: at the path in the MTL, else by its file name next to the MTL, because many MTL files
    /// contain paths of the machine that wrote them. `None`, with a warning, if it does not exist or has a format that
    /// is not read.
    pub fn find(&mut self, mtl: &Path, map: &TextureMap) -> Result<Option<PathBuf>> {
        let folder = mtl.parent().unwrap_or(Path::new(""));
        let name = map.file.rsplit('/').next().unwrap_or_default();
        for candidate in [map.file.as_str(), name] {
            let Ok(relative) = files::inside(candidate) else { continue };
            let path = folder.join(relative);
            if !path.exists() {
                continue;
            }
            let leaves = |e| Error::import_from(mtl, format!("\"{}\"", files::shortened(&map.file)), e);
            let path = files::below(folder, &path).map_err(leaves)?;
            if is_readable(&path) {
                return Ok(Some(path));
            }
            self.ignore(mtl, map, "is no image that relume reads (PNG, JPEG, WebP, TGA, BMP, TIFF)");
            return Ok(None);
        }
        self.ignore(mtl, map, "does not exist");
        Ok(None)
    }

    /// Warns about a file, once.
    fn ignore(&mut self, mtl: &Path, map: &TextureMap, reason: &str) {
        let name = files::shortened(&map.file);
        if !self.ignored.contains(&name) {
            tracing::warn!("{}: texture \"{name}\" {reason} and is ignored", mtl.display());
            // Enough to avoid repeated warnings about textures that all materials share.
            if self.ignored.len() < 64 {
                self.ignored.push(name);
            }
        }
    }

    /// The decoded file.
    pub fn image(&mut self, mtl: &Path, path: &Path) -> Result<Rc<Image>> {
        if let Some(image) = self.images.get(path) {
            return Ok(image.clone());
        }
        let name = files::shortened(&path.file_name().unwrap_or_default().to_string_lossy());
        let bytes = files::read(path).map_err(|e| Error::import_from(mtl, format!("cannot read \"{name}\""), e))?;
        let undecodable = |e| Error::import_from(mtl, format!("\"{name}\" cannot be decoded"), e);
        self.texels.add(&bytes, path).map_err(|e| e.at(mtl, &format!("\"{name}\"")))?;
        let image = Rc::new(Image::decode(&bytes, path).map_err(undecodable)?);
        self.images.insert(path.to_owned(), image.clone());
        Ok(image)
    }

    /// The texture index of the file at `path`.
    pub fn texture(&mut self, mtl: &Path, path: &Path, encoding: Encoding) -> Result<usize> {
        let recipe = (vec![Some(path.to_owned())], encoding);
        self.made(recipe, |images| Ok(Image::clone(&*images.image(mtl, path)?)))
    }

    /// The texture index of a recipe, which is made on its first use.
    pub fn made(&mut self, recipe: Recipe, make: impl FnOnce(&mut Self) -> Result<Image>) -> Result<usize> {
        if let Some(&known) = self.made.get(&recipe) {
            return Ok(known);
        }
        let image = make(self)?;
        let name = recipe.0.iter().flatten().next().and_then(|path| path.file_name()).unwrap_or_default();
        self.textures.push(Texture::of(name.to_string_lossy().into_owned(), image, recipe.1));
        self.made.insert(recipe, self.textures.len() - 1);
        Ok(self.textures.len() - 1)
    }
}

/// Whether the name or the first bytes of a file are those of a format that is read; the file may still be malformed.
fn is_readable(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(64).read_to_end(&mut head));
    let formats = [ImageFormat::from_path(path), image::guess_format(&head)];
    read.is_err() || formats.iter().flatten().any(ImageFormat::reading_enabled)
}

/// An 8-bit image with the largest width and height of its sources; each texel is computed from the sources' nearest
/// texels.
pub fn combined(sources: [Option<&Image>; 2], texel: impl Fn([Option<[u8; 4]>; 2]) -> [u8; 4]) -> Image {
    let largest = |side: fn(&Image) -> usize| sources.iter().flatten().map(|image| side(image)).max().unwrap_or(1);
    let (width, height) = (largest(|image| image.width), largest(|image| image.height));
    let read = |source: Option<&Image>, x: usize, y: usize| {
        source.map(|s| s.texels[y * s.height / height * s.width + x * s.width / width])
    };
    let texels = (0..width * height).map(|i| texel(sources.map(|source| read(source, i % width, i / width))));
    Image { width, height, texels: texels.collect(), low: Vec::new() }
}
