//! Triangles that are hardly any, surfaces that lie on each other or cut each other, gaps that are hardly any.

use glam::{DVec3, Vec3};
use relume::bake::transport::directions::Lobe;
use relume::scene::{Projection, Rig, Scene};

use crate::common::largest;
use crate::common::stage::{Build, lambert, look};
use crate::even::{Stage, errors, gathered, settings, shining};
use crate::table::{Row, check};

const ALBEDO: f32 = 0.9;

fn room() -> Build {
    let mut build = Build::default();
    let material = build.material(shining(ALBEDO));
    build.room(DVec3::ZERO, 1.0, material);
    build
}

/// Each wall as a fan around a corner: its triangles get narrower and narrower, to a millionth of their length.
fn slivers() -> Scene {
    let mut build = room();
    let walls = std::mem::take(&mut build.quads);
    for ([a, b, c, d], material) in walls {
        let mut along = vec![b];
        along.extend((0..=20).rev().map(|i| b.lerp(c, 0.5 * f64::exp2(-f64::from(i)))));
        along.extend((1..=20).map(|i| c.lerp(b, 0.5 * f64::exp2(-f64::from(i)))));
        along.extend([c, c.lerp(d, 0.5), d]);
        for three in along.windows(3).step_by(2) {
            build.quads.push(([a, three[0], three[1], three[2]], material));
        }
    }
    build.scene()
}

/// Each wall in strips, between broad ones such as are a millionth of a metre wide.
fn needles() -> Scene {
    let mut build = room();
    let walls = std::mem::take(&mut build.quads);
    for ([a, b, c, d], material) in walls {
        let edges = [0.0, 1e-6, 0.25, 0.25 + 1e-6, 0.5, 0.5 + 2e-6, 1.0 - 1e-6, 1.0];
        for pair in edges.windows(2) {
            let [low, high] = [pair[0], pair[1]].map(|t: f64| (a.lerp(b, t), d.lerp(c, t)));
            build.quads.push(([low.0, high.0, high.1, low.1], material));
        }
    }
    build.scene()
}

/// Every wall reaches through its neighbours.
fn interpenetrating() -> Scene {
    let mut build = room();
    for (corners, _) in &mut build.quads {
        let center = (corners[0] + corners[2]) / 2.0;
        *corners = corners.map(|p| center + 1.3 * (p - center));
    }
    build.scene()
}

/// Two sheets `gap` apart, shining to both sides, in the middle of a room, which is seen past them.
fn crack(gap: f64) -> Scene {
    let mut build = room();
    let sheet = build.material(relume::scene::Material { double_sided: true, ..shining(ALBEDO) });
    for side in [-0.5, 0.5] {
        build.quad(DVec3::new(0.0, -0.5 + side * gap, 0.0), 0.5 * DVec3::Z, 0.5 * DVec3::X, sheet);
    }
    build.scene()
}

#[test]
fn closed_scenes_of_bad_triangles() {
    let mut twice = room();
    twice.quads.extend(twice.quads.clone());
    let mut hair = room();
    hair.quads.extend(hair.quads.clone().into_iter().map(|(corners, m)| (corners.map(|p| p * (1.0 + 1e-7)), m)));
    let mut rows = Vec::new();
    for (what, scene) in [
        ("walls in fans whose triangles get as narrow as 1e-6", slivers()),
        ("walls in strips, some 1e-6 m wide", needles()),
        ("every triangle twice", twice.scene()),
        ("a second skin 1e-7 m behind the first", hair.scene()),
        ("walls that cut each other", interpenetrating()),
        ("sheets 1e-2 m apart in a room", crack(1e-2)),
        ("sheets 1e-4 m apart in a room", crack(1e-4)),
        ("sheets 1e-6 m apart in a room", crack(1e-6)),
    ] {
        rows.extend(errors(&Stage::inside(scene), ALBEDO).rows(what, ALBEDO, None));
    }
    check("geometry", &rows);
}

/// Share of the light of one of two equal squares that meets the other, at a distance of `gap` sides
/// [Howell, Catalog of radiation configuration factors, C-11].
fn view_factor(gap: f64) -> f64 {
    let x = 1.0 / gap;
    let root = (1.0 + x * x).sqrt();
    let log = ((1.0 + x * x).powi(2) / (1.0 + 2.0 * x * x)).sqrt().ln();
    2.0 / (std::f64::consts::PI * x * x) * (log + 2.0 * x * root * (x / root).atan() - 2.0 * x * x.atan())
}

