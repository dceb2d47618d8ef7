//! Block matrices, which the device or the host multiplies with light.
//!
//! A matrix is divided into panels: a few rows that share a list of columns and are dense within it. Factors are
//! float16, read 16 bytes at a time: eight columns of a row. Rows are adjacent, so that neighbouring threads read
//! neighbouring bytes. Each panel has a scale, so that its factors are within the range of float16.
//!
//! Why float16: it takes half the memory and half the reads of float32. The rounding of a factor, 2^-11, is a twentieth
//! of the default `--error`. Kernels unpack factors by `unpackHalf2x16`, which needs no device feature. Why eight
//! columns: eight float16 fill one `uvec4`, the unit of one read. They are also the unit of skipping: the factors of a
//! column group without light are not read. Eight threads of a device, one for each column, share their inputs
//! through the subgroup. docs/performance.md has times ("Block products", "Columns without light").
//!
//! There are two kinds of columns: with separate factors for R, G and B, and with shared factors, which take a third of
//! the memory and need a tint of the input.

use std::ops::Range;

use glam::{DVec3, UVec4, Vec3};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::shared::{PANEL_COLUMNS, PANEL_ROWS, Panel, STRIP_ROWS};
use crate::storage::mapped::Elements;

/// Rows of a panel before packing.
#[derive(Default)]
pub struct Dense<'a> {
    /// Index into the output vector for each row.
    pub rows: &'a [u32],
    /// With separate factors for R, G and B: `[channel][row][column]`.
    pub own: Columns<'a>,
    /// With factors shared by R, G and B, stored after the own ones: `[row][column]`.
    pub shared: Columns<'a>,
    /// In matrices of three channels, the factor of the input of each shared column.
    pub tints: &'a [Vec3],
}

/// Columns of a panel before packing.
#[derive(Clone, Copy, Default)]
pub struct Columns<'a> {
    /// Index into the input vector for each column.
    pub inputs: &'a [u32],
    pub values: &'a [f32],
}

impl<'a> Columns<'a> {
    fn column_group_count(&self) -> usize {
        self.inputs.len().div_ceil(PANEL_COLUMNS as usize)
    }

    /// Row r of `rows` in a channel.
    fn row(&self, rows: usize, channel: usize, r: usize) -> &'a [f32] {
        &self.values[(channel * rows + r) * self.inputs.len()..][..self.inputs.len()]
    }
}

/// A sparse matrix of dense panels, for RGB vectors.
#[derive(Clone, Debug, Default)]
pub struct BlockMatrix {
    /// 3: R, G and B have separate factors or tints; 1: they share all factors.
    pub channels: u32,
    /// Number of elements of the input vector.
    pub input_count: u32,
    /// Number of elements of the output vector.
    pub output_count: u32,
    pub panels: Vec<Panel>,
    /// Inputs of each panel's columns; each kind is padded to a multiple of [`PANEL_COLUMNS`] by repeating its first.
    pub inputs: Vec<u32>,
    /// With three channels: a tint for each input, 1 for columns with separate factors. Otherwise empty.
    pub tints: Vec<Vec3>,
    /// Outputs of each panel's rows.
    pub outputs: Vec<u32>,
    /// For each panel: `[rows / STRIP_ROWS][columns / 8][channel][row]`, eight columns each; one channel for shared
    /// columns.
    pub values: Elements<UVec4>,
}

/// A range of panels of a matrix, with indices relative to the slices stored here.
pub struct Piece<'a> {
    pub channels: u32,
    pub panels: Vec<Panel>,
    pub inputs: &'a [u32],
    pub tints: &'a [Vec3],
    pub outputs: &'a [u32],
    pub values: &'a [UVec4],
}

/// Maximum magnitude of a packed factor: float16 ends at 65,504 and loses precision below 6e-5.
const LARGEST: f32 = 16384.0;

impl BlockMatrix {
    /// A matrix without panels.
    pub fn new(channels: u32, input_count: usize, output_count: usize) -> Self {
        let [input_count, output_count] =
            [input_count, output_count].map(|n| u32::try_from(n).expect("indices are u32"));
        Self { channels, input_count, output_count, ..Default::default() }
    }

