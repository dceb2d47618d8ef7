//! Light that hardly ends, or gets more at each bounce.

use glam::{DVec3, Vec3};
use relume::bake::baselines::thesis::{Thesis, shade_thesis};
use relume::bake::transport::{LightTransport, direct};
use relume::reference::path_tracer::{Half, Layer, PathTracer};
use relume::scene::{Light, Material, Rig, Scene};
use relume::shared::ALBEDO_CAP;

use crate::common::drawn::tracing;
use crate::common::stage::{Build, ball, lambert};
use crate::even::{Stage, errors, gathered, settings, shining};
use crate::table::{Row, check, full};

const FEW_GO_FAR: &str = "some thousand photons answer for all bounces beyond the eighth; both halves may err alike";

fn room(material: Material) -> Scene {
    let mut build = Build::default();
    let material = build.material(material);
    build.room(DVec3::ZERO, 1.0, material).scene()
}

/// How many times the light of the first bounce all bounces together are, from what leaves all samples.
fn gain(transfer: &LightTransport, direct: &[DVec3]) -> f64 {
    let flux = |coefficients: &[DVec3]| -> f64 {
        let level = &transfer.fine;
        let of = |i: usize| coefficients[level.coefficients(i).start].x * f64::from(level.samples.samples[i].area);
        (0..level.samples.len()).map(of).sum()
    };
    flux(&transfer.bounce(direct).0) / flux(direct)
}

fn gain_of_thesis(thesis: &Thesis, direct: &[DVec3]) -> f64 {
    let flux = |radiance: &[DVec3]| -> f64 {
        thesis.samples.samples.iter().zip(radiance).map(|(s, r)| f64::from(s.area) * r.x).sum()
    };
    flux(&thesis.bounce(direct)) / flux(direct)
}

/// Each bounce leaves the share ρ: 1/(1-ρ) times the light of the first in all; and an even picture of even light.
#[test]
fn closed_rooms_at_any_albedo() {
    let mut rows = Vec::new();
    for albedo in [0.5, 0.9, 0.99, 0.999, 0.9999f32] {
        let want = 1.0 / (1.0 - f64::from(albedo));
        let grey = || lambert(Vec3::splat(albedo));
        // tests/transfer.rs has those of lower albedo, too.
        let lit =
            if full() || albedo > 0.9995 { vec![("box", room(grey())), ("ball", ball(12, grey()))] } else { vec![] };
        for (what, scene) in lit {
            let stage = Stage::inside(scene);
            let light = Light::point("l", DVec3::new(0.3, 0.4, -0.35)).pack(stage.scene.space);
            let transfer = stage.transfer(&settings(1024, 1024, 128));
            let ours = gain(&transfer, &direct::shade(&stage.scene, &transfer.fine, &light));
            let of_thesis = || {
                let thesis = stage.thesis(1024);
                (gain_of_thesis(&thesis, &shade_thesis(&stage.scene, &thesis, &light)) / want - 1.0).abs()
            };
            let case = format!("closed {what}, albedo {albedo}, a point light off its centre");
            let row = Row::new(case, "all light is 1/(1-ρ) times the first bounce's", 1e-3, (ours / want - 1.0).abs());
            rows.push(row.thesis(of_thesis));
        }
        for (what, scene) in [("box", room(shining(albedo))), ("ball", ball(12, shining(albedo)))] {
            let errors = errors(&Stage::inside(scene), albedo);
            let few = (albedo > 0.9995).then_some(FEW_GO_FAR);
            rows.extend(errors.rows(&format!("closed {what}, albedo {albedo}, shining evenly"), albedo, few));
        }
    }
    check("energy", &rows);
}

/// Nothing ends what is never absorbed: the answer is that of the cap, and the certificate says what that took away.
#[test]
fn white_rooms_have_no_answer_and_say_so() {
    let stage = Stage::inside(room(shining(1.0)));
    let transfer = stage.transfer(&settings(768, 768, 128));
    let certificate = &transfer.certificate;
    let cap = f64::from(ALBEDO_CAP);
    let gain = gain(&transfer, &transfer.emission());
    check(
        "white",
        &[
            Row::new("closed box, albedo 1", "as much light as at the cap", 1e-2, (gain * (1.0 - cap) - 1.0).abs()),
            Row::new(
                "closed box, albedo 1",
                "`capped` says what was taken away",
                1e-6,
                (certificate.capped - (1.0 - cap)).abs(),
            ),
            Row::new("closed box, albedo 1", "spectral radius below 1", 1.0 - 1e-6, certificate.spectral_radius),
        ],
    );
}

/// Near grazing glTF's BRDF gives more than it gets: all the same each bounce leaves less.
#[test]
fn furnaces() {
    let mut rows = Vec::new();
    for (what, metallic) in [("white dielectric", 0.0), ("white half metal", 0.5), ("white metal", 1.0)] {
        for roughness in if full() { vec![0.0, 1e-6, 0.1, 0.2, 0.5, 1.0] } else { vec![0.0, 0.2, 1.0] } {
            let material = Material { emissive: Vec3::ONE, metallic, roughness, ..Material::default() };
            let stage = Stage::inside(room(material));
            let transfer = stage.transfer(&settings(256, 256, 128));
            let case = format!("box of {what}, roughness {roughness}");
            let radius = transfer.certificate.spectral_radius;
            let note = format!("{:.2} % scaled away", 100.0 * transfer.certificate.capped);
            let row = Row::new(&case, "spectral radius below 1", 1.0 - 1e-6, radius).note(note);
            rows.push(row.thesis(|| stage.thesis(256).spectral_radius));
            let gathered = gathered(&stage.scene, &stage.framebuffer, &Rig::default(), 4).concat();
            let tracer = PathTracer::new(&stage.scene, &stage.framebuffer.camera, &Rig::default(), &tracing(32, 32));
            let traced = tracer.trace(1, &|| false, &|_| ()).layer(Half::Both, Layer::Emission);
            let most = 1.0 / (1.0 - f64::from(ALBEDO_CAP));
            for (asked, bound, image) in [
                ("gathered light, mean over pixels, not without bounds", 100.0 * most, gathered),
                ("path-traced light, mean over pixels, not without bounds", 100.0 * most, traced),
            ] {
                let mean = image.iter().map(|pixel| f64::from(pixel[0])).sum::<f64>() / image.len() as f64;
                rows.push(Row::new(&case, asked, bound, mean));
            }
        }
    }
    check("furnaces", &rows);
}
