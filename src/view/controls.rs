//! The panel beside the picture and the dialogs over it: the same edits as the keys make, by mouse.

use std::path::{Path, PathBuf};

use egui::{Color32, DragValue, Grid, RichText, ScrollArea, Ui};
use glam::{DVec3, Vec3};

use super::desk::{Desk, LightEdit, luminance};
use super::history::{intensity_unit, kind_name};
use super::keys::{Command, SECTIONS, STEPS_TEXT, Section};
use crate::relight::ToneMap;
use crate::scene::rig::{KELVIN, kelvin_of, kelvin_to_rgb};
use crate::scene::{Light, LightKind};

/// Points.
pub const PANEL_WIDTH: f32 = 290.0;

/// What the window shows besides the lights.
pub struct ViewState {
    /// Stops.
    pub exposure: f32,
    pub tone_map: ToneMap,
    pub one_to_one: bool,
    pub panel: bool,
    pub overlay: bool,
    pub help: bool,
    pub dialog: Option<Dialog>,
}

pub enum Dialog {
    /// The path as typed so far.
    SaveAs(String),
    /// Unsaved edits would be lost.
    Quit,
}

/// What a hand asked of the window.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Do(Command),
    SaveTo(PathBuf),
    SaveAndQuit,
    QuitUnsaved,
}

impl ViewState {
    /// Whether anything lies beside or over the picture.
    pub fn has_ui(&self) -> bool {
        self.panel || self.overlay || self.help || self.dialog.is_some()
    }
}

/// The panel: lights, the selected one's values, picture, history.
/// What is baked behind the picture, and how far it is.
pub fn baking(ui: &mut Ui, what: &str, share: f32) {
    egui::Panel::bottom("baking").show(ui, |ui| {
        ui.label(RichText::new(format!("indirect light: {what}")).small());
        ui.add(egui::ProgressBar::new(share).show_percentage());
    });
}

pub fn panel(ui: &mut Ui, desk: &mut Desk, view: &mut ViewState, scene: &str, actions: &mut Vec<Action>) {
    let mut button = |ui: &mut Ui, text: &str, command: Command, hint: &str| {
        if ui.button(text).on_hover_text(hint).clicked() {
            actions.push(Action::Do(command));
        }
    };
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        let star = if desk.history().is_unsaved() { " *" } else { "" };
        ui.label(RichText::new(format!("{scene}{star}")).strong());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            button(ui, "?", Command::Help, "every key");
            button(ui, "Save", Command::Save, "the lights as a rig file");
        });
    });
    ui.separator();
    light_list(ui, desk);
    ui.horizontal_wrapped(|ui| {
        button(ui, "+ point", Command::New(LightKind::Point), "new point light");
        button(ui, "+ spot", Command::New(LightKind::Spot), "new spot light");
        button(ui, "+ directional", Command::New(LightKind::Directional), "new directional light");
    });
    ui.horizontal(|ui| {
        ui.add_enabled_ui(desk.selected().is_some(), |ui| {
            button(ui, "Duplicate", Command::Duplicate, "the selected light once more");
            button(ui, "Delete", Command::Delete, "the selected light");
            let solo = ui.selectable_label(desk.is_solo(), "Solo").on_hover_text("the selected light alone");
            if solo.clicked() {
                desk.toggle_solo();
            }
        });
    });
    ui.separator();
    ScrollArea::vertical().max_height(ui.available_height() - 118.0).auto_shrink([false, true]).show(ui, |ui| {
        light_values(ui, desk);
    });
    ui.with_layout(egui::Layout::bottom_up(egui::Align::Min), |ui| {
        ui.add_space(4.0);
        ui.label(RichText::new(&desk.message).small());
        ui.horizontal(|ui| {
            for (text, command, name) in [("Undo", Command::Undo, 0), ("Redo", Command::Redo, 1)] {
                let name = &desk.history().names()[name];
                let shown = ui.add_enabled(name.is_some(), egui::Button::new(text));
                if shown.on_hover_text(name.as_deref().unwrap_or_default()).clicked() {
                    actions.push(Action::Do(command));
                }
            }
        });
        picture_values(ui, view, actions);
        ui.separator();
    });
}

fn light_list(ui: &mut Ui, desk: &mut Desk) {
    let row_height = ui.spacing().interact_size.y;
    let count = desk.rig().lights.len();
    if count == 0 {
        ui.label("no lights; add one:");
    }
    let list = ScrollArea::vertical().id_salt("lights").max_height(0.22 * ui.available_height());
    let list = list.auto_shrink([false, true]);
    list.show_rows(ui, row_height, count, |ui, rows| {
        for index in rows {
            let light = &desk.rig().lights[index];
            let (mut enabled, name, color) = (light.enabled, light.name.clone(), chip(light.color));
            let kind = kind_name(light.kind);
            ui.horizontal(|ui| {
                if ui.checkbox(&mut enabled, "").changed() {
                    desk.end_gesture();
                    let light = Light { enabled, ..desk.rig().lights[index].clone() };
                    desk.replace(index, light);
                }
                let (spot, _) = ui.allocate_exact_size(egui::vec2(10.0, 10.0), egui::Sense::hover());
                ui.painter().circle_filled(spot.center(), 5.0, color);
                let text = RichText::new(format!("{name}  ({kind})"));
                if ui.selectable_label(desk.selected() == Some(index), text).clicked() {
                    desk.select(index);
                }
            });
        }
    });
}

