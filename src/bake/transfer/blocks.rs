//! Block matrices: what the device multiplies light by.
//!
//! A matrix is cut into panels: a few rows that share a list of columns, dense within. Factors are float16, read 16 bytes
//! at a time: a row's eight columns, rows next to each other, so that neighbouring threads read neighbouring bytes.
//! Each panel has a scale that keeps its factors far from the ends of float16's range.

use std::ops::Range;

use glam::{DVec3, UVec4};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::gpu::mapped::Elements;
use crate::shared::{PANEL_COLUMNS, PANEL_ROWS, Panel, STRIP_ROWS};

/// Rows of a panel before it is packed.
pub struct Dense<'a> {
    /// Index into the vector that is multiplied, for each column.
    pub columns: &'a [u32],
    /// Index into the vector that results, for each row.
    pub rows: &'a [u32],
    /// `[channel][row][column]`, one channel or three.
    pub values: &'a [f32],
}

/// A sparse matrix of dense panels, for vectors of RGB.
#[derive(Clone, Debug, Default)]
pub struct BlockMatrix {
    /// 3: R, G and B have factors of their own; 1: they share them.
    pub channels: u32,
    /// Elements of the vector that is multiplied.
    pub input_count: u32,
    /// Elements of the vector that results.
    pub output_count: u32,
    pub panels: Vec<Panel>,
    /// Inputs of each panel's columns, padded to a multiple of [`PANEL_COLUMNS`] by repeating the first.
    pub inputs: Vec<u32>,
    /// Output of each panel's rows.
    pub outputs: Vec<u32>,
    /// Of each panel: `[rows / STRIP_ROWS][columns / 8][channel][row]`, eight columns each.
    pub values: Elements<UVec4>,
}

/// Some panels of a matrix, whose indices count from the beginning of what they point into here.
pub struct Piece<'a> {
    pub channels: u32,
    pub panels: Vec<Panel>,
    pub inputs: &'a [u32],
    pub outputs: &'a [u32],
    pub values: &'a [UVec4],
}

/// Largest magnitude of a packed factor: that of float16 is 65,504, and its precision falls below 6e-5.
const LARGEST: f32 = 16384.0;

impl BlockMatrix {
    pub fn new(channels: u32, input_count: usize, output_count: usize) -> Self {
        let [input_count, output_count] =
            [input_count, output_count].map(|n| u32::try_from(n).expect("indices are u32"));
        Self { channels, input_count, output_count, ..Default::default() }
    }

    /// Adds rows that share their columns, [`PANEL_ROWS`] to a panel.
    pub fn push(&mut self, dense: &Dense) {
        let &Dense { columns, rows, values } = dense;
        if columns.is_empty() {
            return;
        }
        let channels = self.channels as usize;
        assert_eq!(values.len(), channels * rows.len() * columns.len());
        let packed = self.values.to_mut();
        let first_input = self.inputs.len() as u32;
        self.inputs.extend(columns);
        let padding = columns.len().next_multiple_of(PANEL_COLUMNS as usize) - columns.len();
        self.inputs.extend(std::iter::repeat_n(columns[0], padding));
        let octets = columns.len().div_ceil(PANEL_COLUMNS as usize);
        for (panel, of_panel) in rows.chunks(PANEL_ROWS as usize).enumerate() {
            let first_row = panel * PANEL_ROWS as usize;
            let row = |channel: usize, r: usize| {
                &values[(channel * rows.len() + first_row + r) * columns.len()..][..columns.len()]
            };
            let all = || (0..channels).flat_map(|c| (0..of_panel.len()).map(move |r| (c, r)));
            let largest = all().flat_map(|(c, r)| row(c, r)).fold(0.0f32, |m, v| m.max(v.abs()));
            let scale = scale(largest);
            self.panels.push(Panel {
                first_value: packed.len() as u32,
                first_input,
                first_output: self.outputs.len() as u32,
                row_count: of_panel.len() as u32,
                octet_count: octets as u32,
                scale,
            });
            self.outputs.extend(of_panel);
            let [octet_count, row_count] = [octets, of_panel.len()];
            lay_out(packed, [octet_count, channels, row_count], |octet, channel, r| {
                pack(&row(channel, r)[octet * PANEL_COLUMNS as usize..], scale)
            });
        }
    }

