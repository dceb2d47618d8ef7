//! Scenes and their indirect light, handed to the window by the thread that loads and bakes.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use winit::event_loop::EventLoopProxy;

use super::Opened;
use super::converge::Sharper;
use crate::bake::transfer::baked::BakedTransfer;
use crate::error::Result;

/// What reaches the event loop from the loading thread.
pub enum LoadEvent {
    Progress {
        what: &'static str,
        share: f32,
    },
    Opened(Box<Opened>),
    Refined(Box<BakedTransfer>),
    /// More samples where edges lie, as lights rest.
    Sharper(Box<Sharper>),
    /// The thread has ended, with all done or with an error.
    Ended(Result<()>),
}

/// The loading thread's way to the window; any thread may tell how far it is.
pub struct Loader {
    proxy: EventLoopProxy<LoadEvent>,
    state: Mutex<State>,
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
        Self { proxy, state: Mutex::new(State { what: "", total: 0, done: 0, told: None }) }
    }

    /// The window shows the scene from now on.
    pub fn show(&self, opened: Opened) {
        self.send(LoadEvent::Opened(Box::new(opened)));
    }

    /// Indirect light takes the place of what there was.
    pub fn refine(&self, transfer: BakedTransfer) {
        self.send(LoadEvent::Refined(Box::new(transfer)));
    }

    pub(super) fn end(&self, outcome: Result<()>) {
        self.send(LoadEvent::Ended(outcome));
    }

    fn send(&self, event: LoadEvent) {
        // Fails only when the window has gone.
        let _ = self.proxy.send_event(event);
    }

    /// Work of `total` steps begins; 0 if nobody knows.
    pub fn begin(&self, what: &'static str, total: usize) {
        let mut state = self.state.lock().expect("no thread panics while it holds this lock");
        *state = State { what, total, done: 0, told: None };
        self.tell(&mut state);
    }

    /// So many more steps are done.
    pub fn advance(&self, steps: usize) {
        let mut state = self.state.lock().expect("no thread panics while it holds this lock");
        state.done += steps;
        if state.told.is_none_or(|told| told.elapsed() >= INTERVAL) {
            self.tell(&mut state);
        }
    }

    fn tell(&self, state: &mut State) {
        state.told = Some(Instant::now());
        let share = if state.total == 0 { 0.0 } else { state.done as f32 / state.total as f32 };
        self.send(LoadEvent::Progress { what: state.what, share });
    }
}
