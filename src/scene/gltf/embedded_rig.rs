//! The exact rig that export stores next to the glTF lights: groups, followers, links, switches and everything else
//! that glTF cannot represent. It is used only while the file's lights agree with it.

use std::collections::HashMap;

use super::document::Document;
use super::light_extension::LightExtension;
use crate::scene::{Light, LightKind, Rig, RigFiles};

/// Key in the extras of the shown scene; the value is the text of a rig file.
pub const KEY: &str = "relume_rig";

/// Relative tolerance: rounding to single precision by another program.
const NEAR: f64 = 1e-5;

/// The rig of a file whose nodes and scene contain `lights`.
pub fn rig(document: &Document, lights: Vec<Light>) -> Rig {
    let extras = document.poses.scenes.get(document.shown_scene()).and_then(|scene| scene.extras.as_ref());
    let loaded = Rig { lights, ..Rig::default() };
    let Some(text) = extras.and_then(|extras| extras.get(KEY)).and_then(|text| text.as_str()) else { return loaded };
    let path = document.path.display();
    let sky_maps = loaded.lights.iter().filter_map(|light| light.map.as_ref()?.as_file().cloned());
    let files = RigFiles::of_scene(&document.path, sky_maps);
    match Rig::from_toml(text, files) {
        Err(reason) => tracing::warn!("{path}: its exact rig is discarded: {reason}"),
        Ok(embedded) => match with_file_nodes(embedded, &loaded) {
            Some(embedded) => return embedded,
            None => {
                let lost = "groups, followers and links are discarded";
                tracing::info!("{path}: its lights were edited since relume wrote them; {lost}")
            }
        },
    }
    loaded
}

/// `embedded` with the file's node indices, if its lights agree with those of the file's nodes.
fn with_file_nodes(mut embedded: Rig, loaded: &Rig) -> Option<Rig> {
    let at_nodes = loaded.lights.iter().filter(|light| light.kind.is_in_gltf());
    let by_name: HashMap<&str, &Light> = at_nodes.map(|light| (light.name.as_str(), light)).collect();
    let in_gltf = |light: &&mut Light| light.kind.is_in_gltf();
    if embedded.lights.iter_mut().filter(in_gltf).count() != by_name.len() {
        return None;
    }
    for light in embedded.lights.iter_mut().filter(in_gltf) {
        let found = by_name.get(light.name.as_str())?;
        light.node = found.node;
        // Profiles are stored once, by their extension.
        if light.kind == LightKind::Point {
            light.filter.ies = found.filter.ies.clone();
        }
    }
    let active = embedded.with_solo_applied();
    let in_gltf = (0..active.lights.len()).filter(|&i| active.lights[i].kind.is_in_gltf());
    let is_same = in_gltf.into_iter().all(|i| is_same(&active, i, by_name[active.lights[i].name.as_str()]));
    is_same.then_some(embedded)
}

/// Whether light `index` of `rig` agrees with the glTF light `found`.
fn is_same(rig: &Rig, index: usize, found: &Light) -> bool {
    let light = &rig.lights[index].nearest_in_gltf();
    let near = |a: f64, b: f64| (a - b).abs() <= NEAR * a.abs().max(b.abs()).max(NEAR);
    let (want, got) = (rig.scale(index).as_dvec3(), found.scale().as_dvec3());
    let same_strength = want.distance(got) <= NEAR * want.length();
    let same_place = light.position.distance(found.position) <= NEAR * (1.0 + light.position.length());
    let same_direction = !light.has_direction() || light.direction.distance(found.direction) <= NEAR;
    let same_cone = near(light.outer_angle, found.outer_angle) && (light.inner_angle - found.inner_angle).abs() <= NEAR;
    let same_range = match (light.range, found.range) {
        (Some(a), Some(b)) => near(a, b),
        (a, b) => a == b,
    };
    let same_up = light.up_axis_in_gltf().is_none() || light.axes()[1].distance(found.axes()[1]) <= NEAR;
    let extension = LightExtension::of(light);
    let same_shape = match (light.kind, extension) {
        (LightKind::Rect, _) => same_place && near(light.size[0], found.size[0]) && near(light.size[1], found.size[1]),
        (LightKind::Disk, _) => same_place && near(light.radius, found.radius),
        (LightKind::Point, LightExtension::Profile) => same_place,
        (LightKind::Point, _) => same_place && same_range,
        (LightKind::Spot, _) => same_place && same_range && same_cone,
        (LightKind::Directional | LightKind::Dome | LightKind::Emitter, _) => true,
    };
    light.kind == found.kind
        && extension == LightExtension::of(found)
        && same_strength
        && same_direction
        && same_up
        && same_shape
}
