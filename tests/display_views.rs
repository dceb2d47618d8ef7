//! Views of OpenColorIO configurations: values beside those of OpenColorIO itself, pictures of the device beside them,
//! and damaged configurations.

mod command;
mod common;

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use command::{Run, folder, read_exr, relume, shipped};
use common::random::Random;
use common::stage::{Setup, Stage};
use common::{gpu, largest, mutants};
use glam::Vec3;
use relume::image::display_view::{DisplayConfig, DisplayView};
use relume::reference::composite;
use relume::relight::output::display_table;
use relume::relight::{Picture, Request, ToneMap};
use relume::scene::Scene;
use relume::shared::OUTPUT_TABLE;

/// Exposed scene-linear Rec. 709: grey, colours inside and outside of displays' gamuts, light brighter than white,
/// noise below black.
const COLORS: [[f32; 3]; 8] = [
    [0.18, 0.18, 0.18],
    [1.0, 0.5, 0.25],
    [0.02, 0.3, 0.9],
    [12.0, 3.0, 0.1],
    [0.001, 0.0005, 0.002],
    [4.0, 4.0, 4.0],
    [-0.01, 0.2, 0.05],
    [0.0, 0.0, 0.0],
];

/// Values of OpenColorIO 2.6.0 for [`COLORS`], made with its Python package.
struct Truth {
    display: &'static str,
    view: &'static str,
    values: [[f32; 3]; 8],
}

const ACES_2: [Truth; 2] = [
    Truth {
        display: "sRGB - Display",
        view: "ACES 2.0 - SDR 100 nits (Rec.709)",
        values: [
            [0.349188, 0.349188, 0.349188],
            [0.724308, 0.571840, 0.460304],
            [0.166374, 0.453939, 0.726249],
            [1.000007, 0.878628, 0.778207],
            [0.000044, 0.000020, 0.000089],
            [0.899869, 0.899869, 0.899869],
            [0.043839, 0.352923, 0.194406],
            [0.0, 0.0, 0.0],
        ],
    },
    Truth {
        display: "Rec.2100-PQ - Display",
        view: "ACES 2.0 - HDR 1000 nits (P3 D65)",
        values: [
            [0.329837, 0.329837, 0.329837],
            [0.486270, 0.450585, 0.399776],
            [0.322923, 0.381123, 0.484135],
            [0.698256, 0.637215, 0.536315],
            [0.003669, 0.002734, 0.005691],
            [0.639800, 0.639800, 0.639800],
            [0.227414, 0.324826, 0.232075],
            [0.000001, 0.000001, 0.000001],
        ],
    },
];

/// Views of [`write_studio`].
const STUDIO: [Truth; 2] = [
    Truth {
        display: "monitor",
        view: "Film",
        values: [
            [0.234856, 0.258785, 0.273371],
            [0.417536, 0.354711, 0.309457],
            [0.083831, 0.300296, 0.416566],
            [0.748039, 0.564992, 0.248163],
            [0.005733, 0.006322, 0.026967],
            [0.610010, 0.607511, 0.609845],
            [0.003701, 0.251777, 0.159531],
            [0.0, 0.0, 0.0],
        ],
    },
    Truth {
        display: "monitor",
        view: "Plain",
        values: [
            [0.458656, 0.458656, 0.458656],
            [1.000007, 0.729742, 0.532521],
            [0.168944, 0.578535, 0.953242],
            [3.094099, 1.647673, 0.351119],
            [0.043288, 0.031589, 0.059319],
            [1.877874, 1.877874, 1.877874],
            [0.0, 0.481157, 0.256225],
            [0.0, 0.0, 0.0],
        ],
    },
];

/// A configuration like a studio's: primaries of its own, a look, and a three-dimensional table in a file.
const STUDIO_CONFIG: &str = "\
ocio_profile_version: 2

search_path: luts
strictparsing: true
roles:
  aces_interchange: ACES2065-1
  default: linear
  scene_linear: linear

displays:
  monitor:
    - !<View> {name: Film, colorspace: film, looks: cooler}
    - !<View> {name: Plain, colorspace: video}

looks:
  - !<Look>
    name: cooler
    process_space: linear
    transform: !<CDLTransform> {slope: [0.9, 1, 1.1], power: [1.1, 1, 0.95]}

