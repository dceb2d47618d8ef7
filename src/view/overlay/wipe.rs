//! The draggable line between a snapshot and the current lights.

use egui::{Align2, Color32, FontId, Pos2, Rect, Sense, Stroke, Ui};

use crate::desk::Desk;
use crate::gpu::Placement;
use crate::view::compare::{Comparing, Comparison};
use crate::view::view_state::ViewState;

/// Half the width in which the mouse grabs the line, points.
const REACH: f32 = 5.0;

/// Draws the labels and the line of a comparison; a drag moves the line. `scale` is physical pixels per point.
pub fn draw(ui: &Ui, view: &mut ViewState, desk: &Desk, placement: Placement, scale: f32) {
    let Some(Comparing { slot, kind }) = &mut view.comparing else { return };
    let Some(snapshot) = desk.snapshots().get(*slot) else { return };
    let corner = Pos2::new(placement.left as f32, placement.top as f32) / scale;
    let picture = Rect::from_min_size(corner, egui::vec2(placement.width as f32, placement.height as f32) / scale);
    let painter = ui.ctx().layer_painter(egui::LayerId::background());
    let write = |at: Pos2, align: Align2, text: &str| {
        for (offset, color) in [(1.0, Color32::BLACK), (0.0, Color32::WHITE)] {
            painter.text(at + egui::vec2(offset, offset), align, text, FontId::proportional(13.0), color);
        }
    };
    let label = snapshot.label(*slot);
    match kind {
        Comparison::Difference => {
            write(picture.left_top() + egui::vec2(6.0, 4.0), Align2::LEFT_TOP, &format!("difference from {label}"));
        }
        Comparison::Wipe { at } => {
            let x = picture.left() + *at * picture.width();
            let grip = Rect::from_x_y_ranges(x - REACH..=x + REACH, picture.y_range());
            let area = egui::Area::new("wipe".into()).fixed_pos(grip.min).order(egui::Order::Background);
            let dragged = area.show(ui.ctx(), |ui| ui.allocate_rect(grip, Sense::drag()).drag_delta().x).inner;
            *at = (*at + dragged / picture.width()).clamp(0.0, 1.0);
            painter.vline(x, picture.y_range(), Stroke::new(1.0, Color32::WHITE));
            write(Pos2::new(x - 6.0, picture.bottom() - 6.0), Align2::RIGHT_BOTTOM, &label);
            write(Pos2::new(x + 6.0, picture.bottom() - 6.0), Align2::LEFT_BOTTOM, "now");
        }
    }
}
