//! Writes a [`Rig`] as TOML for people to edit: shortest digits, no redundant keys.

use std::f64::consts::FRAC_PI_4;
use std::fmt::{Display, Write};
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use super::{Rig, RigSnapshot, Shot};
use crate::scene::light_filter::{Gobo, SOFTNESS_DEG};
use crate::scene::{
    Camera, DomeMap, Light, LightFilter, LightGroup, LightKind, Links, ObjectSet, PhysicalSky, Projection,
};

/// `folder`: where the file will be; paths are relative to it.
pub fn to_toml(rig: &Rig, folder: &Path) -> String {
    let mut out = Document::default();
    if let Some(camera) = &rig.camera {
        out.camera(camera);
    }
    out.lists(rig, folder);
    rig.shots.iter().for_each(|shot| out.shot(shot));
    for RigSnapshot { slot, note, rig } in &rig.snapshots {
        out.table = "";
        out.header("snapshot");
        out.key("slot", slot + 1);
        if !note.is_empty() {
            out.key("note", string(note));
        }
        out.table = "snapshot.";
        out.lists(rig, folder);
    }
    out.text
}

/// A light as a table of [`to_toml`], with absolute paths.
pub fn light_entry(rig: &Rig, light: usize) -> toml::Table {
    let mut out = Document::default();
    out.light(&rig.lights[light], rig, Path::new(""));
    let mut entry = out.only_entry("light");
    let Light { map, filter, .. } = &rig.lights[light];
    let absolute = |path: &Path| toml::Value::from(&*path.to_string_lossy());
    if let Some(map) = map.as_ref().and_then(DomeMap::as_file) {
        entry.insert("map".into(), absolute(map.path()));
    }
    if let Some(ies) = &filter.ies {
        entry.insert("ies".into(), absolute(ies.path()));
    }
    if let (Some(gobo), Some(toml::Value::Table(entry))) = (&filter.gobo, entry.get_mut("gobo")) {
        entry.insert("image".into(), absolute(gobo.image.path()));
    }
    entry
}

/// A group as a table of [`to_toml`].
pub fn group_entry(group: &LightGroup) -> toml::Table {
    let mut out = Document::default();
    out.group(group);
    out.only_entry("group")
}

#[derive(Default)]
struct Document {
    text: String,
    /// Before the names of tables: "snapshot." within a snapshot.
    table: &'static str,
}

impl Document {
    /// The one entry of the list `list`.
    fn only_entry(&self, list: &str) -> toml::Table {
        let mut document: toml::Table = self.text.parse().expect("it is TOML");
        match document.remove(list) {
            Some(toml::Value::Array(mut entries)) => match entries.pop() {
                Some(toml::Value::Table(entry)) => entry,
                _ => unreachable!("entries are tables"),
            },
            _ => unreachable!("an entry was written"),
        }
    }

    /// Begins an entry of a list.
    fn header(&mut self, list: &str) {
        let gap = if self.text.is_empty() { "" } else { "\n" };
        let table = self.table;
        writeln!(self.text, "{gap}[[{table}{list}]]").expect("writing to a string cannot fail");
    }

    fn lists(&mut self, rig: &Rig, folder: &Path) {
        rig.groups.iter().for_each(|group| self.group(group));
        rig.sets.iter().for_each(|set| self.set(set));
        rig.lights.iter().for_each(|light| self.light(light, rig, folder));
    }

    fn shot(&mut self, shot: &Shot) {
        self.table = "";
        self.header("shot");
        self.key("camera", string(&shot.camera));
        self.table = "shot.";
        for (table, list) in [("group", "groups"), ("light", "lights")] {
            for (name, values) in shot.entries(list) {
                self.header(table);
                self.key("name", string(name));
                let (unset, set): (Vec<_>, Vec<_>) = values.iter().partition(|(_, value)| value.is_null());
                set.into_iter().for_each(|(key, value)| self.key(key, toml_value(value)));
                if !unset.is_empty() {
                    self.key("unset", toml_value(unset.into_iter().map(|(key, _)| key).collect::<Vec<_>>()));
                }
            }
        }
    }

