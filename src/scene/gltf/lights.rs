//! Lights and cameras, converted from nodes to world space. [`super::area_lights`], [`super::profile_lights`] and
//! [`super::image_lights`] have the lights that are not in `KHR_lights_punctual`.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::document::Document;
use super::light_extension::LightExtension;
use super::nodes::Placed;
use super::profile_lights::Profiles;
use crate::error::Result;
use crate::scene::rig::UniqueNames;
use crate::scene::{Camera, Light, LightKind, Projection};

impl Document {
    pub fn import_lights(&self, placed: &[Placed]) -> Result<Vec<Light>> {
        let mut names = UniqueNames::default();
        let mut profiles = Profiles::new();
        let mut lights = Vec::new();
        let mut without_direction = 0;
        for &Placed { node, ref world_from_node, .. } in placed {
            let entry = &self.poses.nodes[node];
            for extension in entry.light_extensions() {
                let name = self.light_name(node, extension).unwrap_or_else(|| format!("light{}", lights.len()));
                let name = names.claim(&name);
                let light = match (extension, entry.light(extension), entry.profile()) {
                    (LightExtension::Punctual, Some(index), _) => self.punctual_light(index, node, world_from_node)?,
                    (LightExtension::Area, Some(index), _) => self.area_light(index, node, world_from_node)?,
                    (_, _, Some(instance)) => self.profile_light(instance, node, world_from_node, &mut profiles)?,
                    _ => continue,
                };
                match light {
                    Some(light) => lights.push(Light { name, node: Some(node), ..light }),
                    None => without_direction += 1,
                }
            }
        }
        if without_direction > 0 {
            let path = self.path.display();
            tracing::warn!(
                "{path}: {without_direction} lights at nodes of zero scale have no direction and are ignored"
            );
        }
        if let Some(light) = self.image_light()? {
            lights.push(Light { name: names.claim(&light.name), ..light });
        }
        Ok(lights)
    }

    /// The name of the node, else that of its light in `extension`.
    pub fn light_name(&self, node: usize, extension: LightExtension) -> Option<String> {
        let node = &self.poses.nodes[node];
        let light = node.light(extension);
        let of_light = match extension {
            LightExtension::Punctual => light.and_then(|light| self.lights().get(light)?.name.as_ref()),
            LightExtension::Area => light.and_then(|light| self.area_lights().get(light)?.name.as_ref()),
            LightExtension::Profile => light.and_then(|light| self.profiles().get(light)?.name.as_ref()),
        };
        [node.name.as_ref(), of_light].into_iter().flatten().find(|name| !name.is_empty()).cloned()
    }

    /// `None` if a spot or directional light is at a node of zero scale, which has no direction.
    fn punctual_light(&self, index: usize, node: usize, world_from_node: &DAffine3) -> Result<Option<Light>> {
        let entry = self.item(self.lights(), index, "light", &self.node_name(node))?;
        let what = format!("light {index} of {}", self.node_name(node));
        let wrong = |reason: &str| self.error(format!("{what}: {reason}"));
        let kind = match entry.kind.as_str() {
            "point" => LightKind::Point,
            "spot" => LightKind::Spot,
            "directional" => LightKind::Directional,
            kind => return Err(wrong(&format!("type \"{kind}\" is not defined by KHR_lights_punctual"))),
        };
        let (color, intensity) = self.light_strength(entry.color, entry.intensity.unwrap_or(1.0), &what)?;
        if entry.range.is_some_and(|range| range <= 0.0) {
            return Err(wrong("its range is not positive"));
        }
        let range = entry.range.filter(|_| kind != LightKind::Directional);
        let mut light = Light { kind, color, intensity, range, ..Light::point("", DVec3::ZERO) };
        // Values that a kind ignores stay at their defaults.
        if kind != LightKind::Directional {
            light.position = self.light_position(world_from_node, &what)?;
        }
        if kind != LightKind::Point {
            let Some(direction) = self.light_direction(world_from_node, &what)? else { return Ok(None) };
            light.direction = direction;
        }
        if kind == LightKind::Spot {
            let inner = entry.spot.inner_cone_angle.unwrap_or(0.0);
            let outer = entry.spot.outer_cone_angle.unwrap_or(FRAC_PI_4);
            // pi/2 rounded to single precision is slightly more than pi/2.
            if !(0.0 <= inner && inner <= outer && outer <= FRAC_PI_2 + 1e-6) {
                return Err(wrong(&format!("cone angles {inner} and {outer} are not 0 <= inner <= outer <= pi/2")));
            }
            (light.inner_angle, light.outer_angle) = (inner.min(FRAC_PI_2), outer.min(FRAC_PI_2));
        }
        Ok(Some(light))
    }

