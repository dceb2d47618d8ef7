//! Actions that the user requests with keys, mouse or panel.

use std::path::PathBuf;

use super::keys::Command;
use crate::scene::Rig;
use crate::view::overlay::gizmo::Grab;

/// An action requested by the user.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Do(Command),
    SaveTo(PathBuf),
    SaveAndQuit,
    QuitUnsaved,
    /// Recovers the lights that a crash left.
    Recover(Box<Rig>),
    /// Discards the lights that a crash left.
    DiscardRecovery,
    /// Moves a handle to the mouse.
    Drag(Grab),
    /// Ends a drag, when the held key or mouse button is released.
    EndDrag,
    /// Ends a held key: the next edit is undone separately.
    EndGesture,
    /// Only redraws.
    Show,
}
