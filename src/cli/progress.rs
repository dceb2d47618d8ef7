//! Progress bars on stderr, and only on a terminal.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use relume::session::Progress;

static QUIET: AtomicBool = AtomicBool::new(false);

pub fn set_quiet(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

/// A bar on stderr, while work goes on.
#[derive(Default)]
pub struct Terminal(Mutex<Option<ProgressBar>>);

const UNPOISONED: &str = "no thread panics while it holds this lock";

impl Progress for Terminal {
    fn begin(&self, what: &'static str, total: usize) {
        let shown = if total == 0 { spinner(what) } else { bar(what, total) };
        *self.0.lock().expect(UNPOISONED) = Some(shown);
    }

    fn advance(&self, steps: usize) {
        if let Some(bar) = &*self.0.lock().expect(UNPOISONED) {
            bar.inc(steps as u64);
        }
    }

    fn end(&self) {
        if let Some(bar) = self.0.lock().expect(UNPOISONED).take() {
            bar.finish_and_clear();
        }
    }
}

/// A bar for work of `total` steps; it goes when it is done.
pub fn bar(what: &'static str, total: usize) -> ProgressBar {
    let target = match QUIET.load(Ordering::Relaxed) {
        true => ProgressDrawTarget::hidden(),
        false => ProgressDrawTarget::stderr_with_hz(10), // hidden by itself where stderr is no terminal
    };
    let style = ProgressStyle::with_template("{msg:24} {wide_bar} {percent:>3} %  {eta} left")
        .expect("the template is valid")
        .progress_chars("█▉▊▋▌▍▎▏ ");
    ProgressBar::with_draw_target(Some(total as u64), target).with_style(style).with_message(what)
}

/// Shows how many lights of a picture are done, until all are.
pub fn of_lights() -> impl Fn(usize, usize) + Send + Sync + 'static {
    let shown = Mutex::new(None);
    move |done, all| {
        let mut shown = shown.lock().expect(UNPOISONED);
        if done < all {
            shown.get_or_insert_with(|| bar("lights", all)).set_position(done as u64);
        } else if let Some(bar) = shown.take() {
            bar.finish_and_clear();
        }
    }
}

/// A line for work whose length nobody knows.
pub fn spinner(what: &'static str) -> ProgressBar {
    let bar = bar(what, 0);
    bar.set_style(ProgressStyle::with_template("{msg:24} {spinner}").expect("the template is valid"));
    bar.enable_steady_tick(std::time::Duration::from_millis(100));
    bar
}
