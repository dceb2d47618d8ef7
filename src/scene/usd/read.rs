//! Reads the lights of a composed USD stage.

use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use glam::{DAffine3, DQuat, DVec3, Vec3};
use openusd::sdf::{self, AssetPath, Value};
use openusd::usd::{Prim, Stage};

use super::prims::{
    Fallible, children, color, display_name, ensure, flag, is_instance, is_visible, number, unescaped, world_from_prim,
};
use super::resolver::ShallowFiles;
use super::{EXACT_RIG, has, is_same, nearest};
use crate::error::{Cause, Error, Result};
use crate::scene::rig::{KELVIN, UniqueNames, kelvin_to_rgb};
use crate::scene::{DomeMap, Light, LightKind, Links, Rig, RigFiles};
use crate::storage::file;

/// Reads the UsdLux lights of a USD file and of all files that it is composed of, at the time of their defaults, else
/// of their first sample. Lights that relume wrote and nobody edited are the exact rig again. Warns of lights that
/// relume does not have: cylinders, geometry, portals. Fails if the file is no USD, or a file of it is missing.
pub fn load(path: &Path) -> Result<Rig> {
    file::open(path)?; // with the system's own reason if it cannot be read
    let stage = open(path).map_err(|cause| invalid(path, cause))?;
    for error in stage.composition_errors() {
        tracing::warn!("{}: {error}", path.display());
    }
    let rig = Reader { path, files: RigFiles::new(path.parent().unwrap_or(Path::new(""))) }.rig(&stage)?;
    Ok(exact(&stage, path, &rig).unwrap_or(rig))
}

/// Whether relume wrote a file, and nobody added anything but lights.
pub fn is_ours(path: &Path) -> bool {
    open(path).is_ok_and(|stage| exact_text(&stage).is_some() && has_only_lights(&stage).unwrap_or(false))
}

fn has_only_lights(stage: &Stage) -> Fallible<bool> {
    for scope in children(&stage.prim(sdf::Path::abs_root()))? {
        if scope.path().name() != Some("lights") {
            return Ok(false);
        }
        for prim in children(&scope)? {
            let type_name = prim.type_name()?.map(|name| name.to_string()).unwrap_or_default();
            if !type_name.contains("Light") || !children(&prim)?.is_empty() {
                return Ok(false);
            }
        }
    }
    Ok(true)
}

fn open(path: &Path) -> Fallible<Stage> {
    Ok(Stage::builder().resolver(ShallowFiles::default()).open(&path.to_string_lossy())?)
}

fn invalid(path: &Path, cause: impl Into<Cause>) -> Error {
    Error::import_from(path, "not a readable USD file", cause)
}

fn exact_text(stage: &Stage) -> Option<String> {
    match stage.custom_layer_data().ok()?? {
        Value::Dictionary(mut entries) => match entries.remove(EXACT_RIG)? {
            Value::String(encoded) => String::from_utf8(BASE64_STANDARD.decode(encoded).ok()?).ok(),
            _ => None,
        },
        _ => None,
    }
}

/// The exact rig in the file, if its lights are those of the stage.
fn exact(stage: &Stage, path: &Path, loaded: &Rig) -> Option<Rig> {
    let text = exact_text(stage)?;
    let exact = match Rig::from_toml(&text, RigFiles::new(path.parent().unwrap_or(Path::new("")))) {
        Ok(exact) => exact,
        Err(reason) => {
            tracing::warn!("{}: its exact rig is discarded: {reason}", path.display());
            return None;
        }
    };
    let active = exact.with_solo_applied();
    let in_usd: Vec<Light> =
        (0..active.lights.len()).filter(|&i| has(&active.lights[i])).map(|i| nearest(&active, i)).collect();
    let same = |light: &Light| loaded.lights.iter().any(|other| other.name == light.name && is_same(light, other));
    if in_usd.len() == loaded.lights.len() && in_usd.iter().all(same) {
        return Some(exact);
    }
    let lost = "groups, followers, filters and links are discarded";
    tracing::warn!("{}: its lights were edited since relume wrote them; {lost}", path.display());
    None
}

struct Reader<'a> {
    path: &'a Path,
    files: RigFiles<'a>,
}

/// What a stage's lengths and axes are.
struct Space {
    /// World space of relume, in metres with +y up, from that of the stage.
    world_from_stage: DAffine3,
    metres_per_unit: f64,
    is_z_up: bool,
}

