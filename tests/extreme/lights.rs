//! Lights of any brightness, where no light should be, and none or many of them.

use std::cell::LazyCell;
use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DQuat, DVec3, Vec3};
use relume::bake::DeepFramebuffer;
use relume::bake::baselines::thesis::shade_thesis;
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transfer::sky::SkyTransfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, direct};
use relume::final_gather::{FinalGather, Refined};
use relume::relight::{Layers, Picture, Relighter, Request};
use relume::scene::{Camera, Light, LightKind, Projection, Rig, Scene};
use relume::shared::PackedLight;
use relume::storage::journal::Journal;
use relume::trace::bvh::TracedScene;

use crate::common::stage::{self, Build, Setup, lambert, look, rig};
use crate::common::{Gpu, gpu, largest};
use crate::even::{self, compressed, settings};
use crate::place::relative;
use crate::table::{Row, check, full};

/// A baked scene with compressed indirect light.
pub struct Relit {
    stage: stage::Stage,
    setup: Setup,
}

impl Relit {
    pub fn new(scene: Scene, camera: &Camera, rig: &Rig, setup: &Setup) -> Self {
        Self::with(scene, camera, rig, setup, 768)
    }

    pub fn with(scene: Scene, camera: &Camera, rig: &Rig, setup: &Setup, samples: usize) -> Self {
        let mut stage = stage::Stage::new(scene, camera, rig, setup);
        let settings = settings(samples, samples.div_ceil(4), 128);
        let transport = LightTransport::new(&stage.scene, &stage.framebuffer, &settings, &|_| ());
        let of_sky = CompressionSettings { error: 0.02, lights: 192, lobe: Lobe::All, seed: 1 };
        let sky = || SkyTransfer::new(&transport, &of_sky, &mut Journal::default(), &|_| ()).unwrap();
        let has_dome = rig.lights.iter().any(|light| light.kind == LightKind::Dome);
        let transfer = Transfer { sky: has_dome.then(sky), ..compressed(&transport, 0.01) };
        assert!(transfer.is_consistent(stage.framebuffer.samples.len()));
        stage.transfer = Some(Arc::new(transfer));
        Self { stage, setup: setup.clone() }
    }

    /// What has been baked, to spoil it.
    pub fn baked(&mut self) -> (&mut DeepFramebuffer, &mut Transfer) {
        let transfer = self.stage.transfer.as_mut().expect("it was baked");
        (Arc::make_mut(&mut self.stage.framebuffer), Arc::make_mut(transfer))
    }

    pub fn scene(&self) -> &TracedScene {
        &self.stage.scene
    }

    pub fn relighter(&self, gpu: &Gpu, rig: &Rig) -> Relighter {
        self.stage.relighter(gpu, rig, &self.setup)
    }

    /// What final gathering finds of each light; see [`even::gathered`].
    pub fn gathered(&self, rig: &Rig, passes: u32) -> Vec<Vec<[f32; 3]>> {
        even::gathered(&self.stage.scene, &self.stage.framebuffer, rig, passes)
    }

    /// Indirect light, refined by final gathering.
    pub fn refined(&self, gpu: &Gpu, rig: &Rig) -> Vec<DVec3> {
        let mut gather = FinalGather::new(&self.stage.scene, &self.stage.framebuffer, rig, |_| true, 1, 0);
        (0..4).for_each(|_| gather.pass(&|| false));
        let lights: Vec<usize> = gather.lights().collect();
        let mut relighter = self.relighter(gpu, rig);
        let operator: Vec<Vec<Vec3>> = lights.iter().map(|&light| relighter.indirect(light).unwrap()).collect();
        let estimates: Vec<_> = (0..lights.len()).map(|source| gather.estimate(source)).collect();
        let of_light = |i: usize| (rig.scale(lights[i]), &operator[i][..], &estimates[i]);
        let of_lights: Vec<_> = (0..lights.len()).map(of_light).collect();
        let refined = Refined::new(self.setup.width as usize, &of_lights);
        assert!(refined.error().is_finite() && refined.error() > 0.0, "{}", refined.error());
        let mut sum = vec![DVec3::ZERO; operator[0].len()];
        for ((scale, operator, _), change) in of_lights.iter().zip(&refined.changes) {
            let pixels = operator.iter().zip(change).map(|(a, b)| scale.as_dvec3() * (*a + *b).as_dvec3());
            sum.iter_mut().zip(pixels).for_each(|(sum, pixel)| *sum += pixel);
        }
        sum
    }

