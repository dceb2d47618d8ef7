//! Batches of vectors of RGB coefficients, divided into panels that fit caches, and products of sparse rows with them.

use std::ops::Range;

use faer::{MatMut, MatRef};
use half::bf16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::bake::csr_matrix::CsrMatrix;
use crate::storage::pods;

/// Vectors per panel: two cache lines of single precision.
pub const WIDTH: usize = 32;
/// Rows per parallel task: their sums stay in a cache.
const ROWS: usize = 256;

/// One row per coefficient (or pixel), one column per vector.
pub type Panel = Vec<[f32; WIDTH]>;

/// An equal number of vectors for each channel, in panels; the last panel is padded with zeros.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct VectorBatch {
    /// Number of vectors of each channel.
    pub count: usize,
    pub channels: [Vec<Panel>; 3],
}

impl VectorBatch {
    /// `count` zero vectors of `rows` elements for each channel.
    pub fn zeros(rows: usize, count: usize) -> Self {
        let channel = || vec![vec![[0.0; WIDTH]; rows]; count.div_ceil(WIDTH)];
        Self { count, channels: [channel(), channel(), channel()] }
    }

    /// The panels of each channel.
    pub fn panels(&self) -> [&[Panel]; 3] {
        self.channels.each_ref().map(Vec::as_slice)
    }

