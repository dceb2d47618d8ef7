//! Materials and the textures that they look at.

use std::borrow::Cow;
use std::collections::HashMap;

use glam::{Mat3, Vec2, Vec3, Vec4};
use gltf::json;
use json::extensions::texture::TextureTransform;
use json::texture::WrappingMode;
use rayon::prelude::*;

use super::document::Document;
use crate::error::{Error, Result};
use crate::scene::texture::MAX_TEXELS;
use crate::scene::{AlphaMode, Encoding, Material, Texture, TextureRef, Wrap, files};

/// The materials in use so far, in the order of their first use.
pub struct Materials<'a> {
    document: &'a Document,
    materials: Vec<Material>,
    /// By index in the file; `None` is glTF's default material.
    indices: HashMap<Option<usize>, usize>,
    /// What each texture is decoded from: an image of the file, and how to read it.
    textures: Vec<(usize, Encoding)>,
    texture_indices: HashMap<(usize, Encoding), usize>,
    blend_warned: bool,
}

/// The texture of a material: index, texture coordinate set and transform.
struct Info {
    index: usize,
    tex_coord: u32,
    transform: Option<TextureTransform>,
}

impl From<&json::texture::Info> for Info {
    fn from(info: &json::texture::Info) -> Self {
        let transform = info.extensions.as_ref().and_then(|e| e.texture_transform.clone());
        Self { index: info.index.value(), tex_coord: info.tex_coord, transform }
    }
}

impl<'a> Materials<'a> {
    pub fn new(document: &'a Document) -> Self {
        let (materials, indices, textures, texture_indices) = Default::default();
        Self { document, materials, indices, textures, texture_indices, blend_warned: false }
    }

    /// Index of a material of the file among those in use, and the material.
    pub fn get(&mut self, index: Option<usize>, asked_by: &str) -> Result<(usize, &Material)> {
        let known = match self.indices.get(&index) {
            Some(&known) => known,
            None => {
                let material = match index {
                    Some(index) => self.import(index, asked_by)?,
                    None => Material::default(),
                };
                self.materials.push(material);
                self.indices.insert(index, self.materials.len() - 1);
                self.materials.len() - 1
            }
        };
        Ok((known, &self.materials[known]))
    }

    /// All materials in use, and their textures, decoded.
    pub fn finish(self) -> Result<(Vec<Material>, Vec<Texture>)> {
        let mut texels = 0;
        for &(image, _) in &self.textures {
            texels += self.document.texel_count(image)?;
            if texels > MAX_TEXELS {
                let reason = format!("image {image}: the textures are more than {MAX_TEXELS} texels together");
                return Err(self.document.error(reason));
            }
        }
        let decode = |&(image, encoding): &(usize, Encoding)| self.document.decode_image(image, encoding);
        let textures = self.textures.par_iter().map(decode).collect::<Result<_>>()?;
        Ok((self.materials, textures))
    }

