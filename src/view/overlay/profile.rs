//! Profile window: graph and statistics of frame times, and device memory by owner.

use egui::{Color32, FontId, Grid, Pos2, Rect, RichText, Sense, Stroke, Ui, Vec2};

use crate::gpu::Processor;
use crate::view::timings::{Spread, Timings};

/// Size of the graph, points.
const GRAPH: Vec2 = Vec2::new(330.0, 110.0);
/// Colours of passes in order of first appearance; further passes reuse them.
const COLORS: [[u8; 3]; 12] = [
    [86, 180, 233],
    [230, 159, 0],
    [0, 158, 115],
    [240, 228, 66],
    [0, 114, 178],
    [213, 94, 0],
    [204, 121, 167],
    [150, 150, 150],
    [120, 94, 240],
    [160, 210, 90],
    [254, 97, 0],
    [100, 143, 200],
];

fn color(pass: usize) -> Color32 {
    let [r, g, b] = COLORS[pass % COLORS.len()];
    Color32::from_rgb(r, g, b)
}

/// Draws a window over the picture, initially with its upper right corner at `corner`. `memory` lists owners and bytes.
pub fn draw(ui: &Ui, timings: &Timings, memory: &[(String, u64)], budget_ms: f64, corner: Pos2) {
    let window = egui::Window::new("Profile").collapsible(true).resizable(false).title_bar(true);
    let place = corner + Vec2::new(-GRAPH.x - 36.0, 8.0);
    window.default_pos(Pos2::new(place.x.max(8.0), place.y)).show(ui.ctx(), |ui| {
        graph(ui, timings, budget_ms);
        ui.add_space(4.0);
        figures(ui, timings);
        ui.add_space(4.0);
        ui.horizontal_wrapped(|ui| {
            ui.spacing_mut().item_spacing = Vec2::new(10.0, 1.0);
            let all: u64 = memory.iter().map(|(_, bytes)| bytes).sum();
            text(ui, format!("device memory {:.1} MB", all as f64 * 1e-6), Color32::WHITE);
            for (owner, bytes) in memory {
                text(ui, format!("{owner} {:.1}", *bytes as f64 * 1e-6), Color32::from_gray(190));
            }
        });
    });
}

fn text(ui: &mut Ui, text: String, color: Color32) {
    ui.label(RichText::new(text).monospace().size(10.0).color(color));
}

/// Draws one bar of stacked passes per frame, and a dot at the frame's latency.
fn graph(ui: &mut Ui, timings: &Timings, budget_ms: f64) {
    let (place, _) = ui.allocate_exact_size(GRAPH, Sense::hover());
    let painter = ui.painter().with_clip_rect(place);
    painter.rect_filled(place, 2.0, Color32::from_gray(18));
    let latency = timings.latency_spread().map_or(0.0, |spread| spread.max);
    let top_ms = latency.max(1.2 * budget_ms);
    let y = |ms: f64| place.bottom() - (ms / top_ms) as f32 * place.height();
    let width = place.width() / timings.capacity() as f32;
    for (i, frame) in timings.frames().enumerate() {
        let left = place.left() + i as f32 * width;
        let mut below = 0.0;
        for &(pass, ms) in &frame.passes {
            let bar = Rect::from_min_max(Pos2::new(left, y(below + ms)), Pos2::new(left + width, y(below)));
            painter.rect_filled(bar, 0.0, color(pass));
            below += ms;
        }
        let dot = Rect::from_center_size(Pos2::new(left + width / 2.0, y(frame.latency_ms)), Vec2::splat(1.5));
        painter.rect_filled(dot, 0.0, if frame.coarse { Color32::from_rgb(255, 120, 120) } else { Color32::WHITE });
    }
    for (ms, gray) in [(budget_ms, 150), (1000.0 / 60.0, 70)] {
        painter.hline(place.x_range(), y(ms), Stroke::new(1.0, Color32::from_gray(gray)));
        let at = Pos2::new(place.left() + 2.0, y(ms));
        let label = format!("{ms:.1} ms");
        painter.text(at, egui::Align2::LEFT_BOTTOM, label, FontId::monospace(9.0), Color32::from_gray(170));
    }
}

/// Draws median, 95th percentile and maximum of each pass and of the latency, over the frames of the graph.
fn figures(ui: &mut Ui, timings: &Timings) {
    let columns = |ui: &mut Ui, name: &str, chip: Color32, processor: &str, spread: Spread| {
        text(ui, name.into(), chip);
        text(ui, processor.into(), Color32::from_gray(150));
        for ms in [spread.median, spread.p95, spread.max] {
            text(ui, format!("{ms:>7.2}"), Color32::WHITE);
        }
        ui.end_row();
    };
    Grid::new("profile").num_columns(5).spacing([10.0, 1.0]).show(ui, |ui| {
        for head in ["ms per frame", "", "    p50", "    p95", "    max"] {
            text(ui, head.into(), Color32::from_gray(150));
        }
        ui.end_row();
        for (index, (name, processor)) in timings.names().enumerate() {
            if let Some(spread) = timings.pass_spread(index) {
                columns(ui, name, color(index), if processor == Processor::Gpu { "GPU" } else { "CPU" }, spread);
            }
        }
        if let Some(spread) = timings.latency_spread() {
            columns(ui, "edit to present", Color32::WHITE, "", spread);
        }
    });
}
