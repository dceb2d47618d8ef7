//! Noise and chance, the same on every run.

use glam::{DVec2, DVec3, dvec3};

/// Smooth lattice noise in -1..1.
pub fn noise(p: DVec3) -> f64 {
    let cell = p.floor();
    let t = p - cell;
    let t = t * t * (3.0 - 2.0 * t);
    let value = |x: f64, y: f64, z: f64| {
        let c = cell + dvec3(x, y, z);
        let mut hash = (c.x as i64 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        hash ^= (c.y as i64 as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
        hash ^= (c.z as i64 as u64).wrapping_mul(0x1656_67B1_9E37_79F9);
        hash = (hash ^ hash >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        (hash >> 40) as f64 / f64::from(1 << 23) - 1.0
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let row = |y: f64, z: f64| mix(value(0.0, y, z), value(1.0, y, z), t.x);
    let plane = |z: f64| mix(row(0.0, z), row(1.0, z), t.y);
    mix(plane(0.0), plane(1.0), t.z)
}

/// Noise over a plane in -1..1 that repeats after `period` cells; each `seed` has its own.
pub fn tiling(p: DVec2, period: [u32; 2], seed: u32) -> f64 {
    let cell = p.floor();
    let t = p - cell;
    let t = t * t * (3.0 - 2.0 * t);
    let value = |x: i64, y: i64| {
        let x = (cell.x as i64 + x).rem_euclid(i64::from(period[0]));
        let y = (cell.y as i64 + y).rem_euclid(i64::from(period[1]));
        2.0 * hashed([x as u32, y as u32, seed]) - 1.0
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    mix(mix(value(0, 0), value(1, 0), t.x), mix(value(0, 1), value(1, 1), t.x), t.y)
}

/// Octaves of [`tiling`] over the unit square, about -1..1: the first has `cells`, each further one twice as many at
/// half the height.
pub fn fractal(uv: DVec2, cells: [u32; 2], octaves: u32, seed: u32) -> f64 {
    let octave = |i: u32| {
        let cells = cells.map(|c| c << i);
        tiling(uv * DVec2::from(cells.map(f64::from)), cells, seed + i) / f64::from(1 << i)
    };
    (0..octaves).map(octave).sum::<f64>() / 1.5
}

/// An even number in 0..1 for three integers.
pub fn hashed([a, b, c]: [u32; 3]) -> f64 {
    let mut state = u64::from(a) << 40 ^ u64::from(b) << 20 ^ u64::from(c);
    mixed(&mut state);
    mixed(&mut state)
}

/// A stream of even numbers.
pub struct Chance(u64);

impl Chance {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * mixed(&mut self.0)
    }

    pub fn below(&mut self, count: u32) -> u32 {
        (mixed(&mut self.0) * f64::from(count)) as u32
    }
}

/// The next number in 0..1 [Steele 2014].
fn mixed(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut hash = *state;
    hash = (hash ^ hash >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    hash = (hash ^ hash >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    (hash >> 11) as f64 / (1u64 << 53) as f64
}
