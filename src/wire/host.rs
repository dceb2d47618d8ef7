//! The lights as all clients see them: takes edits, and tells everyone what changed.

use std::collections::HashSet;
use std::path::Path;

use serde_json::{Value, json};

use super::message::{PictureRequest, Request};
use super::server::{Client, Inbound, Pending, Server};
use crate::desk::Desk;
use crate::error::Error;
use crate::scene::rig::diff::{diff, whole};
use crate::scene::rig::merge_patch::{Object, object, without};
use crate::scene::rig::patch::apply;
use crate::scene::rig::without_dots;
use crate::scene::{Emitters, Rig, Scene};

/// Keeps clients and a desk equal. Each version of the desk's lights is one version on the wire.
pub struct Host {
    pub server: Server,
    /// Clients that have been told of the scene, or will be once it is open.
    joined: HashSet<Client>,
    /// What clients have been told, and its version.
    published: Option<(u64, Rig)>,
    /// Edits of one client with one name are undone together, if nothing comes between them: the version after the
    /// last.
    gesture: Option<(Client, String, u64)>,
    /// What clients are told when they join, beside the lights: the scene.
    scene: Object,
    /// Whether indirect light is as good as it gets.
    is_complete: bool,
}

/// A request that the owner of the pictures answers.
pub enum Other {
    Picture(Pending, PictureRequest),
    Reload(Pending),
}

/// An open scene.
pub struct Lit<'a> {
    pub desk: &'a mut Desk,
    pub scene: &'a Scene,
    /// To which paths are relative.
    pub folder: &'a Path,
}

impl Host {
    pub fn new(server: Server) -> Self {
        Self {
            server,
            joined: HashSet::new(),
            published: None,
            gesture: None,
            scene: Object::new(),
            is_complete: false,
        }
    }

    /// Tells everyone that a scene is open, and its lights. `size`: of its pictures.
    pub fn open(&mut self, lit: &Lit, size: [u32; 2], camera: &str) {
        let path = std::path::absolute(&lit.scene.path).unwrap_or_else(|_| lit.scene.path.clone());
        self.scene = object(json!({ "scene": path.to_string_lossy(), "size": size, "camera": camera }));
        self.is_complete = false;
        self.published = Some((lit.desk.version(), lit.desk.rig().clone()));
        self.server.broadcast(&self.opened(), |client| self.joined.contains(&client));
    }

    fn opened(&self) -> Value {
        let mut event = object(json!({ "event": "opened", "complete": self.is_complete }));
        event.extend(self.scene.clone());
        if let Some((version, rig)) = &self.published {
            event.insert("version".into(), (*version).into());
            event.insert("rig".into(), whole(rig).into());
        }
        event.into()
    }

    /// Does what a client asks. `lit`: `None` while the scene loads.
    pub fn take(&mut self, inbound: Inbound, lit: Option<Lit>) -> Option<Other> {
        let (pending, request) = match inbound {
            Inbound::Joined(client) => {
                self.joined.insert(client);
                if lit.is_some() {
                    self.server.send(client, &self.opened());
                }
                return None;
            }
            Inbound::Left(client) => {
                self.joined.remove(&client);
                self.server.forget(client);
                return None;
            }
            Inbound::Request(pending, Ok(request)) => (pending, request),
            Inbound::Request(pending, Err(reason)) => {
                self.server.answer(pending, Err(reason));
                return None;
            }
        };
        let Some(Lit { desk, scene, folder }) = lit else {
            self.server.answer(pending, Err("the scene is still loading; wait for the event \"opened\"".into()));
            return None;
        };
        match request {
            Request::Hello { .. } => unreachable!("the connection answers hello"),
            Request::Rig {} => {
                self.publish(desk);
                let answer = json!({ "version": desk.version(), "rig": whole(desk.rig()) });
                self.server.answer(pending, Ok(object(answer)));
            }
            Request::Edit { rig: patch, gesture } => {
                self.publish(desk);
                let patch = with_names_of_lights(patch);
                let edited = self.edit(pending.client, patch.clone(), gesture, Lit { desk, scene, folder });
                self.answer_edit(pending, edited, &patch, desk);
            }
            Request::Undo {} | Request::Redo {} => {
                self.publish(desk);
                let before = desk.version();
                if request == (Request::Undo {}) {
                    desk.undo()
                } else {
                    desk.redo()
                }
                let done = if desk.version() == before { Err(desk.message.clone()) } else { Ok(()) };
                self.answer_edit(pending, done, &Object::new(), desk);
            }
            Request::Picture(request) => return Some(Other::Picture(pending, request)),
            Request::Reload {} => return Some(Other::Reload(pending)),
        }
        None
    }