impl Reader<'_> {
    fn rig(mut self, stage: &Stage) -> Result<Rig> {
        let path = self.path;
        let space = Space::of(stage).map_err(|cause| invalid(path, cause))?;
        let mut names = UniqueNames::default();
        let mut lights = Vec::new();
        let mut instances = 0;
        let mut prims = vec![stage.prim(sdf::Path::abs_root())];
        while let Some(prim) = prims.pop() {
            instances += usize::from(is_instance(&prim).map_err(|cause| invalid(path, cause))?);
            let mut children = children(&prim).map_err(|cause| invalid(path, cause))?;
            prims.extend(children.drain(..).rev());
            let light = self.light(stage, &prim, &space);
            let light = light.map_err(|cause| Error::import_from(path, format!("the light {}", prim.path()), cause))?;
            lights.extend(light.map(|light| Light { name: names.claim(&light.name), ..light }));
        }
        if instances > 0 {
            tracing::warn!("{}: lights within its {instances} instances are not read", path.display());
        }
        if lights.is_empty() {
            tracing::warn!("{}: has no lights of UsdLux", path.display());
        }
        Ok(Rig { lights, ..Rig::default() })
    }

    /// The light of a prim; `None` if it is none, or one that relume does not have.
    fn light(&mut self, stage: &Stage, prim: &Prim, space: &Space) -> Fallible<Option<Light>> {
        let type_name = prim.type_name()?.map(|name| name.to_string()).unwrap_or_default();
        let cone = cone(prim)?;
        let is_spot = cone.outer < FRAC_PI_2;
        let kind = match type_name.as_str() {
            "SphereLight" if is_spot => LightKind::Spot,
            "SphereLight" => LightKind::Point,
            "DiskLight" => LightKind::Disk,
            "RectLight" => LightKind::Rect,
            "DistantLight" => LightKind::Directional,
            "DomeLight" | "DomeLight_1" => LightKind::Dome,
            "CylinderLight" | "GeometryLight" | "PortalLight" | "PluginLight" => {
                tracing::warn!("{}: {} is a {type_name}, which relume does not have", self.path.display(), prim.path());
                return Ok(None);
            }
            _ => {
                if prim.path().name().is_some() && prim.has_api_schema("MeshLightAPI")? {
                    tracing::warn!(
                        "{}: {} is a mesh light, which relume does not have",
                        self.path.display(),
                        prim.path()
                    );
                }
                return Ok(None);
            }
        };
        self.warn_of_ignored(prim, kind)?;
        let world_from_light = space.world_from_stage * world_from_prim(prim)?;
        let (_, rotation, position) = world_from_light.to_scale_rotation_translation();
        ensure(rotation.is_finite() && position.is_finite(), "its place is not finite or has no size")?;
        let along = |axis: DVec3| world_from_light.transform_vector3(axis);
        let name = display_name(stage, prim)?.unwrap_or_else(|| prim.path().name().unwrap_or("light").to_owned());
        let mut light = Light {
            kind,
            direction: along(DVec3::NEG_Z).try_normalize().unwrap_or(DVec3::NEG_Z),
            enabled: is_visible(prim)?,
            shadows: flag(prim, "inputs:shadow:enable")?.unwrap_or(true),
            stops: number(prim, "inputs:exposure")?.unwrap_or(0.0),
            ..Light::point(&name, if kind.has_position() { position } else { DVec3::ZERO })
        };
        light.color = color(prim, "inputs:color")?.unwrap_or(Vec3::ONE);
        if flag(prim, "inputs:enableColorTemperature")?.unwrap_or(false) {
            let kelvin = number(prim, "inputs:colorTemperature")?.unwrap_or(6500.0);
            light.color *= kelvin_to_rgb(kelvin.clamp(*KELVIN.start(), *KELVIN.end()), 0.0);
        }
        let default = if kind == LightKind::Directional { 50_000.0 } else { 1.0 };
        light.intensity = number(prim, "inputs:intensity")?.unwrap_or(default);
        let factor = shape(prim, &mut light, along, space.metres_per_unit)?;
        light.intensity *= factor;
        match kind {
            LightKind::Spot => (light.inner_angle, light.outer_angle) = (cone.inner, cone.outer),
            LightKind::Disk | LightKind::Rect if is_spot => light.spread = 2.0 * cone.outer,
            LightKind::Dome => self.dome(prim, &type_name, rotation, space, &mut light)?,
            _ => {}
        }
        self.profile(prim, &mut light)?;
        if kind == LightKind::Rect || light.filter.ies.is_some() {
            light.up = along(DVec3::Y).try_normalize().unwrap_or(DVec3::Y);
        }
        light.links = links(prim)?;
        let is_sound = light.intensity.is_finite() && light.intensity >= 0.0 && light.stops.is_finite();
        let is_colored = light.color.is_finite() && light.color.min_element() >= 0.0;
        ensure(is_sound && is_colored, "its strength is no number")?;
        let is_sized = light.radius.is_finite() && light.size.iter().all(|side| side.is_finite());
        ensure(is_sized && light.angle.is_finite() && cone.inner.is_finite(), "its size is no number")?;
        Ok(Some(light))
    }

    /// Warns about what changes a light and is not read.
    fn warn_of_ignored(&self, prim: &Prim, kind: LightKind) -> Fallible<()> {
        let is_other = |name: &str, default: f64| -> Fallible<bool> {
            Ok(number(prim, name)?.is_some_and(|value| value != default))
        };
        let limits = |name: &str| -> Fallible<bool> { Ok(number(prim, name)?.is_some_and(|x| x >= 0.0)) };
        let is_colored = |name: &str| -> Fallible<bool> { Ok(color(prim, name)?.is_some_and(|c| c != Vec3::ZERO)) };
        let has_map = kind == LightKind::Rect && self.asset(prim, "inputs:texture:file")?.is_some();
        let ignored = [
            ("filters", !prim.relationship("light:filters").targets()?.is_empty()),
            ("texture", has_map),
            ("diffuse", is_other("inputs:diffuse", 1.0)?),
            ("specular", is_other("inputs:specular", 1.0)?),
            ("focus", is_other("inputs:shaping:focus", 0.0)?),
            ("scale of IES angles", is_other("inputs:shaping:ies:angleScale", 0.0)?),
            ("shadow colour", is_colored("inputs:shadow:color")?),
            ("shadow distance", limits("inputs:shadow:distance")?),
            ("shadow falloff", limits("inputs:shadow:falloff")?),
        ];
        let ignored: Vec<&str> = ignored.iter().filter(|(_, is_set)| *is_set).map(|(what, _)| *what).collect();
        if !ignored.is_empty() {
            tracing::warn!("{}: {}: ignored {}", self.path.display(), prim.path(), ignored.join(", "));
        }
        Ok(())
    }

    /// The IES profile of a light that has a place.
    fn profile(&mut self, prim: &Prim, light: &mut Light) -> Fallible<()> {
        let ies = self.asset(prim, "inputs:shaping:ies:file")?;
        let Some(ies) = ies.filter(|_| light.kind.has_position()) else { return Ok(()) };
        let profile = self.files.profile(&ies)?;
        // UsdLux multiplies by the candela of the file, which it can divide by their mean over all directions.
        let mean = profile.flux() / (4.0 * PI);
        let divisor = if flag(prim, "inputs:shaping:ies:normalize")?.unwrap_or(false) { mean } else { 1.0 };
        light.intensity *= profile.max() / divisor;
        light.filter.ies = Some(profile);
        Ok(())
    }

    /// The map of a dome and how it is turned. The middle of the map is +z of the light, as it is of ours.
    fn dome(
        &mut self,
        prim: &Prim,
        type_name: &str,
        rotation: DQuat,
        space: &Space,
        light: &mut Light,
    ) -> Fallible<()> {
        let pole = prim.attribute("poleAxis").cast::<String>()?.unwrap_or_else(|| "scene".into());
        let is_z = type_name == "DomeLight_1" && (pole == "Z" || (pole == "scene" && space.is_z_up));
        let turned = if is_z { rotation * DQuat::from_rotation_x(FRAC_PI_2) } else { rotation };
        let (pole, middle) = (turned * DVec3::Y, turned * DVec3::Z);
        if pole.y < 1.0 - 1e-6 {
            tracing::warn!("{}: the dome {} is tilted; relume only turns it", self.path.display(), prim.path());
        }
        light.rotation = middle.x.atan2(middle.z);
        if let Some(name) = self.asset(prim, "inputs:texture:file")? {
            let format =
                prim.attribute("inputs:texture:format").cast::<String>()?.unwrap_or_else(|| "automatic".into());
            ensure(["automatic", "latlong"].contains(&format.as_str()), "its map is not of the format latlong")?;
            light.map = Some(DomeMap::File(self.files.sky_map(&name)?));
        }
        Ok(())
    }

    /// Path of a file, absolute or from the folder of the USD file.
    fn asset(&self, prim: &Prim, name: &str) -> Fallible<Option<String>> {
        let asset = prim.attribute(name).get::<AssetPath>()?.filter(|asset| !asset.as_str().is_empty());
        let path = asset.map(|asset| asset.resolved_path().unwrap_or(asset.as_str()).to_owned());
        let is_packed = path.as_ref().is_some_and(|path| path.ends_with(']'));
        ensure(!is_packed, "its file is inside a .usdz, where relume reads only layers: unpack the .usdz")?;
        Ok(path)
    }
}

