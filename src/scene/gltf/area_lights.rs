//! `EXT_lights_area`: rectangles and disks that shine along -z of their node.

use glam::{DAffine3, DVec3};

use super::document::Document;
use crate::error::Result;
use crate::scene::{Light, LightKind, LightUnit};

/// Default of the extension.
const NITS: f64 = 1000.0;

impl Document {
    /// `None` if the node has zero scale and thus no direction.
    pub fn area_light(&self, index: usize, node: usize, world_from_node: &DAffine3) -> Result<Option<Light>> {
        let entry = self.item(self.area_lights(), index, "area light", &self.node_name(node))?;
        let what = format!("area light {index} of {}", self.node_name(node));
        let wrong = |reason: &str| self.error(format!("{what}: {reason}"));
        let kind = match entry.kind.as_str() {
            "rect" => LightKind::Rect,
            "disk" => LightKind::Disk,
            kind => return Err(wrong(&format!("type \"{kind}\" is not defined by EXT_lights_area"))),
        };
        let (size, aspect) = (entry.size.unwrap_or(1.0), entry.rect.aspect.unwrap_or(1.0));
        if size <= 0.0 || aspect <= 0.0 {
            return Err(wrong("its size or aspect is not positive"));
        }
        let position = self.light_position(world_from_node, &what)?;
        let Some(direction) = self.light_direction(world_from_node, &what)? else { return Ok(None) };
        let size = size * world_scale(world_from_node);
        let mut light = Light { kind, direction, ..Light::point("", position) };
        match kind {
            LightKind::Disk => light.radius = size / 2.0,
            _ => light.size = [size * aspect, size],
        }
        if let Some(axis) = light.up_axis_in_gltf() {
            light.up = world_from_node.matrix3.col(axis).try_normalize().unwrap_or(light.up);
        }
        let Some(nits_of_a_candela) = light.per_intensity(LightUnit::Nit) else {
            return Err(wrong("its size is too small or too large"));
        };
        let candela = entry.intensity.unwrap_or(NITS) / nits_of_a_candela;
        (light.color, light.intensity) = self.light_strength(entry.color, candela, &what)?;
        Ok(Some(light))
    }
}

/// By this the size of an area light is multiplied: the largest component of the node's scale.
pub fn world_scale(world_from_node: &DAffine3) -> f64 {
    let matrix = world_from_node.matrix3;
    [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max)
}
