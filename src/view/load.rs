//! Scenes and their indirect light, handed to the window by the thread that loads and bakes.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use winit::event_loop::EventLoopProxy;

use super::Opened;
use super::converge::Sharper;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::session::Progress;

/// What reaches the event loop from the loading thread.
pub enum LoadEvent {
    Progress {
        what: &'static str,
        share: f32,
    },
    Opened(Box<Opened>),
    Refined(Arc<Transfer>),
    /// More samples where edges lie, as lights rest.
    Sharper(Box<Sharper>),
    /// The thread has ended, with all done or with an error.
    Ended(Result<()>),
}

/// The loading thread's way to the window; any thread may tell how far it is.
pub struct Loader {
    proxy: EventLoopProxy<LoadEvent>,
    state: Mutex<State>,
    window_is_gone: AtomicBool,
}

struct State {
    what: &'static str,
    total: usize,
    done: usize,
    told: Option<Instant>,
}

/// The window need not follow faster.
const INTERVAL: Duration = Duration::from_millis(100);

impl Loader {
    pub(super) fn new(proxy: EventLoopProxy<LoadEvent>) -> Self {
        Self {
            proxy,
            state: Mutex::new(State { what: "", total: 0, done: 0, told: None }),
            window_is_gone: AtomicBool::new(false),
        }
    }

    /// The window shows the scene from now on.
    pub fn show(&self, opened: Opened) {
        self.send(LoadEvent::Opened(Box::new(opened)));
    }

    /// Indirect light takes the place of what there was.
    pub fn refine(&self, transfer: Transfer) {
        self.send(LoadEvent::Refined(Arc::new(transfer)));
    }

    pub(super) fn end(&self, outcome: Result<()>) {
        self.send(LoadEvent::Ended(outcome));
    }

    fn send(&self, event: LoadEvent) {
        if self.proxy.send_event(event).is_err() {
            self.window_is_gone.store(true, Ordering::Relaxed);
        }
    }

    fn tell(&self, state: &mut State) {
        state.told = Some(Instant::now());
        let share = if state.total == 0 { 0.0 } else { state.done as f32 / state.total as f32 };
        self.send(LoadEvent::Progress { what: state.what, share });
    }
}

/// The window's bar, which goes with the loading.
impl Progress for Loader {
    fn begin(&self, what: &'static str, total: usize) {
        let mut state = self.state.lock().expect("no thread panics while it holds this lock");
        *state = State { what, total, done: 0, told: None };
        self.tell(&mut state);
    }

    fn advance(&self, steps: usize) {
        let mut state = self.state.lock().expect("no thread panics while it holds this lock");
        state.done += steps;
        if state.told.is_none_or(|told| told.elapsed() >= INTERVAL) {
            self.tell(&mut state);
        }
    }

    fn is_cancelled(&self) -> bool {
        self.window_is_gone.load(Ordering::Relaxed)
    }
}
