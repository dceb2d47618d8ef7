//! Rows of Φ: what each gather sample's coefficients add to a view sample, by final gathering.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::level::Level;
use super::paths::Paths;
use crate::bake::Baked;
use crate::bake::octahedral;
use crate::brdf::Lobes;
use crate::sequence::Points;
use crate::shared::NO_BRDF;

/// Sparse rows, one a view sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// Entries of row r: `first[r]..first[r + 1]`.
    pub first: Vec<usize>,
    /// Coefficient of each entry, ascending within a row.
    pub columns: Vec<u32>,
    /// RGB.
    pub values: Vec<[f32; 3]>,
}

/// Which of a view sample's lobes reflect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lobe {
    All,
    /// For the pass `indirect_glossy`.
    Specular,
}

/// Gathers rows.
pub struct RowGatherer<'a> {
    pub paths: Paths<'a>,
    pub baked: &'a Baked,
    /// The columns of the first level come first, then those of the second.
    pub levels: Vec<&'a Level>,
    /// Rays a row.
    pub rays: u32,
    pub lobe: Lobe,
    pub seed: u64,
}

/// One row under construction: sums for every coefficient, and blocks of them that are not zero.
pub(super) struct Row {
    sums: Vec<Vec3>,
    /// First coefficient of each sample that was added to, and how many it has.
    touched: Vec<(u32, u32)>,
}

impl RowGatherer<'_> {
    pub fn column_count(&self) -> usize {
        self.levels.iter().map(|level| level.coefficient_count()).sum()
    }

    /// Rows of the view samples `samples`; empty where nothing is reflected. The same whatever the threads, and however
    /// the rows are cut into calls.
    pub fn gather(&self, samples: &[u32]) -> Rows {
        let chunk = |row: &mut Row, samples: &[u32]| {
            let mut rows = Rows { first: vec![0], ..Default::default() };
            for &sample in samples {
                self.gather_row(sample, row);
                row.take(&mut rows);
            }
            rows
        };
        // 16: some milliseconds of work.
        Rows::concatenated(samples.par_chunks(16).map_init(|| Row::new(self.column_count()), chunk).collect())
    }

    fn gather_row(&self, sample: u32, row: &mut Row) {
        let view = &self.baked.samples[sample as usize];
        if view.brdf == NO_BRDF {
            return;
        }
        let brdf = &self.baked.brdfs[view.brdf as usize];
        let normal = octahedral::decode(view.normal).as_dvec3().normalize();
        let wo = octahedral::decode(view.wo).as_dvec3().normalize();
        let Some(lobes) = Lobes::new(brdf, normal, wo) else { return };
        let geometric_normal = self.baked.geometric_normals[sample as usize];
        let points = Points::new(self.seed, u64::from(sample));
        for ray in 0..self.rays {
            let [u, v, w, _] = points.at(ray, 0);
            let Some(wi) = lobes.sample([u, v, w]) else { continue };
            let at = lobes.at(wi);
            let reflected = match self.lobe {
                Lobe::All => at.sum(),
                Lobe::Specular => at.specular,
            };
            let weight = (reflected / (at.density * f64::from(self.rays))).as_vec3();
            let random = |layer: u32| {
                let [u, v, w, _] = points.at(ray, 1 + layer);
                [u, v, w]
            };
            self.paths.follow(view.position, geometric_normal, wi.as_vec3(), random, |arrival| {
                let mut offset = 0;
                for level in &self.levels {
                    let light = weight * arrival.tint;
                    level.read(&arrival.place, arrival.wo, |_, share, first, values| {
                        row.add(offset + first, values, light * share);
                    });
                    offset += level.coefficient_count() as u32;
                }
            });
        }
    }
}

impl Row {
    pub fn new(columns: usize) -> Self {
        Self { sums: vec![Vec3::ZERO; columns], touched: Vec::new() }
    }

    /// Adds a sample's `values` times `light`. The first function is positive, so light leaves a mark there.
    pub fn add(&mut self, first: u32, values: &[f32], light: Vec3) {
        let sums = &mut self.sums[first as usize..][..values.len()];
        if sums[0] == Vec3::ZERO {
            self.touched.push((first, values.len() as u32));
        }
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += light * *value);
    }

    /// [`Self::add`] for values of RGB; what adds nothing to the first leaves no mark, so all are looked at.
    pub fn add_colored(&mut self, first: u32, values: &[Vec3], light: Vec3) {
        let sums = &mut self.sums[first as usize..][..values.len()];
        if sums.iter().all(|sum| *sum == Vec3::ZERO) {
            self.touched.push((first, values.len() as u32));
        }
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += light * *value);
    }

    /// Moves the row to the end of `rows`.
    pub fn take(&mut self, rows: &mut Rows) {
        self.touched.sort_unstable();
        self.touched.dedup(); // what got no light was listed again
        for &(first, count) in &self.touched {
            let sums = &mut self.sums[first as usize..][..count as usize];
            rows.columns.extend(first..first + count);
            rows.values.extend(sums.iter().map(|sum| sum.to_array()));
            sums.fill(Vec3::ZERO);
        }
        self.touched.clear();
        rows.first.push(rows.columns.len());
    }
}

impl Rows {
    /// Rows without entries.
    pub fn empty(count: usize) -> Rows {
        Rows { first: vec![0; count + 1], ..Default::default() }
    }

    /// All rows of `parts` in turn.
    pub fn concatenated(parts: Vec<Rows>) -> Self {
        let mut rows = Rows { first: vec![0], ..Default::default() };
        for part in parts {
            let start = rows.columns.len();
            rows.first.extend(part.first[1..].iter().map(|end| start + end));
            rows.columns.extend(part.columns);
            rows.values.extend(part.values);
        }
        rows
    }

    pub fn len(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Entries of a row: coefficients and RGB factors.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (u32, [f32; 3])> {
        let range = self.first[row]..self.first[row + 1];
        self.columns[range.clone()].iter().copied().zip(self.values[range].iter().copied())
    }

    /// Each row times a vector of RGB coefficients, channel by channel.
    pub fn multiply(&self, coefficients: &[DVec3]) -> Vec<DVec3> {
        let row =
            |r: usize| self.row(r).map(|(i, value)| Vec3::from(value).as_dvec3() * coefficients[i as usize]).sum();
        (0..self.len()).into_par_iter().map(row).collect()
    }
}
