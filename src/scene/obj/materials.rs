//! MTL materials, made for Phong shading, converted to metallic-roughness.
//!
//! [Karis 2013]: B. Karis, Real shading in Unreal Engine 4, SIGGRAPH course notes.
//!
//! - Kd is the base colour, Ke emission, Pr and Pm roughness and metalness, Ni the index of refraction.
//! - Ns, the Blinn-Phong exponent: alpha² = 2 / (Ns + 2) [Karis 2013]; roughness is the square root of alpha.
//! - Ks scales the reflectance at normal incidence; 0.5 is glTF's 0.04, as in common exporters; 0 is Lambertian.
//! - illum 0 and 1 have no highlight; illum 3 is a mirror of colour Ks, else Kd.
//! - map_Kd, map_Ke, map_Ks, norm, bump. A grey bump map is a height map and is ignored.
//! - map_Pr, map_Pm and map_Ns replace their numbers; map_Ns is scaled by Ns.
//! - d, or Tr = 1 - d, is opacity: 0 is a hole, 1 opaque, between them it blends. map_d below one half is a hole; it is
//!   read from the alpha channel if there is one, else from red.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::{DVec3, Vec3};

use super::images::{Images, combined};
use super::sanitize::{self, UNNAMED};
use super::texture_map::TextureMap;
use super::words::text_of;
use crate::error::{Error, Result};
use crate::scene::texture::Image;
use crate::scene::{AlphaMode, Encoding, Material, Texture, TextureRef, files};

/// Linear value of 0.5 in sRGB.
const GREY: f32 = 0.214;

/// Material of faces without one.
pub fn default(name: &str) -> Material {
    let name = if name.is_empty() { "default" } else { name };
    Material { name: name.into(), metallic: 0.0, roughness: 1.0, ..Material::default() }
}

/// The materials of all `mtllib`s, and their textures.
#[derive(Default)]
pub struct Library {
    materials: HashMap<String, Material>,
    images: Images,
    /// Number of materials with zero opacity.
    holes: usize,
}

impl Library {
    pub fn get(&self, name: &str) -> Option<Material> {
        self.materials.get(name).cloned()
    }

    pub fn into_textures(self) -> Vec<Texture> {
        self.images.into_textures()
    }

    /// Warns about materials with zero opacity.
    pub fn warn(&self, obj: &Path) {
        let have = |count: usize| if count == 1 { "1 material has".into() } else { format!("{count} materials have") };
        let path = obj.display();
        if self.holes > 0 {
            tracing::warn!("{path}: {} d 0 or Tr 1: invisible", have(self.holes));
        }
    }

    /// Reads the files of a `mtllib` statement: one file whose name may contain spaces, else several. A missing file is
    /// only a warning, because many OBJ files are distributed without theirs.
    pub fn read(&mut self, obj: &Path, statement: &str) -> Result<()> {
        let folder = obj.parent().unwrap_or(Path::new(""));
        // At its path, or by its name beside the OBJ.
        let there = |name: &str| {
            let name = name.replace('\\', "/");
            let candidates = [name.as_str(), name.rsplit('/').next().unwrap_or_default()];
            let mut paths = candidates.into_iter().filter_map(|name| Some(folder.join(files::inside(name).ok()?)));
            paths.find(|path| path.is_file())
        };
        let without_comment = statement.split('#').next().unwrap_or_default().trim();
        let whole = [statement, without_comment].into_iter().find_map(there);
        let paths = match whole {
            Some(path) => vec![(statement, Some(path))],
            None => without_comment.split_whitespace().map(|name| (name, there(name))).collect(),
        };
        for (name, path) in paths {
            match path {
                Some(path) => self.read_file(&path)?,
                None => {
                    let name = files::shortened(name);
                    tracing::warn!("{}: \"{name}\" does not exist; its materials are grey", obj.display());
                }
            }
        }
        Ok(())
    }

    fn read_file(&mut self, path: &Path) -> Result<()> {
        let bytes = files::read(path)?;
        let text = sanitize::mtl(&text_of(&bytes)).map_err(|reason| Error::import(path, reason))?;
        let (entries, _) =
            tobj::load_mtl_buf(&mut text.as_bytes()).map_err(|e| Error::import_from(path, "not an MTL file", e))?;
        for entry in entries {
            let material = self.material(path, &entry)?;
            let name = if entry.name == UNNAMED { String::new() } else { entry.name };
            self.materials.insert(name, material);
        }
        Ok(())
    }

