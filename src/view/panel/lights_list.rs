//! The list of lights: groups, switches, colours. A click selects one light; with Ctrl or Shift, several.

use egui::{Color32, RichText, ScrollArea, Ui};
use glam::Vec3;

use crate::desk::Desk;
use crate::desk::describe::{kind_name, rounded};
use crate::desk::selection::Selection;
use crate::scene::{Light, LightGroup, Rig};
use crate::view::shares::Shares;

/// A line of the list.
enum Row {
    Group(usize),
    Light(usize),
}

pub fn lights_list(ui: &mut Ui, desk: &mut Desk, shares: &Shares, search: &mut String) {
    if desk.rig().lights.is_empty() {
        ui.label("no lights; add one:");
        return;
    }
    ui.add(egui::TextEdit::singleline(search).hint_text("search: name, kind or group").desired_width(f32::INFINITY));
    let rows = rows(desk.rig(), &search.to_lowercase());
    let row_height = ui.spacing().interact_size.y;
    let list = ScrollArea::vertical().id_salt("lights").max_height(0.26 * ui.available_height());
    list.auto_shrink([false, true]).show_rows(ui, row_height, rows.len(), |ui, range| {
        for row in &rows[range] {
            ui.horizontal(|ui| match row {
                Row::Group(group) => group_row(ui, desk, shares, *group),
                Row::Light(light) => light_row(ui, desk, shares, *light),
            });
        }
    });
}

/// Returns groups with their lights, then the lights without a group. `search`, in lower case, filters them.
fn rows(rig: &Rig, search: &str) -> Vec<Row> {
    let has = |text: &str| text.to_lowercase().contains(search);
    let is_found = |light: &Light| has(&light.name) || has(kind_name(light.kind));
    let members = |group: Option<usize>, all: bool| {
        let lights = rig.lights.iter().enumerate().filter(move |(_, light)| light.group == group);
        lights.filter(move |(_, light)| all || is_found(light)).map(|(index, _)| Row::Light(index))
    };
    let mut rows = Vec::new();
    for (index, group) in rig.groups.iter().enumerate() {
        let all = has(&group.name);
        let mut lights = members(Some(index), all).peekable();
        if all || lights.peek().is_some() {
            rows.push(Row::Group(index));
            rows.extend(lights);
        }
    }
    rows.extend(members(None, false));
    rows
}

fn light_row(ui: &mut Ui, desk: &mut Desk, shares: &Shares, index: usize) {
    let light = &desk.rig().lights[index];
    ui.add_space(if light.group.is_some() { 12.0 } else { 0.0 });
    let (mut enabled, mut solo) = (light.enabled, light.solo);
    let (color, name) = (chip(light.color), format!("{}  ({})", light.name, kind_name(light.kind)));
    if switches(ui, &mut enabled, &mut solo) {
        desk.end_gesture();
        desk.switch(index, enabled, solo);
    }
    let light = &desk.rig().lights[index];
    dot(ui, color);
    let leader = light.follows.map(|leader| desk.rig().lights[leader].name.clone());
    let label = ui.selectable_label(desk.selection().contains(index), name);
    if label.clicked() {
        let mut selection = desk.selection().clone();
        match ui.input(|input| input.modifiers) {
            held if held.command => selection.toggle(index),
            held if held.shift => selection.extend_to(index),
            _ => selection = Selection::only(index),
        }
        desk.select(selection);
    }
    if let Some(leader) = leader {
        label.on_hover_text(format!("follows {leader}"));
    }
    percent(ui, shares.share(index));
}

fn group_row(ui: &mut Ui, desk: &mut Desk, shares: &Shares, index: usize) {
    let group = &desk.rig().groups[index];
    let (mut enabled, mut solo) = (group.enabled, group.solo);
    let (color, stops) = (chip(group.color), group.stops);
    let name = match stops {
        0.0 => group.name.clone(),
        stops => format!("{}  {}{} stops", group.name, if stops > 0.0 { "+" } else { "" }, rounded(stops)),
    };
    if switches(ui, &mut enabled, &mut solo) {
        desk.end_gesture();
        desk.replace_group(index, LightGroup { enabled, solo, ..desk.rig().groups[index].clone() });
    }
    dot(ui, color);
    let members = desk.members(index);
    let all = !members.is_empty() && members.iter().all(|light| desk.selection().contains(light));
    let share = members.iter().map(|light| shares.share(light)).sum();
    if ui.selectable_label(all, RichText::new(name).strong()).on_hover_text("select its lights").clicked() {
        desk.select(members);
    }
    percent(ui, share);
}

/// Draws a share of the light in the picture.
fn percent(ui: &mut Ui, share: Option<f64>) {
    let Some(percent) = share.map(|share| 100.0 * share) else { return };
    let text = if percent == 0.0 || percent >= 9.95 { format!("{percent:.0} %") } else { format!("{percent:.1} %") };
    ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
        ui.label(RichText::new(text).small()).on_hover_text("share of the light in the picture");
    });
}

/// Draws the on and solo switches. Returns whether one of them was clicked.
fn switches(ui: &mut Ui, enabled: &mut bool, solo: &mut bool) -> bool {
    let clicked = ui.checkbox(enabled, "").on_hover_text("on, off; off overrides solo").changed();
    let text = RichText::new("S").small();
    let solo_clicked = ui.selectable_label(*solo, text).on_hover_text("solo").clicked();
    *solo ^= solo_clicked;
    clicked || solo_clicked
}

fn dot(ui: &mut Ui, color: Color32) {
    let (at, _) = ui.allocate_exact_size(egui::vec2(10.0, 10.0), egui::Sense::hover());
    ui.painter().circle_filled(at.center(), 5.0, color);
}

/// Returns a light's colour at full brightness, encoded for the display.
pub fn chip(color: Vec3) -> Color32 {
    let brightest = color.max_element().max(f32::MIN_POSITIVE);
    let encode = |x: f32| (x.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8;
    let c = color / brightest;
    Color32::from_rgb(encode(c.x), encode(c.y), encode(c.z))
}
