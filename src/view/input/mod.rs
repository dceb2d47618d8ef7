//! What the user does: keys, mouse and scripts, as actions.

pub(super) mod action;
pub mod keys;
pub(super) mod pick;
pub mod script;
pub(super) mod state;