    /// What each pass leaves that is not finite.
    pub fn non_finite(&self, gpu: &Gpu, rig: &Rig) -> Vec<(&'static str, u32)> {
        let mut relighter = self.relighter(gpu, rig);
        relighter.check_finite().unwrap();
        relighter.linear(Picture::Whole).unwrap();
        relighter.non_finite()
    }

    /// First-hand light of all lights, with room for few of their images.
    pub fn first_hand(&self, gpu: &Gpu, rig: &Rig) -> Vec<[f32; 3]> {
        let setup = Setup { budget_bytes: Some(1 << 26), ..self.setup.clone() };
        stage::pixels(&mut self.stage.relighter(gpu, rig, &setup), Layers::FirstHand)
    }

    /// First-hand and indirect light of all lights.
    pub fn pictures(&self, gpu: &Gpu, rig: &Rig) -> [Vec<[f32; 3]>; 2] {
        let mut relighter = self.relighter(gpu, rig);
        [Layers::FirstHand, Layers::Indirect].map(|layers| stage::pixels(&mut relighter, layers))
    }

    /// The same of each light alone.
    pub fn by_light(&self, gpu: &Gpu, lights: &[Light]) -> Vec<[Vec<[f32; 3]>; 2]> {
        let mut relighter = self.relighter(gpu, &rig(lights.to_vec()));
        let mut of = |layers: Layers| -> Vec<Vec<[f32; 3]>> {
            let of = |i| Request { layers, ..Picture::Light(i).into() };
            (0..lights.len()).map(|i| relighter.linear(of(i)).unwrap().to_vec()).collect()
        };
        let (first, indirect) = (of(Layers::FirstHand), of(Layers::Indirect));
        first.into_iter().zip(indirect).map(|(first, indirect)| [first, indirect]).collect()
    }
}

/// How much of a picture is negative; not a number, or infinite, where a value is.
pub fn negative(pixels: &[[f32; 3]]) -> f64 {
    let sum = |sign: f64| -> f64 { pixels.iter().flatten().map(|&x| (sign * f64::from(x)).max(0.0)).sum() };
    let broken = pixels.iter().flatten().any(|x| !x.is_finite());
    if broken { f64::NAN } else { sum(-1.0) / sum(1.0).max(f64::MIN_POSITIVE) }
}

/// The value farthest from black; not a number if one of them is not.
pub fn farthest_from_black(pixels: &[[f32; 3]]) -> f64 {
    largest(pixels.iter().flatten().map(|&x| f64::from(x).abs()))
}

pub fn over(pixels: &[[f32; 3]], scale: f64) -> Vec<DVec3> {
    pixels.iter().map(|p| Vec3::from(*p).as_dvec3() / scale).collect()
}

const ALBEDO: f32 = 0.5;

/// A room with a closed box in its middle, and who looks at both.
fn room() -> (Scene, Camera) {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(ALBEDO)));
    let mut inner = build.clone();
    inner.room(DVec3::new(0.1, -0.3, 0.0), 0.25, grey);
    build.room(DVec3::ZERO, 1.0, grey);
    for (mut corners, material) in inner.quads {
        corners.reverse();
        build.quads.push((corners, material));
    }
    let camera =
        look(DVec3::new(0.8, 0.7, 0.9), DVec3::new(0.0, -0.3, 0.0), DVec3::Y, Projection::Perspective { yfov: 1.3 });
    (build.scene(), camera)
}

