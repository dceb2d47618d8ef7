//! Writes a rig's lights as a USD layer of text.

use std::fmt::Write;
use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use glam::DVec3;

use super::{EXACT_RIG, has, nearest};
use crate::error::{Error, Result};
use crate::scene::rig::{UniqueNames, kelvin_and_tint_of, kelvin_to_rgb};
use crate::scene::{Light, LightFilter, LightKind, Rig};
use crate::storage::file;

/// Radius of the sphere that stands for a point light in renderers that have no points, metres.
const POINT_RADIUS: f64 = 1e-3;
/// Colour temperatures at which ours and UsdLux's agree to 0.3 %; below, colours are outside of Rec. 709.
const SAME_KELVIN: std::ops::RangeInclusive<f64> = 2_000.0..=10_000.0;

/// Writes the lights of `rig` to `path` as a layer of UsdLux lights, in metres with +y up; and, for relume itself, the
/// exact rig without camera and snapshots. A file that relume did not write is not replaced. Emitters and physical
/// skies have no counterpart.
pub fn save(rig: &Rig, path: &Path) -> Result<()> {
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("usda")) {
        return Err(Error::invalid(path.display().to_string(), "lights are written as .usda"));
    }
    if path.exists() && !super::read::is_ours(path) {
        let reason = "is not a file of lights by relume, and would lose all else; choose another name";
        return Err(Error::invalid(path.display().to_string(), reason));
    }
    let is_more = |light: &&Light| {
        let has_filter = !LightFilter { ies: None, ..light.filter.clone() }.is_none();
        let is_background = light.kind == LightKind::Dome && light.visible;
        has_filter || !light.links.factor.is_empty() || light.range.is_some() || is_background
    };
    if let Some(light) = rig.lights.iter().find(is_more) {
        let lost = "filters, range, factors of links or background";
        tracing::warn!("{}: UsdLux cannot store {lost} of \"{}\"; relume restores them", path.display(), light.name);
    }
    let text = layer(rig, path);
    file::write_whole(path, |out| out.write_all(text.as_bytes()).map_err(Error::io("write", path)))
}

fn layer(rig: &Rig, path: &Path) -> String {
    let folder = path.parent().unwrap_or(Path::new(""));
    let exact = Rig { camera: None, snapshots: Vec::new(), ..rig.clone() }.to_toml(folder);
    let mut out = Layer::default();
    out.line("#usda 1.0");
    out.open("(");
    out.line("defaultPrim = \"lights\"");
    out.line("metersPerUnit = 1");
    out.line("upAxis = \"Y\"");
    out.open("customLayerData = {");
    out.line(&format!("string {EXACT_RIG} = \"{}\"", BASE64_STANDARD.encode(exact)));
    out.close("}");
    out.close(")");
    out.line("");
    out.line("def Scope \"lights\"");
    out.open("{");
    let active = rig.with_solo_applied();
    let mut names = UniqueNames::default();
    for index in 0..active.lights.len() {
        if has(&active.lights[index]) {
            let light = &active.lights[index];
            out.light(&nearest(&active, index), temperature(light), &names.claim(&identifier(&light.name)), folder);
        } else {
            let name = &active.lights[index].name;
            tracing::warn!("{}: UsdLux has no light like \"{name}\"; relume restores it", path.display());
        }
    }
    out.close("}");
    out.text
}

#[derive(Default)]
struct Layer {
    text: String,
    depth: usize,
}

impl Layer {
    fn line(&mut self, line: &str) {
        let indent = if line.is_empty() { 0 } else { 4 * self.depth };
        writeln!(self.text, "{:indent$}{line}", "").expect("writing to a string cannot fail");
    }

    fn open(&mut self, line: &str) {
        self.line(line);
        self.depth += 1;
    }

    fn close(&mut self, line: &str) {
        self.depth -= 1;
        self.line(line);
    }

    fn number(&mut self, name: &str, value: f64) {
        self.line(&format!("float inputs:{name} = {}", value as f32));
    }

    /// `kelvin`: a temperature to give the colour by.
    fn light(&mut self, light: &Light, kelvin: Option<f64>, identifier: &str, folder: &Path) {
        let kind = match light.kind {
            LightKind::Point | LightKind::Spot => "SphereLight",
            LightKind::Disk => "DiskLight",
            LightKind::Rect => "RectLight",
            LightKind::Directional => "DistantLight",
            LightKind::Dome => "DomeLight",
            LightKind::Emitter => unreachable!("UsdLux has no emitters"),
        };
        let is_flat = matches!(light.kind, LightKind::Disk | LightKind::Rect);
        let narrows = is_flat && light.spread < std::f64::consts::PI;
        let is_shaped = light.kind == LightKind::Spot || light.filter.ies.is_some() || narrows;
        let mut schemas = Vec::new();
        schemas.extend(is_shaped.then_some("\"ShapingAPI\""));
        schemas.extend((!light.shadows).then_some("\"ShadowAPI\""));
        self.line("");
        self.line(&format!("def {kind} \"{identifier}\" ("));
        self.depth += 1;
        self.line(&format!("displayName = {}", quoted(&light.name)));
        if !schemas.is_empty() {
            self.line(&format!("prepend apiSchemas = [{}]", schemas.join(", ")));
        }
        self.close(")");
        self.open("{");
        self.strength(light, kelvin);
        self.shape(light, folder);
        if is_shaped {
            self.shaping(light, narrows, folder);
        }
        if !light.shadows {
            self.line("bool inputs:shadow:enable = 0");
        }
        if !light.enabled {
            self.line("token visibility = \"invisible\"");
        }
        self.links(light);
        self.pose(light);
        self.close("}");
    }

