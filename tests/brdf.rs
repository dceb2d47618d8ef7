//! What holds of the BRDF whatever it is used for: its samplers draw with the density that they tell, it is
//! reciprocal, and how much light it reflects stands in docs/brdf.md.

mod common;

use std::f64::consts::TAU;
use std::fmt::Write;
use std::path::Path;

use common::random::Random;
use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use relume::physics::brdf::{Lobes, f, mirror};
use relume::physics::sequence::Points;
use relume::scene::Surface;
use relume::shared::Brdf;
use relume::trace::surface::brdf;

fn surface(base_color: f32, metallic: f32, roughness: f32) -> Surface {
    common::plain_surface(Vec3::splat(base_color), metallic, roughness)
}

/// A frame around a normal that lies along no axis.
fn tilted() -> DMat3 {
    let normal = DVec3::new(0.36, -0.48, -0.8);
    let (tangent, bitangent) = normal.any_orthonormal_pair();
    DMat3::from_cols(tangent, bitangent, normal)
}

/// The local direction at an angle to the normal, in degrees.
fn tilt(degrees: f64) -> DVec3 {
    let (sine, cosine) = degrees.to_radians().sin_cos();
    DVec3::new(sine, 0.0, cosine)
}

/// Bins over the half vectors of one `wo`, stretched by 1 / `width`, so that they fit the lobe of that alpha. Columns
/// are equal; rows are equal in the root of the cosine, which is fine at the horizon, where grazing lobes end.
#[derive(Clone, Copy)]
struct Grid {
    frame: DMat3,
    wo: DVec3,
    width: f64,
    /// The first row, towards the normal, and the one after the last; all others are one bin with what is not drawn.
    rows: (usize, usize),
}

const ROWS: usize = 16;
const COLUMNS: usize = 32;
/// Points along a bin's sides at which densities are integrated.
const FINE: usize = 24;

impl Grid {
    /// The bin of a direction, 0 being that of all others.
    fn bin(&self, wi: DVec3) -> usize {
        let half = self.frame.transpose() * (wi + self.wo);
        let stretched = DVec3::new(half.x, half.y, half.z * self.width).normalize();
        let row = ((1.0 - stretched.z.sqrt()) * ROWS as f64) as usize;
        let column = ((half.y.atan2(half.x) / TAU + 0.5) * COLUMNS as f64) as usize;
        if row < self.rows.0 || row >= self.rows.1 { 0 } else { 1 + row * COLUMNS + column.min(COLUMNS - 1) }
    }

    /// The direction at a place of the grid in [0, 1)², if there is one, and the solid angle over the place's area.
    fn direction(&self, row: f64, column: f64) -> Option<(DVec3, f64)> {
        let root = 1.0 - row;
        let z = root * root;
        let (sine, cosine) = (TAU * (column - 0.5)).sin_cos();
        let r = self.width * (1.0 - z * z).sqrt();
        let half = DVec3::new(r * cosine, r * sine, z);
        // A linear map M changes solid angles by det M / |M s|³, and mirroring by 4 wo.h [Walter 2007, Eq. 14].
        let solid_angle = 2.0 * root * TAU * self.width * self.width / half.length().powi(3);
        let half = self.frame * half.normalize();
        let oh = self.wo.dot(half);
        (oh > 0.0).then(|| ((2.0 * oh * half - self.wo).normalize(), solid_angle * 4.0 * oh))
    }

    /// The integral of `value` over every bin; that of bin 0 is missing.
    fn integrate(&self, value: impl Fn(DVec3) -> f64) -> Vec<f64> {
        let mut bins = vec![0.0; 1 + ROWS * COLUMNS];
        let (fine_rows, fine_columns) = (ROWS * FINE, COLUMNS * FINE);
        for row in self.rows.0 * FINE..self.rows.1 * FINE {
            for column in 0..fine_columns {
                let (v, u) = ((row as f64 + 0.5) / fine_rows as f64, (column as f64 + 0.5) / fine_columns as f64);
                if let Some((wi, solid_angle)) = self.direction(v, u) {
                    bins[1 + row / FINE * COLUMNS + column / FINE] += value(wi) * solid_angle;
                }
            }
        }
        bins.iter().map(|sum| sum / (fine_rows * fine_columns) as f64).collect()
    }
}

