//! The path tracer against another renderer's pictures, against our own of direct light, and against itself.
//!
//! RELUME_FULL=1 takes enough samples to make the agreement as sharp as the other renderer's noise allows.

mod common;

use std::sync::atomic::{AtomicU64, Ordering};

use common::drawn::tracing;
use common::stage::{Setup, Stage, pixels};
use common::{gpu, largest, not_run, shared, shipped};
use rayon::ThreadPoolBuilder;
use relume::bake::framebuffer::view_samples::{EyeRays, PathPart, Tiling};
use relume::image::{Layer as Picture, exr};
use relume::reference::path_tracer::{Film, Half, Layer, PathTracer, Settings};
use relume::relight::Layers;
use relume::scene::Scene;
use relume::trace::bvh::TracedScene;
use relume::trace::packet::shadow_ray;
use relume::trace::surface::SurfacePoint;

fn is_full() -> bool {
    std::env::var_os("RELUME_FULL").is_some_and(|value| value == "1")
}

fn settings(width: u32, height: u32) -> Settings {
    Settings { bounce_layers: 4, ..tracing(width, height) }
}

fn trace(scene: &Scene, settings: &Settings, samples_a_half: u32) -> Film {
    let scene = &TracedScene::new(scene.clone());
    let tracer = PathTracer::new(scene, &scene.cameras[0], &scene.rig, settings);
    tracer.trace(samples_a_half, &|| false, &|_| ())
}

/// Two independent estimates of one picture.
struct Halves {
    width: usize,
    a: Vec<[f32; 3]>,
    b: Vec<[f32; 3]>,
}

impl Halves {
    fn of(film: &Film, width: usize, layers: &[Layer]) -> Self {
        let sum = |half| {
            let mut sum = vec![[0f32; 3]; film.layer(half, Layer::Beauty).len()];
            for layer in layers {
                let add = |(s, p): (&mut [f32; 3], [f32; 3])| *s = std::array::from_fn(|c| s[c] + p[c]);
                sum.iter_mut().zip(film.layer(half, *layer)).for_each(add);
            }
            sum
        };
        Self { width, a: sum(Half::A), b: sum(Half::B) }
    }

    fn read(name: &str) -> Option<Self> {
        let [a, b] = ["a", "b"].map(|half| shared(&format!("reference/{name}.{half}.exr")));
        let [a, b] = [a?, b?].map(|path| exr::read(&path).expect("the reference is readable"));
        let pixels = |layers: Vec<Picture>| layers.into_iter().next().expect("it has a layer").pixels;
        Some(Self { width: a.width, a: pixels(a.layers), b: pixels(b.layers) })
    }

    /// Mean of each block of so many pixels' side and channel, and its variance; pixels `left_out` are not counted.
    fn blocks(&self, side: usize, left_out: &[bool]) -> Vec<(f64, f64)> {
        let across = self.width / side;
        let mut sums = vec![(0.0, 0.0, 0.0); across * (self.a.len() / self.width / side) * 3];
        for (i, (a, b)) in self.a.iter().zip(&self.b).enumerate() {
            if left_out[i] {
                continue;
            }
            let block = i / self.width / side * across + i % self.width / side;
            for c in 0..3 {
                let (a, b) = (f64::from(a[c]), f64::from(b[c]));
                let sum = &mut sums[3 * block + c];
                *sum = (sum.0 + (a + b) / 2.0, sum.1 + (a - b).powi(2) / 4.0, sum.2 + 1.0);
            }
        }
        sums.into_iter().map(|(sum, squares, count)| (sum / count, squares / (count * count))).collect()
    }
}

