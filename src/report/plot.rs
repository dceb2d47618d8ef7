//! Charts as SVG. The style sheet sets the colours of series through the classes `s0`, `s1`, ...

use std::fmt::Write;

use super::table::{escaped, grouped};

/// A chart with two logarithmic axes.
pub(super) struct Chart {
    pub title: String,
    pub x_label: String,
    pub y_label: &'static str,
    pub series: Vec<Series>,
    /// Value and label of a horizontal line.
    pub floor: Option<(f64, &'static str)>,
}

pub(super) struct Series {
    pub name: String,
    /// Index of colour and marker.
    pub style: usize,
    pub points: Vec<[f64; 2]>,
    /// Tooltip of each point.
    pub tips: Vec<String>,
}

const WIDTH: f64 = 480.0;
const PLOT: [f64; 4] = [82.0, 34.0, 462.0, 314.0]; // left, top, right, bottom
const LEGEND_LINE: f64 = 19.0;

/// One logarithmic axis.
struct Axis {
    /// Decimal logarithms of the end values.
    ends: [f64; 2],
    /// Positions of the ends, pixels.
    at: [f64; 2],
}

impl Axis {
    fn new(values: impl Iterator<Item = f64> + Clone, at: [f64; 2]) -> Self {
        let least = values.clone().fold(f64::INFINITY, f64::min).log10() - 0.08;
        let most = values.fold(f64::NEG_INFINITY, f64::max).log10() + 0.08;
        // The axis spans at least one decade; on a shorter axis noise looks like a trend.
        let pad = (1.0 - (most - least)).max(0.0) / 2.0;
        Self { ends: [least - pad, most + pad], at }
    }

    fn place(&self, value: f64) -> f64 {
        let share = (value.log10() - self.ends[0]) / (self.ends[1] - self.ends[0]);
        self.at[0] + share * (self.at[1] - self.at[0])
    }

    /// Returns the values with a label, and the values with a grid line.
    fn ticks(&self) -> (Vec<f64>, Vec<f64>) {
        let decades = self.ends[0].floor() as i32..=self.ends[1].ceil() as i32;
        let within = |value: &f64| (self.ends[0]..=self.ends[1]).contains(&value.log10());
        let of = |steps: &[f64]| -> Vec<f64> {
            let all = decades.clone().flat_map(|d| steps.iter().map(move |s| s * 10f64.powi(d)));
            all.filter(within).collect()
        };
        let span = self.ends[1] - self.ends[0];
        let labelled: &[f64] = if span < 2.6 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let fine: &[f64] = if span < 4.5 { &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0] } else { &[1.0] };
        (of(labelled), of(fine))
    }
}

