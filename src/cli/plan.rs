//! `relume plan`

use std::path::PathBuf;

use relume::Result;
use relume::relight::VisibilityMethod;
use relume::session::{CountedIn, FramebufferCounts, Survey, TransferPlan};
use serde_json::{Value, json};

use super::options::{DeviceOptions, SceneOptions, ShadowOptions};
use super::progress::Terminal;
use super::stdout::out;
use super::unneeded::left_out;

#[derive(clap::Args)]
pub struct Args {
    /// Scene: a .glb, .gltf or .obj file.
    scene: PathBuf,
    /// Rig file, or USD file, whose lights replace those of the scene.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Prints JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: SceneOptions,
    #[command(flatten)]
    shadows: ShadowOptions,
    #[command(flatten)]
    device: DeviceOptions,
}

pub const AFTER_HELP: &str = "\
If the cache has the deep framebuffer of this picture, its counts are exact. Otherwise they are estimated from a small \
picture of the same view. Without --device and --budget, plan uses no device: it does not choose between shadow maps and \
traced shadows, and does not tell whether the light images fit.";

/// Device memory, and what it is for.
struct Memory {
    /// All light images, and the fewest that work.
    images: [u64; 2],
    budget: Option<u64>,
    /// Why the device has no room.
    refusal: Option<String>,
}

impl Memory {
    /// Whether the budget holds at least the light images that relume cannot do without.
    fn fits(&self) -> Option<bool> {
        Some(self.refusal.is_none() && self.images[1] <= self.budget?)
    }

    /// What the budget is enough for, and what would be enough for more.
    fn verdict(&self, survey: &Survey) -> Option<String> {
        if let Some(refusal) = &self.refusal {
            return Some(format!("does not fit: {refusal}"));
        }
        let budget = self.budget?;
        let [all, fewest] = self.images;
        let transfer = if survey.transfer.is_some() { ", and the transfer if it has room" } else { "" };
        let left = if survey.transfer.is_some() {
            format!("; {} are left for the transfer", megabytes(budget.saturating_sub(all)))
        } else {
            String::new()
        };
        Some(match budget {
            _ if all <= budget => format!("fits: {} hold all light images{left}", megabytes(budget)),
            _ if fewest <= budget => format!(
                "fits in part: {} hold some of the light images{transfer}; others are calculated again when they are needed. \
                 --budget {} holds all light images",
                megabytes(budget),
                rounded_up(all)
            ),
            _ => {
                let side = (budget as f64 / fewest as f64).sqrt();
                let size = survey.size.map(|pixels| (f64::from(pixels) * side).floor().max(1.0));
                format!(
                    "does not fit: the fewest light images that work take {}. --budget {} holds them, --budget {} all; so \
                     does a smaller picture, about --size {}x{}",
                    megabytes(fewest),
                    rounded_up(fewest),
                    rounded_up(all),
                    size[0],
                    size[1]
                )
            }
        })
    }
}

pub fn run(args: &Args) -> Result<()> {
    args.options.view.use_threads();
    let settings = args.options.settings()?;
    let survey = Survey::new(&args.scene, args.rig.as_deref(), &settings, &Terminal::default())?;
    let target = || args.shadows.target(&args.device, &args.options.cache);
    let target = args.device.device.is_some().then(target).transpose()?;
    let traced = match (VisibilityMethod::from(args.shadows.visibility), &target) {
        (_, Some(target)) => target.traces(&survey.scene),
        (method, None) => method == VisibilityMethod::Traced, // the device decides
    };
    let of_device = target.as_ref().map(|target| target.device.usable_bytes());
    let memory = Memory {
        images: survey.light_image_bytes(),
        budget: args.device.budget.or(of_device),
        refusal: target.as_ref().and_then(|target| survey.footprint(target).refusal(&target.device)),
    };
    let reasons = settings.indirect.map_or(Vec::new(), |indirect| indirect.reasons(survey.size));
    let left_out = left_out(&survey.counts, &survey.rig, traced, survey.unneeded);
    let [width, height] = survey.size;
    let FramebufferCounts { samples, layers, .. } = &survey.counts;
    let verdict = memory.verdict(&survey);
    if args.json {
        let plan = json!({
            "schema": 1,
            "scene": {
                "triangles": survey.scene.mesh.triangles.len(),
                "lights": survey.rig.lights.len(),
                "width": width,
                "height": height,
            },
            "samples": { "view": samples, "layers": layers, "counted_in": counted_in(survey.counted_in) },
            "light_image_bytes": memory.images[0],
            "memory": {
                "device": target.as_ref().map(|target| target.device.name.clone()),
                "budget_bytes": memory.budget,
                "fewest_light_image_bytes": memory.images[1],
                "fits": memory.fits(),
                "verdict": verdict,
            },
            "transfer": survey.transfer.as_ref().map(TransferPlan::describe),
            "reasons": reasons,
            "left_out": left_out,
        });
        return out!("{plan:#}");
    }
    out!("{}", args.scene.display())?;
    out!("  {} triangles, {} lights", survey.scene.mesh.triangles.len(), survey.rig.lights.len())?;
    let counted = match survey.counted_in {
        CountedIn::Cache => "from the cache".into(),
        CountedIn::Picture => "counted".into(),
        CountedIn::Smaller([width, height]) => format!("estimated from {width}x{height} pixels"),
    };
    out!("  {width}x{height} pixels, view samples by layer {layers:?} ({counted})")?;
    let [all, fewest] = memory.images.map(megabytes);
    out!("  light images: {}", if all == fewest { all } else { format!("{fewest} to {all}, as the budget allows") })?;
    if let Some(plan) = &survey.transfer {
        out!("  indirect light: {}", plan.describe())?;
    }
    for reason in reasons {
        out!("    {reason}")?;
    }
    if let Some(target) = &target {
        let shadows = if traced { "traced shadows" } else { "shadow maps" };
        out!("  device: {}, {shadows}", target.device.name)?;
    }
    if let Some(verdict) = verdict {
        out!("  memory: {verdict}")?;
    }
    out!("left out:")?;
    for item in left_out {
        out!("  {}: {} (saves {})", item.what, item.why, item.saves)?;
    }
    Ok(())
}

/// Where the counts are from: a bake in the cache, the picture itself, or the size of a smaller one.
fn counted_in(counted_in: CountedIn) -> Value {
    match counted_in {
        CountedIn::Cache => json!("cache"),
        CountedIn::Picture => json!("picture"),
        CountedIn::Smaller(size) => json!(size),
    }
}

fn megabytes(bytes: u64) -> String {
    format!("{:.0} MB", bytes as f64 * 1e-6)
}

/// As --budget takes it.
fn rounded_up(bytes: u64) -> String {
    format!("{}M", bytes.div_ceil(1_000_000))
}
