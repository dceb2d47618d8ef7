//! Random lights for training and validation, normalized by the brightness of their images at view samples.

use glam::DVec3;

use super::Operator;
use super::bounces::Bounces;
use super::lights::{Kind, RandomLights};
use super::skies::RandomSkies;
use super::vector_batch::{self, VectorBatch, WIDTH};
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::linear;
use crate::physics::sequence::Points;
use crate::shared::PackedLight;

/// Computes the coefficients of direct light at the fine level, for a light at unit intensity.
pub type Direct<'a> = dyn Fn(&PackedLight) -> Vec<DVec3> + Sync + 'a;

/// Generates training and validation lights, or skies if the operator is from the sky.
pub struct Trainer<'a> {
    pub operator: Operator<'a>,
    pub bounces: &'a Bounces<'a>,
    pub direct: &'a Direct<'a>,
    /// Rows of a few view samples, and their share of all view samples.
    pub probes: &'a CsrMatrix,
    pub share: f64,
}

/// A set of random lights for one purpose.
#[derive(Clone, Copy, Debug)]
pub struct Group {
    pub kind: Kind,
    pub count: usize,
    pub seed: u64,
}

/// A light is skipped if its image is darker than this share of the brightest light's image at equal intensity: few
/// rays of the rows hit so little light, and the image would be mostly noise.
const MIN_BRIGHTNESS_SHARE: f64 = 0.02;
/// Maximum number of candidates per requested light.
const ATTEMPTS: u32 = 20;

/// Light at the fine level, and after further bounces.
#[derive(Clone)]
pub struct Bounced {
    pub direct: VectorBatch,
    pub further: VectorBatch,
}

impl Trainer<'_> {
    /// Random lights, group by group, each scaled so that its whole indirect image has norm 1. Lights that illuminate
    /// hardly anything visible are skipped. If too few remain in a group, they are repeated; if none remains, the whole
    /// group is black. Different seeds give independent lights.
    pub fn lights(&self, groups: &[Group]) -> Bounced {
        let transport = self.operator.transport;
        let count = groups.iter().map(|g| g.count).sum();
        let zeros = |rows| VectorBatch::zeros(rows, count);
        let mut all =
            Bounced { direct: zeros(self.operator.coefficient_count()), further: zeros(transport.bounce_matrix.len()) };
        // Without bounces no light shows anything.
        let groups = if self.bounces.reflect_any() { groups } else { &[] };
        let mut first = 0;
        for group in groups {
            let end = first + group.count;
            let Some(random) = Random::new(self, group) else { break };
            let mut candidates = (0..group.count as u32 * ATTEMPTS).filter_map(|i| random.light(group.kind, i));
            let mut next = first;
            while next < end {
                let batch: Vec<Vec<DVec3>> = candidates.by_ref().take(WIDTH).collect();
                if batch.is_empty() {
                    break;
                }
                let (bounced, scales) = self.bounce(&batch);
                for (number, scale) in scales.into_iter().enumerate().filter(|(_, scale)| *scale > 0.0).take(end - next)
                {
                    all.direct.copy(next, &bounced.direct, number, scale);
                    all.further.copy(next, &bounced.further, number, scale);
                    next += 1;
                }
            }
            for again in (next..end).filter(|_| next > first) {
                all.repeat(first + (again - next) % (next - first), again);
            }
            first = end;
        }
        all
    }

    /// At most a panel of lights, and each one's scale for an image of norm 1; 0 for skipped lights.
    fn bounce(&self, direct: &[Vec<DVec3>]) -> (Bounced, Vec<f32>) {
        // Normalized, as the magnitude may be outside the range of single precision.
        let length = |light: &Vec<DVec3>| light.iter().map(|x| x.length_squared()).sum::<f64>().sqrt();
        let units: Vec<f64> = direct.iter().map(length).map(|l| if l > 0.0 { l.recip() } else { 0.0 }).collect();
        let entry = |channel: usize, i: usize, light: usize| (direct[light][i][channel] * units[light]) as f32;
        let direct = VectorBatch::from_fn(self.operator.coefficient_count(), direct.len(), entry);
        let further = self.bounces.further(&direct);
        let seen = vector_batch::multiply(self.probes, &self.bounces.seen(&direct, &further)).squares();
        // Squares of the images at the original intensities instead of normalized ones.
        let image = |(seen, unit): (&f64, &f64)| if *unit > 0.0 { seen / (unit * unit) } else { 0.0 };
        let images: Vec<f64> = seen.iter().zip(&units).map(image).collect();
        let least = MIN_BRIGHTNESS_SHARE * MIN_BRIGHTNESS_SHARE * images.iter().copied().fold(0.0, f64::max);
        let scale = |(seen, image): (&f64, &f64)| if *image > least { (self.share / seen).sqrt() as f32 } else { 0.0 };
        let scales = seen.iter().zip(&images).map(scale).collect();
        (Bounced { direct, further }, scales)
    }
}

