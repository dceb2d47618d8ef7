//! Two estimates of one picture, one without noise but biased, one noisy but right in the mean, combined so that the
//! expected squared error is least [James 1961].
//!
//! Bias is smooth and noise is not. So the difference is split by Haar wavelets, and each size is shrunk according to
//! its noise. Pixels that are black in all estimates, as where no surface is seen, take no part: nothing is added to
//! them.

use glam::Vec3;

/// Sizes of blocks: 1, 2, 4 and so on pixels.
const LEVELS: usize = 6;

/// How two estimates are combined.
pub struct Combination {
    /// From pixels to the largest blocks.
    levels: Vec<Level>,
    /// Of each pixel: 1, or 0 where all estimates are black.
    lit: Vec<f32>,
}

/// Blocks of one size.
struct Level {
    size: [usize; 2],
    /// By parent: share of a block's difference from its parent that is kept. At the last level: by block, of all of
    /// it.
    shares: Vec<f32>,
    /// By parent or block: expected squared error of what is kept.
    errors2: Vec<f64>,
}

/// An image at one level: means of its blocks.
struct Means {
    size: [usize; 2],
    pixels: Vec<Vec3>,
    /// Pixels in each block that take part.
    counts: Vec<f32>,
}

impl Means {
    fn new(width: usize, pixels: Vec<Vec3>, counts: Vec<f32>) -> Self {
        Self { size: [width, pixels.len() / width], pixels, counts }
    }

    /// The next larger blocks.
    fn halved(&self) -> Self {
        let size = self.size.map(|size| size.div_ceil(2));
        let count = size[0] * size[1];
        let mut means = Self { size, pixels: vec![Vec3::ZERO; count], counts: vec![0.0; count] };
        for (i, (pixel, count)) in self.pixels.iter().zip(&self.counts).enumerate() {
            let parent = parent(i, self.size[0], size[0]);
            means.pixels[parent] += *pixel * *count;
            means.counts[parent] += *count;
        }
        means.pixels.iter_mut().zip(&means.counts).for_each(|(sum, count)| *sum /= count.max(1.0));
        means
    }

    /// This image at all levels.
    fn pyramid(self) -> Vec<Self> {
        let mut levels = vec![self];
        for level in 1..LEVELS {
            levels.push(levels[level - 1].halved());
        }
        levels
    }
}

/// No difference where an estimate is not finite.
fn finite(difference: Vec3) -> Vec3 {
    if difference.is_finite() { difference } else { Vec3::ZERO }
}

fn parent(i: usize, width: usize, parents: usize) -> usize {
    i / width / 2 * parents + i % width / 2
}

/// Of each block its difference from its parent; at the last level all of it.
fn details(levels: &[Means], level: usize) -> Vec<Vec3> {
    let Means { size, pixels, .. } = &levels[level];
    let Some(parents) = levels.get(level + 1) else { return pixels.clone() };
    let of = |(i, pixel): (usize, &Vec3)| *pixel - parents.pixels[parent(i, size[0], parents.size[0])];
    pixels.iter().enumerate().map(of).collect()
}

impl Combination {
    /// From pictures of `width` pixels a row: the biased one, and two independent halves of the noisy one.
    pub fn new(width: usize, biased: &[Vec3], halves: [&[Vec3]; 2]) -> Self {
        let is_lit =
            |(biased, (a, b)): (&Vec3, (&Vec3, &Vec3))| [biased, a, b].iter().any(|pixel| **pixel != Vec3::ZERO);
        let lit = biased.iter().zip(halves[0].iter().zip(halves[1]));
        let lit: Vec<f32> = lit.map(|pixel| if is_lit(pixel) { 1.0 } else { 0.0 }).collect();
        let difference =
            |half: &[Vec3]| half.iter().zip(biased).map(|(pixel, biased)| finite(*pixel - *biased)).collect();
        let [a, b] = halves.map(|half| Means::new(width, difference(half), lit.clone()).pyramid());
        let level = |level: usize| {
            let size = a[level].size;
            let owners = a.get(level + 1).map_or(size, |parents| parents.size);
            // Sums over the blocks of each owner: of squares, of squared differences of the halves, and their number.
            // In double precision, since lights may be of any brightness.
            let mut squares = vec![[0.0; 3]; owners[0] * owners[1]];
            let counts = &a[level].counts;
            let of_halves = details(&a, level).into_iter().zip(details(&b, level)).enumerate();
            for (i, (a, b)) in of_halves.filter(|(i, _)| counts[*i] > 0.0) {
                let owner = if owners == size { i } else { parent(i, size[0], owners[0]) };
                let [all, noise, count] = &mut squares[owner];
                *all += 0.25 * (a + b).as_dvec3().length_squared();
                *noise += 0.25 * (a - b).as_dvec3().length_squared();
                *count += 3.0;
            }
            let windows: Vec<_> = (0..squares.len()).map(|owner| around(&squares, owners, owner)).collect();
            // Clamping at 0 overestimates the squared bias. `held` scales the clamped values back to the unclamped sum.
            let excess = windows.iter().map(|[all, noise, _]| all - noise);
            let (sum, above) = excess.fold((0.0, 0.0), |(sum, above), excess| (sum + excess, above + excess.max(0.0)));
            let held = if above > 0.0 { (sum / above).max(0.0) } else { 0.0 };
            let (shares, errors2) = windows.iter().map(|window| kept(window, held)).unzip();
            Level { size, shares, errors2 }
        };
        Self { levels: (0..LEVELS).map(level).collect(), lit }
    }