#[test]
fn brightness_and_number() {
    let gpu = gpu();
    let (scene, camera) = room();
    let at = DVec3::new(-0.4, 0.5, 0.3);
    let plain = Light::point("plain", at);
    let setup = Setup::new(64, 48);
    let relit = Relit::new(scene, &camera, &rig(vec![plain.clone()]), &setup);
    let [direct, indirect] = relit.pictures(&gpu, &rig(vec![plain.clone()])).map(|image| over(&image, 1.0));
    let refined = |lights: &[Light]| relit.refined(&gpu, &rig(lights.to_vec()));
    let plain_refined = refined(std::slice::from_ref(&plain));
    let mut rows = Vec::new();
    for candelas in [1e-20, 1e20] {
        let light = Light { intensity: candelas, ..plain.clone() };
        let of_unit: Vec<DVec3> = refined(std::slice::from_ref(&light)).iter().map(|p| *p / candelas).collect();
        rows.push(Row::new(
            format!("a light of {candelas:.0e} cd"),
            "refined indirect light of 1 cd, so many times",
            1e-5,
            relative(&of_unit, &plain_refined),
        ));
        let pictures = relit.pictures(&gpu, &rig(vec![light]));
        for (what, got, want) in [("first-hand", &pictures[0], &direct), ("indirect", &pictures[1], &indirect)] {
            let asked = format!("{what} light of 1 cd, so many times");
            rows.push(Row::new(
                format!("a light of {candelas:.0e} cd"),
                asked,
                1e-5,
                relative(&over(got, candelas), want),
            ));
        }
    }
    let both = [1e-20, 1e20].map(|candelas| Light { intensity: candelas, ..plain.clone() });
    let [first, _] = relit.pictures(&gpu, &rig(both.to_vec()));
    let asked = "as the brighter one alone";
    rows.push(Row::new("lights of 1e-20 and 1e20 cd", asked, 1e-5, relative(&over(&first, 1e20), &direct)));

    let both: Vec<DVec3> = refined(&both).iter().map(|p| *p / 1e20).collect();
    let asked = "refined indirect light, as of the brighter one alone";
    rows.push(Row::new("lights of 1e-20 and 1e20 cd", asked, 0.05, relative(&both, &plain_refined)));

    let black = relit.pictures(&gpu, &rig(Vec::new()));
    let most = farthest_from_black(&black.concat());
    rows.push(Row::new("no light", "black", 0.0, most));
    for count in if full() { vec![1000, 100_000] } else { vec![1000] } {
        let lights = (0..count).map(|i| Light { name: format!("{i}"), ..plain.clone() }).collect();
        let first = relit.first_hand(&gpu, &rig(lights));
        let asked = "as one of as many candelas";
        let case = format!("{count} lights in one place, 64x48");
        rows.push(Row::new(case, asked, 1e-4, relative(&over(&first, f64::from(count)), &direct)));
    }
    check("brightness", &rows);
}

/// Where light must not get out, or hardly in.
#[test]
fn places() {
    let gpu = gpu();
    let (scene, camera) = room();
    let floor = DVec3::new(-0.4, -1.0, 0.3);
    let places = [
        ("on a wall", floor),
        ("1e-6 m off a wall", floor + 1e-6 * DVec3::Y),
        ("in a corner, on three walls", DVec3::splat(-1.0)),
        ("on a wall, 1e20 cd", floor),
        ("inside a closed object", DVec3::new(0.1, -0.3, 0.0)),
        ("behind everything", DVec3::new(0.0, 5.0, 0.0)),
        ("1e-6 m behind a wall", floor - 1e-6 * DVec3::Y),
    ];
    let light = |(name, at): &(&str, DVec3)| Light {
        intensity: if name.contains("1e20") { 1e20 } else { 1.0 },
        ..Light::point(name, *at)
    };
    let lights: Vec<Light> = places.iter().map(light).collect();
    let relit = Relit::new(scene, &camera, &rig(lights.clone()), &Setup::new(64, 48));
    let gathered = relit.gathered(&rig(lights.clone()), 4);
    let mut rows = Vec::new();
    for (i, pictures) in relit.by_light(&gpu, &lights).into_iter().enumerate() {
        let case = format!("a light {}", places[i].0);
        let pictures = [&pictures[0][..], &pictures[1], &gathered[i]];
        match i {
            0..4 => {
                let most = largest(pictures.map(negative));
                rows.push(Row::new(case, "finite, hardly any of it below 0", 1e-4, most));
            }
            _ => {
                let most = largest(pictures.map(farthest_from_black));
                rows.push(Row::new(case, "black", 0.0, most));
            }
        }
    }
    check("places of lights", &rows);
}

