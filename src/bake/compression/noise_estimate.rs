//! Separates light from noise by rows that are gathered twice.

use std::ops::Range;

use faer::{Mat, MatRef};

use super::vector_batch::VectorBatch;
use crate::bake::linear;

/// Images of the deciding lights, and at some pixels the same images with resampled rows.
///
/// The projection of an image onto some directions contains light and noise. The noise is independent of that of the
/// resampled image, so the expected product of the two contains light alone. The projection onto all directions is
/// subtracted first, which reduces the variance if few pixels are resampled.
///
/// Matrices of images have a column for each deciding light, channel by channel, times the square root of the light's
/// weight.
pub struct NoiseEstimate {
    /// Square of the noise of the deciding lights' images: mean over the lights, and weighted mean.
    pub noise: f64,
    pub weighted_noise: f64,
    lights: Range<usize>,
    /// Square roots of the lights' weights, which sum to 1. Lights with more noise than the median of those that reach
    /// the pixels have smaller weights, so that few noisy lights do not hide the others.
    roots: Vec<f64>,
    /// All pixels x deciding lights.
    pub images: Mat<f64>,
    /// Indices of the resampled pixels.
    pixels: Vec<usize>,
    /// Their resampled images.
    again: Mat<f64>,
}

impl NoiseEstimate {
    /// `images` are images at all pixels, and `lights` the deciding ones among them; `again` are images at the
    /// resampled `pixels`.
    pub fn new(pixels: &[usize], images: &VectorBatch, again: &VectorBatch, lights: &Range<usize>) -> Self {
        let times = 0.5 * images.rows() as f64 / pixels.len() as f64;
        let noise: Vec<f64> =
            lights.clone().map(|light| times * squared_distance(pixels, images, again, light)).collect();
        let squares = &images.squares()[lights.clone()];
        let least = MIN_SQUARE_SHARE * squares.iter().sum::<f64>() / squares.len() as f64;
        let reaching = noise.iter().zip(squares).filter(|(_, square)| **square > least).map(|(noise, _)| *noise);
        let mut sorted: Vec<f64> = reaching.collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let weight = |noise: &f64| if median > 0.0 && *noise > median { median / noise } else { 1.0 };
        let all: f64 = noise.iter().map(weight).sum();
        let mut twice = Self {
            noise: noise.iter().sum::<f64>() / noise.len() as f64,
            weighted_noise: noise.iter().map(|noise| noise * weight(noise) / all).sum(),
            lights: lights.clone(),
            roots: noise.iter().map(|noise| (weight(noise) / all).sqrt()).collect(),
            images: Mat::new(),
            pixels: pixels.to_vec(),
            again: Mat::new(),
        };
        twice.images = twice.deciding(images.rows(), |c, pixel, light| images.get(c, pixel, light).into());
        twice.again = twice.deciding(pixels.len(), |c, i, light| again.get(c, i, light).into());
        twice
    }

    /// Weighted values of the deciding lights: rows x deciding lights. `value` takes channel, row and light.
    pub fn deciding(&self, rows: usize, value: impl Fn(usize, usize, usize) -> f64) -> Mat<f64> {
        let count = self.roots.len();
        Mat::from_fn(rows, 3 * count, |row, column| {
            let light = column % count;
            value(column / count, row, self.lights.start + light) * self.roots[light]
        })
    }

    /// The smallest number of leading directions such that the others contain at most `budget` of the light.
    /// `directions` are orthonormal, all pixels x directions; `projections` are the images' coefficients along them.
    pub fn needed(&self, directions: MatRef<f64>, projections: MatRef<f64>, budget: f64) -> usize {
        let seen = Mat::from_fn(self.pixels.len(), directions.ncols(), |i, j| directions[(self.pixels[i], j)]);
        let missing = &self.again - linear::product(seen.as_ref(), projections);
        let missing = linear::product(seen.transpose(), missing.as_ref()) * faer::Scale(self.times());
        let light =
            |j: usize| projections.row(j).iter().zip(missing.row(j).iter()).map(|(x, y)| x * (x + y)).sum::<f64>();
        let mut left = 0.0;
        let few = (0..projections.nrows()).rev().take_while(|&j| {
            left += light(j);
            left <= budget
        });
        projections.nrows() - few.count()
    }

    /// Squared error of the light in `got` against `projections`, the images' projections onto a basis; and the squared
    /// noise of the images that `got` discards. Sums over all pixels; as estimates, both can be negative.
    pub fn lost(&self, projections: &Mat<f64>, got: &Mat<f64>) -> (f64, f64) {
        let off = got - projections;
        let on_all = |i: usize, j: usize| off[(i, j)] * (off[(i, j)] + projections[(i, j)] - self.images[(i, j)]);
        let again =
            |i: usize, j: usize| off[(self.pixels[i], j)] * (projections[(self.pixels[i], j)] - self.again[(i, j)]);
        let columns = || 0..off.ncols();
        let all: f64 = columns().flat_map(|j| (0..off.nrows()).map(move |i| (i, j))).map(|(i, j)| on_all(i, j)).sum();
        let some: f64 =
            columns().flat_map(|j| (0..self.pixels.len()).map(move |i| (i, j))).map(|(i, j)| again(i, j)).sum();
        let light = all + self.times() * some;
        let of_images: f64 = columns()
            .map(|j| got.col(j).iter().zip(self.images.col(j).iter()).map(|(x, y)| (x - y).powi(2)).sum::<f64>())
            .sum();
        (light, of_images - light)
    }

