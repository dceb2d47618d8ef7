//! The report page: charts, tables and inline pictures, with all numbers also in CSV files and all conclusions computed
//! from them. The caller measures and fills in [`Report`]; this module runs nothing.

pub mod conclusions;
mod extreme;
pub mod growth;
mod page;
mod plot;
mod profile;
pub mod stability;
mod table;
pub mod thesis;

use std::path::Path;

use serde::{Deserialize, Serialize};

pub use self::table::{Table, significant};

use self::growth::Growth;
use self::stability::Stability;
use self::thesis::{GlossyAlone, Thesis};

use crate::error::{Error, Result};
use crate::storage::file::write_bytes;

/// The content of the page.
pub struct Report {
    /// Start and end of the measurement, UTC.
    pub when: String,
    /// Command that repeats the measurement.
    pub command: String,
    pub quick: bool,
    /// Names and values that describe the machine, in order of display.
    pub machine: Vec<[String; 2]>,
    pub scenes: Vec<SceneReport>,
    pub thesis: Thesis,
    pub glossy_alone: Option<GlossyAlone>,
    pub growth: Vec<Growth>,
    /// Name of the measured scene, and its rows.
    pub stability: (String, Vec<Stability>),
    /// Tables of extreme cases, Markdown as written by their tests.
    pub extreme: String,
    /// List of known limits, Markdown; independent of the measurement.
    pub known_limits: String,
}

/// Results for one scene.
pub struct SceneReport {
    pub name: String,
    pub triangles: usize,
    pub lights: usize,
    /// Size of the pictures whose errors are measured, pixels.
    pub size: [u32; 2],
    /// Samples per pixel of the ground truth, both halves together.
    pub truth_samples: u32,
    pub floors: Floors,
    pub points: Vec<Point>,
    /// Measurements that were planned but not made.
    pub skipped: Vec<Skipped>,
    pub pictures: Vec<Picture>,
    /// Size of the pictures in which edits are timed, pixels.
    pub edit_size: [u32; 2],
    pub edits: Vec<EditTime>,
    pub left_out: Vec<LeftOut>,
    /// Comparison with the complete deep framebuffer.
    pub ablation: Option<Ablation>,
}

impl SceneReport {
    /// Returns the table of its curves.
    fn table(&self) -> Table {
        table::points(format!("{}.errors.csv", self.name), &self.points)
    }
}

/// A method to compute the picture, and the parameter that varies along its curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    PathTracing,
    ThesisDiffuse,
    ThesisGlossy,
    GatherSamples,
    Rays,
    Compressed,
    Haar,
}

impl Method {
    pub const ALL: [Self; 7] = [
        Self::PathTracing,
        Self::ThesisDiffuse,
        Self::ThesisGlossy,
        Self::GatherSamples,
        Self::Rays,
        Self::Compressed,
        Self::Haar,
    ];

    /// Returns the name shown on the page.
    pub fn name(self) -> &'static str {
        match self {
            Self::PathTracing => "path tracing, more samples",
            Self::ThesisDiffuse => "thesis, diffuse, more gather samples",
            Self::ThesisGlossy => "thesis, glossy, more gather samples",
            Self::GatherSamples => "ours, more gather samples",
            Self::Rays => "ours, more rays",
            Self::Compressed => "ours, less compression",
            Self::Haar => "ours in Haar wavelets, more coefficients",
        }
    }

    /// Returns the identifier used in CSV files.
    pub fn id(self) -> &'static str {
        match self {
            Self::PathTracing => "path_tracing",
            Self::ThesisDiffuse => "thesis_diffuse",
            Self::ThesisGlossy => "thesis_glossy",
            Self::GatherSamples => "gather_samples",
            Self::Rays => "rays",
            Self::Compressed => "compressed",
            Self::Haar => "haar",
        }
    }

    pub fn is_ours(self) -> bool {
        matches!(self, Self::GatherSamples | Self::Rays | Self::Compressed)
    }
}

/// CPU time of all threads (user and system) and wall-clock time, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    pub cpu: f64,
    pub wall: f64,
}

/// One picture of a curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub method: Method,
    /// Command-line options, such as `--spp 16`.
    pub setting: String,
    /// Time of everything before the first picture, including BVH and deep framebuffer.
    pub precompute: Seconds,
    /// Time of a picture after a light has moved.
    pub frame: Seconds,
    /// Bytes that the device reads for indirect light.
    pub bytes: u64,
    /// Multiply-adds for the indirect light of all pixels.
    pub multiply_adds: u64,
    /// Relative error of a compressed operator against its own rows, under held-out point lights; mostly noise of these
    /// rows that compression removes.
    pub held_out: Option<f64>,
    pub spectral_radius: Option<f64>,
    pub load: f64,
    pub errors: Errors,
    /// Path of the picture, relative to the report's folder.
    pub file: String,
}

impl Point {
    /// Returns the CPU seconds to the first picture.
    pub fn total_cpu(&self) -> f64 {
        self.precompute.cpu + self.frame.cpu
    }
}

