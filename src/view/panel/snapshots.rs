//! Snapshots in the panel: thumbnails, notes and comparison.

use egui::{Color32, ColorImage, RichText, TextureHandle, TextureOptions, Ui};

use crate::desk::Desk;
use crate::scene::rig::SLOTS;
use crate::view::compare::{Comparing, Comparison};
use crate::view::input::action::Action;
use crate::view::input::keys::Command;
use crate::view::view_state::ViewState;

/// Width of a thumbnail, pixels.
const WIDTH: usize = 84;
/// Height of the button of a snapshot without a thumbnail, points.
const HEIGHT: f32 = 56.0;

/// A small picture: of a snapshot from when it was stored or recalled, or of an environment map.
pub enum Thumbnail {
    Fresh(ColorImage),
    Loaded(TextureHandle),
}

impl Thumbnail {
    pub fn of(pixels: &[[u8; 4]], size: [u32; 2]) -> Self {
        Self::Fresh(reduced(pixels, size, WIDTH))
    }

    pub fn texture(&mut self, ui: &Ui) -> &TextureHandle {
        if let Self::Fresh(image) = self {
            let texture = ui.ctx().load_texture("thumbnail", std::mem::take(image), TextureOptions::LINEAR);
            *self = Self::Loaded(texture);
        }
        match self {
            Self::Loaded(texture) => texture,
            Self::Fresh(_) => unreachable!("it was loaded above"),
        }
    }
}

/// A picture at most `most` pixels wide: each of its pixels is the mean of the pixels that it covers.
pub fn reduced(pixels: &[[u8; 4]], size: [u32; 2], most: usize) -> ColorImage {
    let [width, height] = size.map(|side| side as usize);
    let small = [most.min(width), (height * most.min(width) / width).max(1)];
    let mean = |x: usize, y: usize| {
        let columns = x * width / small[0]..((x + 1) * width / small[0]).max(x * width / small[0] + 1);
        let rows = y * height / small[1]..((y + 1) * height / small[1]).max(y * height / small[1] + 1);
        let count = (columns.len() * rows.len()) as u32;
        let inside = rows.flat_map(|row| columns.clone().map(move |column| pixels[row * width + column]));
        let sum = inside.fold([0u32; 3], |sum, pixel| [0, 1, 2].map(|c| sum[c] + u32::from(pixel[c])));
        let [r, g, b] = sum.map(|sum| (sum / count) as u8);
        Color32::from_rgb(r, g, b)
    };
    let colors = (0..small[1]).flat_map(|y| (0..small[0]).map(move |x| mean(x, y))).collect();
    ColorImage::new(small, colors)
}

pub fn snapshots(
    ui: &mut Ui,
    desk: &mut Desk,
    thumbnails: &mut [Option<Thumbnail>; SLOTS],
    view: &mut ViewState,
    actions: &mut Vec<Action>,
) {
    egui::CollapsingHeader::new("Snapshots").default_open(true).show(ui, |ui| {
        ui.horizontal_wrapped(|ui| {
            for (slot, thumbnail) in thumbnails.iter_mut().enumerate() {
                match desk.snapshots().get(slot) {
                    None => {
                        if ui.button(format!("{}", slot + 1)).on_hover_text("store the current lights").clicked() {
                            actions.push(Action::Do(Command::Store(slot)));
                        }
                    }
                    Some(snapshot) => {
                        let label = snapshot.label(slot);
                        // The size decides whether it is still in this row.
                        let size = egui::vec2(WIDTH as f32 + 8.0, HEIGHT + 24.0);
                        ui.allocate_ui(size, |ui| {
                            ui.vertical(|ui| stored(ui, slot, &label, thumbnail.as_mut(), view, actions));
                        });
                    }
                }
            }
        });
        let Some(slot) = desk.snapshots().last() else { return };
        let Some(mut note) = desk.snapshots().get(slot).map(|snapshot| snapshot.note.clone()) else { return };
        ui.horizontal(|ui| {
            ui.label(format!("note for {}", slot + 1));
            if ui.add(egui::TextEdit::singleline(&mut note).desired_width(f32::INFINITY)).changed() {
                desk.annotate(slot, note);
            }
        });
    });
}

fn stored(
    ui: &mut Ui,
    slot: usize,
    label: &str,
    thumbnail: Option<&mut Thumbnail>,
    view: &mut ViewState,
    actions: &mut Vec<Action>,
) {
    let button = match thumbnail {
        Some(thumbnail) => egui::Button::image(egui::Image::new(thumbnail.texture(ui)).max_width(WIDTH as f32)),
        None => egui::Button::new(format!("{}", slot + 1)).min_size(egui::vec2(WIDTH as f32, HEIGHT)),
    };
    if ui.add(button).on_hover_text(format!("{label}: click to recall")).clicked() {
        actions.push(Action::Do(Command::Recall(slot)));
    }
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 2.0;
        ui.label(RichText::new(format!("{}", slot + 1)).small());
        if ui.small_button("store").on_hover_text("replace it by the current lights").clicked() {
            actions.push(Action::Do(Command::Store(slot)));
        }
        let comparing = view.comparing.filter(|comparing| comparing.slot == slot).map(|comparing| comparing.kind);
        let choices = [
            (
                "A|B",
                Comparison::Wipe { at: 0.5 },
                matches!(comparing, Some(Comparison::Wipe { .. })),
                "show it beside the current lights",
            ),
            (
                "±",
                Comparison::Difference,
                comparing == Some(Comparison::Difference),
                "show the difference from the current lights",
            ),
        ];
        for (text, kind, is_on, hint) in choices {
            if ui.selectable_label(is_on, RichText::new(text).small()).on_hover_text(hint).clicked() {
                view.comparing = (!is_on).then_some(Comparing { slot, kind });
                actions.push(Action::Show);
            }
        }
    });
}
