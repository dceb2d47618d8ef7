//! Units of a light's strength, as lamps are sold and as other programs ask for it. Colour, stops and group are factors
//! on all of them and are not included.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::{Light, LightKind};

/// A unit of a light's strength.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightUnit {
    /// Luminous intensity, straight ahead.
    Candela,
    /// Illuminance, of directional lights.
    Lux,
    /// Luminous flux of the lamp, before gobo and barn doors.
    Lumen,
    /// Luminance straight ahead, cd/m², of area lights.
    Nit,
    /// Power of a Blender light; W/m² for a sun.
    Watt,
    /// Times the emission of the material, of emitters.
    Factor,
}

/// Lumens per watt, as Blender's glTF I/O add-on converts them (`PBR_WATTS_TO_LUMENS` in io_scene_gltf2).
const LUMENS_PER_WATT: f64 = 683.0;
/// Least difference of the cosines of a spot's inner and outer angle, from the reference code of `KHR_lights_punctual`.
pub const LEAST_FALLOFF: f64 = 0.001;

impl LightUnit {
    pub const ALL: [Self; 6] = [Self::Candela, Self::Lux, Self::Lumen, Self::Nit, Self::Watt, Self::Factor];

    /// The unit of [`Light::intensity`].
    pub fn of_intensity(kind: LightKind) -> Self {
        match kind {
            LightKind::Directional => Self::Lux,
            LightKind::Dome => Self::Nit,
            LightKind::Emitter => Self::Factor,
            _ => Self::Candela,
        }
    }

    pub fn symbol(self, kind: LightKind) -> &'static str {
        match self {
            Self::Candela => "cd",
            Self::Lux => "lx",
            Self::Lumen => "lm",
            Self::Nit => "nit",
            Self::Watt if kind == LightKind::Directional => "W/m²",
            Self::Watt => "W",
            Self::Factor => "x",
        }
    }
}

impl Light {
    /// The strength in `unit` at an intensity of one; `None` if the unit does not fit the light's kind or size.
    ///
    /// Watts are those of a Blender light without a profile. A point has the same intensity in all directions. A spot
    /// is as bright as a point of the same watts, however narrow its cone. An area light sends all its watts to one
    /// side.
    pub fn per_intensity(&self, unit: LightUnit) -> Option<f64> {
        let per_intensity = match unit {
            LightUnit::Candela | LightUnit::Lux | LightUnit::Factor if unit == LightUnit::of_intensity(self.kind) => {
                1.0
            }
            LightUnit::Lumen if self.kind.has_position() => self.flux(),
            LightUnit::Nit => self.projected_area()?.recip(),
            LightUnit::Watt => {
                let lumens = match self.kind {
                    LightKind::Point | LightKind::Spot => 4.0 * PI,
                    LightKind::Directional => 1.0,
                    LightKind::Disk | LightKind::Rect => facet_flux(self.spread),
                    LightKind::Dome | LightKind::Emitter => return None,
                };
                lumens / LUMENS_PER_WATT
            }
            LightUnit::Candela | LightUnit::Lux | LightUnit::Lumen | LightUnit::Factor => return None,
        };
        (per_intensity.is_finite() && per_intensity > 0.0).then_some(per_intensity)
    }

    /// The units that fit the light.
    pub fn units(&self) -> impl Iterator<Item = LightUnit> {
        LightUnit::ALL.into_iter().filter(|unit| self.per_intensity(*unit).is_some())
    }

    /// `unit` if it fits the light, else that of its intensity.
    pub fn fitting(&self, unit: LightUnit) -> LightUnit {
        self.per_intensity(unit).map_or(LightUnit::of_intensity(self.kind), |_| unit)
    }

    /// The next unit that fits the light, in the order of [`LightUnit::ALL`], after `unit` or the one in its place.
    pub fn unit_after(&self, unit: LightUnit) -> LightUnit {
        let shown = self.fitting(unit);
        let later = self.units().skip_while(|other| *other != shown).nth(1);
        later.unwrap_or(LightUnit::of_intensity(self.kind))
    }

    /// Lumens at one candela: the integral of [`Self::emission`] times the profile over all directions.
    fn flux(&self) -> f64 {
        let sides = if self.two_sided { 2.0 } else { 1.0 };
        match (self.kind, &self.filter.ies) {
            (LightKind::Point, None) => 4.0 * PI,
            (LightKind::Point, Some(ies)) => ies.flux() / ies.max(),
            (LightKind::Spot, None) => cone_flux(self.inner_angle, self.outer_angle),
            (LightKind::Disk | LightKind::Rect, None) => sides * facet_flux(self.spread),
            (LightKind::Spot | LightKind::Disk | LightKind::Rect, Some(_)) => self.flux_through_profile(),
            (LightKind::Directional | LightKind::Dome | LightKind::Emitter, _) => 0.0,
        }
    }

