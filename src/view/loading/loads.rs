//! A scene that is loaded, and loaded again while the old one stays.

use std::path::Path;
use std::sync::Arc;

use super::load::{Known, LoadEvent, Loading, Messenger, SceneSource};
use crate::bake::transfer::Transfer;
use crate::scene::Rig;
use crate::view::LoadedScene;

/// Which scene is loaded, and which is shown.
pub struct Loads {
    source: SceneSource,
    messenger: Messenger,
    pub thread: Loading,
    /// Number of the scene that was loaded last.
    latest: u32,
    /// Number of the scene that is shown.
    shown: Option<u32>,
    /// The camera that it was asked for.
    shown_camera: Option<String>,
    /// The scene that was loaded again: it replaces the shown one as soon as it has indirect light.
    replacement: Option<Box<LoadedScene>>,
}

/// What a message of the loading thread changes.
pub enum Change {
    /// The first scene is open.
    Open(Box<LoadedScene>),
    /// The scene was loaded again; see [`Loads::replaced`].
    Replace(Box<LoadedScene>),
    /// The shown scene has better indirect light.
    Transfer(Arc<Transfer>),
    None,
}

impl Loads {
    /// Starts to load.
    pub fn new(source: SceneSource, messenger: Messenger) -> Self {
        let thread = source.start(messenger.clone(), None);
        Self { source, messenger, thread, latest: 0, shown: None, shown_camera: None, replacement: None }
    }

    /// Starts to load again; the thread before ends.
    pub fn again(&mut self) {
        self.start(None);
    }

    /// Starts to look at the scene that is shown from another of its cameras. `rig`: the lights of all shots.
    pub fn look_from(&mut self, camera: String, opened: &LoadedScene, rig: &Rig) {
        self.source.settings.open.camera = Some(camera);
        self.start(Some(Known { scene: opened.scene.clone(), rig: rig.clone(), transfer: None }));
    }

    /// Looks from a camera whose picture is complete.
    pub fn show_complete(&mut self, seen: &LoadedScene, rig: &Rig) {
        self.source.settings.open.camera = Some(seen.framebuffer.camera.name.clone());
        self.start(Some(Known { scene: seen.scene.clone(), rig: rig.clone(), transfer: seen.transfer.clone() }));
    }

    /// Starts to bake for other cameras of the scene that is shown. Returns the number of the scene in the messages,
    /// too.
    pub fn start_shots(&self, opened: &LoadedScene, rig: &Rig, shots: Vec<usize>) -> (Loading, u32) {
        let known = Known { scene: opened.scene.clone(), rig: rig.clone(), transfer: None };
        (self.source.start_shots(&self.messenger(), &known, shots), self.latest)
    }

    fn start(&mut self, known: Option<Known>) {
        self.latest += 1;
        self.replacement = None;
        self.thread = self.source.start(self.messenger(), known);
    }

    /// The rig file that replaces the scene's lights.
    pub fn rig_path(&self) -> Option<&Path> {
        self.source.rig.as_deref()
    }

    /// The camera that is shown, or the one that is being loaded.
    pub fn camera<'a>(&'a self, opened: &'a LoadedScene) -> &'a str {
        self.source.settings.open.camera.as_deref().unwrap_or(&opened.framebuffer.camera.name)
    }

    /// Sends messages of the scene that was loaded last.
    pub fn messenger(&self) -> Messenger {
        self.messenger.of_scene(self.latest)
    }

    /// Whether `event` of a scene still means something.
    pub fn concerns(&self, scene: u32, event: &LoadEvent) -> bool {
        match event {
            LoadEvent::Wire(_) | LoadEvent::Maps(_) => true,
            LoadEvent::EdgesRefined(_) | LoadEvent::Gathered(_) => self.shown == Some(scene),
            LoadEvent::Progress { .. } | LoadEvent::Opened(_) | LoadEvent::Transfer(_) | LoadEvent::Ended(_) => {
                scene == self.latest
            }
        }
    }

    /// Whether the scene that was loaded last is shown.
    pub fn is_shown(&self) -> bool {
        self.shown == Some(self.latest)
    }

    pub fn opened(&mut self, opened: Box<LoadedScene>) -> Change {
        if self.shown.is_some() {
            self.replacement = Some(opened);
            return Change::None;
        }
        self.replaced();
        Change::Open(opened)
    }

    pub fn has_transfer(&mut self, transfer: Arc<Transfer>) -> Change {
        match self.replacement.take() {
            Some(opened) => Change::Replace(Box::new(LoadedScene { transfer: Some(transfer), ..*opened })),
            None if self.is_shown() => Change::Transfer(transfer),
            // Of a scene that did not fit the lights.
            None => Change::None,
        }
    }

    pub fn ended(&mut self, has_failed: bool) -> Change {
        if has_failed && !self.is_shown() {
            self.source.settings.open.camera.clone_from(&self.shown_camera);
        }
        let opened = self.replacement.take().filter(|_| !has_failed);
        opened.map_or(Change::None, Change::Replace) // there is no indirect light
    }

    /// The scene that was loaded last is shown now.
    pub fn replaced(&mut self) {
        self.shown = Some(self.latest);
        self.shown_camera.clone_from(&self.source.settings.open.camera);
    }
}
