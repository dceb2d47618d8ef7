//! One `[[light]]` of a rig file.

use std::collections::{BTreeMap, HashMap};
use std::ops::RangeInclusive;

use glam::{DVec3, Vec3};
use serde::Deserialize;
use toml::Spanned;

use super::rig_text::{RigText, Span};
use super::{blackbody, kelvin_to_rgb, without_dots};
use crate::scene::light_filter::{BarnDoors, Gobo, SOFTNESS_DEG};
use crate::scene::links::MAX_FACTOR;
use crate::scene::sky_map::TURBIDITY;
use crate::scene::{DomeMap, Light, LightFilter, LightGroup, LightKind, LightUnit, Links, PhysicalSky, RigFiles};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightEntry {
    pub name: Spanned<String>,
    pub kind: Spanned<String>,
    /// Of an emitter.
    pub material: Option<String>,
    pub position: Option<Spanned<[f64; 3]>>,
    pub direction: Option<Spanned<[f64; 3]>>,
    pub color: Option<Spanned<[f32; 3]>>,
    pub kelvin: Option<Spanned<f64>>,
    pub tint: Option<Spanned<f64>>,
    pub intensity: Option<Spanned<f64>>,
    /// These three in place of `intensity`.
    pub lumen: Option<Spanned<f64>>,
    pub nit: Option<Spanned<f64>>,
    /// W/m² of directional lights.
    pub watt: Option<Spanned<f64>>,
    pub stops: Option<Spanned<f64>>,
    pub inner_deg: Option<Spanned<f64>>,
    pub outer_deg: Option<Spanned<f64>>,
    pub radius: Option<Spanned<f64>>,
    pub width: Option<Spanned<f64>>,
    pub height: Option<Spanned<f64>>,
    pub up: Option<Spanned<[f64; 3]>>,
    pub angle_deg: Option<Spanned<f64>>,
    /// Of a dome; or `physical_sky`.
    pub map: Option<Spanned<String>>,
    pub physical_sky: Option<Spanned<PhysicalSkyEntry>>,
    pub rotate_deg: Option<Spanned<f64>>,
    pub spread_deg: Option<Spanned<f64>>,
    #[serde(default)]
    pub two_sided: bool,
    /// cd/m² per channel, in place of `color` and `intensity`.
    pub radiance: Option<Spanned<[f64; 3]>>,
    #[serde(default)]
    pub visible: bool,
    pub range: Option<Spanned<f64>>,
    pub decay_start: Option<Spanned<f64>>,
    pub ies: Option<Spanned<String>>,
    pub gobo: Option<Spanned<GoboEntry>>,
    /// Left, right, top, bottom.
    pub barn_doors_deg: Option<Spanned<[f64; 4]>>,
    pub barn_doors_soft_deg: Option<Spanned<f64>>,
    pub group: Option<Spanned<String>>,
    #[serde(default = "yes")]
    pub enabled: bool,
    #[serde(default)]
    pub solo: bool,
    /// The name of another light.
    pub follows: Option<Spanned<String>>,
    #[serde(default = "yes")]
    pub shadows: bool,
    /// Names of nodes, materials or sets.
    pub only: Option<Spanned<Vec<String>>>,
    #[serde(default)]
    pub except: Vec<String>,
    #[serde(default)]
    pub factor: BTreeMap<String, Spanned<f64>>,
    #[serde(default)]
    pub no_shadow_from: Vec<String>,
    /// Source glTF node of the light.
    pub node: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoboEntry {
    image: Spanned<String>,
    rotate_deg: Option<Spanned<f64>>,
    scale: Option<Spanned<f64>>,
    tint: Option<Spanned<[f32; 3]>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhysicalSkyEntry {
    elevation_deg: Option<Spanned<f64>>,
    turbidity: Option<Spanned<f64>>,
    ground: Option<Spanned<f64>>,
    #[serde(default = "yes")]
    sun: bool,
}

pub fn yes() -> bool {
    true
}

pub fn light(
    text: &RigText,
    entry: LightEntry,
    group_indices: &HashMap<String, usize>,
    groups: &[LightGroup],
    files: &mut RigFiles,
) -> Result<Light, String> {
    let name = without_dots(entry.name.get_ref());
    let check = Check { text, name: &name, kind: &entry.kind };
    if name.is_empty() {
        return Err(check.wrong(entry.name.span(), "the name is empty"));
    }
    let kind = check.kind()?;
    let strengths = [&entry.intensity, &entry.lumen, &entry.nit, &entry.watt];
    let strength_at = strengths.into_iter().chain([&entry.stops]).flatten().map(|v| v.span()).next();
    check.one_strength(&entry)?;
    let [inner_angle, outer_angle] = check.cone(entry.inner_deg, entry.outer_deg)?;
    if kind == LightKind::Emitter && entry.material.is_none() {
        return Err(check.wrong(entry.kind.span(), "an emitter needs the name of its material"));
    }
    let position = check.vector(entry.position, "position", kind.has_position())?;
    let default = Light::point("", DVec3::ZERO);
    let radius = match kind {
        LightKind::Disk => check.needed(entry.radius, "radius")?,
        _ if entry.kind.get_ref() == "sphere" => check.needed(entry.radius, "radius")?,
        _ => check.number(entry.radius, 0.0, "radius", SIZES)?,
    };
    let size = match kind {
        LightKind::Rect => [check.needed(entry.width, "width")?, check.needed(entry.height, "height")?],
        _ => [check.number(entry.width, 1.0, "width", SIZES)?, check.number(entry.height, 1.0, "height", SIZES)?],
    };
    let filter = LightFilter {
        ies: check.file(entry.ies, |name| files.profile(name))?,
        gobo: entry.gobo.map(|gobo| check.gobo(gobo.into_inner(), files)).transpose()?,
        barn_doors: check.barn_doors(entry.barn_doors_deg, entry.barn_doors_soft_deg)?,
    };
    // A lamp shines downwards and as brightly as its file says.
    let (aim, candela) = match &filter.ies {
        Some(ies) => (DVec3::NEG_Y, ies.max()),
        None => (DVec3::NEG_Z, 1.0),
    };
    if !kind.has_position() && !filter.is_none()
        || kind == LightKind::Point && (filter.gobo.is_some() || filter.barn_doors.is_some())
    {
        let kind = entry.kind.get_ref();
        tracing::warn!(
            "light \"{name}\": a {kind} light ignores gobo and barn doors; only lights with a position have ies"
        );
    }
    let mut light = Light {
        kind,
        radius,
        size,
        up: check.vector(entry.up, "up", false)?.unwrap_or(default.up),
        angle: check.number(entry.angle_deg, 0.0, "angle_deg", 0.0..=180.0)?.to_radians(),
        // The smallest is a beam of a hundredth of a degree.
        spread: check.number(entry.spread_deg, 180.0, "spread_deg", 0.01..=180.0)?.to_radians(),
        two_sided: entry.two_sided,
        visible: entry.visible,
        position: position.unwrap_or(DVec3::ZERO),
        material: entry.material.filter(|_| kind == LightKind::Emitter),
        map: check.dome_map(entry.map, entry.physical_sky, files)?,
        rotation: check.number(entry.rotate_deg, 0.0, "rotate_deg", -1e6..=1e6)?.to_radians(),
        direction: check.direction(entry.direction, aim, kind.is_aimed() || kind == LightKind::Directional)?,
        color: check.color(entry.color, entry.kelvin, entry.tint)?,
        intensity: check.number(entry.intensity, candela, "intensity", 0.0..=f64::MAX)?,
        stops: check.number(entry.stops, 0.0, "stops", f64::MIN..=f64::MAX)?,
        inner_angle,
        outer_angle,
        range: match entry.range {
            None => None,
            some => Some(check.number(some, 0.0, "range", f64::MIN_POSITIVE..=f64::MAX)?),
        },
        decay_start: check.number(entry.decay_start, 0.0, "decay_start", SIZES)?,
        filter,
        group: check.group(entry.group, group_indices)?,
        enabled: entry.enabled,
        solo: entry.solo,
        follows: None, // resolved once all names are known
        shadows: entry.shadows,
        links: check.links(entry.only, entry.except, entry.factor, entry.no_shadow_from)?,
        node: entry.node,
        name: name.clone(),
    };
    if let Some(radiance) = entry.radiance {
        check.set_radiance(&mut light, radiance)?;
    }
    for (key, unit, value) in [
        ("lumen", LightUnit::Lumen, entry.lumen),
        ("nit", LightUnit::Nit, entry.nit),
        ("watt", LightUnit::Watt, entry.watt),
    ] {
        if let Some(value) = value {
            light.intensity = check.intensity(&light, key, unit, value)?;
        }
    }
    // Checked even if the light or group is off, so that enabling it later cannot break the picture.
    let own = Light { enabled: true, ..light.clone() }.scale();
    let group = light.group.map_or(Vec3::ONE, |g| LightGroup { enabled: true, ..groups[g].clone() }.scale());
    if !(own * group).is_finite() {
        let reason = "color * intensity * 2^stops, including its group's, must be finite";
        return Err(check.wrong(strength_at.unwrap_or(entry.kind.span()), reason));
    }
    Ok(light)
}

const KINDS: &str = "`point`, `spot`, `directional`, `sphere`, `disk`, `rect`, `sun`, `dome` or `emitter`";
/// Lengths in metres.
const SIZES: RangeInclusive<f64> = 0.0..=f64::MAX;

/// Validates the values of one light; its errors name the light.
struct Check<'a> {
    text: &'a RigText<'a>,
    name: &'a str,
    kind: &'a Spanned<String>,
}

impl Check<'_> {
    fn wrong(&self, at: Span, reason: impl std::fmt::Display) -> String {
        self.text.line(at, format!("light \"{}\": {reason}", self.name))
    }

    fn kind(&self) -> Result<LightKind, String> {
        let wrong = |reason: String| Err(self.wrong(self.kind.span(), reason));
        match self.kind.get_ref().as_str() {
            "point" => Ok(LightKind::Point),
            "spot" => Ok(LightKind::Spot),
            "directional" | "sun" => Ok(LightKind::Directional),
            "sphere" => Ok(LightKind::Point),
            "disk" => Ok(LightKind::Disk),
            "rect" => Ok(LightKind::Rect),
            "dome" => Ok(LightKind::Dome),
            "emitter" => Ok(LightKind::Emitter),
            kind => wrong(format!("kind `{kind}` is unknown, expected {KINDS}")),
        }
    }

    fn needed(&self, value: Option<Spanned<f64>>, what: &str) -> Result<f64, String> {
        match value {
            None => Err(self.wrong(self.kind.span(), format!("a {} light needs a {what}", self.kind.get_ref()))),
            some => self.number(some, 0.0, what, SIZES),
        }
    }

    /// The keys of a light's strength exclude each other, and `radiance` excludes those of its colour.
    fn one_strength(&self, entry: &LightEntry) -> Result<(), String> {
        let both = |at: Span, key: &str, other: &str| Err(self.wrong(at, format!("{key} and {other} are both given")));
        let strengths =
            [("intensity", &entry.intensity), ("lumen", &entry.lumen), ("nit", &entry.nit), ("watt", &entry.watt)];
        let mut given = strengths.iter().filter_map(|(key, value)| value.as_ref().map(|value| (*key, value.span())));
        let (first, second) = (given.next(), given.next());
        if let (Some((other, _)), Some((key, at))) = (&first, second) {
            return both(at, key, other);
        }
        let Some(radiance) = &entry.radiance else { return Ok(()) };
        let colors = [("color", entry.color.is_some()), ("kelvin", entry.kelvin.is_some())];
        let color = colors.into_iter().find(|(_, given)| *given).map(|(key, _)| key);
        match color.or(first.map(|(key, _)| key)) {
            Some(other) => both(radiance.span(), "radiance", other),
            None => Ok(()),
        }
    }

    /// The intensity of a light whose strength is given in `unit`.
    fn intensity(&self, light: &Light, key: &str, unit: LightUnit, value: Spanned<f64>) -> Result<f64, String> {
        let at = value.span();
        let Some(per_intensity) = light.per_intensity(unit) else {
            let kind = self.kind.get_ref();
            return Err(self.wrong(at, format!("a {kind} light of this size has no {key}; use intensity")));
        };
        Ok(self.number(Some(value), 0.0, key, 0.0..=f64::MAX)? / per_intensity)
    }

    /// Sets colour and intensity.
    fn set_radiance(&self, light: &mut Light, radiance: Spanned<[f64; 3]>) -> Result<(), String> {
        let wrong = |reason: &str| Err(self.wrong(radiance.span(), reason));
        let value = DVec3::from_array(*radiance.get_ref());
        if !(value.is_finite() && value.min_element() >= 0.0) {
            return wrong("radiance must be finite and not negative");
        }
        let Some(area) = light.projected_area() else {
            return wrong("a light of this kind has no radiance, or its size is zero; use intensity");
        };
        let brightest = value.max_element();
        light.intensity = brightest * area;
        light.color = if brightest > 0.0 { (value / brightest).as_vec3() } else { Vec3::ONE };
        Ok(())
    }

    fn number(
        &self,
        value: Option<Spanned<f64>>,
        default: f64,
        what: &str,
        allowed: RangeInclusive<f64>,
    ) -> Result<f64, String> {
        let Some(value) = value else { return Ok(default) };
        match *value.get_ref() {
            x if allowed.contains(&x) => Ok(x),
            x => Err(self.wrong(value.span(), format!("{what} is {x}, must lie in {allowed:?}"))),
        }
    }

    fn vector(&self, value: Option<Spanned<[f64; 3]>>, what: &str, needed: bool) -> Result<Option<DVec3>, String> {
        match value {
            Some(v) if v.get_ref().iter().all(|x| x.is_finite()) => Ok(Some(DVec3::from_array(*v.get_ref()))),
            Some(v) => Err(self.wrong(v.span(), format!("{what} must be finite"))),
            None if needed => {
                Err(self.wrong(self.kind.span(), format!("a {} light needs a {what}", self.kind.get_ref())))
            }
            None => Ok(None),
        }
    }

    fn direction(&self, value: Option<Spanned<[f64; 3]>>, default: DVec3, needed: bool) -> Result<DVec3, String> {
        let at = value.as_ref().map(|v| v.span()).unwrap_or_default();
        match self.vector(value, "direction", needed)? {
            None => Ok(default),
            // Already unit length, up to rounding: unchanged, so that it reads back as it was written.
            Some(d) if (d.length_squared() - 1.0).abs() < 1e-14 => Ok(d),
            Some(d) => d.try_normalize().ok_or_else(|| self.wrong(at, "direction must not be of zero length")),
        }
    }

    fn color(
        &self,
        color: Option<Spanned<[f32; 3]>>,
        kelvin: Option<Spanned<f64>>,
        tint: Option<Spanned<f64>>,
    ) -> Result<Vec3, String> {
        match (color, kelvin, tint) {
            (Some(_), Some(kelvin), _) => Err(self.wrong(kelvin.span(), "color and kelvin are both given")),
            (_, None, Some(tint)) => Err(self.wrong(tint.span(), "tint needs kelvin")),
            (Some(color), None, None) => self.rgb(color, "color"),
            (None, Some(kelvin), tint) => Ok(kelvin_to_rgb(
                self.number(Some(kelvin), 0.0, "kelvin", blackbody::KELVIN)?,
                self.number(tint, 0.0, "tint", blackbody::TINT)?,
            )),
            (None, None, None) => Ok(Vec3::ONE),
        }
    }

    fn rgb(&self, color: Spanned<[f32; 3]>, what: &str) -> Result<Vec3, String> {
        let value = Vec3::from_array(*color.get_ref());
        let wrong = || self.wrong(color.span(), format!("{what} must be finite and not negative"));
        is_color(value).then_some(value).ok_or_else(wrong)
    }

    /// Transmits at most all light.
    fn tint(&self, tint: Spanned<[f32; 3]>) -> Result<Vec3, String> {
        let at = tint.span();
        let tint = self.rgb(tint, "tint")?;
        if tint.max_element() <= 1.0 { Ok(tint) } else { Err(self.wrong(at, "tint must lie in 0..=1")) }
    }

    fn file<T>(
        &self,
        name: Option<Spanned<String>>,
        read: impl FnOnce(&str) -> crate::error::Result<T>,
    ) -> Result<Option<T>, String> {
        let read = |name: Spanned<String>| read(name.get_ref()).map_err(|e| self.wrong(name.span(), e.chain()));
        name.map(read).transpose()
    }

    fn dome_map(
        &self,
        file: Option<Spanned<String>>,
        sky: Option<Spanned<PhysicalSkyEntry>>,
        files: &mut RigFiles,
    ) -> Result<Option<DomeMap>, String> {
        let Some(sky) = sky else {
            return Ok(self.file(file, |name| files.sky_map(name))?.map(DomeMap::File));
        };
        if file.is_some() {
            return Err(self.wrong(sky.span(), "map and physical_sky are both given"));
        }
        let PhysicalSkyEntry { elevation_deg, turbidity, ground, sun } = sky.into_inner();
        let default = PhysicalSky::default();
        let elevation_deg = self.number(elevation_deg, default.elevation.to_degrees(), "elevation_deg", 0.0..=90.0)?;
        Ok(Some(DomeMap::physical(PhysicalSky {
            elevation: elevation_deg.to_radians(),
            turbidity: self.number(turbidity, default.turbidity, "turbidity", TURBIDITY)?,
            ground: self.number(ground, default.ground, "ground", 0.0..=1.0)?,
            sun,
        })))
    }

    fn gobo(&self, entry: GoboEntry, files: &mut RigFiles) -> Result<Gobo, String> {
        let image = self.file(Some(entry.image), |name| files.image(name))?.expect("a name was given");
        let tint = entry.tint.map(|tint| self.tint(tint)).transpose()?;
        Ok(Gobo {
            image,
            rotation: self.number(entry.rotate_deg, 0.0, "rotate_deg", -360.0..=360.0)?.to_radians(),
            scale: self.number(entry.scale, 1.0, "scale", 1e-3..=1e3)?,
            tint: tint.unwrap_or(Vec3::ONE),
        })
    }

    fn barn_doors(
        &self,
        angles: Option<Spanned<[f64; 4]>>,
        softness: Option<Spanned<f64>>,
    ) -> Result<Option<BarnDoors>, String> {
        let softness = self.number(softness, SOFTNESS_DEG, "barn_doors_soft_deg", 0.01..=90.0)?.to_radians();
        let Some(angles) = angles else { return Ok(None) };
        if !angles.get_ref().iter().all(|angle| (-90.0..=90.0).contains(angle)) {
            return Err(self.wrong(angles.span(), "barn_doors_deg must lie in -90.0..=90.0"));
        }
        Ok(Some(BarnDoors { angles: angles.get_ref().map(f64::to_radians), softness }))
    }

    /// Half-angles in radians, inner and outer.
    fn cone(&self, inner: Option<Spanned<f64>>, outer: Option<Spanned<f64>>) -> Result<[f64; 2], String> {
        let at = outer.as_ref().or(inner.as_ref()).map(|v| v.span()).unwrap_or_default();
        let inner_deg = self.number(inner, 0.0, "inner_deg", 0.0..=90.0)?;
        let outer_deg = self.number(outer, 45.0, "outer_deg", 0.0..=90.0)?;
        if inner_deg > outer_deg {
            return Err(self.wrong(at, format!("inner_deg is {inner_deg}, more than outer_deg, {outer_deg}")));
        }
        Ok([inner_deg.to_radians(), outer_deg.to_radians()])
    }

    fn links(
        &self,
        only: Option<Spanned<Vec<String>>>,
        except: Vec<String>,
        factor: BTreeMap<String, Spanned<f64>>,
        no_shadow_from: Vec<String>,
    ) -> Result<Links, String> {
        if let Some(only) = only.as_ref().filter(|only| only.get_ref().is_empty()) {
            return Err(self.wrong(only.span(), "only is empty; to light nothing, use enabled = false"));
        }
        let factor = factor
            .into_iter()
            .map(|(name, value)| {
                let what = format!("factor of \"{name}\"");
                Ok((name, self.number(Some(value), 1.0, &what, 0.0..=MAX_FACTOR)?))
            })
            .collect::<Result<_, String>>()?;
        Ok(Links { only: only.map(Spanned::into_inner).unwrap_or_default(), except, factor, no_shadow_from })
    }

    fn group(&self, name: Option<Spanned<String>>, indices: &HashMap<String, usize>) -> Result<Option<usize>, String> {
        let Some(name) = name else { return Ok(None) };
        match indices.get(&without_dots(name.get_ref())) {
            Some(&index) => Ok(Some(index)),
            None => Err(self.wrong(name.span(), format!("there is no group \"{}\"", name.get_ref()))),
        }
    }
}

/// Whether a colour is finite and not negative.
pub fn is_color(color: Vec3) -> bool {
    color.is_finite() && color.min_element() >= 0.0
}
