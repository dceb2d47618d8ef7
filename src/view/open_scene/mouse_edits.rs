//! Edits of lights with the mouse in the picture.

use glam::DVec3;

use super::{OpenScene, Pointer};
use crate::desk::Pick;
use crate::desk::describe::rounded;
use crate::desk::selection::Selection;
use crate::gpu::Placement;
use crate::view::overlay::gizmo::{Gizmos, Grab, Handle};

impl OpenScene {
    /// Returns the handles of the lights in the picture.
    pub fn gizmos(&self, placement: Placement) -> Gizmos<'_> {
        Gizmos { opened: &self.opened, desk: &self.desk, placement }
    }

    /// Grabs the handle under the mouse and selects its light. With Ctrl or Shift held, the other lights stay selected,
    /// and a position handle toggles the selection of its light.
    pub fn grab(&mut self, pointer: Pointer, held: egui::Modifiers) -> Option<Grab> {
        let grab = self.gizmos(pointer.placement).grab(pointer.at?)?;
        let mut selection = self.desk.selection().clone();
        match held.command || held.shift {
            true if !selection.contains(grab.light) || grab.handle == Handle::Position => selection.toggle(grab.light),
            true => {}
            false if selection.contains(grab.light) => selection.add(grab.light),
            false => selection = Selection::only(grab.light),
        }
        let stays = selection.contains(grab.light);
        self.desk.select(selection);
        stays.then_some(grab)
    }

    /// Moves the grabbed handle to the mouse.
    pub(super) fn drag(&mut self, grab: Grab, pointer: Pointer) {
        let dragged = pointer.at.and_then(|at| self.gizmos(pointer.placement).dragged(grab, at));
        dragged.into_iter().for_each(|light| self.desk.edit_primary_and_selection(light));
    }

    /// Ends a drag, when the held key or mouse button is released.
    pub(super) fn end_drag(&mut self) {
        self.caster = None;
        self.desk.end_gesture();
    }

    /// The first call takes the point under the mouse as the shadow caster; later calls drag its shadow to the mouse.
    pub(super) fn drag_shadow(&mut self, pointer: Pointer) {
        let Some(caster) = self.caster else {
            self.with_pick(pointer, |desk, pick| {
                desk.message = format!("shadow of {}: drag it to its new place", point_text(pick.position))
            });
            self.caster = self.pick(pointer).map(|pick| pick.position);
            return;
        };
        let Some(at) = self.pick(pointer) else { return };
        if let Some(direction) = (caster - at.position).try_normalize() {
            let free = self.opened.distance_to_surface(caster, direction);
            self.desk.place_shadow(caster, at, free);
        }
    }

    pub(super) fn pick(&self, pointer: Pointer) -> Option<Pick> {
        self.opened.pick(pointer.placement, pointer.at?)
    }
}

/// Formats a point: "(0.1, 2, 3.14)".
fn point_text(point: DVec3) -> String {
    format!("({}, {}, {})", rounded(point.x), rounded(point.y), rounded(point.z))
}