    /// Intensity at `angle` from the light's direction relative to that straight ahead, before filters: the cone of
    /// `KHR_lights_punctual`, or a surface whose spread narrows as in Cycles.
    fn emission(&self, angle: f64) -> f64 {
        match self.kind {
            LightKind::Point | LightKind::Directional | LightKind::Dome | LightKind::Emitter => 1.0,
            LightKind::Spot => {
                let [inner, outer] = [self.inner_angle, self.outer_angle].map(f64::cos);
                ((angle.cos() - outer) / (inner - outer).max(LEAST_FALLOFF)).clamp(0.0, 1.0).powi(2)
            }
            LightKind::Disk | LightKind::Rect => {
                let cosine = if self.two_sided { angle.cos().abs() } else { angle.cos() };
                (cosine - angle.sin() / (self.spread / 2.0).tan()).max(0.0)
            }
        }
    }

    /// [`Self::flux`] of a light that is not round, by the midpoint rule; accurate to 1e-3 for smooth profiles.
    fn flux_through_profile(&self) -> f64 {
        const POLAR_STEPS: u32 = 180;
        const AZIMUTH_STEPS: u32 = 36;
        let Some(ies) = &self.filter.ies else { return 0.0 };
        let edge = if self.kind == LightKind::Spot { self.outer_angle } else { self.spread / 2.0 };
        let step = edge / f64::from(POLAR_STEPS);
        let ring = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            let around = (0..AZIMUTH_STEPS).map(|i| {
                let (y, x) = (TAU * (f64::from(i) + 0.5) / f64::from(AZIMUTH_STEPS)).sin_cos();
                ies.candela([sin * x, sin * y, cos])
            });
            self.emission(angle) * sin * around.sum::<f64>()
        };
        let angles = (0..POLAR_STEPS).map(|i| (f64::from(i) + 0.5) * step);
        let sum: f64 = angles.map(|angle| ring(angle) + if self.two_sided { ring(PI - angle) } else { 0.0 }).sum();
        sum * step * TAU / f64::from(AZIMUTH_STEPS) / ies.max()
    }
}

/// Integral of a spot's cone over the sphere: 1 inside of the inner angle, then a parabola in the cosine.
fn cone_flux(inner: f64, outer: f64) -> f64 {
    // 1 - cos without cancellation.
    let [inner, outer] = [inner, outer].map(|angle| 2.0 * (angle / 2.0).sin().powi(2));
    let width = (outer - inner).max(LEAST_FALLOFF);
    let fall = width.min(outer);
    TAU * (outer - fall + (fall / width).powi(2) * fall / 3.0)
}

