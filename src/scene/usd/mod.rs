//! Lights of USD files: UsdLux [UsdLux 2025] to a [`Rig`] and back.
//!
//! | UsdLux | relume |
//! |---|---|
//! | `SphereLight` | point; with `treatAsPoint` without radius; with a cone of `ShapingAPI` spot |
//! | `DiskLight`, `RectLight` | disk, rect; with a cone: their spread |
//! | `DistantLight` | directional |
//! | `DomeLight`, `DomeLight_1` | dome |
//!
//! Luminance is `intensity` * 2^`exposure` * `color`, over the light's area if `normalize` is set. A sphere of radius r
//! and luminance L has the luminous intensity L π r², and the area 4 π r².

mod prims;
mod read;
mod resolver;
mod write;

use std::path::Path;

pub use self::read::load;
pub use self::write::save;

use super::{Light, LightFilter, LightKind, Links, Rig};

/// Extensions of USD files.
pub const EXTENSIONS: [&str; 4] = ["usda", "usd", "usdc", "usdz"];

/// Key of the root layer's `customLayerData` with the exact rig: the text of a rig file in base64, as not all programs
/// understand escaped characters.
const EXACT_RIG: &str = "relume_rig";

/// Relative tolerance of what other programs write in single precision.
const NEAR: f64 = 1e-5;

/// Whether a path is that of a USD file, by its extension.
pub fn is_usd(path: &Path) -> bool {
    path.extension().is_some_and(|of| EXTENSIONS.iter().any(|usd| of.eq_ignore_ascii_case(usd)))
}

/// Whether UsdLux has lights of this kind, or some that are nearly alike.
fn has(light: &Light) -> bool {
    let is_physical_sky = light.map.as_ref().is_some_and(|map| map.as_file().is_none());
    light.kind != LightKind::Emitter && !is_physical_sky
}

/// Light `index` of a rig as a file without the exact rig has it: its group, switches and stops as intensity and
/// colour, and without what UsdLux cannot hold.
fn nearest(rig: &Rig, index: usize) -> Light {
    let light = &rig.lights[index];
    let group = light.group.map(|group| &rig.groups[group]);
    let filter = LightFilter { ies: light.filter.ies.clone(), ..LightFilter::default() };
    let Links { only, except, no_shadow_from, .. } = light.links.clone();
    let keeps_profile = matches!(light.kind, LightKind::Point | LightKind::Spot);
    Light {
        color: group.map_or(light.color, |group| light.color * group.color),
        stops: light.stops + group.map_or(0.0, |group| group.stops),
        enabled: light.enabled && group.is_none_or(|group| group.enabled),
        filter: if keeps_profile { filter } else { LightFilter::default() },
        links: Links { only, except, no_shadow_from, ..Links::default() },
        two_sided: false,
        visible: false,
        range: None,
        decay_start: 0.0,
        group: None,
        solo: false,
        follows: None,
        node: None,
        ..light.clone()
    }
}

/// Whether two lights agree in all that UsdLux holds.
fn is_same(a: &Light, b: &Light) -> bool {
    let near = |a: f64, b: f64| (a - b).abs() <= NEAR * a.abs().max(b.abs()).max(NEAR);
    let same_strength = a.scale().distance(b.scale()) <= NEAR as f32 * a.scale().length();
    let same_place = !a.kind.has_position() || a.position.distance(b.position) <= NEAR * (1.0 + a.position.length());
    let same_direction = !a.has_direction() || a.direction.distance(b.direction) <= NEAR;
    let same_shape = match a.kind {
        LightKind::Point => near(a.radius, b.radius),
        LightKind::Spot => {
            near(a.radius, b.radius) && near(a.outer_angle, b.outer_angle) && near(a.inner_angle, b.inner_angle)
        }
        LightKind::Disk => near(a.radius, b.radius) && near(a.spread, b.spread),
        LightKind::Rect => {
            let same_sides = near(a.size[0], b.size[0]) && near(a.size[1], b.size[1]);
            same_sides && near(a.spread, b.spread) && a.axes()[1].distance(b.axes()[1]) <= NEAR
        }
        LightKind::Directional => near(a.angle, b.angle),
        LightKind::Dome => (a.turns() - b.turns()).abs() <= NEAR && a.map == b.map,
        LightKind::Emitter => true,
    };
    let same_links = a.links == b.links && a.shadows == b.shadows && a.enabled == b.enabled;
    a.kind == b.kind
        && same_strength
        && same_place
        && same_direction
        && same_shape
        && same_links
        && a.filter == b.filter
}