/// Two plates that shine at each other keep most of their light: between 1/(1-ρF) times what they emit, by convexity,
/// and 1/(1-ρ).
#[test]
fn parallel_plates() {
    let mut rows = Vec::new();
    let rho = f64::from(ALBEDO);
    // Rays start 5e-6 from a plate: nearer ones exchange no light.
    for gap in [1e-1, 1e-2, 1e-3, 1e-4, 1e-5] {
        let mut build = Build::default();
        let material = build.material(shining(ALBEDO));
        build.quad(-0.5 * gap * DVec3::Y, 0.5 * DVec3::Z, 0.5 * DVec3::X, material);
        build.quad(0.5 * gap * DVec3::Y, 0.5 * DVec3::X, 0.5 * DVec3::Z, material);
        // Into the gap from its middle.
        let camera = look(DVec3::ZERO, DVec3::X, DVec3::Y, Projection::Perspective { yfov: 1.5 });
        let stage = Stage::new(build.scene(), &camera, [32, 32]);
        let transfer = stage.transfer(&settings(1024, 1024, 256));
        let (low, high) = (1.0 / (1.0 - rho * view_factor(gap)), 1.0 / (1.0 - rho));
        let outside = |gain: f64| largest([low - gain, gain - high, 0.0]) / high;
        let flux = |light: &[DVec3]| -> f64 {
            let of = |i: usize| {
                light[transfer.fine.coefficients(i).start].x * f64::from(transfer.fine.samples.samples[i].area)
            };
            (0..transfer.fine.samples.len()).map(of).sum()
        };
        let emission = transfer.emission();
        let gain = flux(&transfer.bounce(&emission).0) / flux(&emission);
        let of_thesis = || {
            let thesis = stage.thesis(1024);
            let emitted = vec![DVec3::ONE; thesis.samples.len()];
            outside(thesis.bounce(&emitted).iter().map(|r| r.x).sum::<f64>() / emitted.len() as f64)
        };
        let asked = "between 1/(1-ρF) and 1/(1-ρ) times what they emit";
        let row = Row::new(format!("plates {gap:.0e} of their size apart"), asked, 1e-3, outside(gain));
        rows.push(row.thesis(of_thesis));
        let lit = stage.lit();
        let seen = transfer.apply(&[emission], &lit, Lobe::All, &|_| ()).remove(0);
        let most = largest(seen.iter().map(|p| p.x));
        assert!(most > 0.0, "no light comes back from plates {gap:.0e} apart");
        let asked = "no pixel above ρ/(1-ρ)";
        rows.push(Row::new(
            format!("plates {gap:.0e} of their size apart"),
            asked,
            1e-3,
            largest([most / (rho * high) - 1.0, 0.0]),
        ));
    }
    check("plates", &rows);
}

/// Nothing comes back to what nothing faces, nor to backs of single-sided faces.
#[test]
fn open_scenes() {
    let indirect = |scene: Scene| {
        let camera = look(DVec3::new(0.3, 0.2, 2.5), DVec3::ZERO, DVec3::Y, Projection::Perspective { yfov: 0.8 });
        let stage = Stage::new(scene, &camera, [32, 32]);
        let transfer = stage.transfer(&settings(200, 200, 64));
        let image = transfer.apply(&[transfer.emission()], &stage.lit(), Lobe::All, &|_| ()).remove(0);
        let gathered = gathered(&stage.scene, &stage.framebuffer, &Rig::default(), 4).concat();
        let gathered = gathered.iter().flatten().map(|&x| f64::from(x));
        largest(image.iter().flat_map(|p| p.to_array()).chain(gathered).map(f64::abs))
    };
    let mut one = Build::default();
    let grey = one.material(shining(ALBEDO));
    one.quad(DVec3::ZERO, DVec3::X, DVec3::Y, grey);
    let mut away = one.clone();
    away.quad(DVec3::NEG_Z, DVec3::Y, DVec3::X, grey);
    // A box without its front, inside out.
    let mut outside = Build::default();
    let grey = outside.material(lambert(Vec3::splat(ALBEDO)));
    outside.room(DVec3::ZERO, 0.5, grey);
    outside.quads.iter_mut().for_each(|(corners, _)| corners.reverse());
    let mut inverted = room();
    inverted.quads.remove(5);
    let mut inverted = inverted.scene();
    inverted.mesh.normals.iter_mut().for_each(|n| *n = -*n);
    let asked = "no indirect light";
    check(
        "open",
        &[
            Row::new("one square alone", asked, 0.0, indirect(one.scene())),
            Row::new("two single-sided squares, backs to each other", asked, 0.0, indirect(away.scene())),
            Row::new("an open box whose normals point away from its faces", asked, 0.0, indirect(inverted)),
            Row::new("a box seen from outside", asked, 0.0, indirect(outside.scene())),
        ],
    );
}
