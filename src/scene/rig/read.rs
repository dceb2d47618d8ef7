//! TOML to [`Rig`], everything checked.

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use serde::Deserialize;
use toml::Spanned;

use super::{Rig, blackbody, kelvin_to_rgb, without_dots};
use crate::scene::{Camera, Light, LightGroup, LightKind, Projection};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    camera: Option<Spanned<CameraEntry>>,
    #[serde(default)]
    group: Vec<GroupEntry>,
    #[serde(default)]
    light: Vec<LightEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraEntry {
    name: Option<String>,
    position: [f64; 3],
    target: [f64; 3],
    #[serde(default = "up")]
    up: [f64; 3],
    yfov_deg: Option<f64>,
    /// Half the height of an orthographic view, metres.
    ymag: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GroupEntry {
    name: Spanned<String>,
    #[serde(default)]
    stops: f64,
    #[serde(default = "white")]
    color: [f32; 3],
    #[serde(default = "yes")]
    enabled: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LightEntry {
    name: Spanned<String>,
    kind: Spanned<String>,
    position: Option<Spanned<[f64; 3]>>,
    direction: Option<Spanned<[f64; 3]>>,
    color: Option<Spanned<[f32; 3]>>,
    kelvin: Option<Spanned<f64>>,
    tint: Option<Spanned<f64>>,
    intensity: Option<Spanned<f64>>,
    stops: Option<Spanned<f64>>,
    inner_deg: Option<Spanned<f64>>,
    outer_deg: Option<Spanned<f64>>,
    range: Option<Spanned<f64>>,
    group: Option<Spanned<String>>,
    #[serde(default = "yes")]
    enabled: bool,
    #[serde(default = "yes")]
    shadows: bool,
    /// The glTF node that the light came from.
    node: Option<usize>,
    /// Reserved.
    radius: Option<Spanned<toml::Value>>,
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

fn white() -> [f32; 3] {
    [1.0; 3]
}

fn yes() -> bool {
    true
}

/// Errors begin with the line's number.
pub fn parse(text: &str) -> Result<Rig, String> {
    let reader = Reader { text };
    let file: File = toml::from_str(text).map_err(|e| {
        let at = e.span().unwrap_or_default();
        let message = e.message().replace('\n', " ");
        reader.line(at, message)
    })?;
    let camera = file.camera.map(|camera| reader.camera(camera)).transpose()?;
    let mut rig = Rig { camera, ..Rig::default() };
    let mut group_indices = HashMap::new();
    for entry in file.group {
        let at = entry.name.span();
        let group = reader.group(entry)?;
        if group_indices.insert(group.name.clone(), rig.groups.len()).is_some() {
            return Err(reader.line(at, format!("group \"{}\" is there twice", group.name)));
        }
        rig.groups.push(group);
    }
    let mut names = std::collections::HashSet::new();
    for entry in file.light {
        let at = entry.name.span();
        let light = reader.light(entry, &group_indices, &rig.groups)?;
        if !names.insert(light.name.clone()) {
            return Err(reader.line(at, format!("light \"{}\" is there twice", light.name)));
        }
        rig.lights.push(light);
    }
    Ok(rig)
}

struct Reader<'a> {
    text: &'a str,
}

type Span = std::ops::Range<usize>;

impl Reader<'_> {
    fn line(&self, at: Span, reason: impl std::fmt::Display) -> String {
        let before = &self.text.as_bytes()[..at.start.min(self.text.len())];
        let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
        format!("line {line}: {reason}")
    }

    fn camera(&self, entry: Spanned<CameraEntry>) -> Result<Camera, String> {
        let at = entry.span();
        let wrong = |reason: &str| self.line(at.clone(), format!("camera: {reason}"));
        let entry = entry.into_inner();
        let projection = match (entry.yfov_deg, entry.ymag) {
            (Some(deg), None) if deg > 0.0 && deg < 180.0 => Projection::Perspective { yfov: deg.to_radians() },
            (Some(_), None) => return Err(wrong("yfov_deg must lie between 0 and 180")),
            (None, Some(ymag)) if ymag > 0.0 && ymag.is_finite() => Projection::Orthographic { ymag },
            (None, Some(_)) => return Err(wrong("ymag must be positive")),
            _ => return Err(wrong("needs one of yfov_deg and ymag")),
        };
        let [position, target, up] = [entry.position, entry.target, entry.up].map(DVec3::from_array);
        let mut camera = Camera::look_at(position, target, up, projection)
            .ok_or_else(|| wrong("position, target and up don't make a view"))?;
        if let Some(name) = entry.name {
            camera.name = name;
        }
        Ok(camera)
    }

    fn group(&self, entry: GroupEntry) -> Result<LightGroup, String> {
        let name = without_dots(entry.name.get_ref());
        let group =
            LightGroup { name, stops: entry.stops, color: Vec3::from_array(entry.color), enabled: entry.enabled };
        let wrong = |reason: &str| self.line(entry.name.span(), format!("group \"{}\": {reason}", group.name));
        if group.name.is_empty() {
            return Err(wrong("the name is empty"));
        }
        if !is_color(group.color) {
            return Err(wrong("color must be finite and not negative"));
        }
        if !group.stops.is_finite() || !(group.color * group.stops.exp2() as f32).is_finite() {
            return Err(wrong("color * 2^stops must be finite"));
        }
        Ok(group)
    }

    fn light(
        &self,
        entry: LightEntry,
        group_indices: &HashMap<String, usize>,
        groups: &[LightGroup],
    ) -> Result<Light, String> {
        let name = without_dots(entry.name.get_ref());
        let wrong = |at: Span, reason: String| self.line(at, format!("light \"{name}\": {reason}"));
        if name.is_empty() {
            return Err(wrong(entry.name.span(), "the name is empty".into()));
        }
        if let Some(radius) = entry.radius {
            return Err(wrong(radius.span(), "`radius` is reserved for area lights, which are not there yet".into()));
        }
        let kind = match entry.kind.get_ref().as_str() {
            "point" => LightKind::Point,
            "spot" => LightKind::Spot,
            "directional" => LightKind::Directional,
            kind @ ("rect" | "sphere" | "dome") => {
                return Err(wrong(entry.kind.span(), format!("kind `{kind}` is reserved and not there yet")));
            }
            kind => {
                let reason = format!("kind `{kind}` is unknown, expected `point`, `spot` or `directional`");
                return Err(wrong(entry.kind.span(), reason));
            }
        };
        let number = |value: Option<Spanned<f64>>, default: f64, what: &str, allowed: std::ops::RangeInclusive<f64>| {
            let Some(value) = value else { return Ok(default) };
            match *value.get_ref() {
                x if allowed.contains(&x) && x.is_finite() => Ok(x),
                x => Err(wrong(value.span(), format!("{what} is {x}, must lie in {allowed:?}"))),
            }
        };
        let vector = |value: Option<Spanned<[f64; 3]>>, what: &str, needed: bool| match value {
            Some(v) if v.get_ref().iter().all(|x| x.is_finite()) => Ok(Some(DVec3::from_array(*v.get_ref()))),
            Some(v) => Err(wrong(v.span(), format!("{what} must be finite"))),
            None if needed => Err(wrong(entry.kind.span(), format!("a {} light needs a {what}", entry.kind.get_ref()))),
            None => Ok(None),
        };
        let color = match (&entry.color, &entry.kelvin, entry.tint) {
            (Some(_), Some(kelvin), _) => {
                return Err(wrong(kelvin.span(), "color and kelvin are both given".into()));
            }
            (_, None, Some(tint)) => return Err(wrong(tint.span(), "tint needs kelvin".into())),
            (Some(color), None, None) => {
                let value = Vec3::from_array(*color.get_ref());
                if !is_color(value) {
                    return Err(wrong(color.span(), "color must be finite and not negative".into()));
                }
                value
            }
            (None, Some(_), tint) => {
                let kelvin = number(entry.kelvin, 0.0, "kelvin", blackbody::KELVIN)?;
                kelvin_to_rgb(kelvin, number(tint, 0.0, "tint", -1.0..=1.0)?)
            }
            (None, None, None) => Vec3::ONE,
        };
        let direction_at = entry.direction.as_ref().map(|d| d.span());
        let direction = match vector(entry.direction, "direction", kind != LightKind::Point)? {
            None => DVec3::NEG_Z,
            // Unit length already, but for rounding: left as it is, so that what was written reads back equal.
            Some(d) if (d.length_squared() - 1.0).abs() < 1e-14 => d,
            Some(d) => d.try_normalize().ok_or_else(|| {
                wrong(direction_at.unwrap_or_default(), "direction must not be of zero length".into())
            })?,
        };
        let outer_at = entry.outer_deg.as_ref().or(entry.inner_deg.as_ref()).map(|v| v.span());
        let inner_deg = number(entry.inner_deg, 0.0, "inner_deg", 0.0..=90.0)?;
        let outer_deg = number(entry.outer_deg, 45.0, "outer_deg", 0.0..=90.0)?;
        if inner_deg > outer_deg {
            let reason = format!("inner_deg is {inner_deg}, more than outer_deg, {outer_deg}");
            return Err(wrong(outer_at.unwrap_or_default(), reason));
        }
        let range_at = entry.range.as_ref().map(|r| r.span());
        let range = entry.range.map(|r| *r.get_ref());
        if range.is_some_and(|r| !(r > 0.0 && r.is_finite())) {
            return Err(wrong(range_at.unwrap_or_default(), "range must be positive".into()));
        }
        let group = match entry.group {
            None => None,
            Some(group) => Some(
                *group_indices
                    .get(&without_dots(group.get_ref()))
                    .ok_or_else(|| wrong(group.span(), format!("there is no group \"{}\"", group.get_ref())))?,
            ),
        };
        let intensity_at = [&entry.intensity, &entry.stops].into_iter().flatten().map(|v| v.span()).next();
        let light = Light {
            kind,
            position: vector(entry.position, "position", kind != LightKind::Directional)?.unwrap_or(DVec3::ZERO),
            direction,
            color,
            intensity: number(entry.intensity, 1.0, "intensity", 0.0..=f64::MAX)?,
            stops: number(entry.stops, 0.0, "stops", f64::MIN..=f64::MAX)?,
            inner_angle: inner_deg.to_radians(),
            outer_angle: outer_deg.to_radians(),
            range,
            group,
            enabled: entry.enabled,
            shadows: entry.shadows,
            node: entry.node,
            name: name.clone(),
        };
        // Off or on: switching it on must not be what breaks the picture.
        let on = Light { enabled: true, ..light.clone() }.scale();
        let group = group.map_or(Vec3::ONE, |g| LightGroup { enabled: true, ..groups[g].clone() }.scale());
        if !(on * group).is_finite() {
            let reason = "color * intensity * 2^stops, its group's included, must be finite".into();
            return Err(wrong(intensity_at.unwrap_or(entry.kind.span()), reason));
        }
        Ok(light)
    }
}

fn is_color(color: Vec3) -> bool {
    color.is_finite() && color.min_element() >= 0.0
}