    /// All panels of `parts` in turn, which have the same channels and vectors.
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
        self.outputs.extend(part.outputs);
    }

    /// Whether every index that a kernel follows leads to something, and no output has two rows.
    pub fn is_consistent(&self) -> bool {
        let within = |first: u32, count: usize, len: usize| first as usize + count <= len;
        let mut seen = vec![false; self.output_count as usize];
        matches!(self.channels, 1 | 3)
            && self.inputs.iter().all(|&i| i < self.input_count)
            && self.outputs.iter().all(|&o| o < self.output_count && !std::mem::replace(&mut seen[o as usize], true))
            && self.panels.windows(2).all(|p| {
                // In the order of what they point into.
                let places = |p: &Panel| [p.first_value, p.first_input, p.first_output];
                places(&p[0]).iter().zip(places(&p[1])).all(|(a, b)| *a <= b)
            })
            && self.panels.iter().all(|p| {
                p.row_count <= PANEL_ROWS
                    && within(p.first_input, p.octet_count as usize * PANEL_COLUMNS as usize, self.inputs.len())
                    && within(p.first_output, p.row_count as usize, self.outputs.len())
                    && within(
                        p.first_value,
                        p.octet_count as usize * self.channels as usize * p.row_count as usize,
                        self.values.len(),
                    )
            })
    }

    /// Shares of the first rows and columns of what was [pushed](Self::push) together, in whole octets.
    pub fn leading(&self, rows: f64, columns: f64) -> Self {
        let mut all = Self::new(self.channels, self.input_count as usize, self.output_count as usize);
        let values = all.values.to_mut();
        for block in self.panels.chunk_by(|a, b| a.first_input == b.first_input) {
            let row_count: u32 = block.iter().map(|p| p.row_count).sum();
            let mut rows_left = ((rows * f64::from(row_count)).ceil() as u32).next_multiple_of(PANEL_COLUMNS);
            let octet_count = (columns * f64::from(block[0].octet_count)).ceil() as u32;
            let first_input = all.inputs.len() as u32;
            let inputs = &self.inputs[block[0].first_input as usize..];
            all.inputs.extend(&inputs[..(octet_count * PANEL_COLUMNS) as usize]);
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
                    octet_count,
                    scale: panel.scale,
                };
                let outputs = &self.outputs[panel.first_output as usize..];
                all.outputs.extend(&outputs[..row_count as usize]);
                let shape = [octet_count, self.channels, row_count].map(|n| n as usize);
                lay_out(values, shape, |octet, channel, r| self.values[self.place(panel, octet, channel, r)]);
                all.panels.push(part);
            }
        }
        all
    }

    /// The matrix whose row i is this one's row `sources[i]`, or nothing.
    pub fn with_rows(&self, sources: &[Option<u32>]) -> Self {
        let mut takers = vec![Vec::new(); self.output_count as usize];
        for (row, source) in sources.iter().enumerate() {
            if let Some(source) = source {
                takers[*source as usize].push(row as u32);
            }
        }
        let mut all =
            Self { inputs: self.inputs.clone(), ..Self::new(self.channels, self.input_count as usize, sources.len()) };
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
                let shape = [panel.octet_count as usize, self.channels as usize, rows.len()];
                lay_out(values, shape, |octet, channel, r| self.values[self.place(panel, octet, channel, rows[r].0)]);
            }
        }
        all
    }

    /// Ranges of panels whose factors take at most `bytes`, or that are one panel.
    pub fn pieces(&self, bytes: usize) -> Vec<Range<usize>> {
        pieces(self.panels.iter().map(|panel| self.value_count(panel) * size_of::<UVec4>()), bytes)
    }

    /// These panels alone.
    pub fn piece(&self, panels: Range<usize>) -> Piece<'_> {
        let panels = &self.panels[panels];
        let [first, last] = [&panels[0], &panels[panels.len() - 1]];
        let [values, inputs, outputs] = [first.first_value, first.first_input, first.first_output];
        let input_end = last.first_input + last.octet_count * PANEL_COLUMNS;
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
            outputs: &self.outputs[outputs as usize..(last.first_output + last.row_count) as usize],
            values: &self.values[values as usize..last.first_value as usize + self.value_count(last)],
        }
    }

    /// Octets of factors of a panel.
    fn value_count(&self, panel: &Panel) -> usize {
        panel.octet_count as usize * self.channels as usize * panel.row_count as usize
    }

    /// Bytes that a multiplication reads: factors and indices.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.values[..]) + 4 * (self.inputs.len() + self.outputs.len()) + size_of_val(&self.panels[..])
    }

    /// Multiply-adds of all three channels, padding included.
    pub fn multiply_adds(&self) -> u64 {
        let of_panel = |p: &Panel| 3 * u64::from(p.row_count) * u64::from(p.octet_count * PANEL_COLUMNS);
        self.panels.iter().map(of_panel).sum()
    }

    /// The product with `vector`, in double precision; twin of multiply_blocks.comp.
    pub fn multiply(&self, vector: &[DVec3]) -> Vec<DVec3> {
        self.sum_rows(|factor, i| factor * vector[i])
    }

    /// The same for magnitudes: what the rounding of sums is measured by.
    pub fn multiply_magnitudes(&self, vector: &[DVec3]) -> Vec<DVec3> {
        self.sum_rows(|factor, i| (factor * vector[i]).abs())
    }

    /// Sums of `term(factor, input)` over each row.
    fn sum_rows(&self, term: impl Fn(DVec3, usize) -> DVec3 + Sync) -> Vec<DVec3> {
        let panel = |panel: &Panel| {
            let row = |r: usize| {
                let octet = |o: usize| {
                    let first = panel.first_input as usize + o * PANEL_COLUMNS as usize;
                    let factors = self.factors(panel, o, r);
                    factors.into_iter().zip(&self.inputs[first..]).map(|(f, &i)| term(f, i as usize)).sum::<DVec3>()
                };
                let sum = (0..panel.octet_count as usize).map(octet).sum::<DVec3>() * f64::from(panel.scale);
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

    /// Index of eight columns of row `r`.
    fn place(&self, panel: &Panel, octet: usize, channel: usize, r: usize) -> usize {
        let [octet_count, row_count] = [panel.octet_count, panel.row_count].map(|n| n as usize);
        let channels = self.channels as usize;
        let strip = r - r % STRIP_ROWS as usize;
        let stride = (row_count - strip).min(STRIP_ROWS as usize);
        panel.first_value as usize + channels * octet_count * strip + (octet * channels + channel) * stride + r - strip
    }

    /// Eight columns of row `r`, RGB, before the panel's scale.
    fn factors(&self, panel: &Panel, octet: usize, r: usize) -> [DVec3; PANEL_COLUMNS as usize] {
        let of_channel = |channel: usize| -> [f16; PANEL_COLUMNS as usize] {
            bytemuck::cast(self.values[self.place(panel, octet, channel % self.channels as usize, r)])
        };
        let [red, green, blue] = [0, 1, 2].map(of_channel);
        std::array::from_fn(|k| DVec3::new(red[k].to_f64(), green[k].to_f64(), blue[k].to_f64()))
    }
}

/// What factors, the largest of them this one, are divided by before they are packed: a power of two, so that those that
/// are float16 already stay as they are.
pub(super) fn scale(largest: f32) -> f32 {
    (largest / LARGEST).max(f32::MIN_POSITIVE).log2().ceil().exp2()
}

/// Ranges of what has these sizes that take at most `most` together, or that are one.
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

/// Adds the factors of a panel of that many octets of columns, channels and rows: `value(octet, channel, row)`.
fn lay_out(
    values: &mut Vec<UVec4>,
    [octets, channels, rows]: [usize; 3],
    value: impl Fn(usize, usize, usize) -> UVec4,
) {
    for strip in (0..rows).step_by(STRIP_ROWS as usize) {
        for (octet, channel) in (0..octets).flat_map(|o| (0..channels).map(move |c| (o, c))) {
            values.extend((strip..rows.min(strip + STRIP_ROWS as usize)).map(|r| value(octet, channel, r)));
        }
    }
}

/// The first eight of `factors`, or all followed by zeros, over `scale`.
fn pack(factors: &[f32], scale: f32) -> UVec4 {
    let mut scaled = [0.0; PANEL_COLUMNS as usize];
    scaled.iter_mut().zip(factors).for_each(|(s, v)| *s = v / scale);
    let mut packed = [f16::ZERO; PANEL_COLUMNS as usize];
    packed.convert_from_f32_slice(&scaled);
    bytemuck::cast(packed)
}
