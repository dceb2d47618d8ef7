//! What becomes better while the lights rest, and coarser while they are dragged.

pub(super) mod converge;
pub(super) mod detail_control;
pub(super) mod edge_refinement;
pub(super) mod final_gathering;
pub(super) mod gathered;
