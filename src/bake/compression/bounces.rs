//! S applied to batches of vectors, and its transpose in Haar terms: T = Φ_f + Φ_c S.

use std::ops::Range;
use std::sync::Arc;

use faer::{Mat, MatRef};
use glam::DVec3;
use rayon::prelude::*;

use super::Operator;
use super::haar::Haar;
use super::largest::largest;
use super::transposed::{Exact, PART, Transposed, TransposedPart};
use super::vector_batch::{self, Panel, VectorBatch, WIDTH};
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::linear;
use crate::bake::transport::LightTransport;

/// All bounces of direct light beyond the first surface.
pub struct Bounces<'a> {
    /// See [`LightTransport::resolvents`].
    resolvents: Arc<[Mat<f32>; 3]>,
    /// G_cf; with a single level, G.
    first: &'a CsrMatrix,
    operand: Operand,
}

/// Layout of the vectors that Φ multiplies.
#[derive(Clone, Copy)]
struct Operand {
    two_levels: bool,
    /// Coefficients of the fine level, or of the sky in its place.
    fine: usize,
    /// Whether light that reaches a gather sample directly contributes to view samples.
    first: bool,
}

impl<'a> Bounces<'a> {
    pub fn new(operator: Operator<'a>) -> Self {
        let Operator { transport, from_sky } = operator;
        let first = from_sky.or(transport.from_fine.as_ref()).unwrap_or(&transport.bounce_matrix);
        Self { resolvents: resolvents(operator), first, operand: Operand::new(operator) }
    }

    /// Whether any light reaches view samples: false without bounces.
    pub fn reflect_any(&self) -> bool {
        self.operand.first
    }

    /// S `direct`.
    pub fn further(&self, direct: &VectorBatch) -> VectorBatch {
        vector_batch::multiply(self.first, direct).map(|channel, panel| times(self.resolvents[channel].as_ref(), panel))
    }

    /// See [`LightTransport::residual`].
    pub fn residual(&self, transfer: &LightTransport) -> Option<f64> {
        let even = transfer.even_light();
        let further = self.further(&VectorBatch::from_fn(even.len(), 1, |channel, i, _| even[i][channel] as f32));
        let of = |i: usize| DVec3::from_array([0, 1, 2].map(|c: usize| f64::from(further.channels[c][0][i][0])));
        transfer.residual(&(0..transfer.bounce_matrix.len()).map(of).collect::<Vec<_>>())
    }

    /// Operand of Φ, from direct light and [`Self::further`].
    pub fn seen(&self, direct: &VectorBatch, further: &VectorBatch) -> VectorBatch {
        let mut all = direct.clone();
        if !self.operand.first {
            all.for_each_mut(|_, panel| panel.fill([0.0; WIDTH]));
        }
        if !self.operand.two_levels {
            all.add(further);
            return all;
        }
        for (all, further) in all.channels.iter_mut().zip(&further.channels) {
            for (all, further) in all.iter_mut().zip(further) {
                all.reserve_exact(further.len());
                all.extend(further);
            }
        }
        all
    }

    /// The transpose of the operator in Haar terms. From each row of G_cf, omits terms with at most the share `tail` of
    /// the row's energy, weighted by `power`: most entries of rows of few rays are noise.
    pub fn thinned(self, haar: &Haar, power: &[Vec<f32>; 3], tail: f64) -> Thinned {
        let power = power.each_ref().map(Vec::as_slice);
        let columns = self.operand.fine;
        let thin = |rows: Range<usize>| {
            let mut terms = VectorBatch::from_rows(self.first, rows, columns);
            terms.for_each_mut(|_, panel| haar.transform(panel));
            largest(&terms, power, tail)
        };
        let pieces = |rows: Range<usize>, size: usize| {
            rows.clone().step_by(size).map(move |first| first..rows.end.min(first + size)).collect::<Vec<_>>()
        };
        let part = |rows: Range<usize>| {
            let thinned = pieces(rows.clone(), WIDTH).into_par_iter().map(thin).collect();
            TransposedPart::new(&CsrMatrix::concatenated(thinned), rows.start, columns)
        };
        let parts = pieces(0..self.first.len(), PART).into_iter().map(part).collect();
        let Self { resolvents, operand, .. } = self;
        Thinned { resolvents, first: Transposed { columns, parts }, operand }
    }
}

impl Operand {
    fn new(operator: Operator) -> Self {
        let Operator { transport, from_sky } = operator;
        Self {
            two_levels: from_sky.is_some() || transport.from_fine.is_some(),
            fine: operator.coefficient_count(),
            first: from_sky.is_some() || transport.bounces() != Some(0),
        }
    }
}

fn resolvents(Operator { transport, from_sky }: Operator) -> Arc<[Mat<f32>; 3]> {
    // Light of the sky that gather samples reflect has bounced once, that of the fine level twice.
    let before = if from_sky.is_some() { 0 } else { 1 };
    transport.resolvents(transport.bounces().unwrap_or(0).saturating_sub(before))
}

/// Tᵀ in Haar terms.
pub struct Thinned {
    resolvents: Arc<[Mat<f32>; 3]>,
    /// Rows of G_cf in Haar terms.
    pub first: Transposed<Exact>,
    operand: Operand,
}

impl Thinned {
    /// With `first` from [`Bounces::thinned`] of the same operator.
    pub fn new(operator: Operator, first: Transposed<Exact>) -> Self {
        Self { resolvents: resolvents(operator), first, operand: Operand::new(operator) }
    }

    /// Replaces Φᵀ x by the Haar terms of Tᵀ x, which are the first rows; those after them are of no use.
    pub fn to_terms(&self, haar: &Haar, gathered: &mut VectorBatch) {
        let further = VectorBatch {
            count: gathered.count,
            channels: gathered
                .channels
                .each_ref()
                .map(|panels| panels.iter().map(|p| self.further(p).into()).collect()),
        };
        self.to_direct_terms(haar, gathered);
        self.add_further(&further, gathered);
    }

    /// Whether light after further bounces has coefficients of its own.
    pub fn has_two_levels(&self) -> bool {
        self.operand.two_levels
    }

    /// The rows of Φᵀ x that multiply light after further bounces.
    pub fn further<'a>(&self, gathered: &'a [[f32; WIDTH]]) -> &'a [[f32; WIDTH]] {
        &gathered[if self.operand.two_levels { self.operand.fine } else { 0 }..]
    }

    /// Replaces Φᵀ x by the Haar terms of Φ_fᵀ x.
    pub fn to_direct_terms(&self, haar: &Haar, gathered: &mut VectorBatch) {
        let Operand { fine, first, .. } = self.operand;
        gathered.for_each_mut(|_, panel| match first {
            true => haar.transform(&mut panel[..fine]),
            false => panel[..fine].fill([0.0; WIDTH]),
        });
    }

    /// Adds the Haar terms of Sᵀ x, with x from [`Self::further`].
    pub fn add_further(&self, further: &VectorBatch, terms: &mut VectorBatch) {
        let summed = further.map(|channel, panel| times(self.resolvents[channel].transpose(), panel));
        self.first.add_product(summed.panels(), terms);
    }
}

fn times(matrix: MatRef<'_, f32>, panel: &[[f32; WIDTH]]) -> Panel {
    let mut product = vec![[0.0; WIDTH]; panel.len()];
    linear::add_product(vector_batch::matrix_mut(&mut product), matrix, vector_batch::matrix(panel));
    product
}
