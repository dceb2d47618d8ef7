//! Weights of light that can be found in several ways [Veach 1995, Eq. 14].

use glam::DVec3;

use crate::physics::brdf::Reflected;

/// How likely light of a source is found in all ways that there are, at a surface that a ray from a view sample met.
#[derive(Clone, Copy, Default)]
pub struct Found {
    /// Density of such rays by area; `None` if no connection finds the surface.
    pub rays: Option<f64>,
    /// Probability that the source is chosen there, to look at one point of it.
    pub chance: f64,
    /// Density with which the specular lobe finds that point, relative to that of points.
    pub by_lobe: f64,
    /// By area.
    pub connections: f64,
}

impl Found {
    /// The balance heuristic's weight of light that is found by points on the source.
    pub fn by_point(self) -> f64 {
        self.chance / self.all()
    }

    /// The same of light that is found by the lobe.
    pub fn by_lobe(self) -> f64 {
        self.by_lobe / self.all()
    }

    /// The same of light that a connection finds.
    pub fn by_connection(self) -> f64 {
        1.0 - (self.chance + self.by_lobe) / self.all()
    }

    /// Reflected light with the `weight` of its parts, if a lobe goes on with a probability, times the solid angle that
    /// a point of the source stands for.
    pub fn reflected(self, at: Reflected, goes_on: f64, weight: fn(Self) -> f64) -> DVec3 {
        let specular = Self { by_lobe: goes_on * at.density, ..self };
        at.diffuse * weight(self) + at.specular * weight(specular)
    }

    fn all(self) -> f64 {
        self.chance + self.by_lobe + self.rays.map_or(0.0, |rays| self.connections / rays)
    }
}