    fn strength(&mut self, light: &Light, kelvin: Option<f64>) {
        let mut color = light.color;
        if let Some(kelvin) = kelvin {
            color /= kelvin_to_rgb(kelvin, 0.0);
            self.line("bool inputs:enableColorTemperature = 1");
            self.number("colorTemperature", kelvin);
        }
        self.line(&format!("color3f inputs:color = ({}, {}, {})", color.x, color.y, color.z));
        // Over the area: a sphere shows a quarter of it. Profiles multiply by their candela.
        let area = if matches!(light.kind, LightKind::Point | LightKind::Spot) { 4.0 } else { 1.0 };
        let profile = light.filter.ies.as_ref().map_or(1.0, |ies| ies.max());
        self.number("intensity", area * light.intensity / profile);
        self.number("exposure", light.stops);
        if light.kind != LightKind::Dome {
            self.line("bool inputs:normalize = 1");
        }
    }

    fn shape(&mut self, light: &Light, folder: &Path) {
        match light.kind {
            LightKind::Point | LightKind::Spot => {
                if light.radius == 0.0 {
                    self.line("bool treatAsPoint = 1");
                }
                self.number("radius", if light.radius == 0.0 { POINT_RADIUS } else { light.radius });
            }
            LightKind::Disk => self.number("radius", light.radius),
            LightKind::Rect => {
                self.number("width", light.size[0]);
                self.number("height", light.size[1]);
            }
            LightKind::Directional => self.number("angle", light.angle.to_degrees()),
            LightKind::Dome => {
                if let Some(map) = light.map.as_ref().and_then(|map| map.as_file()) {
                    self.line(&format!("asset inputs:texture:file = {}", asset(&map.path_from(folder))));
                    self.line("token inputs:texture:format = \"latlong\"");
                }
            }
            LightKind::Emitter => {}
        }
    }

    fn shaping(&mut self, light: &Light, narrows: bool, folder: &Path) {
        if light.kind == LightKind::Spot {
            self.number("shaping:cone:angle", light.outer_angle.to_degrees());
            self.number("shaping:cone:softness", 1.0 - light.inner_angle / light.outer_angle.max(f64::MIN_POSITIVE));
        } else if narrows {
            self.number("shaping:cone:angle", (light.spread / 2.0).to_degrees());
            self.number("shaping:cone:softness", 1.0);
        }
        if let Some(ies) = &light.filter.ies {
            self.line(&format!("asset inputs:shaping:ies:file = {}", asset(&ies.path_from(folder))));
        }
    }

    /// Names of objects, whose places in a stage relume does not know.
    fn links(&mut self, light: &Light) {
        let links = &light.links;
        for (name, objects) in
            [("only", &links.only), ("except", &links.except), ("noShadowFrom", &links.no_shadow_from)]
        {
            if !objects.is_empty() {
                let objects = objects.iter().map(|object| quoted(object)).collect::<Vec<_>>().join(", ");
                self.line(&format!("custom string[] relume:{name} = [{objects}]"));
            }
        }
    }

    fn pose(&mut self, light: &Light) {
        if light.kind == LightKind::Dome {
            self.line(&format!("double xformOp:rotateY = {}", light.rotation.to_degrees()));
            self.line("uniform token[] xformOpOrder = [\"xformOp:rotateY\"]");
            return;
        }
        // Lights shine along -z.
        let [x, y] = light.axes();
        let position = if light.kind.has_position() { light.position } else { DVec3::ZERO };
        let row = |v: DVec3, w: i32| format!("({:?}, {:?}, {:?}, {w})", v.x, v.y, v.z);
        let rows = [row(x, 0), row(y, 0), row(-light.direction, 0), row(position, 1)].join(", ");
        self.line(&format!("matrix4d xformOp:transform = ( {rows} )"));
        self.line("uniform token[] xformOpOrder = [\"xformOp:transform\"]");
    }
}

/// The colour temperature of a light that has the colour of a black body, whole kelvin if it is nearly that.
fn temperature(light: &Light) -> Option<f64> {
    let (kelvin, tint) = kelvin_and_tint_of(light.color);
    let is_grey = light.color.min_element() == light.color.max_element();
    let kelvin = if (kelvin - kelvin.round()).abs() < 0.01 * kelvin.round() / 1000.0 { kelvin.round() } else { kelvin };
    // As the file has it, so that its product with the colour is exact.
    (!is_grey && tint.abs() < 1e-3 && SAME_KELVIN.contains(&kelvin)).then_some(f64::from(kelvin as f32))
}

/// A name that prims can have: letters, digits and underscores, no digit first.
fn identifier(name: &str) -> String {
    let mut identifier: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !identifier.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
        identifier.insert(0, '_');
    }
    identifier
}

/// A string of USD's text format.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => quoted.push_str("\\\""),
            '\\' => quoted.push_str("\\\\"),
            '\n' => quoted.push_str("\\n"),
            '\t' => quoted.push_str("\\t"),
            '\r' => quoted.push_str("\\r"),
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}

/// A path of USD's text format.
fn asset(path: &Path) -> String {
    let text = path.to_string_lossy().replace('\\', "/");
    let relative = path.is_relative() && !text.starts_with('.');
    let text = if relative { format!("./{text}") } else { text };
    if text.contains('@') { format!("@@@{text}@@@") } else { format!("@{text}@") }
}
