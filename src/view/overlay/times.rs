//! Overlay with render times.

use egui::{Color32, Pos2, RichText, Ui};

use crate::desk::Desk;
use crate::gpu::Processor;
use crate::view::timings::Timings;

/// Draws pass times, latency and the selection, with the upper left corner near `corner`, points.
pub fn draw(ui: &Ui, timings: &Timings, desk: &Desk, corner: Pos2) {
    let frame = egui::Frame::NONE.fill(Color32::from_black_alpha(190)).inner_margin(8).corner_radius(4);
    let area = egui::Area::new("times".into()).fixed_pos(corner + egui::vec2(8.0, 8.0)).interactable(false);
    area.show(ui.ctx(), |ui| {
        frame.show(ui, |ui| {
            ui.set_max_width(320.0);
            let line = |ui: &mut Ui, text: String| ui.label(RichText::new(text).monospace().color(Color32::WHITE));
            for (name, processor, ms) in timings.passes() {
                let processor = if processor == Processor::Gpu { "GPU" } else { "CPU" };
                line(ui, format!("{name:<16} {ms:>7.2} ms {processor}"));
            }
            let [p50, p95] = timings.recent().unwrap_or_default();
            line(ui, format!("{:<16} {:>7.2} ms", "event to picture", timings.last().unwrap_or_default()));
            line(ui, format!("{:<16} {p50:>7.2} ms p50", "last 5 seconds"));
            line(ui, format!("{:<16} {p95:>7.2} ms p95", ""));
            line(ui, desk.summary());
        });
    });
}
