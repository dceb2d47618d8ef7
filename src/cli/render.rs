//! `relume render`

use std::path::PathBuf;

use relume::scene::Rig;
use relume::{Error, Result};

use super::options::{LightOptions, SceneOptions};
use super::output::{self, Passes, Template, Written};
use super::session::Session;
use super::stats;

#[derive(clap::Args)]
pub struct Args {
    /// .glb, .gltf or .obj
    scene: PathBuf,
    /// Where to: .exr or .png; may hold {rig} and {pass}.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Replaces the scene's lights; several give several images.
    #[arg(long, value_name = "FILE")]
    rig: Vec<PathBuf>,
    /// beauty, direct, reflection, emission, light:NAME, separated by commas; or all.
    #[arg(long, value_name = "LIST", default_value = "beauty", value_parser = output::parse_passes)]
    passes: Passes,
    /// Figures of bake and frame as JSON.
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// A trace of every pass that Perfetto and chrome://tracing open.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    #[command(flatten)]
    scene_options: SceneOptions,
    #[command(flatten)]
    light_options: LightOptions,
}

pub fn run(args: &Args) -> Result<()> {
    let template = Template(args.output.clone());
    template.check(args.rig.len())?;
    // Every rig is read before anything is rendered: a mistake in the last one shows at once.
    let rigs = args.rig.iter().map(|path| Rig::load(path)).collect::<Result<Vec<_>>>()?;
    let session = Session::open(&args.scene, args.rig.first().map(PathBuf::as_path), &args.scene_options)?;
    let context = session.context(&args.light_options)?;
    let mut relighter = session.relighter(&context, &session.rig, &args.light_options)?;
    let mut exposure = args.light_options.exposure;

    let scene_name = session.scene.name();
    let name = |path: &PathBuf| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let jobs: Vec<(String, &Rig)> = match rigs.as_slice() {
        [] => vec![(scene_name, &session.rig)],
        _ => args.rig.iter().map(name).zip(&rigs).collect(),
    };
    let mut written = Written::default();
    let mut trace = stats::Trace::default();
    for (name, rig) in &jobs {
        if rig.camera.is_some() && rig.camera != session.rig.camera {
            let reason = "its camera differs from the first rig's; render it on its own";
            return Err(Error::invalid(format!("rig {name}"), reason));
        }
        relighter.set_rig(rig);
        let this = output::write(&mut relighter, &args.passes, &template, name, session.size(), &mut exposure)?;
        written.non_finite += this.non_finite;
        written.negative += this.negative;
        written.files.extend(this.files);
        trace.add(name, relighter.times());
    }
    if written.non_finite > 0 {
        tracing::warn!("{} values are not finite", written.non_finite);
    }
    if let Some(path) = &args.stats {
        stats::write(path, &session, &relighter, &written)?;
    }
    if let Some(path) = &args.trace {
        trace.write(path, &session.bake)?;
    }
    for file in &written.files {
        tracing::info!("wrote {}", file.display());
    }
    Ok(())
}
