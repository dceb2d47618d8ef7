//! The lighting desk without a window: other programs edit the lights and get pictures as answers.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::channel;

use serde_json::json;

use super::loading::load::{LoadEvent, Messenger, Numbered, SceneSource};
use super::loading::loads::{Change, Loads};
use super::{LoadedScene, PictureSettings};
use crate::desk::Desk;
use crate::error::{Error, Result};
use crate::gpu::Context;
use crate::relight::choose_device;
use crate::relight::output::exposure;
use crate::relight::{Picture, Relighter};
use crate::scene::Rig;
use crate::scene::rig::merge_patch::Object;
use crate::trace::bvh::TracedScene;
use crate::wire::host::Lit;
use crate::wire::picture::picture;
use crate::wire::{Host, Inbound, Other, Server};

/// Serves a scene. `listen`: file that tells other programs how to connect, served without end; `None`: one program, on
/// standard input and output, until it leaves. Fails if the scene cannot be loaded.
pub fn serve(settings: PictureSettings, listen: Option<&Path>, source: SceneSource) -> Result<()> {
    let (sender, messages) = channel::<Numbered>();
    let messenger = Messenger::new(move |message| sender.send(message).is_ok());
    let inbound = messenger.clone();
    let on = move |message| _ = inbound.send(LoadEvent::Wire(message));
    let server = match listen {
        Some(file) => Server::listen(file, on)?,
        None => Server::on_standard_streams(on),
    };
    let context = Context::new(
        choose_device(settings.device.as_deref(), settings.cache_dir.as_deref())?.as_deref(),
        settings.validation,
        settings.cache_dir.as_deref(),
    )?;
    let loads = Loads::new(source, messenger);
    let mut served = Served { host: Host::new(server), settings, context, loads, open: None };
    for Numbered { scene, event, .. } in messages {
        let has_left = matches!(event, LoadEvent::Wire(Inbound::Left(_))) && listen.is_none();
        if has_left {
            break;
        }
        if served.loads.concerns(scene, &event) {
            served.take(event)?;
        }
    }
    Ok(())
}

struct Served {
    host: Host,
    settings: PictureSettings,
    context: Arc<Context>,
    loads: Loads,
    open: Option<Open>,
}

/// An open scene.
struct Open {
    desk: Desk,
    scene: Arc<TracedScene>,
    relighter: Relighter,
    /// To which paths are relative.
    folder: PathBuf,
    /// Stops, unless a request names others.
    exposure: f32,
}

impl Served {
    fn take(&mut self, event: LoadEvent) -> Result<()> {
        match event {
            LoadEvent::Progress { what, share } => {
                self.host.server.inform(&json!({ "event": "progress", "what": what, "share": share }));
            }
            LoadEvent::Opened(opened) => {
                let change = self.loads.opened(opened);
                self.change(change)?;
            }
            LoadEvent::Transfer(transfer) => {
                let change = self.loads.has_transfer(transfer);
                self.change(change)?;
                self.tell_indirect(false);
            }
            LoadEvent::Ended(outcome) => {
                let change = self.loads.ended(outcome.is_err());
                self.change(change)?;
                match outcome {
                    Ok(()) => self.tell_indirect(true),
                    Err(error) if self.open.is_none() => return Err(error),
                    Err(error) => self.host.failed(&error),
                }
            }
            LoadEvent::Wire(inbound) => self.answer(inbound)?,
            LoadEvent::EdgesRefined(_) | LoadEvent::Gathered(_) | LoadEvent::Maps(_) => {
                unreachable!("only windows ask for these")
            }
        }
        Ok(())
    }

    fn change(&mut self, change: Change) -> Result<()> {
        match (change, &mut self.open) {
            (Change::Open(opened), _) => {
                let desk = Desk::new(opened.rig.clone(), opened.framebuffer.camera.clone(), opened.scene.space.unit);
                let mut relighter = self.relighter(&opened, desk.rig())?;
                let exposure = match self.settings.exposure {
                    Some(stops) => stops,
                    None => exposure::automatic(relighter.linear(Picture::Whole)?),
                };
                let of = self.loads.rig_path().unwrap_or(&opened.scene.path);
                let folder = of.parent().unwrap_or(Path::new("")).to_owned();
                let scene = opened.scene.clone();
                self.open = Some(Open { desk, scene, relighter, folder, exposure });
                self.tell_opened();
            }
            (Change::Replace(opened), Some(_)) => match self.replace(&opened) {
                Ok(()) => {
                    self.loads.replaced();
                    self.tell_opened();
                }
                Err(error) => self.host.failed(&error),
            },
            (Change::Transfer(transfer), Some(open)) => open.relighter.set_transfer(transfer)?,
            (Change::Replace(_) | Change::Transfer(_), None) | (Change::None, _) => {}
        }
        Ok(())
    }

    fn relighter(&self, opened: &LoadedScene, rig: &Rig) -> Result<Relighter> {
        let LoadedScene { scene, framebuffer, transfer, .. } = opened;
        Relighter::new(&self.context, scene, framebuffer, transfer.as_ref(), rig, &self.settings.relight)
    }

    /// An error leaves the scene as it was.
    fn replace(&mut self, opened: &LoadedScene) -> Result<()> {
        let open = self.open.as_ref().expect("a scene is open");
        let wrong = |reason: String| Error::invalid("the scene that was loaded again", reason);
        let rig = open.desk.rig_in(&opened.scene, &opened.rig).map_err(wrong)?;
        let relighter = self.relighter(opened, &rig)?;
        let open = self.open.as_mut().expect("a scene is open");
        open.desk.change_scene(rig, &opened.scene, opened.framebuffer.camera.clone());
        (open.scene, open.relighter) = (opened.scene.clone(), relighter);
        Ok(())
    }

    fn tell_opened(&mut self) {
        let Some(Open { desk, scene, relighter, folder, .. }) = &mut self.open else { return };
        let framebuffer = relighter.framebuffer();
        let size = [framebuffer.tiling.width, framebuffer.tiling.height];
        self.host.open(&Lit { desk, scene, folder }, size, &framebuffer.camera.name);
    }

    fn tell_indirect(&mut self, is_complete: bool) {
        if self.loads.is_shown() {
            self.host.indirect(is_complete);
        }
    }

    fn answer(&mut self, inbound: Inbound) -> Result<()> {
        let Some(open) = &mut self.open else {
            self.host.take(inbound, None);
            return Ok(());
        };
        let Open { desk, scene, folder, .. } = open;
        match self.host.take(inbound, Some(Lit { desk, scene, folder })) {
            None => {}
            Some(Other::Reload(pending)) => {
                self.loads.again();
                self.host.server.answer(pending, Ok(Object::new()));
            }
            Some(Other::Picture(pending, request)) => {
                let shown = (open.exposure, self.settings.tone_map.clone());
                let picture = open.relighter.set_rig(open.desk.rig()).and_then(|()| {
                    open.relighter.select(open.desk.history().focus());
                    picture(&mut open.relighter, request, shown)
                });
                self.host.answer_picture(pending, picture, open.desk.version());
            }
        }
        // A dome is new to a bake that had none.
        if open.desk.rig().has_domes()
            && let Some(first_dome) = self.loads.thread.first_dome.take()
        {
            let _ = first_dome.send(()); // fails if the thread has ended: there is no indirect light
        }
        Ok(())
    }
}