    /// Squared light of the images outside a basis, given their `projections` onto it; sum over all pixels. A
    /// lower bound: two standard deviations are subtracted from the estimate.
    pub fn outside(&self, projections: &Mat<f64>) -> f64 {
        let product = |(i, &p): (usize, &usize)| -> f64 {
            (0..projections.ncols())
                .map(|j| (self.images[(p, j)] - projections[(p, j)]) * (self.again[(i, j)] - projections[(p, j)]))
                .sum()
        };
        let products: Vec<f64> = self.pixels.iter().enumerate().map(product).collect();
        let mean = products.iter().sum::<f64>() / products.len() as f64;
        let variance = products.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / products.len() as f64;
        let chance = (variance / products.len() as f64).sqrt();
        self.images.nrows() as f64 * (mean - 2.0 * chance).max(0.0)
    }

    /// Ratio of all pixels to resampled ones.
    fn times(&self) -> f64 {
        self.images.nrows() as f64 / self.pixels.len() as f64
    }
}

/// A light reaches the pixels if its image's square exceeds this share of the mean over all lights.
const MIN_SQUARE_SHARE: f64 = 0.01;

/// Squared distance of a light's two images, over all channels.
fn squared_distance(pixels: &[usize], images: &VectorBatch, again: &VectorBatch, light: usize) -> f64 {
    let square = |channel: usize, i: usize| {
        f64::from(again.get(channel, i, light) - images.get(channel, pixels[i], light)).powi(2)
    };
    (0..3).flat_map(|channel| (0..pixels.len()).map(move |i| (channel, i))).map(|(c, i)| square(c, i)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::sequence::Points;

    const PIXELS: usize = 512;
    const LIGHTS: usize = 24;
    /// Number of directions that contain light.
    const LIT: usize = 8;

    fn random(i: usize, j: usize) -> f64 {
        Points::new(1, 0).at(i as u32, j as u32)[0] - 0.5
    }

    /// Orthonormal directions, coefficients of noise-free lights along them, and their images with noise. Light halves
    /// from each direction to the next; light l and its noise are scaled by `share(l)`.
    fn images(noise: f64, share: impl Fn(usize) -> f64 + Sync) -> (Mat<f64>, Mat<f64>, NoiseEstimate) {
        let (directions, _) = linear::orthonormal(&Mat::from_fn(PIXELS, 64, random));
        let light = |j: usize, l: usize| random(j, 100 + l) * 0.5f64.powi(j as i32) * share(l % LIGHTS);
        let light = Mat::from_fn(64, 3 * LIGHTS, |j, l| if j < LIT { light(j, l) } else { 0.0 });
        let image = linear::product(directions.as_ref(), light.as_ref());
        let noisy = |purpose: usize, rows: &[usize]| {
            VectorBatch::from_fn(rows.len(), LIGHTS, |c, i, l| {
                let noise = noise * share(l) * random(rows[i], purpose + c * LIGHTS + l);
                (image[(rows[i], c * LIGHTS + l)] + noise) as f32
            })
        };
        let resampled: Vec<usize> = (0..PIXELS).step_by(4).collect();
        let all: Vec<usize> = (0..PIXELS).collect();
        let twice = NoiseEstimate::new(&resampled, &noisy(1000, &all), &noisy(2000, &resampled), &(0..LIGHTS));
        (directions, light, twice)
    }

    fn square(row: faer::RowRef<f64>) -> f64 {
        row.iter().map(|x| x * x).sum()
    }

    #[test]
    fn noise_is_not_light() {
        let (directions, light, twice) = images(0.01, |_| 1.0);
        let projections = linear::product(directions.transpose(), twice.images.as_ref());
        let within = |count: usize| linear::product(directions.subcols(0, count), projections.subrows(0, count));
        for kept in [5, 4] {
            let lost = (kept..LIT).map(|j| square(light.row(j))).sum::<f64>() / LIGHTS as f64;
            let in_others: f64 = (kept..64).map(|j| square(projections.row(j))).sum();
            assert!(in_others > 1.5 * lost, "there is too little noise: {in_others}, light {lost}");
            let needed = twice.needed(directions.as_ref(), projections.as_ref(), 1.5 * lost);
            assert_eq!(needed, kept);
            let (found, _) = twice.lost(&within(64), &within(kept));
            assert!((found - lost).abs() < 0.2 * in_others, "{kept} directions: {found} instead of {lost}");
        }
        // A basis of three directions lacks the light of five, and one of eight lacks none.
        let lost: f64 = (3..LIT).map(|j| square(light.row(j))).sum::<f64>() / LIGHTS as f64;
        let found = twice.outside(&within(3));
        assert!(found > 0.6 * lost && found < lost, "{found} outside instead of {lost}");
        assert!(twice.outside(&within(LIT)) < 0.01 * lost);
    }

    /// If most lights hardly reach the pixels or not at all, the remaining lights decide.
    #[test]
    fn lights_elsewhere_do_not_decide() {
        for elsewhere in [0.0, 1e-4] {
            let (directions, light, twice) = images(0.01, |light| if light < 5 { 1.0 } else { elsewhere });
            let projections = linear::product(directions.transpose(), twice.images.as_ref());
            let lost = (4..LIT).map(|j| square(light.row(j))).sum::<f64>() / LIGHTS as f64;
            assert_eq!(
                twice.needed(directions.as_ref(), projections.as_ref(), 1.5 * lost),
                4,
                "{elsewhere} of light elsewhere"
            );
        }
    }
}
