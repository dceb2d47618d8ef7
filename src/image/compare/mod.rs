//! Error metrics between an image and a reference; unbiased by the reference's noise if it consists of two halves.

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

/// The images to compare: of one size, scene-linear, row by row.
#[derive(Clone, Debug)]
pub struct Pictures {
    pub width: usize,
    pub height: usize,
    pub image: Vec<[f32; 3]>,
    pub reference: Vec<[f32; 3]>,
    /// A second reference whose noise is independent of the first's.
    pub second: Option<Vec<[f32; 3]>>,
    /// Pixels that count; `None` means all.
    pub mask: Option<Vec<bool>>,
}

/// Settings of a comparison.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Metrics compare means of `block` x `block` pixels; 1 compares pixels.
    pub block: usize,
    /// Share of the samples that `trimmed` excludes, in [0, 1).
    pub trim: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { block: 1, trim: 0.0 }
    }
}

/// Error metrics over all samples (pixels or block means) and RGB; `None` if the reference gives no scale.
///
/// With x the image, a and b the references (b = a if there is only one) and r = (a + b) / 2, every squared error (x -
/// r)² is computed as (x - a)(x - b), and every squared norm r² in a denominator as ab: their means are not biased by
/// the noise of two independent references. A negative mean becomes 0. If no sample counts, all are `None`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// sqrt(mean((x - a)(x - b)) / mean(ab)): relative to the reference's root mean square.
    pub rel_rmse: Option<f64>,
    /// sqrt(mean((x - a)(x - b))), in the image's unit.
    pub rmse: Option<f64>,
    /// mean((x - a)(x - b) / (r² + 0.01 mean(r)²)). Here r² is not replaced, because ab can be negative in one sample.
    pub rel_mse: Option<f64>,
    /// mean(x - r) / mean(r).
    pub bias: Option<f64>,
    /// Mean of FLIP's error map between x and r as displayed [Andersson 2020]; 0 = no difference, 1 = the largest.
    ///
    /// Displayed is 0.5 / mean(r) times the image, through the ACES fit of [Narkowicz 2015] to 8-bit sRGB, at 67 pixels
    /// per degree. FLIP processes whole images: where no sample counts, both show the reference.
    pub flip_mean: Option<f64>,
    /// The same between a and b at the same exposure: the effect of the references' noise, which cannot be removed from
    /// FLIP. Values of `flip_mean` near it are not significant.
    pub flip_floor: Option<f64>,
    /// Whether two references were given.
    pub noise_free: bool,
    /// `rel_rmse` after the round(trim * count) worst samples are removed from both its sums.
    ///
    /// The worst samples have the largest error (x - a)(x - b) summed over RGB; of equal ones, the first in row order
    /// is removed first. The choice depends on noise, so with two noisy references the value is slightly too small.
    pub trimmed: Option<f64>,
    /// max |x - r| over samples and RGB.
    pub max_abs: Option<f64>,
    /// Pixels inside the mask with an infinite or NaN channel in the image; excluded from everything else.
    pub non_finite: usize,
    /// Pixels inside the mask with a finite image and a non-finite reference; also excluded.
    pub reference_non_finite: usize,
    /// In pixels, for any block size.
    pub width: usize,
    pub height: usize,
}

impl Pictures {
    /// Reads one layer (`""` = unnamed) of EXR files, and a mask that is white where a pixel counts.
    ///
    /// If a reference has only the unnamed layer, that layer is used.
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

    /// Computes the error metrics.
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
            // 1e-2: bounds the weight of black pixels; part of the definition of `rel_mse`.
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
        // Preserves row order, so that trimming nothing gives `rel_rmse` to the last bit.
        return samples;
    }
    let error = |sample: &Sample| sample.errors().iter().sum::<f64>();
    samples.sort_by(|p, q| error(q).total_cmp(&error(p)));
    samples.split_off(worst)
}
