//! Indirect light baked to a small picture, for a larger one of the same view: joint bilateral upsampling [Kopf 2007]
//! as one more matrix.
//!
//! What is interpolated is the light that surfaces get: each row is scaled by how much more its surface reflects than
//! the surfaces of the small picture, so that textures stay sharp.

use glam::Vec3;
use rayon::prelude::*;

use super::Transfer;
use super::blocks::{BlockMatrix, Columns, Dense};
use super::spread::Similar;
use crate::bake::DeepFramebuffer;
use crate::bake::transport::emitted::EmitterLight;
use crate::physics::octahedral;
use crate::shared::{Brdf, NO_BRDF};
use crate::trace::packet::PACKET_SIZE;

/// Share of the weight of a sample that lies right off the tangent plane.
const LEAST: f32 = 1e-4;
/// Exponents of the cosines between normals, and of one less the sine of the angle off the tangent plane.
const NORMAL_SHARPNESS: i32 = 8;
const PLANE_SHARPNESS: i32 = 8;
/// Most that a row is scaled by, and least reflectance that it is compared with.
const MOST_SCALE: f32 = 4.0;
const LEAST_REFLECTANCE: f32 = 0.02;

/// Of one row: columns and factors.
type Row = Vec<(u32, Vec3)>;

impl Transfer {
    /// Extends this transfer from the view samples of `from`, one per pixel, to those of `to`, the same view with more
    /// pixels. `radius` is the scene's. The vector holds the light of the samples of `from`, and a matrix more
    /// interpolates it. Without light of the sky. `None` for row wavelets, which have no blocks.
    pub fn upsampled(&self, from: &DeepFramebuffer, to: &DeepFramebuffer, radius: f32) -> Option<Self> {
        let (last, inner) = self.chain.split_last()?;
        let rows = rows(from, to, radius);
        let first = self.vector_length;
        let vector_length = first + from.samples.len();
        let lengthened = |matrix: &BlockMatrix, outputs: Vec<u32>| BlockMatrix {
            input_count: vector_length as u32,
            output_count: vector_length as u32,
            outputs,
            ..matrix.clone()
        };
        let mut chain: Vec<_> = inner.iter().map(|matrix| lengthened(matrix, matrix.outputs.clone())).collect();
        chain.push(lengthened(last, last.outputs.iter().map(|output| output + first as u32).collect()));
        // Samples of `from` that no light reaches are not part of any block: nothing writes their places in the vector.
        let mut is_lit = vec![false; from.samples.len()];
        last.outputs.iter().for_each(|&output| is_lit[output as usize] = true);
        let lit = |row: &Row| row.iter().copied().filter(|(i, _)| is_lit[*i as usize]).collect();
        let lit: Vec<Row> = rows.iter().map(lit).collect();
        chain.push(matrix(&lit, vector_length, first as u32));
        let upsampled = |light: &EmitterLight| {
            let pixel = |row: &Row| row.iter().map(|&(i, factor)| factor * light.radiance[i as usize]).sum();
            EmitterLight { radiance: rows.par_iter().map(pixel).collect(), ..*light }
        };
        let emission = self.emission.iter().map(upsampled).collect();
        Some(Self { vector_length, chain, coarse: Vec::new(), sparse: None, emission, sky: None, ..self.clone() })
    }
}

fn matrix(rows: &[Row], vector_length: usize, first: u32) -> BlockMatrix {
    let empty = || BlockMatrix::new(3, vector_length, rows.len());
    let block = |(block, rows): (usize, &[Row])| {
        let samples: Vec<u32> = (0..rows.len()).filter(|&r| !rows[r].is_empty()).map(|r| r as u32).collect();
        let mut columns: Vec<u32> = rows.iter().flatten().map(|(column, _)| *column).collect();
        columns.sort_unstable();
        columns.dedup();
        let mut values = vec![0.0; 3 * samples.len() * columns.len()];
        for (r, &sample) in samples.iter().enumerate() {
            for (column, factor) in &rows[sample as usize] {
                let c = columns.binary_search(column).expect("it was listed");
                (0..3).for_each(|channel| values[(channel * samples.len() + r) * columns.len() + c] = factor[channel]);
            }
        }
        columns.iter_mut().for_each(|column| *column += first);
        let samples: Vec<u32> = samples.iter().map(|sample| sample + (block * PACKET_SIZE) as u32).collect();
        let own = Columns { inputs: &columns, values: &values };
        let mut part = empty();
        part.push(&Dense { rows: &samples, own, ..Default::default() });
        part
    };
    let parts: Vec<_> = rows.par_chunks(PACKET_SIZE).enumerate().map(block).collect();
    let mut all = empty();
    parts.into_iter().for_each(|part| all.append(part));
    all
}

