//! Convergence of the sum over bounces as albedo increases, and the error of reduced precision.

use serde::{Deserialize, Serialize};

use super::conclusions::percent;
use super::larger;
use super::table::{Table, escaped, number, significant};

/// Results for a scene whose surfaces are all diffuse with one albedo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stability {
    /// Albedo of all surfaces.
    pub albedo: f64,
    /// Spectral radius of our G.
    pub radius: f64,
    /// Spectral radius of the thesis's G, with as many gather samples.
    pub thesis_radius: f64,
    /// Residual of the solution over all bounces.
    pub residual: f64,
    /// Number of bounces after which at most a thousandth of the light remains, root mean square; `None` if more than
    /// [`MOST_BOUNCES`].
    pub bounces: Option<u32>,
    /// Share of the light that is missing after the thesis's five bounces.
    pub left_after_five: f64,
    /// Relative root mean square error of pictures in single precision, against double precision.
    pub single: f64,
    /// The same, with factors in half precision.
    pub half: f64,
}

/// Largest number of bounces that is tested.
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
            "Our spectral radius never exceeds the albedo, up to {}: the sum over all bounces converges.",
            last.albedo
        ),
        Some(first) => format!("Our spectral radius exceeds the albedo, first at {}: {}.", first.albedo, first.radius),
    }));
    let last_sum = rows.iter().rposition(|s| s.thesis_radius < 1.0);
    said.extend(rows.get(last_sum.map_or(0, |last| last + 1)).map(|first| {
        let radius = significant(first.thesis_radius);
        format!(
            "The thesis's series diverges from an albedo of {} on, where its spectral radius is {radius}.",
            first.albedo
        )
    }));
    let mut within = rows.iter().filter_map(|s| Some((s, s.bounces?)));
    if let Some((least, first)) = within.next() {
        let (most, last) = within.next_back().unwrap_or((least, first));
        said.push(format!(
            "A thousandth of the light remains after {first} bounces at albedo {} and after {last} at {}; five bounces \
             omit {} there.",
            least.albedo,
            most.albedo,
            percent(most.left_after_five)
        ));
    }
    said.extend(rows.iter().find(|s| s.bounces.is_none()).map(|first| {
        format!("At an albedo of {} more than a thousandth remains after {MOST_BOUNCES} bounces.", first.albedo)
    }));
    let most = |of: fn(&Stability) -> f64| rows.iter().map(of).fold(0.0, larger);
    let (residual, single, half) = (most(|s| s.residual), most(|s| s.single), most(|s| s.half));
    said.extend(rows.first().map(|_| {
        format!(
            "The residual of the solution is at most {residual:.0e}. Compared with double precision, pictures in \
             single precision have an error of at most {single:.0e}; with factors in half precision, as on the device, \
             at most {half:.0e}."
        )
    }));
    said
}

/// Returns the HTML section; empty without measurements.
pub(super) fn html(scene: &str, rows: &[Stability]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let items: String = sentences(rows).iter().map(|s| format!("<li>{}</li>\n", escaped(s))).collect();
    format!(
        "<h2 id=stability>Stability</h2>\n<p>All surfaces of {} are diffuse with one albedo. Both methods use 576 \
         gather samples and the first light of the scene.</p>\n<ul>{items}</ul>\n{}",
        escaped(scene),
        table(rows).html()
    )
}
