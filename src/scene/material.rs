//! glTF 2.0 metallic-roughness materials, and their evaluation at a surface point.

use glam::{Mat3, Vec2, Vec3, Vec4};

use super::texture::{Texture, Wrap};

/// Smallest z of a tangent-space normal before it is scaled: glTF maps point out of the surface (blue from 128 to 255).
/// Images that are no normal maps would otherwise let light through from behind.
const LEAST_NORMAL_Z: f32 = 1.0 / 255.0;

/// glTF's material: factors, each with an optional texture that multiplies it. Defaults are glTF's.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Material {
    pub name: String,
    /// Linear RGBA.
    pub base_color: Vec4,
    pub base_color_texture: Option<TextureRef>,
    pub metallic: f32,
    pub roughness: f32,
    /// G roughness, B metallic, linear.
    pub metallic_roughness_texture: Option<TextureRef>,
    pub normal_texture: Option<TextureRef>,
    pub normal_scale: f32,
    /// Linear radiance, including `KHR_materials_emissive_strength`.
    pub emissive: Vec3,
    pub emissive_texture: Option<TextureRef>,
    /// `KHR_materials_specular`.
    pub specular: f32,
    pub specular_texture: Option<TextureRef>,
    pub specular_color: Vec3,
    pub specular_color_texture: Option<TextureRef>,
    /// `KHR_materials_ior`.
    pub ior: f32,
    pub alpha_mode: AlphaMode,
    pub double_sided: bool,
    /// Omits the diffuse lobe [Yang 2007, Figure 5.4].
    pub strip_diffuse: bool,
}

/// How alpha affects a surface.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub enum AlphaMode {
    Opaque,
    /// Fully transparent where alpha is below the cutoff, else opaque.
    Mask {
        cutoff: f32,
    },
    /// Blocks the share alpha of the light; the rest passes straight through.
    Blend,
}

impl AlphaMode {
    /// Coverage in [0, 1] at `alpha`: the share of light that the surface blocks.
    pub fn coverage(self, alpha: f32) -> f32 {
        match self {
            Self::Opaque => 1.0,
            Self::Mask { cutoff } if alpha < cutoff => 0.0,
            Self::Mask { .. } => 1.0,
            Self::Blend => alpha.clamp(0.0, 1.0),
        }
    }
}

/// How a material looks up one texture.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct TextureRef {
    /// Index into [`super::Scene::textures`].
    pub texture: usize,
    /// TEXCOORD set, 0 or 1.
    pub uv_set: usize,
    /// `KHR_texture_transform` as a matrix on (u, v, 1).
    pub uv_transform: Mat3,
    pub wrap: [Wrap; 2],
    /// Whether magnified texels have sharp edges.
    pub is_nearest: bool,
}

/// A material at one point: every factor multiplied by its texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Linear, vertex colour included, in [0, 1].
    pub base_color: Vec3,
    pub alpha: f32,
    pub metallic: f32,
    /// glTF roughness, the square root of GGX alpha.
    pub roughness: f32,
    pub specular: f32,
    pub specular_color: Vec3,
    pub ior: f32,
    pub emissive: Vec3,
    /// 0 if the diffuse lobe is omitted, else 1.
    pub diffuse_weight: f32,
    /// Tangent-space normal from the normal map, unit length; +Z without a map.
    pub normal_t: Vec3,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: "default".into(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            specular: 1.0,
            specular_texture: None,
            specular_color: Vec3::ONE,
            specular_color_texture: None,
            ior: 1.5,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            strip_diffuse: false,
        }
    }
}

impl Material {
    /// All textures of this material.
    pub fn textures(&self) -> impl Iterator<Item = &TextureRef> {
        [
            &self.base_color_texture,
            &self.metallic_roughness_texture,
            &self.normal_texture,
            &self.emissive_texture,
            &self.specular_texture,
            &self.specular_color_texture,
        ]
        .into_iter()
        .flatten()
    }

