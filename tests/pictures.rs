//! Pictures against the truth: another renderer's (shared/reference), and our own small ones, which must not change
//! unseen (tests/goldens; `BLESS=1` makes them anew).

mod common;

use std::path::Path;

use common::pictures::leave;
use common::stage::{Setup, Stage, pixels};
use common::{Gpu, gpu, not_run, shared, shipped};
use glam::DVec3;
use rayon::prelude::*;
use relume::image::compare::{Figures, Pictures, Settings};
use relume::image::{Image, exr};
use relume::relight::{Layers, RelightSettings, VisibilityMethod};
use relume::scene::{Light, LightKind, Scene};
use relume::session::{Form, IndirectSettings};
use relume::trace::packet::{PACKET_SIZE, SamplePacket, trace_packets};
use relume::{Session, SessionSettings};

/// Share of the pixels that may differ at will, on seams and edges: two tracers decide those differently.
const TRIM: f64 = 1e-3;

/// What a picture may be off by: relative RMSE without and with the worst pixels.
struct Floor {
    trimmed: f64,
    whole: f64,
}

fn bake_scene(path: &Path, setup: &Setup) -> Stage {
    let scene = Scene::load(path).expect("the scene loads");
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    Stage::new(scene, &camera, &rig, setup)
}

fn relit(gpu: &Gpu, stage: &Stage, setup: &Setup, layers: Layers) -> Vec<[f32; 3]> {
    pixels(&mut stage.relighter(gpu, &stage.scene.rig, setup), layers)
}

fn read(path: &Path) -> Image {
    exr::read(path).expect("the reference is readable")
}

fn compare(got: Vec<[f32; 3]>, want: Image) -> Pictures {
    assert_eq!(got.len(), want.width * want.height, "pixels of {}x{}", want.width, want.height);
    let Image { width, height, mut layers, .. } = want;
    Pictures { width, height, image: got, reference: layers.remove(0).pixels, second: None, mask: None }
}

/// What of a figure or a floor is wrong.
fn check(figures: &Figures, floor: &Floor, name: &str) -> Result<(), String> {
    let (trimmed, whole) = (figures.trimmed.unwrap_or(f64::NAN), figures.rel_rmse.unwrap_or(f64::NAN));
    println!(
        "{name}: {whole:.2e}, {trimmed:.2e} without the worst {TRIM}; bias {:+.1e}",
        figures.bias.unwrap_or(f64::NAN)
    );
    // Written so that NaN fails.
    if figures.non_finite == 0 && trimmed <= floor.trimmed && whole <= floor.whole {
        return Ok(());
    }
    Err(format!(
        "{name}: {whole:.2e} (at most {}), trimmed {trimmed:.2e} (at most {}), {} not finite",
        floor.whole, floor.trimmed, figures.non_finite
    ))
}

/// Pixels with neighbours of another surface, normal or visibility, row by row: those that would get more samples. And
/// those in which a coarse mesh would shadow itself if rays started on its triangles, as the references' do.
fn edges(path: &Path, setup: &Setup) -> Vec<bool> {
    let stage = bake_scene(path, &Setup { samples: 2, ..setup.clone() });
    let mut edges = vec![false; (setup.width * setup.height) as usize];
    let mut mark = |pixel: usize| {
        let (x, y) = stage.framebuffer.tiling.pixel(pixel);
        if stage.framebuffer.tiling.contains((x, y)) {
            edges[(y * setup.width + x) as usize] = true;
        }
    };
    stage.framebuffer.extra_pixels.iter().filter(|p| p.first_weight < 1.0).for_each(|p| mark(p.pixel as usize));
    let lifted = &stage.framebuffer.packets;
    let flat: Vec<SamplePacket> = (lifted.iter().zip(stage.framebuffer.samples.chunks(PACKET_SIZE)))
        .map(|(packet, samples)| {
            let mut packet = packet.clone();
            for (lane, sample) in samples.iter().enumerate() {
                (0..3).for_each(|axis| packet.position[axis][lane] = sample.position[axis]);
            }
            packet
        })
        .collect();
    for light in stage.scene.rig.lights.iter().map(|light| light.pack(stage.scene.space)) {
        let [lifted, flat] = [lifted, &flat].map(|packets| {
            let mut visibility = vec![0u8; packets.len() * PACKET_SIZE];
            trace_packets(&*stage.scene, &light, packets, &mut visibility);
            visibility
        });
        (0..stage.framebuffer.pixel_stride()).filter(|&i| lifted[i] != flat[i]).for_each(&mut mark);
    }
    edges
}

