//! Products of block matrices with the vector of light on the host, for devices whose kernels run on the CPU. The same
//! product as multiply_blocks.comp.
//!
//! Such a device reads its memory by gathers, four bytes of each thread at a time. Here the factors of a strip of rows
//! are a sequence of bytes, which is read once, in order, from the cache file as it is mapped (docs/performance.md,
//! "Products on the host").

use std::array::from_fn;
use std::cell::RefCell;

use glam::{UVec4, Vec3};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use crate::bake::transfer::blocks::BlockMatrix;
use crate::gpu::SharedFloat;
pub use crate::relight::visibility::interleaved::LightVectors;
use crate::shared::{MAX_LIGHTS_PER_PASS, PANEL_COLUMNS, Panel, STRIP_ROWS};

/// Where the results of a product go.
#[derive(Clone, Copy)]
pub enum Results<'a> {
    /// They replace elements of the vectors.
    ToVectors,
    /// They are added to the radiance of view samples.
    ToViewSamples(&'a [ViewSampleRadiance<'a>]),
}

/// Radiance of all view samples under one light: planes of R, G and B.
#[derive(Clone, Copy)]
pub struct ViewSampleRadiance<'a> {
    pub pixels: &'a [SharedFloat],
    /// Samples beyond those of the pixels.
    pub extras: &'a [SharedFloat],
    pub pixel_stride: usize,
    pub extra_stride: usize,
}

/// Floats of two rows of a column group, or of as many sums of either row: a whole number of registers everywhere.
const PAIR: usize = 2 * COLUMNS;
const COLUMNS: usize = PANEL_COLUMNS as usize;
const ROWS: usize = STRIP_ROWS as usize;
/// `[row][column]` of a column group, or `[row][8]` sums of every eighth column.
type Strip = [f32; ROWS * COLUMNS];
/// Light on the columns of a column group, twice.
type Inputs = [f32; PAIR];
/// Column groups whose products are added at once, while the sums of a row are in registers.
const BATCH: usize = 4;

/// What a thread needs for a panel.
struct Scratch {
    /// Column groups that receive light.
    lit: Vec<usize>,
    /// `[lit column group][light][channel]`.
    inputs: Vec<Inputs>,
    factors: [Strip; BATCH],
}

impl Scratch {
    const fn new() -> Self {
        Self { lit: Vec::new(), inputs: Vec::new(), factors: [[0.0; ROWS * COLUMNS]; BATCH] }
    }
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = const { RefCell::new(Scratch::new()) };
}

/// Multiplies the vectors by `matrix`, on all cores.
pub fn multiply(matrix: &BlockMatrix, vectors: LightVectors, results: Results) {
    matrix.panels.par_iter().for_each(|panel| {
        SCRATCH.with_borrow_mut(|scratch| {
            let product = PanelProduct { matrix, panel, vectors, results, scratch };
            pulp::Arch::new().dispatch(product);
        });
    });
}

struct PanelProduct<'a> {
    matrix: &'a BlockMatrix,
    panel: &'a Panel,
    vectors: LightVectors<'a>,
    results: Results<'a>,
    scratch: &'a mut Scratch,
}

impl WithSimd for PanelProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.vectors.lights {
            1 => self.run::<S, 1>(simd),
            2 => self.run::<S, 2>(simd),
            3 => self.run::<S, 3>(simd),
            _ => self.run::<S, { MAX_LIGHTS_PER_PASS as usize }>(simd),
        }
    }
}