impl Chart {
    /// Returns the SVG; `None` without points.
    pub fn svg(&self) -> Option<String> {
        let points = || self.series.iter().flat_map(|s| &s.points).copied();
        points().next()?;
        let [left, top, right, bottom] = PLOT;
        let x = Axis::new(points().map(|p| p[0]), [left, right]);
        let floor = || self.floor.iter().map(|f| f.0).filter(|f| *f > 0.0);
        let y = Axis::new(points().map(|p| p[1]).chain(floor()), [bottom, top]);
        let series = || self.series.iter().filter(|s| !s.points.is_empty());
        let height = bottom + 50.0 + LEGEND_LINE * series().count() as f64;
        let title = escaped(&self.title);
        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {height}\" role=img aria-label=\"{title}\">\n<text class=title x={left} \
             y=20>{title}</text>\n"
        );
        self.draw_axes(&mut svg, &x, &y);
        if let Some((value, text)) = self.floor.filter(|f| f.0 > 0.0) {
            let at = y.place(value);
            // The label is above the line if there is room, else below.
            let text_at = if at < top + 18.0 { at + 15.0 } else { at - 5.0 };
            svg += &format!(
                "<path class=floor d=\"M{left} {at:.1}H{right}\"/><text class=small x={} \
                 y={text_at:.1}>{text}</text>\n",
                left + 5.0
            );
        }
        for (line, series) in series().enumerate() {
            draw_series(&mut svg, series, &x, &y);
            let at = bottom + 54.0 + LEGEND_LINE * line as f64;
            svg += &format!("<path class=\"line s{}\" d=\"M{left} {at}h26\"/>", series.style);
            svg += &mark(series.style, [left + 13.0, at], "");
            svg += &format!("<text x={} y={}>{}</text>\n", left + 34.0, at + 4.5, escaped(&series.name));
        }
        Some(svg + "</svg>\n")
    }

    fn draw_axes(&self, svg: &mut String, x: &Axis, y: &Axis) {
        let [left, top, right, bottom] = PLOT;
        let (x_labels, x_lines) = x.ticks();
        let (y_labels, y_lines) = y.ticks();
        for value in x_lines {
            let _ = write!(svg, "<path class=grid d=\"M{:.1} {top}V{bottom}\"/>", x.place(value));
        }
        for value in y_lines {
            let _ = write!(svg, "<path class=grid d=\"M{left} {:.1}H{right}\"/>", y.place(value));
        }
        // Labels that would overlap the previous one are omitted.
        let mut free_from = 0.0;
        for value in x_labels {
            let (at, text) = (x.place(value), short(value));
            let half = 4.2 * text.len() as f64;
            if at - half >= free_from && at + half <= WIDTH {
                let _ = write!(svg, "<text class=tick text-anchor=middle x={at:.1} y={}>{text}</text>", bottom + 17.0);
                free_from = at + half + 4.0;
            }
        }
        for value in y_labels {
            let at = y.place(value) + 4.5;
            let _ = write!(svg, "<text class=tick text-anchor=end x={} y={at:.1}>{}</text>", left - 6.0, short(value));
        }
        let (middle, center) = ((top + bottom) / 2.0, (left + right) / 2.0);
        let _ = writeln!(
            svg,
            "<path class=frame d=\"M{left} {top}V{bottom}H{right}\"/>\n\
             <text text-anchor=middle x={center} y={}>{}</text>\n\
             <text text-anchor=middle transform=\"translate(14 {middle}) rotate(-90)\">{}</text>",
            bottom + 36.0,
            escaped(&self.x_label),
            self.y_label
        );
    }
}

fn draw_series(svg: &mut String, series: &Series, x: &Axis, y: &Axis) {
    let places: Vec<[f64; 2]> = series.points.iter().map(|p| [x.place(p[0]), y.place(p[1])]).collect();
    let line: Vec<String> = places.iter().map(|p| format!("{:.1} {:.1}", p[0], p[1])).collect();
    let _ = write!(svg, "<path class=\"line s{}\" d=\"M{}\"/>", series.style, line.join("L"));
    for (place, tip) in places.iter().zip(&series.tips) {
        *svg += &mark(series.style, *place, tip);
    }
    svg.push('\n');
}

/// Returns a marker. Markers differ in shape as well as colour, for colour-blind readers.
fn mark(style: usize, [x, y]: [f64; 2], tip: &str) -> String {
    let path = match style % 7 {
        0 => "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z",
        1 => "M-4 -4h8v8h-8z",
        2 => "M0 -5l5 9h-10z",
        3 => "M0 -5.5l5 5.5l-5 5.5l-5 -5.5z",
        4 => "M0 5l5 -9h-10z",
        5 => "M-5 -2h3v-3h4v3h3v4h-3v3h-4v-3h-3z",
        _ => "M0 -6l1.8 4.2l4.2 1.8l-4.2 1.8l-1.8 4.2l-1.8 -4.2l-4.2 -1.8l4.2 -1.8z",
    };
    let tip = if tip.is_empty() { String::new() } else { format!("<title>{}</title>", escaped(tip)) };
    format!("<path class=\"mark s{style}\" transform=\"translate({x:.1} {y:.1})\" d=\"{path}\">{tip}</path>")
}

/// Formats a tick label in at most seven characters, which fit the margin.
fn short(value: f64) -> String {
    let exponent = (value.log10() + 1e-9).floor() as i32;
    match exponent {
        -4..=5 => grouped(&format!("{value:.*}", (-exponent).max(0) as usize)),
        _ => format!("{value:.0e}"),
    }
}
