//! Area lights, and lights with filters: of no size and larger than the scene, in walls, around the camera. Pictures
//! while they change and at rest, and path-traced ones.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DVec3, Vec3};
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::relight::{Detail, Layers, Request};
use relume::scene::{Camera, Light, LightKind, Links, Material, Projection, Rig, RigFiles, Scene};
use relume::trace::bvh::TracedScene;

use crate::common::stage::{Build, Setup, Stage, lambert, look, pixels, rig};
use crate::common::{Gpu, gpu};
use crate::lights::{Relit, farthest_from_black, negative, over};
use crate::place::relative;
use crate::table::{Row, check, full};

const SIZE: [u32; 2] = [32, 24];
const ALBEDO: f64 = 0.5;
const EYE: DVec3 = DVec3::new(0.8, 0.7, 0.9);
/// In the view and in nobody's way.
const MIDDLE: DVec3 = DVec3::new(0.1, -0.2, 0.05);

/// Light that rounding lets around the edge of a plane, of a candela at a metre.
const ROUNDING: f64 = 1e-8;
const TOUCHES: &str =
    "its points are bounded within their share of its surface, which takes light from where it touches";

fn grey() -> Material {
    Material { name: "grey".into(), ..lambert(Vec3::splat(ALBEDO as f32)) }
}

/// A room of 2 m.
fn room() -> (Scene, Camera) {
    let mut build = Build::default();
    let grey = build.material(grey());
    build.room(DVec3::ZERO, 1.0, grey);
    (build.scene(), camera())
}

fn camera() -> Camera {
    look(EYE, DVec3::new(0.0, -0.3, 0.0), DVec3::Y, Projection::Perspective { yfov: 1.3 })
}

fn relit(of: (Scene, Camera)) -> Relit {
    let (scene, camera) = of;
    let light = rig(vec![Light::point("l", MIDDLE)]);
    Relit::with(scene, &camera, &light, &Setup::new(SIZE[0], SIZE[1]), 256)
}

/// The room without indirect light.
fn stage() -> Stage {
    let (scene, camera) = room();
    Stage::new(scene, &camera, &rig(vec![Light::point("l", MIDDLE)]), &Setup::new(SIZE[0], SIZE[1]))
}

/// Makes pictures of first-hand light of a light in it.
fn first_hand(stage: &Stage, gpu: &Gpu) -> impl Fn(&Light) -> Vec<[f32; 3]> {
    let setup = Setup::new(SIZE[0], SIZE[1]);
    move |light| pixels(&mut stage.relighter(gpu, &rig(vec![light.clone()]), &setup), Layers::FirstHand)
}

fn sphere(radius: f64, position: DVec3) -> Light {
    Light { radius, ..Light::point("l", position) }
}

fn flat(kind: LightKind, position: DVec3, direction: DVec3) -> Light {
    Light { kind, direction, radius: 0.3, size: [0.6, 0.4], ..Light::point("l", position) }
}

