//! A page of what was measured, for a reader who believes nothing: charts, tables and pictures inline, every number beside
//! it as CSV, every sentence of conclusion computed from them. Who measures fills in [`Report`]; nothing here runs anything.

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

/// Everything that the page tells.
pub struct Report {
    /// When it was measured, UTC: from, to.
    pub when: String,
    /// How to measure it again.
    pub command: String,
    pub quick: bool,
    /// Name and value, in order.
    pub machine: Vec<[String; 2]>,
    pub scenes: Vec<SceneReport>,
    pub thesis: Thesis,
    pub glossy_alone: Option<GlossyAlone>,
    pub growth: Vec<Growth>,
    /// Of a scene, by its name.
    pub stability: (String, Vec<Stability>),
    /// Tables of extreme cases, in Markdown as their tests write it.
    pub extreme: String,
    /// What holds whatever was measured, in Markdown: the list of known limits.
    pub known_limits: String,
}

/// One scene.
pub struct SceneReport {
    pub name: String,
    pub triangles: usize,
    pub lights: usize,
    /// Of the pictures whose errors are told.
    pub size: [u32; 2],
    /// Samples a pixel of the truth, both halves together.
    pub truth_samples: u32,
    pub floors: Floors,
    pub points: Vec<Point>,
    /// What was to be measured and was not.
    pub skipped: Vec<Skipped>,
    pub pictures: Vec<Picture>,
    /// Of the pictures in which edits were timed.
    pub edit_size: [u32; 2],
    pub edits: Vec<EditTime>,
    pub left_out: Vec<LeftOut>,
    /// The picture with nothing left out against the one that is shown.
    pub ablation: Option<Ablation>,
}

impl SceneReport {
    /// Its curves.
    fn table(&self) -> Table {
        table::points(format!("{}.errors.csv", self.name), &self.points)
    }
}

/// A way to a picture, and what grows along its curve.
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

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::PathTracing => "path tracing, more samples",
            Self::ThesisDiffuse => "thesis, diffuse, more gather samples",
            Self::ThesisGlossy => "thesis, glossy, more gather samples",
            Self::GatherSamples => "ours, more gather samples",
            Self::Rays => "ours, more rays",
            Self::Compressed => "ours, compressed less",
            Self::Haar => "ours in Haar wavelets, more of them",
        }
    }

    /// For programs.
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

/// Processor time of all threads, user and system, and time on the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    pub cpu: f64,
    pub wall: f64,
}

/// One picture of a curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub method: Method,
    /// In the options of the command line, `--spp 16`.
    pub setting: String,
    /// Everything before the first picture, BVH and deep framebuffer included.
    pub precompute: Seconds,
    /// A picture after a light has moved.
    pub frame: Seconds,
    /// What the device reads for indirect light.
    pub bytes: u64,
    /// Multiply-adds for indirect light, of all pixels.
    pub multiply_adds: u64,
    /// Relative error of a compressed operator against its own rows, under points that it has not learned from: mostly noise of
    /// these rows that it leaves out.
    pub held_out: Option<f64>,
    pub spectral_radius: Option<f64>,
    pub load: f64,
    pub errors: Errors,
    /// The picture itself, under the report's folder.
    pub file: String,
}

impl Point {
    /// CPU seconds to the first picture.
    pub fn total_cpu(&self) -> f64 {
        self.precompute.cpu + self.frame.cpu
    }
}

/// How far a picture is from the truth, free of the truth's noise but for FLIP.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Of indirect light, relative root mean square.
    pub indirect: f64,
    /// The same on means of 4x4 pixels.
    pub indirect_4x4: f64,
    /// The same as `indirect` without the worst 0.1 % of the pixels.
    pub indirect_trimmed: f64,
    /// Mean error over mean, of indirect light.
    pub indirect_bias: f64,
    /// Of the whole picture.
    pub whole: f64,
    /// Mean FLIP of the whole picture.
    pub flip: f64,
    /// Pixels that are infinite or not a number; no other figure counts them.
    pub non_finite: usize,
}

/// Below these the truth tells nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Floors {
    /// Standard deviation of a vanishing [`Errors::indirect`]: what is left of the truth's noise once it cancels.
    pub indirect: f64,
    /// Noise of the truth's mean itself, relative, were it not cancelled.
    pub noise: f64,
    /// What the noise of the truth's mean does to FLIP: half of what its halves have against each other.
    pub flip: f64,
    /// Mean of the truth's indirect light over its root mean square: a bias times it is in units of [`Errors::indirect`].
    pub mean: f64,
}

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

/// What an edit takes until the picture is in host memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EditTime {
    pub edit: String,
    /// Point, spot or directional.
    pub light: String,
    pub lights: usize,
    /// Traced, or as a map.
    pub shadows: String,
    pub median_ms: f64,
    pub p95_ms: f64,
    pub best_ms: f64,
    /// Empty where the driver's times of passes are wrong.
    pub passes: Vec<PassMs>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassMs {
    pub name: String,
    pub on: String,
    pub median_ms: f64,
    /// What a kernel of known work takes: for shading the yardstick over as many samples, for the transfer its bytes at the rate
    /// at which a copy reads and writes.
    pub yardstick_ms: Option<f64>,
}

/// Something that a scene does not need.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    pub what: String,
    pub why: String,
    pub saves: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// Largest difference of a channel between the two pictures, over the picture's mean.
    pub difference: f64,
    /// Milliseconds of moving a light, direct light alone, best: as it is, and with nothing left out.
    pub edit_ms: [f64; 2],
    /// Of these, shading.
    pub shading_ms: [f64; 2],
    /// Device memory.
    pub bytes: [u64; 2],
}

/// The larger of two; what is not a number is larger than any.
pub fn larger(a: f64, b: f64) -> f64 {
    if b.is_nan() || b > a { b } else { a }
}

/// Writes `index.html` and the CSV files into `dir`, which exists.
pub fn write(dir: &Path, report: &Report) -> Result<()> {
    for table in tables(report) {
        write_bytes(&dir.join(&table.file), table.csv().as_bytes())?;
    }
    let path = dir.join("index.html");
    let html = page::html(report).map_err(|source| Error::Export { path: path.clone(), source: source.into() })?;
    write_bytes(&path, html.as_bytes())
}

/// Every number of the page.
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
