//! The contact sheet of shots: pictures from all cameras of the scene, beside each other, that follow the lights.

use std::sync::Arc;

use egui::{ColorImage, RichText, TextureHandle, TextureOptions, Ui};

use super::LoadedScene;
use super::input::action::Action;
use super::input::keys::Command;
use super::loading::load::{LoadEvent, Loading};
use crate::error::{Error, Result};
use crate::gpu::Context;
use crate::relight::{RelightSettings, Relighter, ToneMap};
use crate::scene::Camera;

/// Width of a picture, pixels.
pub const WIDTH: usize = 240;
/// Points that a picture takes for its frame and its name, in width and height.
const FRAME: [f32; 2] = [8.0, 28.0];

/// The sheet; its shots are the cameras of the scene, by their indices.
#[derive(Default)]
pub struct ShotSheet {
    shots: Vec<Shot>,
    /// Bakes for the shots, and the number of the scene in its messages.
    thread: Option<(Loading, u32)>,
    /// Whether its bakes have light of the sky.
    has_sky: bool,
    /// Shot whose turn it is.
    next: usize,
}

/// One camera's picture.
#[derive(Default)]
struct Shot {
    opened: Option<LoadedScene>,
    /// Whether its indirect light is complete.
    is_complete: bool,
    relighter: Option<Relighter>,
    drawn: Option<Drawn>,
    /// A picture that the interface has not taken yet.
    fresh: Option<ColorImage>,
    texture: Option<TextureHandle>,
    /// Progress of its bake, or an error.
    note: String,
}

/// What a picture shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// Version of the lights.
    pub version: u64,
    /// Stops.
    pub exposure: f32,
    pub tone_map: ToneMap,
}

impl ShotSheet {
    /// Whether bakes for it have to begin: there are none, or none with the light of the sky that `domes` need.
    pub fn is_due(&self, domes: bool) -> bool {
        self.thread.is_none() || (domes && !self.has_sky)
    }

    /// A sheet of `count` shots. `scene`: number of the scene in messages of `thread`, which bakes light of the sky if
    /// there are `domes`.
    pub fn new(count: usize, thread: Loading, scene: u32, domes: bool) -> Self {
        let shots = std::iter::repeat_with(Shot::default).take(count).collect();
        Self { shots, thread: Some((thread, scene)), has_sky: domes, next: 0 }
    }

    /// Takes a message of the thread; `scene` is its number.
    pub fn take(&mut self, shot: usize, scene: u32, event: LoadEvent) -> Result<()> {
        if self.thread.as_ref().is_none_or(|(_, number)| *number != scene) {
            return Ok(());
        }
        let shot = &mut self.shots[shot];
        if shot.is_complete {
            return Ok(()); // the window baked for it meanwhile
        }
        match event {
            LoadEvent::Progress { what, share } => shot.note = format!("{what} {:.0} %", 100.0 * share),
            LoadEvent::Opened(opened) => (shot.opened, shot.relighter, shot.drawn) = (Some(*opened), None, None),
            LoadEvent::Transfer(transfer) => {
                if let Some(opened) = &mut shot.opened {
                    opened.transfer = Some(transfer.clone());
                    shot.drawn = None;
                    shot.relighter.as_mut().map_or(Ok(()), |relighter| relighter.set_transfer(transfer))?;
                }
            }
            LoadEvent::Ended(Ok(())) => {
                shot.is_complete = true;
                shot.note.clear();
            }
            LoadEvent::Ended(Err(error)) => shot.note = error.chain(),
            _ => unreachable!("other messages are of the shown camera"),
        }
        Ok(())
    }

    /// What is known of a shot once its indirect light is complete.
    pub fn complete(&self, shot: usize) -> Option<&LoadedScene> {
        self.shots.get(shot).filter(|shot| shot.is_complete)?.opened.as_ref()
    }

    /// The next shot whose picture does not show `wanted`. `shown`: the camera of the window, if its picture may be
    /// used.
    pub fn next_due(&mut self, wanted: &Drawn, shown: Option<usize>, can_copy: bool) -> Option<usize> {
        let count = self.shots.len();
        let is_due = |&at: &usize| {
            let shot = &self.shots[at];
            let is_there = if Some(at) == shown { can_copy } else { shot.opened.is_some() };
            is_there && shot.drawn.as_ref() != Some(wanted)
        };
        let due = (0..count).map(|turn| (self.next + turn) % count).find(is_due)?;
        self.next = due + 1;
        Some(due)
    }

