//! `relume compare`: error figures as JSON.

use std::io::Write;
use std::path::{Path, PathBuf};

use relume::image::compare::{Figures, Pictures, Settings};
use relume::image::png;
use relume::{Error, Result};
use serde::Serialize;

/// Error figures of an image against a reference, as JSON.
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

    /// Compare means of NxN pixels
    #[arg(long, value_name = "N", default_value = "1", value_parser = parse_block)]
    block: usize,

    /// Share of the pixels, from the worst, that `trimmed` leaves out: 0 <= F < 1
    #[arg(long, value_name = "F", default_value = "0", value_parser = parse_trim)]
    trim: f64,

    /// Count only the pixels that are white here
    #[arg(long, value_name = "PNG")]
    mask: Option<PathBuf>,

    /// Write the absolute difference times the scale, clamped, as sRGB
    #[arg(long, value_name = "OUT.png")]
    diff: Option<PathBuf>,

    /// Factor on the differences of --diff
    #[arg(long, value_name = "FACTOR", default_value = "2", value_parser = parse_scale)]
    scale: f32,
}

#[derive(Serialize)]
struct Output<'a> {
    schema: u32,
    #[serde(flatten)]
    figures: &'a Figures,
}

/// Prints the figures on stdout and writes the difference map if one is asked for.
pub fn run(args: &Args) -> Result<()> {
    let second = args.reference_b.as_deref();
    let pictures = Pictures::read(&args.image, &args.reference, second, &args.layer, args.mask.as_deref())?;
    if let Some(path) = &args.diff {
        png::write(path, pictures.width, pictures.height, &pictures.difference_map(args.scale))?;
    }
    let figures = pictures.figures(Settings { block: args.block, trim: args.trim });
    let stdout = Path::new("standard output");
    let json = serde_json::to_string_pretty(&Output { schema: 1, figures: &figures })
        .map_err(|source| Error::Export { path: stdout.to_owned(), source: source.into() })?;
    writeln!(std::io::stdout(), "{json}").map_err(Error::io("write", stdout))
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
