//! Tables of numbers, shared by the page and the CSV files.

use super::{Point, Report, SceneReport};

/// A table of the page, also written as a CSV file.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    pub file: String,
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new(file: impl Into<String>, columns: &[&str]) -> Self {
        Self { file: file.into(), columns: columns.iter().map(|&c| c.into()).collect(), rows: Vec::new() }
    }

    /// Adds a row. Panics unless it has one value per column.
    pub fn push(&mut self, row: impl IntoIterator<Item = String>) {
        let row: Vec<String> = row.into_iter().collect();
        assert_eq!(row.len(), self.columns.len(), "values of a row of {}", self.file);
        self.rows.push(row);
    }

    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Formats the table as CSV: RFC 4180, except that lines end in `\n`.
    pub fn csv(&self) -> String {
        let line = |cells: &Vec<String>| cells.iter().map(|cell| quoted(cell)).collect::<Vec<_>>().join(",") + "\n";
        std::iter::once(&self.columns).chain(&self.rows).map(line).collect()
    }

    pub fn html(&self) -> String {
        // A table of two columns is a list of names and values; its numbers are not aligned.
        let cell = |tag: &str, text: &str| {
            let number = self.columns.len() > 2 && text.parse::<f64>().is_ok();
            let class = match text.starts_with("--") {
                _ if number => " class=n",
                true => " class=options",
                false => "",
            };
            let text = if number { rounded(text) } else { escaped(text) };
            format!("<{tag}{class}>{text}</{tag}>")
        };
        let row = |tag: &'static str, cells: &Vec<String>| {
            format!("<tr>{}</tr>\n", cells.iter().map(|text| cell(tag, text)).collect::<String>())
        };
        let body: String = self.rows.iter().map(|cells| row("td", cells)).collect();
        let head = row("th", &self.columns.iter().map(|c| c.replace('_', " ")).collect());
        format!(
            "<div class=scroll><table><thead>{head}</thead><tbody>{body}</tbody></table></div>\n\
             <p class=source><a href=\"{0}\">{0}</a></p>\n",
            escaped(&self.file)
        )
    }
}

fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.into() }
}

/// Escapes text for HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn rounded(text: &str) -> String {
    match text.parse::<f64>() {
        Ok(value) if text.contains(['.', 'e']) => significant(value),
        _ => grouped(text),
    }
}

/// Inserts thousands separators: "1234567.89" becomes "1,234,567.89".
pub(super) fn grouped(digits: &str) -> String {
    let (sign, digits) = digits.split_at(usize::from(digits.starts_with('-')));
    let whole = digits.find('.').unwrap_or(digits.len());
    let comma = |i: usize| i > 0 && i < whole && (whole - i).is_multiple_of(3);
    let grouped = digits.char_indices().flat_map(|(i, c)| [comma(i).then_some(','), Some(c)]);
    format!("{sign}{}", grouped.flatten().collect::<String>())
}

/// Formats a number with three significant digits.
pub fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let exponent = value.abs().log10().floor() as i32;
    match exponent {
        3.. => grouped(&format!("{:.0}", value)),
        -4..3 => format!("{:.*}", (2 - exponent).max(0) as usize, value),
        _ => format!("{value:.2e}"),
    }
}

pub(super) fn number(value: f64) -> String {
    format!("{value:.5e}").parse::<f64>().map_or_else(|_| String::new(), |short| format!("{short:?}"))
}

pub(super) fn optional(value: Option<f64>) -> String {
    value.map_or_else(String::new, number)
}

pub(super) fn scenes(report: &Report) -> Table {
    let columns = [
        "scene",
        "triangles",
        "lights",
        "width",
        "height",
        "truth_samples",
        "floor_indirect_rel_rmse",
        "truth_noise_rel_rmse",
        "floor_flip",
    ];
    let mut table = Table::new("scenes.csv", &columns);
    for s in &report.scenes {
        let counts = [s.triangles, s.lights, s.size[0] as usize, s.size[1] as usize, s.truth_samples as usize];
        let floors = [s.floors.indirect, s.floors.noise, s.floors.flip].map(number);
        table.push(std::iter::once(s.name.clone()).chain(counts.map(|c| c.to_string())).chain(floors));
    }
    table
}