    fn material(&mut self, path: &Path, entry: &tobj::Material) -> Result<Material> {
        let color = |rgb: Option<[f64; 3]>| rgb.map(|rgb| DVec3::from(rgb).as_vec3());
        let (kd, ks, ke) = (color(entry.diffuse), color(entry.specular), color(entry.emissive));
        let scalar = |key| entry.unknown_param.get(key).and_then(|text: &String| text.parse::<f32>().ok());
        let map = |text: Option<&String>| {
            text.map(|text| TextureMap::parse(text)).transpose().map_err(|reason| Error::import(path, reason))
        };
        let norm = map(entry.unknown_param.get("norm"))?;

        let mut material = default(if entry.name == UNNAMED { "" } else { &entry.name });
        let is_mirror = entry.illumination_model == Some(3);
        let base = if is_mirror { ks.or(kd) } else { kd };
        material.base_color = base.unwrap_or(Vec3::ONE).clamp(Vec3::ZERO, Vec3::ONE).extend(1.0);
        if is_mirror {
            (material.metallic, material.roughness) = (1.0, 0.0);
        } else {
            // Ns >= 0, so this is in [0, 1].
            let from_exponent = entry.shininess.map(|ns| (2.0 / (ns.max(0.0) + 2.0)).sqrt().sqrt() as f32);
            material.roughness = scalar("Pr").or(from_exponent).unwrap_or(1.0).clamp(0.0, 1.0);
            material.metallic = scalar("Pm").unwrap_or(0.0).clamp(0.0, 1.0);
            material.specular_color = ks.map_or(Vec3::ONE, |ks| ks.max(Vec3::ZERO) / 0.5);
            if matches!(entry.illumination_model, Some(0 | 1)) || ks == Some(Vec3::ZERO) {
                material.specular = 0.0;
            }
            material.ior = entry.optical_density.map(|ni| ni as f32).filter(|&ni| ni > 1.0).unwrap_or(1.5);
        }
        material.emissive = ke.unwrap_or(Vec3::ZERO).max(Vec3::ZERO);
        let color_map = map(entry.diffuse_texture.as_ref())?;
        if let Some(map) = &color_map {
            material.base_color_texture = self.texture(path, map, Encoding::Srgb)?;
            // Many exporters write black if a texture replaces the colour.
            if base == Some(Vec3::ZERO) {
                material.base_color = glam::Vec4::ONE;
            }
            // If the texture file is missing, the colour remains, or a perceptual mid-grey if that is white.
            if material.base_color_texture.is_none() && material.base_color == glam::Vec4::ONE {
                material.base_color = Vec3::splat(GREY).extend(1.0);
            }
        }
        if let Some(map) = map(entry.specular_texture.as_ref())?.filter(|_| !is_mirror)
            && let Some(texture) = self.texture(path, &map, Encoding::Srgb)?
        {
            if ks.is_none_or(|ks| ks == Vec3::ZERO) {
                (material.specular, material.specular_color) = (1.0, Vec3::ONE / 0.5);
            }
            material.specular_color_texture = Some(texture);
        }
        if !is_mirror {
            let gloss = map(entry.shininess_texture.as_ref())?;
            let maps = [map(entry.unknown_param.get("map_Pr"))?, map(entry.unknown_param.get("map_Pm"))?];
            self.rough_and_metallic(path, &mut material, maps, gloss, entry.shininess)?;
        }
        let opacity = entry.dissolve.or(scalar("Tr").map(|tr| 1.0 - f64::from(tr)));
        self.holes(path, &mut material, opacity, color_map.as_ref(), map(entry.dissolve_texture.as_ref())?)?;
        if let Some(map) = map(entry.unknown_param.get("map_Ke"))? {
            let texture = self.texture(path, &map, Encoding::Srgb)?;
            if texture.is_some() && ke.is_none_or(|ke| ke == Vec3::ZERO) {
                material.emissive = Vec3::ONE;
            }
            material.emissive_texture = texture;
        }
        let is_bump = norm.is_none();
        if let Some(map) = norm.or(map(entry.normal_texture.as_ref())?)
            && let Some(file) = self.images.find(path, &map)?
        {
            let image = self.images.image(path, &file)?;
            if is_bump && image.texels.iter().all(|t| t[0] == t[1] && t[1] == t[2]) {
                let file = files::shortened(&map.file);
                tracing::warn!("{}: \"{file}\" is a height map, which is not supported", path.display());
            } else {
                let texture = self.images.texture(path, &file, Encoding::Linear)?;
                material.normal_texture = Some(map.reference(texture));
                material.normal_scale = map.strength;
            }
        }
        Ok(material)
    }

    /// `None` if the file does not exist.
    fn texture(&mut self, mtl: &Path, map: &TextureMap, encoding: Encoding) -> Result<Option<TextureRef>> {
        let Some(file) = self.images.find(mtl, map)? else { return Ok(None) };
        Ok(Some(map.reference(self.images.texture(mtl, &file, encoding)?)))
    }

    /// The file of a map and its image, if both exist.
    fn image(&mut self, mtl: &Path, map: Option<&TextureMap>) -> Result<Option<(PathBuf, Rc<Image>)>> {
        let Some(map) = map else { return Ok(None) };
        let Some(file) = self.images.find(mtl, map)? else { return Ok(None) };
        let image = self.images.image(mtl, &file)?;
        Ok(Some((file, image)))
    }

