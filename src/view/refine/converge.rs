//! Refinement of the picture at rest: extra view samples on edges, up to the quality of `relume render`.
//!
//! The positions of the edges of shadows and lights depend on the lights. Once the lights rest, a low-priority thread
//! therefore bakes the deep framebuffer again with more samples. A second relighter uses it and shades some lights at a
//! time, so that an edit does not wait long. When a light that has edges moves, the first relighter continues.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use super::edge_refinement::EdgeRefinement;
use crate::bake::framebuffer::edges::edge_lights;
use crate::bake::transfer::Transfer;
use crate::bake::{BakeSettings, bake, low_priority};
use crate::error::Result;
use crate::gpu::Context;
use crate::relight::{Layers, RelightSettings, Relighter};
use crate::scene::Rig;
use crate::view::LoadedScene;
use crate::view::loading::load::{LoadEvent, Messenger};

/// Refinement of the picture at rest.
pub struct Converge {
    /// View samples per pixel on edges; 1 disables refinement.
    samples: u32,
    settings: RelightSettings,
    context: Arc<Context>,
    messenger: Messenger,
    relighter: Option<Relighter>,
    /// Edges and source transfer of the relighter's bake.
    has: Option<(Vec<u8>, Option<Arc<Transfer>>)>,
    /// Layers that were requested last.
    layers: Layers,
    baking: Option<Baking>,
    /// Time of the last edit.
    edited: Instant,
    /// Time at which progress was last shown.
    progress_shown: Instant,
}

/// A running bake; counts are tiles.
struct Baking {
    done: Arc<AtomicUsize>,
    total: usize,
}

/// Progress of the refinement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Progress {
    /// Waiting for the lights to rest, or disabled.
    #[default]
    Waits,
    /// Baking; share from 0 to 1.
    Bakes(f32),
    /// Shading; lights done, and all lights.
    Shades(usize, usize),
    Done,
}

/// Refinement starts this long after the last edit.
const REFINEMENT_DELAY: Duration = Duration::from_millis(400);
/// Time in which a step begins further lights.
const STEP: Duration = Duration::from_millis(15);
/// Interval at which progress is shown.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

impl Converge {
    pub fn new(context: &Arc<Context>, messenger: Messenger, settings: &RelightSettings, samples: u32) -> Self {
        Self {
            samples,
            settings: settings.clone(),
            context: context.clone(),
            messenger,
            relighter: None,
            has: None,
            layers: Layers::All,
            baking: None,
            edited: Instant::now(),
            progress_shown: Instant::now(),
        }
    }

    /// Records an edit: refinement waits again.
    pub fn restart(&mut self, now: Instant) {
        self.edited = now;
    }

    /// Returns the relighter with extra samples, if there is one.
    pub fn relighter(&self) -> Option<&Relighter> {
        self.relighter.as_ref()
    }

    pub fn relighter_mut(&mut self) -> Option<&mut Relighter> {
        self.relighter.as_mut()
    }

    /// Whether there is nothing left to do for `rig`.
    pub fn is_done(&self, opened: &LoadedScene, rig: &Rig) -> bool {
        self.next_step_at(opened, rig, true).is_none()
    }

    fn is_current(&self, opened: &LoadedScene, rig: &Rig) -> bool {
        self.has
            .as_ref()
            .is_some_and(|(edges_of, of)| opened.has(of) && *edges_of == edge_lights(opened.scene.space, rig))
    }

    /// Returns the relighter with extra samples, if it is complete for `rig`.
    pub fn ready(&mut self, opened: &LoadedScene, rig: &Rig, layers: Layers) -> Result<Option<&mut Relighter>> {
        if !self.is_current(opened, rig) {
            return Ok(None);
        }
        let Some(relighter) = &mut self.relighter else { return Ok(None) };
        self.layers = layers;
        relighter.set_rig(rig)?;
        Ok(Some(relighter).filter(|relighter| relighter.pending(layers) == 0))
    }

    /// Whether extra samples are enabled and possible.
    fn is_wanted(&self, opened: &LoadedScene) -> bool {
        // Wavelet rows support one sample per pixel only. If light images share memory, they are never complete.
        self.samples > 1
            && self.relighter.as_ref().is_none_or(Relighter::has_slot_for_every_image)
            && opened.transfer.as_ref().is_none_or(|transfer| !transfer.chain.is_empty())
    }

