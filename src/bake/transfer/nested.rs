//! The compressed form: Haar terms of direct light, then the nested bases of superclusters and tiles.

use super::{Transfer, TransferReport};
use crate::bake::compression::{Compressed, CompressionSettings, Compressor, Fitted, Operator};
use crate::bake::transport::LightTransport;
use crate::error::Result;
use crate::storage::journal::Journal;

impl Transfer {
    /// Our operator, compressed. Fits found in `journal` are reused. `progress` counts view samples. Fails once there
    /// are more factors than offsets can address.
    pub fn nested(
        transfer: &LightTransport,
        settings: &CompressionSettings,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Self> {
        let compressor = Compressor::new(Operator { transport: transfer, from_sky: None }, settings);
        Self::compressed(&compressor, None, journal, progress)
    }

    /// [`Transfer::nested`] by a compressor, see [`Compressor::compress`].
    pub fn compressed(
        compressor: &Compressor,
        made: Option<Vec<Fitted>>,
        journal: &mut Journal,
        progress: &dyn Fn(usize),
    ) -> Result<Self> {
        let transport = compressor.transport();
        let Compressed { chain, emission, report } = compressor.compress(made, journal, progress)?;
        let report = TransferReport::robust("nested", transport, compressor.residual(), Some(report));
        let vector_length = chain[0].input_count as usize;
        Ok(Self { haar: true, emission, report, ..Self::new(&transport.fine, vector_length, chain) })
    }
}
