//! The sky of a clear or hazy day as an environment map [Hosek 2012], with the disk of the sun.

use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::RangeInclusive;

use glam::{DVec3, Vec3};
use hw_skymodel::rgb::{Channel, SkyParams, SkyState};
use rayon::prelude::*;

use super::{SkyMap, Texels};
use crate::scene::rig::xyz_to_rgb;

/// Parameters of a sky. In its map, the sun stands above the middle: towards +z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhysicalSky {
    /// Of the sun above the horizon in radians, 0 to pi/2.
    pub elevation: f64,
    /// Haze, in [`TURBIDITY`]: 2 is a clear day, 6 a hazy one.
    pub turbidity: f64,
    /// Share of light that the ground reflects, 0 to 1.
    pub ground: f64,
    /// Whether the disk of the sun is in the map.
    pub sun: bool,
}

/// Range for which [Hosek 2012] is fitted.
pub const TURBIDITY: RangeInclusive<f64> = 1.0..=10.0;

impl Default for PhysicalSky {
    fn default() -> Self {
        Self { elevation: PI / 6.0, turbidity: 3.0, ground: 0.2, sun: true }
    }
}

/// Texels are 0.35 degrees wide.
const SIZE: [usize; 2] = [1024, 512];
/// Lumens per watt at 555 nm.
const EFFICACY: f64 = 683.0;
/// Effective temperature of the sun's surface, K.
const SUN_KELVIN: f64 = 5772.0;
/// Half the angle that the sun fills, radians.
const SUN_RADIUS: f64 = 0.004_65;
/// Rows and columns of points in a texel that tell how much of it the sun covers.
const PLACES: usize = 8;

impl PhysicalSky {
    /// Renders the map; radiance in cd/m² of each channel. Panics if a parameter is out of its range.
    pub fn map(&self) -> SkyMap {
        let [width, height] = SIZE;
        let mut texels = Texels { width, height, values: vec![Vec3::ZERO; width * height] };
        let toward_sun = DVec3::new(0.0, self.elevation.sin(), self.elevation.cos());
        let model = self.model();
        let upper = width * height / 2;
        let mut values = std::mem::take(&mut texels.values);
        let rows = values[..upper].par_chunks_mut(width).enumerate();
        let from_sky: DVec3 = rows
            .map(|(y, row)| {
                let first = y * width;
                for x in 0..width / 2 {
                    let direction = texels.direction(first + x);
                    let off = [DVec3::Y, toward_sun].map(|axis| direction.dot(axis).clamp(-1.0, 1.0).acos() as f32);
                    let channel = |channel| model.radiance(off[0], off[1], channel).max(0.0);
                    let watts = Vec3::new(channel(Channel::R), channel(Channel::G), channel(Channel::B));
                    // The sky is symmetric about the sun.
                    row[x] = watts * EFFICACY as f32;
                    row[width - 1 - x] = row[x];
                }
                let cosine = texels.direction(first).y;
                row.iter().map(|value| value.as_dvec3()).sum::<DVec3>() * cosine * texels.solid_angle(first)
            })
            .sum();
        let irradiance = from_sky + self.sun_radiance() * PI * SUN_RADIUS.powi(2) * toward_sun.y;
        values[upper..].fill((irradiance * self.ground / PI).as_vec3());
        if self.sun {
            let covered = covered(&texels, toward_sun);
            let disk: f64 = covered.iter().map(|&(i, share)| share * texels.solid_angle(i)).sum();
            // The texels have exactly the light of the disk.
            let radiance = self.sun_radiance() * (PI * SUN_RADIUS.powi(2) / disk);
            for (i, share) in covered.into_iter().filter(|(i, _)| *i < upper) {
                values[i] += (radiance * share).as_vec3();
            }
        }
        SkyMap::new(Texels { values, ..texels })
    }

    fn model(&self) -> SkyState {
        let elevation = self.elevation.clamp(0.0, FRAC_PI_2) as f32;
        let parameters = SkyParams {
            elevation: elevation.min(std::f32::consts::FRAC_PI_2),
            turbidity: self.turbidity as f32,
            albedo: [self.ground as f32; 3],
        };
        SkyState::new(&parameters).expect("parameters are in their ranges")
    }

    /// Mean radiance of the sun's disk in cd/m²: a black body behind an atmosphere [Preetham 1999, Appendix 2] without
    /// ozone and water.
    fn sun_radiance(&self) -> DVec3 {
        let degrees = self.elevation.to_degrees();
        let air_mass = 1.0 / (self.elevation.sin() + 0.15 * (3.885 + degrees).powf(-1.253));
        let haze = 0.04608 * self.turbidity - 0.04586;
        let step = 10.0;
        let xyz: DVec3 = (0..=40)
            .map(|i| {
                let nanometres = 380.0 + step * f64::from(i);
                let micrometres = 1e-3 * nanometres;
                let depth = 0.008_735 * micrometres.powf(-4.08) + haze * micrometres.powf(-1.3);
                color_matching(nanometres) * black_body(nanometres, SUN_KELVIN) * (-air_mass * depth).exp() * step
            })
            .sum();
        xyz_to_rgb(EFFICACY * xyz).max(DVec3::ZERO)
    }
}

