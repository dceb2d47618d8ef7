//! S applied to many vectors at once, exactly, and what is kept of it: T = Φ_f + Φ_c S.

use faer::Mat;
use rayon::prelude::*;

use super::linear::{self, Lu};
use super::panels::{self, Panel, Panels, WIDTH};
use crate::bake::transfer::Transfer;
use crate::bake::transfer::rows::Rows;

/// Further bounces of direct light.
pub struct Bounces<'a> {
    /// One a channel.
    series: Vec<Series>,
    /// G_cf; with one level G.
    first: &'a Rows,
    seen: Seen,
}

/// (I - G)⁻¹ as factors, or G with the number of terms of I + G + ...
enum Series {
    Infinite(Lu),
    Terms(Mat<f32>, u32),
}

/// What rows of Φ multiply.
#[derive(Clone, Copy)]
struct Seen {
    two_levels: bool,
    /// Coefficients of the fine level.
    fine: usize,
    /// Whether light reaches view samples straight from the samples that it falls on.
    first: bool,
}

impl<'a> Bounces<'a> {
    pub fn new(transfer: &'a Transfer) -> Self {
        let terms = transfer.bounces().map(|bounces| bounces.saturating_sub(1));
        let series = |channel: usize| {
            let g = dense(&transfer.among, channel);
            match terms {
                None => Series::Infinite(Lu::new(Mat::from_fn(g.nrows(), g.nrows(), |i, j| {
                    f64::from(u8::from(i == j)) - f64::from(g[(i, j)])
                }))),
                Some(terms) => Series::Terms(g, terms),
            }
        };
        let seen = Seen {
            two_levels: transfer.from_fine.is_some(),
            fine: transfer.fine.coefficient_count(),
            first: transfer.bounces() != Some(0),
        };
        let first = transfer.from_fine.as_ref().unwrap_or(&transfer.among);
        Self { series: (0..3).into_par_iter().map(series).collect(), first, seen }
    }

    /// S `direct`.
    pub fn further(&self, direct: &Panels) -> Panels {
        panels::multiply(self.first, direct).map(|channel, panel| self.series[channel].times(panel, false))
    }

    /// Sᵀ `further`.
    fn transposed(&self, further: &Panels) -> Panels {
        let summed = further.map(|channel, panel| self.series[channel].times(panel, true));
        panels::multiply_transposed(self.first, self.seen.fine, &summed)
    }

    /// What rows of Φ multiply, from direct light and [`Self::further`].
    pub fn seen(&self, direct: &Panels, further: &Panels) -> Panels {
        let mut all = direct.clone();
        if !self.seen.first {
            all.for_each_mut(|_, panel| panel.fill([0.0; WIDTH]));
        }
        if !self.seen.two_levels {
            all.add(further);
            return all;
        }
        for (all, further) in all.channels.iter_mut().zip(&further.channels) {
            all.iter_mut().zip(further).for_each(|(all, further)| all.extend(further));
        }
        all
    }

    /// S by the directions that `further` light fills most, in whole panels: as many as `enough` asks for, which gets
    /// what `rows`, some of Φ's, see of each of `checks` beyond them, as squares.
    pub fn spanned(&self, further: &Panels, checks: &Panels, rows: &Rows, enough: impl Fn(&[f64]) -> bool) -> Spanned {
        let weights = weights(rows, further.rows(), if self.seen.two_levels { self.seen.fine } else { 0 });
        let found: Vec<Mat<f32>> = (0..3).into_par_iter().map(|c| found(&further.channels[c], &weights[c])).collect();
        let count = found.iter().map(Mat::ncols).max().unwrap_or(0);
        let made = |weigh: fn(f32, f32) -> f32| {
            let entry = |c: usize, i: usize, j: usize| match j < found[c].ncols() {
                true => weigh(found[c][(i, j)], weights[c][i]),
                false => 0.0,
            };
            Panels::from_fn(further.rows(), count, entry)
        };
        let (mut directions, mut shares) = (made(|u, weight| u / weight), made(|u, weight| u * weight));
        let dark = Panels::zeros(self.seen.fine, checks.count);
        let mut left = checks.clone();
        let mut kept = 0;
        while kept < count && !enough(&panels::multiply(rows, &self.seen(&dark, &left)).squares()) {
            left.for_each_mut(|c, panel| {
                let part = kept / WIDTH;
                let share =
                    linear::product(panels::matrix(&shares.channels[c][part]).transpose(), panels::matrix(panel));
                let share = share * faer::Scale(-1.0);
                linear::add_product(
                    panels::matrix_mut(panel),
                    panels::matrix(&directions.channels[c][part]),
                    share.as_ref(),
                );
            });
            kept = count.min(kept + WIDTH);
        }
        directions.truncate(kept);
        shares.truncate(kept);
        Spanned { directions, rows: self.transposed(&shares), seen: self.seen }
    }
}

