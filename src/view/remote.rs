//! Other programs that see and edit the lights of the window.

use std::path::Path;

use serde_json::json;

use super::loading::load::{LoadEvent, Messenger};
use super::open_scene::OpenScene;
use super::view_state::ViewState;
use crate::error::Result;
use crate::wire::host::Lit;
use crate::wire::{Host, Inbound, Other, Pending, Server};

/// The window's side of the wire.
pub struct Remote {
    pub host: Host,
    /// Version of the lights in the picture, and whether that was exact.
    shown: Option<(u64, bool)>,
}

impl Remote {
    /// Listens; `file` tells other programs how to connect.
    pub fn listen(file: &Path, messenger: Messenger) -> Result<Self> {
        let server = Server::listen(file, move |inbound| _ = messenger.send(LoadEvent::Wire(inbound)))?;
        Ok(Self { host: Host::new(server), shown: None })
    }

    /// Does what another program asks. Returns its request to load the scene again.
    pub fn take(&mut self, inbound: Inbound, open_scene: Option<&mut OpenScene>, view: &ViewState) -> Option<Pending> {
        let Some(open_scene) = open_scene else {
            self.host.take(inbound, None);
            return None;
        };
        let folder = open_scene.folder();
        let (desk, scene) = open_scene.lit();
        match self.host.take(inbound, Some(Lit { desk, scene, folder: &folder }))? {
            Other::Reload(pending) => Some(pending),
            Other::Picture(pending, request) => {
                let picture = open_scene.picture(request, view);
                self.host.answer_picture(pending, picture, open_scene.desk.version());
                None
            }
        }
    }

    /// The scene will be loaded again.
    pub fn reloads(&self, pending: Pending) {
        self.host.server.answer(pending, Ok(Default::default()));
    }

    pub fn opened(&mut self, open_scene: &mut OpenScene) {
        let (size, camera) = (open_scene.picture_size(), open_scene.opened.framebuffer.camera.name.clone());
        let folder = open_scene.folder();
        let (desk, scene) = open_scene.lit();
        self.host.open(&Lit { desk, scene, folder: &folder }, size, &camera);
    }

    /// A picture is on the screen: tells what was edited, and that it is shown.
    pub fn drawn(&mut self, open_scene: &OpenScene) {
        self.host.publish(&open_scene.desk);
        let shown = (open_scene.desk.version(), !open_scene.is_coarse());
        if self.shown != Some(shown) {
            self.shown = Some(shown);
            self.host.server.inform(&json!({ "event": "shown", "version": shown.0, "exact": shown.1 }));
        }
    }

    pub fn progress(&self, what: &str, share: f32) {
        self.host.server.inform(&json!({ "event": "progress", "what": what, "share": share }));
    }
}
