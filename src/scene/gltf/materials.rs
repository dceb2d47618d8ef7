//! Materials and their textures.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use glam::{Mat3, Vec2, Vec3, Vec4};
use gltf::json;
use json::extensions::material::PbrSpecularGlossiness;
use json::extensions::texture::TextureTransform;
use json::texture::{MagFilter, WrappingMode};
use json::validation::Checked;
use rayon::prelude::*;

use super::document::Document;
use super::material_extensions::{Missing, make_unlit};
use crate::error::{Error, Result};
use crate::scene::texture::{Image, TexelCount};
use crate::scene::{AlphaMode, Encoding, Material, Texture, TextureRef, Wrap, files};

/// Materials in use so far, in order of first use.
pub struct Materials<'a> {
    document: &'a Document,
    materials: Vec<Material>,
    /// For each material, the file's texture coordinate sets that become sets 0 and 1.
    uv_sets: Vec<[Option<u32>; 2]>,
    /// Index in `materials` by index in the file; `None` is glTF's default material.
    indices: HashMap<Option<usize>, usize>,
    /// Source of each texture: an image of the file, and its encoding.
    textures: Vec<(usize, Content)>,
    texture_indices: HashMap<(usize, Content), usize>,
    missing: Missing,
}

/// What a texture has of its image.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Content {
    Image(Encoding),
    /// Roughness: 1 less the image's alpha times a glossiness, given by its bits.
    Roughness {
        glossiness: u32,
    },
}

/// Reflectance of a material with the default index of refraction, at normal incidence.
const DEFAULT_REFLECTANCE: f32 = 0.04;

/// What a primitive needs from its material.
pub struct MaterialUse {
    /// Index among the materials in use.
    pub index: usize,
    /// The file's texture coordinate sets that become sets 0 and 1.
    pub uv_sets: [Option<u32>; 2],
    /// Which of these two the normal map uses.
    pub tangents_from: Option<usize>,
    /// Whether its own colour is shown.
    pub is_unlit: bool,
}

/// Magic bytes of KTX2 files.
const KTX2: &[u8] = b"\xabKTX 20\xbb\r\n\x1a\n";

const NO_KTX2: &str = "is KTX2 (KHR_texture_basisu), which is not supported; PNG, JPEG and WebP are";

const UNLIT: &str = "KHR_materials_unlit";

