//! IES profiles, gobos and barn doors: relit, traced by the path tracer, and in files.

mod common;
mod support;

use std::path::Path;

use common::stage::{Setup, Stage, rig};
use common::{assert_near, gpu, shipped, transfer};
use glam::{DVec3, Vec3};
use relume::reference::path_tracer::{Filter, Half, Layer, PathTracer, Settings};
use relume::relight::{Layers, VisibilityMethod};
use relume::scene::light_filter::{BarnDoors, Gobo, RigFiles};
use relume::scene::{Light, LightFilter, LightKind, Rig, Scene};
use support::write;

/// An IES file of type C with one plane.
fn ies(vertical: &[f64], candela: &[f64]) -> String {
    let words = |numbers: &[f64]| numbers.iter().map(|x| format!("{x} ")).collect::<String>();
    let count = vertical.len();
    format!(
        "IESNA:LM-63-2002\r\n[TEST] made here\r\nTILT=NONE\r\n1 -1 1 {count} 1 1 2 0 0 0\r\n1 1 40\r\n{}\r\n0\r\n{}\r\n",
        words(vertical),
        words(candela)
    )
}

fn png(width: u32, height: u32, color: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image = image::RgbaImage::from_fn(width, height, |x, y| image::Rgba(color(x, y)));
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn gobo(folder: &Path, name: &str, image: &[u8]) -> Gobo {
    write(folder, name, image);
    let image = RigFiles::new(folder).image(name).unwrap();
    Gobo { image, rotation: 0.0, scale: 1.0, tint: Vec3::ONE }
}

fn profile(folder: &Path, text: &str) -> LightFilter {
    write(folder, "lamp.ies", text.as_bytes());
    LightFilter { ies: Some(RigFiles::new(folder).profile("lamp.ies").unwrap()), ..LightFilter::default() }
}

fn spot() -> Light {
    Light {
        kind: LightKind::Spot,
        direction: DVec3::new(-0.5, -0.8, -0.3).normalize(),
        outer_angle: 0.7,
        intensity: 30.0,
        ..Light::point("spot", DVec3::new(0.6, 1.6, 0.5))
    }
}

/// Balls before mirrors, with indirect light.
fn balls(setup: &Setup) -> Stage {
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let camera = scene.cameras[0].clone();
    let mut stage = Stage::new(scene, &camera, &rig(vec![spot()]), setup);
    stage.transfer = Some(transfer::dense(&stage, &transfer::settings(400, 80, 64)));
    stage
}

/// The halves of a gobo give the halves of a light, in direct, mirrored and indirect light, near and far.
#[test]
fn parts_of_a_gobo_sum_to_the_light() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    let traced = Setup::new(32, 24);
    let stage = balls(&traced);
    let half = |name: &str, lit: std::ops::Range<u32>| {
        let image = png(8, 8, |x, _| if lit.contains(&x) { [255; 4] } else { [0, 0, 0, 255] });
        LightFilter { gobo: Some(gobo(folder.path(), name, &image)), ..LightFilter::default() }
    };
    let halves = [half("left.png", 0..4), half("right.png", 4..8)];
    let near = Light { position: DVec3::new(0.6, 0.15, 0.5), direction: DVec3::NEG_Y, outer_angle: 1.3, ..spot() };
    let wide = Light { radius: 0.1, ..spot() };
    let shadowless = Light { shadows: false, ..spot() };
    let mapped = Setup { visibility: VisibilityMethod::Map, ..Setup::new(32, 24) };
    for (what, light, setup) in [
        ("spot", spot(), &traced),
        ("near the floor", near, &traced),
        ("with a radius", wide, &traced),
        ("without shadows", shadowless, &traced),
        ("by shadow maps", spot(), &mapped),
    ] {
        for layers in [Layers::Direct, Layers::Reflection, Layers::Indirect] {
            let picture = |filter: &LightFilter| {
                let rig = rig(vec![Light { filter: filter.clone(), ..light.clone() }]);
                stage.relighter(&gpu, &rig, setup).linear(layers).unwrap().to_vec()
            };
            let whole = picture(&LightFilter::default());
            let [left, right] = halves.each_ref().map(picture);
            let total = |image: &[[f32; 3]]| image.iter().flatten().map(|&x| f64::from(x)).sum::<f64>();
            let all = total(&whole);
            assert!(all > 0.0 || layers == Layers::Reflection, "{what}, {layers:?}");
            if what == "spot" && layers != Layers::Reflection {
                let share = total(&left) / all;
                assert!((0.02..0.98).contains(&share), "{layers:?}: a half gives {share}");
            }
            let [mut errors, mut squares] = [0.0; 2];
            for (i, pixel) in whole.iter().enumerate() {
                for c in 0..3 {
                    let sum = f64::from(left[i][c] + right[i][c]);
                    // Half precision of both factors.
                    let allowed = 1.5e-3 * f64::from(pixel[c]) + 1e-4 * all / whole.len() as f64;
                    let error = (sum - f64::from(pixel[c])).abs();
                    errors += error * error;
                    squares += f64::from(pixel[c]).powi(2);
                    let is_near = error <= allowed || !light.is_punctual();
                    assert!(is_near, "{what}, {layers:?}: {sum}, want {}", pixel[c]);
                }
            }
            // The halves of an area light may have other numbers of points than the whole.
            assert!(errors.sqrt() <= 0.01 * squares.sqrt(), "{what}, {layers:?}: off by {errors} of {squares}");
        }
    }
}