/// How many standard deviations chi-square lies above what is expected if `drawn`'s directions have `told`'s density.
fn chi_square(grid: &Grid, drawn: &Lobes, told: &Lobes, seed: u64) -> f64 {
    const DRAWS: usize = 400_000;
    let mut random = Random::new(seed);
    let mut counts = vec![0.0; 1 + ROWS * COLUMNS];
    for _ in 0..DRAWS {
        let wi = drawn.sample([random.unit(), random.unit(), random.unit()]);
        counts[wi.map_or(0, |wi| grid.bin(wi))] += 1.0;
    }
    let mut expected: Vec<f64> = grid.integrate(|wi| told.at(wi).density).iter().map(|p| p * DRAWS as f64).collect();
    expected[0] = DRAWS as f64 - expected.iter().sum::<f64>();
    assert!(expected[0] > -1e-3 * DRAWS as f64, "the density's integral is 1 + {:.1e}", -expected[0] / DRAWS as f64);

    // Below ten the distribution is not chi-square's: such bins are one.
    let (rare, common): (Vec<_>, Vec<_>) = counts.into_iter().zip(expected).partition(|&(_, want)| want < 10.0);
    let pooled = rare.iter().fold((0.0, 0.0), |sum, bin| (sum.0 + bin.0, sum.1 + bin.1.max(0.0)));
    let bins = common.iter().chain((pooled.1 >= 10.0).then_some(&pooled));
    assert!(pooled.1 >= 10.0 || pooled.0 < 40.0, "{} draws where {:.1} are expected", pooled.0, pooled.1);
    let freedom = (bins.clone().count() - 1) as f64;
    let sum: f64 = bins.map(|(count, want)| (count - want).powi(2) / want).sum();
    // Its cube root is nearly normal [Wilson 1931].
    let variance = 2.0 / (9.0 * freedom);
    ((sum / freedom).cbrt() - (1.0 - variance)) / variance.sqrt()
}

const ANGLES: [f64; 7] = [0.0, 30.0, 60.0, 80.0, 89.0, 89.9, 89.999];

/// Fixed seeds: with 5 deviations one in 10,000 runs of all of these together would fail by chance.
#[test]
fn samplers_draw_with_the_density_they_tell() {
    let mut cases = Vec::new();
    for angle in ANGLES {
        cases.push((surface(0.8, 0.0, 0.0), angle, 1.0, (0, ROWS)));
        for roughness in [1e-4, 0.01, 0.1, 0.3, 0.6, 1.0] {
            let alpha = f64::from(roughness * roughness);
            cases.push((surface(0.8, 1.0, roughness), angle, alpha, (0, ROWS)));
            // Of two lobes on the grid of one, a row holds what of the other is too narrow to be integrated.
            cases.push((surface(0.8, 0.0, roughness), angle, alpha, (0, ROWS - 1)));
            cases.push((surface(0.2, 0.5, roughness), angle, 1.0, (1, ROWS)));
        }
    }
    let deviations: Vec<f64> = cases
        .par_iter()
        .enumerate()
        .map(|(seed, &(surface, angle, width, rows))| {
            let brdf = brdf(&surface);
            let frame = tilted();
            let wo = frame * tilt(angle);
            let lobes = Lobes::new(&brdf, frame.z_axis, wo).expect("it reflects");
            let deviations = chi_square(&Grid { frame, wo, width, rows }, &lobes, &lobes, seed as u64);
            let of = format!("metallic {}, roughness {}, {angle} degrees", surface.metallic, surface.roughness);
            assert!(deviations.abs() < 5.0, "{of}, bins of width {width}: {deviations:.1} deviations");
            deviations
        })
        .collect();
    let (low, high) = deviations.iter().fold((0f64, 0f64), |(low, high), &d| (low.min(d), high.max(d)));
    println!("{} cases from {low:.1} to {high:.1} deviations", deviations.len());
}