/// Differences of block means over their standard errors: few beyond 3, none beyond 5, spread as noise spreads, and to
/// no side more than to the other.
fn check_agreement(ours: &Halves, theirs: &Halves, side: usize, left_out: &[bool], name: &str) -> Result<(), String> {
    let residuals: Vec<f64> = ours
        .blocks(side, left_out)
        .into_iter()
        .zip(theirs.blocks(side, left_out))
        .filter(|(ours, theirs)| ours.1 + theirs.1 != 0.0)
        .map(|(ours, theirs)| (ours.0 - theirs.0) / (ours.1 + theirs.1).sqrt())
        .collect();
    let count = residuals.len() as f64;
    let mean = residuals.iter().sum::<f64>() / count;
    let deviation = (residuals.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / count).sqrt();
    let beyond = |limit: f64| residuals.iter().filter(|r| r.abs() > limit).count() as f64 / count;
    let most_off = largest(residuals.iter().map(|r| r.abs()));
    let line = format!(
        "{name}: {count} residuals, mean {mean:+.3}, deviation {deviation:.3}, {:.2} % beyond 3, largest {most_off:.2}",
        100.0 * beyond(3.0)
    );
    println!("{line}");
    // Three standard errors of the mean, a pixel's three channels being nearly one; no more than that can few blocks
    // tell.
    let most = if is_full() { 0.2 } else { 3.0 / (count / 3.0).sqrt() };
    // 1 %, but one of them however few they are.
    let most_beyond = f64::max(0.01, 1.0 / count);
    let fine = mean.abs() < most && (0.8..=1.3).contains(&deviation) && beyond(3.0) <= most_beyond && most_off <= 5.0;
    if fine { Ok(()) } else { Err(line) }
}

