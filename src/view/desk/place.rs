//! Lights put where somebody points.

use glam::DVec3;

use super::Desk;
use crate::scene::{Light, LightKind};

/// A surface point that somebody points at, world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    pub position: DVec3,
    /// Unit; towards the eye.
    pub normal: DVec3,
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

    /// Edits the light that was selected last, and the others alike.
    fn edit_primary(&mut self, edit: impl FnOnce(&Self, &Light) -> Result<Light, &'static str>) {
        match self.selected_light().map(|light| (edit(self, light), &light.name)) {
            None => self.message = "no light is selected".into(),
            Some((Err(reason), name)) => self.message = format!("{name}: {reason}"),
            Some((Ok(light), _)) => self.edit_alike(light),
        }
    }
}