    /// Returns when the next step is due, or the next display of progress if `shows_progress`, unless an event comes
    /// before.
    pub fn next_step_at(&self, opened: &LoadedScene, rig: &Rig, shows_progress: bool) -> Option<Instant> {
        let pending = self.relighter.as_ref().map_or(0, |relighter| relighter.pending(self.layers));
        match &self.baking {
            _ if !self.is_wanted(opened) => None,
            Some(_) => shows_progress.then_some(self.progress_shown + PROGRESS_INTERVAL),
            None if self.is_current(opened, rig) && pending == 0 => None,
            None => Some(self.edited + REFINEMENT_DELAY),
        }
    }

    /// Does one short step of refinement, if the lights rest.
    pub fn step(&mut self, opened: &LoadedScene, rig: &Rig) -> Result<()> {
        self.progress_shown = Instant::now();
        if !self.is_wanted(opened) || self.baking.is_some() || self.edited.elapsed() < REFINEMENT_DELAY {
            return Ok(());
        }
        if !self.is_current(opened, rig) {
            self.begin(opened, rig);
        } else if let Some(relighter) = &mut self.relighter {
            let began = Instant::now();
            while began.elapsed() < STEP && relighter.pending(self.layers) > 0 {
                relighter.prepare(self.layers)?;
            }
        }
        Ok(())
    }

    /// Starts a bake on separate threads.
    fn begin(&mut self, opened: &LoadedScene, rig: &Rig) {
        let (scene, plain, of, rig) =
            (opened.scene.clone(), opened.framebuffer.clone(), opened.transfer.clone(), rig.clone());
        let settings = BakeSettings {
            width: plain.tiling.width,
            height: plain.tiling.height,
            layers: plain.asked_layers,
            samples: self.samples,
        };
        let done = Arc::new(AtomicUsize::new(0));
        self.baking = Some(Baking { done: done.clone(), total: 2 * settings.tile_count() });
        let messenger = self.messenger.clone();
        // Not joined, so that closing the window does not wait for it.
        std::thread::spawn(move || {
            let advance = |tiles| {
                done.fetch_add(tiles, Ordering::Relaxed);
            };
            let make = || {
                let mut framebuffer = bake(&scene, &plain.camera, &rig, &settings, &advance);
                framebuffer.has_specular |= plain.has_specular;
                let transfer = of.as_ref().and_then(|of| of.spread(&plain, &framebuffer, scene.bvh.radius));
                (Arc::new(framebuffer), transfer.map(Arc::new))
            };
            let made = catch_unwind(AssertUnwindSafe(|| low_priority(make))).ok();
            let edges = edge_lights(scene.space, &rig);
            let refinement =
                made.map(|(framebuffer, transfer)| Box::new(EdgeRefinement { edges, of, framebuffer, transfer }));
            // Fails only after the window is closed.
            let _ = messenger.send(LoadEvent::EdgesRefined(refinement));
        });
    }

    /// Accepts a finished bake, unless lights that cast shadows have moved since; `None`: it failed.
    pub fn accept(&mut self, refinement: Option<EdgeRefinement>, opened: &LoadedScene, rig: &Rig) {
        self.baking = None;
        let Some(refinement) = refinement else {
            return self.give_up("it failed; the reason is on the terminal");
        };
        if !opened.has(&refinement.of) || refinement.edges != edge_lights(opened.scene.space, rig) {
            return;
        }
        let outcome = match &mut self.relighter {
            Some(relighter) => relighter.set_framebuffer(refinement.framebuffer, refinement.transfer),
            None => {
                let (context, settings) = (&self.context, &self.settings);
                Relighter::new(
                    context,
                    &opened.scene,
                    &refinement.framebuffer,
                    refinement.transfer.as_ref(),
                    rig,
                    settings,
                )
                .map(|made| self.relighter = Some(made))
            }
        };
        match outcome {
            Err(error) => self.give_up(&error.chain()),
            Ok(()) => self.has = Some((refinement.edges, refinement.of)),
        }
    }

    /// The picture remains without extra samples.
    fn give_up(&mut self, reason: &str) {
        tracing::warn!("edges are not refined and have one sample per pixel: {reason}");
        (self.relighter, self.samples) = (None, 1);
    }

    /// Returns the progress of the refinement for `rig`.
    pub fn progress(&self, opened: &LoadedScene, rig: &Rig) -> Progress {
        match (&self.baking, &self.relighter) {
            (Some(Baking { done, total }), _) => {
                Progress::Bakes(done.load(Ordering::Relaxed) as f32 / (*total).max(1) as f32)
            }
            (None, Some(relighter)) if self.is_current(opened, rig) => match relighter.pending(self.layers) {
                0 => Progress::Done,
                pending => Progress::Shades(rig.lights.len().saturating_sub(pending), rig.lights.len()),
            },
            _ => Progress::Waits,
        }
    }
}
