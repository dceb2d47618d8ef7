//! Light of the sky: the compressed map from its cells to view samples, with shadows and all bounces.

use glam::DVec3;

use super::blocks::BlockMatrix;
use super::{cost, multiply_chain, reads_only_what_is_there};
use crate::bake::compression::{self, Compressed, CompressionSettings, Compressor, Fitted, Operator, sky_haar};
use crate::bake::transport::{LightTransport, sky};
use crate::error::Result;
use crate::physics::sky_cells;
use crate::storage::journal::Journal;

/// The map from [`sky::COLUMNS`] coefficients, RGB radiance, in the layout of the device. Light from the sky that view
/// samples see without a surface between is not in it.
#[derive(Clone, Default)]
pub struct SkyTransfer {
    /// Length of the vector that the chain operates on. It begins with the Haar terms of the coefficients.
    pub vector_length: usize,
    /// The outputs of the last matrix are view samples. Empty: no light of the sky arrives.
    pub chain: Vec<BlockMatrix>,
    /// Errors on held-out skies: broad glows, and lamps.
    pub held_out: compression::FitReport,
}

impl SkyTransfer {
    /// Compresses light of the sky; without a chain in a closed scene. Fits found in `journal` are reused; `progress`
    /// counts view samples. Fails once there are more factors than offsets can address.
    pub fn new(
        transport: &LightTransport,
        settings: &CompressionSettings,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Self> {
        let Some(from_sky) = transport.from_sky() else { return Ok(Self::default()) };
        let compressor = Compressor::new(Operator { transport, from_sky: Some(&from_sky) }, settings);
        Self::compressed(&compressor, None, journal, progress)
    }

    /// [`SkyTransfer::new`] by a compressor of what comes from the sky, see [`Compressor::compress`].
    pub fn compressed(
        compressor: &Compressor,
        made: Option<Vec<Fitted>>,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Self> {
        let Compressed { chain, report, .. } = compressor.compress(made, journal, progress)?;
        Ok(Self { vector_length: chain[0].input_count as usize, chain, held_out: report })
    }

    /// Whether mirrors throw light of the sky onto other surfaces.
    pub fn has_mirrors(&self) -> bool {
        let by_mirrors = sky_cells::COUNT as u32..sky::COLUMNS as u32;
        self.chain.first().is_some_and(|v| v.inputs.iter().any(|input| by_mirrors.contains(input)))
    }

    /// Whether every index that a kernel follows is valid, for images of `view_samples` samples.
    pub fn is_consistent(&self, view_samples: usize) -> bool {
        self.chain.is_empty()
            || (self.vector_length >= sky::COLUMNS
                && reads_only_what_is_there(&self.chain, self.vector_length, view_samples))
    }

    /// Bytes that the products read for each sky, and their multiply-adds.
    pub fn cost(&self) -> (usize, u64) {
        cost(&self.chain)
    }

    /// Radiance of all view samples under a sky, in double precision: a twin of the device's kernels.
    pub fn apply(&self, coefficients: &[DVec3]) -> Vec<DVec3> {
        let mut vector = sky_haar().terms(coefficients);
        vector.resize(self.vector_length, DVec3::ZERO);
        multiply_chain(&self.chain, vector)
    }
}