    fn key(&mut self, key: &str, value: impl Display) {
        writeln!(self.text, "{key} = {value}").expect("writing to a string cannot fail");
    }

    fn camera(&mut self, camera: &Camera) {
        self.text.push_str("[camera]\n");
        self.key("name", string(&camera.name));
        self.key("position", vector(camera.position));
        // As far away as the position is from the origin, so that their difference retains its digits.
        let distance = camera.position.abs().max_element().max(1.0).log2().ceil().exp2();
        self.key("target", vector(camera.position - camera.world_from_camera.z_axis * distance));
        self.key("up", vector(camera.world_from_camera.y_axis));
        match camera.projection {
            Projection::Perspective { yfov } => self.key("yfov_deg", number(degrees(yfov))),
            Projection::Orthographic { ymag } => self.key("ymag", number(ymag)),
        }
    }

    fn group(&mut self, group: &LightGroup) {
        self.header("group");
        self.key("name", string(&group.name));
        self.key("stops", number(group.stops));
        self.key("color", color(group.color));
        self.key("enabled", group.enabled);
        if group.solo {
            self.key("solo", true);
        }
    }

    fn set(&mut self, set: &ObjectSet) {
        self.header("set");
        self.key("name", string(&set.name));
        self.key("items", toml_value(&set.items));
    }

    fn light(&mut self, light: &Light, rig: &Rig, folder: &Path) {
        let kind = match light.kind {
            LightKind::Point => "point",
            LightKind::Spot => "spot",
            LightKind::Directional => "directional",
            LightKind::Disk => "disk",
            LightKind::Rect => "rect",
            LightKind::Dome => "dome",
            LightKind::Emitter => "emitter",
        };
        self.header("light");
        self.key("name", string(&light.name));
        self.key("kind", string(kind));
        if let Some(material) = &light.material {
            self.key("material", string(material));
        }
        // Values that a kind ignores are written only if they are not the defaults: they apply again if the kind
        // changes.
        if light.kind.has_position() || light.position != DVec3::ZERO {
            self.key("position", vector(light.position));
        }
        if light.has_direction() || light.direction != DVec3::NEG_Z {
            self.key("direction", vector(light.direction));
        }
        self.key("color", color(light.color));
        self.key("intensity", number(light.intensity));
        self.key("stops", number(light.stops));
        if light.kind == LightKind::Spot || (light.inner_angle, light.outer_angle) != (0.0, FRAC_PI_4) {
            self.key("inner_deg", number(degrees(light.inner_angle)));
            self.key("outer_deg", number(degrees(light.outer_angle)));
        }
        if light.kind == LightKind::Disk || light.radius != 0.0 {
            self.key("radius", number(light.radius));
        }
        let default = Light::point("", DVec3::ZERO);
        let is_rect = light.kind == LightKind::Rect;
        if is_rect || light.size != default.size {
            self.key("width", number(light.size[0]));
            self.key("height", number(light.size[1]));
        }
        if is_rect || light.up != default.up {
            self.key("up", vector(light.up));
        }
        if light.angle != default.angle {
            self.key("angle_deg", number(degrees(light.angle)));
        }
        if light.spread != default.spread {
            self.key("spread_deg", number(degrees(light.spread)));
        }
        if light.visible {
            self.key("visible", true);
        }
        if light.two_sided {
            self.key("two_sided", true);
        }
        if let Some(range) = light.range {
            self.key("range", number(range));
        }
        if light.decay_start != default.decay_start {
            self.key("decay_start", number(light.decay_start));
        }
        match &light.map {
            None => {}
            Some(DomeMap::File(map)) => self.key("map", string(&map.path_from(folder).to_string_lossy())),
            Some(DomeMap::Physical(map)) => self.physical_sky(map.sky()),
        }
        if light.rotation != default.rotation {
            self.key("rotate_deg", number(degrees(light.rotation)));
        }
        self.filter(&light.filter, folder);
        if let Some(group) = light.group {
            self.key("group", string(&rig.groups[group].name));
        }
        if let Some(leader) = light.follows {
            self.key("follows", string(&rig.lights[leader].name));
        }
        self.key("enabled", light.enabled);
        if light.solo {
            self.key("solo", true);
        }
        self.key("shadows", light.shadows);
        let Links { only, except, factor, no_shadow_from } = &light.links;
        for (key, names) in [("only", only), ("except", except), ("no_shadow_from", no_shadow_from)] {
            if !names.is_empty() {
                self.key(key, toml_value(names));
            }
        }
        if !factor.is_empty() {
            self.key("factor", toml_value(factor));
        }
        if let Some(node) = light.node {
            self.key("node", node);
        }
    }
}