const MIME_TYPES: [&str; 3] = ["image/png", "image/jpeg", "image/webp"];

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
        let (materials, uv_sets, indices, textures, texture_indices) = Default::default();
        let missing = Missing::default();
        Self { document, materials, uv_sets, indices, textures, texture_indices, missing }
    }

    /// Material `index` of the file, imported on its first use.
    pub fn get(&mut self, index: Option<usize>, asked_by: &str) -> Result<MaterialUse> {
        let known = match self.indices.get(&index) {
            Some(&known) => known,
            None => {
                let mut material = match index {
                    Some(index) => self.import(index, asked_by)?,
                    None => Material::default(),
                };
                let (uv_sets, is_short) = two_uv_sets(&mut material);
                self.missing.short_of_uv_sets += usize::from(is_short);
                self.materials.push(material);
                self.uv_sets.push(uv_sets);
                self.indices.insert(index, self.materials.len() - 1);
                self.materials.len() - 1
            }
        };
        let material = &self.materials[known];
        let tangents_from = material.normal_texture.as_ref().map(|t| t.uv_set);
        let extensions = index.and_then(|index| self.document.root.materials[index].extensions.as_ref());
        let is_unlit = extensions.is_some_and(|extensions| extensions.others.contains_key(UNLIT));
        Ok(MaterialUse { index: known, uv_sets: self.uv_sets[known], tangents_from, is_unlit })
    }

    /// All materials in use, and their decoded textures.
    pub fn finish(self) -> Result<(Vec<Material>, Vec<Texture>)> {
        let mut texels = TexelCount::default();
        for &(image, _) in &self.textures {
            self.document.count_texels(image, &mut texels)?;
        }
        let decode = |&(image, content): &(usize, Content)| self.document.decode_image(image, content);
        let textures = self.textures.par_iter().map(decode).collect::<Result<_>>()?;
        self.missing.warn(self.document);
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
            json::material::AlphaMode::Blend => AlphaMode::Blend,
        };
        let normal = source.normal_texture.as_ref();
        let normal_info = normal.map(normal_info).transpose();
        let normal_info = normal_info.map_err(|e| {
            Error::import_from(&document.path, format!("{what}: the transform of its normal texture"), e)
        })?;
        let mut texture = |info: Option<Info>, encoding| self.texture(info, Content::Image(encoding), &what);
        let mut material = Material {
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
        if let Some(glossy) = extensions.and_then(|e| e.pbr_specular_glossiness.as_ref()) {
            self.take_specular_glossiness(glossy, &mut material, &what)?;
        }
        let material = checked(material, &document.path, &what);
        let mut material = material.map_err(|reason| document.error(format!("{what}: {reason}")))?;
        if let Some(others) = extensions.map(|e| &e.others) {
            self.missing.count(others);
            if others.contains_key(UNLIT) {
                make_unlit(&mut material);
            }
        }
        Ok(material)
    }

    /// `KHR_materials_pbrSpecularGlossiness` of older files, in place of metallic-roughness. Metals are dielectrics
    /// whose reflectance is a colour.
    fn take_specular_glossiness(
        &mut self,
        glossy: &PbrSpecularGlossiness,
        material: &mut Material,
        what: &str,
    ) -> Result<()> {
        let mut texture =
            |info: Option<&json::texture::Info>, content| self.texture(info.map(Info::from), content, what);
        let (reflectance, glossiness) = (glossy.specular_glossiness_texture.as_ref(), glossy.glossiness_factor.0);
        let from_alpha = Content::Roughness { glossiness: glossiness.to_bits() };
        material.base_color = Vec4::from_array(glossy.diffuse_factor.0);
        material.base_color_texture = texture(glossy.diffuse_texture.as_ref(), Content::Image(Encoding::Srgb))?;
        (material.metallic, material.ior) = (0.0, 1.5);
        (material.specular, material.specular_texture) = (1.0, None);
        material.specular_color = Vec3::from_array(glossy.specular_factor.0) / DEFAULT_REFLECTANCE;
        material.specular_color_texture = texture(reflectance, Content::Image(Encoding::Srgb))?;
        material.metallic_roughness_texture = texture(reflectance, from_alpha)?;
        material.roughness = if reflectance.is_some() { 1.0 } else { 1.0 - glossiness };
        Ok(())
    }

    fn texture(&mut self, info: Option<Info>, content: Content, what: &str) -> Result<Option<TextureRef>> {
        let Some(info) = info else { return Ok(None) };
        let document = self.document;
        let source = document.item(&document.root.textures, info.index, "texture", what)?;
        let what = format!("{what}: texture {}", info.index);
        let extension = |name| source.extensions.as_ref().and_then(|e| e.others.get(name)?.get("source")?.as_u64());
        // The gltf crate represents a missing source by 2^32 - 1.
        let plain = Some(source.source.value()).filter(|&image| image != u32::MAX as usize);
        let Some(image) = extension("EXT_texture_webp").map(|image| image as usize).or(plain) else {
            let reason = match extension("KHR_texture_basisu") {
                Some(_) => NO_KTX2,
                None => "has no image that we can read",
            };
            return Err(document.error(format!("{what} {reason}")));
        };
        document.item(&document.root.images, image, "image", &what)?;
        let (wrap, is_nearest) = match source.sampler {
            None => ([Wrap::Repeat; 2], false),
            Some(sampler) => {
                let sampler = document.item(&document.root.samplers, sampler.value(), "sampler", &what)?;
                let wrap = |mode| -> Result<Wrap> {
                    Ok(match document.valid(mode, &format!("{what}: the wrapping mode"))? {
                        WrappingMode::ClampToEdge => Wrap::Clamp,
                        WrappingMode::MirroredRepeat => Wrap::Mirror,
                        WrappingMode::Repeat => Wrap::Repeat,
                    })
                };
                let is_nearest = sampler.mag_filter == Some(Checked::Valid(MagFilter::Nearest));
                ([wrap(sampler.wrap_s)?, wrap(sampler.wrap_t)?], is_nearest)
            }
        };
        let uv_set = info.transform.as_ref().and_then(|t| t.tex_coord).unwrap_or(info.tex_coord) as usize;
        let uv_transform = info.transform.as_ref().map_or(Mat3::IDENTITY, uv_transform);
        if !uv_transform.is_finite() {
            return Err(document.error(format!("{what}: its transform is not finite")));
        }
        let texture = *self.texture_indices.entry((image, content)).or_insert_with(|| {
            self.textures.push((image, content));
            self.textures.len() - 1
        });
        Ok(Some(TextureRef { texture, uv_set, uv_transform, wrap, is_nearest }))
    }
}

impl Document {
    fn decode_image(&self, index: usize, content: Content) -> Result<Texture> {
        let name = self.root.images[index].name.clone().unwrap_or_else(|| format!("image{index}"));
        let image = self.image(index)?;
        Ok(match content {
            Content::Image(encoding) => Texture::of(name, image, encoding),
            Content::Roughness { glossiness } => {
                let rough = |alpha: u8| 255.0 - f32::from_bits(glossiness) * f32::from(alpha);
                let texels = image.texels.iter().map(|texel| [255, rough(texel[3]).round() as u8, 255, 255]);
                Texture::new(name, image.width, image.height, texels.collect(), Encoding::Linear)
            }
        })
    }

