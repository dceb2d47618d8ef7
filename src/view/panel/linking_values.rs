//! What the selected lights light, and what casts their shadows.

use egui::{DragValue, Grid, RichText, Ui};

use crate::desk::Desk;
use crate::scene::links::MAX_FACTOR;
use crate::scene::{Light, Links};

pub fn linking_values(ui: &mut Ui, desk: &mut Desk) {
    let Some(primary) = desk.selected_light() else { return };
    let mut light: Light = primary.clone();
    ui.label(RichText::new("Z: light the object under the mouse, or not; Shift+Z: its shadow").small());
    Grid::new("linking").num_columns(3).spacing([8.0, 4.0]).show(ui, |ui| {
        names(ui, "lights only", &mut light.links.only);
        factors(ui, &mut light.links);
        names(ui, "no shadow from", &mut light.links.no_shadow_from);
    });
    desk.edit_primary_and_selection(light);
}

fn names(ui: &mut Ui, text: &str, names: &mut Vec<String>) {
    names.retain(|name| {
        ui.label(text);
        ui.label(name);
        let is_kept = !ui.small_button("x").on_hover_text("remove").clicked();
        ui.end_row();
        is_kept
    });
}

/// Objects that are lit by a factor; those that are not lit have the factor 0.
fn factors(ui: &mut Ui, links: &mut Links) {
    // By name, so that a row stays where it is when its factor changes.
    let mut listed = links.factor.clone();
    listed.extend(links.except.iter().map(|name| (name.clone(), 0.0)));
    for (name, before) in listed {
        let mut factor = before;
        ui.add(DragValue::new(&mut factor).speed(0.01).range(0.0..=MAX_FACTOR).max_decimals(3).prefix("x "));
        ui.label(&name);
        let is_removed = ui.small_button("x").on_hover_text("remove").clicked();
        ui.end_row();
        if is_removed || factor != before {
            links.except.retain(|other| *other != name);
            links.factor.remove(&name);
        }
        if !is_removed && factor != before {
            links.factor.insert(name, factor);
        }
    }
}
