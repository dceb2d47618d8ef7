//! What may be asked of a relighter: all that pictures of the same lights differ in.

use super::inspect::Inspection;
use super::light_cache::Detail;

/// A picture that is asked for. `Picture::Whole.into()` asks for all of it, as exact as it gets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    pub picture: Picture,
    /// Emitters belong to [`Layers::All`].
    pub layers: Layers,
    /// How closely images of moved lights are made.
    pub detail: Detail,
    /// Stops; for displays.
    pub exposure: f32,
    /// From scene-linear to display.
    pub tone_map: ToneMap,
    /// What is read of the picture besides its pixels; nothing of contact sheets.
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

/// How pictures leave the relighter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToneMap {
    /// Clamped.
    None,
    Agx,
    PbrNeutral,
    /// [`STOP_COLORS`](crate::shared::STOP_COLORS) by luminance: a colour a stop, middle grey at 2^exposure stops being grey.
    FalseColor,
}

/// Which part of the picture is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layers {
    /// Straight and through mirrors.
    All,
    /// Layer 1 of the deep framebuffer.
    Direct,
    /// The mirror layers.
    Reflection,
    /// All but what came through the gather samples.
    FirstHand,
    /// What came through the gather samples.
    Indirect,
}

impl Layers {
    /// Layers of the deep framebuffer that count.
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

/// What a picture shows of the chosen layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Picture {
    Whole,
    /// One light's share, by its index in the rig.
    Light(usize),
    /// Emitters as seen.
    Emission,
    /// Every light's share, side by side as in a [`Grid`](super::sheet::Grid).
    Sheet,
}
