//! `relume render`

use std::path::PathBuf;

use relume::scene::Rig;
use relume::{Error, Result};

use super::options::{LightOptions, SceneOptions};
use super::output::{self, Display, Has, PassKind, Passes, Relighters, Template, Written};
use super::progress::Terminal;
use super::stats;

#[derive(clap::Args)]
pub struct Args {
    /// Scene: .glb, .gltf or .obj.
    scene: PathBuf,
    /// Image to write: .exr or .png. {rig} and {pass} in its name stand for their names.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Rig file that replaces the scene's lights; several --rig give several images.
    #[arg(long, value_name = "FILE")]
    rig: Vec<PathBuf>,
    /// What to write, separated by commas: beauty, direct, reflection, indirect, indirect_glossy, emission,
    /// light:NAME; or all. Layers of an EXR, or a file each with {pass}.
    #[arg(long, value_name = "LIST", default_value = "beauty", value_parser = output::parse_passes)]
    passes: Passes,
    /// Writes figures of bake and frame as JSON.
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// Writes a trace of every stage and pass, for Perfetto or chrome://tracing.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    #[command(flatten)]
    scene_options: SceneOptions,
    #[command(flatten)]
    light_options: LightOptions,
}

pub fn run(args: &Args) -> Result<()> {
    let template = Template(args.output.clone());
    template.check(args.rig.len(), &args.passes)?;
    args.stats.iter().chain(&args.trace).try_for_each(|path| output::make_parent(path))?;
    // Every rig is read before anything is rendered: a mistake in the last one shows at once.
    let rigs = args.rig.iter().map(|path| Rig::load(path)).collect::<Result<Vec<_>>>()?;
    let mut session = args.scene_options.open(&args.scene, args.rig.first().map(PathBuf::as_path))?;
    let first = session.rig.clone();
    let name = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let rigs: Vec<(String, &Rig)> = match rigs.as_slice() {
        [] => vec![(session.scene.name(), &first)],
        _ => args.rig.iter().map(name).zip(&rigs).collect(),
    };
    let differs = |rig: &Rig| rig.camera.is_some() && rig.camera != session.rig.camera;
    let by_name = args.scene_options.view.camera.is_some();
    if let Some((name, _)) = rigs.iter().find(|(_, rig)| !by_name && differs(rig)) {
        let reason = "its camera differs from the first rig's; render it on its own";
        return Err(Error::invalid(format!("rig {name}"), reason));
    }
    let transfer = session.transfer.as_ref();
    let emission = !session.framebuffer.emission.is_empty() || transfer.is_some_and(|t| !t.emission.is_empty());
    let has = Has { emission, indirect: transfer.is_some() };
    let jobs = output::plan(&args.passes, &template, &rigs, has)?;

    let settings = args.light_options.relight_settings();
    let context = session.context(args.light_options.device.as_deref())?;
    let mut whole = session.relighter(&context, &first, &settings)?;
    whole.check_finite()?;
    let glossy = jobs.iter().any(|job| job.shows(&PassKind::IndirectGlossy));
    let progress = Terminal::default();
    let mut glossy = glossy.then(|| session.glossy_relighter(&context, &first, &settings, &progress)).transpose()?;
    glossy.as_mut().map_or(Ok(()), |glossy| glossy.check_finite())?;
    let mut relighters = Relighters { whole, glossy };
    let LightOptions { exposure, tonemap, .. } = args.light_options;
    let mut display = Display { exposure, tone_map: tonemap.into() };
    let mut written = Written::default();
    for job in &jobs {
        output::write(&mut relighters, job, session.size(), &mut display, &mut written)?;
    }
    for file in &written.files {
        tracing::info!("wrote {}", file.display());
    }
    for (pass, count) in relighters.non_finite().into_iter().filter(|(_, count)| *count > 0) {
        tracing::warn!("{count} values that the pass {pass:?} left are not finite");
    }
    if let Some(path) = &args.stats {
        output::write_json(path, &stats::figures(&session, &relighters, &written))?;
    }
    if let Some(path) = &args.trace {
        output::write_json(path, &stats::trace(&session.bake, &written.frames))?;
    }
    Ok(())
}
