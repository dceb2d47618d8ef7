//! Light adds up: doubled, summed, split into layers, cached or made anew, on any number of threads.

mod common;

use std::sync::OnceLock;

use common::random::Random;
use common::stage::{self, Setup, Stage, pixels};
use common::{Gpu, gpu, shipped};
use glam::{DVec3, Vec3};
use relume::relight::{Layers, Picture, Relighter};
use relume::scene::{Light, LightGroup, LightKind, Rig, Scene};

/// What sums of float32 images may differ by where they are summed in another order: a rounding for each of 10 sums.
const ORDER: f64 = 10.0 / 16_777_216.0;

fn setup() -> Setup {
    Setup::new(90, 60)
}

fn load(name: &str) -> Scene {
    Scene::load(&shipped(name)).expect("shipped scenes load")
}

/// Two lights, a matt and four mirror balls.
fn balls_2() -> &'static Stage {
    static STAGE: OnceLock<Stage> = OnceLock::new();
    STAGE.get_or_init(|| framebuffer("balls-2.glb"))
}

/// The same under 16 lights.
fn balls_16() -> &'static Stage {
    static STAGE: OnceLock<Stage> = OnceLock::new();
    STAGE.get_or_init(|| framebuffer("balls-16.glb"))
}

fn framebuffer(name: &str) -> Stage {
    let scene = load(name);
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    Stage::new(scene, &camera, &rig, &setup())
}

fn fresh(gpu: &Gpu, stage: &Stage, rig: &Rig) -> Vec<[f32; 3]> {
    whole(&mut stage.relighter(gpu, rig, &setup()))
}

fn whole(relighter: &mut Relighter) -> Vec<[f32; 3]> {
    relighter.linear(Picture::Whole).expect("frames run").to_vec()
}

#[track_caller]
fn assert_same(got: &[[f32; 3]], want: &[[f32; 3]], tolerance: f64, what: impl std::fmt::Display) {
    assert_eq!(got.len(), want.len());
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        for (got, want) in got.iter().zip(want) {
            let error = f64::from((got - want).abs());
            assert!(error <= tolerance * f64::from(*want), "{what}: pixel {i} has {got}, not {want}");
        }
    }
}

fn sum(pictures: &[Vec<[f32; 3]>]) -> Vec<[f32; 3]> {
    let pixel =
        |i: usize| pictures.iter().map(|p| DVec3::from(p[i].map(f64::from))).sum::<DVec3>().as_vec3().to_array();
    (0..pictures[0].len()).map(pixel).collect()
}

#[test]
fn doubled_light_doubles_the_picture() {
    let gpu = gpu();
    let stage = balls_2();
    let mut rig = stage.scene.rig.clone();
    let once = fresh(&gpu, stage, &rig);
    assert!(once.iter().filter(|p| p[0] > 0.0).count() > once.len() / 2, "most of the picture is lit");
    let doubled: Vec<[f32; 3]> = once.iter().map(|p| p.map(|x| 2.0 * x)).collect();
    rig.lights.iter_mut().for_each(|light| light.intensity *= 2.0);
    // To the bit: a power of two.
    assert_eq!(fresh(&gpu, stage, &rig), doubled, "intensity");
    rig.lights.iter_mut().for_each(|light| (light.intensity, light.stops) = (light.intensity / 2.0, light.stops + 1.0));
    assert_eq!(fresh(&gpu, stage, &rig), doubled, "stops");
    rig.lights.iter_mut().for_each(|light| (light.color, light.stops) = (light.color * 2.0, light.stops - 1.0));
    assert_eq!(fresh(&gpu, stage, &rig), doubled, "colour");
}

#[test]
fn lights_and_emission_add_up() {
    let gpu = gpu();
    for name in ["balls-2.glb", "balls-16.glb"] {
        let mut scene = load(name);
        // A ball that glows, seen straight and in the mirrors.
        scene.materials[1].emissive = Vec3::new(0.3, 0.2, 0.1);
        let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
        let stage = Stage::new(scene, &camera, &rig, &setup());
        let mut relighter = stage.relighter(&gpu, &rig, &setup());
        let together = whole(&mut relighter);
        let parts = (0..rig.lights.len()).map(Picture::Light).chain([Picture::Emission]);
        let parts: Vec<Vec<[f32; 3]>> = parts.map(|p| relighter.linear(p).expect("frames run").to_vec()).collect();
        for (i, part) in parts.iter().enumerate() {
            assert!(part.iter().any(|p| p[0] > 0.0), "{name}: part {i} lights something");
        }
        assert_same(&together, &sum(&parts), ORDER, name);
    }
}

