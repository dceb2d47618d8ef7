//! Lights of USD files: what relume writes and reads again, stages that other programs composed, and damaged files.

mod command;
mod common;

use std::path::{Path, PathBuf};

use command::{Run, folder, relume, shipped};
use common::mutants;
use common::random::Random;
use glam::{DVec3, Vec3};
use relume::scene::{Light, LightKind, Rig};

const RIG: &str = r#"
[[group]]
name = "rim"
stops = 0.5
color = [1, 0.9, 0.8]

[[light]]
name = "key light é"
kind = "spot"
position = [2.8, 3.8, 1.5]
direction = [-0.6, -0.7, -0.3]
kelvin = 4300
intensity = 60.0
stops = 1.5
inner_deg = 18.0
outer_deg = 28.0
group = "rim"

[[light]]
name = "bulb"
kind = "point"
position = [1, 2, 3]
intensity = 10
radius = 0.05
color = [0.2, 0.5, 1.0]
shadows = false

[[light]]
name = "tiny"
kind = "point"
position = [0, 2, 0]
intensity = 7
range = 10
ies = "lamp.ies"

[[light]]
name = "panel"
kind = "rect"
position = [0, 2.5, 0]
direction = [0.1, -1, 0.2]
up = [0, 0, 1]
width = 2.5
height = 1.25
radiance = [6, 7, 8]
spread_deg = 90
except = ["ball"]
no_shadow_from = ["glass", "leaf"]

[[light]]
name = 'di"s\c'
kind = "disk"
position = [0, 1.5, 2]
direction = [0, -1, 0]
radius = 0.3
intensity = 12
enabled = false

[[light]]
name = "sun"
kind = "sun"
direction = [0.3, -1, 0.2]
angle_deg = 0.53
intensity = 3

[[light]]
name = "far"
kind = "directional"
direction = [0, -1, 0]
intensity = 2

[[light]]
name = "sky"
kind = "dome"
map = "sky.png"
rotate_deg = 75
intensity = 0.25
"#;

const PROFILE: &str = "IESNA:LM-63-2002\nTILT=NONE\n1 -1 2 3 1 1 2 0 0 0 1 1 9\n0 45 90\n0\n50 25 0\n";

/// A folder with [`RIG`] and its files.
fn rig() -> (tempfile::TempDir, PathBuf) {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("rig.toml"), RIG).unwrap();
    std::fs::write(at("lamp.ies"), PROFILE).unwrap();
    let texels: Vec<[u8; 3]> = (0..64 * 32).map(|i| [i as u8, 90, 200]).collect();
    relume::image::png::write(&at("sky.png"), 64, 32, &texels).unwrap();
    let path = at("rig.toml");
    (folder, path)
}

fn light<'a>(rig: &'a Rig, name: &str) -> &'a Light {
    rig.lights.iter().find(|light| light.name == name).unwrap_or_else(|| panic!("no light {name}"))
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn what_is_written_is_read_again() {
    let (folder, path) = rig();
    let rig = Rig::load(&path).unwrap();
    let usda = folder.path().join("lights.usda");
    rig.save(&usda).unwrap();
    let exact = Rig::load(&usda).unwrap();
    assert_eq!((exact.groups, exact.lights), (rig.groups.clone(), rig.lights.clone()));
    // The same lights without the exact rig: all that UsdLux holds.
    let text = std::fs::read_to_string(&usda).unwrap();
    let without = write(folder.path(), "without.usda", &text.replace("relume_rig", "other"));
    let read = Rig::load(&without).unwrap();
    assert!(read.groups.is_empty());
    for (index, want) in rig.lights.iter().enumerate() {
        let got = light(&read, &want.name);
        assert_eq!((got.kind, got.enabled, got.shadows), (want.kind, want.enabled, want.shadows), "{}", want.name);
        assert_eq!((&got.links, &got.filter, &got.map), (&want.links, &want.filter, &want.map), "{}", want.name);
        // Numbers are in single precision.
        let near = |got: f64, want: f64| (got - want).abs() <= 2e-6 * want.abs().max(1e-3);
        assert!(
            got.scale().distance(rig.scale(index)) <= 2e-6 * rig.scale(index).length(),
            "{}: {}",
            want.name,
            got.scale()
        );
        assert!(got.position.distance(want.position) < 1e-12 && near(got.radius, want.radius), "{}", want.name);
        assert!(!want.has_direction() || got.direction.distance(want.direction) < 1e-12, "{}", want.name);
        assert!(near(got.angle, want.angle) && near(got.spread, want.spread) && near(got.turns(), want.turns()));
        if want.kind == LightKind::Spot {
            assert!(near(got.inner_angle, want.inner_angle) && near(got.outer_angle, want.outer_angle));
        }
        if want.kind == LightKind::Rect {
            assert!(got.size == want.size && got.axes()[1].distance(want.axes()[1]) < 1e-12);
        }
    }
    assert!(text.contains("colorTemperature = 4300\n") && text.contains("displayName = \"key light é\""), "{text}");
}