    /// All panels, with channel indices.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &Panel)> {
        self.channels.iter().enumerate().flat_map(|(channel, panels)| panels.iter().map(move |panel| (channel, panel)))
    }

    /// Computes a new panel from each panel and its channel, in parallel.
    pub fn map(&self, make: impl Fn(usize, &Panel) -> Panel + Sync) -> Self {
        let all: Vec<(usize, &Panel)> = self.iter().collect();
        let mut made = all.par_iter().map(|(channel, panel)| make(*channel, panel)).collect::<Vec<_>>().into_iter();
        let channels = [0, 1, 2].map(|c| made.by_ref().take(self.channels[c].len()).collect());
        Self { count: self.count, channels }
    }

    /// Applies `change` to each panel and its channel, in parallel.
    pub fn for_each_mut(&mut self, change: impl Fn(usize, &mut Panel) + Sync) {
        let panels = self.channels.iter_mut().enumerate();
        let all: Vec<_> = panels.flat_map(|(c, panels)| panels.iter_mut().map(move |panel| (c, panel))).collect();
        all.into_par_iter().for_each(|(channel, panel)| change(channel, panel));
    }

    /// `entry` takes channel, row and vector.
    pub fn from_fn(rows: usize, count: usize, entry: impl Fn(usize, usize, usize) -> f32 + Sync) -> Self {
        let mut made = Self::zeros(rows, count);
        for (channel, panels) in made.channels.iter_mut().enumerate() {
            for (part, panel) in panels.iter_mut().enumerate() {
                let vectors = WIDTH.min(count - part * WIDTH);
                panel.par_iter_mut().enumerate().for_each(|(i, row)| {
                    row[..vectors].iter_mut().enumerate().for_each(|(j, x)| *x = entry(channel, i, part * WIDTH + j));
                });
            }
        }
        made
    }

    /// Selected matrix rows as vectors of `columns` coefficients.
    pub fn from_rows(rows: &CsrMatrix, range: Range<usize>, columns: usize) -> Self {
        let mut made = Self::zeros(columns, range.len());
        for (vector, r) in range.enumerate() {
            for (channel, panels) in made.channels.iter_mut().enumerate() {
                let panel = &mut panels[vector / WIDTH];
                rows.row(r).for_each(|(column, value)| panel[column as usize][vector % WIDTH] = value[channel]);
            }
        }
        made
    }

    /// Appends the rows of `others`, which has equally many vectors.
    pub fn append(&mut self, others: Self) {
        for (panels, others) in self.channels.iter_mut().zip(others.channels) {
            panels.iter_mut().zip(others).for_each(|(panel, other)| panel.extend(other));
        }
    }

    /// Adds `others`, which has equally many vectors, elementwise.
    pub fn add(&mut self, others: &Self) {
        for (panels, others) in self.channels.iter_mut().zip(&others.channels) {
            for (panel, other) in panels.iter_mut().zip(others) {
                panel.as_flattened_mut().iter_mut().zip(other.as_flattened()).for_each(|(x, y)| *x += y);
            }
        }
    }

    /// The element of a vector at a row.
    pub fn get(&self, channel: usize, row: usize, vector: usize) -> f32 {
        self.channels[channel][vector / WIDTH][row][vector % WIDTH]
    }

    /// Overwrites a vector by one of `others`, times `factor`.
    pub fn copy(&mut self, vector: usize, others: &Self, other: usize, factor: f32) {
        for (panels, others) in self.channels.iter_mut().zip(&others.channels) {
            let from = others[other / WIDTH].iter().map(|row| row[other % WIDTH]);
            panels[vector / WIDTH].iter_mut().zip(from).for_each(|(row, x)| row[vector % WIDTH] = factor * x);
        }
    }

    /// Copies vector `from` over vector `to`.
    pub fn repeat(&mut self, from: usize, to: usize) {
        for panels in &mut self.channels {
            for row in 0..panels[to / WIDTH].len() {
                panels[to / WIDTH][row][to % WIDTH] = panels[from / WIDTH][row][from % WIDTH];
            }
        }
    }

    /// Sets all elements to zero.
    pub fn clear(&mut self) {
        self.for_each_mut(|_, panel| panel.fill([0.0; WIDTH]));
    }

    /// Number of rows of each panel.
    pub fn rows(&self) -> usize {
        self.channels[0].first().map_or(0, Vec::len)
    }

    /// Sum of squares of each vector, over all channels.
    pub fn squares(&self) -> Vec<f64> {
        let square = |vector: usize| {
            let of_channel = |panels: &Vec<Panel>| -> f64 {
                panels[vector / WIDTH].iter().map(|row| f64::from(row[vector % WIDTH]).powi(2)).sum()
            };
            self.channels.iter().map(of_channel).sum()
        };
        (0..self.count).into_par_iter().map(square).collect()
    }

    /// Sum of squares of each row of a channel, over all vectors.
    pub fn row_squares(&self, channel: usize) -> Vec<f32> {
        let mut sums = vec![0.0; self.rows()];
        for panel in &self.channels[channel] {
            sums.iter_mut().zip(panel).for_each(|(sum, row)| *sum += row.iter().map(|x| x * x).sum::<f32>());
        }
        sums
    }

    /// Multiplies each vector by its factor.
    pub fn scale(&mut self, factors: &[f32]) {
        for panels in &mut self.channels {
            for (panel, factors) in panels.iter_mut().zip(factors.chunks(WIDTH)) {
                for row in panel {
                    row.iter_mut().zip(factors).for_each(|(x, factor)| *x *= factor);
                }
            }
        }
    }

    /// Sets the padding after the last vector to zero.
    pub fn clear_padding(&mut self) {
        if !self.count.is_multiple_of(WIDTH) {
            let last = self.channels.iter_mut().filter_map(|panels| panels.last_mut());
            last.flatten().for_each(|row| row[self.count % WIDTH..].fill(0.0));
        }
    }
}

/// A panel as a matrix.
pub fn matrix(panel: &[[f32; WIDTH]]) -> MatRef<'_, f32> {
    MatRef::from_row_major_slice(panel.as_flattened(), panel.len(), WIDTH)
}

/// A batch in bf16, row-major, for lookup of rows: rounding changes training lights only slightly.
#[derive(Clone, Serialize, Deserialize)]
pub struct Compact {
    /// Number of vectors, including the padding of the last panel.
    pub width: usize,
    /// Rows of each channel.
    rows: usize,
    /// Row-major, channel by channel.
    #[serde(with = "pods")]
    values: Vec<bf16>,
}

