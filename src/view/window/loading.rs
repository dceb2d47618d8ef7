//! What the loading thread makes, and the scene loaded again.

use std::sync::Arc;

use winit::event_loop::ActiveEventLoop;

use super::App;
use crate::error::{Error, Result};
use crate::view::LoadedScene;
use crate::view::loading::loads::Change;
use crate::view::open_scene::Flow;
use crate::view::shot_sheet::ShotSheet;

impl App {
    /// Loads the scene's file again, while the old picture stays.
    pub(super) fn reload(&mut self) {
        self.loads.again();
        self.loading = Some(("loading", 0.0));
        if let Some(open_scene) = &mut self.open_scene {
            open_scene.is_baking = true;
            open_scene.desk.message = "loading the scene again".into();
        }
    }

    /// Looks from the camera that is `step` further in the scene.
    pub(super) fn step_camera(&mut self, step: isize) {
        let Some(open_scene) = &mut self.open_scene else { return };
        let cameras = &open_scene.opened.scene.cameras;
        let shown = cameras.iter().position(|camera| camera.name == self.loads.camera(&open_scene.opened));
        let next = match shown {
            Some(shown) => (shown as isize + step).rem_euclid(cameras.len() as isize) as usize,
            None => 0, // a rig's camera is shown
        };
        if cameras.is_empty() || shown == Some(next) {
            open_scene.desk.message = "the scene has no other camera".into();
            return;
        }
        self.look_from(next);
    }

    /// Looks from another camera of the scene: at once if its picture is in the sheet of shots, else the old picture
    /// stays until there is one.
    pub(super) fn look_from(&mut self, camera: usize) {
        let Some(open_scene) = &mut self.open_scene else { return };
        let name = open_scene.opened.scene.cameras[camera].name.clone();
        let is_wanted = self.loads.camera(&open_scene.opened) == name;
        if is_wanted && (open_scene.is_baking || open_scene.shown_camera() == Some(camera)) {
            return;
        }
        open_scene.desk.message = format!("camera {name}");
        let domes = open_scene.desk.rig().has_domes();
        let has_all =
            |seen: &&LoadedScene| !domes || seen.transfer.as_ref().is_none_or(|transfer| transfer.sky.is_some());
        let complete =
            open_scene.shot_sheet.complete(camera).filter(has_all).filter(|_| !open_scene.is_baking).cloned();
        self.loading = Some(("loading", 0.0));
        match complete {
            Some(opened) => {
                self.loads.show_complete(&opened, open_scene.desk.base());
                self.replace(opened);
                self.open_scene.iter_mut().for_each(|open_scene| open_scene.is_complete = true);
            }
            None => {
                open_scene.is_baking = true;
                self.loads.look_from(name, &open_scene.opened, open_scene.desk.base());
            }
        }
    }

    /// Bakes for all cameras once their sheet is shown and nothing else bakes.
    pub(super) fn start_shots(&mut self) {
        let Some(open_scene) = &mut self.open_scene else { return };
        let domes = open_scene.desk.rig().has_domes();
        if !self.view.show_shots || open_scene.is_baking || !open_scene.shot_sheet.is_due(domes) {
            return;
        }
        let count = open_scene.opened.scene.cameras.len();
        let others = (0..count).filter(|camera| Some(*camera) != open_scene.shown_camera()).collect();
        let (thread, scene) = self.loads.start_shots(&open_scene.opened, open_scene.desk.base(), others);
        open_scene.shot_sheet = ShotSheet::new(count, thread, scene, domes);
    }

    /// Replaces the open scene by the one that was loaded again. If that fails, the old one stays.
    pub(super) fn replace(&mut self, opened: LoadedScene) {
        let (Some(open_scene), Some(graphics)) = (&mut self.open_scene, &self.graphics) else { return };
        let changed = opened.changed.as_ref().map(|changed| format!(", baked again: {changed} changed"));
        let message = match Arc::ptr_eq(&opened.scene, &open_scene.opened.scene) {
            true => format!("camera {}", opened.framebuffer.camera.name),
            false => format!("the scene was loaded again{}", changed.unwrap_or_default()),
        };
        let size = open_scene.picture_size();
        match open_scene.replace(opened, &self.settings, self.loads.messenger()) {
            Ok(()) => {
                self.loads.replaced();
                if open_scene.picture_size() != size {
                    graphics.make_room(open_scene.picture_size());
                }
                open_scene.desk.message = message;
                if let Some(remote) = &mut self.remote {
                    remote.opened(open_scene);
                }
            }
            Err(error) => self.reload_failed(&error),
        }
        self.stale = true;
    }

    pub(super) fn reload_failed(&mut self, error: &Error) {
        if let Some(open_scene) = &mut self.open_scene {
            open_scene.desk.message = format!("the scene stays as it is: {}", error.chain());
        }
        if let Some(remote) = &self.remote {
            remote.host.failed(error);
        }
    }

    /// Shows what the loading thread has made.
    pub(super) fn change(&mut self, change: Change, event_loop: &ActiveEventLoop) {
        let outcome = match (change, &mut self.open_scene) {
            (Change::Open(opened), _) => self.open(*opened),
            (Change::Replace(opened), _) => {
                self.replace(*opened);
                Ok(())
            }
            (Change::Transfer(transfer), Some(open_scene)) => open_scene.set_transfer(transfer),
            (Change::Transfer(_), None) | (Change::None, _) => Ok(()),
        };
        self.stale = true;
        self.check(outcome.map(|()| Flow::Continue), event_loop);
    }

    pub(super) fn loading_ended(&mut self, outcome: Result<()>, event_loop: &ActiveEventLoop) {
        self.loading = None;
        let change = self.loads.ended(outcome.is_err());
        self.change(change, event_loop);
        let is_shown = self.loads.is_shown();
        let Some(open_scene) = &mut self.open_scene else {
            return self.check(outcome.map(|()| Flow::Continue), event_loop);
        };
        open_scene.is_baking = false;
        open_scene.is_complete |= is_shown && outcome.is_ok();
        match outcome {
            Ok(()) if is_shown => self.remote.iter_mut().for_each(|remote| remote.host.indirect(true)),
            Ok(()) => {}
            Err(error) if is_shown => {
                // Direct light can still be edited.
                let what = match open_scene.opened.transfer {
                    Some(_) => "indirect light stays as it is",
                    None => "no indirect light",
                };
                open_scene.desk.message = format!("{what}: {}", error.chain());
                self.remote.iter().for_each(|remote| remote.host.failed(&error));
            }
            Err(error) => self.reload_failed(&error),
        }
    }
}
