//! Requests to a relighter: all parameters of a picture except the lights.
//!
//! [`Picture`] chooses the sources of light, [`Layers`] the parts of their light.
//! `relighter.linear(Layers::Reflection)` is direct light in mirrors alone. [`Request`] combines both with exposure,
//! tone curve and detail.

use std::fmt;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::light_cache::Detail;
#[cfg(doc)]
use super::light_cache::LightCache;
use super::output::exposure::{stop_color, stops};
use super::output::inspect::Inspection;
use crate::image::display_view::DisplayView;
use crate::image::luminance;
use crate::physics::tone_curve::{agx, pbr_neutral, srgb};

/// Parameters of a picture. `Picture::Whole.into()` requests the whole picture with all layers, exact.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    pub picture: Picture,
    /// Only [`Layers::All`] includes emitters.
    pub layers: Layers,
    /// Accuracy of the images of changed lights.
    pub detail: Detail,
    /// Points of lights outside of the focus that the whole picture shades at most, about: see [`LightCache::plan`]. It
    /// may lack lights; see [`lights_shown`](super::Relighter::lights_shown). Not for [`Detail::Exact`].
    pub most_points: usize,
    /// Stops; not applied to scene-linear output.
    pub exposure: f32,
    /// Maps scene-linear radiance to the display; not applied to scene-linear output.
    pub tone_map: ToneMap,
    /// What to compute besides the pixels; ignored for contact sheets.
    pub inspection: Inspection,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            picture: Picture::Whole,
            layers: Layers::All,
            detail: Detail::Exact,
            most_points: usize::MAX,
            exposure: 0.0,
            tone_map: ToneMap::Agx,
            inspection: Inspection::default(),
        }
    }
}

impl From<Picture> for Request {
    fn from(picture: Picture) -> Self {
        Self { picture, ..Self::default() }
    }
}

impl From<Layers> for Request {
    fn from(layers: Layers) -> Self {
        Self { layers, ..Self::default() }
    }
}

/// Mapping of scene-linear radiance to values of a display, which are sRGB but for [`ToneMap::View`].
#[derive(Clone, Debug, PartialEq)]
pub enum ToneMap {
    /// Clamped to [0, 1].
    None,
    Agx,
    PbrNeutral,
    /// [`STOP_COLORS`](crate::shared::STOP_COLORS) by luminance: one colour per stop; exposed middle grey is grey.
    FalseColor,
    /// A view of an OpenColorIO configuration. The device interpolates in a table; [`ToneMap::display`] evaluates it.
    View(Arc<DisplayView>),
}

impl ToneMap {
    /// Maps exposed radiance, in place, to values of a display in [0, 1].
    pub fn display(&self, exposed: &mut [[f32; 3]]) {
        let each = |map: &(dyn Fn(DVec3) -> DVec3 + Sync), pixels: &mut [[f32; 3]]| {
            pixels.par_iter_mut().with_min_len(PIXELS_PER_TASK).for_each(|pixel| {
                *pixel = map(Vec3::from_array(*pixel).as_dvec3()).as_vec3().to_array();
            });
        };
        match self {
            Self::None => each(&srgb, exposed),
            Self::Agx => each(&agx, exposed),
            Self::PbrNeutral => each(&|c| srgb(pbr_neutral(c)), exposed),
            Self::FalseColor => each(
                &|c| {
                    let color = stop_color(stops(luminance(c.as_vec3().to_array())));
                    DVec3::from_array(color.map(f64::from)) / 255.0
                },
                exposed,
            ),
            Self::View(view) => {
                view.apply(exposed);
                exposed.as_flattened_mut().iter_mut().for_each(|value| *value = value.clamp(0.0, 1.0));
            }
        }
    }

    /// Whether its values are sRGB.
    pub fn is_srgb(&self) -> bool {
        !matches!(self, Self::View(view) if !view.is_srgb())
    }

    /// 8-bit values of exposed radiance, as a picture shows it.
    pub fn display8(&self, mut exposed: Vec<[f32; 3]>) -> Vec<[u8; 3]> {
        self.display(&mut exposed);
        exposed.into_iter().map(|pixel| pixel.map(|value| (255.0 * value).round() as u8)).collect()
    }
}

impl fmt::Display for ToneMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("no tone curve"),
            Self::Agx => f.write_str("tone curve AgX"),
            Self::PbrNeutral => f.write_str("tone curve PBR Neutral"),
            Self::FalseColor => f.write_str("false colour"),
            Self::View(view) => write!(f, "{}, {}", view.name(), view.display()),
        }
    }
}

/// Fewer pixels take less time than a task.
const PIXELS_PER_TASK: usize = 1024;

/// Parts of the light transport that a picture contains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layers {
    /// All layers, with indirect light and emitters.
    All,
    /// Direct light on layer 1 of the deep framebuffer.
    Direct,
    /// Direct light on the deeper layers: what mirrors show, without indirect light.
    Reflection,
    /// Direct light on all layers, without indirect light.
    FirstHand,
    /// Only indirect light, which comes through the gather samples.
    Indirect,
}

impl Layers {
    /// Bit mask of the layers of the deep framebuffer that are shown.
    pub(super) fn mask(self) -> u32 {
        match self {
            Self::All | Self::FirstHand | Self::Indirect => u32::MAX,
            Self::Direct => 1,
            Self::Reflection => !1,
        }
    }

    pub(super) fn direct(self) -> bool {
        self != Self::Indirect
    }

    pub(super) fn indirect(self) -> bool {
        matches!(self, Self::All | Self::Indirect)
    }
}

/// Which sources a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Picture {
    /// All lights.
    Whole,
    /// One light's contribution, by its index in the rig.
    Light(usize),
    /// All emitters together.
    Emission,
    /// Each light's contribution, side by side in a [`Grid`](super::sheet::Grid).
    Sheet,
}
