//! The panel beside the picture: lists of lights, their values, snapshots, shots and maps.

pub(super) mod controls;
pub(super) mod filter_values;
pub(super) mod light_values;
pub(super) mod lights_list;
pub(super) mod linking_values;
pub(super) mod map_browser;
pub(super) mod shots;
pub(super) mod snapshots;
pub(super) mod view_menu;