    fn edit(&mut self, client: Client, patch: Object, gesture: Option<String>, lit: Lit) -> Result<(), String> {
        let Lit { desk, scene, folder } = lit;
        let gesture = gesture.map(|gesture| (client, gesture, desk.version()));
        if gesture.is_none() || gesture != self.gesture {
            desk.end_gesture();
        }
        let rig = apply(desk.rig(), patch, folder)?;
        rig.check_links(scene)?;
        Emitters::of(scene).check(&rig)?;
        desk.take_rig(rig)?;
        self.gesture = gesture.map(|(client, gesture, _)| (client, gesture, desk.version()));
        Ok(())
    }

    /// Answers, and tells everyone what the edit changed: its author what it has not asked for.
    fn answer_edit(&mut self, pending: Pending, done: Result<(), String>, asked: &Object, desk: &Desk) {
        let author = pending.client;
        let answer = done.map(|()| object(json!({ "version": desk.version(), "message": desk.message })));
        self.server.answer(pending, answer);
        let Some(change) = self.change(desk) else { return };
        let by = self.server.name(author);
        self.tell(desk, by.as_deref(), &change, |client| client != author);
        let rest = without(change, asked);
        if !rest.is_empty() {
            self.tell(desk, by.as_deref(), &rest, |client| client == author);
        }
    }

    /// Tells everyone what has been edited here.
    pub fn publish(&mut self, desk: &Desk) {
        if let Some(change) = self.change(desk) {
            self.tell(desk, None, &change, |_| true);
        }
    }

    /// What has changed since the last call.
    fn change(&mut self, desk: &Desk) -> Option<Object> {
        let (version, rig) = self.published.as_mut().filter(|(version, _)| *version != desk.version())?;
        let change = diff(rig, desk.rig());
        (*version, *rig) = (desk.version(), desk.rig().clone());
        Some(change).filter(|change| !change.is_empty())
    }

    /// Answers a request for a picture. `version`: of the lights that it shows.
    pub fn answer_picture(&self, pending: Pending, picture: Result<Value, Error>, version: u64) {
        let members = |picture| object(json!({ "version": version, "complete": self.is_complete, "picture": picture }));
        self.server.answer(pending, picture.map(members).map_err(|error| error.chain()));
    }

    /// Indirect light is better now; `is_complete`: as good as it gets.
    pub fn indirect(&mut self, is_complete: bool) {
        self.is_complete = is_complete;
        let event = json!({ "event": "indirect", "complete": is_complete });
        self.server.broadcast(&event, |client| self.joined.contains(&client));
    }

    /// Loading or baking failed; what is shown stays.
    pub fn failed(&self, error: &Error) {
        self.server.broadcast(&json!({ "event": "failed", "message": error.chain() }), |_| true);
    }

    fn tell(&self, desk: &Desk, by: Option<&str>, change: &Object, to: impl Fn(Client) -> bool) {
        let event = json!({
            "event": "edited", "version": desk.version(), "by": by, "message": desk.message, "rig": change,
        });
        self.server.broadcast(&event, |client| self.joined.contains(&client) && to(client));
    }
}

/// Names as the lights have them: without dots.
fn with_names_of_lights(patch: Object) -> Object {
    let renamed = |(list, changes): (String, Value)| match changes {
        Value::Object(changes) if list != "sets" => {
            let changes: Object = changes.into_iter().map(|(name, change)| (without_dots(&name), change)).collect();
            (list, changes.into())
        }
        changes => (list, changes),
    };
    patch.into_iter().map(renamed).collect()
}