#[test]
fn chi_square_sees_a_lobe_two_percent_too_wide() {
    let [narrow, wide] = [0.3, 0.303].map(|roughness| brdf(&surface(0.8, 1.0, roughness)));
    let frame = tilted();
    for angle in [0.0, 60.0, 89.0] {
        let wo = frame * tilt(angle);
        let [narrow, wide] = [&narrow, &wide].map(|brdf| Lobes::new(brdf, frame.z_axis, wo).expect("it reflects"));
        let deviations = chi_square(&Grid { frame, wo, width: 0.09, rows: (0, ROWS) }, &wide, &narrow, 1);
        assert!(deviations > 5.0, "{deviations:.1} deviations at {angle} degrees");
    }
}

#[test]
fn light_may_travel_either_way() {
    let mut random = Random::new(7);
    let frame = tilted();
    let mut lit = 0;
    for _ in 0..200_000 {
        let metallic = random.pick(&[0.0, 0.3, 1.0]);
        let roughness = random.pick(&[0.0, 1e-4, 1e-2, 0.1, 0.5, 1.0]);
        let brdf = brdf(&surface(random.unit() as f32, metallic, roughness));
        // Anywhere, at grazing angles, and near the mirrored direction.
        let height =
            |random: &mut Random| if random.below(2) == 0 { random.unit() } else { random.magnitude(1e-9, 1.0) };
        let direction = |random: &mut Random| {
            let (z, (sine, cosine)) = (height(random), random.between(0.0, TAU).sin_cos());
            DVec3::new((1.0 - z * z).sqrt() * cosine, (1.0 - z * z).sqrt() * sine, z)
        };
        let p = direction(&mut random);
        let off = random.magnitude(1e-12, 1.0);
        let q = match random.below(2) {
            0 => direction(&mut random),
            _ => (DVec3::new(-p.x, -p.y, p.z) + off * direction(&mut random)).normalize(),
        };
        let [p, q] = [p, q].map(|local| (frame * local).normalize());
        let (there, back) = (f(&brdf, frame.z_axis, p, q), f(&brdf, frame.z_axis, q, p));
        // Tens of roundings of 1e-16. Of nearly opposite directions the angle to h is all rounding but its last
        // |p + q| / 2, and so is 1 - F.
        let tolerance = 1e-14 + 1e-14 / (p + q).length_squared();
        assert!(
            (there - back).abs().cmple(tolerance * there.max(back)).all(),
            "{there} and {back}: {brdf:?}, {p}, {q}"
        );
        lit += usize::from(there != DVec3::ZERO);
    }
    assert!(lit > 150_000, "only {lit} pairs reflect anything");
}

/// What a surface reflects towards `wo` of light that is 1 everywhere: by mirrored rays, directions drawn, and their
/// share that found nothing.
fn albedo(brdf: &Brdf, degrees: f64) -> f64 {
    const DRAWS: u32 = 1 << 16;
    let wo = tilt(degrees);
    let drawn = Lobes::new(brdf, DVec3::Z, wo).map_or(0.0, |lobes| {
        let points = Points::new(1, 0);
        let weight = |i: u32| {
            let [u, v, w, _] = points.at(i, 0);
            let at = lobes.sample([u, v, w]).map(|wi| lobes.at(wi));
            at.map_or(0.0, |at| at.sum().x / at.density)
        };
        (0..DRAWS).map(weight).sum::<f64>() / f64::from(DRAWS)
    });
    mirror(brdf, wo.z).x + drawn
}

