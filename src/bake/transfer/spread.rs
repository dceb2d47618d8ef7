//! Indirect light for more view samples than it was baked to: for anti-aliasing.
//!
//! Further samples lie on edges. Some of these are shadow edges, which move with the lights, while indirect light is
//! baked once. At an edge, indirect light is that of the surface on either side: each further sample uses the row of
//! the most similar sample in its own and the adjacent pixels.

use glam::Vec3;
use rayon::prelude::*;

use super::Transfer;
use super::blocks::BlockMatrix;
use super::sky::SkyTransfer;
use crate::bake::DeepFramebuffer;
use crate::bake::transport::emitted::EmitterLight;
use crate::physics::octahedral;
use crate::shared::{ExtraPixel, NO_BRDF};

/// Distances that correspond to opposite normals and to different materials, as fractions of the scene's radius.
const NORMAL: f32 = 0.02;
const MATERIAL: f32 = 0.1;

impl Transfer {
    /// Extends this transfer from the view samples of `from`, one per pixel, to those of `to`, the same picture with
    /// more samples. `radius` is the scene's. Returns a new transfer: the rows of the last matrix and the emission are
    /// taken from the most similar samples of `from`, `coarse` is empty, and everything else is a copy. A sample
    /// without a similar one gets no indirect light. `None` for row wavelets, which have no blocks.
    pub fn spread(&self, from: &DeepFramebuffer, to: &DeepFramebuffer, radius: f32) -> Option<Self> {
        let (last, inner) = self.chain.split_last()?;
        let sources = sources(from, to, radius);
        let spread_chain = |inner: &[BlockMatrix], last: &BlockMatrix| {
            let mut chain = inner.to_vec();
            chain.push(last.with_rows(&sources));
            chain
        };
        let sky = self.sky.as_ref().map(|sky| {
            let chain = sky.chain.split_last().map_or_else(Vec::new, |(last, inner)| spread_chain(inner, last));
            SkyTransfer { chain, vector_length: sky.vector_length, held_out: sky.held_out.clone() }
        });
        let spread =
            |radiance: &[Vec3]| sources.iter().map(|s| s.map_or(Vec3::ZERO, |s| radiance[s as usize])).collect();
        let spread = |light: &EmitterLight| EmitterLight { radiance: spread(&light.radiance), ..*light };
        let emission = self.emission.iter().map(spread).collect();
        let chain = spread_chain(inner, last);
        Some(Self { chain, coarse: Vec::new(), sparse: None, emission, sky, ..self.clone() })
    }
}

/// For each view sample of `to`, the sample of `from` whose indirect light it uses: that of its pixel, or for extra
/// ones the most similar.
fn sources(from: &DeepFramebuffer, to: &DeepFramebuffer, radius: f32) -> Vec<Option<u32>> {
    let similar = Similar::new(from, to, radius);
    let pixels = to.pixel_stride() as u32;
    let mut sources: Vec<Option<u32>> = (0..pixels).map(Some).collect();
    sources.resize(to.samples.len(), None);
    let of_pixel = |p: &ExtraPixel| {
        let list = &to.extra_indices[p.first as usize..(p.first + p.count) as usize];
        let (pixel, similar) = (p.pixel, &similar);
        list.iter().map(move |&extra| {
            let layer = to.extra_samples[extra as usize].layer;
            (extra, similar.most_similar(pixel, pixels + extra, layer))
        })
    };
    let found: Vec<(u32, Option<u32>)> = to.extra_pixels.par_iter().flat_map_iter(of_pixel).collect();
    for (extra, source) in found {
        sources[(pixels + extra) as usize] = source;
    }
    sources
}

/// View samples of one picture that are similar to those of another one of the same view.
pub struct Similar<'a> {
    from: &'a DeepFramebuffer,
    to: &'a DeepFramebuffer,
    /// Of the scene.
    radius: f32,
    /// Of each pixel of `from`: its extra samples.
    extras: Vec<&'a [u32]>,
}

impl<'a> Similar<'a> {
    pub fn new(from: &'a DeepFramebuffer, to: &'a DeepFramebuffer, radius: f32) -> Self {
        let mut extras: Vec<&[u32]> = vec![&[]; from.pixel_stride()];
        for p in &from.extra_pixels {
            extras[p.pixel as usize] = &from.extra_indices[p.first as usize..(p.first + p.count) as usize];
        }
        Self { from, to, radius, extras }
    }

    /// The sample of `from`, in this pixel or beside it, that is most similar to a sample of `to` in a layer; `None` if
    /// none reflects light.
    pub fn most_similar(&self, pixel: u32, sample: u32, layer: u32) -> Option<u32> {
        let Self { from, to, radius, extras } = self;
        if to.samples[sample as usize].brdf == NO_BRDF {
            return None;
        }
        let scaled = |at: u32, from: u32, to: u32| ((2 * at + 1) as u64 * u64::from(from) / (2 * u64::from(to))) as u32;
        let (x, y) = to.tiling.pixel(pixel as usize);
        let x = scaled(x, from.tiling.width, to.tiling.width);
        let y = scaled(y, from.tiling.height, to.tiling.height);
        let around =
            (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy))));
        let places = around.filter(|&at| from.tiling.contains(at)).map(|(x, y)| from.tiling.index(x, y));
        let pixels = from.pixel_stride() as u32;
        let of_layer = places.flat_map(|place| {
            // Extra samples of layer 1 are behind blending surfaces.
            let deeper =
                extras[place].iter().filter(|&&i| from.extra_samples[i as usize].layer == layer).map(|&i| pixels + i);
            (layer == 0).then_some(place as u32).into_iter().chain(deeper)
        });
        let lit = of_layer.filter(|&i| from.samples[i as usize].brdf != NO_BRDF);
        let distance = |i: u32| dissimilarity(from, i, to, sample, *radius);
        lit.map(|i| (distance(i), i)).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map(|(_, i)| i)
    }
}

/// Dissimilarity of two samples; a squared length.
fn dissimilarity(from: &DeepFramebuffer, i: u32, to: &DeepFramebuffer, j: u32, radius: f32) -> f32 {
    let (a, b) = (&from.samples[i as usize], &to.samples[j as usize]);
    let normals = octahedral::decode(a.normal) - octahedral::decode(b.normal);
    // Compares reflectances instead of indices, as textured samples have separate BRDFs.
    let (p, q) = (&from.brdfs[a.brdf as usize], &to.brdfs[b.brdf as usize]);
    let material =
        (p.diffuse - q.diffuse).length_squared() + (p.f0 - q.f0).length_squared() + (p.alpha - q.alpha).powi(2);
    (a.position - b.position).length_squared()
        + (NORMAL * radius).powi(2) * normals.length_squared()
        + (MATERIAL * radius).powi(2) * material
}