impl Space {
    fn of(stage: &Stage) -> Fallible<Self> {
        let metres = match stage.stage_metadata("metersPerUnit")? {
            Some(value) => value.cast::<f64>()?,
            None => 0.01, // UsdGeom's default: centimetres
        };
        ensure(metres.is_finite() && metres > 0.0, "its metersPerUnit is not above 0")?;
        let axis = stage.stage_metadata("upAxis")?.map(|axis| axis.cast::<String>()).transpose()?;
        let is_z_up = axis.is_some_and(|axis| axis == "Z");
        let turn = DQuat::from_rotation_x(if is_z_up { -FRAC_PI_2 } else { 0.0 });
        let world_from_stage = DAffine3::from_scale_rotation_translation(DVec3::splat(metres), turn, DVec3::ZERO);
        Ok(Self { world_from_stage, metres_per_unit: metres, is_z_up })
    }
}

/// Half-angles of `ShapingAPI` in radians; pi/2 without it.
struct Cone {
    inner: f64,
    outer: f64,
}

fn cone(prim: &Prim) -> Fallible<Cone> {
    let outer = number(prim, "inputs:shaping:cone:angle")?.unwrap_or(90.0).clamp(0.0, 90.0).to_radians();
    let softness = number(prim, "inputs:shaping:cone:softness")?.unwrap_or(0.0).clamp(0.0, 1.0);
    Ok(Cone { inner: outer * (1.0 - softness), outer })
}