/// Texels that the sun covers, and what share of them.
fn covered(texels: &Texels, toward_sun: DVec3) -> Vec<(usize, f64)> {
    let share = |i: usize| {
        let inside = (0..PLACES * PLACES).filter(|place| {
            let within = [place % PLACES, place / PLACES].map(|at| (at as f64 + 0.5) / PLACES as f64);
            texels.direction_within(i, within).distance(toward_sun) < SUN_RADIUS
        });
        inside.count() as f64 / (PLACES * PLACES) as f64
    };
    let reach = SUN_RADIUS + PI / texels.height as f64;
    let near = texels.near(toward_sun, reach).filter(|&i| texels.direction(i).distance(toward_sun) < 2.0 * reach);
    near.map(|i| (i, share(i))).filter(|(_, share)| *share > 0.0).collect()
}

/// Spectral radiance in W/(m² sr nm) by Planck's law.
fn black_body(nanometres: f64, kelvin: f64) -> f64 {
    // 2 h c² and h c / k.
    let (first, second) = (1.191_042_972e-16, 1.438_776_877e-2);
    let metres = 1e-9 * nanometres;
    1e-9 * first / (metres.powi(5) * (second / (metres * kelvin)).exp_m1())
}

/// CIE 1931 x, y, z by sums of lobes [Wyman 2013, Equation 4].
fn color_matching(nanometres: f64) -> DVec3 {
    let lobe = |height: f64, middle: f64, below: f64, above: f64| {
        let off = (nanometres - middle) / if nanometres < middle { below } else { above };
        height * (-0.5 * off * off).exp()
    };
    DVec3::new(
        lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) - lobe(0.065, 501.1, 20.4, 26.2),
        lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1),
        lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::luminance;

    fn sky(degrees: f64, turbidity: f64) -> PhysicalSky {
        PhysicalSky { elevation: degrees.to_radians(), turbidity, ..PhysicalSky::default() }
    }

    /// Towards elevation and azimuth from the sun in degrees.
    fn toward(elevation: f64, azimuth: f64) -> Vec3 {
        let [e, a] = [elevation, azimuth].map(f64::to_radians);
        DVec3::new(e.cos() * a.sin(), e.sin(), e.cos() * a.cos()).as_vec3()
    }

    /// Radiance of the sky alone as the emitter `sunsky` of Mitsuba 3.9.1 has it, ground 0.2, times the integral of
    /// CIE y, 106.857 nm.
    #[test]
    fn radiance_is_that_of_another_implementation() {
        for (elevation, turbidity, [zenith, low, aside]) in [
            (30.0, 3.0, [[0.01573, 0.02989, 0.05975], [0.29225, 0.33221, 0.33436], [0.02389, 0.04396, 0.08099]]),
            (60.0, 6.0, [[0.08130, 0.09971, 0.14078], [0.17797, 0.22377, 0.28757], [0.05341, 0.07839, 0.13187]]),
            (5.0, 2.0, [[0.00662, 0.01173, 0.01798], [0.18972, 0.14981, 0.08525], [0.01278, 0.02031, 0.02827]]),
        ] {
            let map = PhysicalSky { sun: false, ..sky(elevation, turbidity) }.map();
            for (want, direction) in
                [(zenith, toward(89.9, 0.0)), (low, toward(10.0, 0.0)), (aside, toward(45.0, 90.0))]
            {
                let want = Vec3::from_array(want) * (106.857 * EFFICACY) as f32;
                let got = map.radiance(direction);
                assert!((got / want - 1.0).abs().max_element() < 0.02, "{elevation} {direction}: {got}, want {want}");
            }
        }
    }

    /// Daylight at noon is near 100,000 lux, a fifth of it from the sky; the setting sun is red and weak.
    #[test]
    fn the_sun_is_as_bright_as_it_should_be() {
        let lux = |sky: &PhysicalSky| {
            let map = sky.map();
            let upper = 0..map.texels.values.len() / 2;
            let texels = &map.texels;
            let at = |i: usize| texels.values[i].as_dvec3() * texels.direction(i).y * texels.solid_angle(i);
            upper.map(at).sum::<DVec3>()
        };
        for (degrees, turbidity, suns, skies) in
            [(60.0, 2.5, 70e3..100e3, 8e3..20e3), (90.0, 2.5, 80e3..120e3, 8e3..25e3), (5.0, 2.5, 0.5e3..5e3, 1e3..8e3)]
        {
            let with = sky(degrees, turbidity);
            let without = PhysicalSky { sun: false, ..with };
            let brightness = |rgb: DVec3| f64::from(luminance(rgb.as_vec3().to_array()));
            let of_sky = brightness(lux(&without));
            let of_sun = brightness(lux(&with)) - of_sky;
            println!("{degrees}: sun {of_sun:.0} lx, sky {of_sky:.0} lx");
            assert!(suns.contains(&of_sun) && skies.contains(&of_sky), "{degrees}: sun {of_sun}, sky {of_sky}");
            let exact = with.sun_radiance() * PI * SUN_RADIUS.powi(2) * with.elevation.sin();
            assert!((of_sun / brightness(exact) - 1.0).abs() < 0.01, "{of_sun}, want {}", brightness(exact));
        }
        let setting = sky(2.0, 3.0).sun_radiance();
        assert!(setting.x > 4.0 * setting.z, "{setting}");
    }

    #[test]
    fn extreme_skies_are_finite_and_have_their_sun() {
        for (degrees, turbidity, ground) in [(0.0, 1.0, 0.0), (90.0, 10.0, 1.0), (0.0, 10.0, 1.0), (90.0, 1.0, 0.5)] {
            let sky = PhysicalSky { ground, ..sky(degrees, turbidity) };
            let map = sky.map();
            assert!(map.texels.values.iter().all(|value| value.is_finite() && value.min_element() >= 0.0));
            // At the horizon the sun may be too weak to be one.
            assert!(degrees == 0.0 || map.parts().suns().len() == 1, "{sky:?}");
        }
    }
}
