//! Error figures between an image and a reference, free of the reference's noise when it comes in two halves.

mod blocks;
mod flip;
mod legend;
mod maps;

use std::path::Path;

use serde::Serialize;

use self::blocks::{Blocks, Sample};
pub use self::flip::{displayed, error_map as flip_map};
use super::{Image, exr, png};
use crate::error::{Error, Result};

/// What is compared: pictures of one size, scene-linear, row by row.
#[derive(Clone, Debug)]
pub struct Pictures {
    pub width: usize,
    pub height: usize,
    pub image: Vec<[f32; 3]>,
    pub reference: Vec<[f32; 3]>,
    /// A second reference whose noise is independent of the first's.
    pub second: Option<Vec<[f32; 3]>>,
    /// Which pixels count; all of them without.
    pub mask: Option<Vec<bool>>,
}

/// How pictures are compared.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Figures are taken on means of `block` x `block` pixels; 1 = on pixels.
    pub block: usize,
    /// Share of the samples that `trimmed` leaves out, in [0, 1).
    pub trim: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { block: 1, trim: 0.0 }
    }
}

/// Error figures over all samples (pixels or block means) and RGB; `None` where the reference gives no scale.
///
/// With x the image, a and b the references (b = a if there is one) and r = (a + b) / 2, every squared error (x - r)²
/// is (x - a)(x - b) and every squared norm r² under it is ab: their means are free of the noise of two independent
/// references. A negative mean becomes 0. Where nothing counts, all are `None`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// sqrt(mean((x - a)(x - b)) / mean(ab)): relative to the reference's root mean square.
    pub rel_rmse: Option<f64>,
    /// sqrt(mean((x - a)(x - b))), in the image's unit.
    pub rmse: Option<f64>,
    /// mean((x - a)(x - b) / (r² + 0.01 mean(r)²)). Here r² stays as it is: ab can be negative in one sample.
    pub rel_mse: Option<f64>,
    /// mean(x - r) / mean(r).
    pub bias: Option<f64>,
    /// Mean of FLIP's error map between x and r as displayed [Andersson 2020]; 0 = no difference, 1 = the largest.
    ///
    /// Displayed is 0.5 / mean(r) times the picture, through the ACES fit of [Narkowicz 2015] into 8-bit sRGB, at 67
    /// pixels a degree. FLIP sees whole pictures: where nothing counts, both show the reference.
    pub flip_mean: Option<f64>,
    /// The same between a and b at the same exposure: what the references' noise does to FLIP, which nothing frees of
    /// it. Differences near it say nothing.
    pub flip_floor: Option<f64>,
    /// Whether two references were given.
    pub noise_free: bool,
    /// `rel_rmse` of what is left when the round(trim * count) worst samples are taken out of both its sums.
    ///
    /// The worst have the largest error (x - a)(x - b) summed over RGB; of equal ones the first in rows goes first.
    /// Noise helps to choose them, so this one is a little too small where two references are noisy.
    pub trimmed: Option<f64>,
    /// max |x - r| over samples and RGB.
    pub max_abs: Option<f64>,
    /// Pixels that the mask counts where a channel of the image is infinite or not a number; left out of all else.
    pub non_finite: usize,
    /// The same for pixels of the references whose image is finite.
    pub reference_non_finite: usize,
    /// In pixels, whatever the blocks.
    pub width: usize,
    pub height: usize,
}

impl Pictures {
    /// Reads one layer (`""` = unnamed) of EXR files and a mask, white where a pixel counts.
    ///
    /// A reference that holds nothing but the unnamed layer is taken as the layer asked for.
    pub fn read(
        image: &Path,
        reference: &Path,
        second: Option<&Path>,
        layer: &str,
        mask: Option<&Path>,
    ) -> Result<Self> {
        let picture = exr::read(image)?;
        let (width, height) = (picture.width, picture.height);
        let same_size = |path: &Path, size: (usize, usize)| {
            if size == (width, height) {
                return Ok(());
            }
            let reason = format!("{}x{} pixels, but {} has {width}x{height}", size.0, size.1, image.display());
            Err(Error::import(path, reason))
        };
        let read_reference = |path: &Path| {
            let reference = exr::read(path)?;
            same_size(path, (reference.width, reference.height))?;
            let is_one_picture = reference.layers.len() == 1 && reference.layers[0].name.is_empty();
            take_layer(path, reference, if is_one_picture { "" } else { layer })
        };
        let read_mask = |path: &Path| {
            let mask = png::read(path)?;
            same_size(path, (mask.width, mask.height))?;
            Ok(mask.rgba.iter().map(|&[r, g, b, _]| r.min(g).min(b) >= 128).collect())
        };
        Ok(Self {
            width,
            height,
            image: take_layer(image, picture, layer)?,
            reference: read_reference(reference)?,
            second: second.map(read_reference).transpose()?,
            mask: mask.map(read_mask).transpose()?,
        })
    }