    /// Adds rows that share their columns, [`PANEL_ROWS`] per panel.
    pub fn push<'a>(&mut self, dense: &Dense<'a>) {
        let &Dense { rows, own, shared, tints } = dense;
        if own.inputs.is_empty() && shared.inputs.is_empty() {
            return;
        }
        assert!(self.channels == 3 || own.inputs.is_empty());
        assert_eq!(own.values.len(), 3 * rows.len() * own.inputs.len());
        assert_eq!(shared.values.len(), rows.len() * shared.inputs.len());
        assert_eq!(tints.len(), if self.channels == 3 { shared.inputs.len() } else { 0 });
        let first_input = self.inputs.len();
        for columns in [own, shared] {
            let padding = columns.column_group_count() * PANEL_COLUMNS as usize - columns.inputs.len();
            self.inputs.extend(columns.inputs);
            self.inputs.extend(columns.inputs.iter().take(1).flat_map(|&first| std::iter::repeat_n(first, padding)));
        }
        let [own_column_groups, shared_column_groups] = [own, shared].map(|columns| columns.column_group_count());
        if self.channels == 3 {
            self.tints.resize(first_input + own_column_groups * PANEL_COLUMNS as usize, Vec3::ONE);
            self.tints.extend(tints);
            self.tints.resize(self.inputs.len(), Vec3::ONE);
        }
        let packed = self.values.to_mut();
        for (panel, of_panel) in rows.chunks(PANEL_ROWS as usize).enumerate() {
            let first_row = panel * PANEL_ROWS as usize;
            let row = |columns: Columns<'a>, channel: usize, r: usize| columns.row(rows.len(), channel, first_row + r);
            let all =
                (0..of_panel.len()).flat_map(|r| [row(own, 0, r), row(own, 1, r), row(own, 2, r), row(shared, 0, r)]);
            let scale = scale(all.flatten().fold(0.0f32, |m, v| m.max(v.abs())));
            self.panels.push(Panel {
                first_value: packed.len() as u32,
                first_input: first_input as u32,
                first_output: self.outputs.len() as u32,
                row_count: of_panel.len() as u32,
                column_group_count: (own_column_groups + shared_column_groups) as u32,
                own_column_group_count: own_column_groups as u32,
                scale,
            });
            self.outputs.extend(of_panel);
            lay_out(packed, [own_column_groups, shared_column_groups, of_panel.len()], |column_group, channel, r| {
                let (columns, column_group) = if column_group < own_column_groups {
                    (own, column_group)
                } else {
                    (shared, column_group - own_column_groups)
                };
                pack(&row(columns, channel, r)[column_group * PANEL_COLUMNS as usize..], scale)
            });
        }
    }

    /// Appends all panels of `part`, which has the same channels and vector lengths.
    pub fn append(&mut self, part: Self) {
        assert_eq!(
            (self.channels, self.input_count, self.output_count),
            (part.channels, part.input_count, part.output_count)
        );
        let [value, input, output] = [self.values.len(), self.inputs.len(), self.outputs.len()].map(|n| n as u32);
        self.panels.extend(part.panels.into_iter().map(|p| Panel {
            first_value: p.first_value + value,
            first_input: p.first_input + input,
            first_output: p.first_output + output,
            ..p
        }));
        self.values.to_mut().extend(&part.values[..]);
        self.inputs.extend(part.inputs);
        self.tints.extend(part.tints);
        self.outputs.extend(part.outputs);
    }

    /// Whether every index that a kernel follows is valid, and no output has two rows.
    pub fn is_consistent(&self) -> bool {
        let within = |first: u32, count: usize, len: usize| first as usize + count <= len;
        let mut seen = vec![false; self.output_count as usize];
        matches!(self.channels, 1 | 3)
            && self.tints.len() == if self.channels == 3 { self.inputs.len() } else { 0 }
            && self.tints.iter().all(|tint| tint.is_finite())
            && self.inputs.iter().all(|&i| i < self.input_count)
            && self.outputs.iter().all(|&o| o < self.output_count && !std::mem::replace(&mut seen[o as usize], true))
            && self.panels.windows(2).all(|p| {
                // Panels are stored in the order of their data.
                let places = |p: &Panel| [p.first_value, p.first_input, p.first_output];
                places(&p[0]).iter().zip(places(&p[1])).all(|(a, b)| *a <= b)
            })
            && self.panels.iter().all(|p| {
                p.row_count <= PANEL_ROWS
                    && p.own_column_group_count <= if self.channels == 3 { p.column_group_count } else { 0 }
                    && within(p.first_input, p.column_group_count as usize * PANEL_COLUMNS as usize, self.inputs.len())
                    && within(p.first_output, p.row_count as usize, self.outputs.len())
                    && within(p.first_value, value_count(p), self.values.len())
            })
    }

    /// The first rows and columns of each group [pushed](Self::push) together, as shares of their number, rounded up to
    /// whole column groups.
    pub fn leading(&self, rows: f64, columns: f64) -> Self {
        let mut all = Self::new(self.channels, self.input_count as usize, self.output_count as usize);
        let values = all.values.to_mut();
        for block in self.panels.chunk_by(|a, b| a.first_input == b.first_input) {
            let row_count: u32 = block.iter().map(|p| p.row_count).sum();
            let mut rows_left = ((rows * f64::from(row_count)).ceil() as u32).next_multiple_of(PANEL_COLUMNS);
            let [own, both] = [block[0].own_column_group_count, block[0].column_group_count];
            let [own_left, shared_left] = [own, both - own].map(|count| (columns * f64::from(count)).ceil() as u32);
            let column_groups: Vec<u32> = (0..own_left).chain(own..own + shared_left).collect();
            let first_input = all.inputs.len() as u32;
            for column_group in &column_groups {
                let first = (block[0].first_input + column_group * PANEL_COLUMNS) as usize;
                let columns = first..first + PANEL_COLUMNS as usize;
                all.inputs.extend(&self.inputs[columns.clone()]);
                all.tints.extend(self.tints.get(columns).unwrap_or_default());
            }
            for panel in block {
                let row_count = panel.row_count.min(rows_left);
                rows_left -= row_count;
                if row_count == 0 {
                    break;
                }
                let part = Panel {
                    first_value: values.len() as u32,
                    first_input,
                    first_output: all.outputs.len() as u32,
                    row_count,
                    column_group_count: own_left + shared_left,
                    own_column_group_count: own_left,
                    scale: panel.scale,
                };
                let outputs = &self.outputs[panel.first_output as usize..];
                all.outputs.extend(&outputs[..row_count as usize]);
                let shape = [own_left, shared_left, row_count].map(|n| n as usize);
                let place =
                    |column_group: usize, channel, r| place(panel, column_groups[column_group] as usize, channel, r);
                lay_out(values, shape, |column_group, channel, r| self.values[place(column_group, channel, r)]);
                all.panels.push(part);
            }
        }
        all
    }

    /// A matrix whose row i is row `sources[i]` of this one, or empty.
    pub fn with_rows(&self, sources: &[Option<u32>]) -> Self {
        let mut takers = vec![Vec::new(); self.output_count as usize];
        for (row, source) in sources.iter().enumerate() {
            if let Some(source) = source {
                takers[*source as usize].push(row as u32);
            }
        }
        let mut all = Self {
            inputs: self.inputs.clone(),
            tints: self.tints.clone(),
            ..Self::new(self.channels, self.input_count as usize, sources.len())
        };
        let values = all.values.to_mut();
        for panel in &self.panels {
            let outputs = &self.outputs[panel.first_output as usize..][..panel.row_count as usize];
            let rows: Vec<(usize, u32)> = outputs
                .iter()
                .enumerate()
                .flat_map(|(r, &o)| takers[o as usize].iter().map(move |&t| (r, t)))
                .collect();
            for rows in rows.chunks(PANEL_ROWS as usize) {
                all.panels.push(Panel {
                    first_value: values.len() as u32,
                    first_output: all.outputs.len() as u32,
                    row_count: rows.len() as u32,
                    ..*panel
                });
                all.outputs.extend(rows.iter().map(|&(_, taker)| taker));
                let [own, both] = [panel.own_column_group_count, panel.column_group_count].map(|n| n as usize);
                let shape = [own, both - own, rows.len()];
                lay_out(values, shape, |column_group, channel, r| {
                    self.values[place(panel, column_group, channel, rows[r].0)]
                });
            }
        }
        all
    }

    /// Ranges of panels with at most `bytes` of factors and indices, or of a single panel.
    pub fn pieces(&self, bytes: usize) -> Vec<Range<usize>> {
        let of_column = size_of::<u32>() + if self.channels == 3 { size_of::<Vec3>() } else { 0 };
        let of_panel = |panel: &Panel| {
            let columns = panel.column_group_count as usize * PANEL_COLUMNS as usize;
            let indices = columns * of_column + panel.row_count as usize * size_of::<u32>();
            value_count(panel) * size_of::<UVec4>() + indices + size_of::<Panel>()
        };
        pieces(self.panels.iter().map(of_panel), bytes)
    }

    /// The given panels as a separate matrix.
    pub fn piece(&self, panels: Range<usize>) -> Piece<'_> {
        let panels = &self.panels[panels];
        let [first, last] = [&panels[0], &panels[panels.len() - 1]];
        let [values, inputs, outputs] = [first.first_value, first.first_input, first.first_output];
        let input_end = last.first_input + last.column_group_count * PANEL_COLUMNS;
        Piece {
            channels: self.channels,
            panels: panels
                .iter()
                .map(|p| Panel {
                    first_value: p.first_value - values,
                    first_input: p.first_input - inputs,
                    first_output: p.first_output - outputs,
                    ..*p
                })
                .collect(),
            inputs: &self.inputs[inputs as usize..input_end as usize],
            tints: self.tints.get(inputs as usize..input_end as usize).unwrap_or_default(),
            outputs: &self.outputs[outputs as usize..(last.first_output + last.row_count) as usize],
            values: &self.values[values as usize..last.first_value as usize + value_count(last)],
        }
    }

    /// Bytes read by a multiplication: factors, indices and tints.
    pub fn bytes(&self) -> usize {
        let columns = size_of_val(&self.inputs[..]) + size_of_val(&self.tints[..]);
        let rows = size_of_val(&self.outputs[..]) + size_of_val(&self.panels[..]);
        size_of_val(&self.values[..]) + columns + rows
    }

    /// Multiply-adds of all three channels, padding included.
    pub fn multiply_adds(&self) -> u64 {
        let of_panel = |p: &Panel| 3 * u64::from(p.row_count) * u64::from(p.column_group_count * PANEL_COLUMNS);
        self.panels.iter().map(of_panel).sum()
    }

    /// The product with `vector`, in double precision; twin of multiply_blocks.comp.
    pub fn multiply(&self, vector: &[DVec3]) -> Vec<DVec3> {
        self.sum_rows(|factor, i| factor * vector[i])
    }

    /// The same with magnitudes of all terms, for bounds on rounding errors.
    pub fn multiply_magnitudes(&self, vector: &[DVec3]) -> Vec<DVec3> {
        self.sum_rows(|factor, i| (factor * vector[i]).abs())
    }

    /// Sums of `term(factor, input)` over each row.
    fn sum_rows(&self, term: impl Fn(DVec3, usize) -> DVec3 + Sync) -> Vec<DVec3> {
        let panel = |panel: &Panel| {
            let row = |r: usize| {
                let column_group = |o: usize| {
                    let first = panel.first_input as usize + o * PANEL_COLUMNS as usize;
                    let factors = self.factors(panel, o, r);
                    factors.into_iter().zip(&self.inputs[first..]).map(|(f, &i)| term(f, i as usize)).sum::<DVec3>()
                };
                let sum =
                    (0..panel.column_group_count as usize).map(column_group).sum::<DVec3>() * f64::from(panel.scale);
                (self.outputs[panel.first_output as usize + r], sum)
            };
            (0..panel.row_count as usize).map(row).collect::<Vec<_>>()
        };
        let mut result = vec![DVec3::ZERO; self.output_count as usize];
        for (output, sum) in self.panels.par_iter().flat_map_iter(panel).collect::<Vec<_>>() {
            result[output as usize] = sum;
        }
        result
    }

    /// Eight columns of each row of the strip that begins at `first_row`, in a channel.
    pub fn of_strip(&self, panel: &Panel, column_group: usize, channel: usize, first_row: usize) -> &[UVec4] {
        let rows = (panel.row_count as usize - first_row).min(STRIP_ROWS as usize);
        &self.values[place(panel, column_group, channel, first_row)..][..rows]
    }

    /// Eight columns of row `r`, RGB, before the panel's scale.
    fn factors(&self, panel: &Panel, column_group: usize, r: usize) -> [DVec3; PANEL_COLUMNS as usize] {
        let of_channel = |channel: usize| -> [f16; PANEL_COLUMNS as usize] {
            bytemuck::cast(self.values[place(panel, column_group, channel, r)])
        };
        let [red, green, blue] = [0, 1, 2].map(of_channel);
        let first = panel.first_input as usize + column_group * PANEL_COLUMNS as usize;
        let tint = |column: usize| self.tints.get(column).map_or(DVec3::ONE, |tint| tint.as_dvec3());
        std::array::from_fn(|k| DVec3::new(red[k].to_f64(), green[k].to_f64(), blue[k].to_f64()) * tint(first + k))
    }
}

