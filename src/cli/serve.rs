//! `relume serve`

use std::path::PathBuf;

use relume::view::SceneSource;
use relume::{Result, SessionSettings};

use super::options::{LightOptions, SceneOptions};
use super::output_file::{check_outputs, make_parent};

#[derive(clap::Args)]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    scene: PathBuf,
    /// Rig file, or USD file, whose lights replace those of the scene.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Listens for programs of this user, and writes to this file how they connect. Without --listen: one program, on
    /// standard input and output.
    #[arg(long, value_name = "FILE")]
    listen: Option<PathBuf>,
    #[command(flatten)]
    scene_options: SceneOptions,
    #[command(flatten)]
    light_options: LightOptions,
}

pub const AFTER_HELP: &str = "\
Messages are JSON objects, one a line; docs/protocol.md lists them. {\"do\": \"edit\", \"rig\": {\"lights\": {\"key\": \
{\"stops\": 1}}}} edits a light, {\"do\": \"picture\"} asks for a picture.";

pub fn run(args: &Args) -> Result<()> {
    args.listen.iter().try_for_each(|path| make_parent(path))?;
    check_outputs([&args.scene].into_iter().chain(&args.rig).map(PathBuf::as_path), args.listen.as_deref())?;
    args.scene_options.view.use_threads();
    let pictures = args.light_options.picture_settings(args.scene_options.cache.dir())?;
    let target = Some(args.light_options.target(&args.scene_options.cache)?);
    let session = SessionSettings { target, ..args.scene_options.settings()? };
    let source = SceneSource { path: args.scene.clone(), rig: args.rig.clone(), settings: session };
    relume::view::serve(pictures, args.listen.as_deref(), source)
}
