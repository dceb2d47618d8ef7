//! `relume reference`

use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use relume::image::exr::{self, ExrMetadata};
use relume::reference::path_tracer::{Film, Filter, Half, Layer, PathTracer, Settings};
use relume::scene::{LightKind, Rig};
use relume::session::{BakeReport, Opened, build_bvh, check_fits, cpu_seconds, peak_bytes};
use relume::{Error, Result};
use serde_json::json;

use super::options::{RecordOptions, ViewOptions, check_extension, parse_seconds};
use super::output::find_light;
use super::output_file::{check_outputs, make_parent};
use super::progress::{self, Terminal};
use super::stats;
use super::transfer::{Bounces, parse_bounces};

pub const AFTER_HELP: &str = "\
Writes three files: OUT.a.exr and OUT.b.exr are two halves with independent noise, OUT.exr is their mean. `relume compare \
IMAGE OUT.a.exr OUT.b.exr` gives errors that are free of this noise.

Two kinds of light are missing. One is light from point, spot and directional lights that reaches a surface by way of a \
perfect mirror: no ray from a surface meets a punctual light. The other is reflections deeper than --layers.

After three bounces, paths end by Russian roulette, which does not change the mean. Ctrl-C stops the path tracer and \
writes what there is. The attributes `samplesPerPixel` and `comments` of the EXR files tell how many samples it has.";

#[derive(clap::Args)]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    scene: PathBuf,
    /// Image to write, the mean of both halves: .exr. The halves are written beside it, as .a.exr and .b.exr.
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
    /// Rig file, or USD file, whose lights replace those of the scene.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Samples of each pixel, both halves together. Odd numbers are rounded up.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 30))]
    spp: u32,
    /// Time in seconds; takes as many samples as it allows. Replaces --spp.
    #[arg(long, value_name = "S", conflicts_with = "spp", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Indirect bounces, counted at the pixel: 0 is direct light alone, 1 is light, surface, pixel, inf is all.
    /// Reflections in perfect mirrors do not count.
    #[arg(long, value_name = "N|inf", default_value = "inf", value_parser = parse_bounces)]
    max_bounces: Bounces,
    /// Where rays go through a pixel. centre: through its centre, as in the deep framebuffer. box: anywhere in it.
    #[arg(long, value_enum, default_value = "centre")]
    filter: FilterName,
    /// Layers to write, separated by commas: beauty, direct, reflection, indirect, indirect_glossy, emission, variance,
    /// bounce:N, light:NAME. all: all of these, with the first eight bounces and every light.
    #[arg(long, value_name = "LIST", value_parser = parse_passes,
          default_value = "beauty,direct,reflection,indirect,emission,variance")]
    passes: Passes,
    #[command(flatten)]
    record: RecordOptions,
    #[command(flatten)]
    view: ViewOptions,
}

#[derive(Clone)]
enum Passes {
    All,
    List(Vec<Pass>),
}