/// Whether the reference changes by more than a tenth of its mean from a pixel to any of its neighbours.
fn changes(pictures: &Pictures, x: usize, y: usize, mean: f64) -> bool {
    let at = |x: usize, y: usize| DVec3::from(pictures.reference[y * pictures.width + x].map(f64::from));
    let (xs, ys) = (x.saturating_sub(1)..pictures.width.min(x + 2), y.saturating_sub(1)..pictures.height.min(y + 2));
    ys.flat_map(|y| xs.clone().map(move |x| (x, y)))
        .any(|(i, j)| (at(i, j) - at(x, y)).abs().max_element() > 0.1 * mean)
}

/// The worst pixels, those that `trimmed` leaves out, lie on seams and edges wherever they are off by more than `floor`
/// of the mean.
fn check_worst(pictures: &Pictures, edges: &[bool], floor: f64, name: &str) -> Result<(), String> {
    let mean = pictures.reference.iter().flatten().map(|&x| f64::from(x)).sum::<f64>() / (3 * edges.len()) as f64;
    let error = |i: usize| {
        let [x, r] = [pictures.image[i], pictures.reference[i]].map(|p| DVec3::from(p.map(f64::from)));
        (x - r).length() / mean
    };
    let mut worst: Vec<usize> = (0..edges.len()).collect();
    worst.sort_by(|&a, &b| error(b).total_cmp(&error(a)));
    worst.truncate((TRIM * edges.len() as f64).round() as usize);
    let wrong: Vec<String> = worst
        .into_iter()
        .map(|i| (i, i % pictures.width, i / pictures.width))
        .filter(|&(i, x, y)| error(i) > floor && !edges[i] && !changes(pictures, x, y, mean))
        .map(|(i, x, y)| format!("({x}, {y}): {:?}, not {:?}", pictures.image[i], pictures.reference[i]))
        .collect();
    match wrong.first() {
        None => Ok(()),
        Some(first) => Err(format!("{name}: {} of the worst pixels are on no edge, first {first}", wrong.len())),
    }
}