impl PanelProduct<'_> {
    #[inline(always)]
    fn run<S: Simd, const LIGHTS: usize>(mut self, simd: S) {
        self.read_inputs(LIGHTS);
        for strip in (0..self.panel.row_count as usize).step_by(ROWS) {
            let sums = self.multiply_strip::<S, LIGHTS>(simd, strip);
            let outputs = &self.matrix.outputs[self.panel.first_output as usize..][..self.panel.row_count as usize];
            for (row, &output) in outputs[strip..].iter().take(ROWS).enumerate() {
                for (light, sums) in sums.iter().enumerate() {
                    let of_row = |sums: &Strip| total(&sums[row * COLUMNS..]);
                    self.store(light, output as usize, self.panel.scale * Vec3::from(sums.each_ref().map(of_row)));
                }
            }
        }
    }

    /// Lists the column groups that receive light, and reads their light.
    fn read_inputs(&mut self, lights: usize) {
        let Self { matrix, panel, vectors, scratch: Scratch { lit, inputs, .. }, .. } = self;
        lit.clear();
        inputs.clear();
        for column_group in 0..panel.column_group_count as usize {
            let first = panel.first_input as usize + column_group * COLUMNS;
            let start = inputs.len();
            inputs.resize(start + 3 * lights, [0.0; PAIR]);
            let mut is_lit = false;
            for k in 0..COLUMNS {
                let tint = matrix.tints.get(first + k).copied().unwrap_or(Vec3::ONE);
                let element = matrix.inputs[first + k] as usize;
                for (light, inputs) in inputs[start..].chunks_mut(3).enumerate() {
                    let rgb = vectors.get(element, light);
                    is_lit |= rgb != Vec3::ZERO;
                    for (inputs, value) in inputs.iter_mut().zip((rgb * tint).to_array()) {
                        (inputs[k], inputs[COLUMNS + k]) = (value, value);
                    }
                }
            }
            match is_lit {
                true => lit.push(column_group),
                false => inputs.truncate(start),
            }
        }
    }

    /// Sums of the rows of a strip, `[light][channel]`, before the panel's scale.
    #[inline(always)]
    fn multiply_strip<S: Simd, const LIGHTS: usize>(&mut self, simd: S, first_row: usize) -> [[Strip; 3]; LIGHTS] {
        let Self { matrix, panel, scratch: Scratch { lit, inputs, factors }, .. } = self;
        let mut sums = [[[0.0; ROWS * COLUMNS]; 3]; LIGHTS];
        let own_count = lit.partition_point(|&column_group| column_group < panel.own_column_group_count as usize);
        for (&column_group, inputs) in lit[..own_count].iter().zip(inputs.chunks_exact(3 * LIGHTS)) {
            for c in 0..3 {
                unpack(matrix.of_strip(panel, column_group, c, first_row), &mut factors[0]);
                for (sums, inputs) in sums.iter_mut().zip(inputs.chunks_exact(3)) {
                    add_products(simd, [&mut sums[c]], [&factors[0]], [[&inputs[c]]]);
                }
            }
        }
        let of_shared = inputs[3 * LIGHTS * own_count..].chunks(3 * LIGHTS * BATCH);
        for (some, inputs) in lit[own_count..].chunks(BATCH).zip(of_shared) {
            for (&column_group, factors) in some.iter().zip(factors.iter_mut()) {
                unpack(matrix.of_strip(panel, column_group, 0, first_row), factors);
            }
            for (light, sums) in sums.iter_mut().enumerate() {
                let of = |b: usize| -> [&Inputs; 3] { from_fn(|c| &inputs[3 * (b * LIGHTS + light) + c]) };
                match some.len() {
                    BATCH => add_products(simd, sums.each_mut(), factors.each_ref(), from_fn(of)),
                    count => {
                        for (b, factors) in factors[..count].iter().enumerate() {
                            add_products(simd, sums.each_mut(), [factors], [of(b)]);
                        }
                    }
                }
            }
        }
        sums
    }

    #[inline(always)]
    fn store(&self, light: usize, output: usize, rgb: Vec3) {
        match self.results {
            Results::ToVectors => self.vectors.set(output, light, rgb),
            Results::ToViewSamples(lights) => {
                let ViewSampleRadiance { pixels, extras, pixel_stride, extra_stride } = lights[light];
                let (planes, index, stride) = match output.checked_sub(pixel_stride) {
                    None => (pixels, output, pixel_stride),
                    Some(extra) => (extras, extra, extra_stride),
                };
                for (c, value) in rgb.to_array().into_iter().enumerate() {
                    let float = &planes[index + c * stride];
                    float.set(float.get() + value);
                }
            }
        }
    }
}

/// Unpacks eight factors of each row. Unlike the functions of `half`, which are calls for each register, this becomes a
/// part of the loop.
#[inline(always)]
fn unpack(packed: &[UVec4], factors: &mut Strip) {
    // Exponents of float32 are greater by 112.
    const SCALE: f32 = f32::from_bits((127 + 112) << 23);
    let packed: &[u16] = bytemuck::cast_slice(packed);
    for (factor, &packed) in factors.iter_mut().zip(packed) {
        let bits = u32::from(packed);
        let magnitude = f32::from_bits((bits & 0x7fff) << 13) * SCALE;
        let infinite = if bits & 0x7c00 == 0x7c00 { f32::INFINITY.to_bits() } else { 0 };
        *factor = f32::from_bits(magnitude.to_bits() | infinite | (bits & 0x8000) << 16);
    }
}

/// The sum of eight floats.
#[inline(always)]
fn total(sums: &[f32]) -> f32 {
    let half: [f32; COLUMNS / 2] = from_fn(|k| sums[k] + sums[k + COLUMNS / 2]);
    (half[0] + half[2]) + (half[1] + half[3])
}

/// Adds products of `N` column groups to the sums of `C` channels.
#[inline(always)]
fn add_products<S: Simd, const C: usize, const N: usize>(
    simd: S,
    sums: [&mut Strip; C],
    factors: [&Strip; N],
    inputs: [[&Inputs; C]; N],
) {
    let in_pair = PAIR / S::F32_LANES;
    let sums = sums.map(|sums| S::as_mut_simd_f32s(sums).0);
    let factors = factors.map(|factors| S::as_simd_f32s(factors).0);
    let inputs = inputs.map(|inputs| inputs.map(|inputs| S::as_simd_f32s(inputs).0));
    for first in (0..factors[0].len()).step_by(in_pair) {
        for j in 0..in_pair {
            let mut all: [S::f32s; C] = from_fn(|c| sums[c][first + j]);
            for b in 0..N {
                let factor = factors[b][first + j];
                for c in 0..C {
                    all[c] = simd.mul_add_e_f32s(factor, inputs[b][c][j], all[c]);
                }
            }
            for c in 0..C {
                sums[c][first + j] = all[c];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use half::f16;

    use super::*;

    #[test]
    fn factors_are_unpacked_exactly() {
        let halves: Vec<f16> = (0..=u16::MAX).map(f16::from_bits).collect();
        for some in halves.chunks(ROWS * COLUMNS) {
            let mut packed = [f16::ZERO; ROWS * COLUMNS];
            packed[..some.len()].copy_from_slice(some);
            let mut factors = [f32::NAN; ROWS * COLUMNS];
            unpack(bytemuck::cast_slice(&packed.map(f16::to_bits)), &mut factors);
            let same = |(got, half): (&f32, &f16)| match half.is_nan() {
                true => got.is_nan(),
                false => got.to_bits() == half.to_f32().to_bits(),
            };
            assert!(factors.iter().zip(&packed).all(same));
        }
    }
}
