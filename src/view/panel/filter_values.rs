//! Filters of the selected lights: IES profile, gobo, barn doors and decay start.

use std::path::{Path, PathBuf};

use egui::{Grid, Ui};
use glam::Vec3;

use super::light_values::{Selected, color_button};
use super::map_browser::MapBrowser;
use crate::desk::{Desk, TakesMap};
use crate::scene::light_filter::{BarnDoors, SOFTNESS_DEG};
use crate::scene::{DomeMap, Light, LightKind};

/// `folder`: of the rig; file names are relative to it. `show_maps`: whether `maps` is shown.
pub fn filter_values(ui: &mut Ui, desk: &mut Desk, folder: &Path, maps: &mut MapBrowser, show_maps: &mut bool) {
    let Some(primary) = desk.selected_light() else { return };
    let mut light = primary.clone();
    let mut files = [None, None, None];
    let selected = Selected::of(desk);
    let step = desk.step();
    Grid::new("filters").num_columns(2).spacing([8.0, 4.0]).show(ui, |ui| {
        if light.kind.has_position() {
            ui.label("IES");
            let shown = light.filter.ies.as_ref().map(|ies| ies.path_from(folder));
            files[0] = file(ui, &light.name, shown, "file.ies");
            ui.end_row();
        }
        if light.kind == LightKind::Dome {
            ui.label("map");
            let shown = light.map.as_ref().and_then(DomeMap::as_file).map(|map| map.path_from(folder));
            ui.horizontal(|ui| {
                files[2] = file(ui, &light.name, shown, "sky.hdr");
                ui.toggle_value(show_maps, "maps...").on_hover_text("maps of the folder, to choose from (Ctrl+7)");
            });
            ui.end_row();
        }
        if light.kind.is_aimed() {
            ui.label("gobo");
            let shown = light.filter.gobo.as_ref().map(|gobo| gobo.image.path_from(folder));
            files[1] = file(ui, &light.name, shown, "image.png");
            ui.end_row();
            gobo(ui, &mut light);
            doors(ui, &selected, &mut light);
        }
        if light.kind.has_position() {
            ui.label("decay from");
            let field = selected.number(&mut light.decay_start, |light| light.decay_start);
            ui.add(field.speed(step * 0.01).range(0.0..=1e12).max_decimals(4).suffix(" m"));
            ui.end_row();
        }
    });
    desk.edit_primary_and_selection(light);
    let [ies, gobo, map] = files;
    let forget = |field| ui.data_mut(|data| data.remove::<String>(field));
    let mut attach = |typed: Option<Typed>, attach: fn(&mut Desk, &Path, &str)| {
        let Some(Typed { field, name }) = typed else { return };
        let before = desk.version();
        attach(desk, folder, &name);
        if desk.version() != before {
            forget(field);
        }
    };
    attach(ies, Desk::attach_profile);
    attach(gobo, Desk::attach_gobo);
    if let Some(Typed { field, name }) = map {
        let to = TakesMap::Selection(desk.selection().clone());
        if name.trim().is_empty() {
            desk.set_map(None);
            forget(field);
        } else if maps.give(folder, name.trim(), to, desk) {
            forget(field);
        }
    }
}

/// The name of a file, as typed into a field. The field keeps it until the file is attached, so that a typing error
/// can be corrected.
struct Typed {
    field: egui::Id,
    name: String,
}

/// Draws the field of a file's name. Returns what was typed once the field loses focus; empty: no file.
fn file(ui: &mut Ui, light: &str, path: Option<PathBuf>, hint: &str) -> Option<Typed> {
    let shown = path.map(|path| path.to_string_lossy().into_owned()).unwrap_or_default();
    let id = egui::Id::new((light, hint, &shown));
    let mut typed = ui.data(|data| data.get_temp::<String>(id)).unwrap_or_else(|| shown.clone());
    let color = (typed != shown).then(|| ui.visuals().warn_fg_color);
    let edit = egui::TextEdit::singleline(&mut typed).hint_text(hint).desired_width(150.0);
    let field = ui.add(edit.text_color_opt(color));
    if field.changed() {
        ui.data_mut(|data| data.insert_temp(id, typed.clone()));
    }
    (field.lost_focus() && typed != shown).then_some(Typed { field: id, name: typed })
}

fn gobo(ui: &mut Ui, light: &mut Light) {
    let Some(gobo) = &mut light.filter.gobo else { return };
    ui.label("turn, scale");
    ui.horizontal(|ui| {
        let before = gobo.rotation.to_degrees();
        let mut deg = before;
        ui.add(egui::DragValue::new(&mut deg).speed(0.5).range(-360.0..=360.0).max_decimals(1).suffix("°"));
        if deg != before {
            gobo.rotation = deg.to_radians();
        }
        ui.add(egui::DragValue::new(&mut gobo.scale).speed(0.01).range(1e-3..=1e3).max_decimals(3).prefix("x "));
        gobo.tint = Vec3::from_array(color_button(ui, gobo.tint));
    });
    ui.end_row();
}

fn doors(ui: &mut Ui, selected: &Selected, light: &mut Light) {
    ui.label("doors");
    let mut has_doors = light.filter.barn_doors.is_some();
    selected.switch(ui, &mut has_doors, "", |light| light.filter.barn_doors.is_some());
    ui.end_row();
    let closed = BarnDoors { angles: [30f64.to_radians(); 4], softness: SOFTNESS_DEG.to_radians() };
    light.filter.barn_doors = has_doors.then(|| light.filter.barn_doors.unwrap_or(closed));
    let Some(doors) = &mut light.filter.barn_doors else { return };
    let mut row = |text: &str, values: &mut [f64], range: std::ops::RangeInclusive<f64>| {
        ui.label(text);
        ui.horizontal(|ui| {
            for value in values {
                let before = value.to_degrees();
                let mut deg = before;
                ui.add(egui::DragValue::new(&mut deg).speed(0.2).range(range.clone()).max_decimals(2).suffix("°"));
                if deg != before {
                    *value = deg.to_radians();
                }
            }
        });
        ui.end_row();
    };
    let (sides, ends) = doors.angles.split_at_mut(2);
    row("left, right", sides, -90.0..=90.0);
    row("top, bottom", ends, -90.0..=90.0);
    row("soft edge", std::slice::from_mut(&mut doors.softness), 0.01..=90.0);
}
