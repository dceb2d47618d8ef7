//! Aims: sampling of directions towards lights mirrored in glossy surfaces, found by `glossy_mirrors`.
//!
//! A light in front of a glossy face causes a caustic that next-event estimation cannot find and BRDF sampling rarely
//! hits: seen from a matt surface, it comes from the few directions in which the face mirrors the light, those towards
//! the light's mirror image. A fraction of the directions is sampled around them, with the width of the face's lobe.
//! Weighting by the density of the whole mixture keeps the estimate unbiased.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::physics::brdf::basis;

/// Maximum number of aims per surface point.
const MAX_AIMS: usize = 8;
/// Maximum fraction of directions that are sampled from aims.
const MAX_SHARE: f64 = 0.5;

/// Aims of one surface point.
#[derive(Default)]
pub(super) struct MirrorAims {
    aims: [MirrorAim; MAX_AIMS],
    count: usize,
    /// Fraction of directions that are sampled from aims.
    pub share: f64,
}

/// A distribution of directions around an axis.
#[derive(Clone, Copy, Default)]
pub(super) struct MirrorAim {
    pub axis: DVec3,
    /// Tangent of the angle from the axis that contains half of the directions.
    pub width: f64,
    /// Estimated irradiance from there; after `fill`, its fraction of the sum of all aims.
    pub weight: f64,
}

impl MirrorAims {
    /// Replaces all aims; `typical` is the typical irradiance in the scene.
    pub fn fill(&mut self, found: impl Iterator<Item = MirrorAim>, typical: f64) {
        (self.count, self.share) = (0, 0.0);
        let mut total = 0.0;
        for (place, aim) in self.aims.iter_mut().zip(found) {
            *place = aim;
            self.count += 1;
            total += aim.weight;
        }
        if self.count == 0 {
            return;
        }
        // Compares the caustic with other bounced light, which is estimated as 3 % of direct light.
        self.share = MAX_SHARE * total / (total + 0.03 * typical);
        self.aims[..self.count].iter_mut().for_each(|aim| aim.weight /= total);
    }

    /// Samples a unit direction; at least one aim must exist.
    pub fn draw(&self, choice: f64, u: f64, v: f64) -> DVec3 {
        let mut left = choice;
        let aims = &self.aims[..self.count];
        let picked = aims.iter().find(|aim| {
            left -= aim.weight;
            left < 0.0
        });
        picked.or(aims.last()).expect("a share above 0 has an aim").draw(u, v)
    }

    /// Density of [`Self::draw`], 1/sr.
    pub fn density(&self, direction: DVec3) -> f64 {
        self.aims[..self.count].iter().map(|aim| aim.weight * aim.density(direction)).sum()
    }
}

impl MirrorAim {
    /// Tangents are distributed as those of GGX half vectors, so that the tails match those of the caustic.
    fn draw(&self, u: f64, v: f64) -> DVec3 {
        let tangent = self.width * (u / (1.0 - u)).sqrt();
        let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
        let (y, x) = (TAU * v).sin_cos();
        (basis(self.axis) * (cosine * DVec3::new(tangent * x, tangent * y, 1.0))).normalize()
    }

    fn density(&self, direction: DVec3) -> f64 {
        let cosine = self.axis.dot(direction);
        if cosine <= 0.0 {
            return 0.0;
        }
        let sine2 = self.axis.cross(direction).length_squared();
        // width² / (pi cos³ (width² + tan²)²)
        let spread = self.width * self.width * cosine * cosine + sine2;
        self.width * self.width * cosine / (PI * spread * spread)
    }
}
