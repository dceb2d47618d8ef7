//! How far both the compressed and the dense operator are from rows gathered anew, with more rays and other numbers.

use std::ops::Range;

use glam::DVec3;

use super::data::Compressed;
use super::haar::Haar;
use super::lights::{Kind, RandomLights};
use super::training::Direct;
use crate::bake::transfer::Transfer;
use crate::bake::transfer::rows::{Lobe, Rows};
use crate::sequence::Points;

/// What to judge by.
#[derive(Clone, Debug, PartialEq)]
pub struct Judge {
    /// Rays of a row gathered anew.
    pub rays: u32,
    /// Tiles looked at, picked at random.
    pub tiles: usize,
    /// Lights of each kind.
    pub lights: usize,
    pub lobe: Lobe,
    /// Lights and rows of another seed than the compressor's have nothing in common with what it knows.
    pub seed: u64,
}

/// Relative errors over all tiles looked at, mean over lights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verdict {
    pub compressed: f64,
    pub dense: f64,
}

/// Under point lights and under spots. Rows take memory by the tile, not by the picture.
pub fn judge(transfer: &Transfer, compressed: &Compressed, direct: &Direct, judge: &Judge) -> [Verdict; 2] {
    if compressed.tiles.is_empty() || transfer.fine.samples.is_empty() {
        return Default::default();
    }
    let haar = Haar::new(&transfer.fine.first);
    let random = Points::new(judge.seed, 0);
    let pick = |i: usize| (random.at(i as u32, 0)[0] * compressed.tiles.len() as f64) as usize;
    let mut tiles: Vec<usize> = (0..judge.tiles).map(pick).collect();
    tiles.sort_unstable();
    tiles.dedup();
    let rows_of = |tile: usize| -> Range<usize> {
        let tile = &compressed.tiles[tile];
        tile.first_sample as usize..(tile.first_sample + tile.samples) as usize
    };
    [Kind::Point, Kind::Spot].map(|kind| {
        let lights = lights(transfer, direct, kind, judge);
        let bounced: Vec<Vec<DVec3>> = lights.iter().map(|light| transfer.bounce(light).0).collect();
        let relit: Vec<Vec<DVec3>> = lights.iter().map(|light| compressed.relight(&haar, light)).collect();
        let mut sums = vec![[0.0; 3]; lights.len()];
        for &tile in &tiles {
            let samples = &compressed.samples[rows_of(tile)];
            let mut gatherer = transfer.row_gatherer(judge.lobe);
            let rows: Rows = gatherer.gather(samples);
            (gatherer.rays, gatherer.seed) = (judge.rays, gatherer.seed ^ judge.seed.rotate_left(17) ^ 1 << 34);
            let anew = gatherer.gather(samples);
            for ((bounced, relit), sums) in bounced.iter().zip(&relit).zip(&mut sums) {
                let (want, dense) = (anew.multiply(bounced), rows.multiply(bounced));
                for ((want, dense), got) in want.iter().zip(&dense).zip(&relit[rows_of(tile)]) {
                    sums[0] += want.length_squared();
                    sums[1] += (*got - want).length_squared();
                    sums[2] += (*dense - want).length_squared();
                }
            }
        }
        let lit: Vec<&[f64; 3]> = sums.iter().filter(|sums| sums[0] > 0.0).collect();
        let mean = |which: usize| lit.iter().map(|s| (s[which] / s[0]).sqrt()).sum::<f64>() / lit.len().max(1) as f64;
        Verdict { compressed: mean(1), dense: mean(2) }
    })
}

/// A light must reach this share of all coefficients.
const LIT: f64 = 0.05;
/// Lights looked at for each one wanted, at most.
const ATTEMPTS: u32 = 50;

fn lights(transfer: &Transfer, direct: &Direct, kind: Kind, judge: &Judge) -> Vec<Vec<DVec3>> {
    let random = RandomLights::new(&transfer.fine.samples, judge.seed);
    let all = (0..judge.lights as u32 * ATTEMPTS).filter_map(|i| random.light(kind, i)).map(|light| direct(&light));
    let lit = |light: &Vec<DVec3>| {
        light.iter().filter(|x| **x != DVec3::ZERO).count() as f64 >= (LIT * light.len() as f64).max(1.0)
    };
    all.filter(lit).take(judge.lights).collect()
}
