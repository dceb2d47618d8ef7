//! Lights put where somebody points.

use glam::DVec3;

use super::Desk;
use crate::scene::{Light, LightKind};

/// Of the way to what is in the way, so much is left free.
const MARGIN: f64 = 0.1;

/// A surface point that somebody points at, world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    pub position: DVec3,
    /// Unit; towards the eye.
    pub normal: DVec3,
    /// Unit, of the surface as it is shaded.
    pub shading_normal: DVec3,
    /// Unit; where it is seen from.
    pub to_eye: DVec3,
}

impl Desk {
    /// Puts the light that was selected last at a surface point, a little off it; the others keep their distance to it.
    pub fn place(&mut self, at: Pick) {
        self.edit_primary(|desk, light| match light.kind {
            LightKind::Directional => Err("a directional light has no place; aim it"),
            _ => Ok(Light { position: at.position + at.normal * desk.lift, ..light.clone() }),
        });
    }

    /// Aims the selected lights at a surface point; a directional light then meets it head-on.
    pub fn aim(&mut self, at: Pick) {
        self.edit_each(|_, light| {
            let direction = match light.kind {
                LightKind::Point => return Err("a point light shines everywhere; nothing to aim"),
                LightKind::Directional => -at.normal,
                LightKind::Spot => (at.position - light.position).try_normalize().ok_or("it is there already")?,
            };
            Ok(Light { direction, ..light.clone() })
        });
    }

    /// Along which way from `at` a light has to stand for its highlight to fall there [Poulin 1992].
    pub fn highlight_way(at: Pick) -> DVec3 {
        (2.0 * at.to_eye.dot(at.shading_normal) * at.shading_normal - at.to_eye).normalize()
    }

    /// Puts the light that was selected last where its highlight falls at a surface point, as far from it as it was, or
    /// as is `free` along [`Self::highlight_way`].
    pub fn place_highlight(&mut self, at: Pick, free: f64) {
        let way = Self::highlight_way(at);
        self.edit_primary(|_, light| match way.dot(at.normal) > 1e-6 {
            false => Err("no highlight falls there: the surface mirrors what is behind it"),
            true => Ok(moved_to(light, at.position, way, free)),
        });
    }

    /// Puts the light that was selected last where it casts the shadow of `caster` to a surface point [Poulin 1992], as
    /// far from the caster as it was, or as is `free` beyond it.
    pub fn place_shadow(&mut self, caster: DVec3, at: Pick, free: f64) {
        let way = (caster - at.position).try_normalize();
        self.edit_primary(|_, light| match way.filter(|way| way.dot(at.normal) > 1e-6) {
            None => Err("no shadow of that point falls there: the surface turns away from it"),
            Some(way) => Ok(moved_to(light, caster, way, free)),
        });
    }

    /// Edits the light that was selected last, and the others alike.
    fn edit_primary(&mut self, edit: impl FnOnce(&Self, &Light) -> Result<Light, &'static str>) {
        match self.selected_light().map(|light| (edit(self, light), &light.name)) {
            None => self.message = "no light is selected".into(),
            Some((Err(reason), name)) => self.message = format!("{name}: {reason}"),
            Some((Ok(light), _)) => self.edit_alike(light),
        }
    }
}

/// `light` at its distance from `point` along `way`, or nearer if less is `free`, and shining at the point.
fn moved_to(light: &Light, point: DVec3, way: DVec3, free: f64) -> Light {
    let mut light = light.clone();
    if light.kind != LightKind::Directional {
        light.position = point + way * (light.position - point).length().min((1.0 - MARGIN) * free);
    }
    if light.kind != LightKind::Point {
        light.direction = -way;
    }
    light
}
