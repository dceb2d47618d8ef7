//! Settings of the window, and its open dialog.

use std::sync::Arc;

use super::compare::Comparing;
use super::views::{Aid, Views};
use crate::image::display_view::{DisplayConfig, DisplayView};
use crate::relight::ToneMap;
use crate::scene::{LightUnit, Rig};

/// The settings of the window that are independent of the lights.
pub struct ViewState {
    /// Exposure, stops.
    pub exposure: f32,
    /// Automatic exposure of a picture that lacks lights, and the number of lights in it. Unless the user changes it,
    /// it is chosen again with more lights.
    pub provisional_exposure: Option<(f32, usize)>,
    pub tone_map: ToneMap,
    /// Offered beside the tone curves.
    pub displays: Option<Displays>,
    pub one_to_one: bool,
    pub panel: bool,
    pub overlay: bool,
    pub views: Views,
    pub help: bool,
    pub dialog: Option<Dialog>,
    /// Search text for the list of lights.
    pub search: String,
    /// Unit in which the panel shows the intensity of lights that it fits.
    pub light_unit: LightUnit,
    /// Active comparison with a snapshot.
    pub comparing: Option<Comparing>,
    /// Whether the view through the selected light is shown.
    pub show_light_view: bool,
    /// Whether the browser of environment maps is shown.
    pub show_maps: bool,
    /// Whether pictures of all cameras are shown.
    pub show_shots: bool,
}

/// An OpenColorIO configuration, and the view that was chosen last.
pub struct Displays {
    pub config: DisplayConfig,
    pub chosen: Arc<DisplayView>,
}

/// An open dialog.
pub enum Dialog {
    /// The path as typed so far.
    SaveAs(String),
    /// Asks whether to save before quitting.
    Quit,
    /// Asks whether to recover these lights, which a crash left.
    Recover(Box<Rig>),
}

impl ViewState {
    /// The window as it opens. `config`: of `tone_map`, if that is a view.
    pub fn new(exposure: f32, tone_map: ToneMap, config: Option<DisplayConfig>) -> Self {
        let views = Views::new(&tone_map);
        let displays = match &tone_map {
            ToneMap::View(chosen) => config.map(|config| Displays { config, chosen: chosen.clone() }),
            _ => None,
        };
        Self {
            exposure,
            provisional_exposure: None,
            tone_map: match tone_map {
                ToneMap::FalseColor => ToneMap::Agx,
                curve => curve,
            },
            displays,
            one_to_one: false,
            panel: true,
            overlay: false,
            views,
            help: false,
            dialog: None,
            search: String::new(),
            light_unit: LightUnit::Candela,
            comparing: None,
            show_light_view: false,
            show_maps: false,
            show_shots: false,
        }
    }

    /// Whether anything is drawn beside or over the picture.
    pub fn has_ui(&self) -> bool {
        let over = self.show_light_view
            || self.show_maps
            || self.show_shots
            || self.comparing.is_some()
            || self.views.has_ui();
        self.panel || self.overlay || self.help || over || self.dialog.is_some()
    }

    /// From scene-linear to the display.
    pub fn curve(&self) -> ToneMap {
        if self.views.has(Aid::FalseColor) { ToneMap::FalseColor } else { self.tone_map.clone() }
    }

    /// Takes the next tone curve, or the chosen view after the last one.
    pub fn next_tone_map(&mut self) {
        self.tone_map = match &self.tone_map {
            ToneMap::Agx => ToneMap::PbrNeutral,
            ToneMap::PbrNeutral => ToneMap::None,
            ToneMap::None => match &self.displays {
                Some(Displays { chosen, .. }) => ToneMap::View(chosen.clone()),
                None => ToneMap::Agx,
            },
            ToneMap::FalseColor | ToneMap::View(_) => ToneMap::Agx,
        };
    }
}