    /// Colour and intensity, checked. A negative intensity becomes 0, with a warning.
    pub fn light_strength(&self, color: Option<[f32; 3]>, intensity: f64, what: &str) -> Result<(Vec3, f64)> {
        let color = Vec3::from_array(color.unwrap_or([1.0; 3]));
        if !(color.is_finite() && color.min_element() >= 0.0) {
            return Err(self.error(format!("{what}: its colour is negative or not finite")));
        }
        if !(color * intensity as f32).is_finite() {
            return Err(self.error(format!("{what}: its intensity is too large")));
        }
        if intensity < 0.0 {
            let path = self.path.display();
            tracing::warn!("{path}: {what} has a negative intensity ({intensity}), replaced by 0");
        }
        Ok((color, intensity.max(0.0)))
    }

    pub fn light_position(&self, world_from_node: &DAffine3, what: &str) -> Result<DVec3> {
        let position = world_from_node.translation;
        if position.is_finite() { Ok(position) } else { Err(self.error(format!("{what}: its position is not finite"))) }
    }

    /// The direction of -z; `None` if the node's z axis has zero scale.
    pub fn light_direction(&self, world_from_node: &DAffine3, what: &str) -> Result<Option<DVec3>> {
        let axis = world_from_node.matrix3.z_axis;
        if axis == DVec3::ZERO {
            return Ok(None);
        }
        // Divided by the largest component first: a tiny scale must not underflow.
        let direction = -(axis / axis.abs().max_element());
        let direction = direction.try_normalize();
        direction.map(Some).ok_or_else(|| self.error(format!("{what}: its node has no direction")))
    }

    pub fn import_cameras(&self, placed: &[Placed]) -> Result<Vec<Camera>> {
        let mut names = UniqueNames::default();
        let mut cameras = Vec::new();
        for Placed { node, world_from_node, .. } in placed {
            let Some(index) = self.poses.nodes[*node].camera else { continue };
            let entry = self.item(&self.poses.cameras, index, "camera", &self.node_name(*node))?;
            let wrong = |reason: &str| self.error(format!("camera {index} of {}: {reason}", self.node_name(*node)));
            let aspect = match (&entry.perspective, &entry.orthographic) {
                (Some(p), _) => p.aspect_ratio,
                (_, Some(o)) => o.xmag.map(|xmag| xmag / o.ymag),
                _ => None,
            };
            let projection = match (entry.kind.as_str(), &entry.perspective, &entry.orthographic) {
                ("perspective", Some(p), _) if 0.0 < p.yfov && p.yfov < PI => Projection::Perspective { yfov: p.yfov },
                ("perspective", Some(_), _) => return Err(wrong("yfov does not lie between 0 and pi")),
                ("orthographic", _, Some(o)) if 0.0 < o.ymag && o.ymag.is_finite() => {
                    Projection::Orthographic { ymag: o.ymag }
                }
                ("orthographic", _, Some(_)) => return Err(wrong("ymag is not positive")),
                _ => return Err(wrong("is neither a perspective nor an orthographic camera")),
            };
            let names_of = [&self.poses.nodes[*node].name, &entry.name];
            let name = names_of.into_iter().flatten().find(|n| !n.is_empty()).cloned();
            let name = names.claim(&name.unwrap_or_else(|| format!("camera{}", cameras.len())));
            let position = world_from_node.translation;
            if !world_from_node.is_finite() {
                return Err(wrong("its node's transform is not finite"));
            }
            let Some(world_from_camera) = unscaled(world_from_node.matrix3) else {
                let (path, node) = (self.path.display(), self.node_name(*node));
                tracing::warn!("{path}: camera {index} of {node} has zero scale and no direction; it is ignored");
                continue;
            };
            // Other aspect ratios are assumed to be mistakes.
            let aspect = aspect.filter(|aspect| (1.0 / 16.0..=16.0).contains(aspect));
            cameras.push(Camera { name, position, world_from_camera, projection, aspect });
        }
        Ok(cameras)
    }
}

/// The axes right, up and back without scale, shear or mirroring: back is unchanged, up is changed as little as
/// possible.
fn unscaled(matrix: DMat3) -> Option<DMat3> {
    if super::nodes::is_singular(matrix) {
        return None;
    }
    let back = matrix.z_axis.try_normalize()?;
    let up = matrix.y_axis.try_normalize()?;
    let right = up.cross(back).try_normalize()?;
    Some(DMat3::from_cols(right, back.cross(right), back))
}
