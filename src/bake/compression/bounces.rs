//! S and its transpose, applied to many vectors at once: T = Φ_f + Φ_c S.

use faer::Mat;
use rayon::prelude::*;

use super::linear;
use super::panels::{self, Panels, WIDTH};
use crate::bake::transfer::rows::Rows;
use crate::bake::transfer::{MOST_COARSE_COEFFICIENTS, Transfer};
use crate::{Error, Result};

/// I + G + G² + ... as dense matrices, and what comes before it.
pub struct Bounces<'a> {
    /// One a channel.
    series: Vec<Mat<f32>>,
    /// G_cf; absent with one level.
    from_fine: Option<&'a Rows>,
    fine: usize,
    /// Whether light reaches view samples straight from the samples that it falls on.
    first: bool,
}

impl<'a> Bounces<'a> {
    pub fn new(transfer: &'a Transfer) -> Result<Self> {
        let size = transfer.among.len();
        if size > MOST_COARSE_COEFFICIENTS {
            let reason = format!(
                "light bounces among {size} coefficients, at most {MOST_COARSE_COEFFICIENTS} can be compressed"
            );
            return Err(Error::invalid("transfer", reason + "; fewer coarse samples"));
        }
        let bounces = transfer.bounces();
        let two_levels = transfer.from_fine.is_some();
        let terms = bounces.map(|count| if two_levels { count.saturating_sub(1) } else { count });
        Ok(Self {
            series: (0..3).into_par_iter().map(|channel| series(&transfer.among, channel, terms)).collect(),
            from_fine: transfer.from_fine.as_ref(),
            fine: transfer.fine.coefficient_count(),
            first: bounces != Some(0),
        })
    }

    /// What rows of Φ multiply, from direct light at the fine level.
    pub fn forward(&self, direct: &Panels) -> Panels {
        let among = |light: &Panels| light.map(|channel, panel| self.dense(channel, panel, false));
        let Some(from_fine) = self.from_fine else { return among(direct) };
        let further = among(&panels::multiply(from_fine, direct));
        let mut all = direct.clone();
        for (all, further) in all.channels.iter_mut().zip(further.channels) {
            for (all, further) in all.iter_mut().zip(further) {
                if !self.first {
                    all.fill([0.0; WIDTH]);
                }
                all.extend(further);
            }
        }
        all
    }

    /// The transpose: what direct light at the fine level is multiplied by, from what Φ's columns are.
    pub fn backward(&self, mut gathered: Panels) -> Panels {
        let among = |light: &Panels| light.map(|channel, panel| self.dense(channel, panel, true));
        let Some(from_fine) = self.from_fine else { return among(&gathered) };
        let mut coarse = Panels { count: gathered.count, ..Default::default() };
        for (coarse, gathered) in coarse.channels.iter_mut().zip(&mut gathered.channels) {
            coarse.extend(gathered.iter_mut().map(|panel| panel.split_off(self.fine)));
            if !self.first {
                gathered.iter_mut().for_each(|panel| panel.fill([0.0; WIDTH]));
            }
        }
        let further = panels::multiply_transposed(from_fine, self.fine, &among(&coarse));
        for (gathered, further) in gathered.channels.iter_mut().zip(further.channels) {
            for (gathered, further) in gathered.iter_mut().zip(further) {
                let sums = gathered.as_flattened_mut().iter_mut();
                sums.zip(further.as_flattened()).for_each(|(sum, x)| *sum += x);
            }
        }
        gathered
    }

    fn dense(&self, channel: usize, panel: &panels::Panel, transposed: bool) -> panels::Panel {
        let series = self.series[channel].as_ref();
        let series = if transposed { series.transpose() } else { series };
        let mut product = vec![[0.0; WIDTH]; panel.len()];
        linear::add_product(panels::matrix_mut(&mut product), series, panels::matrix(panel));
        product
    }
}

/// (I - G)⁻¹, or I + ... + G^(terms - 1).
fn series(g: &Rows, channel: usize, terms: Option<u32>) -> Mat<f32> {
    let size = g.len();
    let mut dense = Mat::<f64>::zeros(size, size);
    for r in 0..size {
        g.row(r).for_each(|(column, value)| dense[(r, column as usize)] += f64::from(value[channel]));
    }
    let identity = Mat::<f64>::identity(size, size);
    match terms {
        None => linear::inverse_of(identity - dense),
        Some(terms) => {
            let mut sum = Mat::<f64>::zeros(size, size);
            for _ in 0..terms {
                sum = &identity + linear::product(dense.as_ref(), sum.as_ref());
            }
            Mat::from_fn(size, size, |i, j| sum[(i, j)] as f32)
        }
    }
}
