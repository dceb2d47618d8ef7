//! Images as means over blocks of pixels.

use rayon::prelude::*;

use super::Pictures;

/// A pixel or a block's mean: image x, references a and b; b = a if there is only one reference.
#[derive(Clone, Copy, Default)]
pub(super) struct Sample {
    pub x: [f64; 3],
    pub a: [f64; 3],
    pub b: [f64; 3],
}

impl Sample {
    /// (x - a)(x - b) per channel.
    pub fn errors(&self) -> [f64; 3] {
        std::array::from_fn(|c| (self.x[c] - self.a[c]) * (self.x[c] - self.b[c]))
    }

    /// ab per channel.
    pub fn squares(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.a[c] * self.b[c])
    }

    /// r = (a + b) / 2 per channel.
    pub fn reference(&self) -> [f64; 3] {
        std::array::from_fn(|c| 0.5 * (self.a[c] + self.b[c]))
    }

    /// x - r per channel.
    pub fn differences(&self) -> [f64; 3] {
        let reference = self.reference();
        std::array::from_fn(|c| self.x[c] - reference[c])
    }

    fn add(&mut self, other: &Sample) {
        for c in 0..3 {
            self.x[c] += other.x[c];
            self.a[c] += other.a[c];
            self.b[c] += other.b[c];
        }
    }

    fn divided_by(&self, count: usize) -> Sample {
        let divided = |sum: [f64; 3]| sum.map(|value| value / count as f64);
        Sample { x: divided(self.x), a: divided(self.a), b: divided(self.b) }
    }

    /// The same with the image and both references replaced by r.
    fn without_error(&self) -> Sample {
        let reference = self.reference();
        Sample { x: reference, a: reference, b: reference }
    }
}

/// Whether a pixel counts, or why it is excluded.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Pixel {
    Counts,
    Masked,
    NonFinite,
    ReferenceNonFinite,
}

/// The images in square blocks, row by row; blocks at the right and lower edge may be smaller.
pub(super) struct Blocks {
    /// In pixels.
    side: usize,
    pub columns: usize,
    /// All have equal weight, however many of their pixels count.
    blocks: Vec<Block>,
    /// Number of pixels of this kind.
    pub non_finite: usize,
    pub reference_non_finite: usize,
}

/// Mean over the pixels that count. If none does, the mean of the references, also in place of the image.
#[derive(Clone, Copy)]
struct Block {
    sample: Sample,
    counts: bool,
}

impl Blocks {
    pub fn new(pictures: &Pictures, side: usize) -> Self {
        assert!(side > 0, "blocks of {side} pixels");
        pictures.check_lengths();
        let (columns, rows) = (pictures.width.div_ceil(side), pictures.height.div_ceil(side));
        let block = |index: usize| block(pictures, (index % columns) * side, (index / columns) * side, side);
        let count = |kind: Pixel| (0..pictures.image.len()).filter(|&index| pictures.pixel(index).0 == kind).count();
        Self {
            side,
            columns,
            blocks: (0..columns * rows).into_par_iter().map(block).collect(),
            non_finite: count(Pixel::NonFinite),
            reference_non_finite: count(Pixel::ReferenceNonFinite),
        }
    }

    /// Samples of the blocks that count, row by row.
    pub fn counting(&self) -> impl Iterator<Item = Sample> {
        self.blocks.iter().filter(|block| block.counts).map(|block| block.sample)
    }

    /// Mean of r over the blocks that count and over RGB.
    pub fn mean_reference(&self) -> Option<f64> {
        let values = self.counting().flat_map(|sample| sample.reference());
        let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
        (count > 0.0).then(|| sum / count)
    }

    /// For each block, whether it counts.
    pub fn counts(&self) -> impl Iterator<Item = bool> {
        self.blocks.iter().map(|block| block.counts)
    }

    /// Samples of all blocks. A block that does not count has the reference three times, or black if that is not finite
    /// either.
    pub fn all(&self) -> impl IndexedParallelIterator<Item = Sample> {
        self.blocks.par_iter().map(|block| block.sample)
    }

    /// Sample of the block that contains a pixel.
    pub fn around(&self, x: usize, y: usize) -> Sample {
        self.blocks[y / self.side * self.columns + x / self.side].sample
    }
}

fn block(pictures: &Pictures, left: usize, top: usize, side: usize) -> Block {
    let (mut counted, mut references) = ((Sample::default(), 0), (Sample::default(), 0));
    for y in top..pictures.height.min(top.saturating_add(side)) {
        for x in left..pictures.width.min(left.saturating_add(side)) {
            let (kind, sample) = pictures.pixel(y * pictures.width + x);
            if kind == Pixel::Counts {
                counted.0.add(&sample);
                counted.1 += 1;
            }
            let reference = sample.without_error();
            if is_finite(reference.x) {
                references.0.add(&reference);
                references.1 += 1;
            }
        }
    }
    let counts = counted.1 > 0;
    let (sum, count) = if counts { counted } else { references };
    Block { sample: sum.divided_by(count.max(1)), counts }
}

impl Pictures {
    /// Values of a pixel, finite or not, and whether it counts.
    pub(super) fn pixel(&self, index: usize) -> (Pixel, Sample) {
        let second = self.second.as_ref().unwrap_or(&self.reference);
        let [x, a, b] = [self.image[index], self.reference[index], second[index]].map(|pixel| pixel.map(f64::from));
        let kind = if self.mask.as_ref().is_some_and(|mask| !mask[index]) {
            Pixel::Masked
        } else if !is_finite(x) {
            Pixel::NonFinite
        } else if !is_finite(a) || !is_finite(b) {
            Pixel::ReferenceNonFinite
        } else {
            Pixel::Counts
        };
        (kind, Sample { x, a, b })
    }
}

fn is_finite(pixel: [f64; 3]) -> bool {
    pixel.iter().all(|value| value.is_finite())
}
