//! `relume render`

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use relume::image::exr::{Blocks, ExrMetadata, Precision};
use relume::image::png;
use relume::image::primaries::Primaries;
use relume::relight::{RelightSettings, Relighter};
use relume::scene::{Emitters, Rig};
use relume::{Error, Result};
use serde_json::Value;

use super::data_passes::Surfaces;
use super::final_gather::{self, FinalOptions};
use super::options::{LightOptions, RecordOptions, SceneOptions};
use super::output::{self, Display, Has, Job, PassKind, Passes, Relighters, Template, Written};
use super::output_file::{as_file_name, check_outputs};
use super::progress::{self, Terminal};
use super::stats::{self, Strange};

#[derive(clap::Args, Clone)]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    scene: PathBuf,
    /// Image to write: .exr or .png. In its name, {rig} stands for the name of the rig, {pass} for the name of the
    /// pass, {camera} for the name of the camera.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Rig file, or USD file, whose lights replace those of the scene. Give --rig several times to write several
    /// images.
    #[arg(long, value_name = "FILE")]
    rig: Vec<PathBuf>,
    /// Passes to write, separated by commas: beauty, direct, reflection, indirect, indirect_glossy, emission,
    /// expected_error (with --final), light:NAME; or all. For EXR files also parts: direct and indirect light, diffuse
    /// and specular, of each light; depth, normal, position, albedo; cryptomatte. One EXR file holds them as layers. If
    /// the name of the image has {pass}, each pass gets its own file.
    #[arg(long, value_name = "LIST", default_value = "beauty", value_parser = output::parse_passes)]
    passes: Passes,
    /// Writes the colours of EXR files with 16 bits a channel. Depth, normals, positions and mattes keep 32.
    #[arg(long)]
    half: bool,
    /// Bits a channel of PNG files.
    #[arg(long, value_name = "8|16", default_value = "8", value_parser = ["8", "16"])]
    png_bits: String,
    /// Writes EXR files in tiles of 64x64 pixels, not in lines.
    #[arg(long)]
    tiles: bool,
    /// Gives each layer of an EXR file a part of its own.
    #[arg(long)]
    multi_part: bool,
    /// Primaries of the colours in EXR files: those of Rec. 709, or ACEScg.
    #[arg(long, value_enum, value_name = "NAME", default_value = "rec709")]
    primaries: PrimariesOption,
    #[command(flatten)]
    refine: FinalOptions,
    #[command(flatten)]
    record: RecordOptions,
    #[command(flatten)]
    scene_options: SceneOptions,
    #[command(flatten)]
    light_options: LightOptions,
}

impl Args {
    /// Refuses options of the other kind of file.
    fn check_format(&self, is_exr: bool) -> Result<()> {
        let of_exr = [
            ("--half", self.half),
            ("--tiles", self.tiles),
            ("--multi-part", self.multi_part),
            ("--primaries", self.primaries != PrimariesOption::Rec709),
        ];
        let of_png = [("--png-bits", self.png_depth() != png::Depth::Eight)];
        let (others, format) = if is_exr { (&of_png[..], "PNG") } else { (&of_exr[..], "EXR") };
        match others.iter().find(|(_, is_given)| *is_given) {
            Some((option, _)) => Err(Error::invalid(*option, format!("is for {format} files"))),
            None => Ok(()),
        }
    }

