//! What explains a picture is true of it: false colours, histogram, probe, contact sheet, channels.

mod common;

use common::stage::{Setup, Stage};
use common::{Gpu, gpu, shipped};
use glam::{DVec3, Vec3};
use relume::bake::channels::Channel;
use relume::image::luminance;
use relume::relight::output::exposure::{stop_color, stops};
use relume::relight::output::inspect::Inspection;
use relume::relight::output::sheet::Grid;
use relume::relight::{Layers, Picture, Relighter, Request, ToneMap};
use relume::scene::{LightGroup, Scene};
use relume::shared::{BINS_PER_STOP, HISTOGRAM_BINS};

const EXPOSURE: f32 = 0.7;

fn setup() -> Setup {
    // Neither is a multiple of a tile's side.
    Setup::new(90, 61)
}

fn stage(name: &str) -> Stage {
    let scene = Scene::load(&shipped(name)).expect("shipped scenes load");
    let (camera, rig) = (scene.cameras[0].clone(), scene.rig.clone());
    Stage::new(scene, &camera, &rig, &setup())
}

fn relighter(gpu: &Gpu, stage: &Stage) -> Relighter {
    stage.relighter(gpu, &stage.scene.rig, &setup())
}

/// Where a value lies between two bands rounding decides; elsewhere it must not.
fn is_clear(bands: f32) -> bool {
    (bands - bands.round()).abs() > 1e-3
}

#[test]
fn false_colours_are_stops_of_luminance() {
    let gpu = gpu();
    let stage = stage("balls-2.glb");
    let mut relighter = relighter(&gpu, &stage);
    let linear = relighter.linear(Picture::Whole).unwrap().to_vec();
    let request = Request { exposure: EXPOSURE, tone_map: ToneMap::FalseColor, ..Request::default() };
    let shown = relighter.display(request).unwrap();
    let mut colors = std::collections::BTreeSet::new();
    for (&c, shown) in linear.iter().zip(shown) {
        let stops = stops(luminance(c) * EXPOSURE.exp2());
        let want = stop_color(stops);
        colors.insert(want);
        assert!(shown[..3] == want || !is_clear(stops + 0.5), "{stops}: {shown:?}, not {want:?}");
    }
    assert!(colors.len() > 5, "the picture has light and shade: {}", colors.len());
}

#[test]
fn histogram_and_probe_tell_what_the_pixels_are() {
    let gpu = gpu();
    let stage = stage("balls-2.glb");
    let mut relighter = relighter(&gpu, &stage);
    let linear = relighter.linear(Picture::Whole).unwrap().to_vec();
    let mut want = vec![0u32; HISTOGRAM_BINS as usize];
    let mut unclear = 0;
    for &c in &linear {
        let bin = stops(luminance(c) * EXPOSURE.exp2()) * BINS_PER_STOP as f32;
        unclear += u32::from(!is_clear(bin));
        want[(bin.floor() + (HISTOGRAM_BINS / 2) as f32).clamp(0.0, (HISTOGRAM_BINS - 1) as f32) as usize] += 1;
    }
    for probe in [[0, 0], [89, 60], [41, 33]] {
        let inspection = Inspection { histogram: true, probe: Some(probe) };
        relighter.display(Request { exposure: EXPOSURE, inspection, ..Request::default() }).unwrap();
        let (pixel, radiance) = relighter.probed().unwrap();
        assert_eq!((pixel, radiance.to_array()), (probe, linear[(probe[1] * 90 + probe[0]) as usize]));
    }
    let counts = relighter.histogram().unwrap();
    assert_eq!(counts.iter().sum::<u32>(), 90 * 61, "every pixel once");
    let apart: u32 = counts.iter().zip(&want).map(|(a, b)| a.abs_diff(*b)).sum();
    assert!(apart <= 2 * unclear, "{apart} pixels in other bins, {unclear} on their edges");
    assert!(counts.iter().filter(|&&count| count > 0).count() > 10, "{counts:?}");
    // Outside of the picture there is nothing to read, and a new picture forgets.
    let inspection = Inspection { histogram: false, probe: Some([90, 0]) };
    relighter.display(Request { exposure: EXPOSURE + 1.0, inspection, ..Request::default() }).unwrap();
    assert!(relighter.probed().is_none() && relighter.histogram().is_none());
}