/// Draws lights, as coefficients.
enum Random<'a> {
    Lights(RandomLights<'a>, &'a Direct<'a>),
    Skies(RandomSkies),
}

impl<'a> Random<'a> {
    /// `None` if there is nothing that lights could shine on.
    fn new(trainer: &Trainer<'a>, group: &Group) -> Option<Self> {
        let Operator { transport, from_sky } = trainer.operator;
        if from_sky.is_some() {
            return Some(Self::Skies(RandomSkies::new(group.seed)));
        }
        let has_samples = !transport.fine.samples.is_empty();
        has_samples.then(|| Self::Lights(RandomLights::new(transport, group.seed), trainer.direct))
    }

    fn light(&self, kind: Kind, index: u32) -> Option<Vec<DVec3>> {
        match self {
            Self::Lights(random, direct) => random.light(kind, index).map(|light| direct(&light)),
            Self::Skies(random) => Some(random.sky(kind, index)),
        }
    }
}

impl Bounced {
    /// `count` random combinations with the covariance of these lights. Those of the channels are independent: one
    /// combination has nearly the same image in all channels, so the images would span hardly more than those of a
    /// channel.
    pub fn combine(&self, count: usize, seed: u64) -> Self {
        Self { direct: combine(&self.direct, count, seed), further: combine(&self.further, count, seed) }
    }

    /// Copies light `from` over light `to`.
    fn repeat(&mut self, from: usize, to: usize) {
        self.direct.repeat(from, to);
        self.further.repeat(from, to);
    }

    pub fn scale(&mut self, factors: &[f32]) {
        self.direct.scale(factors);
        self.further.scale(factors);
    }
}

fn combine(lights: &VectorBatch, count: usize, seed: u64) -> VectorBatch {
    let points = Points::new(seed, 0);
    let scale = 1.0 / count as f64;
    // Normal deviates by the Box-Muller transform.
    let normal = |i: usize, j: usize| {
        let [u, v, ..] = points.at(i as u32, j as u32);
        ((-2.0 * (1.0 - u).ln() * scale).sqrt() * (std::f64::consts::TAU * v).cos()) as f32
    };
    let factors = |channel: usize, from: usize, to: usize| -> [[f32; WIDTH]; WIDTH] {
        let row = |i: usize| std::array::from_fn(|j| normal(from * WIDTH + i, channel << 16 | (to * WIDTH + j)));
        std::array::from_fn(row)
    };
    let mut mixtures = VectorBatch::zeros(lights.rows(), count);
    for (channel, (mixtures, lights)) in mixtures.channels.iter_mut().zip(&lights.channels).enumerate() {
        for (to, mixture) in mixtures.iter_mut().enumerate() {
            for (from, panel) in lights.iter().enumerate() {
                let factors = factors(channel, from, to);
                let factors = vector_batch::matrix(&factors);
                linear::add_product(vector_batch::matrix_mut(mixture), vector_batch::matrix(panel), factors);
            }
        }
    }
    mixtures.clear_padding();
    mixtures
}