/// An edit by another program wins over the exact rig, and so does a light that it adds.
#[test]
fn edits_of_others_win() {
    let (folder, path) = rig();
    let usda = folder.path().join("lights.usda");
    Rig::load(&path).unwrap().save(&usda).unwrap();
    let text = std::fs::read_to_string(&usda).unwrap();
    let edited =
        write(folder.path(), "edited.usda", &text.replace("inputs:intensity = 40\n", "inputs:intensity = 80\n"));
    let read = Rig::load(&edited).unwrap();
    assert!(read.groups.is_empty() && (light(&read, "bulb").intensity - 20.0).abs() < 1e-6);
    let added = format!("{text}\ndef SphereLight \"more\"\n{{\n}}\n");
    let read = Rig::load(&write(folder.path(), "added.usda", &added)).unwrap();
    assert_eq!(read.lights.len(), 9);
    // Luminance 1 over a sphere of radius 0.5, the fallbacks, seen as a disk.
    assert!((light(&read, "more").intensity - std::f64::consts::PI * 0.25).abs() < 1e-6);
}

/// Centimetres, +z up, a place and a size from parents, a reference, and units in which nothing is normalized.
#[test]
fn stages_of_others() {
    let folder = folder();
    write(
        folder.path(),
        "lamp.usda",
        "#usda 1.0\n(defaultPrim = \"lamp\")\ndef Xform \"lamp\" {\n    def DiskLight \"Spot_A\" (displayName = \"Spot.A\") {}\n}\n",
    );
    let stage = r#"#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Z"
)
def Xform "World"
{
    def Xform "Big"
    {
        float3 xformOp:scale = (2, 2, 2)
        uniform token[] xformOpOrder = ["xformOp:scale"]
        def RectLight "Ceiling" (prepend apiSchemas = ["ShapingAPI", "ShadowAPI"])
        {
            color3f inputs:color = (1, 0.5, 0.25)
            float inputs:intensity = 500
            float inputs:exposure = 1
            float inputs:width = 100
            float inputs:height = 50
            bool inputs:shadow:enable = 0
            rel collection:lightLink:excludes = </World/Props/vase>
            rel collection:shadowLink:excludes = [</World/Props/glass>]
            double3 xformOp:translate = (10, 20, 125)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
        def SphereLight "Ball"
        {
            float inputs:intensity = 400
            bool inputs:normalize = 1
            float inputs:radius = 5
        }
        def SphereLight "Cone" (prepend apiSchemas = ["ShapingAPI"])
        {
            float inputs:shaping:cone:angle = 30
            float inputs:shaping:cone:softness = 0.5
            float inputs:intensity.timeSamples = { 1: 10, 2: 20 }
            bool treatAsPoint = 1
        }
    }
    def "Hidden"
    {
        token visibility = "invisible"
        def DistantLight "Sun" { }
        def DistantLight "Lux" { bool inputs:normalize = 1  float inputs:intensity = 7 }
    }
    def DomeLight_1 "Sky"
    {
        float inputs:intensity = 0.5
        double xformOp:rotateZ = 30
        uniform token[] xformOpOrder = ["xformOp:rotateZ"]
    }
    def CylinderLight "Tube" { }
    def "Lamp" (prepend references = @lamp.usda@) { }
    over "Undefined" { def SphereLight "NotThere" { } }
}
"#;
    let path = write(folder.path(), "stage.usda", stage);
    let rig = Rig::load(&path).unwrap();
    let near = |got: f64, want: f64| assert!((got - want).abs() < 1e-6 * want.abs().max(1e-3), "{got}, not {want}");
    let at = |got: DVec3, want: DVec3| assert!(got.distance(want) < 1e-9, "{got}, not {want}");
    assert_eq!(rig.lights.len(), 7, "{:?}", rig.lights.iter().map(|light| &light.name).collect::<Vec<_>>());

    let ceiling = light(&rig, "Ceiling");
    assert_eq!((ceiling.kind, ceiling.shadows), (LightKind::Rect, false));
    at(ceiling.position, DVec3::new(0.2, 2.5, -0.4));
    at(ceiling.direction, DVec3::NEG_Y);
    at(ceiling.axes()[1], DVec3::NEG_Z);
    near(ceiling.size[0], 2.0);
    near(ceiling.size[1], 1.0);
    // 500 nit over 2 m², a stop up.
    near(ceiling.intensity * ceiling.stops.exp2(), 2000.0);
    assert_eq!(ceiling.color, Vec3::new(1.0, 0.5, 0.25));
    assert_eq!(
        (&*ceiling.links.except, &*ceiling.links.no_shadow_from),
        (&["vase".to_owned()][..], &["glass".to_owned()][..])
    );

    // Over an area of square centimetres, seen in square metres: a quarter, times 1e-4.
    let ball = light(&rig, "Ball");
    near(ball.intensity, 400.0 * 0.25 * 1e-4);
    near(ball.radius, 0.1);

    let cone = light(&rig, "Cone");
    assert_eq!((cone.kind, cone.radius), (LightKind::Spot, 0.0));
    near(cone.outer_angle.to_degrees(), 30.0);
    near(cone.inner_angle.to_degrees(), 15.0);
    near(cone.intensity, 10.0 * std::f64::consts::PI * 0.01f64.powi(2));
    at(cone.direction, DVec3::NEG_Y);

    let (sun, lux) = (light(&rig, "Sun"), light(&rig, "Lux"));
    assert!(!sun.enabled && !lux.enabled);
    near(sun.angle.to_degrees(), 0.53);
    near(sun.intensity, 50_000.0 * std::f64::consts::PI * (0.265f64.to_radians()).sin().powi(2));
    near(lux.intensity, 7.0);
    near(light(&rig, "Sky").rotation.to_degrees(), 30.0);
    near(light(&rig, "Sky").intensity, 0.5);
    assert_eq!(light(&rig, "Spot_A").kind, LightKind::Disk);

    let mut command = relume();
    command.arg("rig").arg(shipped("balls-2.glb")).arg("--rig").arg(&path).arg("-o").arg(folder.path().join("a.usda"));
    let run = Run::of(&mut command).done();
    assert!(run.stderr.contains("Tube") && run.stderr.contains("CylinderLight"), "{}", run.stderr);
}