/// Maximum bytes of factors: half of what the 32-bit offsets of panels and slices reach, as columns and rows are
/// padded.
const MAX_BYTES: u64 = 1 << 35;

/// Refuses a transfer whose factors have more bytes than offsets can address.
pub fn check_addressable(bytes: u64) -> Result<()> {
    if bytes <= MAX_BYTES {
        return Ok(());
    }
    let most = MAX_BYTES as f64 * 1e-9;
    let reason = format!(
        "it has more than {most:.0} GB of factors; choose a larger --error, a smaller --size, or a smaller --gather"
    );
    Err(Error::invalid("the transfer", reason))
}

/// Number of groups of eight factors of a panel.
fn value_count(panel: &Panel) -> usize {
    (panel.column_group_count as usize + 2 * panel.own_column_group_count as usize) * panel.row_count as usize
}

/// Index of eight columns of row `r`; shared columns have one entry for all channels.
fn place(panel: &Panel, column_group: usize, channel: usize, r: usize) -> usize {
    let [column_groups, own, rows] =
        [panel.column_group_count, panel.own_column_group_count, panel.row_count].map(|n| n as usize);
    let strip = r - r % STRIP_ROWS as usize;
    let stride = (rows - strip).min(STRIP_ROWS as usize);
    let before = if column_group < own { 3 * column_group + channel } else { 2 * own + column_group };
    panel.first_value as usize + (column_groups + 2 * own) * strip + before * stride + r - strip
}

