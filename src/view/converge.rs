//! What becomes of a picture at rest: more view samples where edges lie, until it is as good as `relume render` makes it.
//!
//! Where shadow edges lie depends on the lights, so once these rest, another thread bakes the deep framebuffer anew with
//! more samples, at low priority. A second relighter takes it over and shades one light after the other, so that no hand
//! has to wait longer than for one. As soon as a light moves that casts shadows, the first relighter goes on.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use winit::event_loop::EventLoopProxy;

use super::Opened;
use super::load::LoadEvent;
use crate::bake::transfer::Transfer;
use crate::bake::{BakeSettings, DeepFramebuffer, bake, low_priority};
use crate::error::Result;
use crate::gpu::Context;
use crate::relight::{Layers, RelightSettings, Relighter};
use crate::scene::{Rig, Scene};

/// A deep framebuffer with more samples, baked in the background.
pub struct Sharper {
    edges: Edges,
    /// The transfer that its own was made from.
    of: Option<Arc<Transfer>>,
    framebuffer: Arc<DeepFramebuffer>,
    transfer: Option<Arc<Transfer>>,
}

/// Whether both are the same bake.
fn is_same(a: &Option<Arc<Transfer>>, b: &Option<Arc<Transfer>>) -> bool {
    a.as_ref().map(Arc::as_ptr) == b.as_ref().map(Arc::as_ptr)
}

/// What shadow edges depend on: every light that casts shadows, as kernels know it.
type Edges = Vec<u8>;

fn edges(scene: &Scene, rig: &Rig) -> Edges {
    let casts = rig.lights.iter().filter(|light| light.enabled && light.shadows);
    casts.flat_map(|light| bytemuck::bytes_of(&light.pack(scene.space)).to_vec()).collect()
}

pub struct Converge {
    /// View samples of a pixel on an edge; 1 leaves pictures as they are.
    samples: u32,
    settings: RelightSettings,
    context: Arc<Context>,
    proxy: EventLoopProxy<LoadEvent>,
    relighter: Option<Relighter>,
    /// Edges and source of the transfer that the relighter has.
    has: Option<(Edges, Option<Arc<Transfer>>)>,
    /// Those that were asked for last.
    layers: Layers,
    baking: Option<Baking>,
    /// When something was last edited.
    edited: Instant,
    /// When somebody last looked at how far it is.
    looked: Instant,
}

/// A bake under way.
struct Baking {
    done: Arc<AtomicUsize>,
    total: usize,
}

/// How far a picture is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Progress {
    /// Edits follow each other, or nothing more is to come.
    #[default]
    Waits,
    /// Share of the samples.
    Bakes(f32),
    /// Lights shaded, of all.
    Shades(usize, usize),
    Done,
}

/// Nothing is begun before lights rest for so long.
const REST: Duration = Duration::from_millis(400);
/// How often progress is shown.
const LOOK: Duration = Duration::from_millis(200);

impl Converge {
    pub fn new(
        context: &Arc<Context>,
        proxy: EventLoopProxy<LoadEvent>,
        settings: &RelightSettings,
        samples: u32,
    ) -> Self {
        Self {
            samples,
            settings: settings.clone(),
            context: context.clone(),
            proxy,
            relighter: None,
            has: None,
            layers: Layers::All,
            baking: None,
            edited: Instant::now(),
            looked: Instant::now(),
        }
    }

    /// Something was edited: whatever is to come waits for rest.
    pub fn restart(&mut self, now: Instant) {
        self.edited = now;
    }

    /// The relighter with more samples, if there is one.
    pub fn relighter(&self) -> Option<&Relighter> {
        self.relighter.as_ref()
    }

    fn is_current(&self, opened: &Opened, rig: &Rig) -> bool {
        self.has
            .as_ref()
            .is_some_and(|(edges_of, of)| is_same(of, &opened.transfer) && *edges_of == edges(&opened.scene, rig))
    }