#[derive(Clone, PartialEq)]
enum Pass {
    Layer(Layer),
    /// By its name: which lights there are the scene will tell.
    Light(String),
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum FilterName {
    Centre,
    Box,
}

/// More than anybody looks at one by one, few enough for their sums to fit.
const MAX_BOUNCE_LAYERS: u32 = 64;

pub fn run(args: &Args, quiet: bool) -> Result<()> {
    check_extension(&args.output, &["exr"])?;
    let [a, b] = ["a.exr", "b.exr"].map(|extension| args.output.with_extension(extension));
    let paths = [args.output.clone(), a, b];
    paths.iter().try_for_each(|path| make_parent(path))?;
    args.record.make_parents()?;
    let read = args.rig.iter().chain([&args.scene]).map(PathBuf::as_path);
    check_outputs(read, paths.iter().map(PathBuf::as_path).chain(args.record.files()))?;
    args.view.use_threads();
    let (mut report, progress) = (BakeReport::default(), Terminal::default());
    let open = || Opened::new(&args.scene, args.rig.as_deref(), &args.view.settings(), &progress);
    let opened = report.stage("load", open)?;
    let layers = args.passes.layers(&opened.rig)?;
    let light_layers = layers.iter().any(|layer| matches!(layer, Layer::Light(_)));
    let settings = Settings {
        width: opened.size[0],
        height: opened.size[1],
        layers: args.view.layers,
        max_bounces: args.max_bounces.0,
        filter: match args.filter {
            FilterName::Centre => Filter::Centre,
            FilterName::Box => Filter::Box,
        },
        bounce_layers: layers.iter().map(|layer| if let Layer::Bounce(n) = layer { *n } else { 0 }).max().unwrap_or(0),
        light_layers,
        seed: args.view.seed,
    };
    let lights = if light_layers { opened.rig.lights.len() } else { 0 };
    let film_bytes = Film::bytes(settings.width, settings.height, settings.bounce_layers, lights);
    let image_bytes = 2 * 12 * layers.len() as u64 * u64::from(settings.width) * u64::from(settings.height);
    check_fits(
        opened.size,
        (film_bytes + image_bytes) as f64,
        "choose a smaller --size or fewer --passes",
        &args.scene,
    )?;
    let Opened { scene, rig, camera, .. } = opened;
    let scene = report.stage("build BVH", || build_bvh(scene, &progress));
    let tracer = PathTracer::new(&scene, &camera, &rig, &settings);

    let (start, cpu_start) = (Instant::now(), cpu_seconds());
    let film = report.stage("path tracing", || trace(&tracer, args))?;
    let (seconds, cpu) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu_start);
    let label = label(&film, args);
    report.stage("write", || {
        paths.iter().zip([Half::Both, Half::A, Half::B]).try_for_each(|(path, half)| {
            let [samples, _] = film.samples();
            let samples_per_pixel = if half == Half::Both { samples } else { samples / 2 };
            let label = ExrMetadata { comments: label.clone(), samples_per_pixel, ..ExrMetadata::default() };
            exr::write_with_metadata(path, &film.image(half, &layers), &label)
        })
    })?;
    let segments = tracer.segments() as f64 / cpu.max(0.01);
    tracing::info!("{:.2} million path segments a CPU second", segments * 1e-6);
    let figures = || {
        let (samples, errors) = (film.samples(), film.standard_errors());
        json!({
            "schema": 1,
            "relume": env!("CARGO_PKG_VERSION"),
            "scene": { "width": settings.width, "height": settings.height, "lights": rig.lights.len() },
            "reference": {
                "seconds": seconds, "cpu_seconds": cpu, "peak_bytes": peak_bytes(),
                "samples_per_pixel": { "least": samples[0], "most": samples[1] }, "segments_per_cpu_second": segments,
                "standard_error": { "of_mean": errors.of_mean, "of_pixel": errors.of_pixel },
            },
        })
    };
    args.record.write(figures, || stats::trace(&report.stages, &[]))?;
    if !quiet {
        // Where stderr is full or closed, the files still tell.
        let _ = writeln!(std::io::stderr(), "{label}; {seconds:.1} s, {cpu:.1} CPU seconds");
    }
    Ok(())
}

/// Traces until there are enough samples, time is up, or Ctrl-C.
fn trace(tracer: &PathTracer, args: &Args) -> Result<Film> {
    static INTERRUPTED: AtomicBool = AtomicBool::new(false);
    // The second time it means it.
    let interrupt = || {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    };
    ctrlc::set_handler(interrupt).map_err(|error| Error::invalid("Ctrl-C", format!("cannot be caught: {error}")))?;
    let start = Instant::now();
    let interrupted = || INTERRUPTED.load(Ordering::Relaxed);
    let film = match args.seconds {
        None => {
            let samples = args.spp.div_ceil(2);
            let bar = progress::bar("path tracing", samples as usize * tracer.tile_count());
            let film = tracer.trace(samples, &interrupted, &|count| bar.inc(count));
            bar.finish_and_clear();
            film
        }
        Some(seconds) => {
            let bar = progress::bar("path tracing", (seconds * 1e3) as usize);
            let deadline = Duration::from_secs_f64(seconds);
            let stop = || interrupted() || start.elapsed() >= deadline;
            let film = tracer.trace(u32::MAX, &stop, &|_| bar.set_position(start.elapsed().as_millis() as u64));
            bar.finish_and_clear();
            film
        }
    };
    if interrupted() {
        tracing::warn!("interrupted: writing the samples taken so far");
    }
    Ok(film)
}

