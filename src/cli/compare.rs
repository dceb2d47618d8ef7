//! `relume compare`: error figures as JSON.

use std::path::PathBuf;

use relume::Result;
use relume::image::compare::{Figures, Pictures, Settings};
use relume::image::png;
use serde::Serialize;
use serde_json::json;

use super::options::check_extension;
use super::output_file::{check_outputs, make_parent};
use super::progress;
use super::stdout::out;

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Image to measure: an EXR file.
    image: PathBuf,

    /// Reference: an EXR file.
    reference: PathBuf,

    /// Second reference, with independent noise. With it, the errors are free of the noise of both references.
    reference_b: Option<PathBuf>,

    /// Layer to compare [default: `beauty`, the layer without a name]. If a reference has only a layer without a name,
    /// that one is compared.
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
    layer: String,

    /// Compares means of blocks of NxN pixels.
    #[arg(long, value_name = "N", default_value = "1", value_parser = parse_block)]
    block: usize,

    /// Share of the pixels, those with the largest errors, that `trimmed` leaves out: from 0, less than 1.
    #[arg(long, value_name = "F", default_value = "0", value_parser = parse_trim)]
    trim: f64,

    /// Image whose white pixels are compared; all others are left out.
    #[arg(long, value_name = "PNG")]
    mask: Option<PathBuf>,

    /// Writes an image of the absolute difference times --scale, clamped, as sRGB.
    #[arg(long, value_name = "OUT.png")]
    diff: Option<PathBuf>,

    /// Writes an image of the difference in false colours, with a legend. The brightest colour is a difference of 1 /
    /// --scale.
    #[arg(long, value_name = "OUT.png")]
    false_color: Option<PathBuf>,

    /// Factor for the differences in --diff and --false-color.
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
    let maps = || [&args.diff, &args.false_color].into_iter().flatten();
    maps().try_for_each(|path| make_parent(path).and_then(|()| check_extension(path, &["png"])))?;
    let read = [&args.image, &args.reference].into_iter().chain(&args.reference_b).chain(&args.mask);
    check_outputs(read.map(PathBuf::as_path), maps().map(PathBuf::as_path))?;
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
    text.parse()
        .ok()
        .filter(|&block| block > 0)
        .ok_or_else(|| "expected a whole number of pixels, at least 1".to_owned())
}

fn parse_trim(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|share| (0.0..1.0).contains(share))
        .ok_or_else(|| "expected a number from 0, less than 1".to_owned())
}

fn parse_scale(text: &str) -> Result<f32, String> {
    let scale = text.parse().ok().filter(|scale: &f32| scale.is_finite() && *scale > 0.0);
    scale.ok_or_else(|| "expected a number greater than 0".to_owned())
}