/// Where light falls on few points, but not all of it on so few that rays answer for it.
const FEW: &str =
    "rays answer for its middle, some hundred points of gather samples for the rest, which are that far off";
/// Lights that a row is the mean of.
const TURNS: u32 = 64;

/// Light of a candela in a closed room meets a wall, all of it, wherever the light stands.
#[test]
fn all_light_is_caught() {
    let mut build = Build::default();
    let grey = build.material(lambert(Vec3::splat(ALBEDO)));
    build.room(DVec3::ZERO, 1.0, grey);
    let stage = even::Stage::inside(build.scene());
    let transfer = stage.transfer(&settings(1536, 1536, 16));
    let thesis = LazyCell::new(|| stage.thesis(1536));
    let level = &transfer.fine;
    let ours = |light: &PackedLight| -> f64 {
        let shaded = direct::shade(&stage.scene, level, light);
        let of = |i: usize| shaded[level.coefficients(i).start].x * f64::from(level.samples.samples[i].area);
        (0..level.samples.len()).map(of).sum::<f64>() * PI.sqrt()
    };
    let theirs = |light: &PackedLight| -> f64 {
        let shaded = shade_thesis(&stage.scene, &thesis, light);
        thesis.samples.samples.iter().zip(&shaded).map(|(s, r)| f64::from(s.area) * r.x * PI).sum()
    };
    // Of lights turned about the room's axis, so that no single one's luck counts: root mean square.
    let error = |caught: &dyn Fn(&PackedLight) -> f64, turned: &dyn Fn(DQuat) -> Light, power: f64| {
        let square = stage.scene.space.unit.powi(2) / f64::from(ALBEDO);
        let turns = (0..TURNS).map(|i| DQuat::from_rotation_y(2.0 * PI * f64::from(i) / f64::from(TURNS)));
        let off = turns.map(|turn| square * caught(&turned(turn).pack(stage.scene.space)) / power - 1.0);
        (off.map(|off| off * off).sum::<f64>() / f64::from(TURNS)).sqrt()
    };
    let mut rows = Vec::new();
    for distance in [1.0, 0.1, 1e-2, 1e-3, 1e-6] {
        let light = |turn| Light::point("l", turn * DVec3::new(-0.4, -1.0 + distance, 0.3));
        let case = format!("a light {distance} m off a wall");
        let row = Row::new(case, "all of its light is caught", 5e-3, error(&ours, &light, 4.0 * PI));
        let row = row.thesis(|| error(&theirs, &light, 4.0 * PI));
        rows.push(if distance == 0.1 { row.short(FEW) } else { row });
    }
    for (inner, outer) in [(0.0, 0.01), (0.0, 1.0), (0.0, 10.0), (30.0, 30.0), (0.0, 89.99), (89.99, 89.99)] {
        let spot = Light {
            kind: LightKind::Spot,
            direction: DVec3::new(0.3, -1.0, 0.2).normalize(),
            inner_angle: f64::to_radians(inner),
            outer_angle: f64::to_radians(outer),
            ..Light::point("s", DVec3::new(0.3, 0.4, -0.35))
        };
        let turned = |turn| Light { direction: turn * spot.direction, ..spot.clone() };
        let case = format!("a spot of {inner} to {outer} degrees");
        let row = Row::new(case, "all of its light is caught", 5e-3, error(&ours, &turned, power(&spot)));
        let row = row.thesis(|| error(&theirs, &turned, power(&spot)));
        rows.push(if outer == 10.0 { row.short(FEW) } else { row });
    }
    check("light that is caught", &rows);
}

/// Power of a spot of one candela [KHR_lights_punctual].
fn power(light: &Light) -> f64 {
    let versine = |angle: f64| 2.0 * (0.5 * angle).sin().powi(2);
    let (inner, outer) = (versine(light.inner_angle), versine(light.outer_angle));
    let scale = 1.0 / (outer - inner).max(0.001);
    let steps = 100_000;
    let at = |i: usize| outer * (i as f64 + 0.5) / f64::from(steps);
    let sum: f64 = (0..steps as usize).map(|i| ((outer - at(i)) * scale).clamp(0.0, 1.0).powi(2)).sum();
    2.0 * PI * outer * sum / f64::from(steps)
}
