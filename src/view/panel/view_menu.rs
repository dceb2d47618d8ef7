//! The menu of views and the buttons of aids.

use egui::{ComboBox, Ui};

use crate::view::input::action::Action;
use crate::view::input::keys::{self, Command};
use crate::view::view_state::ViewState;
use crate::view::views::{Aid, View};

/// Draws the menu of views and the buttons of aids.
pub fn view_menu(ui: &mut Ui, view: &ViewState, actions: &mut Vec<Action>) {
    ui.horizontal(|ui| {
        ui.label("view");
        let shown = ComboBox::from_id_salt("view").selected_text(view.views.title()).width(150.0).height(420.0);
        shown.show_ui(ui, |ui| {
            for choice in View::all() {
                let label = ui.selectable_label(view.views.view == choice, choice.name());
                let label = match keys::hint(Command::View(choice)) {
                    Some(hint) => label.on_hover_text(hint),
                    None => label,
                };
                if label.clicked() {
                    actions.push(Action::Do(Command::View(choice)));
                }
            }
        });
        if matches!(view.views.view, View::Channel(channel) if channel.has_layers())
            && ui.button("layer").on_hover_text("show the next layer of the deep framebuffer").clicked()
        {
            actions.push(Action::Do(Command::NextLayer));
        }
    });
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        for (aid, text) in Aid::ALL {
            let hint = keys::hint(Command::Aid(aid)).unwrap_or_default();
            if ui.selectable_label(view.views.has(aid), text).on_hover_text(hint).clicked() {
                actions.push(Action::Do(Command::Aid(aid)));
            }
        }
    });
}