/// Errors of a picture against the ground truth. The noise of the ground truth cancels in all of them except FLIP.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Relative root mean square error of indirect light.
    pub indirect: f64,
    /// The same, on means of 4x4 pixels.
    pub indirect_4x4: f64,
    /// The same as `indirect`, without the worst 0.1 % of the pixels.
    pub indirect_trimmed: f64,
    /// Mean error of indirect light, divided by its mean.
    pub indirect_bias: f64,
    /// Relative root mean square error of the whole picture.
    pub whole: f64,
    /// Mean FLIP of the whole picture.
    pub flip: f64,
    /// Number of pixels that are infinite or NaN; the other errors exclude them.
    pub non_finite: usize,
}

/// Noise floors of the ground truth: smaller errors cannot be measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Floors {
    /// Standard deviation of [`Errors::indirect`] for a picture without error: the noise that remains after
    /// cancellation.
    pub indirect: f64,
    /// Relative noise of the mean of both halves, without cancellation.
    pub noise: f64,
    /// FLIP due to the noise of the mean: half of the FLIP between the two halves.
    pub flip: f64,
    /// Mean of the ground truth's indirect light, divided by its root mean square; converts a bias to units of
    /// [`Errors::indirect`].
    pub mean: f64,
}

/// A measurement that was planned but not made, and the reason.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Skipped {
    pub what: String,
    pub why: String,
}

/// A picture for the page, 8-bit sRGB.
pub struct Picture {
    pub caption: String,
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<[u8; 3]>,
}

/// Time from an edit until the picture is in host memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EditTime {
    pub edit: String,
    /// Kind of the light: point, spot or directional.
    pub light: String,
    pub lights: usize,
    /// Shadow method: traced, or a map.
    pub shadows: String,
    pub median_ms: f64,
    pub p95_ms: f64,
    pub best_ms: f64,
    /// Empty if the driver's pass times are wrong.
    pub passes: Vec<PassMs>,
}

/// Time of one pass of an edit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassMs {
    pub name: String,
    pub on: String,
    pub median_ms: f64,
    /// Time of a kernel with known work: for shading, the yardstick kernel over as many samples; for the transfer, its
    /// bytes at the bandwidth of a copy.
    pub yardstick_ms: Option<f64>,
}

/// Data or work that is omitted because the scene does not need it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    pub what: String,
    pub why: String,
    pub saves: String,
}

/// The picture with nothing omitted, compared with the usual picture. Pairs hold the usual value first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// Largest difference of a channel between the two pictures, divided by the picture's mean.
    pub difference: f64,
    /// Best time of moving a light with direct light alone, milliseconds.
    pub edit_ms: [f64; 2],
    /// Shading part of these times, milliseconds.
    pub shading_ms: [f64; 2],
    /// Device memory, bytes.
    pub bytes: [u64; 2],
}

/// Returns the larger number; NaN counts as larger than any.
pub fn larger(a: f64, b: f64) -> f64 {
    if b.is_nan() || b > a { b } else { a }
}

/// Writes `index.html` and the CSV files into `dir`, which must exist.
pub fn write(dir: &Path, report: &Report) -> Result<()> {
    for table in tables(report) {
        write_bytes(&dir.join(&table.file), table.csv().as_bytes())?;
    }
    let path = dir.join("index.html");
    let html = page::html(report).map_err(|source| Error::Export { path: path.clone(), source: source.into() })?;
    write_bytes(&path, html.as_bytes())
}

/// Returns all tables of the page.
pub fn tables(report: &Report) -> Vec<Table> {
    let mut machine = Table::new("machine.csv", &["what", "value"]);
    let how = [("measured", &report.when), ("command", &report.command)];
    how.into_iter().for_each(|(what, value)| machine.push([what.into(), value.clone()]));
    report.machine.iter().for_each(|row| machine.push(row.clone()));
    let scenes = report.scenes.iter();
    let mut tables = vec![machine, table::scenes(report)];
    tables.extend(scenes.clone().filter(|s| !s.points.is_empty()).map(SceneReport::table));
    tables.extend(scenes.clone().filter(|s| !s.edits.is_empty()).map(table::edits));
    tables.extend(scenes.filter(|s| !s.left_out.is_empty()).map(table::left_out));
    let others = [
        table::ablations(&report.scenes),
        table::skipped(&report.scenes),
        thesis::previews(&report.thesis.previews),
        thesis::transfers(&report.scenes),
    ];
    tables.extend(others.into_iter().filter(|table| !table.is_empty()));
    tables.extend(report.glossy_alone.iter().map(GlossyAlone::table));
    if !report.growth.is_empty() {
        tables.push(growth::table(&report.growth));
    }
    if !report.stability.1.is_empty() {
        tables.push(stability::table(&report.stability.1));
    }
    tables.extend(Some(extreme::table(&report.extreme)).filter(|table| !table.is_empty()));
    tables
}