/// One scene against its reference images at one sample a pixel.
fn against_truth(name: &str, references: &[(&str, Layers)]) {
    let Some(path) = shared(&format!("scenes/{name}.glb")) else { return };
    let gpu = gpu();
    let size = Scene::load(&path).expect("the scene loads").image_size.expect("it says its size");
    let full = Setup::new(size[0], size[1]);
    let stage = bake_scene(&path, &full);
    let mut wrong = Vec::new();
    let mut edge_pixels = None;
    for &(image, layers) in references {
        let Some(reference) = shared(&format!("reference/{name}.centre.{image}.exr")) else { continue };
        let is_direct = layers == Layers::Direct;
        for (visibility, floor) in [
            (VisibilityMethod::Traced, Floor { trimmed: if is_direct { 0.002 } else { 0.005 }, whole: 0.03 }),
            // Shadow edges of maps are soft: nothing is asked of the worst pixels.
            (VisibilityMethod::Map, Floor { trimmed: 0.02, whole: f64::INFINITY }),
        ] {
            let setup = Setup { visibility, ..full.clone() };
            let name = format!("{name}.{image}.{visibility:?}");
            let pictures = compare(relit(&gpu, &stage, &setup, layers), read(&reference));
            let figures = pictures.figures(Settings { block: 1, trim: TRIM });
            let mut failures: Vec<String> = check(&figures, &floor, &name).err().into_iter().collect();
            if visibility == VisibilityMethod::Traced {
                let edges = edge_pixels.get_or_insert_with(|| edges(&path, &full));
                failures.extend(check_worst(&pictures, edges, floor.trimmed, &name).err());
            }
            if !failures.is_empty() {
                wrong.push(format!("{}\n  {}", failures.join("\n"), leave(&pictures, &name)));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

const DIRECT: (&str, Layers) = ("direct", Layers::Direct);
const WHITTED: (&str, Layers) = ("whitted5", Layers::All);

#[test]
fn cornell_glossy() {
    against_truth("cornell-glossy", &[DIRECT]);
}

#[test]
fn cornell_diffuse() {
    against_truth("cornell-diffuse", &[DIRECT]);
}

#[test]
fn balls_2() {
    against_truth("balls-2", &[DIRECT, WHITTED]);
}

#[test]
fn balls_16() {
    against_truth("balls-16", &[WHITTED]);
}

#[test]
fn bunny_dragon_2() {
    against_truth("bunny-dragon-2", &[DIRECT, WHITTED]);
}

/// 16 samples on edges against a box filter of many, whose noise is 0.9 % of the mean.
#[test]
fn edges_are_anti_aliased() {
    let gpu = gpu();
    let mut wrong = Vec::new();
    for name in ["balls-2", "bunny-dragon-2"] {
        let Some(path) = shared(&format!("scenes/{name}.glb")) else { continue };
        let Some(reference) = shared(&format!("reference/{name}.box.whitted5.exr")) else { continue };
        let reference = read(&reference);
        let setup = Setup { samples: 16, ..Setup::new(reference.width as u32, reference.height as u32) };
        let pictures = compare(relit(&gpu, &bake_scene(&path, &setup), &setup, Layers::All), reference);
        let name = format!("{name}.box.whitted5.16-samples");
        let figures = pictures.figures(Settings { block: 1, trim: TRIM });
        if let Err(failure) = check(&figures, &Floor { trimmed: 0.03, whole: 0.03 }, &name) {
            wrong.push(format!("{failure}\n  {}", leave(&pictures, &name)));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Packets and single rays with the same end points, over all samples: they agree but for rays that graze an edge.
#[test]
fn packets_see_what_single_rays_see() {
    for (name, path) in
        [("balls-2", Some(shipped("balls-2.glb"))), ("bunny-dragon-2", shared("scenes/bunny-dragon-2.glb"))]
    {
        let Some(path) = path else { continue };
        let stage = bake_scene(&path, &Setup::new(720, 480));
        let Stage { scene, framebuffer, .. } = &stage;
        let sun = Light {
            kind: LightKind::Directional,
            direction: DVec3::new(0.4, -1.0, -0.6).normalize(),
            ..Light::point("sun", DVec3::ZERO)
        };
        let straight = Light { direction: DVec3::NEG_Y, ..sun.clone() };
        for light in scene.rig.lights.iter().chain([&sun, &straight]) {
            let light_name = &light.name;
            let light = light.pack(scene.space);
            let mut visibility = vec![7u8; framebuffer.packets.len() * PACKET_SIZE];
            trace_packets(&**scene, &light, &framebuffer.packets, &mut visibility);
            let lanes = (framebuffer.packets.par_iter().zip(visibility.par_chunks(PACKET_SIZE))).flat_map_iter(
                |(packet, seen)| {
                    (0..PACKET_SIZE).filter_map(|lane| {
                        let ray = packet.shadow_ray(&scene.bvh, &light, lane)?;
                        let single = !scene.occluded(ray.origin, ray.direction, ray.length);
                        Some((single, seen[lane] == 255, ray.origin, ray.direction))
                    })
                },
            );
            let lanes: Vec<_> = lanes.collect();
            let seen = lanes.iter().filter(|lane| lane.0).count();
            let differing: Vec<_> = lanes.iter().filter(|lane| lane.0 != lane.1).collect();
            println!("{name}, {light_name}: {} of {} rays differ, {seen} see the light", differing.len(), lanes.len());
            assert!(seen > lanes.len() / 10 && lanes.len() > 50_000, "{seen} of {} rays see the light", lanes.len());
            // Two ways to round: a ray in a million passes an edge within rounding.
            let allowed = 5.0 * lanes.len() as f64 / 1e6;
            assert!(differing.len() as f64 <= allowed, "{name}, {light_name}: first {:?}", differing.first());
            let facing_away = visibility.iter().filter(|&&v| v != 0 && v != 255).count();
            assert_eq!(facing_away, 0, "every byte is written");
        }
    }
}

/// What of a picture is not what tests/goldens has: the mean relative error is more than `most`.
fn against_golden(name: &str, width: u32, height: u32, got: Vec<[f32; 3]>, most: f64) -> Option<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/goldens").join(format!("{name}.exr"));
    if std::env::var_os("BLESS").is_some() {
        exr::write(&path, &Image::single(width as usize, height as usize, got)).expect("the goldens are writable");
        not_run(&format!("{name} is blessed, not compared"));
        return None;
    }
    let pictures = compare(got, read(&path));
    let difference: f64 = (pictures.image.iter().flatten().zip(pictures.reference.iter().flatten()))
        .map(|(x, r)| f64::from((x - r).abs()))
        .sum();
    let total: f64 = pictures.reference.iter().flatten().map(|&r| f64::from(r)).sum();
    let error = difference / total;
    println!("{name}: mean error {error:.1e}");
    // Written so that NaN fails.
    let is_same = error <= most;
    (!is_same).then(|| format!("{name}: mean error {error:.1e}\n  {}", leave(&pictures, &format!("golden-{name}"))))
}

/// Mean relative error against our own picture of before.
#[test]
fn goldens() {
    let gpu = gpu();
    for (name, width, height) in [("balls-2", 90, 60), ("cornell-glossy", 64, 64)] {
        let setup = Setup { samples: 4, ..Setup::new(width, height) };
        let got = relit(&gpu, &bake_scene(&shipped(&format!("{name}.glb")), &setup), &setup, Layers::All);
        let wrong = against_golden(name, width, height, got, 1e-4);
        assert!(wrong.is_none(), "{}", wrong.unwrap_or_default());
    }
}

/// Any number of threads gives the same bits. On another processor rounding may keep another direction of a block, one
/// of hundreds. A ray fewer of each row (127 instead of 128) is 0.015 off, another seed 0.08 and more (RMS).
const INDIRECT_GOLDEN: f64 = 1e-3;

/// The same of indirect light alone, compressed, and spread over the samples of edges: with few gather samples and
/// rays, so that its bake takes seconds.
#[test]
fn goldens_of_indirect_light() {
    let IndirectSettings::Robust { outgoing, .. } = IndirectSettings::default() else { panic!("ours is the default") };
    let (gather, rays, form) = (Some(512), Some(128), Form::Nested(0.05));
    let indirect = Some(IndirectSettings::Robust { outgoing, form, gather, rays, bounces: None });
    let (width, height) = (48, 48);
    let mut settings = SessionSettings { samples: 4, indirect, cache_dir: None, ..Default::default() };
    settings.open.size = Some([width, height]);
    for scene in ["cornell-diffuse", "cornell-glossy"] {
        let session = Session::open(&shipped(&format!("{scene}.glb")), None, &settings, &()).expect("the scene opens");
        let gpu = gpu();
        let traced = RelightSettings { visibility: VisibilityMethod::Traced, ..Default::default() };
        let mut relighter = session.relighter(&gpu, &session.rig, &traced).expect("the device has room");
        let got = pixels(&mut relighter, Layers::Indirect);
        let wrong = against_golden(&format!("{scene}-indirect"), width, height, got, INDIRECT_GOLDEN);
        assert!(wrong.is_none(), "{}", wrong.unwrap_or_default());
    }
}
