//! The legend of a false-colour map.

use std::convert::Infallible;

use embedded_graphics::Pixel;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_7X13;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{PrimitiveStyle, Rectangle};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};

/// Background of the legend and of pixels without a value: a grey that is not a colour of the map.
pub const GROUND: [u8; 3] = [56; 3];
/// Decades that the colours span: from clearly visible errors to errors far below noise.
pub const DECADES: i32 = 3;

// In pixels of the legend, which is enlarged by integer factors for wide images.
const MIN_WIDTH: usize = 388;
const ENLARGED_EVERY: usize = 900;
/// Left and right margin: half of the widest label.
const MARGIN: usize = 32;
const BAR_TOP: usize = 8;
const BAR_HEIGHT: usize = 14;
const TICK: usize = 4;
const LINE: usize = 15;

/// Pixels, row by row.
pub struct Legend {
    pub width: usize,
    pub pixels: Vec<[u8; 3]>,
}

/// A bar of `colors` with labels for its decades up to `most`, in radiance and, if the reference's mean is known, in %
/// of it, and a line for `note`. About as wide as the image, but at least as wide as its text requires.
pub fn draw(
    picture_width: usize,
    most: f64,
    mean_reference: Option<f64>,
    note: Option<&str>,
    colors: &[[u8; 3]],
) -> Legend {
    let enlarged = 1 + picture_width / ENLARGED_EVERY;
    let width = (picture_width / enlarged).max(MIN_WIDTH);
    let mean = mean_reference.filter(|&mean| mean > 0.0);
    let labels_top = BAR_TOP + BAR_HEIGHT + TICK + 1;
    let caption_top = labels_top + LINE * if mean.is_some() { 2 } else { 1 } + 3;
    let lines = 1 + usize::from(note.is_some());
    let mut canvas = Canvas { width, pixels: vec![GROUND; width * (caption_top + lines * LINE + 4)] };

    let bar_end = width - 2 * MARGIN - 1;
    for x in 0..=bar_end {
        let color = colors[(x * (colors.len() - 1) + bar_end / 2) / bar_end];
        canvas.fill(MARGIN + x, BAR_TOP, BAR_HEIGHT, color);
    }
    for decade in 0..=DECADES {
        let x = MARGIN + bar_end * decade as usize / DECADES as usize;
        canvas.fill(x, BAR_TOP + BAR_HEIGHT, TICK, [255; 3]);
        let error = most * 10f64.powi(decade - DECADES);
        canvas.write(&short(error), x, labels_top, Alignment::Center);
        if let Some(mean) = mean {
            canvas.write(&format!("{} %", short(100.0 * error / mean)), x, labels_top + LINE, Alignment::Center);
        }
    }
    let caption = if mean.is_some() { "|image - reference|, % of the reference's mean" } else { "|image - reference|" };
    canvas.write(caption, MARGIN, caption_top, Alignment::Left);
    canvas.write(note.unwrap_or_default(), MARGIN, caption_top + LINE, Alignment::Left);
    canvas.enlarged(enlarged)
}

/// A positive number with three significant digits.
fn short(value: f64) -> String {
    let magnitude = value.log10().floor();
    if !(-5.0..5.0).contains(&magnitude) {
        return format!("{value:.0e}");
    }
    let text = format!("{value:.*}", (2.0 - magnitude).max(0.0) as usize);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

struct Canvas {
    width: usize,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// A vertical line, one pixel wide.
    fn fill(&mut self, x: usize, y: usize, height: usize, [r, g, b]: [u8; 3]) {
        let area = Rectangle::new(Point::new(x as i32, y as i32), Size::new(1, height as u32));
        let Ok(()) = area.into_styled(PrimitiveStyle::with_fill(Rgb888::new(r, g, b))).draw(self);
    }

    fn write(&mut self, text: &str, x: usize, y: usize, alignment: Alignment) {
        let font = MonoTextStyle::new(&FONT_7X13, Rgb888::WHITE);
        let style = TextStyleBuilder::new().alignment(alignment).baseline(Baseline::Top).build();
        let Ok(_) = Text::with_text_style(text, Point::new(x as i32, y as i32), font, style).draw(self);
    }

    /// Enlarges every pixel to a square of `factor` x `factor`.
    fn enlarged(&self, factor: usize) -> Legend {
        let rows = self.pixels.chunks(self.width).flat_map(|row| std::iter::repeat_n(row, factor));
        let pixels = rows.flatten().flat_map(|&pixel| std::iter::repeat_n(pixel, factor));
        Legend { width: self.width * factor, pixels: pixels.collect() }
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width as u32, (self.pixels.len() / self.width) as u32)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        let area = self.bounding_box();
        for Pixel(at, color) in pixels.into_iter().filter(|pixel| area.contains(pixel.0)) {
            self.pixels[at.y as usize * self.width + at.x as usize] = [color.r(), color.g(), color.b()];
        }
        Ok(())
    }
}
