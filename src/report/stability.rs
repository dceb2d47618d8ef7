//! How the sum over bounces behaves as surfaces get brighter, and how much of it precision costs.

use serde::{Deserialize, Serialize};

use super::conclusions::percent;
use super::larger;
use super::table::{Table, escaped, number, significant};

/// A scene painted evenly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stability {
    /// Of all its surfaces, which are matt.
    pub albedo: f64,
    /// Of our G.
    pub radius: f64,
    /// Of the thesis's, with as many gather samples.
    pub thesis_radius: f64,
    /// Of the solution over all bounces.
    pub residual: f64,
    /// Bounces after which a thousandth is left of all their light, root mean square; absent beyond [`MOST_BOUNCES`].
    pub bounces: Option<u32>,
    /// What the thesis's five leave out.
    pub left_after_five: f64,
    /// Error of pictures made in single precision, against double precision; relative, root mean square.
    pub single: f64,
    /// Of factors in half precision.
    pub half: f64,
}

/// As many were looked at.
pub const MOST_BOUNCES: u32 = 2000;

pub(super) fn table(rows: &[Stability]) -> Table {
    let columns = [
        "albedo",
        "spectral_radius",
        "thesis_spectral_radius",
        "residual",
        "bounces_to_a_thousandth",
        "left_after_five",
        "float32_error",
        "float16_error",
    ];
    let mut table = Table::new("stability.csv", &columns);
    for s in rows {
        let bounces = s.bounces.map_or_else(String::new, |b| b.to_string());
        let [albedo, radius, thesis] = [s.albedo, s.radius, s.thesis_radius].map(number);
        let [residual, left, single, half] = [s.residual, s.left_after_five, s.single, s.half].map(number);
        table.push([albedo, radius, thesis, residual, bounces, left, single, half]);
    }
    table
}

fn sentences(rows: &[Stability]) -> Vec<String> {
    let mut said = Vec::new();
    let over: Vec<&Stability> = rows.iter().filter(|s| s.radius > s.albedo * (1.0 + 1e-6)).collect();
    said.extend(rows.last().map(|last| match over.first() {
        None => format!(
            "Our spectral radius stays at or below the albedo in all of them, up to {}: the sum over all bounces exists.",
            last.albedo
        ),
        Some(first) => format!("Our spectral radius exceeds the albedo, first at {}: {}.", first.albedo, first.radius),
    }));
    let last_sum = rows.iter().rposition(|s| s.thesis_radius < 1.0);
    said.extend(rows.get(last_sum.map_or(0, |last| last + 1)).map(|first| {
        let radius = significant(first.thesis_radius);
        format!(
            "The thesis's series has no sum from an albedo of {} on, where its spectral radius is {radius}.",
            first.albedo
        )
    }));
    let mut within = rows.iter().filter_map(|s| Some((s, s.bounces?)));
    if let Some((least, first)) = within.next() {
        let (most, last) = within.next_back().unwrap_or((least, first));
        said.push(format!(
            "A thousandth of the light is left after {first} bounces at albedo {} and after {last} at {}; five bounces leave out {} there.",
            least.albedo,
            most.albedo,
            percent(most.left_after_five)
        ));
    }
    said.extend(rows.iter().find(|s| s.bounces.is_none()).map(|first| {
        format!("At an albedo of {} more than a thousandth is left after {MOST_BOUNCES} bounces.", first.albedo)
    }));
    let most = |of: fn(&Stability) -> f64| rows.iter().map(of).fold(0.0, larger);
    let (residual, single, half) = (most(|s| s.residual), most(|s| s.single), most(|s| s.half));
    said.extend(rows.first().map(|_| {
        format!(
            "The solution's residual is {residual:.0e} at most. Against double precision pictures in single precision are off by \
             {single:.0e} at most, with factors in half precision, as the device has them, by {half:.0e}."
        )
    }));
    said
}

/// A part of the page; empty without measurements.
pub(super) fn html(scene: &str, rows: &[Stability]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let items: String = sentences(rows).iter().map(|s| format!("<li>{}</li>\n", escaped(s))).collect();
    format!(
        "<h2 id=stability>Stability</h2>\n<p>All surfaces of {} matt and of one albedo, 576 gather samples of either method, under \
         the first of its lights.</p>\n<ul>{items}</ul>\n{}",
        escaped(scene),
        table(rows).html()
    )
}
