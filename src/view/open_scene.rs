//! An open scene: its desk and relighter, and the commands that act on them.

mod comparison;
mod drawing;
mod gathering;
mod mouse_edits;
mod other_programs;
mod shots;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;

use self::drawing::Shown;
use self::shots::ShotDisplay;
use super::autosave::Autosave;
use super::compare::{Comparison, ComparisonImage};
use super::gather_marks::GatherMarks;
use super::input::action::Action;
use super::input::keys::Command;
use super::input::pick::pixel;
use super::light_view::LightView;
use super::loading::load::Messenger;
use super::loading::map_answer::Answer;
use super::overlay::aids::OverlayInfo;
use super::overlay::map_ball::MapBall;
use super::panel::map_browser::MapBrowser;
use super::panel::snapshots::Thumbnail;
use super::refine::converge::Converge;
use super::refine::detail_control::DetailControl;
use super::refine::edge_refinement::EdgeRefinement;
use super::refine::final_gathering::FinalGathering;
use super::shares::Shares;
use super::shot_sheet::ShotSheet;
use super::still::Still;
use super::view_state::{Dialog, ViewState};
use super::views::View;
use super::{LoadedScene, ViewSettings};
use crate::bake::transfer::Transfer;
use crate::desk::describe::rounded;
use crate::desk::selection::Selection;
use crate::desk::{Desk, Pick};
use crate::error::Result;
use crate::gpu::{Context, PassTime, Placement};
use crate::relight::output::sheet::Grid;
use crate::relight::{Layers, RelightSettings, Relighter};
use crate::scene::rig::SLOTS;
use crate::scene::{Rig, export_gltf, usd};

/// An open scene with its desk and relighter.
pub struct OpenScene {
    pub desk: Desk,
    pub opened: LoadedScene,
    pub shares: Shares,
    /// Whether indirect light is being baked.
    pub is_baking: bool,
    /// Whether the indirect light that is shown is complete.
    pub is_complete: bool,
    relighter: Relighter,
    shows_light_view: bool,
    /// Version of the desk's lights in the relighter, and whether it was unsaved.
    synced_version: Option<(u64, bool)>,
    /// Layers that the relighter shows.
    layers: Layers,
    detail_control: DetailControl,
    converge: Converge,
    /// Whether the picture has extra samples on edges.
    is_refined: bool,
    final_gathering: FinalGathering,
    /// Version of the desk's lights in the picture.
    drawn: Option<u64>,
    /// The last picture, and how many lights it showed.
    shown: Option<(Shown, usize)>,
    /// Whether that picture stays until as many lights have images again.
    waits_for_lights: bool,
    still: Option<Still>,
    /// Whether the picture at rest stays until another operator has one as good.
    waits_for_operator: bool,
    /// Data for the aids over the picture.
    pub overlay: OverlayInfo,
    pub gather_marks: Option<GatherMarks>,
    pub thumbnails: [Option<Thumbnail>; SLOTS],
    comparison_image: Option<ComparisonImage>,
    pub light_view: LightView,
    pub map_browser: MapBrowser,
    pub map_ball: MapBall,
    pub shot_sheet: ShotSheet,
    /// `None`: the sheet is not shown.
    shot_display: Option<ShotDisplay>,
    /// The point whose shadow is being dragged, world space.
    caster: Option<DVec3>,
    relight: RelightSettings,
    autosave: Autosave,
    rig_path: Option<PathBuf>,
    suggested_path: String,
}

/// Whether the window stays open after a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    Continue,
    Quit,
}

/// Positions of the picture and the mouse, which commands may use.
#[derive(Clone, Copy)]
pub struct Pointer {
    pub placement: Placement,
    /// Mouse position, physical pixels; `None` outside the window.
    pub at: Option<[f32; 2]>,
}

