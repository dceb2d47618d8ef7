//! The result of a bake with extra view samples on edges.

use std::sync::Arc;

use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;

/// A deep framebuffer with extra samples on edges, baked in the background.
pub struct EdgeRefinement {
    /// See [`edge_lights`](crate::bake::framebuffer::edges::edge_lights).
    pub edges: Vec<u8>,
    /// The transfer that `transfer` was derived from.
    pub of: Option<Arc<Transfer>>,
    pub framebuffer: Arc<DeepFramebuffer>,
    pub transfer: Option<Arc<Transfer>>,
}
