//! Overlays at the lower left of the picture: legend, values under the mouse, histogram.

use egui::{Align2, Color32, FontId, Pos2, Rect, RichText, Sense, Stroke, Ui, Vec2};
use glam::Vec3;

use crate::desk::{Desk, luminance};
use crate::relight::output::exposure::{stop_color, stops};
use crate::relight::output::sheet::Grid;
use crate::shared::{BINS_PER_STOP, HISTOGRAM_BINS, MIDDLE_STOP, STOP_COUNT};
use crate::view::refine::converge::Progress;
use crate::view::refine::gathered::GatheringState;
use crate::view::still::MIDDLE_ERROR;
use crate::view::views::{Aid, View, Views};

/// Data about the picture that was drawn last.
#[derive(Clone, Default, PartialEq)]
pub struct OverlayInfo {
    /// Text lines about the pixel under the mouse.
    pub probe: Vec<String>,
    /// Counts from [`crate::relight::Relighter::histogram`].
    pub histogram: Option<Vec<u32>>,
    /// Whether the picture is coarse.
    pub is_coarse: bool,
    /// Number of lights that have an image, and of all; `None` if no light lacks one.
    pub lights: Option<[usize; 2]>,
    /// Progress towards extra samples on edges.
    pub progress: Progress,
    pub gathering: GatheringState,
}

/// Points.
const WIDTH: f32 = 16.0 * STOP_COUNT as f32;
const HISTOGRAM_HEIGHT: f32 = 70.0;
const TEXT: Color32 = Color32::from_gray(220);

impl OverlayInfo {
    /// Returns a text for a picture that lacks lights or is coarse, or for a running refinement; `None` otherwise.
    pub fn state(&self) -> Option<String> {
        if let Some([done, of]) = self.lights {
            return Some(format!("{done} of {of} lights"));
        }
        match self.progress {
            _ if self.is_coarse => Some("coarse".into()),
            Progress::Bakes(share) => Some(format!("refining edges {:.0} %", 100.0 * share)),
            Progress::Shades(done, of) => Some(format!("refining edges, light {} of {of}", done + 1)),
            Progress::Waits | Progress::Done => {
                let error = 100.0 * self.gathering.expected_error?;
                let what = if self.gathering.goes_on { "final gathering, expected error" } else { "expected error" };
                Some(format!("{what} {error:.1} %"))
            }
        }
    }
}

/// Draws the overlays that `views` enables, with their lower left corner at `corner`, points.
pub fn draw(ui: &Ui, views: &Views, overlay: &OverlayInfo, corner: Pos2) {
    let errors = views.view == View::TransferError;
    let legend = errors || (views.has(Aid::FalseColor) && views.view.picture(None).is_some());
    let (histogram, probe) = (overlay.histogram.as_ref().filter(|_| views.has(Aid::Histogram)), views.has(Aid::Probe));
    if !legend && histogram.is_none() && !probe {
        return;
    }
    let frame = egui::Frame::NONE.fill(Color32::from_black_alpha(200)).inner_margin(8).corner_radius(4);
    let area = egui::Area::new("aids".into()).interactable(false).constrain(false);
    area.fixed_pos(corner + Vec2::new(8.0, -8.0)).pivot(Align2::LEFT_BOTTOM).show(ui.ctx(), |ui| {
        frame.show(ui, |ui| {
            ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
            if probe {
                for line in &overlay.probe {
                    ui.label(RichText::new(line).monospace().size(11.0).color(TEXT));
                }
            }
            if let Some(counts) = histogram {
                bars(ui, counts);
            }
            if legend {
                let relative_to =
                    if overlay.gathering.expected_error.is_some() { "picture's mean" } else { "image's RMS" };
                stop_legend(ui, errors.then_some(relative_to));
            }
        });
    });
}

/// Draws one colour box per stop, or per doubling of an error, with labels. `errors`: what they are relative to.
fn stop_legend(ui: &mut Ui, errors: Option<&str>) {
    let (place, _) = ui.allocate_exact_size(Vec2::new(WIDTH, 34.0), Sense::hover());
    let width = WIDTH / STOP_COUNT as f32;
    for band in 0..STOP_COUNT {
        let stop = band as f32 - MIDDLE_STOP as f32;
        let [r, g, b] = stop_color(stop);
        let left = place.left() + band as f32 * width;
        let of_band = Rect::from_min_size(Pos2::new(left, place.top()), Vec2::new(width, 14.0));
        ui.painter().rect_filled(of_band, 0.0, Color32::from_rgb(r, g, b));
        let text = match errors {
            Some(_) => percent(MIDDLE_ERROR * stop.exp2()),
            None if stop == 0.0 => "0".into(),
            None => format!("{stop:+}"),
        };
        if errors.is_none() || band % 4 == 0 {
            let under = Pos2::new(left + width / 2.0, place.top() + 16.0);
            ui.painter().text(under, Align2::CENTER_TOP, text, FontId::proportional(9.0), TEXT);
        }
    }
    let what = match errors {
        Some(relative_to) => format!("error of indirect light, relative to the {relative_to}"),
        None => "stops from middle grey".into(),
    };
    ui.painter().text(place.center_bottom(), Align2::CENTER_BOTTOM, what, FontId::proportional(9.0), TEXT);
}

fn percent(share: f32) -> String {
    let percent = 100.0 * share;
    if percent < 0.1 {
        format!("{percent:.3} %")
    } else {
        format!("{percent:.3}").trim_end_matches('0').trim_end_matches('.').to_owned() + " %"
    }
}

