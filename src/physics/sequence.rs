//! Low-discrepancy points for all sampling: Sobol points with Owen scrambling [Burley 2020]; a lattice where their number
//! is known.
//!
//! A point depends only on its stream, set and index, so samples are the same for any number of threads. The first n
//! points of a set are stratified for any n, best at powers of two; sets and streams are independent.

/// Independent sets of four-dimensional points.
#[derive(Clone, Copy, Debug)]
pub struct Points {
    seed: u64,
}

impl Points {
    /// `stream` separates what must not share points under one seed: pixels, rows, halves.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self { seed: mix(mix(seed) ^ stream) }
    }

    /// Point `index` of a set: four numbers in [0, 1). Each decision of up to four numbers (a bounce, a light) needs
    /// its own set.
    pub fn at(&self, index: u32, set: u32) -> [f64; 4] {
        // The generator supports 2^16 indices; further blocks use different scrambles. Only its first four dimensions
        // are used, which are the best, with one seed per set [Burley 2020, Section 5].
        let block = u64::from(index >> 16);
        let seed = mix(self.seed ^ (block << 32 | u64::from(set))) as u32;
        sobol_burley::sample_4d(index & 0xffff, 0, seed).map(f64::from)
    }
}

/// Three dimensions of the first points of one set, with a digital shift per stream [Kollig 2002]: for callers that
/// draw so many points that generating each would be slow. Strips and squares that contain one point each still do
/// after a shift.
pub struct ShiftedPoints {
    seed: u64,
    count: usize,
    /// Points in blocks, by dimension.
    digits: Vec<[[u32; BLOCK]; 3]>,
}

/// Points per block.
pub const BLOCK: usize = 16;

impl ShiftedPoints {
    /// The first `count` points of set 0 of stream 0.
    pub fn new(seed: u64, count: u32) -> Self {
        Self::of(seed, 0..count)
    }

    /// A range of the points of set 0 of stream 0.
    pub fn of(seed: u64, range: std::ops::Range<u32>) -> Self {
        let points = Points::new(seed, 0);
        let (first, count) = (range.start, range.len());
        // The generator's numbers are multiples of 2^-24, so this is exact.
        let digits =
            |index: usize, dimension: usize| (points.at(first + index as u32, 0)[dimension] * f64::exp2(32.0)) as u32;
        let block = |b: usize| [0, 1, 2].map(|d| std::array::from_fn(|i| digits(BLOCK * b + i, d)));
        Self { seed, count, digits: (0..count.div_ceil(BLOCK)).map(block).collect() }
    }

    /// Points per stream.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether a stream has no points.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The digital shift of a stream, per dimension.
    pub fn shifts(&self, stream: u64) -> [u32; 3] {
        let first = mix(mix(self.seed) ^ stream);
        [first as u32, (first >> 32) as u32, mix(first) as u32]
    }

    /// Blocks of points by dimension, each number in [0, 1); the last block is filled up with surplus points.
    #[inline(always)]
    pub fn blocks(&self, shifts: [u32; 3]) -> impl Iterator<Item = [[f32; BLOCK]; 3]> {
        // As signed integers, which convert faster; 24 bits remain.
        let unit = |digits: u32, shift: u32| ((digits ^ shift) >> 8) as i32 as f32 * f32::exp2(-24.0);
        let dimension = move |block: &[[u32; BLOCK]; 3], d: usize| {
            let mut units = [0.0; BLOCK];
            units.iter_mut().zip(&block[d]).for_each(|(u, digits)| *u = unit(*digits, shifts[d]));
            units
        };
        self.digits.iter().map(move |block| [dimension(block, 0), dimension(block, 1), dimension(block, 2)])
    }
}

/// Point `index` of a lattice of `count` points in the unit square, a power of two: more even than Sobol points of the
/// same number, also on a sphere [Keinert 2015]. The order is such that the first points are spread out, too.
pub fn fibonacci_lattice(index: u32, count: u32) -> [f64; 2] {
    debug_assert!(count.is_power_of_two() && index < count);
    let row = u64::from(index).reverse_bits() >> (64 - count.trailing_zeros().max(1));
    let row = if count == 1 { 0.0 } else { row as f64 };
    [(row + 0.5) / f64::from(count), (row * GOLDEN_RATIO).fract()]
}

const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;

/// The finalizer of [Steele 2014], SplitMix64.
fn mix(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each of 2^k strips contains one of the first 2^k points, for every dimension, block and set.
    #[test]
    fn points_are_stratified() {
        for (start, set, stream) in [(0, 0, 0), (0, 7, 1), (1 << 16, 7, 1)] {
            let points = Points::new(3, stream);
            for dimension in 0..4 {
                let mut seen = [false; 256];
                (start..start + 256).for_each(|i| seen[(points.at(i, set)[dimension] * 256.0) as usize] = true);
                assert!(seen.iter().all(|&s| s), "dimension {dimension} of set {set}, stream {stream}");
            }
        }
    }

    /// All rows of a lattice are met once, and the first points are spread over them.
    #[test]
    fn lattices_are_even_from_the_start() {
        for (count, first) in [(1, 1), (4, 4), (256, 256), (256, 16)] {
            let mut seen = vec![false; first as usize];
            (0..first).for_each(|i| seen[(fibonacci_lattice(i, count)[0] * f64::from(first)) as usize] = true);
            assert!(seen.iter().all(|&s| s), "{first} of {count}");
        }
    }

    /// The correlation of two streams, sets or blocks over 4,096 points is within four standard deviations.
    #[test]
    fn streams_sets_and_blocks_are_independent() {
        let all = |stream: u64, set: u32, start: u32| -> Vec<f64> {
            let points = Points::new(1, stream);
            (start..start + 4096).map(|i| points.at(i, set)[0] - 0.5).collect()
        };
        let base = all(0, 0, 0);
        for other in [all(1, 0, 0), all(0, 1, 0), all(0, 0, 1 << 16), all(1 << 32, 0, 0)] {
            let correlation = 12.0 / 4096.0 * base.iter().zip(&other).map(|(a, b)| a * b).sum::<f64>();
            assert!(correlation.abs() < 4.0 / 64.0, "{correlation}");
        }
    }
}
