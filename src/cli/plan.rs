//! `relume plan`

use std::path::PathBuf;

use relume::bake::transport::TransferSettings;
use relume::bake::transport::importance::Importance;
use relume::session::TransferPlan;
use relume::{Result, Session, SessionSettings};
use serde_json::json;

use super::options::SceneOptions;
use super::progress::Terminal;
use super::stdout::out;

#[derive(clap::Args)]
pub struct Args {
    /// Scene: .glb, .gltf or .obj.
    scene: PathBuf,
    /// Rig file that replaces the scene's lights.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Prints JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: SceneOptions,
}

pub const AFTER_HELP: &str = "";

/// Something that a scene does not need.
#[derive(serde::Serialize)]
pub struct LeftOut {
    pub what: &'static str,
    pub why: String,
    pub saves: String,
}

/// Share of the surfaces that is not worth a word.
const LITTLE: f64 = 0.01;
/// Paths from the eye that tell how much of the scene is seen.
const PATHS: usize = 16_384;

/// What this scene does not pay for. `traced`: shadow rays are traced, no maps are drawn. `unseen`: share of surfaces that no
/// pixel sees, even over bounces, if there is, or will be, indirect light.
pub fn left_out(session: &Session, traced: bool, unseen: Option<f64>) -> Vec<LeftOut> {
    let framebuffer = &session.framebuffer;
    let pixels = framebuffer.pixel_stride();
    let mut list = Vec::new();
    let mut add = |what, why: &str, saves: String| list.push(LeftOut { what, why: why.into(), saves });
    let megabytes = |bytes: usize| format!("{:.1} MB", bytes as f64 * 1e-6);
    let per_sample = size_of::<relume::shared::ViewSample>();
    let full_layers = framebuffer.asked_layers.saturating_sub(1) as usize * pixels;
    let deeper: usize = framebuffer.layers.iter().skip(1).sum();
    if deeper == 0 && full_layers > 0 {
        let saves = format!("{} layers, {}", framebuffer.asked_layers - 1, megabytes(full_layers * per_sample));
        add("mirror layers", "no mirror is visible", saves);
    } else if deeper < full_layers {
        let saves =
            format!("{} view samples, {}", full_layers - deeper, megabytes((full_layers - deeper) * per_sample));
        add("parts of mirror layers", "mirrors cover a part of the picture", saves);
    }
    if !framebuffer.has_specular {
        add("the specular lobe", "no visible surface has one", "its share of the shading kernel".into());
    }
    match unseen {
        None => add("indirect light", "--gi off", "gather samples, their transfer, and its passes".into()),
        Some(unseen) if unseen > LITTLE => {
            let saves = format!("the samples of {:.0} % of all surfaces", 100.0 * unseen);
            add("gather samples nobody sees", "no light reaches the eye from there, over any bounces", saves);
        }
        Some(_) => (),
    }
    if framebuffer.emission.is_empty() {
        add("emission", "no emitter is visible", megabytes(12 * pixels));
    }
    if framebuffer.brdfs.len() == session.scene.materials.len() {
        add(
            "BRDFs of single samples",
            "no texture or vertex colour is visible",
            megabytes(pixels * size_of::<relume::shared::Brdf>()),
        );
    }
    if traced {
        add("shadow maps", "rays are traced on the CPU", "drawing, and 24 MB at 1024 texels".into());
    }
    list
}

pub fn run(args: &Args) -> Result<()> {
    // Its bake takes longest, and nothing here depends on it.
    args.options.view.use_threads();
    let settings = args.options.settings()?;
    let direct = SessionSettings { indirect: None, ..settings.clone() };
    let session = Session::open(&args.scene, args.rig.as_deref(), &direct, &Terminal::default())?;
    let framebuffer = &session.framebuffer;
    let size = [framebuffer.tiling.width, framebuffer.tiling.height];
    let transfer = settings.indirect.map(|indirect| indirect.plan(size, settings.layers, settings.seed));
    let reasons = settings.indirect.map_or(Vec::new(), |indirect| indirect.reasons(size));
    let images = 2 * session.rig.lights.len() * 12 * framebuffer.pixel_stride();
    // Whether maps are drawn depends on the device, which a plan does not open.
    let unseen = match &transfer {
        Some(TransferPlan::Robust(TransferSettings { layers, seed, .. }, _)) => {
            Some(Importance::new(&session.scene, framebuffer, *layers, PATHS, *seed).unseen)
        }
        other => other.as_ref().map(|_| 0.0),
    };
    let left_out = left_out(&session, false, unseen);
    if args.json {
        let plan = json!({
            "schema": 1,
            "scene": {
                "triangles": session.scene.mesh.triangles.len(),
                "lights": session.rig.lights.len(),
                "width": framebuffer.tiling.width,
                "height": framebuffer.tiling.height,
            },
            "samples": { "view": framebuffer.samples.len(), "layers": session.layers() },
            "light_image_bytes": images,
            "transfer": transfer.as_ref().map(TransferPlan::describe),
            "reasons": reasons,
            "left_out": left_out,
        });
        out!("{plan:#}")?;
        return Ok(());
    }
    out!("{}", args.scene.display())?;
    out!("  {} triangles, {} lights", session.scene.mesh.triangles.len(), session.rig.lights.len())?;
    out!(
        "  {}x{} pixels, view samples by layer {:?}",
        framebuffer.tiling.width,
        framebuffer.tiling.height,
        session.layers()
    )?;
    out!("  light images: up to {:.0} MB", images as f64 * 1e-6)?;
    if let Some(plan) = &transfer {
        out!("  indirect light: {}", plan.describe())?;
    }
    for reason in reasons {
        out!("    {reason}")?;
    }
    out!("left out:")?;
    for item in left_out {
        out!("  {}: {} (saves {})", item.what, item.why, item.saves)?;
    }
    Ok(())
}