/// Integral of cos - sin / tan(spread / 2), one side of a flat light, over its cone: pi for a full spread.
fn facet_flux(spread: f64) -> f64 {
    let half = (spread / 2.0).min(FRAC_PI_2);
    // The series of 1 - x / tan x avoids cancellation.
    PI * if half < 0.01 { half.powi(2) / 3.0 + half.powi(4) / 45.0 } else { 1.0 - half / half.tan() }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_4;
    use std::path::Path;

    use glam::DVec3;

    use super::*;
    use crate::scene::{Rig, RigFiles};

    fn light(kind: LightKind) -> Light {
        Light { kind, radius: 0.5, size: [2.0, 0.25], angle: 0.01, ..Light::point("light", DVec3::ZERO) }
    }

    fn assert_near(got: Option<f64>, want: f64, tolerance: f64) {
        assert!(got.is_some_and(|got| (got / want - 1.0).abs() <= tolerance), "{got:?} is not {want}");
    }

    /// A lamp of the same intensity in all directions.
    fn with_even_profile(light: Light) -> Light {
        let folder = tempfile::tempdir().unwrap();
        let text = "TILT=NONE\n1 -1 1 2 1 1 2 0 0 0 1 1 9 0 180 0 250 250\n";
        std::fs::write(folder.path().join("even.ies"), text).unwrap();
        let ies = Some(RigFiles::new(folder.path()).profile("even.ies").unwrap());
        Light { filter: crate::scene::LightFilter { ies, ..light.filter.clone() }, ..light }
    }

    #[test]
    fn lumens_are_the_integral_of_candela() {
        use LightUnit::Lumen;
        assert_near(light(LightKind::Point).per_intensity(Lumen), 4.0 * PI, 1e-15);
        let disk = light(LightKind::Disk);
        assert_near(disk.per_intensity(Lumen), PI, 1e-15);
        assert_near(Light { two_sided: true, ..disk.clone() }.per_intensity(Lumen), TAU, 1e-15);
        let spot = |inner_angle, outer_angle| Light { inner_angle, outer_angle, ..light(LightKind::Spot) };
        // A hemisphere; the edge of the cone is never harder than a thousandth.
        assert_near(spot(FRAC_PI_2, FRAC_PI_2).per_intensity(Lumen), TAU, LEAST_FALLOFF);
        // A paraboloid over the hemisphere.
        assert_near(spot(0.0, FRAC_PI_2).per_intensity(Lumen), TAU / 3.0, 1e-15);
        // The closed forms are the integrals of the emission.
        for light in [
            spot(0.3, 1.2),
            spot(0.0, 0.01),
            Light { spread: 1.0, ..disk.clone() },
            Light { spread: 0.015, two_sided: true, ..disk.clone() },
        ] {
            let steps = 100_000;
            let edge = if light.kind == LightKind::Spot { light.outer_angle } else { light.spread / 2.0 };
            let sides = if light.two_sided { 2.0 } else { 1.0 };
            let angles = (0..steps).map(|i| edge * (f64::from(i) + 0.5) / f64::from(steps));
            let sum: f64 = angles.map(|angle| light.emission(angle) * angle.sin()).sum();
            assert_near(light.per_intensity(Lumen), sides * TAU * sum * edge / f64::from(steps), 1e-6);
        }
    }

    #[test]
    fn an_even_profile_changes_no_lumens() {
        let disk = Light { spread: 2.0, two_sided: true, ..light(LightKind::Disk) };
        let spot = Light { inner_angle: 0.3, outer_angle: 1.2, ..light(LightKind::Spot) };
        for (light, tolerance) in [(light(LightKind::Point), 1e-12), (spot, 1e-3), (disk, 1e-3)] {
            let want = light.per_intensity(LightUnit::Lumen).unwrap();
            assert_near(with_even_profile(light).per_intensity(LightUnit::Lumen), want, tolerance);
        }
    }

    #[test]
    fn nits_times_area_are_candela() {
        for (kind, area) in [(LightKind::Point, FRAC_PI_4), (LightKind::Disk, FRAC_PI_4), (LightKind::Rect, 0.5)] {
            assert_near(light(kind).per_intensity(LightUnit::Nit), area.recip(), 1e-15);
        }
        // The sun's radiance is its irradiance over its solid angle.
        assert_near(light(LightKind::Directional).per_intensity(LightUnit::Nit), 1.0 / (PI * 0.005f64.powi(2)), 1e-5);
        assert_eq!(light(LightKind::Spot).per_intensity(LightUnit::Nit), None);
        assert_eq!(Light { radius: 0.0, ..light(LightKind::Disk) }.per_intensity(LightUnit::Nit), None);
    }

    /// Watts of Blender 4 and its glTF exporter, area lights as in Cycles.
    #[test]
    fn watts_are_those_of_blender() {
        let intensity_of_a_watt = |light: Light| light.per_intensity(LightUnit::Watt).map(f64::recip);
        assert_near(intensity_of_a_watt(light(LightKind::Point)), 683.0 / (4.0 * PI), 1e-15);
        assert_near(intensity_of_a_watt(light(LightKind::Spot)), 683.0 / (4.0 * PI), 1e-15);
        assert_near(intensity_of_a_watt(light(LightKind::Directional)), 683.0, 1e-15);
        assert_near(intensity_of_a_watt(light(LightKind::Rect)), 683.0 / PI, 1e-15);
        // Cycles: tan(a) / (tan(a) - a) times as bright ahead if the spread is 2a.
        let narrow = Light { spread: 1.0, ..light(LightKind::Disk) };
        let (half, tan) = (0.5f64, 0.5f64.tan());
        assert_near(intensity_of_a_watt(narrow), 683.0 / PI * tan / (tan - half), 1e-14);
    }

    #[test]
    fn every_unit_of_every_kind_is_read_as_it_is_shown() {
        use LightKind::{Directional, Disk, Emitter, Point, Rect, Spot};
        use LightUnit::{Candela, Factor, Lumen, Lux, Nit, Watt};
        for (kind, name, units) in [
            (Point, "point", &[Candela, Lumen, Nit, Watt][..]),
            (Spot, "spot", &[Candela, Lumen, Watt]),
            (Directional, "sun", &[Lux, Nit, Watt]),
            (Disk, "disk", &[Candela, Lumen, Nit, Watt]),
            (Rect, "rect", &[Candela, Lumen, Nit, Watt]),
            (Emitter, "emitter", &[Factor]),
        ] {
            let shown = Light { intensity: 12.5, ..light(kind) };
            assert_eq!(shown.units().collect::<Vec<_>>(), units);
            for unit in units {
                let key = match unit {
                    Candela | Lux | Factor => "intensity",
                    Lumen => "lumen",
                    Nit => "nit",
                    Watt => "watt",
                };
                let value = shown.intensity * shown.per_intensity(*unit).unwrap();
                let text = format!(
                    "[[light]]\nname = \"a\"\nkind = \"{name}\"\nposition = [0, 0, 0]\ndirection = [0, 0, -1]\n\
                    material = \"m\"\n\
                    radius = 0.5\nwidth = 2\nheight = 0.25\nangle_deg = {:?}\n{key} = {value:?}\n",
                    0.01f64.to_degrees()
                );
                let read = Rig::from_toml(&text, RigFiles::new(Path::new(""))).unwrap();
                assert_near(Some(read.lights[0].intensity), 12.5, 1e-14);
            }
            assert_eq!(shown.fitting(Candela), LightUnit::of_intensity(kind));
            let cycle = (1..units.len()).scan(units[0], |unit, _| {
                *unit = shown.unit_after(*unit);
                Some(*unit)
            });
            assert!(cycle.eq(units[1..].iter().copied()) && shown.unit_after(*units.last().unwrap()) == units[0]);
        }
    }
}