impl Document {
    fn physical_sky(&mut self, sky: &PhysicalSky) {
        let PhysicalSky { elevation, turbidity, ground, sun } = *sky;
        let (elevation, turbidity, ground) = (number(degrees(elevation)), number(turbidity), number(ground));
        let place = format!("elevation_deg = {elevation}, turbidity = {turbidity}, ground = {ground}");
        self.key("physical_sky", format!("{{ {place}, sun = {sun} }}"));
    }

    fn filter(&mut self, filter: &LightFilter, folder: &Path) {
        let path = |path: PathBuf| string(&path.to_string_lossy());
        if let Some(ies) = &filter.ies {
            self.key("ies", path(ies.path_from(folder)));
        }
        if let Some(Gobo { image, rotation, scale, tint }) = &filter.gobo {
            let image = path(image.path_from(folder));
            let (turn, scale, tint) = (number(degrees(*rotation)), number(*scale), color(*tint));
            self.key("gobo", format!("{{ image = {image}, rotate_deg = {turn}, scale = {scale}, tint = {tint} }}"));
        }
        if let Some(doors) = &filter.barn_doors {
            let angles = doors.angles.map(|angle| number(degrees(angle))).join(", ");
            self.key("barn_doors_deg", format!("[{angles}]"));
            if doors.softness != SOFTNESS_DEG.to_radians() {
                self.key("barn_doors_soft_deg", number(degrees(doors.softness)));
            }
        }
    }
}

/// The shortest decimal that reads back as `x`, with a point or an exponent as TOML requires.
fn number(x: impl Into<f64>) -> String {
    format!("{:?}", x.into())
}

fn vector(v: DVec3) -> String {
    format!("[{}, {}, {}]", number(v.x), number(v.y), number(v.z))
}

/// f32's shortest digits: 0.95, not 0.949999988079071.
fn color(c: Vec3) -> String {
    format!("[{:?}, {:?}, {:?}]", c.x, c.y, c.z)
}

fn toml_value(of: impl serde::Serialize) -> toml::Value {
    toml::Value::try_from(of).expect("plain data is serialized in memory")
}

fn string(s: &str) -> String {
    toml::Value::String(s.into()).to_string()
}

/// The shortest degrees that convert back to `radians`; if there are none, the nearest.
fn degrees(radians: f64) -> f64 {
    let exact = radians.to_degrees();
    (0..=15)
        .filter_map(|digits| format!("{exact:.digits$}").parse::<f64>().ok())
        .chain([exact.next_down(), exact.next_up()])
        .find(|shorter| shorter.to_radians() == radians)
        .unwrap_or(exact)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_degrees_stay_round() {
        for deg in [0.0, 18.0, 28.0, 42.0, 33.3, 89.999, 90.0] {
            assert_eq!(degrees(f64::to_radians(deg)), deg);
        }
    }
}
