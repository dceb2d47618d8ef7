//! Points of flat lights that are far wider than the scene. Spread evenly, hardly any would be near enough to light it.

use glam::{DVec2, DVec3};

use super::{Light, LightKind, MeshSpace};

/// A light is wide if a side is longer than this, in units of the distance within which most of its light comes from.
const WIDE: f64 = 8.0;

/// A density of points on a flat light: along each of its axes that of Cauchy, whose middle is next to the scene. It
/// falls no faster than the light of a point does, so that no point is too bright.
#[derive(Clone, Copy, Debug)]
pub struct WideLight {
    sides: [Side; 2],
}

/// Points along one axis; all lengths in metres.
#[derive(Clone, Copy, Debug)]
struct Side {
    /// Of the light.
    length: f64,
    /// From the middle of the light to the point next to the scene's.
    middle: f64,
    /// Half of the points are nearer to that, if the side is much longer. `None`: points are spread evenly.
    scale: Option<f64>,
}

impl WideLight {
    /// `None` if the light is not flat, or not wide.
    pub fn of(light: &Light, space: MeshSpace) -> Option<Self> {
        let lengths = match light.kind {
            LightKind::Rect => light.size,
            LightKind::Disk | LightKind::Spot => [2.0 * light.radius; 2],
            _ => return None,
        };
        let to_scene = space.origin - light.position;
        let scale = to_scene.dot(light.direction).abs() + space.unit;
        let is_wide = |length: f64| length > WIDE * scale;
        let side = |(axis, length): (DVec3, f64)| Side {
            length,
            middle: to_scene.dot(axis),
            scale: is_wide(length).then_some(scale),
        };
        let [width, height] = light.axes();
        lengths
            .into_iter()
            .any(is_wide)
            .then(|| Self { sides: [side((width, lengths[0])), side((height, lengths[1]))] })
    }

    /// A point, by its place along the axes from the middle of the light, and the reciprocal of its density relative to
    /// even points. `at`: in the unit square.
    pub fn point(&self, at: [f64; 2]) -> (DVec2, f64) {
        let [x, y] = [0, 1].map(|axis| self.sides[axis].point(at[axis]));
        let place = DVec2::new(x, y);
        (place, self.weight(place))
    }

    /// Reciprocal of the density at a place on the light, relative to even points.
    pub fn weight(&self, place: DVec2) -> f64 {
        self.sides[0].weight(place.x) * self.sides[1].weight(place.y)
    }
}

impl Side {
    /// Angles of the ends, seen from `scale` above the middle.
    fn angles(&self, scale: f64) -> [f64; 2] {
        [-0.5, 0.5].map(|end| ((end * self.length - self.middle) / scale).atan())
    }

    fn point(&self, u: f64) -> f64 {
        let Some(scale) = self.scale else { return (u - 0.5) * self.length };
        let [low, high] = self.angles(scale);
        (self.middle + scale * (low + u * (high - low)).tan()).clamp(-0.5 * self.length, 0.5 * self.length)
    }

    fn weight(&self, x: f64) -> f64 {
        let Some(scale) = self.scale else { return 1.0 };
        let [low, high] = self.angles(scale);
        let tangent = (x - self.middle) / scale;
        scale * (high - low) * (1.0 + tangent * tangent) / self.length
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean over the square of any function of the light is that over even points.
    #[test]
    fn points_are_weighted_by_their_density() {
        let space = MeshSpace { origin: DVec3::new(3.0, -2.0, 1.0), unit: 1.5 };
        for size in [[1000.0, 1000.0], [5.0, 400.0], [1e6, 2e3]] {
            let light = Light { kind: LightKind::Rect, size, ..Light::point("card", DVec3::new(40.0, 5.0, -7.0)) };
            let light = Light { direction: DVec3::NEG_Y, up: DVec3::Z, ..light };
            let wide = WideLight::of(&light, space).unwrap();
            const SIDE: usize = 400;
            let mean = |of: &dyn Fn(DVec2) -> f64| {
                let at = |i: usize| (i as f64 + 0.5) / SIDE as f64;
                let points = (0..SIDE * SIDE).map(|i| wide.point([at(i % SIDE), at(i / SIDE)]));
                points.map(|(place, weight)| weight * of(place)).sum::<f64>() / (SIDE * SIDE) as f64
            };
            let area = size[0] * size[1];
            for u in [0.003, 0.4, 0.52, 0.9, 0.9999] {
                let [(before, _), (at, weight), (after, _)] = [-1e-7, 0.0, 1e-7].map(|by| wide.point([u + by, u + by]));
                let slope = (after - before) / (2e-7 * DVec2::from(size));
                assert!((slope.x * slope.y / weight - 1.0).abs() < 1e-4, "{size:?} at {at}: {slope}, not {weight}");
            }
            // Irradiance below an infinite card of unit radiance is pi.
            let h = 7.0;
            let [along_width, along_height] = light.axes();
            let at = space.origin - light.position;
            let at = DVec2::new(at.dot(along_width), at.dot(along_height));
            let irradiance = area * mean(&|place| (h / ((place - at).length_squared() + h * h)).powi(2));
            let want = std::f64::consts::PI;
            assert!(size[0] < 100.0 || (irradiance / want - 1.0).abs() < 0.02, "{size:?}: {irradiance}");
        }
        // Below a disk of radius r and unit radiance it is pi r² / (r² + h²).
        let disk = Light { kind: LightKind::Disk, radius: 60.0, ..Light::point("disk", DVec3::new(3.0, 5.0, 1.0)) };
        let disk = Light { direction: DVec3::NEG_Y, ..disk };
        let irradiance = |i: usize| {
            let point = disk.pack_point(space, [i % 400, i / 400].map(|i| (i as f64 + 0.5) / 400.0), None);
            // From the middle of the scene; in mesh space lights are weaker by the square of its unit.
            let squared = (space.unit * point.position.as_dvec3()).length_squared();
            3600.0 * f64::from(point.strength) * (space.unit * 7.0 / squared).powi(2)
        };
        let mean = (0..400 * 400).map(irradiance).sum::<f64>() / (400.0 * 400.0);
        assert!((mean * (3600.0 + 49.0) / 3600.0 - 1.0).abs() < 0.01, "{mean}");
        let small = Light { kind: LightKind::Rect, size: [4.0, 30.0], ..disk };
        assert!(WideLight::of(&small, space).is_none());
    }
}
