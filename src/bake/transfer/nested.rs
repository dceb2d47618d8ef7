//! The compressed form: Haar terms of direct light, then the nested bases of superclusters and tiles.

use super::{Transfer, TransferReport};
use crate::bake::compression::{Compressed, CompressionSettings, Compressor, Operator};
use crate::bake::transport::{LightTransport, direct};
use crate::error::Result;
use crate::shared::PackedLight;
use crate::storage::journal::Journal;

impl Transfer {
    /// Our operator, compressed. Fits found in `journal` are reused. `progress` counts view samples. Fails once there are
    /// more factors than offsets can address.
    pub fn nested(
        transfer: &LightTransport,
        settings: &CompressionSettings,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Self> {
        let direct = |light: &PackedLight| direct::shade(transfer.scene(), &transfer.fine, light);
        let compressor = Compressor::new(Operator { transport: transfer, from_sky: None }, &direct, settings);
        let Compressed { chain, emission, report } = compressor.compress(journal, progress)?;
        let report = TransferReport::robust("nested", transfer, compressor.residual(), Some(report));
        let vector_length = chain[0].input_count as usize;
        Ok(Self { haar: true, emission, report, ..Self::new(&transfer.fine, vector_length, chain) })
    }
}
