//! What all superclusters share: lights to learn from and to check with, and the transpose of the bounces.

use std::borrow::Cow;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::bounces::Thinned;
use super::haar::Haar;
use super::transposed::{Exact, Transposed};
use super::vector_batch::{Compact, VectorBatch};
use super::{DECIDING, Operator};

/// Input shared by all superclusters.
pub struct Inputs {
    pub bounces: Thinned,
    /// See [`crate::bake::transport::LightTransport::residual`].
    pub residual: Option<f64>,
    pub haar: Haar,
    /// Operands of Φ for random combinations of the training lights.
    pub combinations: VectorBatch,
    /// Operands of Φ for the validation lights.
    pub validation_operands: VectorBatch,
    /// Haar terms of the training lights, scaled so that the mean square of their images is 1.
    pub training_terms: Compact,
    /// Sum of the squares of each term over the training lights, by channel.
    pub power: [Vec<f32>; 3],
    /// Haar terms of the validation lights.
    pub validation_terms: VectorBatch,
    /// The validation lights that determine the ranks.
    pub deciding: Range<usize>,
}

/// [`Inputs`] in a file, without what follows from the operator.
#[derive(Serialize, Deserialize)]
pub struct StoredInputs<'a> {
    bounces: Cow<'a, Transposed<Exact>>,
    residual: Option<f64>,
    combinations: Cow<'a, VectorBatch>,
    validation_operands: Cow<'a, VectorBatch>,
    training_terms: Cow<'a, Compact>,
    power: Cow<'a, [Vec<f32>; 3]>,
    validation_terms: Cow<'a, VectorBatch>,
}

impl<'a> StoredInputs<'a> {
    pub fn of(inputs: &'a Inputs) -> Self {
        Self {
            bounces: Cow::Borrowed(&inputs.bounces.first),
            residual: inputs.residual,
            combinations: Cow::Borrowed(&inputs.combinations),
            validation_operands: Cow::Borrowed(&inputs.validation_operands),
            training_terms: Cow::Borrowed(&inputs.training_terms),
            power: Cow::Borrowed(&inputs.power),
            validation_terms: Cow::Borrowed(&inputs.validation_terms),
        }
    }

    /// For the operator that they were made for.
    pub fn restore(self, operator: Operator) -> Inputs {
        Inputs {
            bounces: Thinned::new(operator, self.bounces.into_owned()),
            residual: self.residual,
            haar: operator.haar(),
            combinations: self.combinations.into_owned(),
            validation_operands: self.validation_operands.into_owned(),
            training_terms: self.training_terms.into_owned(),
            power: self.power.into_owned(),
            validation_terms: self.validation_terms.into_owned(),
            deciding: DECIDING,
        }
    }
}
