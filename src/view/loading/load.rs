//! Messages from other threads to the window: scenes, indirect light, progress, and requests of other programs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::map_answer::Answer;
use crate::bake::transfer::Transfer;
use crate::error::{Error, Result};
use crate::scene::Rig;
use crate::session::{BakeInput, Progress, Session, SessionSettings};
use crate::trace::bvh::TracedScene;
use crate::view::LoadedScene;
use crate::view::refine::edge_refinement::EdgeRefinement;
use crate::view::refine::gathered::Gathered;
use crate::wire::Inbound;

/// A message to the event loop, with the number of the scene that it is for. The scene may have been loaded again
/// since.
pub struct Numbered {
    pub scene: u32,
    /// Of another camera than the shown one: its index in the scene.
    pub shot: Option<usize>,
    pub event: LoadEvent,
}

/// Sends messages of one scene to the event loop.
#[derive(Clone)]
pub struct Messenger {
    send: Arc<dyn Fn(Numbered) -> bool + Send + Sync>,
    scene: u32,
    shot: Option<usize>,
}

impl Messenger {
    /// `send` returns whether somebody still takes messages.
    pub fn new(send: impl Fn(Numbered) -> bool + Send + Sync + 'static) -> Self {
        Self { send: Arc::new(send), scene: 0, shot: None }
    }

    /// The same for another scene.
    #[must_use]
    pub fn of_scene(&self, scene: u32) -> Self {
        Self { send: self.send.clone(), scene, shot: None }
    }

    /// The same for another camera of the scene.
    fn of_shot(&self, shot: usize) -> Self {
        Self { shot: Some(shot), ..self.clone() }
    }

    /// Returns whether somebody still takes messages.
    pub fn send(&self, event: LoadEvent) -> bool {
        (self.send)(Numbered { scene: self.scene, shot: self.shot, event })
    }
}

/// A scene to load.
#[derive(Clone)]
pub struct SceneSource {
    pub path: PathBuf,
    /// Rig file whose lights replace those of the scene.
    pub rig: Option<PathBuf>,
    pub settings: SessionSettings,
}

/// What is known of a scene of which another camera is wanted.
#[derive(Clone)]
pub struct Known {
    pub scene: Arc<TracedScene>,
    /// The lights of all shots.
    pub rig: Rig,
    /// The camera's indirect light, if its picture is shown already.
    pub transfer: Option<Arc<Transfer>>,
}

impl SceneSource {
    /// Starts to load the scene and to bake it on a thread, which tells `messenger`.
    pub fn start(&self, messenger: Messenger, known: Option<Known>) -> Loading {
        let (sender, domes) = channel();
        let is_cancelled = Arc::<AtomicBool>::default();
        let loader = Loader::new(messenger, domes, is_cancelled.clone());
        let source = self.clone();
        // Not joined, so that closing the window does not wait for a long bake.
        std::thread::spawn(move || loader.end(source.load_or_fail(known, &loader)));
        Loading { first_dome: Some(sender), is_cancelled }
    }

    /// Starts to bake for cameras of the scene, in turn, on a thread, which tells `messenger`.
    pub fn start_shots(&self, messenger: &Messenger, known: &Known, shots: Vec<usize>) -> Loading {
        let is_cancelled = Arc::<AtomicBool>::default();
        let loading = Loading { first_dome: None, is_cancelled: is_cancelled.clone() };
        let (messenger, known, mut source) = (messenger.clone(), known.clone(), self.clone());
        std::thread::spawn(move || {
            for shot in shots {
                source.settings.open.camera = Some(known.scene.cameras[shot].name.clone());
                // With the first dome the sheet begins again.
                let loader = Loader::new(messenger.of_shot(shot), channel().1, is_cancelled.clone());
                loader.end(source.load_or_fail(Some(known.clone()), &loader));
                if is_cancelled.load(Ordering::Relaxed) {
                    return;
                }
            }
        });
        loading
    }

    /// [`Self::load`]; a panic, for instance of a decoder of images, is an error.
    fn load_or_fail(&self, known: Option<Known>, loader: &Loader) -> Result<()> {
        let loaded = catch_unwind(AssertUnwindSafe(|| self.load(known, loader)));
        loaded.unwrap_or_else(|_| {
            Err(Error::import(&self.path, "loading or baking it failed; the reason is on the terminal"))
        })
    }