/// A profile that is the same in all directions, fully open doors and a white gobo change nothing, to the last bit.
#[test]
fn neutral_filters_change_nothing() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    let setup = Setup::new(32, 24);
    let stage = balls(&setup);
    let picture = |light: Light| {
        let rig = rig(vec![light]);
        stage.relighter(&gpu, &rig, &setup).linear(Layers::All).unwrap().to_vec()
    };
    let point = || Light { kind: LightKind::Point, ..spot() };
    let constant = profile(folder.path(), &ies(&[0.0, 90.0, 180.0], &[7.0; 3]));
    assert_eq!(picture(Light { filter: constant, ..point() }), picture(point()));
    let open = LightFilter {
        barn_doors: Some(BarnDoors { angles: [std::f64::consts::FRAC_PI_2; 4], softness: 0.1 }),
        gobo: Some(gobo(folder.path(), "white.png", &png(1, 1, |_, _| [255; 4]))),
        ..LightFilter::default()
    };
    assert_eq!(picture(Light { filter: open, ..spot() }), picture(spot()));
}

/// Relit and path-traced direct light agree pixel by pixel under every kind of filter.
#[test]
fn the_path_tracer_has_the_same_filters() {
    let gpu = gpu();
    let folder = tempfile::tempdir().unwrap();
    let setup = Setup::new(48, 36);
    let stage = balls(&setup);
    let image =
        png(16, 12, |x, y| [(16 * x) as u8, 255 - (20 * y) as u8, if (x + y) % 2 == 0 { 255 } else { 40 }, 255]);
    let turned = Gobo {
        rotation: 0.4,
        scale: 0.7,
        tint: Vec3::new(1.0, 0.5, 0.25),
        ..gobo(folder.path(), "colours.png", &image)
    };
    let doors = BarnDoors { angles: [0.3, 0.2, 0.5, 0.1], softness: 0.1 };
    let lamp = profile(folder.path(), &ies(&[0.0, 30.0, 60.0, 90.0], &[100.0, 80.0, 300.0, 20.0]));
    let filters = [
        LightFilter { gobo: Some(turned.clone()), ..LightFilter::default() },
        LightFilter { barn_doors: Some(doors), ..LightFilter::default() },
        lamp.clone(),
        LightFilter { gobo: Some(turned), barn_doors: Some(doors), ..lamp },
    ];
    for filter in filters {
        let all = rig(vec![Light { filter, ..spot() }]);
        let got = stage.relighter(&gpu, &all, &setup).linear(Layers::Direct).unwrap().to_vec();
        let settings = Settings {
            width: 48,
            height: 36,
            layers: 4,
            max_bounces: Some(0),
            filter: Filter::Centre,
            bounce_layers: 0,
            light_layers: false,
            seed: 1,
        };
        let camera = stage.framebuffer.camera.clone();
        let film = PathTracer::new(&stage.scene, &camera, &all, &settings).trace(1, &|| false, &|_| ());
        let want = film.layer(Half::Both, Layer::Direct);
        let brightest = want.iter().flatten().fold(0f32, |m, &x| m.max(x));
        assert!(brightest > 0.0, "{all:?}");
        for (got, want) in got.iter().flatten().zip(want.iter().flatten()) {
            assert!((got - want).abs() <= 1e-3 * brightest, "{got}, want {want} under {all:?}");
        }
    }
}