/// Sets the size of a light, in metres. Returns the factor on its intensity: candela, lux or radiance by what UsdLux
/// has. `along`: turns and scales axes of the light.
fn shape(prim: &Prim, light: &mut Light, along: impl Fn(DVec3) -> DVec3, metres_per_unit: f64) -> Fallible<f64> {
    let is_normalized = flag(prim, "inputs:normalize")?.unwrap_or(false);
    let length = |name: &str, default: f64, axis: DVec3| -> Fallible<f64> {
        Ok(number(prim, name)?.unwrap_or(default).max(0.0) * along(axis).length())
    };
    // Normalized lights are divided by their area in units of the stage; `share` of it is seen from one side.
    let over_area = |area: f64, share: f64| if is_normalized { share * metres_per_unit.powi(2) } else { area };
    Ok(match light.kind {
        LightKind::Point | LightKind::Spot | LightKind::Disk => {
            let radius = length("inputs:radius", 0.5, DVec3::X)?;
            let is_disk = light.kind == LightKind::Disk;
            let is_point = flag(prim, "treatAsPoint")?.unwrap_or(false) && !is_disk;
            light.radius = if is_point { 0.0 } else { radius };
            over_area(PI * radius * radius, if is_disk { 1.0 } else { 0.25 })
        }
        LightKind::Rect => {
            light.size = [length("inputs:width", 1.0, DVec3::X)?, length("inputs:height", 1.0, DVec3::Y)?];
            over_area(light.size[0] * light.size[1], 1.0)
        }
        LightKind::Directional => {
            light.angle = number(prim, "inputs:angle")?.unwrap_or(0.53).clamp(0.0, 180.0).to_radians();
            let solid_angle = PI * (light.angle / 2.0).sin().powi(2);
            if is_normalized || solid_angle == 0.0 { 1.0 } else { solid_angle }
        }
        LightKind::Dome | LightKind::Emitter => 1.0,
    })
}

/// Links that relume wrote by name, and those to prims, by the names of these.
fn links(prim: &Prim) -> Fallible<Links> {
    let names = |name: &str| -> Fallible<Vec<String>> {
        let names = prim.attribute(name).cast::<Vec<String>>()?.unwrap_or_default();
        Ok(names.iter().map(|name| unescaped(name)).collect())
    };
    let targets = |name: &str| -> Fallible<Vec<String>> {
        let paths = prim.relationship(name).targets()?;
        Ok(paths.iter().filter_map(|path| path.name().map(str::to_owned)).collect())
    };
    let mut links = Links {
        only: names("relume:only")?,
        except: names("relume:except")?,
        no_shadow_from: names("relume:noShadowFrom")?,
        ..Links::default()
    };
    if flag(prim, "collection:lightLink:includeRoot")?.unwrap_or(true) {
        links.except.extend(targets("collection:lightLink:excludes")?);
    } else {
        links.only.extend(targets("collection:lightLink:includes")?);
    }
    links.no_shadow_from.extend(targets("collection:shadowLink:excludes")?);
    Ok(links)
}