    /// The error figures.
    pub fn figures(&self, settings: Settings) -> Figures {
        assert!((0.0..1.0).contains(&settings.trim), "share {} to trim", settings.trim);
        let blocks = Blocks::new(self, settings.block);
        let samples: Vec<Sample> = blocks.counting().collect();
        let values = 3.0 * samples.len() as f64;
        let total = |value: fn(&Sample) -> [f64; 3]| samples.iter().flat_map(value).sum::<f64>();
        let squared_error = (total(Sample::errors) / values).max(0.0);
        let any = !samples.is_empty();
        let mean_reference = blocks.mean_reference().unwrap_or(0.0);
        let has_mean = mean_reference != 0.0;
        let relative = |sample: &Sample| -> f64 {
            let (errors, reference) = (sample.errors(), sample.reference());
            // 1e-2: keeps black pixels from counting without bound, as the contract has it.
            (0..3).map(|c| errors[c] / (reference[c] * reference[c] + 1e-2 * mean_reference * mean_reference)).sum()
        };
        let flip = |reference: fn(&Sample) -> [f64; 3], test: fn(&Sample) -> [f64; 3]| {
            (mean_reference > 0.0).then(|| flip::mean(&blocks, 0.5 / mean_reference, reference, test))
        };
        Figures {
            rel_rmse: relative_rmse(&samples),
            rmse: any.then(|| squared_error.sqrt()),
            rel_mse: has_mean.then(|| (samples.iter().map(relative).sum::<f64>() / values).max(0.0)),
            bias: has_mean.then(|| total(Sample::differences) / values / mean_reference),
            flip_mean: flip(Sample::reference, |sample| sample.x),
            flip_floor: self.second.as_ref().and_then(|_| flip(|sample| sample.a, |sample| sample.b)),
            noise_free: self.second.is_some(),
            max_abs: samples.iter().flat_map(Sample::differences).map(f64::abs).reduce(f64::max),
            trimmed: relative_rmse(&without_worst(samples, settings.trim)),
            non_finite: blocks.non_finite,
            reference_non_finite: blocks.reference_non_finite,
            width: self.width,
            height: self.height,
        }
    }

    fn check_lengths(&self) {
        let pixels = self.width * self.height;
        assert_eq!(self.image.len(), pixels, "pixels of the image");
        assert_eq!(self.reference.len(), pixels, "pixels of the reference");
        assert_eq!(self.second.as_ref().map_or(pixels, Vec::len), pixels, "pixels of the second reference");
        assert_eq!(self.mask.as_ref().map_or(pixels, Vec::len), pixels, "pixels of the mask");
    }
}

fn take_layer(path: &Path, image: Image, name: &str) -> Result<Vec<[f32; 3]>> {
    let called = |name: &str| if name.is_empty() { "(unnamed)".to_owned() } else { format!("`{name}`") };
    match image.layer(name) {
        Some(layer) => Ok(layer.pixels.clone()),
        None => {
            let names: Vec<_> = image.layers.iter().map(|layer| called(&layer.name)).collect();
            Err(Error::import(path, format!("has no layer {}, only {}", called(name), names.join(", "))))
        }
    }
}

fn relative_rmse(samples: &[Sample]) -> Option<f64> {
    let errors: f64 = samples.iter().flat_map(Sample::errors).sum();
    let squares: f64 = samples.iter().flat_map(Sample::squares).sum();
    (squares > 0.0).then(|| (errors.max(0.0) / squares).sqrt())
}

fn without_worst(mut samples: Vec<Sample>, share: f64) -> Vec<Sample> {
    let worst = (share * samples.len() as f64).round() as usize;
    if worst == 0 {
        // Sums in the order of rows, so that trimming nothing gives `rel_rmse` to the last bit.
        return samples;
    }
    let error = |sample: &Sample| sample.errors().iter().sum::<f64>();
    samples.sort_by(|p, q| error(q).total_cmp(&error(p)));
    samples.split_off(worst)
}
