//! Chart of edit times: one bar per edit, one colour per pass.

use std::fmt::Write;

use super::EditTime;
use super::table::{escaped, significant};

const WIDTH: f64 = 480.0;
const BARS: [f64; 2] = [8.0, 396.0];
/// Height of a row: a label, and the bar below it.
const ROW: f64 = 42.0;
const LEGEND_COLUMN: f64 = 236.0;
/// Number of colours in the style sheet.
const COLORS: usize = 12;

/// Returns the chart; `None` without edits.
pub(super) fn svg(title: &str, edits: &[EditTime]) -> Option<String> {
    let longest = edits.iter().map(|e| e.median_ms).fold(0.0, f64::max);
    if longest <= 0.0 {
        return None;
    }
    let mut names: Vec<&str> = Vec::new();
    for pass in edits.iter().flat_map(|e| &e.passes) {
        if !names.contains(&pass.name.as_str()) {
            names.push(&pass.name);
        }
    }
    let scale = (BARS[1] - BARS[0]) / longest;
    let bars_end = 34.0 + ROW * edits.len() as f64;
    let legend = |index: usize| [8.0 + LEGEND_COLUMN * (index % 2) as f64, bars_end + 30.0 + 20.0 * (index / 2) as f64];
    let height = legend(names.len())[1] + 14.0;
    let title = escaped(title);
    let mut svg = format!(
        "<svg class=wide viewBox=\"0 0 {WIDTH} {height}\" role=img aria-label=\"{title}\">\n\
         <text class=title x=8 y=20>{title}</text>\n"
    );
    for (row, edit) in edits.iter().enumerate() {
        let top = 34.0 + ROW * row as f64;
        let label = format!("{}, {}, {}", edit.edit.replace('_', " "), edit.light, edit.shadows);
        let _ = write!(svg, "<text x={} y={}>{}</text>", BARS[0], top + 14.0, escaped(&label));
        let bar = top + 19.0;
        let mut left = BARS[0];
        for pass in &edit.passes {
            let index = names.iter().position(|n| *n == pass.name).expect("collected above");
            // The pass medians can add up to more than the median of their sum.
            let width = (pass.median_ms * scale).min(BARS[0] + edit.median_ms * scale - left).max(0.0);
            let tip = format!("{} on the {}: {} ms", pass.name, pass.on, significant(pass.median_ms));
            let _ = write!(
                svg,
                "<rect class=f{} x={left:.1} y={bar} width={width:.1} height=17><title>{}</title></rect>",
                index % COLORS,
                escaped(&tip)
            );
            left += width;
        }
        let end = BARS[0] + edit.median_ms * scale;
        let rest = (end - left).max(0.0);
        let _ = write!(
            svg,
            "<rect class=rest x={left:.1} y={bar} width={rest:.1} height=17><title>the rest</title></rect>"
        );
        let total = significant(edit.median_ms);
        let _ = writeln!(svg, "<text x={:.1} y={}>{total} ms</text>", end + 6.0, bar + 13.0);
    }
    for (index, name) in names.iter().chain(&["the rest"]).enumerate() {
        let [x, y] = legend(index);
        let class = if index < names.len() { format!("f{}", index % COLORS) } else { "rest".into() };
        let _ = write!(svg, "<rect class={class} x={x} y={} width=14 height=14 />", y - 12.0);
        let _ = writeln!(svg, "<text x={} y={y}>{}</text>", x + 20.0, escaped(name));
    }
    Some(svg + "</svg>\n")
}
