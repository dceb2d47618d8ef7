//! The result of a bake with extra view samples on edges.

use std::sync::Arc;

use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::scene::{Rig, Scene};

/// A deep framebuffer with extra samples on edges, baked in the background.
pub struct EdgeRefinement {
    pub edges: Edges,
    /// The transfer that `transfer` was derived from.
    pub of: Option<Arc<Transfer>>,
    pub framebuffer: Arc<DeepFramebuffer>,
    pub transfer: Option<Arc<Transfer>>,
}

/// All lights that cast shadows, packed as for kernels; shadow edges depend on them.
pub type Edges = Vec<u8>;

pub fn edges(scene: &Scene, rig: &Rig) -> Edges {
    let casts = rig.lights.iter().filter(|light| light.enabled && light.shadows);
    casts.flat_map(|light| bytemuck::bytes_of(&light.pack(scene.space)).to_vec()).collect()
}