/// A light's colour at full brightness, as the display shows it.
pub fn chip(color: Vec3) -> Color32 {
    let brightest = color.max_element().max(f32::MIN_POSITIVE);
    let encode = |x: f32| (x.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8;
    let c = color / brightest;
    Color32::from_rgb(encode(c.x), encode(c.y), encode(c.z))
}

fn light_values(ui: &mut Ui, desk: &mut Desk) {
    let Some(index) = desk.selected() else {
        ui.label("no light is selected");
        return;
    };
    let mut light = desk.rig().lights[index].clone();
    let step = desk.step();
    Grid::new("light").num_columns(2).spacing([8.0, 4.0]).show(ui, |ui| {
        ui.label("name");
        // Taken over when the field is left, so that half a name is no edit.
        let id = ui.id().with(("name", index, &light.name));
        let mut name = ui.data(|data| data.get_temp::<String>(id)).unwrap_or_else(|| light.name.clone());
        let field = ui.text_edit_singleline(&mut name);
        if field.lost_focus() {
            light.name = name.replace('.', "_");
            ui.data_mut(|data| data.remove::<String>(id));
        } else if field.changed() {
            ui.data_mut(|data| data.insert_temp(id, name));
        }
        ui.end_row();

        ui.label("");
        ui.horizontal(|ui| {
            ui.checkbox(&mut light.enabled, "on");
            ui.checkbox(&mut light.shadows, "shadows");
        });
        ui.end_row();

        ui.label("intensity");
        let speed = (light.intensity * 0.01).max(1e-6);
        let unit = intensity_unit(light.kind);
        let range = 0.0..=f64::from(f32::MAX);
        ui.add(DragValue::new(&mut light.intensity).speed(speed).range(range).suffix(format!(" {unit}")));
        ui.end_row();
        ui.label("stops");
        ui.add(DragValue::new(&mut light.stops).speed(0.02).range(-60.0..=60.0).fixed_decimals(2));
        ui.end_row();

        ui.label("kelvin");
        let before = kelvin_of(light.color);
        let mut kelvin = before;
        ui.add(DragValue::new(&mut kelvin).speed(20.0).range(KELVIN).fixed_decimals(0).suffix(" K"));
        if kelvin != before {
            light.color = kelvin_to_rgb(kelvin, 0.0) * luminance(light.color);
        }
        ui.end_row();
        ui.label("colour");
        ui.horizontal(|ui| {
            let mut color = light.color.to_array();
            ui.color_edit_button_rgb(&mut color);
            for channel in &mut color {
                ui.add(DragValue::new(channel).speed(0.005).range(0.0..=1e6).max_decimals(3));
            }
            light.color = Vec3::from_array(color);
        });
        ui.end_row();

        if light.kind != LightKind::Directional {
            ui.label("position");
            vector(ui, &mut light.position, step * 0.1);
            ui.end_row();
        }
        if light.kind != LightKind::Point {
            ui.label("direction");
            let mut direction = light.direction;
            vector(ui, &mut direction, 0.005);
            if direction != light.direction
                && let Some(unit) = direction.try_normalize()
            {
                light.direction = unit;
            }
            ui.end_row();
        }
        if light.kind == LightKind::Spot {
            for (text, outer) in [("cone", true), ("inner", false)] {
                ui.label(text);
                let angle = if outer { light.outer_angle } else { light.inner_angle };
                let mut deg = angle.to_degrees();
                let most = if outer { 90.0 } else { light.outer_angle.to_degrees() };
                ui.add(DragValue::new(&mut deg).speed(0.1).range(0.0..=most).max_decimals(2).suffix("°"));
                if deg != angle.to_degrees() {
                    *(if outer { &mut light.outer_angle } else { &mut light.inner_angle }) = deg.to_radians();
                    light.inner_angle = light.inner_angle.min(light.outer_angle);
                }
                ui.end_row();
            }
        }
        ui.label("range");
        ui.horizontal(|ui| {
            let mut limited = light.range.is_some();
            ui.checkbox(&mut limited, "");
            let mut range = light.range.unwrap_or(100.0 * step);
            if limited {
                ui.add(DragValue::new(&mut range).speed(step * 0.1).range(1e-6..=1e12).max_decimals(3).suffix(" m"));
            }
            light.range = limited.then_some(range);
        });
        ui.end_row();
    });
    desk.replace(index, light);
}

fn vector(ui: &mut Ui, v: &mut DVec3, speed: f64) {
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        for x in [&mut v.x, &mut v.y, &mut v.z] {
            ui.add(DragValue::new(x).speed(speed).max_decimals(3));
        }
    });
}