/// Divisor of factors before packing, given the largest of them: a power of two, so that factors with float16 precision
/// are unchanged.
pub(super) fn scale(largest: f32) -> f32 {
    (largest / LARGEST).max(f32::MIN_POSITIVE).log2().ceil().exp2()
}

/// Ranges of items with at most `most` total size, or of a single item.
pub(super) fn pieces(sizes: impl Iterator<Item = usize>, most: usize) -> Vec<Range<usize>> {
    let mut pieces: Vec<Range<usize>> = Vec::new();
    let mut sum = 0;
    for (i, size) in sizes.enumerate() {
        match pieces.last_mut() {
            Some(last) if sum + size <= most => {
                last.end = i + 1;
                sum += size;
            }
            _ => {
                pieces.push(i..i + 1);
                sum = size;
            }
        }
    }
    pieces
}

/// Appends the factors of a panel with `own` and `shared` column groups and `rows` rows: `value(column group, channel,
/// row)`.
fn lay_out(values: &mut Vec<UVec4>, [own, shared, rows]: [usize; 3], value: impl Fn(usize, usize, usize) -> UVec4) {
    for strip in (0..rows).step_by(STRIP_ROWS as usize) {
        let of_own = (0..own).flat_map(|column_group| [0, 1, 2].map(|channel| (column_group, channel)));
        for (column_group, channel) in of_own.chain((own..own + shared).map(|column_group| (column_group, 0))) {
            values.extend((strip..rows.min(strip + STRIP_ROWS as usize)).map(|r| value(column_group, channel, r)));
        }
    }
}

/// The first eight of `factors`, padded with zeros, divided by `scale`.
fn pack(factors: &[f32], scale: f32) -> UVec4 {
    let mut scaled = [0.0; PANEL_COLUMNS as usize];
    scaled.iter_mut().zip(factors).for_each(|(s, v)| *s = v / scale);
    let mut packed = [f16::ZERO; PANEL_COLUMNS as usize];
    packed.convert_from_f32_slice(&scaled);
    bytemuck::cast(packed)
}