/// Lights in the room.
fn cases() -> Vec<(&'static str, Light)> {
    use LightKind::{Disk, Rect, Spot};
    let rect = flat(Rect, MIDDLE, DVec3::NEG_Y);
    let disk = flat(Disk, MIDDLE, DVec3::NEG_Y);
    let wall = DVec3::new(-1.0, 0.1, -0.2);
    let floor = DVec3::new(-0.2, -1.0, 0.1);
    vec![
        ("a sphere of 2e-6 m", sphere(1e-6, MIDDLE)),
        ("a sphere half in a wall", sphere(0.3, wall)),
        ("a sphere that touches the floor", sphere(0.3, floor + 0.3 * DVec3::Y)),
        ("a sphere that touches all walls", sphere(1.0, DVec3::ZERO)),
        ("a sphere around the room", sphere(5.0, DVec3::ZERO)),
        ("a sphere around the camera", sphere(0.15, EYE)),
        ("a rectangle through the floor", flat(Rect, floor, DVec3::X)),
        ("a rectangle in a wall", flat(Rect, wall, DVec3::X)),
        ("a rectangle in a wall, facing it", flat(Rect, wall, DVec3::NEG_X)),
        ("a rectangle through the camera", flat(Rect, EYE, DVec3::NEG_Z)),
        ("a disk on the floor, facing up", flat(Disk, floor, DVec3::Y)),
        ("a disk on the floor, facing down", flat(Disk, floor, DVec3::NEG_Y)),
        ("a disk on the floor, facing both", Light { two_sided: true, ..flat(Disk, floor, DVec3::Y) }),
        ("a disk of 100 m below the ceiling", Light { radius: 50.0, position: 0.9 * DVec3::Y, ..disk.clone() }),
        ("a disk of no size", Light { radius: 0.0, ..disk.clone() }),
        ("a rectangle without width", Light { size: [0.0, 0.4], ..rect.clone() }),
        ("a rectangle without height", Light { size: [0.6, 0.0], ..rect.clone() }),
        ("a rectangle of no size", Light { size: [0.0; 2], ..rect.clone() }),
        ("a rectangle of 1e-6 x 2 m", Light { size: [1e-6, 2.0], ..rect.clone() }),
        ("a disk with a spread of 0.01 degrees", Light { spread: 0.01f64.to_radians(), ..disk.clone() }),
        ("a disk with a spread of 180 degrees", Light { spread: PI, ..disk.clone() }),
        ("a spot of 100 m", Light { kind: Spot, radius: 50.0, ..disk.clone() }),
        ("a disk of 1e-30 cd", Light { intensity: 1e-30, ..disk.clone() }),
        ("a disk of 5e-324 cd", Light { intensity: 5e-324, ..disk.clone() }),
        ("a disk of 1e30 cd", Light { intensity: 1e30, ..disk }),
    ]
}

/// Pictures of a light that has just moved: while it is dragged, some at rest, and the exact one.
fn pictures(relit: &Relit, gpu: &Gpu, light: &Light) -> Vec<Vec<[f32; 3]>> {
    let before = Light { position: light.position + 0.1 * DVec3::X, ..light.clone() };
    let mut relighter = relit.relighter(gpu, &rig(vec![before]));
    relighter.linear(Request::default()).unwrap();
    relighter.set_rig(&rig(vec![light.clone()])).unwrap();
    let details = [Detail::Coarse, Detail::Progressive, Detail::Progressive, Detail::Exact];
    details.map(|detail| relighter.linear(Request { detail, ..Request::default() }).unwrap().to_vec()).into()
}

/// Direct light of one light.
fn direct(relit: &Relit, gpu: &Gpu, light: &Light) -> Vec<[f32; 3]> {
    relit.relighter(gpu, &rig(vec![light.clone()])).linear(Layers::Direct).unwrap().to_vec()
}

fn traced(scene: &TracedScene, light: &Light, max_bounces: u32, samples: u32, layer: Layer) -> Vec<[f32; 3]> {
    let settings = Settings {
        width: SIZE[0],
        height: SIZE[1],
        layers: 4,
        max_bounces: Some(max_bounces),
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed: 1,
    };
    let (camera, rig) = (camera(), rig(vec![light.clone()]));
    let film = PathTracer::new(scene, &camera, &rig, &settings).trace(samples, &|| false, &|_| ());
    film.layer(Half::Both, layer)
}

fn mean(pixels: &[[f32; 3]]) -> f64 {
    pixels.iter().flatten().map(|&x| f64::from(x)).sum::<f64>() / (3 * pixels.len()) as f64
}

fn apart(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    relative(&over(a, 1.0), &over(b, 1.0))
}

/// 0 if the pictures are equal.
fn different(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    if a == b { 0.0 } else { apart(a, b).max(f64::MIN_POSITIVE) }
}

