//! What the mouse does to lights in the picture.

use glam::DVec3;

use super::{Pointer, Stage};
use crate::gpu::Placement;
use crate::view::describe::rounded;
use crate::view::desk::Pick;
use crate::view::desk::selection::Selection;
use crate::view::gizmo::{Gizmos, Grab, Handle};

impl Stage {
    /// The lights in the picture, to take hold of.
    pub fn gizmos(&self, placement: Placement) -> Gizmos<'_> {
        Gizmos { opened: &self.opened, desk: &self.desk, placement }
    }

    /// Takes hold of what is under the mouse; a light that is not selected is selected first, with Ctrl or Shift held
    /// beside those that are.
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

    /// Follows the mouse with what it took hold of.
    pub(super) fn drag(&mut self, grab: Grab, pointer: Pointer) {
        let dragged = pointer.at.and_then(|at| self.gizmos(pointer.placement).dragged(grab, at));
        dragged.into_iter().for_each(|light| self.desk.edit_alike(light));
    }

    /// The held key, or the mouse's button, was let go.
    pub fn let_go(&mut self) {
        self.caster = None;
        self.desk.end_gesture();
    }

    /// The first time takes the point under the mouse as what casts the shadow, then drags the shadow there.
    pub(super) fn drag_shadow(&mut self, pointer: Pointer) {
        let Some(caster) = self.caster else {
            self.with_pick(pointer, |desk, pick| {
                desk.message = format!("shadow of {}: drag it", point_text(pick.position))
            });
            self.caster = self.pick(pointer).map(|pick| pick.position);
            return;
        };
        let Some(at) = self.pick(pointer) else { return };
        if let Some(way) = (caster - at.position).try_normalize() {
            let free = self.opened.free_along(caster, way);
            self.desk.place_shadow(caster, at, free);
        }
    }

    pub(super) fn pick(&self, pointer: Pointer) -> Option<Pick> {
        self.opened.pick(pointer.placement, pointer.at?)
    }
}

/// "(0.1, 2, 3.14)"
fn point_text(point: DVec3) -> String {
    format!("({}, {}, {})", rounded(point.x), rounded(point.y), rounded(point.z))
}