    fn load(&self, known: Option<Known>, loader: &Loader) -> Result<()> {
        let (session, shown) = match known {
            Some(Known { scene, rig, transfer }) => (Session::of_traced(scene, rig, &self.settings, loader)?, transfer),
            None => (Session::open_direct(&self.path, self.rig.as_deref(), &self.settings, loader)?, None),
        };
        let Session { scene, framebuffer, base_rig: rig, transfers, bake, .. } = session;
        let changed = bake.because;
        let opened =
            LoadedScene { scene: scene.clone(), framebuffer: framebuffer.clone(), transfer: None, rig, changed };
        if shown.is_none() {
            loader.send(LoadEvent::Opened(Box::new(opened)));
        }
        let Some(transfers) = transfers else { return Ok(()) };
        let seen = BakeInput { scene: &scene, framebuffer: &framebuffer };
        let show = |transfer| loader.send(LoadEvent::Transfer(transfer));
        let transfer = shown.map_or_else(|| transfers.refine(seen, loader, show), Ok)?;
        if transfers.lacks_sky() && loader.wait_for_dome() {
            loader.send(LoadEvent::Transfer(Arc::new(transfers.add_sky(&transfer, seen, loader)?)));
        }
        Ok(())
    }
}

/// A message to the event loop from another thread.
pub enum LoadEvent {
    Progress {
        what: &'static str,
        share: f32,
    },
    Opened(Box<LoadedScene>),
    Transfer(Arc<Transfer>),
    /// A bake with extra samples on edges, made while lights rest; `None`: it failed.
    EdgesRefined(Option<Box<EdgeRefinement>>),
    /// Indirect light that was gathered while lights rest; `None`: gathering failed.
    Gathered(Option<Box<Gathered>>),
    /// The thread that reads environment maps has done a job.
    Maps(Box<Answer>),
    /// The loading thread has nothing to do any more, or failed.
    Ended(Result<()>),
    /// Of another program, whatever scene is open.
    Wire(Inbound),
}

/// Sends messages from the loading thread to the window; any thread may report progress.
struct Loader {
    messenger: Messenger,
    state: Mutex<State>,
    /// The window is gone, or loads again.
    is_cancelled: Arc<AtomicBool>,
    /// Receives once the rig has a dome; ends with the window.
    domes: Mutex<Receiver<()>>,
}

/// What the window holds of a loading thread. When it is dropped, the thread ends soon.
pub struct Loading {
    /// Tells the thread that the rig has a dome; `None` once it was told.
    pub first_dome: Option<Sender<()>>,
    is_cancelled: Arc<AtomicBool>,
}

impl Drop for Loading {
    fn drop(&mut self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }
}

struct State {
    what: &'static str,
    total: usize,
    done: usize,
    last_sent: Option<Instant>,
}

/// Shortest interval between progress messages.
const INTERVAL: Duration = Duration::from_millis(100);

impl Loader {
    fn new(messenger: Messenger, domes: Receiver<()>, is_cancelled: Arc<AtomicBool>) -> Self {
        let state = Mutex::new(State { what: "", total: 0, done: 0, last_sent: None });
        Self { messenger, state, is_cancelled, domes: Mutex::new(domes) }
    }

    /// Waits until the rig has a dome. Returns whether it has one, and not the window is gone.
    fn wait_for_dome(&self) -> bool {
        self.end(Ok(()));
        self.domes.lock().expect("no thread panics while it holds this lock").recv().is_ok()
    }

    fn end(&self, outcome: Result<()>) {
        self.send(LoadEvent::Ended(outcome));
    }

    fn send(&self, event: LoadEvent) {
        if !self.messenger.send(event) {
            self.is_cancelled.store(true, Ordering::Relaxed);
        }
    }

    fn send_progress(&self, state: &mut State) {
        state.last_sent = Some(Instant::now());
        let share = if state.total == 0 { 0.0 } else { state.done as f32 / state.total as f32 };
        self.send(LoadEvent::Progress { what: state.what, share });
    }
}

/// The progress bar of the window.
impl Progress for Loader {
    fn begin(&self, what: &'static str, total: usize) {
        let mut state = self.state.lock().expect("no thread panics while it holds this lock");
        *state = State { what, total, done: 0, last_sent: None };
        self.send_progress(&mut state);
    }

    fn advance(&self, steps: usize) {
        let mut state = self.state.lock().expect("no thread panics while it holds this lock");
        state.done += steps;
        if state.last_sent.is_none_or(|last_sent| last_sent.elapsed() >= INTERVAL) {
            self.send_progress(&mut state);
        }
    }

    fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }
}