#[test]
fn sizes_and_places() {
    let gpu = gpu();
    let relit = relit(room());
    let mut rows = Vec::new();
    for (case, light) in cases() {
        let seen = Light { visible: true, ..light.clone() };
        let mut all = pictures(&relit, &gpu, &seen);
        all.push(traced(relit.scene(), &seen, 2, 4, Layer::Beauty));
        rows.push(Row::new(case, "finite, hardly any of it below 0", 1e-4, negative(&all.concat())));
        if light.intensity < f64::from(f32::MIN_POSITIVE) {
            continue; // black, for single precision
        }
        let least = ROUNDING * light.intensity;
        // With a bounce, so that rays find what touches a surface.
        let [ours, want] =
            [direct(&relit, &gpu, &light), traced(relit.scene(), &light, 1, 128, Layer::Direct)].map(|p| mean(&p));
        let row = Row::new(
            case,
            "direct light as path-traced, mean over pixels",
            2e-2,
            (ours - want).abs() / want.max(least),
        );
        rows.push(match case {
            "a sphere half in a wall" | "a sphere that touches the floor" | "a sphere that touches all walls" => {
                row.short(TOUCHES)
            }
            _ => row,
        });
        let gathered = relit.gathered(&rig(vec![light.clone()]), if full() { 16 } else { 8 });
        let [ours, want] =
            [&gathered.concat(), &traced(relit.scene(), &light, u32::MAX, 64, Layer::Indirect)].map(|p| mean(p));
        let ours = if gathered.is_empty() { 0.0 } else { ours * rig(vec![light]).scale(0).x as f64 };
        let asked = "gathered indirect light as path-traced, mean over pixels";
        rows.push(Row::new(case, asked, 3e-2, (ours - want).abs() / want.max(least)));
    }
    check("sizes of lights", &rows);
}