/// Returns the measurements of pictures, as a table for `file`.
pub(super) fn points(file: String, points: &[Point]) -> Table {
    let columns = [
        "method",
        "setting",
        "precompute_cpu_s",
        "precompute_wall_s",
        "frame_cpu_s",
        "frame_wall_s",
        "bytes",
        "multiply_adds",
        "indirect_rel_rmse",
        "indirect_4x4",
        "indirect_trimmed",
        "indirect_bias",
        "whole_rel_rmse",
        "flip",
        "non_finite",
        "held_out",
        "spectral_radius",
        "load",
        "picture",
    ];
    let mut table = Table::new(file, &columns);
    for p in points {
        let e = p.errors;
        let times = [p.precompute.cpu, p.precompute.wall, p.frame.cpu, p.frame.wall].map(number);
        let errors = [e.indirect, e.indirect_4x4, e.indirect_trimmed, e.indirect_bias, e.whole, e.flip].map(number);
        let head = [p.method.id().to_owned(), p.setting.clone()];
        let costs = [p.bytes, p.multiply_adds].map(|count| count.to_string());
        let non_finite = e.non_finite.to_string();
        let rest = [non_finite, optional(p.held_out), optional(p.spectral_radius), number(p.load), p.file.clone()];
        table.push(head.into_iter().chain(times).chain(costs).chain(errors).chain(rest));
    }
    table
}

pub(super) fn edits(scene: &SceneReport) -> Table {
    let columns = [
        "edit",
        "light",
        "lights",
        "shadows",
        "pass",
        "on",
        "median_ms",
        "p95_ms",
        "best_ms",
        "yardstick_ms",
        "yardstick_over_pass",
    ];
    let mut table = Table::new(format!("{}.edits.csv", scene.name), &columns);
    for e in &scene.edits {
        let head = || [e.edit.clone(), e.light.clone(), e.lights.to_string(), e.shadows.clone()].into_iter();
        let none = String::new;
        let whole = ["all".into(), none(), number(e.median_ms), number(e.p95_ms), number(e.best_ms), none(), none()];
        table.push(head().chain(whole));
        for p in &e.passes {
            let share = p.yardstick_ms.map(|yardstick| yardstick / p.median_ms);
            let pass = [p.name.clone(), p.on.clone(), number(p.median_ms), none(), none()];
            table.push(head().chain(pass).chain([optional(p.yardstick_ms), optional(share)]));
        }
    }
    table
}

/// Returns the savings from omitted data, by scene.
pub(super) fn ablations(scenes: &[SceneReport]) -> Table {
    let columns = [
        "scene",
        "largest_difference_over_mean",
        "edit_ms",
        "edit_ms_nothing_left_out",
        "shading_ms",
        "shading_ms_nothing_left_out",
        "bytes",
        "bytes_nothing_left_out",
    ];
    let mut table = Table::new("ablation.csv", &columns);
    for (scene, a) in scenes.iter().filter_map(|s| Some((s, s.ablation?))) {
        let times = [a.difference, a.edit_ms[0], a.edit_ms[1], a.shading_ms[0], a.shading_ms[1]].map(number);
        table.push(std::iter::once(scene.name.clone()).chain(times).chain(a.bytes.map(|bytes| bytes.to_string())));
    }
    table
}

pub(super) fn skipped(scenes: &[SceneReport]) -> Table {
    let mut table = Table::new("not-measured.csv", &["scene", "what", "why"]);
    for (scene, skipped) in scenes.iter().flat_map(|s| s.skipped.iter().map(move |skipped| (s, skipped))) {
        table.push([scene.name.clone(), skipped.what.clone(), skipped.why.clone()]);
    }
    table
}

pub(super) fn left_out(scene: &SceneReport) -> Table {
    let mut table = Table::new(format!("{}.left-out.csv", scene.name), &["what", "why", "saves"]);
    scene.left_out.iter().for_each(|item| table.push([item.what.clone(), item.why.clone(), item.saves.clone()]));
    table
}
