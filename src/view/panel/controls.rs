//! The panel beside the picture and the dialogs over it. Every edit by a key is also possible here with the mouse.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use egui::{Color32, DragValue, Grid, Key, Modifiers, RichText, ScrollArea, Ui};

use super::filter_values::filter_values;
use super::light_values::light_values;
use super::lights_list::lights_list;
use super::linking_values::linking_values;
use super::map_browser::MapBrowser;
use super::shots::shots;
use super::snapshots::snapshots;
use super::view_menu::view_menu;
use crate::desk::{Desk, GroupEdit, LightEdit};
use crate::relight::ToneMap;
use crate::scene::{LightKind, Links};
use crate::view::input::action::Action;
use crate::view::input::keys::{self, Command, SECTIONS, STEPS_TEXT, Section};
use crate::view::open_scene::OpenScene;
use crate::view::view_state::{Dialog, Displays, ViewState};

/// Width of the panel, points.
pub const PANEL_WIDTH: f32 = 290.0;

/// Draws the progress of a bake in the background; `share` is from 0 to 1.
pub fn baking(ui: &mut Ui, what: &str, share: f32) {
    egui::Panel::bottom("baking").show(ui, |ui| {
        ui.label(RichText::new(format!("indirect light: {what}")).small());
        ui.add(egui::ProgressBar::new(share).show_percentage());
    });
}

/// Draws the panel: lights, values of the selected lights, snapshots, history, picture.
pub fn panel(ui: &mut Ui, open_scene: &mut OpenScene, view: &mut ViewState, scene: &str, actions: &mut Vec<Action>) {
    let folder = open_scene.folder();
    let OpenScene { desk, shares, thumbnails, map_browser, opened, .. } = open_scene;
    let mut button = |ui: &mut Ui, text: &str, command: Command, hint: &str| {
        if ui.button(text).on_hover_text(hint).clicked() {
            actions.push(Action::Do(command));
        }
    };
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        let star = if desk.is_unsaved() { " *" } else { "" };
        ui.label(RichText::new(format!("{scene}{star}")).strong());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            button(ui, "?", Command::Help, "show all keys");
            button(ui, "Save", Command::Save, "save the lights as a rig file");
        });
    });
    ui.separator();
    lights_list(ui, desk, shares, &mut view.search);
    ui.horizontal_wrapped(|ui| {
        ui.label("+");
        button(ui, "point", Command::New(LightKind::Point), "new point light");
        button(ui, "spot", Command::New(LightKind::Spot), "new spot light");
        button(ui, "sun", Command::New(LightKind::Directional), "new directional light");
        button(ui, "disk", Command::New(LightKind::Disk), "new disk light");
        button(ui, "rect", Command::New(LightKind::Rect), "new rectangle light");
        button(ui, "dome", Command::New(LightKind::Dome), "new dome: the sky");
    });
    ui.horizontal(|ui| {
        ui.add_enabled_ui(desk.selected().is_some(), |ui| {
            button(ui, "Duplicate", Command::Duplicate, "duplicate the selected lights");
            button(ui, "Delete", Command::Delete, "delete the selected lights");
            button(ui, "Group", Command::Group, "group the selected lights");
        });
        ui.add_enabled_ui(desk.is_solo(), |ui| {
            button(ui, "End solo", Command::EndSolo, "switch solo off for all lights and groups");
        });
    });
    ui.separator();
    ScrollArea::vertical().max_height(ui.available_height() - 166.0).auto_shrink([false, true]).show(ui, |ui| {
        light_values(ui, desk, &mut view.light_unit);
        light_extras(ui, desk, &folder, map_browser, &mut view.show_maps);
        shots(ui, desk, &opened.scene.cameras, &opened.framebuffer.camera.name, view, actions);
        snapshots(ui, desk, thumbnails, view, actions);
        history_list(ui, desk);
    });
    ui.with_layout(egui::Layout::bottom_up(egui::Align::Min), |ui| {
        ui.add_space(4.0);
        ui.label(RichText::new(&desk.message).small());
        ui.horizontal(|ui| {
            for (text, command, name) in [("Undo", Command::Undo, 0), ("Redo", Command::Redo, 1)] {
                let name = desk.history().names()[name];
                let shown = ui.add_enabled(name.is_some(), egui::Button::new(text));
                if shown.on_hover_text(name.unwrap_or_default()).clicked() {
                    actions.push(Action::Do(command));
                }
            }
        });
        picture_values(ui, desk, view, actions);
        ui.separator();
    });
}