/// A lamp gives what its table says, from below and from the side, through range and decay start.
#[test]
fn a_lamp_shines_as_its_file_says() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "lamp.ies", ies(&[0.0, 90.0, 180.0], &[200.0, 100.0, 0.0]).as_bytes());
    let rig = write(
        folder.path(),
        "rig.toml",
        b"[[light]]\nname = \"lamp\"\nkind = \"point\"\nposition = [0, 2, 0]\nies = \"lamp.ies\"\n",
    );
    let light = Rig::load(&rig).unwrap().lights.remove(0);
    assert_eq!((light.intensity, light.direction), (200.0, DVec3::NEG_Y));
    let filter = relume::scene::light_filter::PosedFilter::new(&light).unwrap();
    for (direction, candela) in [(Vec3::NEG_Y, 200.0), (Vec3::X, 100.0), (Vec3::NEG_Z, 100.0), (Vec3::Y, 0.0)] {
        assert_near(light.intensity * f64::from(filter.factor(direction).y), candela, 1e-6, format!("{direction}"));
    }
}

#[test]
fn filters_read_back_equal() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("sub")).unwrap();
    write(folder.path(), "leaves.png", &png(4, 2, |x, _| [50 * x as u8, 9, 9, 255]));
    write(folder.path(), "lamp.ies", ies(&[0.0], &[3.0]).as_bytes());
    let text = "[[light]]\nname = \"a\"\nkind = \"spot\"\nposition = [0, 0, 0]\ndirection = [0, 0, -1]\nies = \"lamp.ies\"\n\
         gobo = { image = \"leaves.png\", rotate_deg = 30, scale = 2.5, tint = [1, 0.5, 0.25] }\n\
         barn_doors_deg = [80, 70, -10, 90]\nbarn_doors_soft_deg = 2.5\ndecay_start = 0.5\n";
    let read = Rig::load(&write(folder.path(), "rig.toml", text.as_bytes())).unwrap();
    for to in ["again.toml", "sub/again.toml"] {
        let to = folder.path().join(to);
        read.save(&to).unwrap();
        assert_eq!(Rig::load(&to).unwrap(), read, "{}", std::fs::read_to_string(&to).unwrap());
    }
    assert!(std::fs::read_to_string(folder.path().join("sub/again.toml")).unwrap().contains("\"../lamp.ies\""));
}

#[test]
fn bad_filters_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "broken.ies", b"IESNA:LM-63-2002\nTILT=NONE\n1 2 3\n");
    write(folder.path(), "broken.png", b"\x89PNG\r\n\x1a\n");
    write(folder.path(), "white.png", &png(1, 1, |_, _| [255; 4]));
    for (key, says) in [
        ("ies = \"none.ies\"", "none.ies"),
        ("ies = \"broken.ies\"", "broken.ies: "),
        ("gobo = { image = \"broken.png\" }", "broken.png: the image cannot be decoded"),
        ("gobo = { image = \"white.png\", scale = 0 }", "scale is 0"),
        ("gobo = { image = \"white.png\", tint = [1, -1, 1] }", "tint must be finite and not negative"),
        ("gobo = { image = \"white.png\", tint = [1e5, 1, 1] }", "tint must lie in 0..=1"),
        ("gobo = { image = \"white.png\", blur = 1 }", "unknown field `blur`"),
        ("barn_doors_deg = [1, 2, 3, 91]", "barn_doors_deg must lie in -90.0..=90.0"),
        ("barn_doors_soft_deg = 0", "barn_doors_soft_deg is 0"),
        ("decay_start = -1", "decay_start is -1"),
    ] {
        let text =
            format!("[[light]]\nname = \"a\"\nkind = \"spot\"\nposition = [0, 0, 0]\ndirection = [0, 0, -1]\n{key}\n");
        let error = Rig::load(&write(folder.path(), "rig.toml", text.as_bytes())).unwrap_err().chain();
        assert!(error.contains(says) && error.contains("line 6"), "{key}: {error}");
    }
}
