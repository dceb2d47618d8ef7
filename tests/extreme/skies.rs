//! Domes whose maps are of one texel or of millions, black, broken, or all in one bright spot; and none of their light
//! in a closed box. Pictures while they turn and at rest.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use relume::relight::{Detail, Request};
use relume::scene::{Camera, DomeMap, Light, PhysicalSky, Projection, Scene, SkyMap};

use crate::common::domes::{dome, map};
use crate::common::stage::{Build, Setup, lambert, look, rig};
use crate::common::{gpu, largest};
use crate::lights::{Relit, farthest_from_black, negative};
use crate::table::{Row, check, full};

const ALBEDO: f64 = 0.5;
const ONE_DIRECTION: &str = "while the dome turns, a sun is one direction, here in the plane of the floor";
const AT_THE_POLE: &str =
    "at the pole, interpolation adds a twelfth to the light of the first row, which suns do not have";

/// A floor alone, seen from above.
fn floor() -> (Scene, Camera) {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(ALBEDO as f32)));
    build.quad(DVec3::ZERO, DVec3::X, DVec3::NEG_Z, grey);
    let camera = look(DVec3::new(0.0, 2.0, 1.0), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.4 });
    (build.scene(), camera)
}

fn closed_room() -> (Scene, Camera) {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(ALBEDO as f32)));
    build.room(DVec3::ZERO, 1.0, grey);
    let camera = look(DVec3::new(0.8, 0.7, 0.9), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 1.3 });
    (build.scene(), camera)
}

fn relit((scene, camera): (Scene, Camera)) -> Relit {
    Relit::with(scene, &camera, &rig(vec![dome(None)]), &Setup::new(32, 24), 256)
}

/// Radiance of the floor under all of a map, by the midpoint rule.
fn radiance_under(map: &SkyMap) -> DVec3 {
    const SIDE: i32 = 2048;
    let step = [TAU / f64::from(2 * SIDE), 0.5 * PI / f64::from(SIDE)];
    let ring = |y: i32| {
        let (sine, cosine) = ((f64::from(y) + 0.5) * step[1]).sin_cos();
        let at = |x: i32| {
            let (sin, cos) = ((f64::from(x) + 0.5) * step[0]).sin_cos();
            map.radiance(DVec3::new(sine * sin, cosine, -sine * cos).as_vec3()).as_dvec3()
        };
        (0..2 * SIDE).map(at).sum::<DVec3>() * sine * cosine * step[0] * step[1]
    };
    (0..SIDE).map(ring).sum::<DVec3>() * ALBEDO / PI
}

/// A map with one bright spot.
fn spot(name: &str, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>, radiance: f32) -> Light {
    let at = |x, y| if columns.contains(&x) && rows.contains(&y) { Vec3::splat(radiance) } else { Vec3::ZERO };
    dome(Some(map(name, [512, 256], at)))
}

fn cases() -> Vec<(&'static str, Light)> {
    let day = |degrees: f64| {
        let sky = PhysicalSky { elevation: degrees.to_radians(), ..PhysicalSky::default() };
        Light { map: Some(DomeMap::physical(sky)), ..dome(None) }
    };
    let broken = map("broken", [64, 32], |x, y| match (x % 8, y % 8) {
        (0, 0) => Vec3::NAN,
        (4, 4) => Vec3::splat(-1e6),
        _ => Vec3::new(1.0, 0.5, 0.25),
    });
    let mut cases = vec![
        ("a map of one texel", dome(Some(map("texel", [1, 1], |_, _| Vec3::new(0.5, 1.0, 2.0))))),
        ("a map of 1 x 256", dome(Some(map("column", [1, 256], |_, y| Vec3::splat(y as f32))))),
        ("a sun of 1e6 cd/m² at the pole", spot("pole", 0..512, 0..2, 1e6)),
        ("a sun of 1e6 cd/m² at the horizon", spot("horizon", 100..103, 126..130, 1e6)),
        ("a texel of 1e30 cd/m²", spot("bright", 200..201, 60..61, 1e30)),
        ("every 32nd texel not a number or -1e6", dome(Some(broken))),
        ("a day, its sun at the zenith", day(90.0)),
        ("a day, its sun on the horizon", day(0.0)),
    ];
    if full() {
        let large = |x, y| if (x / 512 + y / 512) % 2 == 0 { Vec3::ONE } else { Vec3::splat(0.1) };
        cases.push(("a map of 16,384 x 8,192", dome(Some(map("large", [16_384, 8_192], large)))));
    }
    cases
}

#[test]
fn skies() {
    let gpu = gpu();
    let relit = relit(floor());
    let mut rows = Vec::new();
    for (case, light) in cases() {
        let want = radiance_under(light.sky());
        for (detail, when, bound) in [(Detail::Progressive, "while it turns", 5e-2), (Detail::Exact, "at rest", 1e-2)] {
            let mut relighter = relit.relighter(&gpu, &rig(vec![light.clone()]));
            let pixels = relighter.linear(Request { detail, ..Request::default() }).unwrap().to_vec();
            let sum: DVec3 = pixels.iter().map(|p| Vec3::from(*p).as_dvec3()).sum();
            let off = largest((sum / pixels.len() as f64 / want - 1.0).abs().to_array()) + negative(&pixels);
            let row = Row::new(case, format!("irradiance of a floor, {when}"), bound, off);
            rows.push(match (case, detail) {
                ("a sun of 1e6 cd/m² at the horizon", Detail::Progressive) => row.short(ONE_DIRECTION),
                ("a day, its sun at the zenith", Detail::Progressive) => row.short(AT_THE_POLE),
                _ => row,
            });
        }
    }
    let closed = self::relit(closed_room());
    let dark = spot("black", 0..0, 0..0, 0.0);
    for (case, relit, light) in
        [("a black map", &relit, dark), ("a sun around a closed room", &closed, spot("around", 0..512, 0..256, 1e6))]
    {
        let details = [Detail::Progressive, Detail::Exact];
        let pixels = details.map(|detail| {
            let mut relighter = relit.relighter(&gpu, &rig(vec![light.clone()]));
            relighter.linear(Request { detail, ..Request::default() }).unwrap().to_vec()
        });
        rows.push(Row::new(case, "black", 0.0, farthest_from_black(&pixels.concat())));
    }
    check("skies", &rows);
}