/// Draws what few lights have: filters, and links to objects.
fn light_extras(ui: &mut Ui, desk: &mut Desk, folder: &Path, maps: &mut MapBrowser, show_maps: &mut bool) {
    let Some(light) = desk.selected_light() else { return };
    let is_open = !light.filter.is_none() || light.links != Links::default();
    egui::CollapsingHeader::new("Filters and objects").default_open(is_open).show(ui, |ui| {
        filter_values(ui, desk, folder, maps, show_maps);
        linking_values(ui, desk);
    });
}

/// Draws the list of past states of the lights; a click restores one.
fn history_list(ui: &mut Ui, desk: &mut Desk) {
    egui::CollapsingHeader::new("History").default_open(false).show(ui, |ui| {
        let row_height = ui.spacing().interact_size.y;
        let count = desk.history().entries().len();
        let height = 8.0 * row_height;
        let list = ScrollArea::vertical().id_salt("history").max_height(height).min_scrolled_height(height);
        list.stick_to_bottom(true).auto_shrink([false, true]).show_rows(ui, row_height, count, |ui, rows| {
            for index in rows {
                let current = desk.history().current();
                let name = RichText::new(&desk.history().entries()[index].name);
                let name = if index > current { name.weak() } else { name };
                if ui.selectable_label(index == current, name).clicked() {
                    desk.go_to(index);
                }
            }
        });
    });
}

/// Draws the displays and views of an OpenColorIO configuration. Choosing one shows it.
fn display_values(ui: &mut Ui, desk: &mut Desk, view: &mut ViewState) {
    let Some(Displays { config, chosen }) = &mut view.displays else { return };
    let mut wanted = None;
    ui.horizontal(|ui| {
        ui.label("OCIO");
        let menu = |ui: &mut Ui, id: &str, shown: &str, width: f32, names: Vec<String>| {
            let menu = egui::ComboBox::from_id_salt(id).selected_text(shown).width(width).truncate();
            let inner = menu.show_ui(ui, |ui| {
                names.into_iter().find(|name| ui.selectable_label(name == shown, name.as_str()).clicked())
            });
            inner.response.on_hover_text(shown);
            inner.inner.flatten()
        };
        if let Some(display) = menu(ui, "display", chosen.display(), 88.0, config.displays()) {
            // A view of the same name, else the display's default one.
            let name = config.views(&display).into_iter().find(|name| name == chosen.name());
            wanted = Some((display, name));
        }
        if let Some(name) = menu(ui, "display view", chosen.name(), 120.0, config.views(chosen.display())) {
            wanted = Some((chosen.display().to_owned(), Some(name)));
        }
    });
    let Some((display, name)) = wanted else { return };
    match config.view(Some(&display), name.as_deref()) {
        Ok(made) => {
            *chosen = Arc::new(made);
            view.tone_map = ToneMap::View(chosen.clone());
            desk.message = view.tone_map.to_string();
        }
        Err(error) => desk.message = error.chain(),
    }
}

fn picture_values(ui: &mut Ui, desk: &mut Desk, view: &mut ViewState, actions: &mut Vec<Action>) {
    view_menu(ui, view, actions);
    ui.horizontal(|ui| {
        ui.label("exposure");
        ui.add(DragValue::new(&mut view.exposure).speed(0.02).range(-100.0..=100.0).fixed_decimals(2).suffix(" stops"));
        if ui.button("auto").on_hover_text("choose the exposure from the picture").clicked() {
            actions.push(Action::Do(Command::AutoExposure));
        }
    });
    ui.horizontal(|ui| {
        let tone_maps = [(ToneMap::Agx, "AgX"), (ToneMap::PbrNeutral, "Neutral"), (ToneMap::None, "none")];
        for (tone_map, text) in tone_maps {
            ui.selectable_value(&mut view.tone_map, tone_map, text);
        }
        if let Some(Displays { chosen, .. }) = &view.displays {
            let tone_map = ToneMap::View(chosen.clone());
            ui.selectable_value(&mut view.tone_map, tone_map, "OCIO").on_hover_text(view.tone_map.to_string());
        }
        ui.separator();
        ui.toggle_value(&mut view.one_to_one, "1:1").on_hover_text("one picture pixel per screen pixel");
        ui.toggle_value(&mut view.overlay, "times");
    });
    display_values(ui, desk, view);
}