#[test]
fn files_of_others_are_not_replaced() {
    let (folder, rig) = rig();
    let text = "#usda 1.0\ndef Xform \"World\" {}\n";
    let theirs = write(folder.path(), "theirs.usda", text);
    let convert = |output: &Path| {
        let mut command = relume();
        Run::of(command.arg("rig").arg(shipped("balls-2.glb")).arg("--rig").arg(&rig).arg("-o").arg(output))
    };
    convert(&theirs).failed(&["theirs.usda", "choose another name"]);
    assert_eq!(std::fs::read_to_string(&theirs).unwrap(), text);
    let ours = folder.path().join("ours.usda");
    convert(&ours).done();
    convert(&ours).done();
    let with_more = std::fs::read_to_string(&ours).unwrap() + "\ndef Mesh \"floor\"\n{\n}\n";
    let more = write(folder.path(), "more.usda", &with_more);
    convert(&more).failed(&["more.usda", "choose another name"]);
    assert_eq!(std::fs::read_to_string(&more).unwrap(), with_more);
    convert(&folder.path().join("ours.usdc")).failed(&["ours.usdc", "written as .usda"]);
    // And relume lights a scene with it.
    let mut command = relume();
    command.arg("render").arg(shipped("balls-2.glb")).arg("-o").arg(folder.path().join("a.exr"));
    Run::of(command.args(["--size", "32x24", "--no-cache", "--rig"]).arg(&ours)).failed(&["ball"]); // no such object
}

