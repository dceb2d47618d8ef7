//! Worst case of a deep framebuffer: its cost without the optimizations for a particular scene.

use super::DeepFramebuffer;
use super::view_samples::{EMPTY_SAMPLE, pack};
use crate::shared::{ExtraPixel, ExtraSample, NO_BRDF};

impl DeepFramebuffer {
    /// The same picture from a framebuffer with all mirror layers at all pixels, one BRDF per sample, and a specular
    /// lobe. Existing samples retain their places.
    pub fn into_worst_case(mut self) -> Self {
        let pixels = self.pixel_stride();
        for sample in self.samples.iter_mut().filter(|s| s.brdf != NO_BRDF) {
            self.brdfs.push(self.brdfs[sample.brdf as usize]);
            sample.brdf = self.brdfs.len() as u32 - 1;
        }
        self.has_specular = true;

        let mut listed: Vec<Vec<u32>> = vec![Vec::new(); pixels];
        let mut first_weights = vec![1.0; pixels];
        for p in &self.extra_pixels {
            listed[p.pixel as usize] = self.extra_indices[p.first as usize..][..p.count as usize].to_vec();
            first_weights[p.pixel as usize] = p.first_weight;
        }
        self.layers.resize(self.asked_layers as usize, 0);
        for layer in 1..self.asked_layers {
            for list in &mut listed {
                if list.iter().any(|&i| self.extra_samples[i as usize].layer == layer) {
                    continue;
                }
                list.push(self.extra_samples.len() as u32);
                self.extra_samples.push(ExtraSample { layer, ..bytemuck::Zeroable::zeroed() });
                self.samples.push(EMPTY_SAMPLE);
                self.geometric_normals.push(glam::Vec3::ZERO);
                self.lifts.push(0.0);
                self.layers[layer as usize] += 1;
            }
        }
        self.extra_indices.clear();
        self.extra_pixels.clear();
        for ((pixel, list), first_weight) in listed.into_iter().enumerate().zip(first_weights) {
            let (first, count) = (self.extra_indices.len() as u32, list.len() as u32);
            self.extra_pixels.push(ExtraPixel { pixel: pixel as u32, first, count, first_weight });
            self.extra_indices.extend(list);
        }
        self.packets = pack(&self.samples, &self.geometric_normals, &self.lifts, pixels);
        self
    }
}
