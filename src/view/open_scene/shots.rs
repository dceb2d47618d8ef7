//! Pictures from other cameras of the scene.

use super::OpenScene;
use crate::error::{Error, Result};
use crate::relight::{Layers, Request, ToneMap};
use crate::view::panel::snapshots::reduced;
use crate::view::shot_sheet::{Drawn, WIDTH};

/// How the sheet shows its pictures.
pub struct ShotDisplay {
    /// Stops.
    pub exposure: f32,
    pub tone_map: ToneMap,
}

impl OpenScene {
    /// Index of the camera that is shown; `None`: it is not one of the scene's.
    pub fn shown_camera(&self) -> Option<usize> {
        let shown = &self.opened.framebuffer.camera;
        self.opened.scene.cameras.iter().position(|camera| camera.name == shown.name && camera.sees_as(shown))
    }

    /// Updates one picture of the sheet. Returns whether there was one to update.
    pub(super) fn shot_step(&mut self) -> Result<bool> {
        let Some(ShotDisplay { exposure, tone_map }) = &self.shot_display else { return Ok(false) };
        let wanted = Drawn { version: self.desk.version(), exposure: *exposure, tone_map: tone_map.clone() };
        let shown = self.shown_camera();
        // Its light images serve the picture of the window, too.
        let can_copy = !self.relighter.is_coarse() && self.layers == Layers::All;
        let Some(shot) = self.shot_sheet.next_due(&wanted, shown, can_copy) else { return Ok(false) };
        let request = Request { exposure: *exposure, tone_map: tone_map.clone(), ..Request::default() };
        if Some(shot) == shown {
            self.sync_lights()?;
            let size = self.picture_size();
            let picture = reduced(self.relighter.display(request)?, size, WIDTH);
            self.shot_sheet.drew(shot, Ok(picture), wanted);
            return Ok(true);
        }
        let name = &self.opened.scene.cameras[shot].name;
        let rig = self.desk.base().of_shot(name).map_err(|reason| Error::invalid(format!("shot {name}"), reason));
        let focus = self.desk.history().focus();
        let context = self.relighter.context().clone();
        let Some(relighter) = self.shot_sheet.relighter(shot, &context, &self.relight) else {
            self.shot_sheet.wait(shot, wanted);
            return Ok(true);
        };
        let tiling = &relighter.framebuffer().tiling;
        let size = [tiling.width, tiling.height];
        let picture = rig.and_then(|rig| {
            relighter.set_rig(&rig)?;
            relighter.select(focus);
            Ok(reduced(relighter.display(request)?, size, WIDTH))
        });
        self.shot_sheet.drew(shot, picture, wanted);
        Ok(true)
    }
}
