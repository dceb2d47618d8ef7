//! MTL: materials made for Phong shading, as metallic-roughness.
//!
//! [Karis 2013]: B. Karis, Real shading in Unreal Engine 4, SIGGRAPH course notes.
//!
//! - Kd is the base colour, Ke emission, Pr and Pm roughness and metalness, Ni the index of refraction.
//! - Ns, the Blinn-Phong exponent: alpha² = 2 / (Ns + 2) [Karis 2013]; roughness is the square root of alpha.
//! - Ks scales the reflection at normal incidence, 0.5 being glTF's 0.04, as common exporters have it; 0 is Lambert.
//! - illum 0 and 1 have no highlight; illum 3 is a mirror of colour Ks, or Kd.
//! - map_Kd, map_Ke, norm, bump. A grey bump map is a height map, which is left out.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DVec3, Mat3, Vec2, Vec3};

use super::guard::{self, number, split_word};
use crate::error::{Error, Result};
use crate::scene::texture::MAX_TEXELS;
use crate::scene::{Encoding, Material, Texture, TextureRef, Wrap, files};

/// What a face without a material gets.
pub fn default(name: &str) -> Material {
    let name = if name.is_empty() { "default" } else { name };
    Material { name: name.into(), metallic: 0.0, roughness: 1.0, ..Material::default() }
}

/// The materials of all `mtllib`s, and their textures.
#[derive(Default)]
pub struct Library {
    materials: HashMap<String, Material>,
    textures: Vec<Texture>,
    decoded: HashMap<(PathBuf, Encoding), usize>,
    texel_count: u64,
}

/// A texture statement: options, then a file name.
pub struct Map {
    file: String,
    offset: Vec2,
    scale: Vec2,
    clamp: bool,
    /// -bm
    strength: f32,
}

impl Library {
    pub fn get(&self, name: &str) -> Option<Material> {
        self.materials.get(name).cloned()
    }

    pub fn into_textures(self) -> Vec<Texture> {
        self.textures
    }

    /// Reads what a `mtllib` statement names: one file whose name may hold spaces, else several. A missing file is a
    /// warning: many OBJ files travel without theirs.
    pub fn read(&mut self, obj: &Path, statement: &str) -> Result<()> {
        let folder = obj.parent().unwrap_or(Path::new(""));
        let there = |name: &str| files::inside(&name.replace('\\', "/")).map(|p| folder.join(p)).ok();
        let whole = there(statement).filter(|path| path.is_file());
        let paths = match whole {
            Some(path) => vec![(statement, Some(path))],
            None => statement.split_whitespace().map(|name| (name, there(name))).collect(),
        };
        for (name, path) in paths {
            match path.filter(|path| path.is_file()) {
                Some(path) => self.read_file(&path)?,
                None => {
                    let name = files::shortened(name);
                    tracing::warn!("{}: there is no \"{name}\"; its materials are grey", obj.display());
                }
            }
        }
        Ok(())
    }

    fn read_file(&mut self, path: &Path) -> Result<()> {
        let bytes = files::read(path)?;
        let text = guard::mtl(&String::from_utf8_lossy(&bytes)).map_err(|reason| Error::import(path, reason))?;
        let (entries, _) =
            tobj::load_mtl_buf(&mut text.as_bytes()).map_err(|e| Error::import_from(path, "not an MTL file", e))?;
        for entry in entries {
            let material = self.material(path, &entry)?;
            self.materials.insert(entry.name, material);
        }
        Ok(())
    }

