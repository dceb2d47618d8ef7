//! `relume compare`: error figures as JSON.

use std::path::PathBuf;

use relume::Result;
use relume::image::compare::{Figures, Pictures, Settings};
use relume::image::png;
use serde::Serialize;
use serde_json::json;

use super::output::make_parent;
use super::progress;
use super::stdout::out;

#[derive(clap::Args, Debug)]
pub struct Args {
    /// EXR file to judge
    image: PathBuf,

    /// EXR file that holds the truth
    reference: PathBuf,

    /// Second truth with noise of its own: the errors are then free of the truths' noise
    reference_b: Option<PathBuf>,

    /// Layer to compare [default: the unnamed one, `beauty`]; a reference of the unnamed layer alone stands for it
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
    layer: String,

    /// Compares means of NxN pixels
    #[arg(long, value_name = "N", default_value = "1", value_parser = parse_block)]
    block: usize,

    /// Share of the pixels, from the worst, that `trimmed` leaves out: 0 <= F < 1
    #[arg(long, value_name = "F", default_value = "0", value_parser = parse_trim)]
    trim: f64,

    /// Counts only the pixels that are white here
    #[arg(long, value_name = "PNG")]
    mask: Option<PathBuf>,

    /// Writes the absolute difference times --scale, clamped, as sRGB
    #[arg(long, value_name = "OUT.png")]
    diff: Option<PathBuf>,

    /// Writes the difference in false colours, with a legend; the brightest stands for 1 / --scale
    #[arg(long, value_name = "OUT.png")]
    false_color: Option<PathBuf>,

    /// Factor on the differences of --diff and --false-color
    #[arg(long, value_name = "FACTOR", default_value = "2", value_parser = parse_scale)]
    scale: f32,
}

#[derive(Serialize)]
struct Output<'a> {
    schema: u32,
    #[serde(flatten)]
    figures: &'a Figures,
}

/// Prints the figures on stdout and writes the difference maps that are asked for.
pub fn run(args: &Args) -> Result<()> {
    [&args.diff, &args.false_color].into_iter().flatten().try_for_each(|path| make_parent(path))?;
    let spinner = progress::spinner("comparing");
    let second = args.reference_b.as_deref();
    let pictures = Pictures::read(&args.image, &args.reference, second, &args.layer, args.mask.as_deref())?;
    if let Some(path) = &args.diff {
        png::write(path, pictures.width, pictures.height, &pictures.difference_map(args.block, args.scale))?;
    }
    if let Some(path) = &args.false_color {
        let map = pictures.false_color(args.block, args.scale);
        png::write(path, map.width, map.height, &map.rgba)?;
    }
    let figures = pictures.figures(Settings { block: args.block, trim: args.trim });
    spinner.finish_and_clear();
    out!("{:#}", json!(Output { schema: 1, figures: &figures }))
}

fn parse_block(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&block| block > 0).ok_or_else(|| "a whole number of pixels from 1".to_owned())
}

fn parse_trim(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|share| (0.0..1.0).contains(share)).ok_or_else(|| "a share from 0, below 1".to_owned())
}

fn parse_scale(text: &str) -> Result<f32, String> {
    let scale = text.parse().ok().filter(|scale: &f32| scale.is_finite() && *scale > 0.0);
    scale.ok_or_else(|| "a positive number".to_owned())
}
