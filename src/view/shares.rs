//! Each light's share of the light in the picture. It is measured from the light images, one light at a time at rest,
//! and measured again only for lights that changed.

use std::sync::Arc;

use crate::desk::luminance;
use crate::desk::rig_state::RigState;
use crate::error::Result;
use crate::relight::{Picture, Relighter};
use crate::scene::{Light, LightGroup};

/// Measured shares of the lights.
#[derive(Default)]
pub struct Shares {
    /// By light; `None` if not measured yet.
    measured: Vec<Option<Measured>>,
}

struct Measured {
    light: Arc<Light>,
    group: Option<Arc<LightGroup>>,
    shines: bool,
    /// Mean luminance of the light's image.
    luminance: f64,
}

impl Shares {
    /// Measures one light, if out of date. Returns whether anything was measured.
    pub fn measure(&mut self, state: &RigState, relighter: &mut Relighter) -> Result<bool> {
        self.measured.resize_with(state.lights.len(), || None);
        let shines = |relighter: &Relighter, index: usize| relighter.rig().lights[index].enabled;
        let is_stale = |index: &usize| match &self.measured[*index] {
            None => true,
            Some(known) => {
                let light = &state.lights[*index];
                let group = light.group.map(|group| &state.groups[group]);
                let same_group = match (&known.group, group) {
                    (Some(known), Some(group)) => Arc::ptr_eq(known, group),
                    (known, group) => known.is_none() && group.is_none(),
                };
                !Arc::ptr_eq(&known.light, light) || !same_group || known.shines != shines(relighter, *index)
            }
        };
        let Some(stale) = (0..state.lights.len()).find(is_stale) else { return Ok(false) };
        let light = state.lights[stale].clone();
        let group = light.group.map(|group| state.groups[group].clone());
        let shines = shines(relighter, stale);
        let luminance = mean_luminance(relighter.linear(Picture::Light(stale))?);
        self.measured[stale] = Some(Measured { light, group, shines, luminance });
        Ok(true)
    }

    /// Discards all measurements.
    pub fn invalidate(&mut self) {
        *self = Self::default();
    }

    /// Returns the share of a light, as last measured; `None` until all lights are measured.
    pub fn share(&self, light: usize) -> Option<f64> {
        let lights: Option<f64> = self.measured.iter().map(|one| Some(one.as_ref()?.luminance)).sum();
        let one = self.measured.get(light)?.as_ref()?.luminance;
        Some(one / lights?).filter(|share| share.is_finite())
    }
}

/// Mean luminance of a picture.
pub fn mean_luminance(pixels: &[[f32; 3]]) -> f64 {
    pixels.iter().map(|pixel| f64::from(luminance((*pixel).into()))).sum::<f64>() / pixels.len() as f64
}
