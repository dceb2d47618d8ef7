//! `relume rig`: lights out of a scene, and into it.

use std::path::PathBuf;

use relume::scene::{Rig, Scene, export_gltf, usd};
use relume::{Error, Result};

use super::output_file::make_parent;

#[derive(clap::Args)]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    pub scene: PathBuf,
    /// Rig file. With it, relume writes the lights of this rig.
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// File to write. Without --rig: a rig (.toml). With --rig: the scene with these lights (.glb or .gltf). Either way
    /// .usda: the lights for programs that read USD.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

pub fn run(args: &Args) -> Result<()> {
    make_parent(&args.output)?;
    let scene = Scene::load(&args.scene)?;
    if let Some(rig) = args.rig.as_ref().filter(|_| usd::is_usd(&args.output)) {
        return usd::save(&Rig::load(rig)?, &args.output);
    }
    if let Some(rig) = &args.rig {
        return export_gltf(&scene, &Rig::load(rig)?, &args.output);
    }
    // A forgotten --rig would put TOML where the next program expects a scene.
    if args.output.extension().is_some_and(|e| ["glb", "gltf", "obj"].iter().any(|s| e.eq_ignore_ascii_case(s))) {
        let reason =
            "without --rig, relume writes a rig, which is a .toml file; to write a scene, name a rig with --rig";
        return Err(Error::invalid(args.output.display().to_string(), reason));
    }
    Rig { camera: scene.cameras.first().cloned(), ..scene.rig }.save(&args.output)
}
