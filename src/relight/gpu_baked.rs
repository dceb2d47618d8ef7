//! The baked data on the device.

use std::sync::Arc;

use glam::DVec3;

use crate::bake::Baked;
use crate::bake::view_samples::resolve;
use crate::error::Result;
use crate::gpu::{Buffer, Context};
use crate::shared::*;

/// The baked data that kernels read.
pub struct GpuBaked {
    pub samples: Buffer<ViewSample>,
    pub brdfs: Buffer<Brdf>,
    pub extra_samples: Buffer<ExtraSample>,
    pub extra_indices: Buffer<u32>,
    pub extra_pixels: Buffer<ExtraPixel>,
    pub emission: Option<Buffer<f32>>,
}

impl GpuBaked {
    pub fn new(context: &Arc<Context>, baked: &Baked) -> Result<Self> {
        Ok(Self {
            samples: Buffer::from_slice(context, "view samples", &baked.samples)?,
            brdfs: Buffer::from_slice(context, "brdfs", &baked.brdfs)?,
            extra_samples: Buffer::from_slice(context, "view samples (extra)", &baked.extra_samples)?,
            extra_indices: Buffer::from_slice(context, "view samples (extra indices)", &baked.extra_indices)?,
            extra_pixels: Buffer::from_slice(context, "view samples (extra pixels)", &baked.extra_pixels)?,
            emission: upload_emission(context, baked)?,
        })
    }
}

pub fn upload_emission(context: &Arc<Context>, baked: &Baked) -> Result<Option<Buffer<f32>>> {
    let emission = emission(baked);
    (!emission.is_empty()).then(|| Buffer::from_slice(context, "emission", &emission)).transpose()
}

/// Emitters as seen and all their indirect light: planes R, G, B; empty where nothing emits.
fn emission(baked: &Baked) -> Vec<f32> {
    let Some(transfer) = baked.transfer.as_ref().filter(|t| !t.emission.is_empty()) else {
        return baked.emission.clone();
    };
    let stride = baked.pixel_stride();
    let radiance: Vec<DVec3> = transfer.emission.iter().map(|e| e.as_dvec3()).collect();
    let (pixels, extras) = radiance.split_at(stride);
    let mut image = pixels.to_vec();
    resolve(&baked.extra_pixels, &baked.extra_indices, &baked.extra_samples, extras, u32::MAX, &mut image);
    let mut planes = baked.emission.clone();
    planes.resize(3 * stride, 0.0);
    for (i, pixel) in image.iter().enumerate() {
        (0..3).for_each(|plane| planes[plane * stride + i] += pixel[plane] as f32);
    }
    planes
}
