//! Low-discrepancy points for all sampling: Sobol points with Owen scrambling [Burley 2020]; [`SharedPoints`], whose
//! streams are stratified together; a lattice where their number is known.
//!
//! A point depends only on its stream, set and index, so samples are the same for any number of threads. The first n
//! points of a set are stratified for any n, best at powers of two; sets and streams of [`Points`] are independent.

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

/// Three dimensions of a Sobol sequence whose consecutive parts are streams. The points of one stream are stratified.
/// So are those of 2^k streams together that begin at a multiple of 2^k, if a stream has a power of two of points: the
/// errors of neighbouring pixels cancel in their mean if they are such streams [Ahmed 2020]. Streams of other lengths
/// begin as far apart as those of the next power of two. Streams repeat after 2^32 points, that is after 4.2 million
/// pixels with 1,024 points.
///
/// The generator matrices are scrambled linearly [Matousek 1998]. So the points of a stream are those of the first one
/// after a digital shift, and a point costs three additions without carry.
pub struct SharedPoints {
    matrices: [Matrix; 3],
    /// Digital shift of all points.
    shift: [u32; 3],
    count: usize,
    /// Binary digits of the number of points from one stream to the next.
    digits_of_stream: u32,
    /// The chosen points of the first stream in blocks, by dimension.
    digits: Vec<[[u32; BLOCK]; 3]>,
}

/// Digits of a stream's number that are permuted: all of those of a picture of 16 million pixels.
const SHUFFLED_DIGITS: u32 = 24;
/// Points per block.
pub const BLOCK: usize = 16;

impl SharedPoints {
    /// The first `count` points of streams of as many.
    pub fn new(seed: u64, count: u32) -> Self {
        Self::of(seed, 0..count, count)
    }

    /// The points `range` of each stream, of `stream` points.
    pub fn of(seed: u64, range: std::ops::Range<u32>, stream: u32) -> Self {
        let random = |purpose: u64| mix(mix(seed) ^ purpose);
        let matrices = [0, 1, 2].map(|d| scrambled(SOBOL[d], |row| random(row << 8 | d as u64) as u32));
        let shift = [0, 1, 2].map(|d| random(1 << 16 | d) as u32);
        let (first, count) = (range.start, range.len());
        let block = |b: usize| {
            [0, 1, 2].map(|d| std::array::from_fn(|i| apply(&matrices[d], u64::from(first) + (BLOCK * b + i) as u64)))
        };
        let digits = (0..count.div_ceil(BLOCK)).map(block).collect();
        Self { matrices, shift, count, digits_of_stream: stream.next_power_of_two().trailing_zeros(), digits }
    }

    /// Chosen points per stream.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether a stream has no points.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The digital shift of a stream, per dimension.
    pub fn shifts(&self, stream: u64) -> [u32; 3] {
        let stream = self.shuffled(stream);
        [0, 1, 2].map(|d| self.shift[d] ^ apply(&self.matrices[d], stream << self.digits_of_stream))
    }