/// Pixels that any two tracers decide for themselves: whose centre lies within a thousandth of a pixel of an edge
/// between two faces, or within a tenth of one of a shadow's edge. Where shadow rays start, 1e-5 m off a surface here
/// and 1e-4 m there, moves that edge by a fiftieth of a pixel, and further where light grazes. And those where a coarse
/// mesh would shadow itself if rays started on its triangles, as theirs do.
fn edges(scene: &Scene, width: u32, height: u32) -> Vec<bool> {
    let scene = &TracedScene::new(scene.clone());
    let tiling = Tiling { width, height };
    let eye = EyeRays { scene, camera: &scene.cameras[0], tiling, layers: 1 };
    let lights: Vec<_> = scene.rig.lights.iter().map(|light| light.pack(scene.space)).collect();
    let seen = |x: f64, y: f64| {
        let mut seen = None;
        eye.follow(x, y, |part| {
            if let PathPart::Vertex(vertex) = part {
                seen = Some(vertex.point);
            }
        });
        seen
    };
    let is_lit = |point: &SurfacePoint, light| {
        let ray = shadow_ray(&scene.bvh, light, point.lifted(), point.normal, point.geometric_normal);
        ray.is_some_and(|ray| !scene.occluded(ray.origin, ray.direction, ray.length))
    };
    let shadows_itself = |a: &SurfacePoint| {
        let flat = SurfacePoint { lift: 0.0, ..*a };
        lights.iter().any(|light| is_lit(a, light) != is_lit(&flat, light))
    };
    let on_seam = |a: &SurfacePoint, b: &SurfacePoint| a.material != b.material || a.normal.dot(b.normal) < 0.9;
    let on_shadow_edge = |a: &SurfacePoint, b: &SurfacePoint| lights.iter().any(|l| is_lit(a, l) != is_lit(b, l));
    let is_edge = |(x, y): (u32, u32)| {
        let (x, y) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let around = |off: f64| [(-off, 0.0), (off, 0.0), (0.0, -off), (0.0, off)].map(|(dx, dy)| seen(x + dx, y + dy));
        let differ = |around: [Option<SurfacePoint>; 4], differ: &dyn Fn(&SurfacePoint, &SurfacePoint) -> bool| {
            around.iter().any(|other| match (&around[0], other) {
                (Some(a), Some(b)) => differ(a, b),
                (a, b) => a.is_some() != b.is_some(),
            })
        };
        let at_terminator = seen(x, y).is_some_and(|point| shadows_itself(&point));
        at_terminator || differ(around(1e-3), &on_seam) || differ(around(0.1), &on_shadow_edge)
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(is_edge).collect()
}

/// Light by any bounces, by one and by four, against Mitsuba's. Blocks have `quick_side` pixels where samples are few.
fn agrees(scene_name: &str, quick_side: usize) {
    let Some(path) = shared(&format!("scenes/{scene_name}.glb")) else { return };
    let reference = |image: &str| format!("{scene_name}.centre.{image}");
    let Some(direct) = shared(&format!("reference/{}.exr", reference("direct"))) else { return };
    let direct = exr::read(&direct).expect("the reference is readable");
    let (width, height) = (direct.width, direct.height);
    let scene = Scene::load(&path).unwrap();
    let film = trace(&scene, &settings(width as u32, height as u32), if is_full() { 128 } else { 4 });

    let edges = edges(&scene, width as u32, height as u32);
    println!("{scene_name}: {} pixels on edges", edges.iter().filter(|&&edge| edge).count());
    let ours = film.layer(Half::Both, Layer::Direct);
    let differs = |(a, b): (&[f32; 3], &[f32; 3])| !(0..3).all(|c| (a[c] - b[c]).abs() <= 1e-4 * b[c].max(0.1));
    let differing =
        ours.iter().zip(&direct.layers[0].pixels).map(differs).zip(&edges).filter(|(d, edge)| *d && !**edge);
    let differing = differing.count();
    println!("{scene_name}: {differing} differ in direct light elsewhere");
    assert!(differing <= 20, "{differing} pixels differ in direct light, which has no noise, edges aside");

    use Layer::*;
    let pictures: [(&str, &[Layer]); 4] = [
        ("full", &[Beauty]),
        ("indirect", &[Indirect]),
        ("depth3", &[Direct, Bounce(1)]),
        ("depth6", &[Direct, Bounce(1), Bounce(2), Bounce(3), Bounce(4)]),
    ];
    let check = |(image, layers): (&str, &[Layer])| {
        let Some(theirs) = Halves::read(&reference(image)) else { return Ok(()) };
        let side = if is_full() { 32 } else { quick_side };
        check_agreement(&Halves::of(&film, width, layers), &theirs, side, &edges, &reference(image))
    };
    let wrong: Vec<String> = pictures.into_iter().filter_map(|picture| check(picture).err()).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn agrees_with_another_renderer_where_all_is_matt() {
    agrees("cornell-diffuse", 32);
}

#[test]
fn agrees_with_another_renderer_where_it_is_glossy() {
    agrees("cornell-glossy", 128);
}

/// The truths that ship are what the path tracer gives, with few samples of another seed.
#[test]
fn shipped_truths_are_true() {
    for (name, truth, size) in [
        ("cornell-diffuse", "cornell-diffuse", 128),
        ("cornell-glossy", "cornell-glossy", 128),
        ("cornell-glossy", "cornell-glossy-64", 64),
        ("balls-2", "balls-2", 128),
    ] {
        let scene = Scene::load(&shipped(&format!("{name}.glb"))).unwrap();
        let film = trace(&scene, &Settings { seed: 7, ..settings(size, size) }, if is_full() { 256 } else { 16 });
        let size = size as usize;
        let read = |half: &str| {
            let image = exr::read(&shipped(&format!("truth/{truth}.{half}.exr"))).expect("the truth is readable");
            assert_eq!((image.width, image.height), (size, size), "{truth}");
            image.layer("beauty").expect("it has a beauty").pixels.clone()
        };
        let theirs = Halves { width: size, a: read("a"), b: read("b") };
        // As many blocks as the stricter limit on their mean asks for, and enough of a small picture.
        let side = if is_full() || size < 128 { 8 } else { 32 };
        let ours = Halves::of(&film, size, &[Layer::Beauty]);
        let result = check_agreement(&ours, &theirs, side, &vec![false; size * size], truth);
        assert!(result.is_ok(), "{result:?}");
    }
}

/// They show what another renderer's picture shows: a pixel of theirs is the mean of so many of its, but for what one
/// ray through the centre misses.
#[test]
fn shipped_truths_are_those_of_another_renderer() {
    for name in ["cornell-diffuse", "cornell-glossy"] {
        let Some(theirs) = Halves::read(&format!("{name}.centre.full")) else { return };
        let ours = ["a", "b"].map(|half| {
            let image = exr::read(&shipped(&format!("truth/{name}.{half}.exr"))).expect("the truth is readable");
            image.layer("beauty").expect("it has a beauty").pixels.clone()
        });
        // Means over eighths of the sides: 16 pixels of ours, 64 of theirs.
        let mean = |pixels: &[[f32; 3]], width: usize, x: usize, y: usize, c: usize| {
            let side = width / 8;
            let rows = pixels.chunks(width).skip(y * side).take(side);
            rows.flat_map(|row| &row[x * side..][..side]).map(|p| f64::from(p[c])).sum::<f64>() / (side * side) as f64
        };
        let mut off = Vec::new();
        for (x, y, c) in (0..8 * 8 * 3).map(|i| (i / 3 % 8, i / 24, i % 3)) {
            let got = ours.iter().map(|half| mean(half, 128, x, y, c)).sum::<f64>() / 2.0;
            let want = [&theirs.a, &theirs.b].map(|half| mean(half, theirs.width, x, y, c)).iter().sum::<f64>() / 2.0;
            off.push((got - want).abs() / (0.05 + want));
        }
        let worst = largest(off.iter().copied());
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        println!("{name}: blocks are off by {mean:.4} in the mean, {worst:.4} at most");
        // Edges that blocks hold are sampled at other places: measured 0.0065 and 0.040.
        assert!(mean < 0.01 && worst < 0.06, "{name}: off by {mean} in the mean, {worst} at most");
    }
}

/// Direct light and reflections are the relighter's own, pixel by pixel but for shadow edges.
#[test]
fn direct_light_and_reflections_are_those_of_the_relighter() {
    let gpu = gpu();
    for name in ["balls-2.glb", "balls-16.glb", "cornell-glossy.glb"] {
        let scene = Scene::load(&shipped(name)).unwrap();
        let (width, height) = (180, 120);
        let film = trace(&scene, &Settings { max_bounces: Some(0), ..settings(width, height) }, 1);
        let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
        let setup = Setup::new(width, height);
        let stage = Stage::new(scene, &camera, &rig, &setup);
        let mut relighter = stage.relighter(&gpu, &rig, &setup);
        for (layer, layers) in [(Layer::Direct, Layers::Direct), (Layer::Reflection, Layers::Reflection)] {
            let (got, want) = (film.layer(Half::Both, layer), pixels(&mut relighter, layers));
            // 1e-4: what a moved decimal of a normal does to the steep edge of a cone.
            let differs = |(a, b): &(&[f32; 3], &[f32; 3])| !(0..3).all(|c| (a[c] - b[c]).abs() <= 1e-4 * (0.1 + b[c]));
            let differing = got.iter().zip(&want).filter(differs).count();
            println!("{name}, {layer:?}: {differing} of {} pixels differ", want.len());
            assert!(differing <= 4, "{name}, {layer:?}: {differing} pixels differ");
            let is_lit = want.iter().flatten().filter(|&&x| x > 0.0).count() > 300;
            let has_mirrors = name.starts_with("balls");
            assert_eq!(is_lit, layer == Layer::Direct || has_mirrors, "{name}, {layer:?}");
        }
        assert!(
            film.layer(Half::Both, Layer::Indirect).iter().flatten().all(|&v| v == 0.0),
            "0 bounces are direct light"
        );
    }
}

#[test]
fn layers_add_up_and_bounces_can_be_cut() {
    let scene = Scene::load(&shipped("cornell-glossy.glb")).unwrap();
    let all = trace(&scene, &settings(48, 48), 8);
    let values =
        |film: &Film, layer| film.layer(Half::A, layer).into_iter().flatten().map(f64::from).collect::<Vec<_>>();
    use Layer::*;
    let sum = |film: &Film, layers: &[Layer]| {
        let layers: Vec<_> = layers.iter().map(|layer| values(film, *layer)).collect();
        (0..layers[0].len()).map(|i| layers.iter().map(|layer| layer[i]).sum::<f64>()).collect::<Vec<_>>()
    };
    let same = |a: Vec<f64>, b: Vec<f64>, what: &str| {
        let off = largest(a.iter().zip(&b).map(|(a, b)| (a - b).abs() / (1.0 + b.abs())));
        assert!(off < 1e-6, "{what}: off by {off}");
    };
    same(sum(&all, &[Direct, Reflection, Indirect, Emission]), values(&all, Beauty), "layers");
    for bounces in [1, 3] {
        let cut = trace(&scene, &Settings { max_bounces: Some(bounces), ..settings(48, 48) }, 8);
        let first: Vec<Layer> = (1..=bounces).map(Bounce).collect();
        same(values(&cut, Indirect), sum(&all, &first), "the same paths, cut");
    }
    let glossy = sum(&all, &[IndirectGlossy]);
    let indirect = values(&all, Indirect);
    assert!(glossy.iter().zip(&indirect).all(|(g, i)| *g >= 0.0 && *g <= i * (1.0 + 1e-6)), "a part of the whole");
    assert!(glossy.iter().sum::<f64>() > 0.01 * indirect.iter().sum::<f64>(), "the block and the ball are glossy");
}

/// Each light's layer is what the light does, bounces past those that have layers included; one that is off does
/// nothing.
#[test]
fn lights_add_up() {
    let mut scene = Scene::load(&shipped("balls-16.glb")).unwrap();
    scene.rig.lights[3].enabled = false;
    let settings = Settings { light_layers: true, bounce_layers: 1, ..settings(48, 32) };
    let film = trace(&scene, &settings, 4);
    let mut sum = film.layer(Half::A, Layer::Emission);
    for light in 0..16 {
        let layer = film.layer(Half::A, Layer::Light(light));
        assert_eq!(layer.iter().flatten().any(|&v| v > 0.0), light != 3, "light {light}");
        sum.iter_mut().zip(layer).for_each(|(sum, own)| (0..3).for_each(|c| sum[c] += own[c]));
    }
    // 17 roundings of float32.
    let same = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() <= 2e-6 * b.abs())
    };
    assert!(same(&sum, &film.layer(Half::A, Layer::Beauty)), "lights do not add up");

    // A light among others does what it does alone.
    let straight = Settings { max_bounces: Some(0), ..settings };
    let among = trace(&scene, &straight, 1).layer(Half::A, Layer::Light(5));
    scene.rig.lights.iter_mut().enumerate().for_each(|(i, light)| light.enabled = i == 5);
    assert!(same(&trace(&scene, &straight, 1).layer(Half::A, Layer::Beauty), &among), "light 5 does otherwise alone");
}

