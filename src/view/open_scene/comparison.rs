//! Snapshots with thumbnails, and comparison of the picture with them.

use super::OpenScene;
use crate::error::Result;
use crate::relight::{Layers, Request};
use crate::scene::{Emitters, Rig};
use crate::view::compare::{Comparing, Comparison, ComparisonImage};
use crate::view::panel::snapshots::Thumbnail;
use crate::view::view_state::ViewState;
use crate::view::views::View;

impl OpenScene {
    /// Returns the active comparison if its snapshot exists, and updates its pixels.
    pub(super) fn compare(&mut self, view: &ViewState, blue_first: bool) -> Result<Option<Comparing>> {
        let is_there = |comparing: &Comparing| self.desk.snapshots().get(comparing.slot).is_some();
        let comparing = view.comparing.filter(|_| view.views.view == View::Beauty).filter(is_there);
        let Some(comparing) = comparing else { return Ok(None) };
        if let Err(reason) = self.check_snapshot(comparing.slot) {
            self.desk.message = reason;
            return Ok(None);
        }
        self.sync_lights()?;
        if self.comparison_image.is_none() {
            self.comparison_image = Some(ComparisonImage::new(self.relighter.context(), self.picture_size())?);
        }
        let comparison_image = self.comparison_image.as_mut().expect("made above");
        let display = (view.exposure, view.curve(), blue_first);
        if comparison_image.make(comparing, &self.desk, &mut self.relighter, display)? {
            self.synced_version = None;
        }
        Ok(Some(comparing))
    }

    /// Stores the lights in a slot, with a thumbnail.
    pub(super) fn store_snapshot(&mut self, slot: usize, view: &ViewState) -> Result<()> {
        self.desk.store(slot);
        self.thumbnails[slot] = Some(self.thumbnail(view)?);
        Ok(())
    }

    /// Whether a snapshot fits the scene: it may be of before that was loaded again.
    fn check_snapshot(&self, slot: usize) -> std::result::Result<(), String> {
        let scene = &self.opened.scene;
        let check = |rig: Rig| rig.check_links(scene).and_then(|()| Emitters::of(scene).check(&rig));
        self.desk
            .snapshot_rig(slot)
            .map_or(Ok(()), check)
            .map_err(|reason| format!("slot {} does not fit the scene: {reason}", slot + 1))
    }

    /// Recalls the lights of a slot. A snapshot from a file gets its thumbnail.
    pub(super) fn recall_snapshot(&mut self, slot: usize, view: &ViewState) -> Result<()> {
        if let Err(reason) = self.check_snapshot(slot) {
            self.desk.message = reason;
            return Ok(());
        }
        self.desk.recall(slot);
        if self.desk.snapshots().get(slot).is_some() && self.thumbnails[slot].is_none() {
            self.thumbnails[slot] = Some(self.thumbnail(view)?);
        }
        Ok(())
    }

    /// A small picture of the current lights.
    fn thumbnail(&mut self, view: &ViewState) -> Result<Thumbnail> {
        self.sync_lights()?;
        self.layers = Layers::All;
        let size = self.picture_size();
        let request = Request { exposure: view.exposure, tone_map: view.curve(), ..Request::default() };
        Ok(Thumbnail::of(self.relighter.display(request)?, size))
    }

    /// Starts a comparison with the snapshot that was stored or recalled last, or ends it.
    pub(super) fn toggle_comparison(&mut self, view: &mut ViewState, kind: Comparison) {
        let is_on = view.comparing.is_some_and(|on| std::mem::discriminant(&on.kind) == std::mem::discriminant(&kind));
        let slot = view.comparing.map(|on| on.slot).or_else(|| self.desk.snapshots().last());
        let wanted = slot.filter(|_| !is_on).map(|slot| Comparing { slot, kind });
        self.desk.message = match (&wanted, is_on) {
            (Some(on), _) => {
                let label = self.desk.snapshots().get(on.slot).map(|snapshot| snapshot.label(on.slot));
                let what = if kind == Comparison::Difference { "difference from" } else { "comparison with" };
                format!("{what} snapshot {}", label.unwrap_or_default())
            }
            (None, true) => "comparison off".into(),
            (None, false) => "store a snapshot first: Ctrl+Alt+1".into(),
        };
        view.comparing = wanted;
    }
}