#[test]
fn damaged_files_are_errors() {
    let (folder, path) = rig();
    let usda = folder.path().join("lights.usda");
    Rig::load(&path).unwrap().save(&usda).unwrap();
    let good = std::fs::read_to_string(&usda).unwrap().replace("relume_rig", "other");
    let damaged = folder.path().join("damaged.usda");
    let mut random = Random::new(8);
    let mut taken = 0;
    for _ in 0..mutants() {
        let mut lines: Vec<&str> = good.lines().collect();
        let at = random.below(lines.len());
        match random.below(4) {
            0 => drop(lines.remove(at)),
            1 => lines.insert(at, lines[random.below(lines.len())]),
            2 => lines.truncate(at),
            _ => {}
        }
        let mut bytes = lines.join("\n").into_bytes();
        for _ in 0..random.below(4) {
            let at = random.below(bytes.len().max(1));
            if let Some(byte) = bytes.get_mut(at) {
                *byte = random.pick(b"\0\n\t \"#-09e:.@()[]{}<>=zA\xff");
            }
        }
        std::fs::write(&damaged, bytes).unwrap();
        match Rig::load(&damaged) {
            Ok(rig) => {
                taken += 1;
                for light in rig.lights {
                    assert!(
                        light.scale().is_finite() && light.position.is_finite() && light.direction.is_finite(),
                        "{light:?}"
                    );
                }
            }
            Err(error) => assert!(error.to_string().contains("damaged.usda"), "{error}"),
        }
    }
    assert!(taken > mutants() / 20, "only {taken} were taken: they do not get far");
    for (name, bytes) in
        [("no.usda", &b"{}"[..]), ("no.usdc", b"PXR-USDC\0\0"), ("no.usdz", b"PK\x03\x04"), ("no.usd", b"")]
    {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = Rig::load(&path).unwrap_err().chain();
        assert!(error.contains(name), "{error}");
    }
    // Nested deeper than the stack is; a file that contains itself; one that is gone.
    for (prim, end) in [("def \"a\" {\n", "}\n"), ("(customLayerData = { dictionary a = {", "}})")] {
        let text = format!("#usda 1.0\n{}{}", prim.repeat(20_000), end.repeat(20_000));
        let error = Rig::load(&write(folder.path(), "deep.usda", &text)).unwrap_err().chain();
        assert!(error.contains("deep.usda") && error.contains("nested"), "{error}");
        Rig::load(&write(
            folder.path(),
            "deep.usda",
            &format!("#usda 1.0\n{}{}", "def \"a\" {\n".repeat(120), "}\n".repeat(120)),
        ))
        .unwrap();
    }
    let text = "#usda 1.0\n(subLayers = [@itself.usda@, @gone.usda@])\ndef \"a\" (references = @itself.usda@</a>) {}\n";
    assert!(Rig::load(&write(folder.path(), "itself.usda", text)).unwrap().lights.is_empty());
    let error = Rig::load(&folder.path().join("missing.usda")).unwrap_err().chain();
    assert!(error.contains("missing.usda") && error.contains("No such file"), "{error}");
}