    /// Whether alpha is 1 everywhere, not counting vertex colours.
    pub fn has_full_alpha(&self, textures: &[Texture]) -> bool {
        let is_full = |t: &TextureRef| textures[t.texture].least[3] == 255;
        self.base_color.w >= 1.0 && self.base_color_texture.as_ref().is_none_or(is_full)
    }

    /// Minimum roughness over all texels.
    pub fn least_roughness(&self, textures: &[Texture]) -> f32 {
        let least = |t: &TextureRef| f32::from(textures[t.texture].least[1]) / 255.0;
        (self.roughness * self.metallic_roughness_texture.as_ref().map_or(1.0, least)).clamp(0.0, 1.0)
    }

    /// Only the glTF roughness of [`Self::evaluate`], from the finest mip level.
    pub fn roughness_at(&self, textures: &[Texture], uvs: [Vec2; 2]) -> f32 {
        let read = |t: &TextureRef| t.sample(textures, uvs, [0.0; 2]).y;
        (self.roughness * self.metallic_roughness_texture.as_ref().map_or(1.0, read)).clamp(0.0, 1.0)
    }

    /// All texture slots, mutable; empty slots are `None`.
    pub fn textures_mut(&mut self) -> [&mut Option<TextureRef>; 6] {
        [
            &mut self.base_color_texture,
            &mut self.metallic_roughness_texture,
            &mut self.normal_texture,
            &mut self.emissive_texture,
            &mut self.specular_texture,
            &mut self.specular_color_texture,
        ]
    }

    /// Only the alpha of [`Self::evaluate`], from the finest mip level.
    pub fn alpha_at(&self, textures: &[Texture], uvs: [Vec2; 2], color: Vec4) -> f32 {
        let read = |t: &TextureRef| t.sample(textures, uvs, [0.0; 2]).w;
        self.base_color.w * self.base_color_texture.as_ref().map_or(1.0, read) * color.w
    }

    /// Evaluates all factors at texture coordinates `uvs` (sets 0 and 1) and vertex colour `color`.
    ///
    /// `footprints` is the pixel width in units of each set, for choosing mip levels; 0 reads the finest.
    pub fn evaluate(&self, textures: &[Texture], uvs: [Vec2; 2], footprints: [f32; 2], color: Vec4) -> Surface {
        let read = |texture: &Option<TextureRef>| match texture {
            Some(t) => t.sample(textures, uvs, footprints),
            None => Vec4::ONE,
        };
        let base_color = self.base_color * read(&self.base_color_texture) * color;
        let metallic_roughness = read(&self.metallic_roughness_texture);
        let normal_t = match &self.normal_texture {
            Some(t) => {
                let n = t.sample(textures, uvs, footprints).truncate() * 2.0 - 1.0;
                let n = n.with_z(n.z.max(LEAST_NORMAL_Z));
                (n * Vec3::new(self.normal_scale, self.normal_scale, 1.0)).try_normalize().unwrap_or(Vec3::Z)
            }
            None => Vec3::Z,
        };
        Surface {
            base_color: base_color.truncate().clamp(Vec3::ZERO, Vec3::ONE),
            alpha: base_color.w,
            metallic: (self.metallic * metallic_roughness.z).clamp(0.0, 1.0),
            roughness: (self.roughness * metallic_roughness.y).clamp(0.0, 1.0),
            specular: self.specular * read(&self.specular_texture).w,
            specular_color: self.specular_color * read(&self.specular_color_texture).truncate(),
            ior: self.ior,
            emissive: self.emissive * read(&self.emissive_texture).truncate(),
            diffuse_weight: if self.strip_diffuse { 0.0 } else { 1.0 },
            normal_t,
        }
    }
}

impl TextureRef {
    fn sample(&self, textures: &[Texture], uvs: [Vec2; 2], footprints: [f32; 2]) -> Vec4 {
        let uv = (self.uv_transform * uvs[self.uv_set].extend(1.0)).truncate();
        let scale = self.uv_transform.determinant().abs().sqrt();
        let uv = if self.is_nearest { textures[self.texture].texel_center(uv) } else { uv };
        textures[self.texture].sample(uv, self.wrap, footprints[self.uv_set] * scale)
    }
}
