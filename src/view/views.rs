//! Views, which replace the picture, and aids, which are drawn over it.

use crate::bake::channels::Channel;
use crate::relight::{Layers, Picture, ToneMap};

/// What the window shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    Beauty,
    Direct,
    Reflection,
    Indirect,
    Emission,
    /// The contribution of the selected light.
    Light,
    /// The contributions of all lights, side by side.
    Lights,
    /// Error of each tile's indirect light.
    TransferError,
    /// A channel of the deep framebuffer.
    Channel(Channel),
}

/// An overlay, or another way to show the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aid {
    /// One colour per stop of luminance.
    FalseColor,
    Histogram,
    /// The values of the pixel under the mouse.
    Probe,
    /// Gather samples that the camera sees.
    GatherSamples,
    /// Frame times as a graph.
    Profile,
}

/// The current view and the active aids.
#[derive(Clone, Copy, Debug)]
pub struct Views {
    pub view: View,
    /// Layer of the deep framebuffer, from 0.
    pub layer: u32,
    aids: [bool; 5],
}

impl View {
    /// In the order of the menu; channels follow.
    const PICTURES: [Self; 8] = [
        Self::Beauty,
        Self::Direct,
        Self::Reflection,
        Self::Indirect,
        Self::Emission,
        Self::Light,
        Self::Lights,
        Self::TransferError,
    ];

    pub fn all() -> impl Iterator<Item = Self> {
        Self::PICTURES.into_iter().chain(Channel::ALL.map(Self::Channel))
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Beauty => "beauty",
            Self::Direct => "direct",
            Self::Reflection => "reflection",
            Self::Indirect => "indirect",
            Self::Emission => "emission",
            Self::Light => "selected light",
            Self::Lights => "every light",
            Self::TransferError => "error of indirect light",
            Self::Channel(channel) => channel.name(),
        }
    }

    /// Returns the relighter's layers and picture for this view; `None` if the view does not depend on the lights.
    pub fn picture(self, selected: Option<usize>) -> Option<(Layers, Picture)> {
        Some(match self {
            Self::Beauty => (Layers::All, Picture::Whole),
            Self::Direct => (Layers::Direct, Picture::Whole),
            Self::Reflection => (Layers::Reflection, Picture::Whole),
            Self::Indirect => (Layers::Indirect, Picture::Whole),
            Self::Emission => (Layers::All, Picture::Emission),
            Self::Light => (Layers::All, selected.map_or(Picture::Whole, Picture::Light)),
            Self::Lights => (Layers::All, Picture::Sheet),
            Self::TransferError | Self::Channel(_) => return None,
        })
    }

    /// Returns the next channel of the deep framebuffer.
    pub fn next_channel(self) -> Self {
        let at = Channel::ALL.iter().position(|&channel| self == Self::Channel(channel));
        Self::Channel(Channel::ALL[at.map_or(0, |at| (at + 1) % Channel::ALL.len())])
    }
}

impl Aid {
    /// All aids, and the labels of their buttons.
    pub const ALL: [(Self, &'static str); 5] = [
        (Self::FalseColor, "stops"),
        (Self::Histogram, "histogram"),
        (Self::Probe, "probe"),
        (Self::GatherSamples, "gather"),
        (Self::Profile, "profile"),
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::FalseColor => "false colours",
            Self::Histogram => "histogram",
            Self::Probe => "probe",
            Self::GatherSamples => "gather samples",
            Self::Profile => "profile",
        }
    }
}

impl Views {
    pub fn new(tone_map: &ToneMap) -> Self {
        let mut views = Self { view: View::Beauty, layer: 0, aids: [false; 5] };
        views.aids[Aid::FalseColor as usize] = *tone_map == ToneMap::FalseColor;
        views
    }

    pub fn has(&self, aid: Aid) -> bool {
        self.aids[aid as usize]
    }

    pub fn toggle(&mut self, aid: Aid) {
        self.aids[aid as usize] ^= true;
    }

    /// Whether any aid requires the interface to be drawn.
    pub fn has_ui(&self) -> bool {
        [Aid::Histogram, Aid::Probe, Aid::GatherSamples, Aid::Profile].iter().any(|&aid| self.has(aid))
    }

    /// Returns the name of the view, with the layer if it has layers.
    pub fn title(&self) -> String {
        match self.view {
            View::Channel(channel) if channel.has_layers() => format!("{}, layer {}", channel.name(), self.layer + 1),
            view => view.name().into(),
        }
    }
}
