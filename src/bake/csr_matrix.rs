//! Sparse RGB matrices in compressed row storage.

use faer::Mat;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::storage::pods;

/// Sparse matrix with one row per view sample.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CsrMatrix {
    /// Entries of row r: `first[r]..first[r + 1]`.
    pub first: Vec<usize>,
    /// Column of each entry, ascending within a row.
    #[serde(with = "pods")]
    pub columns: Vec<u32>,
    /// RGB.
    #[serde(with = "pods")]
    pub values: Vec<[f32; 3]>,
}

impl CsrMatrix {
    /// `count` rows without entries.
    pub fn empty(count: usize) -> CsrMatrix {
        CsrMatrix { first: vec![0; count + 1], ..Default::default() }
    }

    /// A matrix without rows, with capacity for `entries` entries.
    pub fn with_capacity(entries: usize) -> CsrMatrix {
        CsrMatrix { first: vec![0], columns: Vec::with_capacity(entries), values: Vec::with_capacity(entries) }
    }

    /// Whether all indices are valid for `rows` rows and `columns` columns.
    pub fn is_consistent(&self, rows: usize, columns: usize) -> bool {
        self.first.len() == rows + 1
            && self.first[0] == 0
            && self.first[rows] == self.columns.len()
            && self.first.is_sorted()
            && self.columns.len() == self.values.len()
            && self.columns.iter().all(|&column| (column as usize) < columns)
            && self.first.windows(2).all(|row| self.columns[row[0]..row[1]].is_sorted())
    }

    /// Multiplies all values by `factor`.
    pub fn scale(&mut self, factor: f64) {
        self.values.iter_mut().flatten().for_each(|value| *value = (f64::from(*value) * factor) as f32);
    }

    /// The rows of all `parts`, in order.
    pub fn concatenated(parts: Vec<CsrMatrix>) -> Self {
        let mut rows = Self::with_capacity(parts.iter().map(|part| part.columns.len()).sum());
        parts.into_iter().for_each(|part| rows.append(&part));
        rows
    }

    /// Makes room for more entries.
    pub fn reserve(&mut self, entries: usize) {
        self.columns.reserve(entries);
        self.values.reserve(entries);
    }

    /// Appends `rows`.
    pub fn append(&mut self, rows: &CsrMatrix) {
        let start = self.columns.len();
        self.first.extend(rows.first[1..].iter().map(|end| start + end));
        self.columns.extend_from_slice(&rows.columns);
        self.values.extend_from_slice(&rows.values);
    }

    /// One channel as a dense matrix of `columns` columns.
    pub fn to_dense(&self, columns: usize, channel: usize) -> Mat<f32> {
        let mut dense = Mat::zeros(self.len(), columns);
        for r in 0..self.len() {
            self.row(r).for_each(|(column, value)| dense[(r, column as usize)] += value[channel]);
        }
        dense
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        self.first.clear();
        self.first.push(0);
        self.columns.clear();
        self.values.clear();
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Entries of a row: columns and RGB values.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (u32, [f32; 3])> {
        let range = self.first[row]..self.first[row + 1];
        self.columns[range.clone()].iter().copied().zip(self.values[range].iter().copied())
    }

    /// Product with a vector of RGB coefficients, channel by channel, on all cores.
    pub fn multiply(&self, coefficients: &[DVec3]) -> Vec<DVec3> {
        (0..self.len()).into_par_iter().map(|r| self.times(r, coefficients)).collect()
    }

    /// [`Self::multiply`] on the calling thread, for few rows.
    pub fn multiply_here(&self, coefficients: &[DVec3]) -> Vec<DVec3> {
        (0..self.len()).map(|r| self.times(r, coefficients)).collect()
    }

    fn times(&self, row: usize, coefficients: &[DVec3]) -> DVec3 {
        self.row(row).map(|(i, value)| Vec3::from(value).as_dvec3() * coefficients[i as usize]).sum()
    }
}
