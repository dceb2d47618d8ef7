//! Low-discrepancy points for everything random: Sobol, scrambled as Owen has it [Burley 2020].
//!
//! A point follows from its stream, set and index alone, so whatever is drawn is the same on any number of threads.
//! The first n points of a set are stratified for any n, best at powers of two; sets and streams are independent.

/// Independent sets of points, each four numbers wide.
#[derive(Clone, Copy, Debug)]
pub struct Points {
    seed: u64,
}

impl Points {
    /// `stream` tells apart what must not share points under one seed: pixels, rows, halves.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self { seed: mix(mix(seed) ^ stream) }
    }

    /// Four numbers in [0, 1): point `index` of a set. Give each decision of up to four numbers (a bounce, a light) a
    /// set of its own.
    pub fn at(&self, index: u32, set: u32) -> [f64; 4] {
        // The generator knows 2^16 indices; after that another scramble starts anew. Always its first four dimensions,
        // which are the best, under a seed a set [Burley 2020, Section 5].
        let block = u64::from(index >> 16);
        let seed = mix(self.seed ^ (block << 32 | u64::from(set))) as u32;
        sobol_burley::sample_4d(index & 0xffff, 0, seed).map(f64::from)
    }
}

/// Three numbers of each of the first points of one set, shifted digit by digit from stream to stream [Kollig 2002]: for
/// those who draw so often that making points anew would take their time. Strips and squares that hold one point each
/// still do after a shift.
pub struct ShiftedPoints {
    seed: u64,
    count: usize,
    /// By blocks of points, then by dimension.
    digits: Vec<[[u32; BLOCK]; 3]>,
}

/// Points that are made together.
pub const BLOCK: usize = 16;

impl ShiftedPoints {
    pub fn new(seed: u64, count: u32) -> Self {
        let points = Points::new(seed, 0);
        // The generator's numbers are multiples of 2^-24: nothing is lost.
        let digits = |index: usize, dimension: usize| (points.at(index as u32, 0)[dimension] * f64::exp2(32.0)) as u32;
        let block = |b: usize| [0, 1, 2].map(|d| std::array::from_fn(|i| digits(BLOCK * b + i, d)));
        let count = count as usize;
        Self { seed, count, digits: (0..count.div_ceil(BLOCK)).map(block).collect() }
    }

    /// Points of a stream.
    pub fn len(&self) -> usize {
        self.count
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// What tells the points of a stream from those of others.
    pub fn shifts(&self, stream: u64) -> [u32; 3] {
        let first = mix(mix(self.seed) ^ stream);
        [first as u32, (first >> 32) as u32, mix(first) as u32]
    }

    /// Blocks of points by dimension, each number in [0, 1); the last block is filled up with points to spare.
    #[inline(always)]
    pub fn blocks(&self, shifts: [u32; 3]) -> impl Iterator<Item = [[f32; BLOCK]; 3]> {
        // As signed numbers, which machines convert at once: 24 bits are left.
        let unit = |digits: u32, shift: u32| ((digits ^ shift) >> 8) as i32 as f32 * f32::exp2(-24.0);
        let dimension = move |block: &[[u32; BLOCK]; 3], d: usize| {
            let mut units = [0.0; BLOCK];
            units.iter_mut().zip(&block[d]).for_each(|(u, digits)| *u = unit(*digits, shifts[d]));
            units
        };
        self.digits.iter().map(move |block| [dimension(block, 0), dimension(block, 1), dimension(block, 2)])
    }
}

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

    /// Of the first 2^k points one lies in each of 2^k strips, along every number, in every block and set.
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

    /// The correlation of two streams, sets or blocks over 4,096 points stays within four standard deviations.
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