/// What a picture is, in words.
fn label(film: &Film, args: &Args) -> String {
    let [least, most] = film.samples();
    let samples = if least == most { format!("{least}") } else { format!("{least} to {most}") };
    let bounces = args.max_bounces.0.map_or("inf".into(), |bounces| bounces.to_string());
    let filter = if matches!(args.filter, FilterName::Box) { "box" } else { "centre" };
    let errors = film.standard_errors();
    format!(
        "{samples} samples a pixel in two halves, seed {}, --max-bounces {bounces}, --filter {filter}; standard error of \
         the mean luminance {:.2e} of it, of a pixel {:.2e}",
        args.view.seed, errors.of_mean, errors.of_pixel
    )
}

/// Layers with a name that is the same for all scenes.
const NAMED: [(&str, Layer); 7] = [
    ("beauty", Layer::Beauty),
    ("direct", Layer::Direct),
    ("reflection", Layer::Reflection),
    ("indirect", Layer::Indirect),
    ("indirect_glossy", Layer::IndirectGlossy),
    ("emission", Layer::Emission),
    ("variance", Layer::Variance),
];

fn parse_passes(text: &str) -> Result<Passes, String> {
    if text == "all" {
        return Ok(Passes::All);
    }
    let names: Vec<&str> = text.split(',').map(str::trim).collect();
    let passes = names.iter().map(|name| parse_pass(name)).collect::<Result<Vec<_>, _>>()?;
    match (0..passes.len()).find(|&i| passes[..i].contains(&passes[i])) {
        Some(twice) => Err(format!("{} is listed twice", names[twice])),
        None => Ok(Passes::List(passes)),
    }
}

fn parse_pass(name: &str) -> Result<Pass, String> {
    if let Some(light) = name.strip_prefix("light:") {
        return Ok(Pass::Light(light.into()));
    }
    if let Some(number) = name.strip_prefix("bounce:") {
        let bounce = number.parse().ok().filter(|bounce| (1..=MAX_BOUNCE_LAYERS).contains(bounce));
        let layer = bounce.map(|bounce| Pass::Layer(Layer::Bounce(bounce)));
        return layer.ok_or(format!("{name}: expected bounce:1 to bounce:{MAX_BOUNCE_LAYERS}"));
    }
    let named = NAMED.iter().find(|(known, _)| *known == name);
    named.map(|(_, layer)| Pass::Layer(*layer)).ok_or_else(|| {
        let known = NAMED.map(|(known, _)| known).join(", ");
        format!("{name}: expected {known}, bounce:N, light:NAME or all")
    })
}

impl Passes {
    /// The layers of a rig, whose lights may be asked for by name.
    fn layers(&self, rig: &Rig) -> Result<Vec<Layer>> {
        let light = |light: usize| Layer::Light(light as u32);
        match self {
            Self::All => {
                let is_emitter = |light: &usize| rig.lights[*light].kind == LightKind::Emitter;
                let lights = (0..rig.lights.len()).filter(|light| !is_emitter(light)).map(light);
                Ok(NAMED.map(|(_, layer)| layer).into_iter().chain((1..=8).map(Layer::Bounce)).chain(lights).collect())
            }
            Self::List(passes) => {
                let layer = |pass: &Pass| match pass {
                    Pass::Layer(layer) => Ok(*layer),
                    Pass::Light(name) => find_light(rig, name).map(light),
                };
                passes.iter().map(layer).collect()
            }
        }
    }
}
