//! Messages from the loading thread to the window: scenes, indirect light and progress.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use winit::event_loop::EventLoopProxy;

use super::Opened;
use super::edge_refinement::EdgeRefinement;
use super::gathered::Gathered;
use super::map_answer::Answer;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::session::Progress;

/// A message to the event loop from a loading or baking thread.
pub enum LoadEvent {
    Progress {
        what: &'static str,
        share: f32,
    },
    Opened(Box<Opened>),
    Transfer(Arc<Transfer>),
    /// A bake with extra samples on edges, made while lights rest.
    EdgesRefined(Box<EdgeRefinement>),
    /// Indirect light that was gathered while lights rest.
    Gathered(Box<Gathered>),
    /// The thread that reads environment maps has done a job.
    Maps(Box<Answer>),
    /// The loading thread has nothing to do any more, or failed.
    Ended(Result<()>),
}

/// Sends messages from the loading thread to the window; any thread may report progress.
pub struct Loader {
    proxy: EventLoopProxy<LoadEvent>,
    state: Mutex<State>,
    window_is_gone: AtomicBool,
    /// Receives once the rig has a dome; ends with the window.
    domes: Mutex<Receiver<()>>,
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
    /// Returns a loader, and what tells it that the rig has a dome.
    pub(super) fn new(proxy: EventLoopProxy<LoadEvent>) -> (Self, Sender<()>) {
        let (sender, domes) = channel();
        let loader = Self {
            proxy,
            state: Mutex::new(State { what: "", total: 0, done: 0, last_sent: None }),
            window_is_gone: AtomicBool::new(false),
            domes: Mutex::new(domes),
        };
        (loader, sender)
    }

    /// Sends the scene to the window, which shows it.
    pub fn show(&self, opened: Opened) {
        self.send(LoadEvent::Opened(Box::new(opened)));
    }

    /// Sends indirect light to the window; it replaces the previous one.
    pub fn show_transfer(&self, transfer: Arc<Transfer>) {
        self.send(LoadEvent::Transfer(transfer));
    }

    /// Waits until the rig has a dome. Returns whether it has one, and not the window is gone.
    pub fn wait_for_dome(&self) -> bool {
        self.end(Ok(()));
        self.domes.lock().expect("no thread panics while it holds this lock").recv().is_ok()
    }

    pub(super) fn end(&self, outcome: Result<()>) {
        self.send(LoadEvent::Ended(outcome));
    }

    fn send(&self, event: LoadEvent) {
        if self.proxy.send_event(event).is_err() {
            self.window_is_gone.store(true, Ordering::Relaxed);
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
        self.window_is_gone.load(Ordering::Relaxed)
    }
}
