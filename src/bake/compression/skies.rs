//! Random skies: the spots of light that maps of the sky are sums of, from broad glows to lamps.

use std::f64::consts::TAU;

use glam::DVec3;

use super::lights::Kind;
use crate::bake::transport::sky;
use crate::physics::sequence::Points;
use crate::physics::sky_cells;

/// Draws skies.
pub struct RandomSkies(Points);

/// Angles from the middle of a spot at which it has lost a third of its light, radians: of broad and of narrow spots.
const BROAD: [f64; 2] = [0.35, 1.2];
const NARROW: [f64; 2] = [0.1, 0.35];

impl RandomSkies {
    /// Different seeds give independent skies.
    pub fn new(seed: u64) -> Self {
        Self(Points::new(seed, 0))
    }

    /// Coefficients of sky number `index`. What mirrors see is another sky, so that both are learned, each by its own
    /// share of the picture.
    pub fn sky(&self, kind: Kind, index: u32) -> Vec<DVec3> {
        let [straight, by_mirrors] = [0, 1].map(|set| {
            let [u, v, width, _] = self.0.at(index, 4 * set + u32::from(kind == Kind::Spot));
            let (sin, cos) = (TAU * v).sin_cos();
            let (y, r) = (1.0 - 2.0 * u, 2.0 * (u * (1.0 - u)).sqrt());
            let middle = DVec3::new(r * cos, y, r * sin);
            let [least, most] = if kind == Kind::Spot { NARROW } else { BROAD };
            let sharpness = (least * (most / least).powf(width)).powi(-2);
            let radiance = move |cell| (sharpness * (sky_cells::direction(cell, [0.5; 2]).dot(middle) - 1.0)).exp();
            (0..sky_cells::COUNT).map(move |cell| DVec3::splat(radiance(cell)))
        });
        let all: Vec<DVec3> = straight.chain(by_mirrors).collect();
        debug_assert_eq!(all.len(), sky::COLUMNS);
        all
    }
}
