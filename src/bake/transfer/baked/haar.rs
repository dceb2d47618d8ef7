//! Each row's own wavelets, to compare with.

use super::{BakedTransfer, TransferReport};
use crate::bake::compression::CompressionSettings;
use crate::bake::compression::row_wavelets::RowWavelets;
use crate::bake::transfer::Transfer;
use crate::bake::transfer::direct;
use crate::bake::transfer::sparse::TERM_BYTES;
use crate::error::Result;
use crate::shared::PackedLight;
use crate::storage::journal::Journal;

impl BakedTransfer {
    /// Our operator, of each row of which the largest wavelets are kept. `fits` is asked whether so many bytes may be
    /// taken, before most of the work; what `journal` has is not done again; `progress` counts view samples.
    pub fn haar(
        transfer: &Transfer,
        settings: &CompressionSettings,
        fits: impl Fn(f64) -> Result<()>,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Self> {
        let direct = |light: &PackedLight| direct::shade(transfer.scene(), &transfer.fine, light);
        let wavelets = RowWavelets::new(transfer, &direct, settings);
        // On the host and on the device.
        fits(2.0 * (TERM_BYTES * wavelets.samples.len()) as f64 * wavelets.kept)?;
        let residual = wavelets.residual();
        let (sparse, emission, held_out) = wavelets.compress(journal, progress);
        let report = TransferReport::robust("haar", transfer, residual, Some(held_out));
        let plain = Self::new(&transfer.fine, transfer.fine.coefficient_count(), Vec::new());
        Ok(Self { haar: true, sparse: Some(sparse), emission, report, ..plain })
    }
}
