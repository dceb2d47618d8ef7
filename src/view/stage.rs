//! A scene in its window: desk, relighter, and what commands do to them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;

use super::Opened;
use super::controls::{Action, Dialog, ViewState};
use super::describe::rounded;
use super::desk::{Desk, Pick};
use super::keys::Command;
use super::shares::Shares;
use crate::bake::transfer::baked::BakedTransfer;
use crate::error::Result;
use crate::gpu::{Context, PassTime, Placement, Screen};
use crate::relight::{Picture, RelightSettings, Relighter, ToneMap, exposure};

pub struct Stage {
    pub desk: Desk,
    pub opened: Opened,
    pub shares: Shares,
    relighter: Relighter,
    /// The version of the desk's lights that the relighter has, and whether it was unsaved.
    taken: Option<(u64, bool)>,
    rig_path: Option<PathBuf>,
    suggested_path: String,
}

/// Whether the window goes on after a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Then {
    Continue,
    Quit,
}

/// What a command may depend on besides the lights.
#[derive(Clone, Copy)]
pub struct Pointer {
    pub placement: Placement,
    /// Physical pixels; `None` outside of the window.
    pub at: Option<[f32; 2]>,
}

impl Stage {
    pub fn new(
        context: &Arc<Context>,
        opened: Opened,
        rig_path: Option<PathBuf>,
        settings: &RelightSettings,
    ) -> Result<Self> {
        let Opened { scene, bvh, baked, camera, rig } = &opened;
        let relighter = Relighter::new(context, scene, bvh, baked, rig, settings)?;
        let desk = Desk::new(rig.clone(), camera.clone(), f64::from(bvh.radius));
        let suggested = scene.path.with_extension("rig.toml");
        let suggested_path = suggested.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { desk, shares: Shares::default(), relighter, taken: None, rig_path, suggested_path, opened })
    }

    /// Pixels.
    pub fn picture_size(&self) -> [u32; 2] {
        [self.opened.baked.tiling.width, self.opened.baked.tiling.height]
    }

    pub fn rig_path(&self) -> Option<&Path> {
        self.rig_path.as_deref()
    }

    /// What the passes of the last picture took.
    pub fn times(&self) -> &[PassTime] {
        self.relighter.times()
    }

    /// Hands the lights to the relighter.
    fn take_lights(&mut self) -> Result<()> {
        let version = Some((self.desk.version(), self.desk.history().is_unsaved()));
        if self.taken != version {
            self.relighter.set_rig(self.desk.rig())?;
            self.relighter.select(self.desk.history().focus());
            self.taken = version;
        }
        Ok(())
    }

    /// Indirect light takes the place of what there was.
    pub fn refine(&mut self, transfer: BakedTransfer) -> Result<()> {
        self.shares.forget();
        self.relighter.set_transfer(transfer)
    }

    /// What is worth a look only while the hand rests: a little of it. Returns whether there was anything to do.
    pub fn rest(&mut self) -> Result<bool> {
        self.take_lights()?;
        self.shares.measure(self.desk.history().state(), &mut self.relighter)
    }

    pub fn draw(&mut self, view: &ViewState, screen: Screen) -> Result<()> {
        self.take_lights()?;
        self.relighter.set_tone_map(view.tone_map);
        self.relighter.show(Picture::Whole, view.exposure, screen)
    }

    /// Stops that suit the lights as they are.
    pub fn automatic_exposure(&mut self) -> Result<f32> {
        self.take_lights()?;
        Ok(exposure::automatic(self.relighter.linear(Picture::Whole)?))
    }

    pub fn act(&mut self, action: &Action, view: &mut ViewState, pointer: Pointer) -> Result<Then> {
        match action {
            Action::Do(command) => return self.command(*command, view, pointer),
            Action::SaveTo(path) => {
                self.save(path.clone());
            }
            Action::SaveAndQuit => {
                let saved = self.rig_path.clone().is_some_and(|path| self.save(path));
                return Ok(if saved { Then::Quit } else { Then::Continue });
            }
            Action::QuitUnsaved => return Ok(Then::Quit),
        }
        Ok(Then::Continue)
    }

    pub fn command(&mut self, command: Command, view: &mut ViewState, pointer: Pointer) -> Result<Then> {
        let desk = &mut self.desk;
        match command {
            Command::NextLight => desk.select_next(1),
            Command::PreviousLight => desk.select_next(-1),
            Command::Edit(edit) => desk.edit(edit),
            Command::Place => self.with_pick(pointer, Desk::place),
            Command::Aim => self.with_pick(pointer, Desk::aim),
            Command::NextLightToo => desk.select_next_too(1),
            Command::AllLights => desk.select_all(),
            Command::EditGroup(edit) => desk.edit_group(edit),
            Command::EndSolo => desk.end_solo(),
            Command::Group => desk.group_selected(),
            Command::Ungroup => desk.set_group(None),
            Command::Link => desk.link(),
            Command::Unlink => desk.unlink(),
            Command::New(kind) => {
                let target = self.target(pointer);
                self.desk.add(kind, target, view.exposure);
            }
            Command::Duplicate => desk.duplicate(),
            Command::Delete => desk.delete(),
            Command::Undo => desk.undo(),
            Command::Redo => desk.redo(),
            Command::Exposure(by) => {
                view.exposure = (view.exposure + by).clamp(-100.0, 100.0);
                desk.message = format!("exposure {} stops", rounded(f64::from(view.exposure)));
            }
            Command::AutoExposure => {
                view.exposure = self.automatic_exposure()?;
                self.desk.message = format!("exposure {} stops", rounded(f64::from(view.exposure)));
            }
            Command::ToneMap => {
                view.tone_map = match view.tone_map {
                    ToneMap::Agx => ToneMap::PbrNeutral,
                    ToneMap::PbrNeutral => ToneMap::None,
                    ToneMap::None => ToneMap::Agx,
                };
                desk.message = format!("tone curve {:?}", view.tone_map);
            }
            Command::Save => match self.rig_path.clone() {
                Some(path) => drop(self.save(path)),
                None => view.dialog = Some(Dialog::SaveAs(self.suggested_path.clone())),
            },
            Command::SaveAs => {
                let path = self.rig_path.as_ref().map(|path| path.display().to_string());
                view.dialog = Some(Dialog::SaveAs(path.unwrap_or_else(|| self.suggested_path.clone())));
            }
            Command::Quit if desk.history().is_unsaved() && !matches!(view.dialog, Some(Dialog::Quit)) => {
                view.dialog = Some(Dialog::Quit);
            }
            Command::Quit => return Ok(Then::Quit),
            Command::OneToOne => {
                view.one_to_one = !view.one_to_one;
                desk.message = if view.one_to_one { "picture 1:1" } else { "picture fitted" }.into();
            }
            Command::Panel => view.panel = !view.panel,
            Command::Overlay => view.overlay = !view.overlay,
            Command::Help => view.help = !view.help,
            Command::Close => {
                if view.dialog.take().is_none() {
                    view.help = false;
                }
            }
            Command::FullScreen => {} // the window's own
        }
        Ok(Then::Continue)
    }

    fn with_pick(&mut self, pointer: Pointer, edit: impl FnOnce(&mut Desk, Pick)) {
        match pointer.at.and_then(|at| self.opened.pick(pointer.placement, at)) {
            Some(pick) => edit(&mut self.desk, pick),
            None => self.desk.message = "there is no surface under the mouse".into(),
        }
    }

    /// What a new light shines at: what the mouse points at, else the middle of the picture, else of the scene.
    fn target(&self, pointer: Pointer) -> DVec3 {
        let under_mouse = pointer.at.and_then(|at| self.opened.pick(pointer.placement, at));
        let pick = under_mouse.or_else(|| self.opened.pick_share(0.5, 0.5));
        pick.map_or(self.opened.scene.origin, |pick| pick.position)
    }

    /// Writes the rig; a failure is told, and nothing is lost.
    fn save(&mut self, path: PathBuf) -> bool {
        match self.desk.rig().save(&path) {
            Ok(()) => {
                self.desk.mark_saved();
                self.desk.message = format!("saved {}", path.display());
                self.rig_path = Some(path);
                true
            }
            Err(error) => {
                let cause = std::error::Error::source(&error).map(|cause| format!(": {cause}"));
                self.desk.message = format!("NOT SAVED: {error}{}", cause.unwrap_or_default());
                false
            }
        }
    }
}