#[test]
fn direct_and_reflection_are_the_whole() {
    let gpu = gpu();
    for samples in [1, 4] {
        let scene = load("balls-2.glb");
        let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
        let setup = Setup { samples, ..setup() };
        let stage = Stage::new(scene, &camera, &rig, &setup);
        let mut relighter = stage.relighter(&gpu, &rig, &setup);
        let [direct, reflection, all] =
            [Layers::Direct, Layers::Reflection, Layers::All].map(|layers| pixels(&mut relighter, layers));
        assert!(reflection.iter().filter(|p| p[0] > 0.0).count() > 200, "mirrors show something");
        assert_same(&sum(&[direct, reflection]), &all, ORDER, format!("{samples} samples"));
    }
}

/// One random change of a rig, of every kind that a lighting desk makes.
fn edit(random: &mut Random, rig: &mut Rig, next_name: &mut usize) -> String {
    let count = rig.lights.len();
    let which = random.below(count.max(1));
    let some = |light: &mut Light, random: &mut Random| match random.below(9) {
        0 => light.position += random.vector(-0.5, 0.5),
        1 => light.intensity = random.magnitude(1.0, 100.0),
        2 => light.color = random.color(),
        3 => light.enabled ^= true,
        4 => light.stops = random.between(-2.0, 2.0),
        5 => light.direction = (light.direction + 0.3 * random.direction()).normalize(),
        6 => light.kind = random.pick(&[LightKind::Point, LightKind::Spot, LightKind::Directional]),
        7 => light.solo ^= true,
        _ => light.shadows ^= true,
    };
    match random.below(12) {
        0 if count < 24 => {
            *next_name += 1;
            let position = DVec3::new(0.0, 3.0, 0.0) + random.vector(-2.0, 2.0);
            rig.lights.push(Light { intensity: 10.0, ..Light::point(&format!("new{next_name}"), position) });
            "a light comes".into()
        }
        1 if count > 3 => {
            rig.lights.remove(which);
            format!("light {which} goes")
        }
        2 => {
            let group = random.below(rig.groups.len());
            rig.groups[group].enabled ^= true;
            format!("group {group} is switched")
        }
        3 => {
            let group = random.below(rig.groups.len());
            rig.groups[group].stops = random.between(-1.0, 1.0);
            format!("group {group} gets other stops")
        }
        4 if count > 0 => {
            rig.lights[which].group = random.pick(&[None, Some(0), Some(1)]);
            format!("light {which} changes its group")
        }
        5 if count > 0 => {
            let several = 1 + random.below(count);
            (0..several).for_each(|i| some(&mut rig.lights[(which + i) % count], random));
            format!("{several} lights from {which} change")
        }
        _ if count > 0 => {
            some(&mut rig.lights[which], random);
            format!("light {which} changes")
        }
        _ => "nothing".into(),
    }
}

/// Whatever was edited, the picture is that of a new relighter, in plenty of memory and in next to none.
fn edits_leave_no_trace(budget_bytes: Option<u64>, edits: usize, seed: u64) {
    let gpu = gpu();
    let stage = balls_16();
    let mut random = Random::new(seed);
    let mut rig = stage.scene.rig.clone();
    let group = |name: &str| LightGroup::new(name);
    rig.groups = vec![group("a"), group("b")];
    let setup = Setup { budget_bytes, ..setup() };
    let mut relighter = stage.relighter(&gpu, &rig, &setup);
    let mut names = 0;
    let mut trail = Vec::new();
    let (mut layers, mut compared) = (Layers::All, 0);
    for i in 0..edits {
        trail.push(edit(&mut random, &mut rig, &mut names));
        relighter.set_rig(&rig).unwrap();
        // Several edits a picture, as a busy machine sees them; lights alone and other layers in between.
        match random.below(4) {
            0 => continue,
            1 if !rig.lights.is_empty() => {
                let from = random.below(rig.lights.len());
                let lights: Vec<usize> = (from..rig.lights.len().min(from + 5)).collect();
                relighter.select(&lights);
            }
            2 if !rig.lights.is_empty() => {
                let light = random.below(rig.lights.len());
                relighter.linear(Picture::Light(light)).expect("frames run");
            }
            _ => {}
        }
        if random.below(40) == 0 {
            layers = random.pick(&[Layers::All, Layers::Direct, Layers::Reflection]);
        }
        let got = pixels(&mut relighter, layers);
        if random.below(10) == 0 {
            compared += 1;
            let want = pixels(&mut stage.relighter(&gpu, &rig, &setup), layers);
            // 24 lights are summed in some order of at most 24 + 5 steps.
            assert_same(&got, &want, 3.0 * ORDER, format!("edit {i}: {:?}", &trail[i.saturating_sub(5)..]));
        }
    }
    assert!(compared > edits / 20, "{compared} of {edits} pictures compared");
}