    fn import(&mut self, index: usize, asked_by: &str) -> Result<Material> {
        let document = self.document;
        let source = document.item(&document.root.materials, index, "material", asked_by)?;
        let name = source.name.clone().unwrap_or_else(|| format!("material{index}"));
        let what = format!("material {index} \"{name}\"");
        let pbr = &source.pbr_metallic_roughness;
        let extensions = source.extensions.as_ref();
        let specular = extensions.and_then(|e| e.specular.clone()).unwrap_or_default();
        let strength = extensions.and_then(|e| e.emissive_strength.as_ref()).map_or(1.0, |s| s.emissive_strength.0);
        let alpha_mode = match document.valid(source.alpha_mode, &format!("{what}: the alpha mode"))? {
            json::material::AlphaMode::Opaque => AlphaMode::Opaque,
            json::material::AlphaMode::Mask => AlphaMode::Mask { cutoff: source.alpha_cutoff.unwrap_or_default().0 },
            json::material::AlphaMode::Blend => {
                if !std::mem::replace(&mut self.blend_warned, true) {
                    let path = document.path.display();
                    tracing::warn!("{path}: {what} blends; such materials are taken as opaque");
                }
                AlphaMode::Opaque
            }
        };
        let normal = source.normal_texture.as_ref();
        let normal_info = normal.map(normal_info).transpose();
        let normal_info = normal_info.map_err(|e| {
            Error::import_from(&document.path, format!("{what}: the transform of its normal texture"), e)
        })?;
        let mut texture = |info: Option<Info>, encoding| self.texture(info, encoding, &what);
        let material = Material {
            base_color: Vec4::from_array(pbr.base_color_factor.0),
            base_color_texture: texture(pbr.base_color_texture.as_ref().map(Info::from), Encoding::Srgb)?,
            metallic: pbr.metallic_factor.0,
            roughness: pbr.roughness_factor.0,
            metallic_roughness_texture: texture(
                pbr.metallic_roughness_texture.as_ref().map(Info::from),
                Encoding::Linear,
            )?,
            normal_texture: texture(normal_info, Encoding::Linear)?,
            normal_scale: normal.map_or(1.0, |n| n.scale),
            emissive: Vec3::from_array(source.emissive_factor.0) * strength,
            emissive_texture: texture(source.emissive_texture.as_ref().map(Info::from), Encoding::Srgb)?,
            specular: specular.specular_factor.0,
            specular_texture: texture(specular.specular_texture.as_ref().map(Info::from), Encoding::Linear)?,
            specular_color: Vec3::from_array(specular.specular_color_factor.0),
            specular_color_texture: texture(specular.specular_color_texture.as_ref().map(Info::from), Encoding::Srgb)?,
            ior: extensions.and_then(|e| e.ior.as_ref()).map_or(1.5, |i| i.ior.0),
            alpha_mode,
            double_sided: source.double_sided,
            strip_diffuse: false,
            name,
        };
        checked(material).map_err(|reason| document.error(format!("{what}: {reason}")))
    }

    fn texture(&mut self, info: Option<Info>, encoding: Encoding, what: &str) -> Result<Option<TextureRef>> {
        let Some(info) = info else { return Ok(None) };
        let document = self.document;
        let source = document.item(&document.root.textures, info.index, "texture", what)?;
        let what = format!("{what}: texture {}", info.index);
        // 2^32 - 1 is what the crate makes of a missing source.
        if source.source.value() == u32::MAX as usize {
            return Err(document.error(format!("{what} has no image that we can read")));
        }
        let image = source.source.value();
        document.item(&document.root.images, image, "image", &what)?;
        let wrap = match source.sampler {
            None => [Wrap::Repeat; 2],
            Some(sampler) => {
                let sampler = document.item(&document.root.samplers, sampler.value(), "sampler", &what)?;
                let wrap = |mode| -> Result<Wrap> {
                    Ok(match document.valid(mode, &format!("{what}: the wrapping mode"))? {
                        WrappingMode::ClampToEdge => Wrap::Clamp,
                        WrappingMode::MirroredRepeat => Wrap::Mirror,
                        WrappingMode::Repeat => Wrap::Repeat,
                    })
                };
                [wrap(sampler.wrap_s)?, wrap(sampler.wrap_t)?]
            }
        };
        let uv_set = info.transform.as_ref().and_then(|t| t.tex_coord).unwrap_or(info.tex_coord) as usize;
        if uv_set > 1 {
            return Err(document.error(format!("{what} uses TEXCOORD_{uv_set}; only sets 0 and 1 are read")));
        }
        let uv_transform = info.transform.as_ref().map_or(Mat3::IDENTITY, uv_transform);
        if !uv_transform.is_finite() {
            return Err(document.error(format!("{what}: its transform is not finite")));
        }
        let texture = *self.texture_indices.entry((image, encoding)).or_insert_with(|| {
            self.textures.push((image, encoding));
            self.textures.len() - 1
        });
        Ok(Some(TextureRef { texture, uv_set, uv_transform, wrap }))
    }
}

