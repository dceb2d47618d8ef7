//! The thesis's Tables 5.1 and 5.2 [Yang 2007, Chapter 5], with columns for our measurements.

use serde::{Deserialize, Serialize};

use super::conclusions::curve;
use super::table::{self, Table, escaped, number, optional, significant};
use super::{Method, Picture, Point, SceneReport, Seconds};

/// A row of Table 5.1: a preview and a final picture, with direct light and reflections.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Preview {
    pub scene: String,
    pub triangles: usize,
    pub lights: usize,
    pub size: [u32; 2],
    /// Median time of the picture after a light has moved.
    pub preview_ms: f64,
    /// Time of our path tracer with 8 samples spread over each pixel, as in the thesis's Blender pictures.
    pub final_picture: Seconds,
}

/// Times of the thesis and of Blender for a scene with `lights` lights.
struct Printed {
    scene: &'static str,
    lights: usize,
    /// The thesis's preview, milliseconds (Pentium 4 at 3.4 GHz, GeForce 8800 GTX).
    preview_ms: &'static str,
    /// The thesis's final picture, seconds (Blender on the same machine, 8 samples per pixel).
    final_s: f64,
    /// Cycles (Blender 5.0.1), half of the CPU seconds on two current cores: at most 128 samples per pixel, adaptive
    /// threshold 0.01, denoised.
    cycles_s: f64,
}

const PRINTED: [Printed; 4] = [
    Printed { scene: "balls", lights: 2, preview_ms: "2 to 3", final_s: 18.39, cycles_s: 24.0 },
    Printed { scene: "balls", lights: 16, preview_ms: "2 to 3", final_s: 75.92, cycles_s: 33.0 },
    Printed { scene: "bunny-dragon", lights: 2, preview_ms: "2 to 4", final_s: 107.20, cycles_s: 70.0 },
    Printed { scene: "bunny-dragon", lights: 16, preview_ms: "2 to 4", final_s: 340.16, cycles_s: 94.0 },
];

/// Table 5.2: seconds for a 512x512 picture on an Athlon 64 X2 by path tracing with 1,024 samples per pixel, diffuse
/// transfer and glossy transfer from 2,304 gather samples.
const PRINTED_TRANSFERS: [(&str, [f64; 3]); 2] =
    [("cornell", [5321.0, 1001.0, 2494.0]), ("buddha", [4700.0, 913.0, 2308.0])];
const PRINTED_PIXELS: f64 = 512.0 * 512.0;
const PRINTED_SAMPLES: f64 = 1024.0;

/// Pictures of Figures 5.1 and 5.2, and the rows of Table 5.1.
#[derive(Default)]
pub struct Thesis {
    pub previews: Vec<Preview>,
    pub pictures: Vec<Picture>,
}

/// Figure 5.4: a scene without diffuse lobes, its indirect light times 4.
pub struct GlossyAlone {
    pub points: Vec<Point>,
    pub pictures: Vec<Picture>,
}

impl GlossyAlone {
    pub(super) fn table(&self) -> Table {
        table::points("figure-5.4.csv".into(), &self.points)
    }
}

impl Preview {
    fn printed(&self) -> Option<&'static Printed> {
        PRINTED.iter().find(|p| self.scene.starts_with(p.scene) && self.lights == p.lights)
    }
}

pub(super) fn previews(rows: &[Preview]) -> Table {
    let columns = [
        "scene",
        "triangles",
        "lights",
        "width",
        "height",
        "thesis_preview_ms",
        "preview_ms",
        "thesis_final_s",
        "final_cpu_s",
        "final_wall_s",
        "cycles_half_cpu_s",
    ];
    let mut table = Table::new("table-5.1.csv", &columns);
    for row in rows {
        let counts = [row.triangles, row.lights, row.size[0] as usize, row.size[1] as usize].map(|c| c.to_string());
        let printed = row.printed();
        let times = [
            printed.map_or_else(String::new, |p| p.preview_ms.into()),
            number(row.preview_ms),
            optional(printed.map(|p| p.final_s)),
            number(row.final_picture.cpu),
            number(row.final_picture.wall),
            optional(printed.map(|p| p.cycles_s)),
        ];
        table.push(std::iter::once(row.scene.clone()).chain(counts).chain(times));
    }
    table
}

