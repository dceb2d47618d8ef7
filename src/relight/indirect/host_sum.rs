//! Weighted sums of images on the host, for devices whose kernels run on the CPU. The same sum as
//! sum_images.comp.

use glam::Vec3;
use rayon::prelude::*;

/// Floats that one task sums: they stay in the first-level cache.
const CHUNK: usize = 2048;

/// Replaces an image by `kept` times itself plus the images of `terms`, each with a factor for its three planes of
/// `stride` floats.
pub fn sum(image: &mut [f32], stride: usize, terms: &[(&[f32], Vec3)], kept: f32) {
    for (plane, image) in image[..3 * stride].chunks_mut(stride).enumerate() {
        image.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, sums)| {
            let first = plane * stride + chunk * CHUNK;
            if kept > 0.0 {
                sums.iter_mut().for_each(|sum| *sum *= kept);
            } else {
                sums.fill(0.0);
            }
            for (floats, scale) in terms {
                let scale = scale[plane];
                sums.iter_mut().zip(&floats[first..]).for_each(|(sum, float)| *sum += scale * float);
            }
        });
    }
}