impl Document {
    fn texel_count(&self, index: usize) -> Result<u64> {
        let count = Texture::texel_count(&self.image_file(index)?);
        count.map_err(|e| self.undecodable(index, e))
    }

    fn decode_image(&self, index: usize, encoding: Encoding) -> Result<Texture> {
        let name = self.root.images[index].name.clone().unwrap_or_else(|| format!("image{index}"));
        let texture = Texture::decode(name, &self.image_file(index)?, encoding);
        texture.map_err(|e| self.undecodable(index, e))
    }

    fn image_file(&self, index: usize) -> Result<Cow<'_, [u8]>> {
        let image = &self.root.images[index];
        let what = self.image_name(index);
        if let Some(mime) = &image.mime_type
            && !json::image::VALID_MIME_TYPES.contains(&mime.0.as_str())
        {
            return Err(self.error(format!("{what} is of type {}, expected PNG or JPEG", files::shortened(&mime.0))));
        }
        match (&image.uri, image.buffer_view) {
            (Some(uri), _) => Ok(files::read_uri(&self.path, uri, &what)?.into()),
            (None, Some(view)) => Ok(self.view(view.value(), &what)?.into()),
            (None, None) => Err(self.error(format!("{what} has neither a URI nor a buffer view"))),
        }
    }

    fn undecodable(&self, index: usize, cause: image::ImageError) -> Error {
        Error::import_from(&self.path, format!("{} cannot be decoded", self.image_name(index)), cause)
    }

    /// `image 3 "bricks"`.
    fn image_name(&self, index: usize) -> String {
        match &self.root.images[index].name {
            Some(name) => format!("image {index} \"{name}\""),
            None => format!("image {index}"),
        }
    }
}

/// The gltf crate knows no extensions of normal textures, but keeps them.
fn normal_info(normal: &json::material::NormalTexture) -> Result<Info, serde_json::Error> {
    let transform = normal.extensions.as_ref().and_then(|e| e.others.get("KHR_texture_transform"));
    // Through text: the type borrows its extras from it.
    let transform = transform.map(|t| serde_json::from_str(&t.to_string())).transpose()?;
    Ok(Info { index: normal.index.value(), tex_coord: normal.tex_coord, transform })
}

/// `KHR_texture_transform` as a matrix on (u, v, 1).
///
/// The extension's text turns counter-clockwise where v points down, and so do its example and everybody's code; the
/// GLSL in it turns the other way.
fn uv_transform(transform: &TextureTransform) -> Mat3 {
    let offset = Vec2::from_array(transform.offset.0);
    let scale = Vec2::from_array(transform.scale.0);
    Mat3::from_translation(offset) * Mat3::from_angle(-transform.rotation.0) * Mat3::from_scale(scale)
}

/// Factors in the ranges that shading counts on: finite and not negative, those that are shares clamped to 1.
fn checked(mut material: Material) -> Result<Material, &'static str> {
    let shares = [&mut material.metallic, &mut material.roughness, &mut material.specular];
    for share in shares {
        if !(share.is_finite() && *share >= 0.0) {
            return Err("a factor is negative or not finite");
        }
        *share = share.min(1.0);
    }
    let (emissive, specular_color) = (material.emissive.to_array(), material.specular_color.to_array());
    let colors = material.base_color.to_array().into_iter().chain(emissive).chain(specular_color);
    if !colors.clone().all(|c| c.is_finite() && c >= 0.0) {
        return Err("a colour is negative or not finite");
    }
    if !material.normal_scale.is_finite() {
        return Err("its normal scale is not finite");
    }
    // 0 stands for infinity [KHR_materials_ior].
    if !(material.ior.is_finite() && (material.ior >= 1.0 || material.ior == 0.0)) {
        return Err("its index of refraction is neither 0 nor at least 1");
    }
    if let AlphaMode::Mask { cutoff } = material.alpha_mode
        && !cutoff.is_finite()
    {
        return Err("its alpha cutoff is not finite");
    }
    material.base_color = material.base_color.min(Vec4::ONE);
    Ok(material)
}
