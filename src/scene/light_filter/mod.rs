//! Light filters: what multiplies a light's radiance by the direction of emission. IES profiles, gobos and barn doors,
//! and the colours of environment maps.
//!
//! Directions are in the light's frame: +x and +y are the axes of width and height ([`Light::axes`]), +z the light's
//! direction. All points of an area light have the same filter.

mod attached;
mod gobo;
pub mod ies;
mod profile;

use std::f64::consts::FRAC_PI_2;
use std::path::Path;

use glam::{DVec3, Vec3};

pub use self::attached::{Attached, RigFiles};
pub use self::gobo::Gobo;
use self::gobo::PosedGobo;
use self::ies::PhotometricType;
pub use self::profile::Profile;
use super::{Light, LightKind};

/// The filters of a light; the default has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightFilter {
    /// Its candela, relative to their maximum, multiply the light's intensity.
    pub ies: Option<Attached<Profile>>,
    pub gobo: Option<Gobo>,
    pub barn_doors: Option<BarnDoors>,
}

/// Four flaps around a light, each of which blocks what lies beyond its angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarnDoors {
    /// Radians from the light's direction to the edges of the left, right, top and bottom door as seen along it, from
    /// -pi/2 to pi/2: fully open.
    pub angles: [f64; 4],
    /// Width of the soft edge inside of those angles, radians.
    pub softness: f64,
}

/// Rounding of a cosine.
const SLACK: f32 = 1e-5;

/// Default width of the soft edge of barn doors in degrees.
pub const SOFTNESS_DEG: f64 = 4.0;

impl LightFilter {
    /// The filters without those whose files lie neither in `folder` nor below.
    pub fn within(&self, folder: &Path) -> Self {
        Self {
            ies: self.ies.clone().filter(|ies| ies.is_within(folder)),
            gobo: self.gobo.clone().filter(|gobo| gobo.image.is_within(folder)),
            barn_doors: self.barn_doors,
        }
    }

    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// The filters of a light in its pose.
pub struct PosedFilter {
    /// Unit axes of the light's frame.
    axes: [Vec3; 3],
    /// The profile, and 1 / its maximum in candela.
    ies: Option<(Attached<Profile>, f64)>,
    gobo: Option<PosedGobo>,
    doors: Vec<Door>,
    /// Whether gobo and doors are before the rear of the light, too.
    two_sided: bool,
    /// Least z of directions into which the light shines.
    least_z: f32,
}

/// One barn door: its direction across the light's axis, and the tangents at which it begins to dim and is black.
struct Door {
    across: [f32; 2],
    open: f32,
    black: f32,
}

impl PosedFilter {
    /// `None` for lights without filters or without a position.
    pub fn new(light: &Light) -> Option<Self> {
        let LightFilter { ies, gobo, barn_doors } = &light.filter;
        if light.filter.is_none() || !light.kind.has_position() {
            return None;
        }
        let is_flat = light.kind != LightKind::Point;
        let [width, height] = light.axes();
        let relative = |ies: &Attached<Profile>| {
            let most = ies.max();
            (ies.clone(), if most > 0.0 { most.recip() } else { 0.0 })
        };
        let least_z = match light.kind {
            LightKind::Spot => light.outer_angle.cos() as f32 - SLACK,
            _ => -1.0 - SLACK,
        };
        Some(Self {
            least_z,
            axes: [width, height, light.direction].map(DVec3::as_vec3),
            ies: ies.as_ref().map(relative),
            gobo: gobo.as_ref().filter(|_| is_flat).map(|gobo| PosedGobo::new(gobo, light)),
            doors: barn_doors.iter().filter(|_| is_flat).flat_map(doors).collect(),
            two_sided: light.two_sided && matches!(light.kind, LightKind::Disk | LightKind::Rect),
        })
    }