    /// The relighter with more samples, if all that it needs for `rig` is there.
    pub fn ready(&mut self, opened: &Opened, rig: &Rig, layers: Layers) -> Result<Option<&mut Relighter>> {
        if !self.is_current(opened, rig) {
            return Ok(None);
        }
        let Some(relighter) = &mut self.relighter else { return Ok(None) };
        self.layers = layers;
        relighter.set_rig(rig)?;
        Ok(Some(relighter).filter(|relighter| relighter.pending(layers) == 0))
    }

    /// Whether there can be more samples.
    fn is_wanted(&self, opened: &Opened) -> bool {
        // Rows of wavelets serve one sample a pixel; images that take each other's place are never all there.
        self.samples > 1
            && self.relighter.as_ref().is_none_or(Relighter::keeps_all)
            && opened.transfer.as_ref().is_none_or(|transfer| !transfer.chain.is_empty())
    }

    /// When there is something to do, or to show to one who looks at it, if nothing happens until then.
    pub fn goes_on_at(&self, opened: &Opened, rig: &Rig, is_looked_at: bool) -> Option<Instant> {
        let pending = self.relighter.as_ref().map_or(0, |relighter| relighter.pending(self.layers));
        match &self.baking {
            _ if !self.is_wanted(opened) => None,
            Some(_) => is_looked_at.then_some(self.looked + LOOK),
            None if self.is_current(opened, rig) && pending == 0 => None,
            None => Some(self.edited + REST),
        }
    }

    /// Does one thing that does not take long, if lights rest.
    pub fn go_on(&mut self, opened: &Opened, rig: &Rig) -> Result<()> {
        self.looked = Instant::now();
        if !self.is_wanted(opened) || self.baking.is_some() || self.edited.elapsed() < REST {
            return Ok(());
        }
        if !self.is_current(opened, rig) {
            self.begin(opened, rig);
        } else if let Some(relighter) = &mut self.relighter {
            relighter.prepare(self.layers)?;
        }
        Ok(())
    }

    /// Begins a bake on threads of its own.
    fn begin(&mut self, opened: &Opened, rig: &Rig) {
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
        let proxy = self.proxy.clone();
        // Not joined: who closes the window does not wait for it.
        std::thread::spawn(move || {
            let advance = |tiles| {
                done.fetch_add(tiles, Ordering::Relaxed);
            };
            let (framebuffer, transfer) = low_priority(|| {
                let mut framebuffer = bake(&scene, &plain.camera, &rig, &settings, &advance);
                framebuffer.has_specular |= plain.has_specular;
                let transfer = of.as_ref().and_then(|of| of.spread(&plain, &framebuffer, scene.bvh.radius));
                (Arc::new(framebuffer), transfer.map(Arc::new))
            });
            let sharper = Sharper { edges: edges(&scene, &rig), of, framebuffer, transfer };
            // Fails only when the window has gone.
            let _ = proxy.send_event(LoadEvent::Sharper(Box::new(sharper)));
        });
    }

    /// Takes over what another thread has baked, unless lights have moved since.
    pub fn take(&mut self, sharper: Sharper, opened: &Opened, rig: &Rig) {
        self.baking = None;
        if !is_same(&sharper.of, &opened.transfer) || sharper.edges != edges(&opened.scene, rig) {
            return;
        }
        let taken = match &mut self.relighter {
            Some(relighter) => relighter.set_framebuffer(sharper.framebuffer, sharper.transfer),
            None => {
                let (context, settings) = (&self.context, &self.settings);
                Relighter::new(context, &opened.scene, &sharper.framebuffer, sharper.transfer.as_ref(), rig, settings)
                    .map(|made| self.relighter = Some(made))
            }
        };
        match taken {
            // The picture that there is does without.
            Err(error) => {
                tracing::warn!("edges stay as they are, with one sample a pixel: {error}");
                (self.relighter, self.samples) = (None, 1);
            }
            Ok(()) => self.has = Some((sharper.edges, sharper.of)),
        }
    }

    pub fn progress(&self, opened: &Opened, rig: &Rig) -> Progress {
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
