//! Placement of lights by pointing at surfaces.

use glam::DVec3;

use super::Desk;
use crate::scene::{Light, LightKind};

/// Share of the distance to an obstacle that a placed light leaves free.
pub(super) const MARGIN: f64 = 0.1;

/// The surface point under the mouse, world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    pub position: DVec3,
    /// Unit geometric normal, towards the eye.
    pub normal: DVec3,
    /// Unit shading normal, towards the eye.
    pub shading_normal: DVec3,
    /// Unit direction to the eye.
    pub to_eye: DVec3,
}

impl Desk {
    /// Places the primary light a little off a surface point; the other selected lights move by the same offset.
    pub fn place(&mut self, at: Pick) {
        self.edit_primary(|desk, light| match light.kind {
            LightKind::Directional => Err("a directional light has no position; aim it"),
            LightKind::Dome => Err("a dome has no position; turn it"),
            LightKind::Emitter => Err("an emitter is where its material is"),
            _ => Ok(Light { position: at.position + at.normal * desk.lift, ..light.clone() }),
        });
    }

    /// Aims the selected lights at a surface point; directional lights then shine along its normal.
    pub fn aim(&mut self, at: Pick) {
        self.edit_each(|_, light| {
            let direction = match light.kind {
                _ if !light.has_direction() => {
                    return Err("a light that shines in all directions cannot aim");
                }
                LightKind::Directional => -at.normal,
                _ => (at.position - light.position).try_normalize().ok_or("it is at that point")?,
            };
            Ok(Light { direction, ..light.clone() })
        });
    }

    /// Returns the direction from `at` in which a light has its highlight there: the mirror direction [Poulin 1992].
    pub fn highlight_direction(at: Pick) -> DVec3 {
        (2.0 * at.to_eye.dot(at.shading_normal) * at.shading_normal - at.to_eye).normalize()
    }

    /// Moves the primary light so that its highlight falls at a surface point. Its distance to the point is unchanged,
    /// or limited by the distance `free` along [`Self::highlight_direction`].
    pub fn place_highlight(&mut self, at: Pick, free: f64) {
        let direction = Self::highlight_direction(at);
        self.edit_primary(|_, light| match direction.dot(at.normal) > 1e-6 {
            false => Err("no highlight is possible there: the mirror direction points into the surface"),
            true => Ok(moved_to(light, at.position, direction, free)),
        });
    }

    /// Moves the primary light so that the shadow of `caster` falls at a surface point [Poulin 1992]. Its distance to
    /// the caster is unchanged, or limited by the distance `free` beyond the caster.
    pub fn place_shadow(&mut self, caster: DVec3, at: Pick, free: f64) {
        let direction = (caster - at.position).try_normalize();
        self.edit_primary(|_, light| match direction.filter(|direction| direction.dot(at.normal) > 1e-6) {
            None => Err("no shadow of that point is possible there: the surface faces away from it"),
            Some(direction) => Ok(moved_to(light, caster, direction, free)),
        });
    }

    /// Edits the primary light; the other selected lights change in the same way.
    fn edit_primary(&mut self, edit: impl FnOnce(&Self, &Light) -> Result<Light, &'static str>) {
        match self.selected_light().map(|light| (edit(self, light), &light.name)) {
            None => self.message = "no light is selected".into(),
            Some((Err(reason), name)) => self.message = format!("{name}: {reason}"),
            Some((Ok(light), _)) => self.edit_primary_and_selection(light),
        }
    }
}

/// Moves `light` to its distance from `point` along `direction`, or nearer if less is `free`, and aims it at the
/// point.
fn moved_to(light: &Light, point: DVec3, direction: DVec3, free: f64) -> Light {
    let mut light = light.clone();
    if light.kind.has_position() {
        light.position = point + direction * (light.position - point).length().min((1.0 - MARGIN) * free);
    }
    if light.has_direction() {
        light.direction = -direction;
    }
    light
}
