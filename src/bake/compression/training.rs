//! What lights really put into the terms: random lights, made equally bright by what view samples see of them.

use glam::DVec3;

use super::bounces::Bounces;
use super::lights::{Kind, RandomLights};
use super::panels::{self, Panels, WIDTH};
use crate::bake::transfer::Transfer;
use crate::bake::transfer::rows::Rows;
use crate::sequence::Points;
use crate::shared::PackedLight;

/// Coefficients of direct light at the fine level, from a light at unit intensity.
pub type Direct<'a> = dyn Fn(&PackedLight) -> Vec<DVec3> + Sync + 'a;

/// Makes light to learn from and to check with.
pub struct Trainer<'a> {
    pub transfer: &'a Transfer<'a>,
    pub bounces: &'a Bounces<'a>,
    pub direct: &'a Direct<'a>,
    /// Rows of a few view samples, of how many there are.
    pub scouts: &'a Rows,
    pub share: f64,
}

/// Random lights of one purpose.
#[derive(Clone, Copy, Debug)]
pub struct Group {
    pub kind: Kind,
    pub count: usize,
    pub seed: u64,
}

/// A light is passed over if view samples see less than this share of what they see of others, of as much direct light.
const SEEN: f64 = 0.02;
/// Lights looked at for each one wanted, at most.
const ATTEMPTS: u32 = 20;

impl Trainer<'_> {
    /// Direct light of random lights, coefficients x lights, group by group; each is scaled so that its whole indirect
    /// image has norm 1. Lights that hardly anything visible receives light from are passed over; if too many are, the
    /// last stay black. Lights of different seeds have nothing in common.
    pub fn lights(&self, groups: &[Group]) -> Panels {
        let level = &self.transfer.fine;
        let mut all = Panels::zeros(level.coefficient_count(), groups.iter().map(|g| g.count).sum());
        let mut first = 0;
        for group in groups.iter().filter(|_| !level.samples.is_empty()) {
            let end = first + group.count;
            let random = RandomLights::new(&level.samples, group.seed);
            let mut candidates = (0..group.count as u32 * ATTEMPTS).filter_map(|i| random.light(group.kind, i));
            let mut next = first;
            while next < end {
                let batch: Vec<Vec<DVec3>> =
                    candidates.by_ref().take(WIDTH.min(end - next)).map(|light| (self.direct)(&light)).collect();
                if batch.is_empty() {
                    break;
                }
                for (light, scale) in batch.iter().zip(self.scales(&batch)).filter(|(_, scale)| *scale > 0.0) {
                    for (i, x) in light.iter().enumerate() {
                        (0..3).for_each(|channel| all.set(channel, i, next, (x[channel] * scale) as f32));
                    }
                    next += 1;
                }
            }
            first = end;
        }
        all
    }

    /// What each light must be multiplied by for an image of norm 1; 0 for those that are passed over.
    fn scales(&self, lights: &[Vec<DVec3>]) -> Vec<f64> {
        let mut panels = Panels::zeros(self.transfer.fine.coefficient_count(), lights.len());
        let lengths: Vec<f64> =
            lights.iter().map(|light| light.iter().map(|x| x.length_squared()).sum::<f64>().sqrt()).collect();
        for (number, light) in lights.iter().enumerate().filter(|(number, _)| lengths[*number] > 0.0) {
            for (i, x) in light.iter().enumerate() {
                (0..3).for_each(|channel| panels.set(channel, i, number, (x[channel] / lengths[number]) as f32));
            }
        }
        let seen = panels::multiply(self.scouts, &self.bounces.forward(&panels)).squares();
        let least = SEEN * SEEN * seen.iter().copied().fold(0.0, f64::max);
        let scale =
            |(seen, length): (&f64, &f64)| if *seen > least { (self.share / seen).sqrt() / length } else { 0.0 };
        seen.iter().zip(&lengths).map(scale).collect()
    }
}

/// `count` random combinations of `lights`; their covariance is that of the lights.
pub fn combine(lights: &Panels, count: usize, seed: u64) -> Panels {
    let points = Points::new(seed, 0);
    let scale = 1.0 / count as f64;
    // Box and Muller's way to normal numbers.
    let normal = |i: usize, j: usize| {
        let [u, v, ..] = points.at(i as u32, j as u32);
        ((-2.0 * (1.0 - u).ln() * scale).sqrt() * (std::f64::consts::TAU * v).cos()) as f32
    };
    let mut mixtures = Panels::zeros(lights.rows(), count);
    let factors: Vec<Vec<[[f32; WIDTH]; WIDTH]>> = (0..lights.count.div_ceil(WIDTH))
        .map(|from| {
            let factor =
                |to: usize| std::array::from_fn(|i| std::array::from_fn(|j| normal(from * WIDTH + i, to * WIDTH + j)));
            (0..count.div_ceil(WIDTH)).map(factor).collect()
        })
        .collect();
    for (mixtures, lights) in mixtures.channels.iter_mut().zip(&lights.channels) {
        for (to, mixture) in mixtures.iter_mut().enumerate() {
            for (from, panel) in lights.iter().enumerate() {
                let factors = panels::matrix(&factors[from][to]);
                super::linear::add_product(panels::matrix_mut(mixture), panels::matrix(panel), factors);
            }
        }
    }
    mixtures.clear_padding();
    mixtures
}