fn picture_values(ui: &mut Ui, view: &mut ViewState, actions: &mut Vec<Action>) {
    ui.horizontal(|ui| {
        ui.label("exposure");
        ui.add(DragValue::new(&mut view.exposure).speed(0.02).range(-100.0..=100.0).fixed_decimals(2).suffix(" stops"));
        if ui.button("auto").on_hover_text("from the picture").clicked() {
            actions.push(Action::Do(Command::AutoExposure));
        }
    });
    ui.horizontal(|ui| {
        let tone_maps = [(ToneMap::Agx, "AgX"), (ToneMap::PbrNeutral, "Neutral"), (ToneMap::None, "none")];
        for (tone_map, text) in tone_maps {
            ui.selectable_value(&mut view.tone_map, tone_map, text);
        }
        ui.separator();
        ui.toggle_value(&mut view.one_to_one, "1:1").on_hover_text("one pixel of the picture is one of the screen");
        ui.toggle_value(&mut view.overlay, "times");
    });
}

/// Every key, from the table that binds them.
pub fn help(ui: &mut Ui, view: &mut ViewState) {
    let mut open = true;
    let room = ui.ctx().content_rect().size() - egui::vec2(48.0, 80.0);
    let window = egui::Window::new("Keys").open(&mut open).collapsible(false).resizable(false);
    window.fixed_pos([12.0, 12.0]).fixed_size(room).show(ui.ctx(), |ui| {
        ScrollArea::both().auto_shrink([true, true]).show(ui, |ui| {
            ui.spacing_mut().interact_size.y = 14.0;
            ui.horizontal_top(|ui| {
                // As many in each column as look even.
                for sections in [&SECTIONS[..2], &SECTIONS[2..3], &SECTIONS[3..]] {
                    ui.vertical(|ui| sections.iter().for_each(|section| help_section(ui, section)));
                    ui.add_space(12.0);
                }
            });
            ui.label(STEPS_TEXT);
        });
    });
    view.help &= open;
}

fn help_section(ui: &mut Ui, section: &Section) {
    ui.label(RichText::new(section.title).strong());
    Grid::new(section.title).num_columns(2).spacing([10.0, 1.0]).show(ui, |ui| {
        for binding in section.bindings {
            ui.label(RichText::new(binding.keys_text()).monospace().color(Color32::WHITE));
            ui.add(egui::Label::new(binding.text).extend());
            ui.end_row();
        }
    });
    ui.add_space(6.0);
}

/// Asks for a path, or whether edits may be lost.
pub fn dialog(ui: &mut Ui, view: &mut ViewState, rig_path: Option<&Path>, actions: &mut Vec<Action>) {
    let Some(dialog) = &mut view.dialog else { return };
    let mut close = false;
    egui::Modal::new(egui::Id::new("dialog")).show(ui.ctx(), |ui| match dialog {
        Dialog::SaveAs(path) => {
            ui.set_width(420.0);
            ui.label("Save the rig as");
            let field = ui.add(egui::TextEdit::singleline(path).desired_width(f32::INFINITY));
            let entered = field.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
            if !entered {
                field.request_focus();
            }
            ui.horizontal(|ui| {
                if (ui.button("Save").clicked() || entered) && !path.trim().is_empty() {
                    actions.push(Action::SaveTo(PathBuf::from(path.trim())));
                    close = true;
                }
                close |= ui.button("Cancel").clicked();
            });
        }
        Dialog::Quit => {
            ui.label("There are unsaved edits.");
            ui.horizontal(|ui| {
                let save = match rig_path {
                    Some(path) => format!("Save to {} and quit (S)", path.display()),
                    None => "Save as... (S)".into(),
                };
                let pressed = |ui: &Ui, key| ui.input(|input| input.key_pressed(key));
                if ui.button(save).clicked() || pressed(ui, egui::Key::S) {
                    actions.push(if rig_path.is_some() { Action::SaveAndQuit } else { Action::Do(Command::SaveAs) });
                    close = true;
                } else if ui.button("Quit without saving (Q)").clicked() || pressed(ui, egui::Key::Q) {
                    actions.push(Action::QuitUnsaved);
                    close = true;
                }
                close |= ui.button("Stay (Esc)").clicked();
            });
        }
    });
    if close {
        view.dialog = None;
    }
}

/// What a key may do while a dialog or a text field takes the others.
pub fn works_always(command: Command) -> bool {
    matches!(command, Command::Close | Command::Quit)
}

/// Whether a held key repeats its command.
pub fn repeats(command: Command) -> bool {
    match command {
        Command::Edit(edit) => !matches!(edit, LightEdit::Toggle | LightEdit::Shadows),
        Command::NextLight | Command::PreviousLight | Command::Exposure(_) | Command::Undo | Command::Redo => true,
        _ => false,
    }
}
