//! Progress of loading and baking, told to the window from another thread.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use winit::event_loop::EventLoopProxy;

use super::Opened;
use crate::error::Result;

/// What reaches the event loop from the loading thread.
pub enum LoadEvent {
    Progress { what: &'static str, share: f32 },
    Opened(Box<Result<Opened>>),
}

/// How far loading is; any thread may tell.
pub struct LoadProgress {
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
const INTERVAL: Duration = Duration::from_millis(50);

impl LoadProgress {
    pub(super) fn new(proxy: EventLoopProxy<LoadEvent>) -> Self {
        Self { proxy, state: Mutex::new(State { what: "", total: 0, done: 0, told: None }) }
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
        // Fails only when the window has gone.
        let _ = self.proxy.send_event(LoadEvent::Progress { what: state.what, share });
    }
}