    /// Adds an image to `texels`, or returns why it is refused.
    pub fn count_texels(&self, index: usize, texels: &mut TexelCount) -> Result<()> {
        let (file, name) = (self.image_file(index)?, self.image_name(index));
        if file.starts_with(KTX2) {
            return Err(self.error(format!("{name} {NO_KTX2}")));
        }
        texels.add(&file, Path::new("")).map_err(|refusal| refusal.at(&self.path, &name))
    }

    pub fn image(&self, index: usize) -> Result<Image> {
        let image = Image::decode(&self.image_file(index)?, Path::new(""));
        image.map_err(|e| Error::import_from(&self.path, format!("{} cannot be decoded", self.image_name(index)), e))
    }

    pub fn image_file(&self, index: usize) -> Result<Cow<'_, [u8]>> {
        let image = &self.root.images[index];
        let what = self.image_name(index);
        if image.mime_type.as_ref().is_some_and(|mime| mime.0 == "image/ktx2") {
            return Err(self.error(format!("{what} {NO_KTX2}")));
        }
        if let Some(mime) = &image.mime_type
            && !MIME_TYPES.contains(&mime.0.as_str())
            // Some exporters write jpg.
            && mime.0 != "image/jpg"
        {
            return Err(
                self.error(format!("{what} is of type {}, expected PNG, JPEG or WebP", files::shortened(&mime.0)))
            );
        }
        match (&image.uri, image.buffer_view) {
            (Some(uri), _) => Ok(files::read_uri(&self.path, uri, &what)?.into()),
            (None, Some(view)) => Ok(self.view(view.value(), &what)?.into()),
            (None, None) => Err(self.error(format!("{what} has neither a URI nor a buffer view"))),
        }
    }

    /// `image 3 "bricks"`.
    pub fn image_name(&self, index: usize) -> String {
        match &self.root.images[index].name {
            Some(name) => format!("image {index} \"{name}\""),
            None => format!("image {index}"),
        }
    }
}

/// Renumbers the texture coordinate sets that a material uses to 0 and 1, because a mesh has only two. Returns the
/// file's number for each, and whether textures were dropped because the material uses more than two sets.
fn two_uv_sets(material: &mut Material) -> ([Option<u32>; 2], bool) {
    let mut used: Vec<usize> = Vec::new();
    for texture in material.textures() {
        if !used.contains(&texture.uv_set) {
            used.push(texture.uv_set);
        }
    }
    let is_short = used.len() > 2;
    used.truncate(2);
    used.sort_unstable();
    // Sets 0 and 1 do not change.
    let slots = match used[..] {
        [] => [None, None],
        [1] => [None, Some(1)],
        [set] => [Some(set), None],
        [a, b, ..] => [Some(a), Some(b)],
    };
    for texture in material.textures_mut() {
        let slot = texture.as_ref().map(|t| slots.iter().position(|&s| s == Some(t.uv_set)));
        match (texture.as_mut(), slot) {
            (Some(texture), Some(Some(slot))) => texture.uv_set = slot,
            (Some(_), Some(None)) => *texture = None,
            _ => {}
        }
    }
    (slots.map(|set| set.map(|set| set as u32)), is_short)
}

/// The gltf crate does not parse extensions of normal textures, but retains them.
fn normal_info(normal: &json::material::NormalTexture) -> Result<Info, serde_json::Error> {
    let transform = normal.extensions.as_ref().and_then(|e| e.others.get("KHR_texture_transform"));
    // Through text, because the type borrows its extras from it.
    let transform = transform.map(|t| serde_json::from_str(&t.to_string())).transpose()?;
    Ok(Info { index: normal.index.value(), tex_coord: normal.tex_coord, transform })
}

/// `KHR_texture_transform` as a matrix on (u, v, 1).
///
/// The extension's text rotates counter-clockwise with v pointing down, as do its example and all implementations; the
/// GLSL in it rotates the other way.
fn uv_transform(transform: &TextureTransform) -> Mat3 {
    let offset = Vec2::from_array(transform.offset.0);
    let scale = Vec2::from_array(transform.scale.0);
    Mat3::from_translation(offset) * Mat3::from_angle(-transform.rotation.0) * Mat3::from_scale(scale)
}

/// Validates factors for shading: finite and not negative, shares clamped to 1.
fn checked(mut material: Material, path: &Path, what: &str) -> Result<Material, &'static str> {
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
    // Below 1, the surrounding medium is denser; n and 1 / n have equal reflectance at normal incidence.
    if 0.0 < material.ior && material.ior < 1.0 && material.ior.recip().is_finite() {
        tracing::warn!(
            "{}: {what}: its index of refraction {} is taken as {}",
            path.display(),
            material.ior,
            material.ior.recip()
        );
        material.ior = material.ior.recip();
    }
    // 0 means infinity [KHR_materials_ior].
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
