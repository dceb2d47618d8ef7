//! The report page: one self-contained HTML file without scripts.

use std::fmt::Write;

use base64::Engine;

use super::conclusions::{self, curve};
use super::plot::{Chart, Series};
use super::table::{escaped, significant};
use super::{Method, Picture, Point, Report, SceneReport, extreme, growth, profile, stability, table, tables, thesis};
use crate::image::png;

/// Returns the page as HTML.
pub(super) fn html(report: &Report) -> Result<String, ::png::EncodingError> {
    let scenes = report.scenes.iter().map(scene).collect::<Result<String, _>>()?;
    let glossy_alone = report.glossy_alone.iter().flat_map(|alone| &alone.pictures);
    let figures = report.thesis.pictures.iter().chain(glossy_alone).map(figure).collect::<Result<String, _>>()?;
    let thesis_comparison = thesis::html(&report.thesis, &report.scenes, report.glossy_alone.as_ref());
    let machine = tables(report).swap_remove(0).html();
    let quick = if report.quick { " This is the quick version, with small pictures and short curves." } else { "" };
    let parts = [
        ("thesis", thesis_comparison.is_empty()),
        ("scaling", report.growth.is_empty()),
        ("stability", report.stability.1.is_empty()),
        ("extreme", report.extreme.is_empty()),
    ];
    let parts = parts.into_iter().filter(|part| !part.1).map(|part| part.0);
    let contents: String = report
        .scenes
        .iter()
        .map(|s| s.name.as_str())
        .chain(parts)
        .map(|n| format!("<a href=\"#{0}\">{0}</a> ", escaped(n)))
        .collect();
    Ok(format!(
        "<!doctype html>\n<html lang=en><head><meta charset=utf-8>\
         <meta name=viewport content=\"width=device-width,initial-scale=1\">\
         <meta name=color-scheme content=\"light dark\"><title>relume: error against run time</title>\n\
         <style>\n{style}</style></head>\n<body><main>\n\
         <h1>relume: error against run time</h1>\n\
         <p>Measured {when} by <code>{command}</code>.{quick} All numbers are in the CSV files next to this page; the \
         pictures whose errors are measured are EXR files. Every sentence under “Conclusions” is computed from these \
         numbers. Seconds are CPU time of all threads, user and system, plus GPU time; wall-clock times are in the CSV \
         files.</p>\n<p class=contents>{contents}<a href=\"#method\">How it was measured</a> <a href=\"#limits\">Known \
         limits</a></p>\n\
         <h2>Machine</h2>\n{machine}{scenes}{thesis_comparison}{figures}{growth}{stability}{extreme}{method}\
         <h2 id=limits>Known limits</h2>\n{limits}</main></body></html>\n",
        style = include_str!("style.css"),
        when = escaped(&report.when),
        command = escaped(&report.command),
        growth = growth::html(&report.growth),
        stability = stability::html(report.stability.0.as_str(), &report.stability.1),
        extreme = extreme::html(&report.extreme),
        method = METHOD,
        limits = list(&report.known_limits),
    ))
}

const METHOD: &str = "<h2 id=method>How it was measured</h2>\n\
    <p>The ground truth is rendered by our own path tracer in two halves a and b with independent noise, through the \
    pixel centres as in the deep framebuffer. Every squared error of a picture x is computed as (x - a)(x - b), so \
    that their noise cancels except for the floor that the charts show. FLIP is computed against the mean of the \
    halves, whose noise does not cancel: its line is half of the FLIP between the halves. Relative errors are those of \
    indirect light alone, since direct light and reflections are the same for all methods; FLIP is computed on the \
    whole picture. Shadows are traced. The time to the first picture includes BVH, deep framebuffer, the complete \
    bake, upload and one frame. It excludes the BRDF tables that all scenes share, which are computed before. The time \
    after an edit is that of a picture after a light has moved. For path tracing that is the whole picture \
    again.</p>\n";

