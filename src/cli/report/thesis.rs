//! Table 5.1 and Figures 5.1 and 5.2 of the thesis: previews beside final pictures, direct light and reflections; and
//! Figure 5.4, indirect light by glossy lobes alone. Those of Figures 5.3 and 5.5 are among each scene's own.

use std::path::{Path, PathBuf};

use relume::image::compare::{Pictures, displayed};
use relume::image::{Image, exr};
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::relight;
use relume::report::thesis::{GlossyAlone, Preview, Thesis};
use relume::report::{Method, Picture, Skipped, significant};
use relume::{Error, Result, Session};

use super::curves::{Clock, thesis_diffuse, thesis_glossy};
use super::lab::{Lab, fit, ours, picture_file, session_settings};
use super::measurement_store::MeasurementStore;
use super::{Args, Extent, truth};
use crate::cli::bench::{Timing, edits_of};
use crate::cli::options::ViewOptions;
use crate::cli::output_file::make_parent;
use crate::cli::progress::Terminal;
use crate::cli::transfer::FormName;

/// By the figure that shows them.
const SCENES: [(&str, &str); 4] = [
    ("balls-2", "Figure 5.1"),
    ("balls-16", "Figure 5.1"),
    ("bunny-dragon-2", "Figure 5.2"),
    ("bunny-dragon-16", "Figure 5.2"),
];
/// Of a final picture, all over its pixels; an even number.
const SAMPLES: u32 = 8;

/// Where the thesis's scenes are, if they are at hand.
pub fn shared_scene(name: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("RELUME_SHARED").map_or_else(|| PathBuf::from("../shared"), PathBuf::from);
    let path = shared.join("scenes").join(name).with_extension("glb");
    path.exists().then_some(path)
}

/// Whatever of the thesis's scenes is at hand.
pub fn measure_all(args: &Args, extent: &Extent, kept: &mut MeasurementStore) -> Result<Thesis> {
    let mut thesis = Thesis::default();
    for (path, figure) in SCENES.iter().filter_map(|(name, figure)| Some((shared_scene(name)?, figure))) {
        let (preview, pictures) = one(&path, figure, args, extent, kept)?;
        thesis.previews.push(preview);
        thesis.pictures.extend(pictures);
    }
    Ok(thesis)
}

/// Figure 5.4: without diffuse lobes, indirect light times 4; none where there is none. Comes with what was not
/// measured.
pub fn glossy_alone(
    path: &Path,
    args: &Args,
    extent: &Extent,
    kept: &mut MeasurementStore,
) -> Result<Option<(GlossyAlone, Vec<Skipped>)>> {
    let view = ViewOptions { strip_diffuse: true, ..args.view.clone() };
    let mut lab = Lab::open(path, &view, args, extent, kept)?;
    let truth = lab.truth()?;
    let Some(exposure) = truth.exposure().filter(|_| truth.has_indirect()) else { return Ok(None) };
    if let Some(&gather) = extent.thesis.last() {
        lab.transfer(&truth, Method::ThesisDiffuse, &thesis_diffuse(gather))?;
        lab.transfer(&truth, Method::ThesisGlossy, &thesis_glossy(gather))?;
    }
    let usual = Some(lab.usual_gather_samples());
    lab.transfer(&truth, Method::GatherSamples, &ours(usual, 1024, 0.01, FormName::Auto))?;
    let name = lab.session.scene.name();
    let (width, height) = lab.session.size();
    let picture = |who: &str, indirect: &[[f32; 3]]| Picture {
        caption: format!("Figure 5.4, {name}, indirect light by glossy lobes alone, times 4: {who}"),
        width,
        height,
        pixels: displayed(indirect, 4.0 * exposure),
    };
    let mut pictures = vec![picture("the truth", &truth.indirect())];
    for point in &lab.points {
        let image = truth::read(&lab.dir.join(&point.file), (width, height))?;
        let indirect = image.layer("indirect").map_or(&[][..], |layer| &layer.pixels);
        let off = significant(100.0 * point.errors.indirect);
        pictures.push(picture(&format!("`{}`, {off} % off", point.setting), indirect));
    }
    let skipped = lab.skipped.into_iter().map(|s| Skipped { what: format!("Figure 5.4, {}", s.what), ..s }).collect();
    Ok(Some((GlossyAlone { points: lab.points, pictures }, skipped)))
}

