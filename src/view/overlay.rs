//! Figures and marks over the picture.

use egui::{Align2, Color32, FontId, Pos2, RichText, Stroke, Ui};

use super::desk::Desk;
use super::lights_list::chip;
use super::timings::Timings;
use crate::gpu::Site;
use crate::scene::LightKind;

/// What passes took, latency, and what is selected.
pub fn times(ui: &Ui, timings: &Timings, desk: &Desk, corner: Pos2) {
    let frame = egui::Frame::NONE.fill(Color32::from_black_alpha(190)).inner_margin(8).corner_radius(4);
    let area = egui::Area::new("times".into()).fixed_pos(corner + egui::vec2(8.0, 8.0)).interactable(false);
    area.show(ui.ctx(), |ui| {
        frame.show(ui, |ui| {
            ui.set_max_width(320.0);
            let line = |ui: &mut Ui, text: String| ui.label(RichText::new(text).monospace().color(Color32::WHITE));
            for (name, site, ms) in timings.passes() {
                let site = if site == Site::Gpu { "GPU" } else { "CPU" };
                line(ui, format!("{name:<16} {ms:>7.2} ms {site}"));
            }
            let [p50, p95] = timings.recent().unwrap_or_default();
            line(ui, format!("{:<16} {:>7.2} ms", "event to picture", timings.last().unwrap_or_default()));
            line(ui, format!("{:<16} {p50:>7.2} ms p50", "last 5 seconds"));
            line(ui, format!("{:<16} {p95:>7.2} ms p95", ""));
            line(ui, desk.summary());
        });
    });
}

/// A mark for each light where the picture has it; the selected one is named. `at` places a light, in points.
pub fn marks(ui: &Ui, desk: &Desk, at: impl Fn(glam::DVec3) -> Option<Pos2>) {
    let painter = ui.ctx().layer_painter(egui::LayerId::background());
    for (index, light) in desk.rig().lights.iter().enumerate() {
        if light.kind == LightKind::Directional {
            continue;
        }
        let Some(at) = at(light.position) else { continue };
        let selected = desk.selection().contains(index);
        let color = if light.enabled { chip(light.color) } else { Color32::DARK_GRAY };
        painter.circle(at, if selected { 6.0 } else { 4.0 }, color, Stroke::new(1.5, Color32::BLACK));
        if selected {
            painter.circle_stroke(at, 8.5, Stroke::new(1.5, Color32::from_rgb(255, 190, 60)));
            let shadow = at + egui::vec2(13.0, 1.0);
            let font = FontId::proportional(13.0);
            painter.text(shadow, Align2::LEFT_CENTER, &light.name, font.clone(), Color32::BLACK);
            painter.text(at + egui::vec2(12.0, 0.0), Align2::LEFT_CENTER, &light.name, font, Color32::WHITE);
        }
    }
}
