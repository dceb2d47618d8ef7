//! A level of detail: gather samples, their coefficients, and the lookup of the samples near a surface point.

use glam::Vec3;

use super::cells::{Cell, Cells};
use crate::bake::brdf_factors::harmonics::{Harmonics, MAX_FUNCTIONS};
use crate::bake::brdf_factors::roughness_coordinate;
use crate::bake::gather_samples::light_rays::LightRays;
use crate::bake::gather_samples::{GatherSample, GatherSamples, Place};
use crate::scene::Scene;
use crate::shared::LightSample;

/// Gather samples and the layout of their coefficients: those of sample i are `first[i]..first[i + 1]` of a coefficient
/// vector.
pub struct Level {
    pub samples: GatherSamples,
    pub first: Vec<u32>,
    pub cells: Cells,
    /// Two tangents and the normal of each sample.
    pub frames: Vec<[Vec3; 3]>,
    /// The samples as receivers of direct light.
    pub light_samples: Vec<LightSample>,
    pub light_rays: LightRays,
}

impl Level {
    /// `functions` is the number of harmonics of each sample: a square number.
    pub fn new(scene: &Scene, samples: GatherSamples, functions: &[u8]) -> Self {
        let mut first = vec![0];
        first.extend(functions.iter().scan(0, |sum, &count| {
            *sum += u32::from(count);
            Some(*sum)
        }));
        let cells = Cells::new(scene, &samples);
        Self::with(samples, first, cells)
    }

    /// With cells that were made before.
    pub fn with(samples: GatherSamples, first: Vec<u32>, cells: Cells) -> Self {
        let frames: Vec<_> = samples.samples.iter().map(|s| s.frame()).collect();
        let light_sample = |((s, frame), range): ((&GatherSample, &[Vec3; 3]), &[u32])| LightSample {
            brdf: s.direct_brdf,
            normal: frame[2],
            tangent: frame[0],
            roughness: roughness_coordinate(&s.direct_brdf),
            first: range[0],
            degrees: (range[1] - range[0]).isqrt(),
            area: s.area,
        };
        let light_samples: Vec<_> =
            samples.samples.iter().zip(&frames).zip(first.windows(2)).map(light_sample).collect();
        Self {
            cells,
            light_rays: LightRays::new(&light_samples, samples.points.iter().map(|p| (p.position, p.normal))),
            light_samples,
            frames,
            samples,
            first,
        }
    }

    /// Number of coefficients of all samples.
    pub fn coefficient_count(&self) -> usize {
        self.first[self.samples.len()] as usize
    }

    /// Range of a sample's coefficients.
    pub fn coefficients(&self, sample: usize) -> std::ops::Range<usize> {
        self.first[sample] as usize..self.first[sample + 1] as usize
    }

    /// The cell of a surface point; with weights of 0 on the back of a single-sided face.
    #[inline(always)]
    pub fn cell(&self, place: &Place) -> Cell {
        self.cells.index(place).map_or_else(Cell::default, |index| *self.cells.get(index))
    }

    /// The radiance from a `cell` towards `wo`: calls `read` with each contributing sample, its weight, the index of
    /// its first coefficient, and the values of its functions.
    #[inline(always)]
    pub fn read(&self, cell: &Cell, wo: Vec3, mut read: impl FnMut(usize, f32, u32, &[f32])) {
        let mut values = [0.0; MAX_FUNCTIONS];
        // On flat surfaces neighbours share one frame.
        let mut known: Option<(Vec3, usize)> = None;
        for (sample, weight) in cell.read() {
            let range = self.coefficients(sample);
            let (first, count) = (range.start as u32, range.len());
            if count == 1 {
                read(sample, weight, first, &[CONSTANT]);
                continue;
            }
            let frame = &self.frames[sample];
            if known != Some((frame[2], count)) {
                Harmonics::get().evaluate(local(frame, wo), &mut values[..count]);
                known = Some((frame[2], count));
            }
            read(sample, weight, first, &values[..count]);
        }
    }

    /// Like [`Self::read`], but of the samples with many functions a single one is drawn by weight, with `random` in
    /// 0..1, for all of them: unbiased, with a third of the entries.
    #[inline(always)]
    pub fn read_few(&self, cell: &Cell, wo: Vec3, random: f32, mut read: impl FnMut(usize, f32, &[f32])) {
        let has_many = |sample: usize| self.coefficients(sample).len() >= MANY_FUNCTIONS;
        let many: f32 = cell.read().filter(|&(sample, _)| has_many(sample)).map(|(_, weight)| weight).sum();
        if many == 0.0 {
            return self.read(cell, wo, |sample, weight, _, values| read(sample, weight, values));
        }
        let mut values = [0.0; MAX_FUNCTIONS];
        let mut read = |sample: usize, weight| {
            let count = self.coefficients(sample).len();
            Harmonics::get().evaluate(local(&self.frames[sample], wo), &mut values[..count]);
            read(sample, weight, &values[..count]);
        };
        let mut left = random * many;
        let mut drawn = None;
        for (sample, weight) in cell.read() {
            if !has_many(sample) {
                read(sample, weight);
            } else if left >= 0.0 {
                drawn = Some(sample);
                left -= weight;
            }
        }
        read(drawn.expect("there is one with many"), many);
    }
}

/// Number of functions from which on a row reads one sample instead of all neighbours like it.
const MANY_FUNCTIONS: usize = 9;
/// The first function: the square root of 1/pi.
pub const CONSTANT: f32 = 0.564_189_6;

/// A direction in a frame of two tangents and a normal.
#[inline(always)]
pub fn local(frame: &[Vec3; 3], direction: Vec3) -> Vec3 {
    Vec3::from(frame.map(|axis| axis.dot(direction)))
}