    /// Combines map_Pr or map_Ns (green) and map_Pm (blue) in one texture.
    fn rough_and_metallic(
        &mut self,
        mtl: &Path,
        material: &mut Material,
        [roughness, metalness]: [Option<TextureMap>; 2],
        gloss: Option<TextureMap>,
        exponent: Option<f64>,
    ) -> Result<()> {
        let is_gloss = roughness.is_none();
        let rough_map = roughness.or(gloss);
        let aligned = match (&rough_map, &metalness) {
            (Some(rough), Some(metallic)) => rough.is_aligned(metallic),
            _ => true,
        };
        let metal_map = metalness.filter(|_| aligned);
        if !aligned {
            tracing::warn!(
                "{}: \"{}\" has a map_Pm whose transform differs from map_Pr; it is ignored",
                mtl.display(),
                material.name
            );
        }
        let (rough, metal) = (self.image(mtl, rough_map.as_ref())?, self.image(mtl, metal_map.as_ref())?);
        let Some(map) = rough_map.as_ref().filter(|_| rough.is_some()).or(metal_map.as_ref()) else { return Ok(()) };
        if rough.is_none() && metal.is_none() {
            return Ok(());
        }
        let exponent = exponent.filter(|&ns| ns > 0.0).unwrap_or(1_000.0) as f32;
        let roughness_of = |value: u8| match is_gloss {
            true => (255.0 * (2.0 / (f32::from(value) / 255.0 * exponent + 2.0)).powf(0.25)).round() as u8,
            false => value,
        };
        let file = |found: &Option<(PathBuf, Rc<Image>)>| found.as_ref().map(|(file, _)| file.clone());
        // The texture depends on the exponent, so the recipe includes it.
        let kind = is_gloss.then(|| PathBuf::from(format!("Ns {exponent}")));
        let recipe = (vec![file(&rough), file(&metal), kind], Encoding::Linear);
        let texture = self.images.made(recipe, |_| {
            let images = [&rough, &metal].map(|found| found.as_ref().map(|(_, image)| &**image));
            let texel = |[rough, metal]: [Option<[u8; 4]>; 2]| {
                [255, rough.map_or(255, |t| roughness_of(t[0])), metal.map_or(255, |t| t[0]), 255]
            };
            Ok(combined(images, texel))
        })?;
        if rough.is_some() {
            material.roughness = 1.0;
        }
        if metal.is_some() {
            material.metallic = 1.0;
        }
        material.metallic_roughness_texture = Some(map.reference(texture));
        Ok(())
    }

    /// d, Tr and map_d: opacity. The mask becomes the alpha channel of the base colour texture.
    fn holes(
        &mut self,
        mtl: &Path,
        material: &mut Material,
        opacity: Option<f64>,
        color_map: Option<&TextureMap>,
        map: Option<TextureMap>,
    ) -> Result<()> {
        if opacity.is_some_and(|d| d <= 0.0) {
            material.base_color.w = 0.0;
            material.alpha_mode = AlphaMode::Mask { cutoff: 0.5 };
            self.holes += 1;
            return Ok(());
        }
        let alpha_mode = match opacity {
            Some(share) if share < 1.0 => {
                material.base_color.w = share as f32;
                material.alpha_mode = AlphaMode::Blend;
                AlphaMode::Blend
            }
            _ => AlphaMode::Mask { cutoff: 0.5 },
        };
        let Some((mask_file, mask)) = self.image(mtl, map.as_ref())? else { return Ok(()) };
        let map = map.expect("its image was found");
        let has_alpha = mask.texels.iter().any(|t| t[3] < 255);
        let color = self.image(mtl, color_map)?;
        // map_d names the file of map_Kd, which has no alpha: exporters mean an opaque material.
        if !has_alpha && color.as_ref().is_some_and(|(file, _)| *file == mask_file) {
            return Ok(());
        }
        if color.is_some() && !color_map.is_some_and(|color| color.is_aligned(&map)) {
            tracing::warn!(
                "{}: \"{}\" has a map_d whose transform differs from map_Kd; it is ignored",
                mtl.display(),
                material.name
            );
            return Ok(());
        }
        let channel = if has_alpha { 3 } else { 0 };
        let recipe = (vec![color.as_ref().map(|(file, _)| file.clone()), Some(mask_file)], Encoding::Srgb);
        let texture = self.images.made(recipe, |_| {
            let texel = |[color, mask]: [Option<[u8; 4]>; 2]| {
                let [r, g, b, _] = color.unwrap_or([255; 4]);
                [r, g, b, mask.map_or(255, |t| t[channel])]
            };
            Ok(combined([color.as_ref().map(|(_, image)| &**image), Some(&*mask)], texel))
        })?;
        material.base_color_texture = Some(map.reference(texture));
        material.alpha_mode = alpha_mode;
        Ok(())
    }
}