    fn png_depth(&self) -> png::Depth {
        if self.png_bits == "16" { png::Depth::Sixteen } else { png::Depth::Eight }
    }
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum PrimariesOption {
    Rec709,
    #[value(name = "acescg")]
    AcesCg,
}

impl From<PrimariesOption> for Primaries {
    fn from(option: PrimariesOption) -> Self {
        match option {
            PrimariesOption::Rec709 => Self::REC_709,
            PrimariesOption::AcesCg => Self::ACES_CG,
        }
    }
}

pub fn run(args: &Args) -> Result<()> {
    let config = args.light_options.display.config()?;
    let tone_map = args.light_options.display.tone_map(config.as_ref())?;
    // Pictures of several cameras share the exposure that the first one gets.
    let mut display = Display { exposure: args.light_options.display.exposure, tone_map, png_depth: args.png_depth() };
    let cameras = args.scene_options.view.all_cameras(&args.scene)?;
    if cameras.is_empty() {
        return render(args, &mut display);
    }
    if args.record.is_wanted() {
        return Err(Error::invalid("--camera all", "--stats and --trace tell of one camera"));
    }
    let mut names = BTreeSet::new();
    if let Some(twice) = cameras.iter().map(|camera| as_file_name(camera)).find(|name| !names.insert(name.clone())) {
        let reason = format!("has several cameras whose pictures would be called {twice}");
        return Err(Error::import(&args.scene, reason));
    }
    for camera in cameras {
        let mut args = args.clone();
        args.output = Template(args.output).of_camera(&camera)?;
        args.scene_options.view.camera = Some(camera);
        render(&args, &mut display)?;
    }
    Ok(())
}

/// Renders the pictures of one camera.
fn render(args: &Args, display: &mut Display) -> Result<()> {
    let template = Template(args.output.clone());
    template.check(args.rig.len(), &args.passes)?;
    args.check_format(template.is_exr())?;
    args.record.make_parents()?;
    let read = args.rig.iter().chain([&args.scene]).map(PathBuf::as_path);
    check_outputs(read, args.record.files().chain([args.output.as_path()]))?;
    // Every rig is read before anything is rendered: a mistake in the last one shows at once.
    let rigs = args.rig.iter().map(|path| Rig::load(path)).collect::<Result<Vec<_>>>()?;
    args.refine.check(args.scene_options.settings()?.indirect.as_ref())?;
    let target = args.light_options.target(&args.scene_options.cache)?;
    let others = rigs.iter().skip(1).flat_map(|rig| rig.lights.iter().cloned()).collect();
    let first = args.rig.first().map(PathBuf::as_path);
    let mut session = args.scene_options.open_for(&args.scene, first, others, Some(target))?;
    let emitters = Emitters::of(&session.scene);
    let camera = &session.framebuffer.camera.name;
    let of_shot = |(rig, path): (&Rig, &PathBuf)| {
        emitters.complete(rig).of_shot(camera).map_err(|reason| Error::import(path, reason))
    };
    let rigs: Vec<Rig> = rigs.iter().zip(&args.rig).map(of_shot).collect::<Result<_>>()?;
    let first = session.rig.clone();
    let name = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let rigs: Vec<(String, &Rig)> = match rigs.as_slice() {
        [] => vec![(session.scene.name(), &first)],
        _ => args.rig.iter().map(name).zip(&rigs).collect(),
    };
    let differs = |rig: &Rig| rig.camera.is_some() && rig.camera != session.rig.camera;
    let by_name = args.scene_options.view.camera.is_some();
    if let Some((name, _)) = rigs.iter().find(|(_, rig)| !by_name && differs(rig)) {
        let reason = "its camera differs from that of the first rig; render this rig in a command of its own";
        return Err(Error::invalid(format!("rig {name}"), reason));
    }
    let transfer = session.transfer.as_ref();
    let emission = !session.framebuffer.emission.is_empty() || transfer.is_some_and(|t| !t.emission.is_empty());
    let has = Has { emission, indirect: transfer.is_some(), expected_error: args.refine.is_wanted() };
    let template = Template(template.of_camera(&session.framebuffer.camera.name).unwrap_or(template.0));
    let jobs = output::plan(&args.passes, &template, &rigs, has)?;
    let maps = rigs.iter().flat_map(|(_, rig)| rig.files());
    let written = jobs.iter().flat_map(Job::files).chain(args.record.files());
    check_outputs(
        [args.scene.as_path()].into_iter().chain(args.rig.iter().map(PathBuf::as_path)).chain(maps),
        written,
    )?;

    // Other pictures can use images of lights again. Those of area lights are made before the picture's plan.
    let keep_images = rigs.len() > 1
        || rigs.iter().any(|(_, rig)| rig.has_sizes())
        || args.refine.is_wanted()
        || jobs.iter().any(|job| job.shows(&PassKind::is_of_one_light));
    let settings = RelightSettings { keep_images, ..args.light_options.relight_settings() };
    let context = session.context(args.light_options.device.device.as_deref())?;
    let mut whole = session.relighter(&context, &first, &settings)?;
    whole.check_finite()?;
    whole.set_progress(progress::of_lights());
    let glossy = jobs.iter().any(|job| job.shows(&PassKind::is_glossy));
    let diffuse = jobs.iter().any(|job| job.shows(&PassKind::is_split));
    let bars = Terminal::default();
    let mut glossy = glossy.then(|| session.glossy_relighter(&context, &first, &settings, &bars)).transpose()?;
    glossy.as_mut().map_or(Ok(()), |glossy| glossy.check_finite())?;
    let diffuse = diffuse.then(|| {
        let framebuffer = Arc::new(session.framebuffer.without_specular());
        Relighter::new(&context, &session.scene, &framebuffer, None, &first, &settings)
    });
    let mut relighters = Relighters { whole, glossy, diffuse: diffuse.transpose()? };
    let surfaces = Surfaces { scene: &session.scene, framebuffer: &session.framebuffer };
    let exr = ExrMetadata {
        precision: if args.half { Precision::Half } else { Precision::Float },
        primaries: args.primaries.into(),
        blocks: if args.tiles { Blocks::Tiles } else { Blocks::Lines },
        has_parts: args.multi_part,
        ..ExrMetadata::default()
    };
    let mut written = Written::default();
    let mut figures_of_final = None;
    for job in &jobs {
        let mut refine = |relighter: &mut Relighter| {
            let seed = args.scene_options.view.seed;
            let refine = || args.refine.refine(&session, relighter, seed);
            let refinement = args.refine.is_wanted().then(refine).transpose()?;
            figures_of_final.get_or_insert(refinement.as_ref().map_or(Value::Null, final_gather::figures));
            Ok(refinement)
        };
        output::write(&mut relighters, job, display, &surfaces, &exr, &mut refine, &mut written)?;
    }
    for file in &written.files {
        tracing::info!("wrote {}", file.display());
    }
    let strange = Strange { non_finite: relighters.non_finite(), negative: written.negative };
    for (pass, count) in strange.non_finite.iter().filter(|(_, count)| *count > 0) {
        tracing::warn!("the pass {pass:?} gave {count} values that are infinite or not a number");
    }
    let first = written.frames.first().map_or(&[][..], Vec::as_slice);
    let figures = || {
        let mut figures = stats::figures(&session, &relighters.whole, first, Some(&strange));
        figures["final"] = figures_of_final.unwrap_or(Value::Null);
        figures
    };
    args.record.write(figures, || stats::trace(&session.bake.stages, &written.frames))
}
