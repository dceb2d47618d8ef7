//! The deep framebuffer on the device.

use std::collections::HashMap;
use std::sync::Arc;

use glam::DVec3;

use crate::bake::DeepFramebuffer;
use crate::bake::framebuffer::view_samples::resolve;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Buffer, Context};
use crate::scene::{Emitters, Scene};
use crate::shared::*;

/// Buffers of the deep framebuffer that kernels read, and light of emitters.
pub struct GpuFramebuffer {
    pub samples: Buffer<ViewSample>,
    pub brdfs: Buffer<Brdf>,
    pub extra_samples: Buffer<ExtraSample>,
    pub extra_indices: Buffer<u32>,
    pub extra_pixels: Buffer<ExtraPixel>,
    pub emitters: EmitterImages,
}

/// What each emitter contributes to the picture: as it is seen, and all its indirect light. Planes R, G, B.
pub struct EmitterImages {
    /// Emitters that contribute nothing have none.
    images: Vec<Buffer<f32>>,
    /// Index of its image, by the emitter's material.
    by_material: HashMap<String, usize>,
}

impl GpuFramebuffer {
    pub fn new(
        context: &Arc<Context>,
        scene: &Scene,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
    ) -> Result<Self> {
        Ok(Self {
            samples: Buffer::from_slice(context, "view samples", &framebuffer.samples)?,
            brdfs: Buffer::from_slice(context, "brdfs", &framebuffer.brdfs)?,
            extra_samples: Buffer::from_slice(context, "view samples (extra)", &framebuffer.extra_samples)?,
            extra_indices: Buffer::from_slice(context, "view samples (extra indices)", &framebuffer.extra_indices)?,
            extra_pixels: Buffer::from_slice(context, "view samples (extra pixels)", &framebuffer.extra_pixels)?,
            emitters: EmitterImages::new(context, scene, framebuffer, transfer)?,
        })
    }
}

impl EmitterImages {
    pub fn new(
        context: &Arc<Context>,
        scene: &Scene,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
    ) -> Result<Self> {
        let mut all = Self { images: Vec::new(), by_material: HashMap::new() };
        for (emitter, material) in Emitters::of(scene).names.into_iter().enumerate() {
            if let Some(planes) = planes(emitter as u32, framebuffer, transfer) {
                all.by_material.insert(material, all.images.len());
                all.images.push(Buffer::from_slice(context, "emitter", &planes)?);
            }
        }
        Ok(all)
    }

    /// Index of the image of each emitter, by its material.
    pub fn by_material(&self) -> &HashMap<String, usize> {
        &self.by_material
    }

    pub fn image(&self, index: usize) -> &Buffer<f32> {
        &self.images[index]
    }
}

/// Radiance of an emitter as it is seen, and all its indirect light: planes R, G, B; `None` if there is none.
fn planes(emitter: u32, framebuffer: &DeepFramebuffer, transfer: Option<&Transfer>) -> Option<Vec<f32>> {
    let indirect = indirect_of_emitter(emitter, framebuffer, transfer);
    let seen = framebuffer.emission.iter().filter(|part| part.emitter == emitter);
    if indirect.is_none() && seen.clone().next().is_none() {
        return None;
    }
    let mut image = indirect.unwrap_or_else(|| vec![DVec3::ZERO; framebuffer.pixel_stride()]);
    seen.for_each(|part| image[part.pixel as usize] += part.radiance.as_dvec3());
    Some((0..3).flat_map(|plane| image.iter().map(move |pixel| pixel[plane] as f32)).collect())
}

/// Indirect light of an emitter in the pixels of the deep framebuffer; `None` if there is none.
pub fn indirect_of_emitter(
    emitter: u32,
    framebuffer: &DeepFramebuffer,
    transfer: Option<&Transfer>,
) -> Option<Vec<DVec3>> {
    let light = transfer?.emission.iter().find(|light| light.emitter == emitter)?;
    let mut pixels: Vec<DVec3> = light.radiance.iter().map(|e| e.as_dvec3()).collect();
    let extras = pixels.split_off(framebuffer.pixel_stride());
    let DeepFramebuffer { extra_pixels, extra_indices, extra_samples, .. } = framebuffer;
    resolve(extra_pixels, extra_indices, extra_samples, &extras, u32::MAX, &mut pixels);
    Some(pixels)
}
