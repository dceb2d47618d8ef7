//! What final gathering tells the window.

use std::sync::Arc;

use glam::Vec3;

use crate::final_gather::Estimate;

/// What a thread found until now.
pub struct Gathered {
    pub lights: Vec<GatheredLight>,
    /// Expected squared error of each pixel, row by row; of these lights together.
    pub errors2: Arc<Vec<f64>>,
    /// Whether the thread finds no more.
    pub has_ended: bool,
}

/// What it found of a light of its rig. Images are of unit strength, row by row.
pub struct GatheredLight {
    pub index: usize,
    /// Indirect light by the operator.
    pub operator: Arc<Vec<Vec3>>,
    pub estimate: Arc<Estimate>,
    /// What is added to the light's image.
    pub change: Vec<Vec3>,
    /// Its part of the squared error at unit strength, relative to [`Gathered::errors2`].
    pub part: f64,
}

/// How far final gathering has come with the lights as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct GatheringState {
    /// Expected error of a pixel, root mean square, relative to the mean luminance of the picture; `None` before each
    /// light was gathered.
    pub expected_error: Option<f64>,
    /// Fewest passes of a light.
    pub passes: u32,
    /// Whether it is at work, or about to be.
    pub goes_on: bool,
}
