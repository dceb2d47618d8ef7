//! What other programs see and edit, and the scene that they changed.

use std::sync::Arc;

use serde_json::Value;

use super::OpenScene;
use crate::desk::Desk;
use crate::error::{Error, Result};
use crate::relight::{Layers, Relighter};
use crate::scene::Scene;
use crate::view::light_view::LightView;
use crate::view::loading::load::Messenger;
use crate::view::refine::converge::Converge;
use crate::view::refine::detail_control::DetailControl;
use crate::view::refine::final_gathering::FinalGathering;
use crate::view::shot_sheet::ShotSheet;
use crate::view::view_state::ViewState;
use crate::view::{LoadedScene, ViewSettings};
use crate::wire::message::PictureRequest;
use crate::wire::picture::picture;

impl OpenScene {
    /// Replaces the scene, which was loaded again or is seen from another camera; lights, history and snapshots stay.
    /// An error leaves all as it was.
    pub fn replace(&mut self, opened: LoadedScene, settings: &ViewSettings, messenger: Messenger) -> Result<()> {
        let LoadedScene { scene, framebuffer, transfer, rig, .. } = &opened;
        let wrong = |reason: String| Error::invalid("the scene that was loaded again", reason);
        let is_same = Arc::ptr_eq(scene, &self.opened.scene);
        let rig = if is_same { self.desk.rig().clone() } else { self.desk.rig_in(scene, rig).map_err(wrong)? };
        let context = self.relighter.context().clone();
        let given = scene.cameras.iter().position(|camera| camera.name == framebuffer.camera.name);
        let given = given.filter(|_| is_same).and_then(|shot| self.shot_sheet.give(shot, &opened));
        let relighter = match given {
            Some(relighter) => relighter,
            None => Relighter::new(&context, scene, framebuffer, transfer.as_ref(), &rig, &settings.pictures.relight)?,
        };
        let before = (self.shown_camera(), std::mem::replace(&mut self.relighter, relighter));
        match is_same {
            true => self.desk.look_from(framebuffer.camera.clone()),
            false => self.desk.change_scene(rig, scene, framebuffer.camera.clone()),
        }
        self.shares.invalidate();
        (self.synced_version, self.drawn, self.still) = (None, None, None);
        (self.is_refined, self.waits_for_operator) = (false, false);
        (self.shown, self.waits_for_lights) = (None, false);
        let size = [framebuffer.tiling.width, framebuffer.tiling.height];
        self.detail_control = DetailControl::new(settings.frame_budget, size);
        self.layers = Layers::All;
        self.converge = Converge::new(&context, messenger.clone(), &settings.pictures.relight, settings.rest_samples);
        self.final_gathering = FinalGathering::new(settings.final_error, messenger);
        (self.gather_marks, self.comparison_image, self.caster) = (None, None, None);
        self.light_view = LightView::default();
        let seen = std::mem::replace(&mut self.opened, opened);
        let is_complete = std::mem::take(&mut self.is_complete);
        match before {
            (Some(shot), relighter) if is_same => self.shot_sheet.keep(shot, seen, relighter, is_complete),
            _ if is_same => {}
            _ => self.shot_sheet = ShotSheet::default(),
        }
        Ok(())
    }

    /// What other programs may read and edit.
    pub fn lit(&mut self) -> (&mut Desk, &Scene) {
        (&mut self.desk, &self.opened.scene)
    }

    /// The picture of the lights as they are, for another program.
    pub fn picture(&mut self, request: PictureRequest, view: &ViewState) -> Result<Value> {
        self.sync_lights()?;
        self.layers = Layers::All;
        self.relighter.set_changes(self.final_gathering.changes())?;
        picture(&mut self.relighter, request, (view.exposure, view.curve()))
    }
}
