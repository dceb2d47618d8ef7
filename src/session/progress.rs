//! Where long work tells how far it is, and hears that nobody waits for it any more.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use crate::error::{Error, Result};

/// Who is told of progress; one piece of work at a time.
pub trait Progress: Sync {
    /// Work of `total` steps begins; 0 if nobody knows how long it takes.
    fn begin(&self, _what: &'static str, _total: usize) {}
    /// From any thread, often.
    fn advance(&self, _steps: usize) {}
    fn end(&self) {}
    /// Whether work shall stop: it then ends soon with [`Error::Cancelled`].
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Nobody.
impl Progress for () {}

/// What unwinds out of work that is cancelled, through whatever threads it runs on. No panic hook sees it.
struct Cancelled;

/// `progress.advance` for the loops of a bake; unwinds where `progress` is cancelled, inside of [`until_cancelled`].
pub(super) fn advance(progress: &dyn Progress) -> impl Fn(usize) + Sync + '_ {
    move |steps| {
        progress.advance(steps);
        if progress.is_cancelled() {
            resume_unwind(Box::new(Cancelled));
        }
    }
}

/// Runs `work` to its end or until its [`advance`] finds it cancelled.
pub(super) fn until_cancelled<R>(work: impl FnOnce() -> Result<R>) -> Result<R> {
    // What the work borrows is thrown away with it by who gets the error.
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload: Box<dyn Any + Send>| {
        match payload.is::<Cancelled>() {
            true => Err(Error::Cancelled),
            false => resume_unwind(payload),
        }
    })
}