    /// Makes the relighter of a shot, unless it has one. Without one, the error is the shot's note.
    pub fn relighter(
        &mut self,
        shot: usize,
        context: &Arc<Context>,
        settings: &RelightSettings,
    ) -> Option<&mut Relighter> {
        let shot = &mut self.shots[shot];
        let opened = shot.opened.as_ref()?;
        if shot.relighter.is_none() {
            let LoadedScene { scene, framebuffer, transfer, rig, .. } = opened;
            match Relighter::new(context, scene, framebuffer, transfer.as_ref(), rig, settings) {
                Ok(relighter) => shot.relighter = Some(relighter),
                Err(error) => shot.note = error.chain(),
            }
        }
        shot.relighter.as_mut()
    }

    /// A shot has a new picture; without one its note tells why.
    pub fn drew(&mut self, shot: usize, picture: Result<ColorImage, Error>, drawn: Drawn) {
        let shot = &mut self.shots[shot];
        shot.drawn = Some(drawn);
        match picture {
            Ok(picture) => {
                shot.fresh = Some(picture);
                if shot.is_complete {
                    shot.note.clear();
                }
            }
            Err(error) => shot.note = error.chain(),
        }
    }

    /// The picture of a shot has to be made again.
    pub fn forget(&mut self, shot: Option<usize>) {
        if let Some(shot) = shot.and_then(|shot| self.shots.get_mut(shot)) {
            shot.drawn = None;
        }
    }

    /// A shot can have no picture of these lights.
    pub fn wait(&mut self, shot: usize, drawn: Drawn) {
        self.shots[shot].drawn = Some(drawn);
    }

    /// Gives the relighter of a shot to the window if it is of `opened`.
    pub fn give(&mut self, shot: usize, opened: &LoadedScene) -> Option<Relighter> {
        let shot = self.shots.get_mut(shot)?;
        let of = shot.opened.as_ref()?;
        let is_same = Arc::ptr_eq(&of.framebuffer, &opened.framebuffer) && of.has(&opened.transfer);
        shot.relighter.take_if(|_| is_same)
    }

    /// Takes what the window showed before it looked from another camera.
    pub fn keep(&mut self, shot: usize, opened: LoadedScene, relighter: Relighter, is_complete: bool) {
        if let Some(shot) = self.shots.get_mut(shot) {
            (shot.opened, shot.relighter, shot.is_complete) = (Some(opened), Some(relighter), is_complete);
        }
    }

    /// Draws the window; a click on a picture looks from its camera.
    pub fn show(
        &mut self,
        ui: &Ui,
        open: &mut bool,
        cameras: &[Camera],
        shown: Option<usize>,
        actions: &mut Vec<Action>,
    ) {
        let rows = cameras.len().div_ceil(3) as f32 * (0.7 * WIDTH as f32 + FRAME[1]) + 24.0;
        let size =
            egui::vec2(3.0 * (WIDTH as f32 + 2.0 * FRAME[0]) + 16.0, rows.min(ui.ctx().content_rect().height() - 80.0));
        let window = egui::Window::new("Shots").open(open).default_pos([12.0, 12.0]).default_size(size);
        window.vscroll(true).show(ui.ctx(), |ui| {
            ui.horizontal_wrapped(|ui| {
                for (at, (shot, camera)) in self.shots.iter_mut().zip(cameras).enumerate() {
                    if shot.show(ui, camera, shown == Some(at)) {
                        actions.push(Action::Do(Command::Camera(at)));
                    }
                }
            });
        });
    }
}

impl Shot {
    /// Draws the picture and the camera's name. Returns whether it was clicked.
    fn show(&mut self, ui: &mut Ui, camera: &Camera, is_shown: bool) -> bool {
        if let Some(picture) = self.fresh.take() {
            match &mut self.texture {
                Some(texture) => texture.set(picture, TextureOptions::LINEAR),
                None => self.texture = Some(ui.ctx().load_texture("shot", picture, TextureOptions::LINEAR)),
            }
        }
        let width = WIDTH as f32;
        let height = self.texture.as_ref().map_or(0.66 * width, |texture| texture.size_vec2().y);
        // The size decides whether it is still in this row.
        let inner = ui.allocate_ui(egui::vec2(width + FRAME[0], height + FRAME[1]), |ui| {
            ui.vertical(|ui| {
                let button = match &self.texture {
                    Some(texture) => egui::Button::image(egui::Image::new(texture).max_width(width)),
                    None => egui::Button::new("").min_size(egui::vec2(width, height)),
                };
                let name = if is_shown { RichText::new(&camera.name).strong() } else { RichText::new(&camera.name) };
                let clicked = ui.add(button.selected(is_shown)).on_hover_text("look from this camera").clicked();
                ui.horizontal(|ui| {
                    ui.label(name.small());
                    ui.label(RichText::new(&self.note).small().weak());
                });
                clicked
            })
        });
        inner.inner.inner
    }
}
