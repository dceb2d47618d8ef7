//! One frame of the user interface: everything over and beside the picture.

use egui::Ui;

use super::gather_marks::GatherMarks;
use super::input::action::Action;
use super::open_scene::OpenScene;
use super::overlay::{profile, times, wipe};
use super::panel::controls::{self, PANEL_WIDTH};
use super::timings::Timings;
use super::view_state::ViewState;
use super::views::{Aid, View};
use crate::gpu::Placement;

/// The state that the interface shows and changes.
pub struct Interface<'a> {
    pub open_scene: &'a mut OpenScene,
    pub view: &'a mut ViewState,
    pub timings: &'a Timings,
    /// Name of the scene.
    pub name: &'a str,
    /// Current step of the loading thread, and its progress from 0 to 1.
    pub loading: Option<(&'static str, f32)>,
    /// Time budget of a frame, milliseconds.
    pub budget_ms: f64,
    /// Position of the picture in the window.
    pub placement: Placement,
    /// Physical pixels per point.
    pub scale: f32,
}

impl Interface<'_> {
    /// Draws the interface and appends the requested actions to `actions`.
    pub fn draw(self, ui: &mut Ui, actions: &mut Vec<Action>) {
        let Self { open_scene, view, timings, name, loading, budget_ms, placement, scale } = self;
        let rig_path = open_scene.rig_path().map(ToOwned::to_owned);
        for file in ui.ctx().input(|input| input.raw.dropped_files.clone()) {
            open_scene.take_file(file.path());
        }
        if view.panel {
            let side = egui::Panel::right("panel").exact_size(PANEL_WIDTH).resizable(false);
            side.show(ui, |ui| {
                if let Some((what, share)) = loading {
                    controls::baking(ui, what, share);
                }
                controls::panel(ui, open_scene, view, name, actions)
            });
        }
        let project = |point| Some(open_scene.opened.project(placement, point)? / scale);
        if view.views.has(Aid::GatherSamples) {
            let mut marks = GatherMarks::get(open_scene.gather_marks.take(), &open_scene.opened);
            marks.draw(ui, project);
            open_scene.gather_marks = Some(marks);
        }
        if view.panel && view.views.view != View::Lights {
            let painter = ui.ctx().layer_painter(egui::LayerId::background());
            open_scene.gizmos(placement).draw(&painter, scale);
        }
        if view.views.view == View::Beauty {
            wipe::draw(ui, view, &open_scene.desk, placement, scale);
        }
        if view.show_light_view {
            let OpenScene { light_view, opened, desk, .. } = open_scene;
            light_view.show(ui, opened, desk);
        }
        let shown = open_scene.shown_camera();
        if view.show_shots {
            let OpenScene { shot_sheet, opened, .. } = &mut *open_scene;
            shot_sheet.show(ui, &mut view.show_shots, &opened.scene.cameras, shown, actions);
        }
        let folder = open_scene.folder();
        let OpenScene { map_browser, map_ball, opened, desk, .. } = open_scene;
        map_browser.show(ui, &mut view.show_maps, desk, &folder);
        if view.panel && view.views.view != View::Lights {
            let corner = egui::Pos2::new(placement.left as f32, placement.top as f32);
            let size = egui::vec2(placement.width as f32, placement.height as f32);
            let picture = egui::Rect::from_min_size(corner, size) / scale;
            let seen = picture.intersect(ui.available_rect_before_wrap());
            map_ball.show(ui, desk, view, opened.framebuffer.camera.world_from_camera, seen);
        }
        open_scene.draw_aids(ui, view, placement, scale);
        if view.overlay {
            times::draw(ui, timings, &open_scene.desk, egui::Pos2::ZERO);
        }
        if view.views.has(Aid::Profile) {
            let right = (placement.left as f32 + placement.width as f32) / scale;
            profile::draw(ui, timings, &open_scene.memory(), budget_ms, egui::Pos2::new(right, 0.0));
        }
        if view.help {
            controls::help(ui, view);
        }
        controls::dialog(ui, view, rig_path.as_deref(), actions);
    }
}

/// Draws the progress bar that precedes the first picture.
pub fn loading_bar(ui: &mut Ui, name: &str, (what, share): (&str, f32)) {
    ui.vertical_centered(|ui| {
        ui.add_space(ui.available_height() * 0.4);
        ui.heading(name);
        ui.add_space(8.0);
        ui.label(what);
        ui.add(egui::ProgressBar::new(share).desired_width(320.0).show_percentage());
    });
}
