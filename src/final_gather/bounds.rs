//! Which connections are chosen for 64 view samples, and how likely.

use glam::Vec3;

use super::photons::{MAX_TILT, Sent};
use super::sources::Source;
use crate::trace::packet::PACKET_SIZE;
use crate::trace::surface::SurfacePoint;

/// Approximates 64 view samples as seen from points that send light.
pub struct Bounds {
    /// Positions and unit normals of some.
    some: [(Vec3, Vec3); SOME],
    /// Least squared distance that counts.
    near2: f32,
    /// Expected connections for each unit of potential, by area.
    pub per_potential: f64,
}

/// Number of view samples that stand for 64.
const SOME: usize = 4;

impl Bounds {
    /// `place`: position and unit normal of a view sample.
    pub fn of<R>(view_samples: &[R], place: impl Fn(&R) -> (Vec3, Vec3)) -> Self {
        let last = view_samples.len() - 1;
        let some = [9, 14, 49, 54].map(|lane| place(&view_samples[lane * last / (PACKET_SIZE - 1)]));
        let centre = some.iter().map(|(position, _)| *position).sum::<Vec3>() / SOME as f32;
        let near2 = some.iter().map(|(position, _)| position.distance_squared(centre)).fold(1e-12, f32::max);
        Self { some, near2, per_potential: 0.0 }
    }

    /// Mean of cosines over squared distance between a place and the view samples, bounded where these are near.
    fn form(&self, position: Vec3, normal: Vec3) -> f32 {
        let form = |(receiver, facing): &(Vec3, Vec3)| {
            let to = *receiver - position;
            let distance2 = to.length_squared();
            let leaving = normal.dot(to).max(0.0);
            let arriving = (-facing.dot(to)).max(0.0);
            leaving * arriving / (distance2.max(1e-18) * distance2.max(self.near2))
        };
        self.some.iter().map(form).sum::<f32>() / SOME as f32
    }

    /// What a place could send to the view samples, by area: about its greatest radiance times their form factor.
    pub fn potential(&self, source: &Source, surface: &SurfacePoint, light: Sent) -> f64 {
        let radiance = match light {
            Sent::Reflected { wi, irradiance } => {
                let albedo = f64::from((surface.brdf.diffuse + surface.brdf.f0).max_element());
                let cosine = surface.normal.as_dvec3().dot(wi).max(0.0);
                irradiance.max_element() * cosine * albedo * std::f64::consts::FRAC_1_PI
            }
            Sent::Emitted => surface.emission.max_element().into(),
        };
        source.scale * radiance * f64::from(self.form(surface.position, surface.geometric_normal))
    }

    /// Expected connections to a place that sends light of a source, by area.
    pub fn connections(&self, source: &Source, surface: &SurfacePoint, light: Sent) -> f64 {
        let landed = match light {
            // Where normals differ much, fewer photons land than the density of lit points says.
            Sent::Reflected { wi, .. } => {
                let [facing, cosine] = [surface.geometric_normal, surface.normal].map(|n| n.as_dvec3().dot(wi));
                (MAX_TILT * facing / cosine).clamp(0.0, 1.0)
            }
            Sent::Emitted => 1.0,
        };
        self.per_potential * self.potential(source, surface, light) * landed
    }
}
