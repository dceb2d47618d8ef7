//! Autosave: a separate thread writes every edit to a file beside the rig. The file is removed when no edits are
//! unsaved, so a file that no window holds was left by a crash.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;

use crate::desk::Desk;
use crate::error::{Error, Result};
use crate::scene::Rig;

/// Writer of the autosave file.
pub struct Autosave {
    /// The file that a crash left.
    found: Option<PathBuf>,
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
    /// The next write takes another file.
    Leave,
}

/// Highest number of a file that a crash left for the next window to find.
const MOST_FOUND: usize = 16;

impl Autosave {
    /// Starts the writer thread for files beside `of`, which is the rig or else the scene. The current state of `desk`
    /// is not written.
    pub fn new(of: &Path, desk: &Desk) -> Self {
        let (jobs, taken) = channel();
        let (answer, outcomes) = channel();
        let mut held = paths(of).take(MOST_FOUND).filter(|path| path.exists()).find_map(Held::new);
        let found = held.as_ref().map(|held| held.path.clone());
        let of = of.to_owned();
        let writer = std::thread::spawn(move || {
            for job in taken {
                let outcome = match job {
                    Job::Write(rig) => rig.save(&held.get_or_insert_with(|| Held::unused(&of)).path),
                    Job::Remove => held.take().map_or(Ok(()), Held::remove),
                    Job::Leave => {
                        held = None;
                        Ok(())
                    }
                };
                if answer.send(outcome).is_err() {
                    return;
                }
            }
        });
        Self {
            found,
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
        let found = Rig::load(self.found.as_ref()?);
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
            self.send(if state.1 { Job::Write(Box::new(desk.rig_to_save())) } else { Job::Remove });
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

    /// Leaves the file that was found as it is.
    pub fn leave_found(&mut self) {
        self.found = None;
        self.send(Job::Leave);
    }

    /// Removes the file and stops the writer.
    pub fn remove(mut self) -> Result<()> {
        self.send(Job::Remove);
        self.end();
        self.outcomes.try_iter().last().unwrap_or(Ok(()))
    }

    fn send(&mut self, job: Job) {
        self.busy = self.jobs.as_ref().is_some_and(|jobs| jobs.send(job).is_ok());
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

/// The autosave files beside `of`, one for each window: `NAME.autosave.toml`, `NAME.autosave.2.toml` and so on.
fn paths(of: &Path) -> impl Iterator<Item = PathBuf> {
    let others = (2..).map(|number: usize| format!("autosave.{number}.toml"));
    std::iter::once("autosave.toml".to_owned()).chain(others).map(|extension| of.with_extension(extension))
}

/// An autosave file that no other window writes, removes or offers to recover.
///
/// The lock is on a file of its own: each write replaces the autosave file, and a lock would stay with the old one.
struct Held {
    path: PathBuf,
    /// `None` where files cannot be made or locked.
    lock: Option<File>,
}

impl Held {
    /// `None` if another window holds `path`.
    fn new(path: PathBuf) -> Option<Self> {
        let lock_path = lock_path(&path);
        let open = || OpenOptions::new().write(true).create(true).truncate(false).open(&lock_path).ok();
        loop {
            let Some(lock) = open() else { return Some(Self { path, lock: None }) };
            match lock.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return None,
                Err(TryLockError::Error(_)) => return Some(Self { path, lock: None }),
            }
            // The window that held it before may have removed the file after it was opened here. A lock of the file
            // that is there now tells: it is refused if the file is the same.
            match open().map(|again| again.try_lock()) {
                Some(Ok(())) => {}
                Some(Err(_)) | None => return Some(Self { path, lock: Some(lock) }),
            }
        }
    }

    /// The first file that no window holds and no crash left.
    fn unused(of: &Path) -> Self {
        paths(of).filter(|path| !path.exists()).find_map(Self::new).expect("there are more numbers than windows")
    }

    fn remove(self) -> Result<()> {
        match std::fs::remove_file(&self.path) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io("remove", &self.path)(error)),
            _ => Ok(()),
        }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        if self.lock.is_some()
            && let Err(error) = std::fs::remove_file(lock_path(&self.path))
        {
            tracing::debug!("{}: {error}", lock_path(&self.path).display());
        }
    }
}

fn lock_path(path: &Path) -> PathBuf {
    path.with_extension("lock")
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::desk::LightEdit;
    use crate::scene::{Camera, Light, Projection};

    /// A window on a rig.
    struct Window {
        desk: Desk,
        autosave: Autosave,
    }

    impl Window {
        fn open(of: &Path) -> Self {
            let yfov = Projection::Perspective { yfov: 0.7 };
            let camera = Camera::look_at(DVec3::Z, DVec3::ZERO, DVec3::Y, yfov).unwrap();
            let rig = Rig { lights: vec![Light::point("key", DVec3::ZERO)], ..Rig::default() };
            let desk = Desk::new(rig, camera, 1.0);
            Self { autosave: Autosave::new(of, &desk), desk }
        }

        /// Edits the light, or marks it as saved, and waits until the file says so.
        fn brighten(&mut self, stops: f64) {
            self.desk.edit(LightEdit::Stops(stops));
            self.write();
        }

        fn write(&mut self) {
            self.autosave.update(&self.desk).unwrap();
            while self.autosave.busy {
                std::thread::yield_now();
                self.autosave.update(&self.desk).unwrap();
            }
        }

        fn found(&self) -> Option<f64> {
            self.autosave.found(&self.desk.rig_to_save()).map(|found| found.unwrap().lights[0].stops)
        }
    }

    fn stops(path: &Path) -> f64 {
        Rig::load(path).unwrap().lights[0].stops
    }

    fn files(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<String> = entries.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn two_windows_write_two_files() {
        let folder = tempfile::tempdir().unwrap();
        let of = folder.path().join("rig.toml");
        let files = || files(folder.path());
        let [mut first, mut second] = [Window::open(&of), Window::open(&of)];
        assert!(files().is_empty(), "an unchanged rig leaves no files");
        first.brighten(1.0);
        second.brighten(2.0);
        first.brighten(0.5);
        let both = ["rig.autosave.2.lock", "rig.autosave.2.toml", "rig.autosave.lock", "rig.autosave.toml"];
        assert_eq!(files(), both);
        let path = |name: &str| folder.path().join(name);
        assert_eq!((stops(&path("rig.autosave.toml")), stops(&path("rig.autosave.2.toml"))), (1.5, 2.0));
        assert_eq!(Window::open(&of).found(), None, "windows that are open are no crash");

        // Saving removes the window's own file only; the next edit may take any number that is free.
        first.desk.mark_saved();
        first.write();
        assert_eq!(files(), both[..2]);
        let mut third = Window::open(&of);
        third.brighten(3.0);
        first.brighten(0.25);
        assert_eq!((stops(&path("rig.autosave.toml")), stops(&path("rig.autosave.3.toml"))), (3.0, 1.75));
        for window in [third, second, first] {
            window.autosave.remove().unwrap();
        }
        assert!(files().is_empty(), "{:?}", files());
    }

    #[test]
    fn a_file_that_a_crash_left_is_offered_once_and_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let of = folder.path().join("rig.toml");
        let [mut first, mut second, mut late] = [Window::open(&of), Window::open(&of), Window::open(&of)];
        first.brighten(1.0);
        second.brighten(2.0);
        // As a crash: the lock is released, the file stays.
        drop(second);
        late.brighten(4.0);
        let path = |name: &str| folder.path().join(name);
        assert_eq!((stops(&path("rig.autosave.2.toml")), stops(&path("rig.autosave.3.toml"))), (2.0, 4.0));
        let mut next = Window::open(&of);
        assert_eq!((next.found(), Window::open(&of).found()), (Some(2.0), None));
        next.autosave.discard_found();
        next.write();
        assert!(!path("rig.autosave.2.toml").exists() && path("rig.autosave.toml").exists());
    }

    #[test]
    fn a_file_that_cannot_be_recovered_stays() {
        let folder = tempfile::tempdir().unwrap();
        let of = folder.path().join("rig.toml");
        let left = folder.path().join("rig.autosave.toml");
        std::fs::write(&left, "no rig").unwrap();
        let mut window = Window::open(&of);
        assert!(window.autosave.found(&window.desk.rig_to_save()).unwrap().is_err());
        window.autosave.leave_found();
        window.brighten(1.0);
        assert_eq!(files(folder.path()), ["rig.autosave.2.lock", "rig.autosave.2.toml", "rig.autosave.toml"]);
        window.autosave.remove().unwrap();
        assert_eq!(
            (files(folder.path()), std::fs::read_to_string(left).unwrap().as_str()),
            (vec!["rig.autosave.toml".to_owned()], "no rig")
        );
    }
}