#[test]
fn cached_equals_made_anew() {
    edits_leave_no_trace(None, 500, 1);
}

#[test]
fn cached_equals_made_anew_in_little_memory() {
    edits_leave_no_trace(Some(1), 500, 2);
}

#[test]
fn colour_edits_shade_nothing() {
    let gpu = gpu();
    let stage = balls_16();
    let mut rig = stage.scene.rig.clone();
    let mut relighter = stage.relighter(&gpu, &rig, &setup());
    let passes = |relighter: &Relighter| relighter.times().iter().map(|t| t.name).collect::<Vec<_>>();
    whole(&mut relighter);
    let shaded = passes(&relighter).iter().filter(|&&name| name == "shade light").count();
    assert_eq!(shaded, 16, "each light once: {:?}", passes(&relighter));
    for (light, color) in [(3, Vec3::X), (3, Vec3::ONE), (9, Vec3::Y), (9, Vec3::ZERO), (9, Vec3::Z)] {
        rig.lights[light].color = color;
        rig.lights[light].enabled = color != Vec3::ONE;
        rig.lights[light].intensity += 1.0;
        relighter.set_rig(&rig).unwrap();
        whole(&mut relighter);
        let passes = passes(&relighter);
        let idle = !passes.iter().any(|name| ["shade light", "trace shadows", "resolve"].contains(name));
        assert!(idle, "light {light} became {color}: {passes:?}");
    }
    // The same light again: nothing is summed either.
    rig.lights[9].color = Vec3::ONE;
    relighter.set_rig(&rig).unwrap();
    whole(&mut relighter);
    assert_eq!(passes(&relighter), ["composite"]);
    // A moved light is shaded, alone.
    rig.lights[9].position += DVec3::X;
    relighter.set_rig(&rig).unwrap();
    whole(&mut relighter);
    let shaded = passes(&relighter).iter().filter(|&&name| name == "shade light").count();
    assert_eq!(shaded, 1, "{:?}", passes(&relighter));
}

/// A relighter that began with few lights, or none, shows as many as come, in plenty of memory and in none.
#[test]
fn lights_may_come_after_the_start() {
    let gpu = gpu();
    let stage = balls_16();
    let all = &stage.scene.rig;
    for budget_bytes in [None, Some(1)] {
        let setup = Setup { budget_bytes, ..setup() };
        for first in [0, 1, 2] {
            let few = Rig { lights: all.lights[..first].to_vec(), ..all.clone() };
            let mut relighter = stage.relighter(&gpu, &few, &setup);
            whole(&mut relighter);
            relighter.set_rig(all).unwrap();
            let got = whole(&mut relighter);
            let want = whole(&mut stage.relighter(&gpu, all, &setup));
            assert_eq!(got, want, "{first} lights at first, budget {budget_bytes:?}");
        }
    }
}

/// Bake and picture, from file to pixels, as bytes.
fn bytes(gpu: &Gpu, threads: usize) -> (Vec<u8>, Vec<u8>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
    pool.install(|| {
        let scene = load("balls-2.glb");
        let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
        let setup = Setup { samples: 4, ..setup() };
        let stage = Stage::new(scene, &camera, &rig, &setup);
        let framebuffer = &stage.framebuffer;
        let mut data = bytemuck::cast_slice::<_, u8>(&framebuffer.samples).to_vec();
        data.extend_from_slice(bytemuck::cast_slice(&framebuffer.brdfs));
        data.extend_from_slice(bytemuck::cast_slice(&framebuffer.extra_samples));
        data.extend_from_slice(bytemuck::cast_slice(&framebuffer.extra_indices));
        data.extend_from_slice(bytemuck::cast_slice(&framebuffer.extra_pixels));
        let picture = stage::pixels(&mut stage.relighter(gpu, &rig, &setup), Layers::All);
        (data, bytemuck::cast_slice(&picture).to_vec())
    })
}

#[test]
fn same_bytes_whatever_the_threads() {
    let gpu = gpu();
    let one = bytes(&gpu, 1);
    for threads in [1, 2, 3] {
        let again = bytes(&gpu, threads);
        assert!(again.0 == one.0, "the bake differs on {threads} threads");
        assert!(again.1 == one.1, "the picture differs on {threads} threads");
    }
}