/// The same bytes from the seed, whatever the number of threads; others from another seed.
#[test]
fn pixels_do_not_depend_on_threads() {
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let image = |threads: usize, seed: u64| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let film = pool.install(|| trace(&scene, &Settings { seed, ..settings(45, 30) }, 5));
        film.image(Half::Both, &[Layer::Beauty, Layer::Indirect, Layer::Variance, Layer::Bounce(1)])
    };
    let one = image(1, 1);
    assert_eq!(one, image(2, 1));
    assert_eq!(one, image(3, 1));
    assert_ne!(one, image(1, 2));
}

/// What a film that was stopped holds is a mean over the samples that it has, and says how many.
#[test]
fn a_stopped_film_is_an_estimate() {
    let scene = TracedScene::new(Scene::load(&shipped("cornell-diffuse.glb")).unwrap());
    let tracer = PathTracer::new(&scene, &scene.cameras[0], &scene.rig, &settings(32, 32));
    let film = tracer.trace(1 << 20, &|| true, &|_| ());
    assert_eq!(film.samples(), [2, 2], "a first sample in each half is always there");
    let tiles = AtomicU64::new(0);
    let stop = || tiles.load(Ordering::Relaxed) > 40;
    let film = tracer.trace(1 << 20, &stop, &|_| _ = tiles.fetch_add(1, Ordering::Relaxed));
    let [least, most] = film.samples();
    assert!(least >= 2 && most > 2 && most <= 64, "{least} to {most}");
    let means: Vec<f64> =
        [film, trace(&scene, &settings(32, 32), 32)].iter().map(|film| film.standard_errors().mean).collect();
    assert!((means[0] / means[1] - 1.0).abs() < 0.05, "{means:?}");
}

/// Error against samples, from the difference of independent halves: a line in logarithms whose slope is at most -0.45.
#[test]
fn error_falls_with_samples() {
    let scene = Scene::load(&shipped("cornell-diffuse.glb")).unwrap();
    let most = if is_full() { 10_000 } else { 100 };
    let counts: Vec<u32> = [1, 3, 10, 32, 100, 316, 1_000, 3_162, 10_000].into_iter().filter(|&n| n <= most).collect();
    let logs: Vec<(f64, f64)> = counts
        .iter()
        .map(|&n| {
            let error = trace(&scene, &settings(64, 64), n).standard_errors().of_pixel;
            println!("{} samples a pixel: {error:.3e}", 2 * n);
            (f64::from(n).ln(), error.ln())
        })
        .collect();
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| logs.iter().map(f).sum::<f64>() / logs.len() as f64;
    let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
    let slope = mean(&|p| (p.0 - x) * (p.1 - y)) / mean(&|p| (p.0 - x).powi(2));
    println!("slope {slope:.3}");
    assert!(slope <= -0.45, "slope {slope}");
    if !is_full() {
        not_run("the other two of four decades: RELUME_FULL=1");
    }
}
