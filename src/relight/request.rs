//! Requests to a relighter: all parameters of a picture except the lights.
//!
//! [`Picture`] chooses the sources of light, [`Layers`] the parts of their light.
//! `relighter.linear(Layers::Reflection)` is direct light in mirrors alone. [`Request`] combines both with exposure,
//! tone curve and detail.

use glam::Vec3;

use super::exposure::{stop_color, stops};
use super::inspect::Inspection;
use super::light_cache::Detail;
use crate::physics::tone_curve::{agx, pbr_neutral, srgb};

/// Parameters of a picture. `Picture::Whole.into()` requests the whole picture with all layers, exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    pub picture: Picture,
    /// Only [`Layers::All`] includes emitters.
    pub layers: Layers,
    /// Accuracy of the images of changed lights.
    pub detail: Detail,
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

/// Mapping of scene-linear radiance to 8-bit sRGB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToneMap {
    /// Clamped to [0, 1].
    None,
    Agx,
    PbrNeutral,
    /// [`STOP_COLORS`](crate::shared::STOP_COLORS) by luminance: one colour per stop; exposed middle grey is grey.
    FalseColor,
}

impl ToneMap {
    /// 8-bit sRGB of exposed radiance, as a picture shows it.
    pub fn display(self, exposed: Vec3) -> [u8; 3] {
        let linear = exposed.as_dvec3();
        let encoded = match self {
            Self::None => srgb(linear),
            Self::Agx => agx(linear),
            Self::PbrNeutral => srgb(pbr_neutral(linear)),
            // Rec. 709 luminance, as in glsl/lib/color.glsl.
            Self::FalseColor => return stop_color(stops(exposed.dot(Vec3::new(0.2126, 0.7152, 0.0722)))),
        };
        encoded.to_array().map(|channel| (255.0 * channel).round() as u8)
    }
}

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