    /// A permutation of streams in which those of an aligned group of 2^k stay an aligned group: groups in the order of
    /// the sequence have similar errors, which would be stripes in a picture [Ahmed 2020].
    fn shuffled(&self, stream: u64) -> u64 {
        let seed = u64::from(self.shift[0]) << 32 | u64::from(self.shift[1]);
        let flip = |digit: u32| (mix(mix(seed ^ u64::from(digit)) ^ stream >> (digit + 1)) & 1) << digit;
        (0..SHUFFLED_DIGITS).fold(stream, |shuffled, digit| shuffled ^ flip(digit))
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

/// A generator matrix of 32 binary digits, by column: column k is added for digit k of the index. The first digit of a
/// number is the highest bit.
type Matrix = [u32; 32];

/// The first three dimensions of the Sobol sequence, with the direction numbers of [Joe 2008].
const SOBOL: [Matrix; 3] = {
    let mut matrices = [[1 << 31; 32]; 3];
    let mut k = 1;
    while k < 32 {
        matrices[0][k] = matrices[0][k - 1] >> 1;
        matrices[1][k] = matrices[1][k - 1] ^ matrices[1][k - 1] >> 1;
        matrices[2][k] = match k {
            1 => 3 << 30,
            _ => matrices[2][k - 1] ^ matrices[2][k - 2] ^ matrices[2][k - 2] >> 2,
        };
        k += 1;
    }
    matrices
};

/// The product of a random lower triangular matrix with ones on its diagonal and `matrix`. `random` takes a row.
fn scrambled(matrix: Matrix, random: impl Fn(u64) -> u32) -> Matrix {
    // Row `row` of the random matrix: digits before its own are random.
    let row = |row: u32| random(row.into()) & !(u32::MAX >> row) | 1 << (31 - row);
    let rows: [u32; 32] = std::array::from_fn(|i| row(i as u32));
    matrix.map(|column| (0..32).map(|i| ((rows[i] & column).count_ones() & 1) << (31 - i)).sum())
}

/// The sum without carry of the columns that the digits of `index` name; of the lowest 32.
fn apply(matrix: &Matrix, index: u64) -> u32 {
    matrix.iter().enumerate().filter(|(k, _)| index >> k & 1 == 1).fold(0, |sum, (_, column)| sum ^ column)
}

/// Point `index` of a lattice of `count` points in the unit square, a power of two: more even than Sobol points of the
/// same number, also on a sphere [Keinert 2015]. The order is such that the first points are spread out, too.
pub fn fibonacci_lattice(index: u32, count: u32) -> [f64; 2] {
    debug_assert!(count.is_power_of_two() && index < count);
    let row = u64::from(index).reverse_bits() >> (64 - count.trailing_zeros().max(1));
    let row = if count == 1 { 0.0 } else { row as f64 };
    [(row + 0.5) / f64::from(count), (row * GOLDEN_RATIO).fract()]
}

/// The inverse of the golden ratio: fractional parts of its multiples fill 0..1 evenly for any count.
pub const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;

/// The finalizer of [Steele 2014], SplitMix64.
pub fn mix(seed: u64) -> u64 {
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

    /// Neighbouring streams are stratified together: one of their points is in each of as many strips of each
    /// dimension, and in each of as many squares of the first two.
    #[test]
    fn streams_share_their_strata() {
        let points = SharedPoints::new(7, 64);
        let drawn = |streams: std::ops::Range<u64>| -> Vec<[f32; 3]> {
            let of_stream = |stream| points.blocks(points.shifts(stream));
            let of_block = |block: [[f32; BLOCK]; 3]| (0..BLOCK).map(move |i| block.map(|d| d[i]));
            streams.flat_map(of_stream).flat_map(of_block).collect()
        };
        for (streams, squares) in [(5..6, 8.0), (12..16, 16.0), (48..64, 32.0)] {
            let drawn = drawn(streams);
            let count = drawn.len() as f32;
            let strata = |place: &dyn Fn(&[f32; 3]) -> usize| {
                let mut seen = vec![false; drawn.len()];
                drawn.iter().for_each(|point| seen[place(point)] = true);
                seen.iter().all(|&seen| seen)
            };
            assert!((0..3).all(|d| strata(&|point| (point[d] * count) as usize)), "{count} points, strips");
            let square =
                |point: &[f32; 3]| (squares * (point[0] * squares).floor() + (point[1] * squares).floor()) as usize;
            assert!(strata(&square), "{count} points, squares");
        }
    }

    /// Ranges of a stream are parts of it, of streams of any length.
    #[test]
    fn streams_have_parts() {
        for count in [64, 37] {
            let first = |points: SharedPoints| -> Vec<[f32; 3]> {
                let of_block = |block: [[f32; BLOCK]; 3]| (0..BLOCK).map(move |i| block.map(|d| d[i]));
                points.blocks(points.shifts(5)).flat_map(of_block).take(points.len()).collect()
            };
            let all = first(SharedPoints::new(1, count));
            assert_eq!(all.len(), count as usize);
            assert_eq!(first(SharedPoints::of(1, 5..37, count)), all[5..37]);
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
