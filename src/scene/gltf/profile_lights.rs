//! `EXT_lights_ies`: points with an IES profile, aimed along -z of their node.

use std::collections::HashMap;

use glam::DAffine3;

use super::document::Document;
use super::light_entries::ProfileInstance;
use crate::error::Result;
use crate::scene::Light;
use crate::scene::light_filter::{Attached, LightFilter, Profile};

/// The profiles that have been read, by index.
pub type Profiles = HashMap<usize, Attached<Profile>>;

impl Document {
    /// `None` if the node has zero scale and thus no direction.
    pub fn profile_light(
        &self,
        instance: &ProfileInstance,
        node: usize,
        world_from_node: &DAffine3,
        profiles: &mut Profiles,
    ) -> Result<Option<Light>> {
        let index = instance.light;
        let what = format!("IES light {index} of {}", self.node_name(node));
        let position = self.light_position(world_from_node, &what)?;
        let Some(direction) = self.light_direction(world_from_node, &what)? else { return Ok(None) };
        let ies = match profiles.get(&index) {
            Some(profile) => profile.clone(),
            None => profiles.entry(index).or_insert(self.profile(index, &self.node_name(node))?).clone(),
        };
        let candela = instance.multiplier.unwrap_or(1.0) * ies.max();
        let (color, intensity) = self.light_strength(instance.color, candela, &what)?;
        let filter = LightFilter { ies: Some(ies), ..LightFilter::default() };
        let mut light = Light { direction, color, intensity, filter, ..Light::point("", position) };
        if let Some(axis) = light.up_axis_in_gltf() {
            light.up = world_from_node.matrix3.col(axis).try_normalize().unwrap_or(light.up);
        }
        Ok(Some(light))
    }

    fn profile(&self, index: usize, asked_by: &str) -> Result<Attached<Profile>> {
        let bytes = self.profile_bytes(index, asked_by)?;
        let profile = Profile::parse(&bytes);
        let profile = profile.map_err(|reason| self.error(format!("IES light {index}: {reason}")))?;
        Ok(Attached::new(&self.profile_path(index), &bytes, profile))
    }
}