/// Draws the list of all keys, from the table that binds them.
pub fn help(ui: &mut Ui, view: &mut ViewState) {
    let mut open = true;
    let room = ui.ctx().content_rect().size() - egui::vec2(48.0, 80.0);
    let window = egui::Window::new("Keys").open(&mut open).collapsible(false).resizable(false);
    window.fixed_pos([12.0, 12.0]).fixed_size(room).show(ui.ctx(), |ui| {
        ScrollArea::both().auto_shrink([true, true]).show(ui, |ui| {
            ui.spacing_mut().interact_size.y = 14.0;
            ui.horizontal_top(|ui| {
                // Two or three columns, as the width allows, of similar height.
                let ends: &[usize] = if room.x < 1200.0 { &[4, SECTIONS.len()] } else { &[3, 5, SECTIONS.len()] };
                let mut first = 0;
                for &end in ends {
                    let sections = &SECTIONS[std::mem::replace(&mut first, end)..end];
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

/// Draws the open dialog, if any.
pub fn dialog(ui: &mut Ui, view: &mut ViewState, rig_path: Option<&Path>, actions: &mut Vec<Action>) {
    let Some(dialog) = &mut view.dialog else { return };
    let mut close = false;
    egui::Modal::new(egui::Id::new("dialog")).show(ui.ctx(), |ui| match dialog {
        Dialog::SaveAs(path) => {
            ui.set_width(420.0);
            ui.label(
                "Save the rig as .toml, or export: the scene with its lights as .glb or .gltf, the lights as .usda",
            );
            let field = ui.add(egui::TextEdit::singleline(path).desired_width(f32::INFINITY));
            let entered = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
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
        Dialog::Recover(rig) => {
            ui.label("Unsaved edits were found. A window of this rig has crashed.");
            ui.label(format!("The recovered rig has {} lights.", rig.lights.len()));
            ui.horizontal(|ui| {
                let pressed = |ui: &Ui, key| ui.input(|input| input.key_pressed(key));
                if ui.button("Recover (R)").clicked() || pressed(ui, Key::R) {
                    actions.push(Action::Recover(rig.clone()));
                    close = true;
                } else if ui.button("Discard (D)").clicked() || pressed(ui, Key::D) {
                    actions.push(Action::DiscardRecovery);
                    close = true;
                }
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
                if ui.button(save).clicked() || pressed(ui, Key::S) {
                    actions.push(if rig_path.is_some() { Action::SaveAndQuit } else { Action::Do(Command::SaveAs) });
                    close = true;
                } else if ui.button("Quit without saving (Q)").clicked() || pressed(ui, Key::Q) {
                    actions.push(Action::QuitUnsaved);
                    close = true;
                }
                close |= ui.button("Cancel (Esc)").clicked();
            });
        }
    });
    if close {
        view.dialog = None;
    }
}

/// Whether a command works while a dialog or a text field receives the keys.
pub fn works_always(command: Command) -> bool {
    matches!(command, Command::Close | Command::Quit)
}

/// Whether a key may open or close a dialog, or leave a text field, so that later keys have another receiver.
pub fn changes_key_receiver(dialog: Option<&Dialog>, ui_wants_keys: bool, modifiers: Modifiers, key: Key) -> bool {
    let leaves = ui_wants_keys && matches!(key, Key::Enter | Key::Tab);
    let answers = is_answered_by_keys(dialog);
    let commands = [Command::Close, Command::Quit, Command::Save, Command::SaveAs, Command::Export];
    leaves || answers || keys::command(modifiers, key).is_some_and(|command| commands.contains(&command))
}

/// Whether single keys answer the dialog.
pub fn is_answered_by_keys(dialog: Option<&Dialog>) -> bool {
    matches!(dialog, Some(Dialog::Quit | Dialog::Recover(_)))
}

/// Whether a held key repeats its command.
pub fn repeats(command: Command) -> bool {
    match command {
        Command::Edit(edit) => !matches!(edit, LightEdit::Toggle | LightEdit::Solo | LightEdit::Shadows),
        Command::EditGroup(edit) => matches!(edit, GroupEdit::Stops(_)),
        Command::NextLight | Command::PreviousLight | Command::Exposure(_) | Command::Undo | Command::Redo => true,
        _ => false,
    }
}