colorspaces:
  - !<ColorSpace>
    name: ACES2065-1
    to_scene_reference: !<MatrixTransform> {matrix: [2.52168618674388, -1.13413098823972, -0.387555198504164, 0, \
-0.276479914229922, 1.37271908766826, -0.0962391734383340, 0, -0.0153780649660342, -0.152975335867399, \
1.16835340083343, 0, 0, 0, 0, 1]}

  - !<ColorSpace>
    name: linear

  - !<ColorSpace>
    name: video
    from_scene_reference: !<ExponentTransform> {value: [2.2, 2.2, 2.2, 1], direction: inverse}

  - !<ColorSpace>
    name: film
    from_scene_reference: !<GroupTransform>
      children:
        - !<AllocationTransform> {allocation: lg2, vars: [-8, 6, 0.00390625]}
        - !<FileTransform> {src: film.cube, interpolation: tetrahedral}
";

fn write_studio(folder: &Path) -> PathBuf {
    let side = 5;
    let mut table = format!("LUT_3D_SIZE {side}\n");
    for i in 0..side * side * side {
        let place = [i % side, i / side % side, i / (side * side)].map(|x| f64::from(x) / f64::from(side - 1));
        let mean = place.iter().sum::<f64>() / 3.0;
        let [r, g, b] = place.map(|x| (0.9 * x + 0.1 * mean).powf(1.5));
        table += &format!("{r:.4} {g:.4} {b:.4}\n");
    }
    std::fs::create_dir(folder.join("luts")).unwrap();
    std::fs::write(folder.join("luts/film.cube"), table).unwrap();
    let path = folder.join("studio.ocio");
    std::fs::write(&path, STUDIO_CONFIG).unwrap();
    path
}

fn load(name: impl AsRef<Path>) -> DisplayConfig {
    DisplayConfig::load(name.as_ref().to_str().unwrap()).unwrap()
}

fn assert_equal(config: &DisplayConfig, truths: &[Truth]) {
    for Truth { display, view, values } in truths {
        let mut colors = COLORS;
        config.view(Some(display), Some(view)).unwrap().apply(&mut colors);
        for ((got, want), color) in colors.iter().zip(values).zip(COLORS) {
            let error = largest((Vec3::from(*got) - Vec3::from(*want)).as_dvec3().abs().to_array());
            // The truth is rounded to 5e-7; a code of 10 bits is 1e-3.
            assert!(error < 1e-5, "{view}: {color:?} is {got:?}, not {want:?}");
        }
    }
}

#[test]
fn values_are_those_of_opencolorio() {
    let aces = load("ocio://default");
    assert_eq!(aces.displays()[0], "sRGB - Display");
    assert_equal(&aces, &ACES_2);
    let folder = folder();
    let studio = load(write_studio(folder.path()));
    assert_eq!(
        (studio.displays(), studio.views("monitor")),
        (vec!["monitor".into()], vec!["Film".into(), "Plain".into()])
    );
    assert_equal(&studio, &STUDIO);
}

/// A configuration that does not name its interchange space, as those before OpenColorIO 2: found by its colours.
#[test]
fn primaries_are_found_without_roles() {
    let folder = folder();
    let path = write_studio(folder.path());
    let without = STUDIO_CONFIG.replace("  aces_interchange: ACES2065-1\n", "");
    std::fs::write(&path, &without).unwrap();
    assert_equal(&load(&path), &STUDIO);
    // And where no space is known, it is an error that says what to do.
    let unknown = without.replace("2.52168618674388", "2.7").replace("1.37271908766826", "1.5");
    std::fs::write(&path, unknown).unwrap();
    let error = load(&path).view(None, None).unwrap_err().chain();
    assert!(error.contains("studio.ocio") && error.contains("interchange roles"), "{error}");
}

