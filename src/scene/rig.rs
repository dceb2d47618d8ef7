//! Rig files: lights, groups and a camera as TOML.

use std::path::Path;

use super::{Camera, Light, LightGroup};
use crate::error::Result;

/// Everything about a scene that an artist edits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    pub camera: Option<Camera>,
    pub groups: Vec<LightGroup>,
    pub lights: Vec<Light>,
}

impl Rig {
    pub fn load(path: &Path) -> Result<Self> {
        let _ = path;
        todo!()
    }

    /// The rig as a TOML document that [`Rig::load`] reads back equal.
    pub fn to_toml(&self) -> String {
        todo!()
    }
}
