//! Shots in the panel: the camera, and what the lights have in its pictures only.

use egui::{RichText, Ui};

use crate::desk::Desk;
use crate::scene::Camera;
use crate::view::input::action::Action;
use crate::view::input::keys::Command;
use crate::view::view_state::ViewState;

/// Draws cameras and switches, unless the scene has one camera and its lights are the same in all pictures.
pub fn shots(
    ui: &mut Ui,
    desk: &mut Desk,
    cameras: &[Camera],
    shown: &str,
    view: &mut ViewState,
    actions: &mut Vec<Action>,
) {
    if cameras.len() < 2 && desk.base().shots.is_empty() {
        return;
    }
    egui::CollapsingHeader::new("Shots").default_open(true).show(ui, |ui| {
        ui.horizontal(|ui| {
            egui::ComboBox::from_id_salt("camera").selected_text(shown).width(150.0).truncate().show_ui(ui, |ui| {
                for (at, camera) in cameras.iter().enumerate() {
                    if ui.selectable_label(camera.name == shown, &camera.name).clicked() {
                        actions.push(Action::Do(Command::Camera(at)));
                    }
                }
            });
            ui.toggle_value(&mut view.show_shots, "all cameras").on_hover_text("pictures from all cameras");
        });
        ui.checkbox(&mut desk.only_here, "edits change this shot only")
            .on_hover_text("values of lights that you change become those of this camera's pictures alone");
        let Some(light) = desk.selected_light() else { return };
        let group = light.group.map(|group| desk.rig().groups[group].name.as_str());
        let of = [("lights", Some(light.name.as_str())), ("groups", group)];
        let only_here = of.into_iter().filter_map(|(list, name)| {
            let keys: Vec<&str> = desk.shot()?.values(list, name?)?.keys().map(String::as_str).collect();
            Some(format!("{} only here: {}", name?, keys.join(", ")))
        });
        let only_here: Vec<String> = only_here.collect();
        if only_here.is_empty() {
            return;
        }
        only_here.into_iter().for_each(|line| _ = ui.label(RichText::new(line).small()));
        if ui
            .button("As in all shots")
            .on_hover_text("give up what the selected lights and their groups have only here")
            .clicked()
        {
            desk.share_selected();
        }
    });
}
