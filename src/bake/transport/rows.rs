//! Rows of Φ: the contribution of each gather sample's coefficients to a view sample, by final gathering.

use glam::Vec3;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::cells::Cell;
use super::directions::Lobe;
use super::fan::Fan;
use super::level::Level;
use super::paths::{Arrival, Encounter, Paths};
use super::sky;
use crate::bake::DeepFramebuffer;
use crate::bake::csr_matrix::CsrMatrix;
use crate::physics::brdf::Lobes;
use crate::physics::octahedral;
use crate::physics::sequence::{GOLDEN_RATIO, Points, SharedPoints};
use crate::shared::NO_BRDF;

/// Gathers rows.
pub struct RowGatherer<'a> {
    pub paths: Paths<'a>,
    pub framebuffer: &'a DeepFramebuffer,
    /// Whether the first columns are those of the [sky].
    pub sky: bool,
    /// The columns of the first level precede those of the second.
    pub levels: Vec<&'a Level>,
    /// Rays per row.
    pub rays: u32,
    pub lobe: Lobe,
    pub seed: u64,
}

/// Rows, and the buffers of their tasks: reused, because they are large.
#[derive(Default)]
pub struct RowBuffers {
    pub rows: CsrMatrix,
    /// Of [`TASK`] samples each.
    parts: Vec<CsrMatrix>,
}

/// Accumulator of one row: sums for every coefficient of a level, and a mask of the samples with nonzero sums.
pub struct Row<'a> {
    /// Coefficients of sample i: `first[i]..first[i + 1]`.
    first: &'a [u32],
    /// Maximum number of coefficients used of each sample.
    most: u32,
    /// For each sample the sums of red, then green, then blue.
    sums: Vec<f32>,
    /// One bit per sample.
    touched: Vec<u64>,
}

/// Buffers that a thread reuses between rows.
struct Scratch<'a> {
    sky: Option<Row<'a>>,
    /// One per level.
    rows: Vec<Row<'a>>,
    fan: Fan,
    /// What the rays of a row meet, and numbers in 0..1 that pick samples there. Tints have the weights of the rays.
    arrivals: Vec<(Arrival, f32)>,
    /// The cell that each arrival reads, in one level. Copied in a loop of their own, so that cache misses overlap.
    cells: Vec<Cell>,
}

impl RowGatherer<'_> {
    /// Rows of the view samples `samples`; a row is empty if the sample reflects nothing. Results do not depend on the
    /// number of threads or on how rows are distributed over calls.
    pub fn gather(&self, samples: &[u32]) -> CsrMatrix {
        let mut buffers = RowBuffers::default();
        self.gather_to(samples, &mut buffers);
        buffers.rows
    }

    /// [`Self::gather`], in place of the rows that the buffers have.
    pub fn gather_to(&self, samples: &[u32], RowBuffers { rows, parts }: &mut RowBuffers) {
        parts.resize_with(samples.len().div_ceil(TASK), CsrMatrix::default);
        let points = SharedPoints::new(self.seed, self.rays);
        samples.par_chunks(TASK).zip(&mut *parts).for_each_init(
            || Scratch::new(self.sky, &self.levels),
            |scratch, (samples, part)| self.gather_task(samples, &points, scratch, part),
        );
        rows.clear();
        rows.reserve(parts.iter().map(|part| part.columns.len()).sum());
        parts.iter().for_each(|part| rows.append(part));
    }

    /// Applies `make` to the rows of [`TASK`] samples at a time; results are in order.
    pub fn map<T: Send>(&self, samples: &[u32], make: impl Fn(&CsrMatrix) -> T + Sync) -> Vec<T> {
        let points = SharedPoints::new(self.seed, self.rays);
        let task = |(scratch, rows): &mut (Scratch, CsrMatrix), samples: &[u32]| {
            self.gather_task(samples, &points, scratch, rows);
            make(rows)
        };
        let scratch = || (Scratch::new(self.sky, &self.levels), CsrMatrix::default());
        samples.par_chunks(TASK).map_init(scratch, task).collect()
    }

    /// Replaces `rows` by those of one task.
    fn gather_task(&self, samples: &[u32], points: &SharedPoints, scratch: &mut Scratch, rows: &mut CsrMatrix) {
        rows.clear();
        for &sample in samples {
            self.gather_row(sample, points, scratch);
            let mut offset = 0;
            for row in scratch.sky.iter_mut().chain(&mut scratch.rows) {
                row.take(offset, rows);
                offset += row.columns();
            }
            rows.first.push(rows.columns.len());
        }
    }

    fn gather_row(&self, sample: u32, points: &SharedPoints, scratch: &mut Scratch) {
        let view = &self.framebuffer.samples[sample as usize];
        if view.brdf == NO_BRDF {
            return;
        }
        let brdf = &self.framebuffer.brdfs[view.brdf as usize];
        let normal = octahedral::decode(view.normal).as_dvec3().normalize();
        let wo = octahedral::decode(view.wo).as_dvec3().normalize();
        let Some(lobes) = Lobes::new(brdf, normal, wo) else { return };
        let eye = (normal.as_vec3(), wo.as_vec3(), lobes.specular_share() as f32);
        scratch.fan.draw(brdf, eye, self.lobe, points, sample);
        let geometric_normal = self.framebuffer.geometric_normals[sample as usize];
        scratch.fan.trace(&self.paths, view.position, geometric_normal);
        pulp::Arch::new().dispatch(Deposit { gatherer: self, sample, geometric_normal, scratch });
    }
}

