//! `EXT_lights_image_based`: the environment of a scene as a dome.
//!
//! Where the extension's text leaves a choice, the environment is as Babylon.js shows it, whose authors wrote the text:
//! colours are sRGB. Faces are stored upside down ("flipped"). Cube maps are left-handed: +x of the cube is -x of the
//! scene. The rotation turns the cube in its own axes.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3, Vec4};

use super::container::Container;
use super::document::Document;
use super::profile_files::path_in_file;
use crate::error::Result;
use crate::scene::light_filter::Attached;
use crate::scene::sky_map::CubeFace;
use crate::scene::texture::TexelCount;
use crate::scene::{DomeMap, Encoding, Light, LightKind, SkyMap};

/// Least divisor of RGBD: the smallest of 8 bits.
const LEAST_ALPHA: f32 = 1.0 / 255.0;

impl Document {
    /// The light of the shown scene.
    pub fn image_light(&self) -> Result<Option<Light>> {
        let scene = self.poses.scenes.get(self.shown_scene());
        let Some(index) = scene.and_then(|scene| scene.image_light()) else { return Ok(None) };
        let map = self.sky_map(index, "the scene")?;
        let entry = &self.image_lights()[index];
        let (color, intensity) = self.light_strength(None, entry.intensity.unwrap_or(1.0), &what(index))?;
        let name = entry.name.as_deref().filter(|name| !name.is_empty()).unwrap_or("environment");
        let (rotation, _) = self.rotation(index)?;
        let kind = LightKind::Dome;
        Ok(Some(Light {
            kind,
            color,
            intensity,
            map: Some(DomeMap::File(map)),
            rotation,
            ..Light::point(name, DVec3::ZERO)
        }))
    }

    /// The environment map of light `index`. Its rotation about the vertical is left to [`Light::rotation`].
    fn sky_map(&self, index: usize, asked_by: &str) -> Result<Attached<SkyMap>> {
        let entry = self.item(self.image_lights(), index, "image-based light", asked_by)?;
        let what = what(index);
        let images = entry.specular_images.first().map(Vec::as_slice).unwrap_or_default();
        let images: &[usize; 6] = images.try_into().map_err(|_| {
            self.error(format!("{what}: the first of its specularImages has {} faces, not 6", images.len()))
        })?;
        let (_, cube_from_map) = self.rotation(index)?;
        let mut bytes: Vec<u8> = cube_from_map.to_cols_array().into_iter().flat_map(f64::to_le_bytes).collect();
        let mut texels = TexelCount::default();
        for &image in images {
            self.item(&self.root.images, image, "image", &what)?;
            self.count_texels(image, &mut texels)?;
            bytes.extend_from_slice(&self.image_file(image)?);
        }
        let mut side = None;
        let face = |&index: &usize| {
            let image = self.image(index)?;
            let (width, height, name) = (image.width, image.height, self.image_name(index));
            let side = *side.get_or_insert(width);
            if [width, height] != [side; 2] {
                let reason = format!("{what}: {name} has {width} x {height} texels, expected {side} x {side}");
                return Err(self.error(reason));
            }
            let radiance = |texel: &Vec4| texel.truncate() / texel.w.max(LEAST_ALPHA);
            // Upside down: the last row of the image is the first of the face.
            let rows = image.to_linear(Encoding::Srgb);
            Ok(CubeFace::new(side, rows.rchunks_exact(side).flatten().map(radiance).collect()))
        };
        let faces = images.iter().map(face).collect::<Result<Vec<CubeFace>>>()?;
        let map = SkyMap::of_cube(&faces, cube_from_map.as_mat3());
        Ok(Attached::new(&path_in_file(&self.path, index), &bytes, map))
    }

    /// The rotation of light `index` in two parts: radians about the vertical by which its dome is turned, and what
    /// turns and mirrors directions of the map into those of the cube.
    fn rotation(&self, index: usize) -> Result<(f64, DMat3)> {
        let rotation = DQuat::from_array(self.image_lights()[index].rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
        if !rotation.length_squared().is_normal() {
            return Err(self.error(format!("{}: its rotation is not a quaternion", what(index))));
        }
        let rotation = rotation.normalize();
        // A quaternion and its negative are one rotation.
        let turn = 2.0 * (rotation.y * rotation.w.signum()).atan2(rotation.w.abs());
        let tilt = DQuat::from_rotation_y(-turn) * rotation;
        // Mirrored, a turn has the opposite sense.
        Ok((-turn, DMat3::from_quat(tilt.inverse()) * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))))
    }
}

fn what(index: usize) -> String {
    format!("image-based light {index}")
}

/// Reads the environment map of image-based light `index` of the glTF file at `path`.
pub fn read_sky_map(path: &Path, index: usize) -> Result<Attached<SkyMap>> {
    Document::parse(path, &Container::read(path)?)?.sky_map(index, "the rig")
}