#[test]
fn cells_of_the_contact_sheet_are_their_lights_made_smaller() {
    let gpu = gpu();
    let stage = stage("balls-16.glb");
    let mut relighter = relighter(&gpu, &stage);
    let check = |relighter: &mut Relighter, what: &str| {
        let count = relighter.rig().lights.len();
        let grid = Grid::new(count, [90, 61]);
        let lights: Vec<Vec<[f32; 3]>> =
            (0..count).map(|i| relighter.linear(Picture::Light(i)).unwrap().to_vec()).collect();
        let sheet = relighter.linear(Picture::Sheet).unwrap().to_vec();
        for (index, light) in lights.iter().enumerate() {
            let [left, top, width, height] = grid.cell(index);
            for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
                let (columns, rows) = (x * 90 / width..(x + 1) * 90 / width, y * 61 / height..(y + 1) * 61 / height);
                let area = (columns.len() * rows.len()) as f64;
                let pixels = rows.flat_map(|y| columns.clone().map(move |x| (y * 90 + x) as usize));
                let mean = pixels.map(|i| DVec3::from(light[i].map(f64::from))).sum::<DVec3>() / area;
                let got = DVec3::from(sheet[((top + y) * 90 + left + x) as usize].map(f64::from));
                assert!((got - mean).length() <= 1e-5 * mean.length() + 1e-12, "{what}, light {index}: {got} {mean}");
            }
        }
    };
    check(&mut relighter, "at first");
    let mut rig = stage.scene.rig.clone();
    rig.lights[3].position.x += 0.3;
    rig.lights[5].stops += 1.0;
    rig.lights[7].enabled = false;
    relighter.set_rig(&rig).unwrap();
    check(&mut relighter, "after edits");
    // Only the cell of a light that moves is drawn again.
    relighter.linear(Picture::Sheet).unwrap();
    rig.lights[2].position.y += 0.2;
    relighter.set_rig(&rig).unwrap();
    relighter.linear(Picture::Sheet).unwrap();
    let cells = relighter.times().iter().filter(|time| time.name == "contact sheet").count();
    assert_eq!(cells, 1);
    // Another picture in between leaves nothing of the sheet.
    relighter.linear(Picture::Whole).unwrap();
    check(&mut relighter, "after a whole picture");
    // Nine cells are larger than sixteen.
    relighter.linear(Picture::Sheet).unwrap();
    rig.lights.truncate(9);
    relighter.set_rig(&rig).unwrap();
    let fewer = relighter.linear(Picture::Sheet).unwrap().to_vec();
    relighter.linear(Picture::Whole).unwrap();
    let anew = relighter.linear(Picture::Sheet).unwrap();
    let grid = Grid::new(9, [90, 61]);
    for [left, top, width, height] in (0..9).map(|index| grid.cell(index)) {
        let row = |y: u32| (y * 90 + left) as usize..(y * 90 + left + width) as usize;
        assert!((top..top + height).all(|y| fewer[row(y)] == anew[row(y)]), "the cell at {left}, {top}");
    }
}

/// A red light in a blue group is black, though neither is.
#[test]
fn lights_that_are_black_by_their_group_are_not_waited_for() {
    let gpu = gpu();
    let stage = stage("balls-16.glb");
    let mut relighter = relighter(&gpu, &stage);
    let mut rig = stage.scene.rig.clone();
    rig.groups.push(LightGroup { color: Vec3::Z, ..LightGroup::new("blue") });
    for (light, color) in rig.lights.iter_mut().zip([Vec3::X, Vec3::ONE]) {
        (light.group, light.color) = (Some(rig.groups.len() - 1), color);
    }
    relighter.set_rig(&rig).unwrap();
    for _ in 0..rig.lights.len() {
        relighter.prepare(Layers::All).unwrap();
    }
    assert_eq!(relighter.pending(Layers::All), 0);
}

#[test]
fn channels_are_what_the_camera_sees() {
    let stage = stage("balls-2.glb");
    let camera = &stage.scene.cameras[0];
    let space = stage.scene.space;
    let channel = |channel, layer| stage.framebuffer.channel(channel, layer, space);
    let (positions, normals) = (channel(Channel::Position, 0), channel(Channel::Normal, 0));
    let distances = channel(Channel::Distance, 0);
    for (i, position) in positions.iter().enumerate() {
        let (x, y) = ((i % 90) as f64 + 0.5, (i / 90) as f64 + 0.5);
        let (eye, direction) = camera.ray(x / 90.0, y / 61.0, 90.0 / 61.0);
        let Some(position) = position else {
            assert!(normals[i].is_none());
            continue;
        };
        let along = position.as_dvec3() - eye;
        assert!((along.normalize() - direction).length() < 1e-4, "pixel {i}");
        assert!((along.length() - f64::from(distances[i].unwrap().x)).abs() < 1e-4 * along.length());
        assert!((normals[i].unwrap().length() - 1.0).abs() < 1e-5);
    }
    // Four of the balls are mirrors: what they show is a layer of its own, but for mirrors in mirrors.
    let layers = channel(Channel::Layers, 0);
    let seen = channel(Channel::Normal, 1);
    assert!(layers.iter().zip(&seen).all(|(layers, seen)| layers.unwrap().x >= 2.0 || seen.is_none()));
    assert!(seen.iter().flatten().count() > 100);
    let roughness = channel(Channel::Roughness, 0);
    assert!(roughness.iter().flatten().all(|r| (0.0..=1.0).contains(&r.x)));
    assert!(roughness.iter().flatten().count() > 1000);
}