/// Adds the contributions of a view sample's rays to the gather samples that they hit.
struct Deposit<'a, 'b, 'c> {
    gatherer: &'a RowGatherer<'a>,
    sample: u32,
    geometric_normal: Vec3,
    scratch: &'b mut Scratch<'c>,
}

impl WithSimd for Deposit<'_, '_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { gatherer: RowGatherer { paths, levels, .. }, sample, geometric_normal, scratch } = self;
        let position = self.gatherer.framebuffer.samples[sample as usize].position;
        let numbers = Points::new(self.gatherer.seed, u64::from(sample));
        let Scratch { sky, rows, fan, arrivals, cells } = scratch;
        let shift = numbers.at(0, 0)[0];
        arrivals.clear();
        for (ray, weight, direction, hit) in fan.rays_from(paths, position, geometric_normal) {
            let among = (shift + f64::from(ray) * GOLDEN_RATIO).fract() as f32;
            let random = |layer: u32| {
                let [u, v, w, _] = numbers.at(ray, 1 + layer);
                [u, v, w]
            };
            let meet = |met: Encounter| match met {
                Encounter::Surface(arrival) => {
                    arrivals.push((Arrival { tint: weight * arrival.tint, ..arrival }, among));
                }
                Encounter::Sky(escape) => {
                    if let Some(row) = sky {
                        row.add(sky::column(&escape), &[1.0], weight * escape.tint);
                    }
                }
            };
            paths.go_on(hit, direction, random, meet);
        }
        for (level, row) in levels.iter().zip(rows) {
            cells.clear();
            cells.extend(arrivals.iter().map(|(arrival, _)| level.cell(&arrival.place)));
            for ((Arrival { wo, tint, .. }, among), cell) in arrivals.iter().zip(&*cells) {
                level.read_few(cell, *wo, *among, |sample, share, values| row.add(sample, values, *tint * share));
            }
        }
    }
}

/// Rows per parallel task: some milliseconds of work.
pub const TASK: usize = 16;

impl<'a> Scratch<'a> {
    fn new(sky: bool, levels: &[&'a Level]) -> Self {
        Self {
            sky: sky.then(Row::of_sky),
            rows: levels.iter().map(|level| Row::new(&level.first, u32::MAX)).collect(),
            fan: Fan::default(),
            arrivals: Vec::new(),
            cells: Vec::new(),
        }
    }
}

impl Row<'static> {
    /// A row of the columns of the [sky].
    pub fn of_sky() -> Self {
        Self::new(&sky::FIRST, 1)
    }
}

impl<'a> Row<'a> {
    /// Coefficients of sample i are `first[i]..first[i + 1]`; only the first `most` are used.
    pub fn new(first: &'a [u32], most: u32) -> Self {
        let touched = vec![0; first.len().div_ceil(64)];
        let mut row = Self { first, most, sums: Vec::new(), touched };
        row.sums.resize(3 * row.columns() as usize, 0.0);
        row
    }

    /// Adds a sample's `values`, one per coefficient, times `light`.
    #[inline(always)]
    pub fn add(&mut self, sample: usize, values: &[f32], light: Vec3) {
        let sums = self.sums_of(sample, values.len());
        for (channel, sums) in sums.into_iter().enumerate() {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += light[channel] * value;
            }
        }
    }

    /// [`Self::add`] for RGB values.
    pub fn add_colored(&mut self, sample: usize, values: &[Vec3], light: Vec3) {
        for (channel, sums) in self.sums_of(sample, values.len()).into_iter().enumerate() {
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += light[channel] * value[channel]);
        }
    }

    #[inline(always)]
    fn sums_of(&mut self, sample: usize, count: usize) -> [&mut [f32]; 3] {
        let count = count.min(self.most as usize);
        self.touched[sample / 64] |= 1 << (sample % 64);
        let (red, others) = self.sums[3 * self.first[sample] as usize..][..3 * count].split_at_mut(count);
        let (green, blue) = others.split_at_mut(count);
        [red, green, blue]
    }

    /// Number of columns.
    fn columns(&self) -> u32 {
        *self.first.last().expect("one more than samples")
    }

    /// Appends the row to `rows`, with column indices increased by `offset`, and clears it.
    pub fn take(&mut self, offset: u32, rows: &mut CsrMatrix) {
        for (word, touched) in self.touched.iter_mut().enumerate() {
            while *touched != 0 {
                let sample = 64 * word + touched.trailing_zeros() as usize;
                *touched &= *touched - 1;
                let first = self.first[sample];
                let end = self.first[sample + 1].min(first.saturating_add(self.most));
                let count = (end - first) as usize;
                let sums = &mut self.sums[3 * first as usize..][..3 * count];
                rows.columns.extend(offset + first..offset + end);
                rows.values.extend((0..count).map(|i| [sums[i], sums[count + i], sums[2 * count + i]]));
                sums.fill(0.0);
            }
        }
    }
}
