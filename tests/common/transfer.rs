//! Indirect light for test stages.

use std::sync::Arc;

use relume::bake::Baked;
use relume::bake::transfer::baked::BakedTransfer;
use relume::bake::transfer::rows::Lobe;
use relume::bake::transfer::{Outgoing, Transfer, TransferSettings};
use relume::storage::journal::Journal;

use super::stage::Stage;

/// All bounces, in as many functions as each material needs, of light looked at from 4 points of each sample.
pub fn settings(samples: usize, coarse_samples: usize, rays: u32) -> TransferSettings {
    TransferSettings {
        outgoing: Outgoing::Glossy { functions: None },
        samples,
        coarse_samples,
        points: 4,
        rays,
        layers: 4,
        bounces: None,
        seed: 1,
    }
}

/// The stage's deep framebuffer with indirect light in dense form.
pub fn with_dense(stage: &Stage, settings: &TransferSettings) -> Arc<Baked> {
    let transfer = Transfer::new(&stage.scene, &stage.baked, settings, &|_| ());
    let dense = BakedTransfer::dense(&transfer, &stage.baked, Lobe::All, &mut Journal::default(), &|_| ());
    assert!(dense.is_consistent(stage.baked.samples.len()));
    Arc::new(Baked { transfer: Some(dense), ..Baked::clone(&stage.baked) })
}