    /// What is added to the biased estimate, of all light or of a part of it.
    pub fn change(&self, biased: &[Vec3], halves: [&[Vec3]; 2]) -> Vec<Vec3> {
        let difference = biased.iter().zip(halves[0].iter().zip(halves[1]));
        let difference = difference.map(|(biased, (a, b))| finite((*a + *b) * 0.5 - *biased)).collect();
        let levels = Means::new(self.levels[0].size[0], difference, self.lit.clone()).pyramid();
        let mut sums: Vec<Vec3> = Vec::new();
        for (level, Level { size, shares, .. }) in self.levels.iter().enumerate().rev() {
            let above = self.levels.get(level + 1).map(|above| above.size[0]);
            let sum = |(i, detail): (usize, Vec3)| match above {
                Some(above) => {
                    let owner = parent(i, size[0], above);
                    sums[owner] + shares[owner] * detail
                }
                None => shares[i] * detail,
            };
            sums = details(&levels, level).into_iter().enumerate().map(sum).collect();
        }
        sums.iter_mut().zip(&self.lit).for_each(|(sum, lit)| *sum *= *lit);
        sums
    }

    /// Expected squared error of each pixel, mean over its channels.
    pub fn errors2(&self) -> Vec<f64> {
        let mut sums: Vec<f64> = self.levels[LEVELS - 1].errors2.clone();
        for level in (0..LEVELS - 1).rev() {
            let Level { size, errors2, .. } = &self.levels[level];
            let parents = self.levels[level + 1].size[0];
            sums = (0..size[0] * size[1])
                .map(|i| parent(i, size[0], parents))
                .map(|owner| sums[owner] + errors2[owner])
                .collect();
        }
        sums.iter_mut().zip(&self.lit).for_each(|(sum, lit)| *sum *= f64::from(*lit));
        sums
    }
}

/// Standard deviations by which a sum of squares must exceed that of the noise.
const DOUBT: f64 = 1.0;

/// Sum over an owner and its neighbours: one alone has few blocks to tell from.
fn around(squares: &[[f64; 3]], size: [usize; 2], owner: usize) -> [f64; 3] {
    let (x, y) = (owner % size[0], owner / size[0]);
    let mut sum = [0.0; 3];
    for y in y.saturating_sub(1)..(y + 2).min(size[1]) {
        for x in x.saturating_sub(1)..(x + 2).min(size[0]) {
            sum.iter_mut().zip(squares[y * size[0] + x]).for_each(|(sum, value)| *sum += value);
        }
    }
    sum
}

/// Share that is kept, and the expected squared error: from sums of squares, of those by noise, and their number.
/// `held`: what the excess over noise is multiplied by.
fn kept(&[all, noise, count]: &[f64; 3], held: f64) -> (f32, f64) {
    let count = count.max(1.0);
    // Where there is nothing but noise, sums of few squares differ by chance. Channels mostly have the same noise.
    let doubt = 1.0 + DOUBT / (count / 3.0).sqrt();
    let share = if all > doubt * noise { 1.0 - doubt * noise / all } else { 0.0 };
    let bias = held * (all - noise).max(0.0);
    (share as f32, (share * share * noise + (1.0 - share) * (1.0 - share) * bias) / count)
}