#[test]
fn missing_views_and_files_are_named() {
    let folder = folder();
    let path = write_studio(folder.path());
    let studio = load(&path);
    for (display, view, says) in [
        (Some("wall"), None, "has no display \"wall\"; it has monitor"),
        (None, Some("Print"), "has no view \"Print\"; it has Film, Plain"),
    ] {
        let error = studio.view(display, view).unwrap_err().chain();
        assert!(error.contains(says) && error.contains("studio.ocio"), "{error}");
    }
    assert_eq!(studio.view(None, Some("plain")).unwrap().name(), "Plain", "names have no case in OpenColorIO");
    std::fs::remove_file(folder.path().join("luts/film.cube")).unwrap();
    let error = load(&path).view(None, None).unwrap_err().chain();
    assert!(error.contains("film.cube"), "{error}");
    let error = DisplayConfig::load("nosuch.ocio").err().unwrap().chain();
    assert!(error.contains("nosuch.ocio") && error.contains("No such file"), "{error}");
    let error = DisplayConfig::load("ocio://nosuch").err().unwrap().chain();
    assert!(error.contains("ocio://nosuch"), "{error}");
}

#[test]
fn damaged_configurations_are_errors() {
    let folder = folder();
    let path = write_studio(folder.path());
    let mut random = Random::new(11);
    let mut good = 0;
    for _ in 0..mutants() {
        let lines: Vec<&str> = STUDIO_CONFIG.lines().collect();
        let mut bytes = STUDIO_CONFIG.as_bytes().to_vec();
        match random.below(4) {
            0 => {
                let mut lines = lines;
                lines.remove(random.below(lines.len()));
                bytes = lines.join("\n").into_bytes();
            }
            1 => {
                let mut lines = lines;
                lines.insert(random.below(lines.len()), lines[random.below(lines.len())]);
                bytes = lines.join("\n").into_bytes();
            }
            2 => bytes.truncate(random.below(bytes.len())),
            _ => {
                for _ in 0..=random.below(3) {
                    let at = random.below(bytes.len());
                    bytes[at] = random.pick(b"\0\n\t \"#-09e:[]{}!<>*&zA\xff");
                }
            }
        }
        std::fs::write(&path, bytes).unwrap();
        match DisplayConfig::load(path.to_str().unwrap()).and_then(|config| config.view(None, None)) {
            Ok(view) => {
                good += 1;
                view.apply(&mut COLORS.clone());
            }
            Err(error) => assert!(error.to_string().contains("studio.ocio"), "{error}"),
        }
    }
    assert!(good > mutants() / 20, "only {good} were taken: they do not get far");
}