/// For each view sample of `to`, samples of `from` and their factors.
fn rows(from: &DeepFramebuffer, to: &DeepFramebuffer, radius: f32) -> Vec<Row> {
    let similar = Similar::new(from, to, radius);
    let pixels = to.pixel_stride();
    let of_pixel = |pixel: usize| {
        let interpolated = interpolated(from, to, pixel);
        let likest = |pixel| similar.most_similar(pixel, pixel, 0).map(|i| (i, scale(from, i, to, pixel)));
        if interpolated.is_empty() { likest(pixel as u32).into_iter().collect() } else { interpolated }
    };
    let mut rows: Vec<Row> = (0..pixels).into_par_iter().map(of_pixel).collect();
    rows.resize(to.samples.len(), Row::new());
    for p in &to.extra_pixels {
        for &extra in &to.extra_indices[p.first as usize..(p.first + p.count) as usize] {
            let (sample, layer) = (pixels as u32 + extra, to.extra_samples[extra as usize].layer);
            let source = similar.most_similar(p.pixel, sample, layer);
            rows[sample as usize] = source.map(|i| (i, scale(from, i, to, sample))).into_iter().collect();
        }
    }
    rows
}

/// Samples of adjacent pixels that lie on the same surface; empty if there are none.
fn interpolated(from: &DeepFramebuffer, to: &DeepFramebuffer, pixel: usize) -> Row {
    let sample = &to.samples[pixel];
    let (x, y) = to.tiling.pixel(pixel);
    if sample.brdf == NO_BRDF || !to.tiling.contains((x, y)) {
        return Row::new();
    }
    // Pixel centres of the small picture lie at whole numbers.
    let place = |at: u32, from: u32, to: u32| (at as f32 + 0.5) * from as f32 / to as f32 - 0.5;
    let at = [place(x, from.tiling.width, to.tiling.width), place(y, from.tiling.height, to.tiling.height)];
    let normal = octahedral::decode(sample.normal);
    let mut row = Row::new();
    let mut sum = 0.0;
    let near = at.map(|at| at.round() as i32);
    for (v, u) in (near[1] - 1..=near[1] + 1).flat_map(|v| (near[0] - 1..=near[0] + 1).map(move |u| (v, u))) {
        let inside = |at: i32, size: u32| (0..size as i32).contains(&at);
        if !inside(u, from.tiling.width) || !inside(v, from.tiling.height) {
            continue;
        }
        let index = from.tiling.index(u as u32, v as u32);
        let other = &from.samples[index];
        if other.brdf == NO_BRDF {
            continue;
        }
        // A quadratic B-spline: smooth, and 0 beyond three halves of a pixel.
        let spline = |d: f32| if d < 0.5 { 0.75 - d * d } else { 0.5 * (1.5 - d).max(0.0).powi(2) };
        let nearness = spline((u as f32 - at[0]).abs()) * spline((v as f32 - at[1]).abs());
        let alike = normal.dot(octahedral::decode(other.normal)).max(0.0).powi(NORMAL_SHARPNESS);
        let between = other.position - sample.position;
        let off_plane = normal.dot(between).abs() / between.length().max(f32::MIN_POSITIVE);
        let weight = nearness * alike * (1.0 - off_plane).max(0.0).powi(PLANE_SHARPNESS);
        if weight > LEAST {
            sum += weight;
            row.push((index as u32, weight * scale(from, index as u32, to, pixel as u32)));
        }
    }
    row.iter_mut().for_each(|(_, factor)| *factor /= sum);
    row
}

/// How much more light a sample of `to` reflects than one of `from` that gets the same.
fn scale(from: &DeepFramebuffer, i: u32, to: &DeepFramebuffer, j: u32) -> Vec3 {
    let reflectance = |brdf: &Brdf| (brdf.diffuse + brdf.f0).max(Vec3::splat(LEAST_REFLECTANCE));
    let of = |framebuffer: &DeepFramebuffer, sample: u32| {
        reflectance(&framebuffer.brdfs[framebuffer.samples[sample as usize].brdf as usize])
    };
    (of(to, j) / of(from, i)).min(Vec3::splat(MOST_SCALE))
}