fn scene(scene: &SceneReport) -> Result<String, ::png::EncodingError> {
    let [width, height] = scene.size;
    let mut html = format!(
        "<h2 id=\"{name}\">{name}</h2>\n<p>{triangles} triangles, {lights} light{s}; errors at {width}×{height} \
         against a ground truth with {samples} samples per pixel.</p>\n",
        name = escaped(&scene.name),
        triangles = table::grouped(&scene.triangles.to_string()),
        lights = scene.lights,
        s = if scene.lights == 1 { "" } else { "s" },
        samples = table::grouped(&scene.truth_samples.to_string()),
    );
    let sentences = conclusions::of_scene(scene);
    if !sentences.is_empty() {
        let items: String = sentences.iter().map(|s| format!("<li>{}</li>\n", inline(s))).collect();
        let _ = write!(html, "<h3>Conclusions</h3>\n<ul>{items}</ul>\n");
    }
    if !scene.pictures.is_empty() {
        html += "<h3>Pictures, as in the thesis’s Figures 5.3 and 5.5</h3>\n";
    }
    for picture in &scene.pictures {
        html += &figure(picture)?;
    }
    let charts: String = charts(scene).iter().filter_map(Chart::svg).collect();
    if !charts.is_empty() {
        let rows = scene.table().html();
        let _ = write!(
            html,
            "<h3>Error against run time</h3>\n<div class=charts>\n{charts}</div>\n<details><summary>All \
             numbers</summary>{rows}</details>\n"
        );
    }
    if !scene.skipped.is_empty() {
        let item = |s: &super::Skipped| format!("<li>{}: {}</li>", inline(&s.what), escaped(&s.why));
        let _ = writeln!(html, "<p>Not measured:</p><ul>{}</ul>", scene.skipped.iter().map(item).collect::<String>());
    }
    let [width, height] = scene.edit_size;
    let title = format!("Milliseconds per edit, median, {width}×{height} pixels");
    if let Some(svg) = profile::svg(&title, &scene.edits) {
        let rows = table::edits(scene).html();
        let _ = write!(
            html,
            "<h3>Time of an edit by pass</h3>\n{svg}<details><summary>All numbers</summary>{rows}</details>\n"
        );
    }
    if !scene.left_out.is_empty() {
        let _ = write!(html, "<h3>Omitted for this scene</h3>\n{}", table::left_out(scene).html());
    }
    Ok(html)
}

type Of = fn(&Point) -> f64;

fn charts(scene: &SceneReport) -> Vec<Chart> {
    let first = "CPU seconds to the first picture";
    let again = "CPU seconds for a picture after an edit";
    let error = "error of indirect light, % rel. RMSE";
    let percent: Of = |p| 100.0 * p.errors.indirect;
    let flip: Of = |p| p.errors.flip;
    let (total, frame): (Of, Of) = (Point::total_cpu, |p| p.frame.cpu);
    let noise = (100.0 * scene.floors.indirect, "noise of the ground truth");
    let flip_noise = (scene.floors.flip, "noise of the ground truth");
    let chart = |title: &str, x_label: &str, x: Of, y_label, y: Of, floor| Chart {
        title: title.to_owned(),
        x_label: String::from(x_label),
        y_label,
        series: Method::ALL.into_iter().enumerate().map(|(style, m)| series(scene, m, style, x, y)).collect(),
        floor: Some(floor),
    };
    vec![
        chart("Error, bake included", first, total, error, percent, noise),
        chart("Error, after the bake", again, frame, error, percent, noise),
        chart("Perceptual difference, bake included", first, total, "mean FLIP", flip, flip_noise),
        chart("Perceptual difference, after the bake", again, frame, "mean FLIP", flip, flip_noise),
    ]
}

/// Returns the points with nonzero error and time. The others do not fit logarithmic axes; the table has them.
fn series(scene: &SceneReport, method: Method, style: usize, x: Of, y: Of) -> Series {
    let points: Vec<(&Point, [f64; 2])> = curve(scene, method).into_iter().map(|p| (p, [x(p), y(p)])).collect();
    let drawn: Vec<_> = points.into_iter().filter(|(_, at)| at.iter().all(|v| *v > 0.0 && v.is_finite())).collect();
    let tip = |(point, at): &(&Point, [f64; 2])| {
        format!("{}: {} s, {}", point.setting, significant(at[0]), significant(at[1]))
    };
    Series {
        name: method.name().into(),
        style,
        tips: drawn.iter().map(tip).collect(),
        points: drawn.iter().map(|(_, at)| *at).collect(),
    }
}

fn figure(picture: &Picture) -> Result<String, ::png::EncodingError> {
    let png = png::encode(picture.width, picture.height, &picture.pixels)?;
    let data = base64::engine::general_purpose::STANDARD.encode(png);
    let caption = inline(&picture.caption);
    let alt = escaped(&picture.caption);
    Ok(format!(
        "<figure><img width={} height={} alt=\"{alt}\" \
         src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption></figure>\n",
        picture.width, picture.height
    ))
}

/// Escapes text for HTML; text in backquotes becomes `<code>`.
fn inline(text: &str) -> String {
    let parts = text.split('`').enumerate();
    parts.map(|(i, part)| if i % 2 == 1 { format!("<code>{}</code>", escaped(part)) } else { escaped(part) }).collect()
}

/// Converts a Markdown list to HTML. Items begin with `- `; other lines continue an item.
fn list(markdown: &str) -> String {
    let lines: Vec<&str> = markdown.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let text = lines.join("\n");
    let items = text.trim_start_matches("- ").split("\n- ");
    format!("<ul>{}</ul>\n", items.map(|item| format!("<li>{}</li>\n", inline(item))).collect::<String>())
}
