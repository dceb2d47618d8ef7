//! What is drawn over the picture.

pub(super) mod aids;
pub(super) mod gizmo;
pub(super) mod map_ball;
pub(super) mod profile;
pub(super) mod times;
pub(super) mod wipe;