impl Compact {
    pub fn new(panels: VectorBatch) -> Self {
        let (width, rows) = (panels.count.next_multiple_of(WIDTH), panels.rows());
        let mut values = vec![bf16::ZERO; 3 * rows * width];
        for (values, panels) in values.chunks_exact_mut((rows * width).max(1)).zip(panels.channels) {
            for (number, panel) in panels.into_iter().enumerate() {
                let places = values.chunks_exact_mut(width).map(|row| &mut row[number * WIDTH..][..WIDTH]);
                places.zip(&panel).for_each(|(place, row)| place.convert_from_f32_slice(row));
            }
        }
        Self { width, rows, values }
    }

    /// The first `count` vectors of the given rows of a channel, row-major.
    pub fn gathered(&self, channel: usize, rows: impl ExactSizeIterator<Item = usize>, count: usize) -> Vec<f32> {
        let mut all = vec![0.0; rows.len() * count];
        let places = all.chunks_exact_mut(count.max(1));
        places.zip(rows).for_each(|(place, row)| {
            self.values[(channel * self.rows + row) * self.width..][..count].convert_to_f32_slice(place)
        });
        all
    }
}

/// The given rows of all panels: row-major, `panels.len() * WIDTH` values each.
pub fn gathered(panels: &[Panel], rows: impl ExactSizeIterator<Item = usize>) -> Vec<f32> {
    let mut all = Vec::with_capacity(rows.len() * panels.len() * WIDTH);
    rows.for_each(|row| panels.iter().for_each(|panel| all.extend_from_slice(&panel[row])));
    all
}

/// Product of each row with each vector, channel by channel.
pub fn multiply(rows: &CsrMatrix, vectors: &VectorBatch) -> VectorBatch {
    let mut products = VectorBatch::zeros(rows.len(), vectors.count);
    let tasks = tasks(vectors.panels(), &mut products, rows.len(), ROWS);
    tasks.into_par_iter().enumerate().for_each(|(block, tasks)| {
        pulp::Arch::new().dispatch(Multiply { rows, first: block * ROWS, columns: vectors.rows(), tasks });
    });
    products
}

/// The products of one block of rows or columns with one panel of each channel.
pub(super) struct Task<'a> {
    pub panels: [&'a Panel; 3],
    pub sums: [&'a mut [[f32; WIDTH]]; 3],
}

/// The tasks of each block of `size` of the first `rows` rows of `sums`, one for each panel number.
pub(super) fn tasks<'a>(
    vectors: [&'a [Panel]; 3],
    sums: &'a mut VectorBatch,
    rows: usize,
    size: usize,
) -> Vec<Vec<Task<'a>>> {
    let mut tasks: Vec<Vec<Task>> = (0..rows.div_ceil(size)).map(|_| Vec::new()).collect();
    let [red, green, blue] = sums.channels.each_mut().map(|panels| panels.iter_mut());
    for (number, ((red, green), blue)) in red.zip(green).zip(blue).enumerate() {
        let panels = vectors.map(|panels| &panels[number]);
        let [red, green, blue] = [red, green, blue].map(|panel| panel[..rows].chunks_mut(size));
        for (tasks, ((red, green), blue)) in tasks.iter_mut().zip(red.zip(green).zip(blue)) {
            tasks.push(Task { panels, sums: [red, green, blue] });
        }
    }
    tasks
}

/// Adds `x` times the factor of each channel.
#[inline(always)]
pub(super) fn add_multiples(sums: &mut [[f32; WIDTH]; 3], factors: [f32; 3], x: [&[f32; WIDTH]; 3]) {
    for ((sums, factor), x) in sums.iter_mut().zip(factors).zip(x) {
        sums.iter_mut().zip(x).for_each(|(sum, x)| *sum += factor * x);
    }
}

/// The products of one block of rows with all panels.
struct Multiply<'a> {
    rows: &'a CsrMatrix,
    /// First row of the block.
    first: usize,
    /// Number of columns.
    columns: usize,
    tasks: Vec<Task<'a>>,
}

