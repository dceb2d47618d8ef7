//! The deep framebuffer on the device.

use std::sync::Arc;

use glam::DVec3;

use crate::bake::DeepFramebuffer;
use crate::bake::framebuffer::view_samples::resolve;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Buffer, Context};
use crate::shared::*;

/// Buffers of the deep framebuffer that kernels read, and the emission.
pub struct GpuFramebuffer {
    pub samples: Buffer<ViewSample>,
    pub brdfs: Buffer<Brdf>,
    pub extra_samples: Buffer<ExtraSample>,
    pub extra_indices: Buffer<u32>,
    pub extra_pixels: Buffer<ExtraPixel>,
    /// Planes R, G, B; `None` if nothing emits.
    pub emission: Option<Buffer<f32>>,
}

impl GpuFramebuffer {
    pub fn new(context: &Arc<Context>, framebuffer: &DeepFramebuffer, transfer: Option<&Transfer>) -> Result<Self> {
        Ok(Self {
            samples: Buffer::from_slice(context, "view samples", &framebuffer.samples)?,
            brdfs: Buffer::from_slice(context, "brdfs", &framebuffer.brdfs)?,
            extra_samples: Buffer::from_slice(context, "view samples (extra)", &framebuffer.extra_samples)?,
            extra_indices: Buffer::from_slice(context, "view samples (extra indices)", &framebuffer.extra_indices)?,
            extra_pixels: Buffer::from_slice(context, "view samples (extra pixels)", &framebuffer.extra_pixels)?,
            emission: upload_emission(context, framebuffer, transfer)?,
        })
    }
}

/// Uploads the emission; `None` if nothing emits.
pub fn upload_emission(
    context: &Arc<Context>,
    framebuffer: &DeepFramebuffer,
    transfer: Option<&Transfer>,
) -> Result<Option<Buffer<f32>>> {
    let emission = emission(framebuffer, transfer);
    (!emission.is_empty()).then(|| Buffer::from_slice(context, "emission", &emission)).transpose()
}

/// Radiance of visible emitters and all their indirect light: planes R, G, B; empty if nothing emits.
fn emission(framebuffer: &DeepFramebuffer, transfer: Option<&Transfer>) -> Vec<f32> {
    let Some(transfer) = transfer.filter(|t| !t.emission.is_empty()) else {
        return framebuffer.emission.clone();
    };
    let stride = framebuffer.pixel_stride();
    let radiance: Vec<DVec3> = transfer.emission.iter().map(|e| e.as_dvec3()).collect();
    let (pixels, extras) = radiance.split_at(stride);
    let mut image = pixels.to_vec();
    resolve(
        &framebuffer.extra_pixels,
        &framebuffer.extra_indices,
        &framebuffer.extra_samples,
        extras,
        u32::MAX,
        &mut image,
    );
    let mut planes = framebuffer.emission.clone();
    planes.resize(3 * stride, 0.0);
    for (i, pixel) in image.iter().enumerate() {
        (0..3).for_each(|plane| planes[plane * stride + i] += pixel[plane] as f32);
    }
    planes
}