/// Returns the rows of Table 5.2 that the scenes' curves contain.
pub(super) fn transfers(scenes: &[SceneReport]) -> Table {
    let columns = [
        "scene",
        "method",
        "thesis_s",
        "setting",
        "measured_cpu_s",
        "width",
        "height",
        "with_1024_samples_at_512x512_cpu_s",
        "indirect_rel_rmse",
    ];
    let mut table = Table::new("table-5.2.csv", &columns);
    for scene in scenes {
        let Some((_, printed)) = PRINTED_TRANSFERS.iter().find(|(name, _)| scene.name.starts_with(name)) else {
            continue;
        };
        let pixels = f64::from(scene.size[0]) * f64::from(scene.size[1]);
        let rows = [
            (Method::PathTracing, Some(printed[0])),
            (Method::ThesisDiffuse, Some(printed[1])),
            (Method::ThesisGlossy, Some(printed[2])),
            (Method::GatherSamples, None),
        ];
        for (method, printed) in rows {
            let Some(point) = curve(scene, method).pop() else { continue };
            let samples = point.setting.strip_prefix("--spp ").and_then(|n| n.parse::<f64>().ok());
            // Picture time is proportional to pixels and samples; bake time is not.
            let scaled =
                samples.map(|n| point.precompute.cpu + point.frame.cpu * PRINTED_PIXELS / pixels * PRINTED_SAMPLES / n);
            let cpu = number(point.total_cpu());
            let head = [scene.name.clone(), method.id().into(), optional(printed), point.setting.clone(), cpu];
            let size = scene.size.map(|side| side.to_string());
            table.push(head.into_iter().chain(size).chain([optional(scaled), number(point.errors.indirect)]));
        }
    }
    table
}

fn sentences(rows: &[Preview]) -> Vec<String> {
    let of_row = |row: &Preview| {
        let ratio = row.final_picture.wall * 1e3 / row.preview_ms;
        format!(
            "{}: the preview after an edit takes {} ms; a final picture takes {} s on the same machine, {} times as \
             long.",
            row.scene,
            significant(row.preview_ms),
            significant(row.final_picture.wall),
            significant(ratio)
        )
    };
    let pairs = rows.iter().filter(|row| row.lights == 2).filter_map(|two| {
        let name = two.scene.trim_end_matches("-2");
        Some((name, two, rows.iter().find(|row| row.lights == 16 && row.scene.trim_end_matches("-16") == name)?))
    });
    let more_lights = pairs.map(|(name, two, sixteen)| {
        format!(
            "{name}: with 16 lights a preview takes {} times as long as with 2, a final picture {} times (CPU time).",
            significant(sixteen.preview_ms / two.preview_ms),
            significant(sixteen.final_picture.cpu / two.final_picture.cpu)
        )
    });
    rows.iter().map(of_row).chain(more_lights).collect()
}

/// Returns the HTML section without its pictures; empty without measurements.
pub(super) fn html(thesis: &Thesis, scenes: &[SceneReport], glossy_alone: Option<&GlossyAlone>) -> String {
    let mut html = String::new();
    if !thesis.previews.is_empty() {
        let items: String = sentences(&thesis.previews).iter().map(|s| format!("<li>{}</li>\n", escaped(s))).collect();
        html += &format!(
            "<h3>Table 5.1: direct light and reflections</h3>\n<ul>{items}</ul>\n<p>A preview is the picture after a \
             light has moved. A final picture is rendered by our path tracer with direct light and mirrors, 8 samples \
             spread over each pixel. The thesis's final pictures were rendered by Blender on a Pentium 4; both are \
             720×480. The last column is half of the CPU seconds of Cycles (Blender 5.0.1) for the scene on two \
             current cores, at most 128 samples per pixel, adaptive threshold 0.01, denoised.</p>\n{}",
            previews(&thesis.previews).html()
        );
    }
    let transfers = transfers(scenes);
    if !transfers.is_empty() {
        html += &format!(
            "<h3>Table 5.2: indirect light</h3>\n<p>The last picture of each curve above, in CPU seconds including the \
             bake. The time of path tracing is proportional to pixels and samples, so it is also scaled to 512×512 \
             pixels with 1,024 samples each. The thesis's seconds are those of an Athlon 64 X2 at 2.2 GHz for 512×512 \
             pixels, with 2,304 gather samples.</p>\n{}",
            transfers.html()
        );
    }
    if let Some(alone) = glossy_alone {
        html += &format!(
            "<h3>Figure 5.4: indirect light by glossy lobes alone</h3>\n<p>The ground truth and the pictures are \
             below.</p>\n{}",
            alone.table().html()
        );
    }
    if html.is_empty() { html } else { format!("<h2 id=thesis>Comparison with the thesis</h2>\n{html}") }
}