/// What a light must give, known from another light or from a formula.
#[test]
fn sizes_that_are_known() {
    let gpu = gpu();
    let stage = stage();
    let first_hand = first_hand(&stage, &gpu);
    let mut rows = Vec::new();
    let mut row = |case: &str, asked: &str, bound: f64, error: f64| rows.push(Row::new(case, asked, bound, error));

    let point = Light::point("l", MIDDLE);
    let text = "[[light]]\nname = \"l\"\nkind = \"sphere\"\nradius = 0\nposition = [0.1, -0.2, 0.05]\n";
    let read = Rig::from_toml(text, RigFiles::new(Path::new(""))).unwrap();
    let same = "as a point, to the last bit";
    row("a sphere of radius 0", same, 0.0, different(&first_hand(&read.lights[0]), &first_hand(&point)));
    let text = format!("{text}kind = \"disk\"\n").replace("kind = \"sphere\"\n", "spread_deg = 0\n");
    let refused = Rig::from_toml(&text, RigFiles::new(Path::new(""))).is_err_and(|e| e.contains("spread_deg is 0"));
    row("a spread of 0 degrees", "one error that names it", 0.0, if refused { 0.0 } else { 1.0 });

    let spot = Light { outer_angle: 1.2, ..flat(LightKind::Spot, MIDDLE, DVec3::NEG_Y) };
    let rect = flat(LightKind::Rect, MIDDLE, DVec3::NEG_Y);
    let disk = flat(LightKind::Disk, MIDDLE, DVec3::NEG_Y);
    for (what, light) in [("sphere", &point), ("spot", &spot), ("disk", &disk), ("rectangle", &rect)] {
        let of_size = |size: f64| first_hand(&Light { radius: size, size: [size; 2], ..light.clone() });
        row(&format!("a {what} of 1e-6 m"), "as one of no size", 1e-3, apart(&of_size(1e-6), &of_size(0.0)));
    }
    for size in [[0.0, 0.4], [0.6, 0.0]] {
        let thin = size.map(|side: f64| side.max(1e-6));
        let [got, want] = [size, thin].map(|size| first_hand(&Light { size, ..rect.clone() }));
        let case = format!("a rectangle of {} x {} m", size[0], size[1]);
        row(&case, "as one of 1e-6 m there", 1e-3, apart(&got, &want));
    }

    // Where all of a sphere is above the horizon.
    let large = sphere(0.2, MIDDLE);
    row("a sphere of 0.4 m", "as a point in its middle", 2e-3, apart(&first_hand(&large), &first_hand(&point)));
    let floor = DVec3::new(-0.2, -1.0, 0.1);
    let through = Light { size: [0.6, 0.4], ..flat(LightKind::Rect, floor, DVec3::X) };
    let above = Light { size: [0.6, 0.2], position: floor + 0.1 * DVec3::Y, intensity: 0.5, ..through.clone() };
    row(
        "a rectangle half below the floor",
        "as its upper half",
        // Half of its points answer, some of them at the floor.
        5e-2,
        apart(&first_hand(&through), &first_hand(&above)),
    );
    let wall = flat(LightKind::Rect, DVec3::new(-1.0, 0.1, -0.2), DVec3::X);
    for (case, light) in
        [("a rectangle in a wall", &wall), ("a disk on the floor, facing up", &flat(LightKind::Disk, floor, DVec3::Y))]
    {
        let off = Light { position: light.position + 1e-4 * light.direction, ..light.clone() };
        row(case, "as 1e-4 m before it", 1e-2, apart(&first_hand(light), &first_hand(&off)));
    }
    let black = [
        ("a disk on the floor, facing down", flat(LightKind::Disk, floor, DVec3::NEG_Y)),
        ("a rectangle in a wall, facing it", Light { direction: DVec3::NEG_X, ..wall }),
        ("a sphere around the room, which shines outwards", sphere(5.0, DVec3::ZERO)),
        ("a light that leaves out all there is", Light { links: except("grey"), ..sphere(0.1, MIDDLE) }),
    ];
    for (case, light) in &black {
        let traced = traced(&stage.scene, light, 1, 16, Layer::Beauty);
        row(case, "black, up to rounding", ROUNDING, farthest_from_black(&[first_hand(light), traced].concat()));
    }

    let ahead = (DVec3::new(0.0, -0.3, 0.0) - EYE).normalize();
    let invisible = [
        ("a visible sphere of no size", sphere(0.0, MIDDLE)),
        ("a visible rectangle without width", Light { size: [0.0, 0.4], ..rect.clone() }),
        ("a visible sphere behind the camera", sphere(0.03, EYE - 0.1 * ahead)),
        ("a visible disk behind the camera", Light { radius: 0.05, ..flat(LightKind::Disk, EYE - 0.1 * ahead, ahead) }),
        ("a visible disk in front, seen from behind", flat(LightKind::Disk, EYE + 0.1 * ahead, ahead)),
        ("a visible sphere around the camera", sphere(0.09, EYE)),
    ];
    for (case, light) in &invisible {
        let seen = Light { visible: true, ..light.clone() };
        let traced = [light, &seen].map(|light| traced(&stage.scene, light, 0, 4, Layer::Direct));
        let error = different(&first_hand(&seen), &first_hand(light)).max(different(&traced[0], &traced[1]));
        row(case, "as if it were not visible", 0.0, error);
    }
    let filling = [
        ("a visible sphere, 1e-6 m before the camera", sphere(0.1, EYE + (0.1 + 1e-6) * ahead)),
        ("a visible rectangle, 1e-6 m before the camera", flat(LightKind::Rect, EYE + 1e-6 * ahead, -ahead)),
        (
            "a visible disk of 1e6 m before the camera",
            Light { radius: 1e6, ..flat(LightKind::Disk, EYE + 0.01 * ahead, -ahead) },
        ),
    ];
    for (case, light) in &filling {
        let seen = Light { visible: true, ..light.clone() };
        let radiance = light.projected_area().unwrap().recip() as f32;
        let relit_and_traced =
            |light: &Light| [first_hand(light), traced(&stage.scene, light, 0, 4, Layer::Direct)].concat();
        let want: Vec<_> = relit_and_traced(light).iter().map(|p| p.map(|behind| radiance + behind)).collect();
        let error = apart(&relit_and_traced(&seen), &want);
        row(case, "its radiance in every pixel, besides what is behind", 1e-5, error);
    }
    let bright = Light { intensity: 1e30, ..sphere(0.1, MIDDLE) };
    let plain = Light { intensity: 1.0, ..bright.clone() };
    let error = relative(&over(&first_hand(&bright), 1e30), &over(&first_hand(&plain), 1.0));
    row("a sphere of 1e30 cd", "light of 1 cd, so many times", 1e-5, error);
    check("area lights whose light is known", &rows);
}

