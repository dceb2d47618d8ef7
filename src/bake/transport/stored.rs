//! Light transport in a file: what takes long to compute, without what follows from it.

use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Serialize};

use super::cells::Cells;
use super::level::Level;
use super::{Certificate, LightTransport, TransferSettings};
use crate::bake::DeepFramebuffer;
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::gather_samples::GatherSamples;
use crate::bake::linear::Square;
use crate::trace::bvh::TracedScene;

/// [`LightTransport`] without the scene and the settings, which whoever reads it must know to be the same.
#[derive(Serialize, Deserialize)]
pub struct Stored<'a> {
    fine: StoredLevel<'a>,
    coarse: Option<StoredLevel<'a>>,
    bounce_matrix: Cow<'a, CsrMatrix>,
    from_fine: Option<Cow<'a, CsrMatrix>>,
    certificate: Cow<'a, Certificate>,
    bounces: Option<u32>,
    resolvents: Option<[Square; 3]>,
}

#[derive(Serialize, Deserialize)]
struct StoredLevel<'a> {
    samples: Cow<'a, GatherSamples>,
    first: Cow<'a, [u32]>,
    cells: Cow<'a, Cells>,
}

impl<'a> StoredLevel<'a> {
    fn of(level: &'a Level) -> Self {
        let Level { samples, first, cells, .. } = level;
        Self { samples: Cow::Borrowed(samples), first: Cow::Borrowed(first), cells: Cow::Borrowed(cells) }
    }

    fn restore(self) -> Level {
        Level::with(self.samples.into_owned(), self.first.into_owned(), self.cells.into_owned())
    }
}

impl<'a> Stored<'a> {
    pub fn of(transport: &'a LightTransport) -> Self {
        Self {
            fine: StoredLevel::of(&transport.fine),
            coarse: transport.coarse.as_ref().map(StoredLevel::of),
            bounce_matrix: Cow::Borrowed(&transport.bounce_matrix),
            from_fine: transport.from_fine.as_ref().map(Cow::Borrowed),
            certificate: Cow::Borrowed(&transport.certificate),
            bounces: transport.settings.bounces,
            resolvents: transport.resolvents.get().map(|all| all.each_ref().map(Square::of)),
        }
    }

    /// For the scene, the framebuffer and the settings that it was made with.
    pub fn restore<'b>(
        self,
        scene: &'b TracedScene,
        framebuffer: &'b DeepFramebuffer,
        settings: &TransferSettings,
    ) -> LightTransport<'b> {
        LightTransport {
            scene,
            framebuffer,
            settings: TransferSettings { bounces: self.bounces, ..settings.clone() },
            fine: self.fine.restore(),
            coarse: self.coarse.map(StoredLevel::restore),
            bounce_matrix: self.bounce_matrix.into_owned(),
            from_fine: self.from_fine.map(Cow::into_owned),
            certificate: self.certificate.into_owned(),
            resolvents: match self.resolvents {
                Some(all) => OnceLock::from(Arc::new(all.map(Square::restore))),
                None => OnceLock::new(),
            },
        }
    }
}