impl pulp::NullaryFnOnce for Multiply<'_> {
    type Output = ();

    /// Columns are the outer loop: what a piece of them needs of three panels stays in the second-level cache for all
    /// rows.
    #[inline(always)]
    fn call(self) {
        let Self { rows, first, columns, mut tasks } = self;
        let count = tasks.first().map_or(0, |task| task.sums[0].len());
        let ends = &rows.first[first + 1..first + 1 + count];
        let mut runs: Vec<Range<usize>> = rows.first[first..first + count].iter().map(|&start| start..start).collect();
        for piece in (0..columns).step_by(COLUMNS) {
            for (run, end) in runs.iter_mut().zip(ends) {
                let left = &rows.columns[run.end..*end];
                let of_piece = left.iter().take_while(|&&column| (column as usize) < piece + COLUMNS).count();
                *run = run.end..run.end + of_piece;
            }
            for Task { panels, sums } in &mut tasks {
                let panels = panels.map(|panel| &panel[piece..]);
                for (row, run) in runs.iter().enumerate() {
                    let mut all = sums.each_ref().map(|of_channel| of_channel[row]);
                    for (column, value) in rows.columns[run.clone()].iter().zip(&rows.values[run.clone()]) {
                        let column = *column as usize - piece;
                        add_multiples(&mut all, *value, panels.map(|panel| &panel[column]));
                    }
                    sums.iter_mut().zip(all).for_each(|(of_channel, sum)| of_channel[row] = sum);
                }
            }
        }
    }
}

/// Columns per piece, whose parts of three panels, or whose sums, stay in the second-level cache.
pub(super) const COLUMNS: usize = 512;

/// [`matrix`], mutable.
pub fn matrix_mut(panel: &mut [[f32; WIDTH]]) -> MatMut<'_, f32> {
    let rows = panel.len();
    MatMut::from_row_major_slice_mut(panel.as_flattened_mut(), rows, WIDTH)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::physics::sequence::Points;

    fn random(i: usize, j: usize) -> f32 {
        Points::new(5, 0).at(i as u32, j as u32)[0] as f32 - 0.5
    }

    /// More rows and columns than a task has, and more vectors than a panel.
    #[test]
    fn products_are_those_of_each_vector() {
        let (row_count, columns, vectors) = (ROWS + 3, 2 * COLUMNS + 3, WIDTH + 1);
        let mut rows = CsrMatrix::empty(0);
        for r in 0..row_count {
            for column in (0..columns).filter(|&column| r != 3 && random(r, column) > 0.4) {
                rows.columns.push(column as u32);
                rows.values.push([1, 2, 3].map(|channel| random(r, channel * 10_000 + column)));
            }
            rows.first.push(rows.columns.len());
        }
        let batch = VectorBatch::from_fn(columns, vectors, |c, i, vector| random(5000 + i, 100 * c + vector));
        let products = multiply(&rows, &batch);
        assert_eq!((products.rows(), products.count), (row_count, vectors));
        for vector in 0..vectors {
            let of_column = |i: usize| DVec3::from_array([0, 1, 2].map(|c| batch.get(c, i, vector).into()));
            let want = rows.multiply(&(0..columns).map(of_column).collect::<Vec<_>>());
            for (r, want) in want.into_iter().enumerate() {
                let off = DVec3::from_array([0, 1, 2].map(|c| products.get(c, r, vector).into())) - want;
                assert!(off.abs().max_element() < 1e-5, "row {r}, vector {vector}: {off}");
            }
        }
    }

    #[test]
    fn compact_rows_are_those_of_panels_but_for_rounding() {
        let panels = VectorBatch::from_fn(9, WIDTH + 3, |channel, i, j| 1e20 * random(i, 100 * channel + j));
        let compact = Compact::new(panels.clone());
        let got = compact.gathered(1, [7, 2].into_iter(), 2 * WIDTH);
        let want = gathered(&panels.channels[1], [7, 2].into_iter());
        assert_eq!((got.len(), compact.width), (want.len(), 2 * WIDTH));
        assert!(got.iter().zip(&want).all(|(x, y)| (x - y).abs() <= y.abs() / 256.0));
    }
}