/// S ≈ P Q, low in rank because light that has bounced twice is smooth.
pub struct Spanned {
    /// P: a row for each coefficient of further light.
    directions: Panels,
    /// Qᵀ: a row for each coefficient of direct light.
    rows: Panels,
    seen: Seen,
}

impl Spanned {
    /// Directions of further light.
    pub fn rank(&self) -> usize {
        self.rows.count
    }

    /// Tᵀ x from Φᵀ x.
    pub fn backward(&self, mut gathered: Panels) -> Panels {
        let seen = self.seen;
        let split = |panel: &mut Panel| if seen.two_levels { panel.split_off(seen.fine) } else { panel.clone() };
        let channels = gathered.channels.iter_mut().enumerate();
        let all: Vec<(usize, &mut Panel)> =
            channels.flat_map(|(c, panels)| panels.iter_mut().map(move |panel| (c, panel))).collect();
        all.into_par_iter().for_each(|(c, panel)| {
            let further = split(panel);
            if !seen.first {
                panel.fill([0.0; WIDTH]);
            }
            for (directions, rows) in self.directions.channels[c].iter().zip(&self.rows.channels[c]) {
                let shares = linear::product(panels::matrix(directions).transpose(), panels::matrix(&further));
                linear::add_product(panels::matrix_mut(panel), panels::matrix(rows), shares.as_ref());
            }
        });
        gathered
    }
}

impl Series {
    fn times(&self, panel: &Panel, transposed: bool) -> Panel {
        match self {
            Self::Infinite(lu) => {
                let solution = lu.solve(panels::matrix(panel), transposed);
                let row = |i: usize| std::array::from_fn(|j| solution[(i, j)] as f32);
                (0..panel.len()).map(row).collect()
            }
            Self::Terms(g, terms) => {
                let g = if transposed { g.transpose() } else { g.as_ref() };
                let mut sum = vec![[0.0; WIDTH]; panel.len()];
                for _ in 0..*terms {
                    let before = std::mem::replace(&mut sum, panel.clone());
                    linear::add_product(panels::matrix_mut(&mut sum), g, panels::matrix(&before));
                }
                sum
            }
        }
    }
}

fn dense(g: &Rows, channel: usize) -> Mat<f32> {
    let mut dense = Mat::zeros(g.len(), g.len());
    for r in 0..g.len() {
        g.row(r).for_each(|(column, value)| dense[(r, column as usize)] += value[channel]);
    }
    dense
}

/// How much `rows` make of each coefficient of further light, root mean square, by channel; those begin at column
/// `first`.
fn weights(rows: &Rows, count: usize, first: usize) -> [Vec<f32>; 3] {
    let mut squares = vec![[0.0f32; 3]; count];
    for (&column, value) in rows.columns.iter().zip(&rows.values).filter(|(column, _)| **column as usize >= first) {
        (0..3).for_each(|c| squares[column as usize - first][c] += value[c] * value[c]);
    }
    [0, 1, 2].map(|c| {
        let largest = squares.iter().map(|s| s[c]).fold(0.0, f32::max);
        let least = if largest > 0.0 { LEAST_WEIGHT * largest.sqrt() } else { 1.0 };
        squares.iter().map(|s| s[c].sqrt().max(least)).collect()
    })
}

/// What few rows don't see is not nothing.
const LEAST_WEIGHT: f32 = 1e-2;

/// Orthonormal directions of weighted light, the fullest first.
fn found(lights: &[Panel], weights: &[f32]) -> Mat<f32> {
    let all = Mat::from_fn(weights.len(), lights.len() * WIDTH, |i, l| {
        f64::from(lights[l / WIDTH][i][l % WIDTH] * weights[i])
    });
    linear::orthonormal(&all).0
}