fn one(
    path: &Path,
    figure: &str,
    args: &Args,
    extent: &Extent,
    kept: &mut MeasurementStore,
) -> Result<(Preview, Vec<Picture>)> {
    let size = args.view.size.unwrap_or_else(|| fit([720, 480], extent.preview_side));
    let view = ViewOptions { size: Some(size), ..args.view.clone() };
    let session = Session::open_direct(
        path,
        args.rig.as_deref(),
        &session_settings(&view, None, args.target()?)?,
        &Terminal::default(),
    )?;
    let name = session.scene.name();
    let [ours, theirs] = ["preview", "final"]
        .map(|what| args.output.join(picture_file(&format!("{name}-{}x{}", size[0], size[1]), what)));
    let lit = (&session.rig, &args.device.device, args.relight_settings(), extent.frames);
    let what = format!("table 5.1 {:?} {lit:?}", session.key);
    let known = kept.get::<Preview>(&what).filter(|_| ours.exists() && theirs.exists());
    let preview = match known {
        Some(preview) => preview,
        None => {
            let preview = trace_and_time(&session, &view, args, extent, [&ours, &theirs])?;
            kept.keep(&what, &preview)?;
            preview
        }
    };
    let [ours, theirs] = [exr::read(&ours)?, exr::read(&theirs)?].map(halved);
    Ok((preview, pictures(&format!("{figure}, {name}"), ours, theirs)))
}

fn trace_and_time(
    session: &Session,
    view: &ViewOptions,
    args: &Args,
    extent: &Extent,
    [ours, theirs]: [&Path; 2],
) -> Result<Preview> {
    let (width, height) = session.size();
    let context = session.context(args.device.device.as_deref())?;
    let mut relighter = session.relighter(&context, &session.rig, &args.relight_settings())?;
    make_parent(ours)?;
    let picture = relighter.linear(relight::Picture::Whole)?.to_vec();
    exr::write(ours, &Image::single(width, height, picture))?;
    let moved = edits_of(&session.rig).into_iter().find(|(_, edit)| edit.1 == "move_direct");
    let (edited, edit) = moved.ok_or_else(|| Error::invalid(session.scene.name(), "has no lights to move"))?;
    let record = Timing::new(session, extent.frames).measure(&mut relighter, &session.rig, edited, edit)?;

    let settings = Settings {
        width: width as u32,
        height: height as u32,
        layers: view.layers,
        max_bounces: Some(0),
        filter: Filter::Box,
        bounce_layers: 0,
        light_layers: false,
        seed: view.seed,
    };
    let clock = Clock::start();
    let tracer = PathTracer::new(&session.scene, &session.framebuffer.camera, &session.rig, &settings);
    let film = tracer.trace(SAMPLES / 2, &|| false, &|_| ());
    let final_picture = clock.seconds();
    exr::write(theirs, &film.image(Half::Both, &[Layer::Beauty]))?;
    Ok(Preview {
        scene: session.scene.name(),
        triangles: session.scene.mesh.triangles.len(),
        lights: session.rig.lights.len(),
        size: [width as u32, height as u32],
        preview_ms: record.median_ms,
        final_picture,
    })
}

/// Preview, final picture and their difference times 2.
fn pictures(name: &str, ours: Image, theirs: Image) -> Vec<Picture> {
    let (width, height) = (ours.width, ours.height);
    let [Some(image), Some(reference)] = [ours, theirs].map(|image| image.layers.into_iter().next().map(|l| l.pixels))
    else {
        return Vec::new();
    };
    let sum: f64 = reference.iter().flatten().map(|&v| f64::from(v)).sum();
    let exposure = if sum > 0.0 { 0.5 * (3 * reference.len()) as f64 / sum } else { 1.0 };
    let picture = |caption: String, pixels| Picture { caption, width, height, pixels };
    let shown = [
        picture(format!("{name}: relit"), displayed(&image, exposure)),
        picture(format!("{name}: final, {SAMPLES} samples a pixel"), displayed(&reference, exposure)),
    ];
    let both = Pictures { width, height, image, reference, second: None, mask: None };
    let map = both.difference_map(1, (2.0 * exposure) as f32);
    shown.into_iter().chain([picture(format!("{name}: difference, times 2"), map)]).collect()
}

/// Means of 2x2 pixels where a picture is larger than the page shows it.
fn halved(image: Image) -> Image {
    const SHOWN: usize = 400;
    if image.width <= SHOWN {
        return image;
    }
    let (width, height) = (image.width / 2, image.height / 2);
    let mut small = Image { width, height, ..Image::default() };
    for layer in image.layers {
        let at = |x: usize, y: usize| layer.pixels[y * image.width + x];
        let mean = |x: usize, y: usize| {
            let four = [at(2 * x, 2 * y), at(2 * x + 1, 2 * y), at(2 * x, 2 * y + 1), at(2 * x + 1, 2 * y + 1)];
            [0, 1, 2].map(|c| four.iter().map(|p| p[c]).sum::<f32>() / 4.0)
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| mean(x, y)).collect();
        small.push_layer(layer.name, pixels);
    }
    small
}