fn except(material: &str) -> Links {
    Links { except: vec![material.into()], ..Links::default() }
}

/// An even floor under suns.
#[test]
fn suns() {
    let gpu = gpu();
    let mut build = Build::default();
    let grey = build.material(grey());
    build.quad(DVec3::ZERO, 4.0 * DVec3::Z, 4.0 * DVec3::X, grey);
    let above = look(DVec3::Y, DVec3::ZERO, DVec3::NEG_Z, Projection::Orthographic { ymag: 1.0 });
    let setup = Setup::new(SIZE[0], SIZE[1]);
    let point = rig(vec![Light::point("l", DVec3::Y)]);
    let stage = Stage::new(build.scene(), &above, &point, &setup);
    let picture = |degrees: f64| {
        let sun = Light { angle: f64::to_radians(degrees), ..flat(LightKind::Directional, DVec3::ZERO, DVec3::NEG_Y) };
        stage.relighter(&gpu, &rig(vec![sun]), &setup).linear(Layers::Direct).unwrap().to_vec()
    };
    let want = vec![[(ALBEDO / PI) as f32; 3]; (SIZE[0] * SIZE[1]) as usize];
    let mut rows = Vec::new();
    for degrees in [0.0, 1e-9, 1e-3, 0.53, 90.0, 180.0] {
        let case = format!("a sun of {degrees} degrees and 1 lux");
        rows.push(Row::new(case, "ρ/π on a floor that faces it", 1e-3, apart(&picture(degrees), &want)));
    }
    check("suns", &rows);
}

/// Filters that let all light through.
#[test]
fn filters() {
    let gpu = gpu();
    let stage = stage();
    let folder = tempfile::tempdir().unwrap();
    let first_hand = first_hand(&stage, &gpu);
    let read = |filter: &str| {
        let text = format!(
            "[[light]]\nname = \"l\"\nkind = \"spot\"\nposition = [0, 0.5, 0]\ndirection = [0, -1, 0]\n\
            intensity = 1\n{filter}"
        );
        Rig::from_toml(&text, RigFiles::new(folder.path())).unwrap().lights.remove(0)
    };
    let plain = first_hand(&read(""));
    std::fs::write(folder.path().join("even.ies"), "TILT=NONE\n1 -1 1 1 1 1 2 0 0 0 1 1 9 0 0 250\n").unwrap();
    let asked = "as without it, to the last bit";
    let mut rows = Vec::new();
    let mut row = |case: String, filter: &str| {
        rows.push(Row::new(case, asked, 0.0, different(&first_hand(&read(filter)), &plain)));
    };
    row("an IES profile with one angle".into(), "ies = \"even.ies\"");
    let sides: &[u32] = if full() { &[1, 8192] } else { &[1] };
    for side in sides {
        let name = format!("{side}.png");
        image::RgbImage::from_pixel(*side, *side, image::Rgb([255; 3])).save(folder.path().join(&name)).unwrap();
        row(format!("a white gobo of {side}x{side} pixels"), &format!("gobo = {{ image = \"{name}\", scale = 2 }}"));
    }
    check("filters of lights", &rows);
}