/// Draws one bar per bin, its height proportional to the square root of the count, and a line every two stops.
fn bars(ui: &mut Ui, counts: &[u32]) {
    let (place, _) = ui.allocate_exact_size(Vec2::new(WIDTH, HISTOGRAM_HEIGHT + 12.0), Sense::hover());
    let bins = HISTOGRAM_BINS as usize;
    let width = WIDTH / (bins - 2) as f32;
    // The first and last bin, which hold all darker and brighter pixels, are shown as numbers.
    let most = counts[1..bins - 1].iter().copied().max().unwrap_or(0).max(1);
    let bottom = place.top() + HISTOGRAM_HEIGHT;
    let x = |bin: usize| place.left() + (bin - 1) as f32 * width;
    for stop in (0..=(bins - 2) / BINS_PER_STOP as usize).step_by(2) {
        let at = x(1 + stop * BINS_PER_STOP as usize);
        let middle = stop == (bins - 2) / BINS_PER_STOP as usize / 2;
        let line = Stroke::new(1.0, Color32::from_gray(if middle { 110 } else { 50 }));
        ui.painter().vline(at, place.top()..=bottom, line);
        let text = if middle { "0".into() } else { format!("{:+}", stop as i32 - 8) };
        let font = FontId::proportional(9.0);
        ui.painter().text(Pos2::new(at, bottom + 1.0), Align2::CENTER_TOP, text, font, TEXT);
    }
    for (bin, &count) in counts.iter().enumerate().take(bins - 1).skip(1) {
        let height = HISTOGRAM_HEIGHT * (count as f32 / most as f32).sqrt();
        let [r, g, b] = stop_color((bin as f32 - (bins / 2) as f32 + 0.5) / BINS_PER_STOP as f32);
        let bar = Rect::from_min_max(Pos2::new(x(bin), bottom - height), Pos2::new(x(bin + 1) - 0.5, bottom));
        ui.painter().rect_filled(bar, 0.0, Color32::from_rgb(r, g, b));
    }
    let all = counts.iter().sum::<u32>().max(1) as f32;
    let share = |count: u32| format!("{:.1} %", 100.0 * count as f32 / all);
    let font = FontId::proportional(9.0);
    ui.painter().text(place.left_top(), Align2::LEFT_TOP, format!("darker {}", share(counts[0])), font.clone(), TEXT);
    let brighter = format!("brighter {}", share(counts[bins - 1]));
    ui.painter().text(place.right_top(), Align2::RIGHT_TOP, brighter, font, TEXT);
}

/// Formats a pixel's radiance, luminance and stops as text lines.
pub fn radiance_lines(pixel: [u32; 2], radiance: Vec3, exposure: f32) -> Vec<String> {
    let [x, y] = pixel;
    let luminance = luminance(radiance);
    let exposed = stops(luminance * exposure.exp2());
    let text = |stops: f32| if stops.is_finite() { format!("{stops:+.2}") } else { "none".into() };
    vec![
        format!("pixel {x}, {y}"),
        format!("R {}  G {}  B {}", short(radiance.x), short(radiance.y), short(radiance.z)),
        format!("luminance {}", short(luminance)),
        format!("stops {} with exposure, {} without", text(exposed), text(stops(luminance))),
    ]
}

/// Formats a number with four significant digits.
pub fn short(value: f32) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 {
        "0".into()
    } else if (1e-3..1e5).contains(&magnitude) {
        format!("{value:.*}", (3.0 - magnitude.log10().floor()).clamp(0.0, 6.0) as usize)
    } else {
        format!("{value:.3e}")
    }
}

/// Draws the view's name at the top centre of the picture.
pub fn title(ui: &Ui, text: &str, at: Pos2) {
    // Drawn over all windows, since it describes the picture that they may cover.
    let layer = egui::LayerId::new(egui::Order::Foreground, egui::Id::new("title"));
    let painter = ui.ctx().layer_painter(layer);
    let galley = painter.layout_no_wrap(text.to_owned(), FontId::proportional(13.0), TEXT);
    let place = Align2::CENTER_TOP.anchor_size(at + Vec2::new(0.0, 6.0), galley.size());
    painter.rect_filled(place.expand2(Vec2::new(8.0, 3.0)), 4.0, Color32::from_black_alpha(200));
    painter.galley(place.min, galley, TEXT);
}

/// Draws the lights' names in their contact-sheet cells, and a frame around the selected light. `at` converts pixels of
/// the picture to points of the window.
pub fn sheet_names(ui: &Ui, desk: &Desk, grid: Grid, at: impl Fn([u32; 2]) -> Pos2) {
    let painter = ui.ctx().layer_painter(egui::LayerId::background());
    for (index, light) in desk.rig().lights.iter().enumerate() {
        let [left, top, width, height] = grid.cell(index);
        let cell = Rect::from_min_max(at([left, top]), at([left + width, top + height]));
        if desk.selected() == Some(index) {
            let stroke = Stroke::new(2.0, Color32::from_rgb(255, 190, 60));
            painter.rect_stroke(cell, 0.0, stroke, egui::StrokeKind::Inside);
        }
        let galley = painter.layout_no_wrap(light.name.clone(), FontId::proportional(11.0), TEXT);
        let place = Rect::from_min_size(cell.min + Vec2::splat(5.0), galley.size());
        painter.rect_filled(place.expand2(Vec2::new(3.0, 1.0)), 2.0, Color32::from_black_alpha(160));
        painter.galley(place.min, galley, TEXT);
    }
}
