//! Every edit is in a file beside the rig a moment later, written by a thread of its own. The file goes when there is
//! nothing to lose; what is found at the start is what a crash left.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;

use super::desk::Desk;
use crate::error::{Error, Result};
use crate::scene::Rig;

pub struct Autosave {
    path: PathBuf,
    /// The version of the desk that was handed to the writer, and whether it was unsaved.
    written: (u64, bool),
    /// The writer has not answered yet.
    busy: bool,
    /// Somebody was told that writing fails.
    told: bool,
    jobs: Option<Sender<Job>>,
    outcomes: Receiver<Result<()>>,
    writer: Option<JoinHandle<()>>,
}

enum Job {
    Write(Box<Rig>),
    Remove,
}

impl Autosave {
    /// Beside the rig, or else beside the scene.
    pub fn path(rig: Option<&Path>, scene: &Path) -> PathBuf {
        rig.unwrap_or(scene).with_extension("autosave.toml")
    }

    pub fn new(path: PathBuf) -> Self {
        let (jobs, taken) = channel();
        let (answer, outcomes) = channel();
        let target = path.clone();
        let writer = std::thread::spawn(move || {
            for job in taken {
                let outcome = match job {
                    Job::Write(rig) => rig.save(&target),
                    Job::Remove => remove(&target),
                };
                if answer.send(outcome).is_err() {
                    return;
                }
            }
        });
        Self { path, written: (0, false), busy: false, told: false, jobs: Some(jobs), outcomes, writer: Some(writer) }
    }

    /// What a crash left, if it differs from `rig`.
    pub fn found(&self, rig: &Rig) -> Option<Result<Rig>> {
        if !self.path.exists() {
            return None;
        }
        let found = Rig::load(&self.path);
        let differs = |found: &Rig| (&found.lights, &found.groups) != (&rig.lights, &rig.groups);
        Some(found).filter(|found| found.as_ref().map_or(true, differs))
    }

    /// Hands the lights to the writer if they changed and it is free; nothing waits. Returns, once, what went wrong.
    pub fn note(&mut self, desk: &Desk) -> Result<()> {
        let outcome = match self.outcomes.try_recv() {
            Ok(outcome) => {
                self.busy = false;
                outcome
            }
            Err(TryRecvError::Empty | TryRecvError::Disconnected) => Ok(()),
        };
        let state = (desk.version(), desk.history().is_unsaved());
        if !self.busy && self.written != state {
            let job = if state.1 { Job::Write(Box::new(desk.rig().clone())) } else { Job::Remove };
            self.busy = self.jobs.as_ref().is_some_and(|jobs| jobs.send(job).is_ok());
            self.written = state;
        }
        let is_news = !self.told;
        self.told |= outcome.is_err();
        if is_news { outcome } else { Ok(()) }
    }

    /// What was found is not wanted.
    pub fn forget(&mut self) {
        self.written = (u64::MAX, true);
    }

    /// There is nothing to lose any more.
    pub fn remove(mut self) -> Result<()> {
        self.end();
        remove(&self.path)
    }

    /// Lets the writer finish.
    fn end(&mut self) {
        self.jobs = None;
        self.writer.take().into_iter().for_each(|writer| writer.join().expect("the writer does not panic"));
    }
}

impl Drop for Autosave {
    fn drop(&mut self) {
        self.end();
    }
}

fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io("remove", path)(error)),
        _ => Ok(()),
    }
}