/// Largest error of a colour's channels in the device's table, codes of 8 bits.
fn table_errors(view: &DisplayView, colors: &[[f32; 3]]) -> Vec<f64> {
    let table = display_table::values(view);
    let mut want = colors.to_vec();
    view.apply(&mut want);
    let error = |(color, want): (&[f32; 3], [f32; 3])| {
        let got = composite::display(OUTPUT_TABLE, Vec3::from(*color).as_dvec3(), &table);
        let want = Vec3::from(want).clamp(Vec3::ZERO, Vec3::ONE).as_dvec3();
        255.0 * largest((got - want).abs().to_array())
    };
    let mut errors: Vec<f64> = colors.iter().zip(want).map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

/// The table is for the window. What it is off by, docs/desk.md says, from this test with `--nocapture`.
#[test]
fn the_table_is_close() {
    let view = load("ocio://default").view(None, None).unwrap();
    let mut random = Random::new(5);
    let greys: Vec<[f32; 3]> = (0..2000).map(|_| [random.magnitude(1e-3, 64.0) as f32; 3]).collect();
    // Of any brightness that a picture has, channels at most a factor of 3 apart; then any channels.
    let plausible: Vec<[f32; 3]> = (0..20_000)
        .map(|_| {
            let brightness = random.magnitude(4e-3, 16.0);
            [(); 3].map(|()| (brightness * random.between(1.0 / 3.0, 1.0)) as f32)
        })
        .collect();
    let any: Vec<[f32; 3]> = (0..20_000).map(|_| [(); 3].map(|()| random.magnitude(4e-3, 16.0) as f32)).collect();
    for (name, colors, most) in
        [("greys", greys, 0.25), ("plausible colours", plausible, 0.4), ("any colours", any, 2.0)]
    {
        let errors = table_errors(&view, &colors);
        let at = |share: f64| errors[(share * (errors.len() - 1) as f64) as usize];
        println!("{name}: median {:.3}, 99 % {:.3}, worst {:.3} codes of 8 bits", at(0.5), at(0.99), at(1.0));
        assert!(at(0.99) < most, "{name}: {}", at(0.99));
    }
}

/// The device's picture beside the one that is evaluated pixel by pixel, and after the view has changed.
#[test]
fn the_device_shows_the_view() {
    let gpu = gpu();
    let scene = Scene::load(&shipped("balls-2.glb")).unwrap();
    let (rig, camera) = (scene.rig.clone(), scene.cameras[0].clone());
    let setup = Setup::new(72, 48);
    let stage = Stage::new(scene, &camera, &rig, &setup);
    let mut relighter = stage.relighter(&gpu, &rig, &setup);
    let config = load("ocio://default");
    let exposure = -1.5f32;
    let linear = relighter.linear(Picture::Whole).unwrap().to_vec();
    let exposed: Vec<[f32; 3]> = linear.iter().map(|pixel| pixel.map(|value| exposure.exp2() * value)).collect();
    let mut pictures = Vec::new();
    for name in ["ACES 2.0 - SDR 100 nits (Rec.709)", "Un-tone-mapped", "ACES 2.0 - SDR 100 nits (Rec.709)"] {
        let tone_map = ToneMap::View(Arc::new(config.view(None, Some(name)).unwrap()));
        let request = Request { exposure, tone_map: tone_map.clone(), ..Request::default() };
        let picture = relighter.display(request).unwrap().to_vec();
        let want = tone_map.display8(exposed.clone());
        let apart = |(got, want): (&[u8; 4], &[u8; 3])| (0..3).map(|c| got[c].abs_diff(want[c])).max().unwrap();
        let far = picture.iter().zip(&want).filter(|pair| apart((pair.0, pair.1)) > 1).count();
        assert!(far <= picture.len() / 200, "{name}: {far} of {} pixels are off by more than a code", picture.len());
        pictures.push(picture);
    }
    assert_ne!(pictures[0], pictures[1]);
    assert_eq!(pictures[0], pictures[2]);
}

/// A PNG of 16 bits has the view's values, one of 8 bits the same rounded; only sRGB says that it is sRGB.
#[test]
fn pictures_have_the_values_of_the_view() {
    let folder = folder();
    let studio = write_studio(folder.path());
    let at = |name: &str| folder.path().join(name);
    let scene = shipped("balls-2.glb");
    let render = |output: &Path, arguments: &[&str]| {
        let mut command = relume();
        command.args(["render", "--size", "48x32", "--gi", "off", "--no-cache", "--exposure", "1"]);
        Run::of(command.arg(&scene).arg("-o").arg(output).args(arguments)).done();
    };
    render(&at("linear.exr"), &[]);
    let linear = read_exr(&at("linear.exr"));
    for (config, is_srgb) in [("ocio://default", true), (studio.to_str().unwrap(), false)] {
        let mut want: Vec<[f32; 3]> =
            linear.layers[0].pixels.iter().map(|pixel| pixel.map(|value| 2.0 * value)).collect();
        load(config).view(None, None).unwrap().apply(&mut want);
        for (bits, most) in [("8", 255.0), ("16", 65535.0)] {
            render(&at("a.png"), &["--ocio", config, "--png-bits", bits]);
            let mut reader = png::Decoder::new(BufReader::new(File::open(at("a.png")).unwrap())).read_info().unwrap();
            assert_eq!(reader.info().srgb.is_some(), is_srgb, "{config}");
            let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut bytes).unwrap();
            let values: Vec<f32> = match bits {
                "8" => bytes.iter().map(|&byte| byte.into()).collect(),
                _ => bytes.as_chunks::<2>().0.iter().map(|&pair| u16::from_be_bytes(pair).into()).collect(),
            };
            assert_eq!(values.len(), 3 * want.len());
            for (got, want) in values.iter().zip(want.as_flattened()) {
                assert!((got - most * want.clamp(0.0, 1.0)).abs() <= 0.51, "{config}, {bits} bits: {got}, not {want}");
            }
        }
    }
    let bad = [&["--view", "Film"][..], &["--ocio", "ocio://default", "--tonemap", "agx"], &["--png-bits", "12"]];
    for arguments in bad {
        let mut command = relume();
        Run::of(command.arg("render").arg(&scene).arg("-o").arg(at("b.png")).args(arguments)).refused(arguments[0]);
    }
    let mut command = relume();
    command.arg("render").arg(&scene).arg("-o").arg(at("b.png")).args(["--ocio", "nosuch.ocio"]);
    Run::of(&mut command).failed(&["nosuch.ocio"]);
}