    fn material(&mut self, path: &Path, entry: &tobj::Material) -> Result<Material> {
        let color = |rgb: Option<[f64; 3]>| rgb.map(|rgb| DVec3::from(rgb).as_vec3());
        let (kd, ks, ke) = (color(entry.diffuse), color(entry.specular), color(entry.emissive));
        let scalar = |key| entry.unknown_param.get(key).and_then(|text: &String| text.parse::<f32>().ok());
        let map = |text: Option<&String>| {
            text.map(|text| Map::parse(text)).transpose().map_err(|reason| Error::import(path, reason))
        };
        let norm = map(entry.unknown_param.get("norm"))?;

        let mut material = default(&entry.name);
        let is_mirror = entry.illumination_model == Some(3);
        let base = if is_mirror { ks.or(kd) } else { kd };
        material.base_color = base.unwrap_or(Vec3::ONE).clamp(Vec3::ZERO, Vec3::ONE).extend(1.0);
        if is_mirror {
            (material.metallic, material.roughness) = (1.0, 0.0);
        } else {
            // Ns is not negative, so this lies in [0, 1].
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
        if let Some(map) = map(entry.diffuse_texture.as_ref())? {
            // Many exporters write black where a texture replaces the colour.
            if base == Some(Vec3::ZERO) {
                material.base_color = glam::Vec4::ONE;
            }
            material.base_color_texture = Some(self.texture(path, &map, Encoding::Srgb)?);
        }
        if let Some(map) = map(entry.unknown_param.get("map_Ke"))? {
            if ke.is_none_or(|ke| ke == Vec3::ZERO) {
                material.emissive = Vec3::ONE;
            }
            material.emissive_texture = Some(self.texture(path, &map, Encoding::Srgb)?);
        }
        let is_bump = norm.is_none();
        if let Some(map) = norm.or(map(entry.normal_texture.as_ref())?) {
            let texture = self.texture(path, &map, Encoding::Linear)?;
            let texels = &self.textures[texture.texture].levels[0].texels;
            if is_bump && texels.iter().all(|t| t[0] == t[1] && t[1] == t[2]) {
                let file = files::shortened(&map.file);
                tracing::warn!("{}: \"{file}\" is a height map, which is left out", path.display());
            } else {
                material.normal_texture = Some(texture);
                material.normal_scale = map.strength;
            }
        }
        Ok(material)
    }

    fn decode(&mut self, mtl: &Path, map: &Map, path: &Path, encoding: Encoding) -> Result<Texture> {
        let name = files::shortened(&map.file);
        let bytes = files::read(path).map_err(|e| Error::import_from(mtl, format!("cannot read \"{name}\""), e))?;
        let undecodable = |e| Error::import_from(mtl, format!("\"{name}\" cannot be decoded"), e);
        self.texel_count += Texture::texel_count(&bytes).map_err(undecodable)?;
        if self.texel_count > MAX_TEXELS {
            let reason = format!("\"{name}\": the textures are more than {MAX_TEXELS} texels together");
            return Err(Error::import(mtl, reason));
        }
        Texture::decode(map.file.clone(), &bytes, encoding).map_err(undecodable)
    }

    fn texture(&mut self, mtl: &Path, map: &Map, encoding: Encoding) -> Result<TextureRef> {
        let name = files::shortened(&map.file);
        let relative = files::inside(&map.file).map_err(|reason| Error::import(mtl, format!("\"{name}\" {reason}")))?;
        let path = mtl.parent().unwrap_or(Path::new("")).join(relative);
        let key = (path, encoding);
        let texture = match self.decoded.get(&key) {
            Some(&known) => known,
            None => {
                let texture = self.decode(mtl, map, &key.0, encoding)?;
                self.textures.push(texture);
                self.decoded.insert(key, self.textures.len() - 1);
                self.textures.len() - 1
            }
        };
        let wrap = if map.clamp { Wrap::Clamp } else { Wrap::Repeat };
        // Our v is OBJ's turned over, before the transform and after it.
        let turned = Mat3::from_cols(Vec3::X, -Vec3::Y, Vec3::new(0.0, 1.0, 1.0));
        let uv_transform = turned * Mat3::from_translation(map.offset) * Mat3::from_scale(map.scale) * turned;
        Ok(TextureRef { texture, uv_set: 0, uv_transform, wrap: [wrap; 2] })
    }
}

impl Map {
    pub fn parse(rest: &str) -> Result<Self, String> {
        let (offset, scale) = (Vec2::ZERO, Vec2::ONE);
        let mut map = Self { file: String::new(), offset, scale, clamp: false, strength: 1.0 };
        let mut rest = rest;
        while rest.starts_with('-') {
            let (option, mut after) = split_word(rest);
            match option {
                "-o" | "-s" | "-t" => {
                    // One to three numbers.
                    let mut values = Vec::new();
                    while let (word, next) = split_word(after)
                        && values.len() < 3
                        && let Ok(value) = number(word)
                    {
                        values.push(value as f32);
                        after = next;
                    }
                    let default = if option == "-s" { 1.0 } else { 0.0 };
                    let value = |i: usize| values.get(i).copied().unwrap_or(default);
                    match option {
                        "-o" => map.offset = Vec2::new(value(0), value(1)),
                        "-s" => map.scale = Vec2::new(value(0), value(1)),
                        _ => {}
                    }
                }
                "-mm" => after = split_word(split_word(after).1).1,
                "-bm" => {
                    let (word, next) = split_word(after);
                    (map.strength, after) = (number(word)? as f32, next);
                }
                "-clamp" => {
                    let (word, next) = split_word(after);
                    (map.clamp, after) = (word == "on", next);
                }
                "-blendu" | "-blendv" | "-boost" | "-cc" | "-imfchan" | "-texres" | "-type" => {
                    after = split_word(after).1;
                }
                _ => return Err(format!("option {option} is unknown")),
            }
            rest = after;
        }
        map.file = rest.replace('\\', "/");
        if map.file.is_empty() { Err("names no file".into()) } else { Ok(map) }
    }
}
