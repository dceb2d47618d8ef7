//! Autosave: a separate thread writes every edit to a file beside the rig. The file is removed when no edits are
//! unsaved, so a file that exists at the start was left by a crash.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;

use super::desk::Desk;
use crate::error::{Error, Result};
use crate::scene::Rig;

/// Writer of the autosave file.
pub struct Autosave {
    path: PathBuf,
    /// Versions of lights and snapshots last sent to the writer, and whether they were unsaved.
    written: ([u64; 2], bool),
    /// Whether the writer has not answered yet.
    busy: bool,
    /// Whether a failure of the writer has been reported.
    error_reported: bool,
    jobs: Option<Sender<Job>>,
    outcomes: Receiver<Result<()>>,
    writer: Option<JoinHandle<()>>,
}

enum Job {
    Write(Box<Rig>),
    Remove,
}

impl Autosave {
    /// Returns the path of the autosave file: beside the rig, or else beside the scene.
    pub fn path(rig: Option<&Path>, scene: &Path) -> PathBuf {
        rig.unwrap_or(scene).with_extension("autosave.toml")
    }

    /// Starts the writer thread for the file at `path`. The current state of `desk` is not written.
    pub fn new(path: PathBuf, desk: &Desk) -> Self {
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
        Self {
            path,
            written: (versions(desk), false),
            busy: false,
            error_reported: false,
            jobs: Some(jobs),
            outcomes,
            writer: Some(writer),
        }
    }

    /// Loads the file that a crash left, if it exists and differs from `rig`.
    pub fn found(&self, rig: &Rig) -> Option<Result<Rig>> {
        if !self.path.exists() {
            return None;
        }
        let found = Rig::load(&self.path);
        let differs = |found: &Rig| Rig { camera: rig.camera.clone(), ..found.clone() } != *rig;
        Some(found).filter(|found| found.as_ref().map_or(true, differs))
    }

    /// Sends changed lights to the writer if it is free; never blocks. Returns only the first failure of the writer.
    pub fn update(&mut self, desk: &Desk) -> Result<()> {
        let outcome = match self.outcomes.try_recv() {
            Ok(outcome) => {
                self.busy = false;
                outcome
            }
            Err(TryRecvError::Empty | TryRecvError::Disconnected) => Ok(()),
        };
        let state = (versions(desk), desk.is_unsaved());
        if !self.busy && self.written != state {
            let job = if state.1 { Job::Write(Box::new(desk.rig_to_save())) } else { Job::Remove };
            self.busy = self.jobs.as_ref().is_some_and(|jobs| jobs.send(job).is_ok());
            self.written = state;
        }
        let is_first = !self.error_reported;
        self.error_reported |= outcome.is_err();
        if is_first { outcome } else { Ok(()) }
    }

    /// Discards the file that was found: the next [`Self::update`] overwrites or removes it.
    pub fn discard_found(&mut self) {
        self.written = ([u64::MAX; 2], true);
    }

    /// Stops the writer and removes the file.
    pub fn remove(mut self) -> Result<()> {
        self.end();
        remove(&self.path)
    }

    /// Waits for the writer to finish.
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

fn versions(desk: &Desk) -> [u64; 2] {
    [desk.version(), desk.snapshots().version()]
}

fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io("remove", path)(error)),
        _ => Ok(()),
    }
}