    /// RGB factor on radiance that is emitted in unit `direction`.
    pub fn factor(&self, direction: Vec3) -> Vec3 {
        let [x, y, mut z] = self.axes.map(|axis| axis.dot(direction));
        if z < self.least_z {
            return Vec3::ZERO;
        }
        let mut factor = Vec3::ONE;
        if let Some((ies, scale)) = &self.ies {
            let direction = match ies.photometric_type {
                PhotometricType::C => [x, y, z],
                // Their +x is up.
                PhotometricType::A | PhotometricType::B => [y, -x, z],
            };
            factor *= (ies.candela(direction.map(f64::from)) * scale) as f32;
        }
        if self.two_sided {
            z = z.abs();
        }
        if self.gobo.is_some() || !self.doors.is_empty() {
            if z <= 0.0 {
                return Vec3::ZERO;
            }
            let on_plane = [x / z, y / z];
            factor *= self.doors.iter().map(|door| door.share(on_plane)).product::<f32>();
            if let Some(gobo) = self.gobo.as_ref().filter(|_| factor != Vec3::ZERO) {
                factor *= gobo.transmittance(on_plane);
            }
        }
        factor
    }
}

/// The doors that are not fully open.
fn doors(doors: &BarnDoors) -> impl Iterator<Item = Door> {
    let softness = doors.softness;
    let sides = [[-1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    doors.angles.into_iter().zip(sides).filter(|(angle, _)| *angle < FRAC_PI_2).map(move |(angle, across)| Door {
        across,
        open: (angle - softness).max(-FRAC_PI_2).tan() as f32,
        black: angle.tan() as f32,
    })
}

impl Door {
    /// Share of light that passes in the direction with these tangents.
    fn share(&self, [x, y]: [f32; 2]) -> f32 {
        let tangent = self.across[0] * x + self.across[1] * y;
        if tangent >= self.black {
            return 0.0;
        }
        let t = ((self.black - tangent) / (self.black - self.open)).min(1.0);
        t * t * (3.0 - 2.0 * t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(filter: LightFilter) -> Light {
        Light { kind: LightKind::Spot, outer_angle: FRAC_PI_2, filter, ..Light::point("spot", DVec3::ZERO) }
    }

    /// Direction in the frame of a light that looks along -z with +y up, in degrees to the right and upwards.
    fn towards(right: f32, up: f32) -> Vec3 {
        Vec3::new(right.to_radians().tan(), up.to_radians().tan(), -1.0).normalize()
    }

    #[test]
    fn doors_block_what_lies_beyond_them() {
        let angles = [10f64, 20.0, 30.0, 90.0].map(f64::to_radians);
        let doors = BarnDoors { angles, softness: 4f64.to_radians() };
        let filter =
            PosedFilter::new(&spot(LightFilter { barn_doors: Some(doors), ..LightFilter::default() })).unwrap();
        for (right, up, share) in [
            (0.0, 0.0, 1.0),
            (-5.9, 0.0, 1.0),
            (-10.1, 0.0, 0.0),
            (15.9, 0.0, 1.0),
            (20.1, 0.0, 0.0),
            (0.0, 25.9, 1.0),
            (0.0, 30.1, 0.0),
            (0.0, -89.0, 1.0),
        ] {
            assert_eq!(filter.factor(towards(right, up)), Vec3::splat(share), "{right} {up}");
        }
        let edge = filter.factor(towards(-8.0, 0.0)).x;
        assert!((edge - 0.5).abs() < 0.02, "{edge}");
        assert_eq!(filter.factor(Vec3::Z), Vec3::ZERO, "behind the light");
    }

    /// A headlamp that shines upwards only: +x of type A is up.
    #[test]
    fn profiles_of_type_a_stand_upright() {
        let folder = tempfile::tempdir().expect("there is room");
        let text = "TILT=NONE\n1 -1 1 3 2 3 2 0 0 0 1 1 9 -90 0 90 -90 90 0 0 5 0 0 5\n";
        std::fs::write(folder.path().join("a.ies"), text).expect("there is room");
        let ies = RigFiles::new(folder.path()).profile("a.ies").expect("it is a profile");
        let filter = PosedFilter::new(&spot(LightFilter { ies: Some(ies), ..LightFilter::default() })).unwrap();
        let [up, down] = [20.0, -20.0].map(|up| filter.factor(towards(0.0, up)).x);
        assert!(up > 0.2 && down == 0.0, "{up} {down}");
        assert!((filter.factor(towards(20.0, 20.0)).x - filter.factor(towards(-20.0, 20.0)).x).abs() < 1e-6);
    }

    #[test]
    fn lights_without_filters_have_none() {
        assert!(PosedFilter::new(&spot(LightFilter::default())).is_none());
    }
}