/// The same by integration: the specular lobe on the grid that fits it, the diffuse one on that of alpha 1.
fn integrated_albedo(brdf: &Brdf, degrees: f64) -> f64 {
    let wo = tilt(degrees);
    let lobes = Lobes::new(brdf, DVec3::Z, wo);
    let integral = |width: f64, value: fn(&Lobes, DVec3) -> f64| {
        let grid = Grid { frame: DMat3::IDENTITY, wo, width, rows: (0, ROWS) };
        lobes.map_or(0.0, |lobes| grid.integrate(|wi| value(&lobes, wi)).iter().sum())
    };
    let specular = if brdf.has_lobe() { integral(brdf.alpha.into(), |lobes, wi| lobes.at(wi).specular.x) } else { 0.0 };
    mirror(brdf, wo.z).x + specular + integral(1.0, |lobes, wi| lobes.at(wi).diffuse.x)
}

const FURNACE_ROUGHNESS: [f32; 8] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0];
const FURNACE_ANGLES: [f64; 8] = [0.0, 30.0, 45.0, 60.0, 75.0, 80.0, 85.0, 89.0];

#[test]
fn metals_reflect_less_than_they_get() {
    for roughness in FURNACE_ROUGHNESS.into_iter().chain([1e-4, 0.03]) {
        for degrees in FURNACE_ANGLES.into_iter().chain([89.99]) {
            let albedo = albedo(&brdf(&surface(1.0, 1.0, roughness)), degrees);
            assert!(albedo <= 1.0 + 1e-9, "a white metal of roughness {roughness} has {albedo} at {degrees} degrees");
        }
    }
}

/// What another implementation of the same BRDF has been found to reflect.
#[test]
fn albedos_known_from_elsewhere() {
    for (metallic, roughness, degrees, known) in
        [(0.0, 0.3, 85.0, 1.29), (0.25, 0.0, 85.0, 1.44), (1.0, 1.0, 0.0, 0.31)]
    {
        let albedo = albedo(&brdf(&surface(1.0, metallic, roughness)), degrees);
        assert!((albedo - known).abs() < 0.006, "metallic {metallic}, roughness {roughness}, {degrees}: {albedo}");
    }
}

/// The tables of docs/brdf.md; `BLESS=1` writes them.
#[test]
fn albedos_are_those_of_the_documentation() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/brdf.md");
    let document = std::fs::read_to_string(&path).unwrap();
    let (before, tables) = document.split_once("<!-- tables -->\n").expect("a mark before the tables");
    let mut now = String::new();
    for metallic in [0.0f32, 0.25, 0.5, 1.0] {
        writeln!(now, "\n| metallic {metallic} | {} |", FURNACE_ANGLES.map(|d| format!("{d}°")).join(" | ")).unwrap();
        writeln!(now, "|---|{}", "---|".repeat(FURNACE_ANGLES.len())).unwrap();
        for roughness in FURNACE_ROUGHNESS {
            let brdf = brdf(&surface(1.0, metallic, roughness));
            let row = FURNACE_ANGLES.map(|degrees| {
                let (drawn, integrated) = (albedo(&brdf, degrees), integrated_albedo(&brdf, degrees));
                let of = format!("metallic {metallic}, roughness {roughness}, {degrees} degrees");
                assert!((drawn - integrated).abs() < 1e-3, "{of}: {drawn} drawn, {integrated} integrated");
                drawn
            });
            writeln!(now, "| {roughness} | {} |", row.map(|albedo| format!("{albedo:.3}")).join(" | ")).unwrap();
        }
    }
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(&path, format!("{before}<!-- tables -->\n{now}")).unwrap();
        return;
    }
    // Another machine's sines may turn the last digit.
    let numbers = |text: &str| -> Vec<f64> { text.split(['|', ' ']).filter_map(|word| word.parse().ok()).collect() };
    let (got, want) = (numbers(&now), numbers(tables));
    assert_eq!(got.len(), want.len(), "the tables have other rows or columns");
    assert!(got.iter().zip(&want).all(|(got, want)| (got - want).abs() < 1.5e-3), "the tables are now:\n{now}");
}