impl OpenScene {
    pub fn new(
        context: &Arc<Context>,
        opened: LoadedScene,
        settings: &ViewSettings,
        messenger: Messenger,
    ) -> Result<Self> {
        let LoadedScene { scene, framebuffer, transfer, rig, .. } = &opened;
        let relighter =
            Relighter::new(context, scene, framebuffer, transfer.as_ref(), rig, &settings.pictures.relight)?;
        let desk = Desk::new(rig.clone(), framebuffer.camera.clone(), scene.space.unit);
        let suggested = scene.path.with_extension("rig.toml");
        let suggested_path = suggested.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self {
            autosave: Autosave::new(settings.rig_path.as_ref().unwrap_or(&scene.path), &desk),
            desk,
            shares: Shares::default(),
            is_baking: true,
            is_complete: false,
            relighter,
            shows_light_view: false,
            synced_version: None,
            layers: Layers::All,
            detail_control: DetailControl::new(
                settings.frame_budget,
                [framebuffer.tiling.width, framebuffer.tiling.height],
            ),
            converge: Converge::new(context, messenger.clone(), &settings.pictures.relight, settings.rest_samples),
            is_refined: false,
            final_gathering: FinalGathering::new(settings.final_error, messenger.clone()),
            drawn: None,
            shown: None,
            waits_for_lights: false,
            still: None,
            waits_for_operator: false,
            overlay: OverlayInfo::default(),
            gather_marks: None,
            thumbnails: Default::default(),
            comparison_image: None,
            light_view: LightView::default(),
            map_browser: MapBrowser::new(messenger),
            map_ball: MapBall::default(),
            shot_sheet: ShotSheet::default(),
            shot_display: None,
            relight: settings.pictures.relight.clone(),
            caster: None,
            rig_path: settings.rig_path.clone(),
            suggested_path,
            opened,
        })
    }

    /// Takes a file that the user dropped.
    pub fn take_file(&mut self, path: &Path) {
        match self.desk.takes_map(path) {
            Some(to) => _ = self.map_browser.give(Path::new(""), &path.to_string_lossy(), to, &mut self.desk),
            None => self.desk.attach(path),
        }
    }

    /// Returns width and height of the picture, pixels.
    pub fn picture_size(&self) -> [u32; 2] {
        [self.opened.framebuffer.tiling.width, self.opened.framebuffer.tiling.height]
    }

    /// Returns the folder of the rig, or of the scene if there is no rig.
    pub fn folder(&self) -> PathBuf {
        let file = self.rig_path.as_ref().unwrap_or(&self.opened.scene.path);
        file.parent().unwrap_or(Path::new("")).to_owned()
    }

    pub fn rig_path(&self) -> Option<&Path> {
        self.rig_path.as_deref()
    }

    /// Returns the pass times of the last picture.
    pub fn times(&self) -> &[PassTime] {
        self.refined().map_or(&self.relighter, |refined| refined).times()
    }

    /// Returns the relighter with extra edge samples, if it made the picture.
    fn refined(&self) -> Option<&Relighter> {
        self.converge.relighter().filter(|_| self.is_refined)
    }

    /// Accepts a bake with extra samples on edges.
    pub fn accept_refinement(&mut self, refinement: Option<EdgeRefinement>) {
        self.converge.accept(refinement, &self.opened, self.desk.rig());
    }

    /// Accepts what the thread that reads environment maps did.
    pub fn accept_maps(&mut self, answer: Answer) {
        self.map_browser.accept(answer, &mut self.desk);
    }

    /// Returns device memory by owner, bytes.
    pub fn memory(&self) -> Vec<(String, u64)> {
        self.relighter.context().memory_by_owner()
    }

    /// Updates the relighter if the lights have changed.
    fn sync_lights(&mut self) -> Result<()> {
        let version = Some((self.desk.version(), self.desk.history().is_unsaved()));
        if self.synced_version != version {
            self.relighter.set_rig(self.desk.rig())?;
            self.relighter.select(self.desk.history().focus());
            self.synced_version = version;
        }
        Ok(())
    }

    /// Replaces the indirect light.
    pub fn set_transfer(&mut self, transfer: Arc<Transfer>) -> Result<()> {
        self.shares.invalidate();
        self.comparison_image.iter_mut().for_each(ComparisonImage::invalidate);
        self.shot_sheet.forget(self.shown_camera());
        self.relighter.set_transfer(transfer.clone())?;
        self.opened.transfer = Some(transfer);
        self.final_gathering.forget_operator();
        self.waits_for_operator = self.final_gathering.catches_up() && !self.is_coarse();
        self.still = None;
        Ok(())
    }

    /// Does one short step of idle work: refines the view through the light, or measures shares. Returns whether there
    /// was work.
    pub fn idle_step(&mut self) -> Result<bool> {
        self.update_autosave();
        if self.shot_step()? {
            return Ok(true);
        }
        if self.shows_light_view
            && let Some(light) = self.desk.selected_light()
            && self.light_view.make(&self.opened, light, true)
        {
            return Ok(true);
        }
        if self.relighter.is_coarse() || self.layers != Layers::All {
            return Ok(false); // the light images are coarse or lack layers
        }
        self.sync_lights()?;
        self.shares.measure(self.desk.history().state(), &mut self.relighter)
    }

    /// Selects the light whose contact-sheet cell is under the mouse. Returns whether there is one.
    pub fn select_from_sheet(&mut self, pointer: Pointer) -> bool {
        let size = self.picture_size();
        let grid = Grid::new(self.desk.rig().lights.len(), size);
        let cell = pointer.at.and_then(|at| grid.at(pixel(pointer.placement, size, at)?));
        let light = cell.filter(|&cell| cell < self.desk.rig().lights.len());
        light.inspect(|&light| self.desk.select(Selection::only(light))).is_some()
    }

    /// Writes edits to the autosave file.
    pub(super) fn update_autosave(&mut self) {
        if let Err(error) = self.autosave.update(&self.desk) {
            self.desk.message = format!("AUTOSAVE FAILED: {}", error.chain());
        }
    }

    /// If a crash left an autosave file, asks whether to recover it.
    pub fn ask_to_recover(&mut self, view: &mut ViewState) {
        let Some(found) = self.autosave.found(&self.desk.rig_to_save()) else { return };
        let fitting = found.map_err(|error| format!("cannot be read: {}", error.chain())).and_then(|rig| {
            let fits = rig.check_links(&self.opened.scene);
            fits.map(|()| rig).map_err(|reason| format!("do not fit the scene: {reason}"))
        });
        match fitting {
            Ok(rig) => {
                self.desk.message = "unsaved edits were found".into();
                view.dialog = Some(Dialog::Recover(Box::new(rig)));
            }
            Err(reason) => {
                self.desk.message = format!("unsaved edits were found but {reason}");
                self.autosave.leave_found();
            }
        }
    }

    /// Removes the autosave file, since the window closes normally.
    pub fn close(self) -> Result<()> {
        self.autosave.remove()
    }

    pub fn act(&mut self, action: &Action, view: &mut ViewState, pointer: Pointer) -> Result<Flow> {
        self.waits_for_operator = false;
        match action {
            Action::Do(command) => return self.command(*command, view, pointer),
            Action::SaveTo(path) => {
                self.save(path.clone());
            }
            Action::SaveAndQuit => {
                let saved = self.rig_path.clone().is_some_and(|path| self.save(path));
                return Ok(if saved { Flow::Quit } else { Flow::Continue });
            }
            Action::QuitUnsaved => return Ok(Flow::Quit),
            Action::Recover(rig) => {
                self.desk.recover(Rig::clone(rig));
                self.thumbnails = Default::default();
            }
            Action::DiscardRecovery => self.autosave.discard_found(),
            Action::Drag(grab) => self.drag(*grab, pointer),
            Action::EndDrag => self.end_drag(),
            Action::EndGesture => self.desk.end_gesture(),
            Action::Show => {}
        }
        Ok(Flow::Continue)
    }

    pub fn command(&mut self, command: Command, view: &mut ViewState, pointer: Pointer) -> Result<Flow> {
        let desk = &mut self.desk;
        match command {
            Command::NextLight => desk.select_next(1),
            Command::PreviousLight => desk.select_next(-1),
            Command::Edit(edit) => desk.edit(edit),
            Command::Place => self.with_pick(pointer, Desk::place),
            Command::Aim => self.with_pick(pointer, Desk::aim),
            Command::Highlight => {
                let free = self
                    .pick(pointer)
                    .map(|at| self.opened.distance_to_surface(at.position, Desk::highlight_direction(at)));
                self.with_pick(pointer, |desk, at| desk.place_highlight(at, free.unwrap_or(f64::INFINITY)));
            }
            Command::Shadow => self.drag_shadow(pointer),
            Command::Maps => view.show_maps = !view.show_maps,
            Command::Shots => view.show_shots = !view.show_shots,
            Command::LookThrough => view.show_light_view = !view.show_light_view,
            Command::Store(slot) => self.store_snapshot(slot, view)?,
            Command::Recall(slot) => self.recall_snapshot(slot, view)?,
            Command::Wipe => self.toggle_comparison(view, Comparison::Wipe { at: 0.5 }),
            Command::Difference => self.toggle_comparison(view, Comparison::Difference),
            Command::AddNextLight => desk.add_next_to_selection(1),
            Command::AllLights => desk.select_all(),
            Command::EditGroup(edit) => desk.edit_group(edit),
            Command::EndSolo => desk.end_solo(),
            Command::Group => desk.group_selected(),
            Command::Ungroup => desk.set_group(None),
            Command::Follow => desk.follow(),
            Command::Unfollow => desk.unfollow(),
            Command::EditLinks(edit) => match pointer.at.and_then(|at| self.opened.object_at(pointer.placement, at)) {
                Some(object) => desk.edit_links(edit, object),
                None => desk.message = "there is no object with a name under the mouse".into(),
            },
            Command::SizeKeeps => desk.toggle_size_keeps(),
            Command::NextUnit => match desk.selected_light() {
                Some(light) => {
                    view.light_unit = light.unit_after(view.light_unit);
                    let symbol = view.light_unit.symbol(light.kind);
                    desk.message = format!("intensity in {symbol}");
                }
                None => desk.message = "no light is selected".into(),
            },
            Command::New(kind) => {
                let target = self.target(pointer);
                let free = self.opened.distance_to_surface(target, self.desk.offset_of_new(target).normalize());
                self.desk.add(kind, target, view.exposure, free);
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
                self.choose_exposure(view)?;
                self.desk.message = format!("exposure {} stops", rounded(f64::from(view.exposure)));
            }
            Command::ToneMap => {
                view.next_tone_map();
                desk.message = view.tone_map.to_string();
            }
            Command::Save => match self.rig_path.clone() {
                Some(path) => drop(self.save(path)),
                None => view.dialog = Some(Dialog::SaveAs(self.suggested_path.clone())),
            },
            Command::SaveAs => {
                let path = self.rig_path.as_ref().map(|path| path.display().to_string());
                view.dialog = Some(Dialog::SaveAs(path.unwrap_or_else(|| self.suggested_path.clone())));
            }
            Command::Export => {
                let path = self.opened.scene.path.with_extension("lit.glb");
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                view.dialog = Some(Dialog::SaveAs(name));
            }
            Command::Quit if desk.is_unsaved() && !matches!(view.dialog, Some(Dialog::Quit)) => {
                view.dialog = Some(Dialog::Quit);
            }
            Command::Quit => return Ok(Flow::Quit),
            Command::OneToOne => {
                view.one_to_one = !view.one_to_one;
                desk.message = if view.one_to_one { "picture 1:1" } else { "picture fitted" }.into();
            }
            Command::View(chosen) => {
                view.views.view = chosen;
                desk.message = format!("view: {}", view.views.title());
            }
            Command::NextChannel => {
                view.views.view = view.views.view.next_channel();
                desk.message = format!("view: {}", view.views.title());
            }
            Command::NextLayer => {
                let layers = self.opened.framebuffer.layers.len().max(1) as u32;
                view.views.layer = (view.views.layer + 1) % layers;
                desk.message = format!("view: {}", view.views.title());
            }
            Command::Aid(aid) => {
                view.views.toggle(aid);
                let state = if view.views.has(aid) { "on" } else { "off" };
                desk.message = format!("{} {state}", aid.name());
            }
            Command::Panel => view.panel = !view.panel,
            Command::Overlay => view.overlay = !view.overlay,
            Command::Help => view.help = !view.help,
            Command::Close if matches!(view.dialog, Some(Dialog::Recover(_))) => {} // this dialog requires an answer
            Command::Close => {
                let closes = view.dialog.take().is_some()
                    || std::mem::take(&mut view.help)
                    || std::mem::take(&mut view.show_maps)
                    || std::mem::take(&mut view.show_shots);
                if !closes {
                    view.views.view = View::Beauty;
                }
            }
            // Handled by the window.
            Command::FullScreen | Command::NextCamera | Command::PreviousCamera | Command::Camera(_) => {}
        }
        Ok(Flow::Continue)
    }

    fn with_pick(&mut self, pointer: Pointer, edit: impl FnOnce(&mut Desk, Pick)) {
        match pointer.at.and_then(|at| self.opened.pick(pointer.placement, at)) {
            Some(pick) => edit(&mut self.desk, pick),
            None => self.desk.message = "there is no surface under the mouse".into(),
        }
    }

    /// Returns the target of a new light: the surface under the mouse, else in the middle of the picture, else the
    /// middle of the scene.
    fn target(&self, pointer: Pointer) -> DVec3 {
        let under_mouse = pointer.at.and_then(|at| self.opened.pick(pointer.placement, at));
        let pick = under_mouse.or_else(|| self.opened.pick_share(0.5, 0.5));
        pick.map_or(self.opened.scene.space.origin, |pick| pick.position)
    }

    /// Saves the rig, or exports the scene if the path ends in `.glb` or `.gltf`, or its lights as UsdLux. Puts the
    /// outcome into the message and returns whether it succeeded.
    fn save(&mut self, path: PathBuf) -> bool {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        let is_gltf = matches!(extension.as_str(), "glb" | "gltf");
        if is_gltf || usd::is_usd(&path) {
            let exported = match is_gltf {
                true => export_gltf(&self.opened.scene, self.desk.base(), &path),
                false => usd::save(self.desk.base(), &path),
            };
            self.desk.message = match &exported {
                Ok(()) => format!("exported {}; Blender draws the edges of cones differently", path.display()),
                Err(error) => format!("NOT EXPORTED: {}", error.chain()),
            };
            return exported.is_ok();
        }
        match self.desk.rig_to_save().save(&path) {
            Ok(()) => {
                if self.rig_path.as_deref() != Some(&*path) {
                    let mut beside_it = Autosave::new(&path, &self.desk);
                    beside_it.leave_found();
                    if let Err(error) = std::mem::replace(&mut self.autosave, beside_it).remove() {
                        tracing::warn!("{error}");
                    }
                }
                self.desk.mark_saved();
                self.desk.message = format!("saved {}", path.display());
                self.rig_path = Some(path);
                true
            }
            Err(error) => {
                self.desk.message = format!("NOT SAVED: {}", error.chain());
                false
            }
        }
    }
}
