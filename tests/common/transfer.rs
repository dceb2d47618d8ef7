//! Indirect light for test stages.

use std::sync::Arc;

use relume::bake::transfer::Transfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::storage::journal::Journal;

use super::stage::Stage;

/// All bounces, in as many functions as each material needs, of light looked at from 4 points of each sample.
pub fn settings(samples: usize, coarse_samples: usize, rays: u32) -> TransferSettings {
    TransferSettings {
        outgoing: Outgoing::Glossy { functions: None },
        samples,
        paths: TransferSettings::paths_for(samples),
        coarse_samples,
        points: 4,
        rays,
        layers: 4,
        bounces: None,
        seed: 1,
    }
}

/// Indirect light of the stage in dense form.
pub fn dense(stage: &Stage, settings: &TransferSettings) -> Arc<Transfer> {
    let transfer = LightTransport::new(&stage.scene, &stage.framebuffer, settings, &|_| ());
    let dense = Transfer::dense(&transfer, &stage.framebuffer, Lobe::All, &mut Journal::default(), &|_| ());
    assert!(dense.is_consistent(stage.framebuffer.samples.len()));
    Arc::new(dense)
}
