//! Groups with a master, and lights that follow another.

use super::Desk;
use super::selection::Selection;
use crate::scene::rig::UniqueNames;
use crate::scene::{LightGroup, Rig};

/// An edit of the primary light's group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GroupEdit {
    Stops(f64),
    Toggle,
    Solo,
}

impl Desk {
    /// Returns the primary light's group.
    pub fn group(&self) -> Option<usize> {
        self.selected_light()?.group
    }

    /// Returns the lights of a group.
    pub fn members(&self, group: usize) -> Selection {
        Selection::of((0..self.rig.lights.len()).filter(|&light| self.rig.lights[light].group == Some(group)))
    }

    /// Creates a group of the selected lights.
    pub fn group_selected(&mut self) {
        if self.selection.is_empty() {
            self.message = "no light is selected".into();
            return;
        }
        let mut names = UniqueNames::default();
        self.rig.groups.iter().for_each(|group| drop(names.claim(&group.name)));
        let mut rig = self.rig.clone();
        rig.groups.push(LightGroup::new(&names.claim("group")));
        let new = rig.groups.len() - 1;
        self.join(rig, Some(new));
    }

    /// Moves the selected lights into a group, or out of their groups.
    pub fn set_group(&mut self, group: Option<usize>) {
        self.join(self.rig.clone(), group);
    }

    fn join(&mut self, mut rig: Rig, group: Option<usize>) {
        self.history.end_gesture();
        self.selection.iter().for_each(|light| rig.lights[light].group = group);
        drop_empty_groups(&mut rig, &self.rig);
        self.commit(rig);
        self.history.end_gesture();
    }

    /// Edits the primary light's group.
    pub fn edit_group(&mut self, edit: GroupEdit) {
        let Some(index) = self.group() else {
            self.message = "the selected light is in no group".into();
            return;
        };
        let mut group = self.rig.groups[index].clone();
        match edit {
            GroupEdit::Stops(by) => group.stops += by,
            GroupEdit::Toggle => group.enabled = !group.enabled,
            GroupEdit::Solo => group.solo = !group.solo,
        }
        self.replace_group(index, group);
    }

    /// Replaces a group, if it differs.
    pub fn replace_group(&mut self, index: usize, group: LightGroup) {
        if self.rig.groups[index] != group {
            let mut rig = self.rig.clone();
            rig.groups[index] = group;
            self.commit(rig);
        }
    }

    /// Sets the switches of one light, selected or not.
    pub fn switch(&mut self, light: usize, enabled: bool, solo: bool) {
        let mut rig = self.rig.clone();
        (rig.lights[light].enabled, rig.lights[light].solo) = (enabled, solo);
        self.commit(rig);
    }

    /// Switches solo off for all lights and groups.
    pub fn end_solo(&mut self) {
        let mut rig = self.rig.clone();
        rig.lights.iter_mut().for_each(|light| light.solo = false);
        rig.groups.iter_mut().for_each(|group| group.solo = false);
        self.commit(rig);
    }

    /// Makes the other selected lights follow the primary light.
    pub fn follow(&mut self) {
        let Some(leader) = self.selected().filter(|_| self.selection.len() > 1) else {
            self.message = "select the followers first, then the light that they are to follow".into();
            return;
        };
        self.history.end_gesture();
        let mut rig = self.rig.clone();
        let followers = self.selection.iter().filter(|&light| light != leader);
        followers.for_each(|light| rig.lights[light].follows = Some(leader));
        match rig.leaders_first() {
            Ok(_) => self.commit(rig),
            Err(_) => self.message = format!("{} already follows one of them", rig.lights[leader].name),
        }
    }

    /// Makes the selected lights follow no light.
    pub fn unfollow(&mut self) {
        self.history.end_gesture();
        let mut rig = self.rig.clone();
        self.selection.iter().for_each(|light| rig.lights[light].follows = None);
        self.commit(rig);
    }
}

/// Removes the groups that have lost their last light since `before`.
fn drop_empty_groups(rig: &mut Rig, before: &Rig) {
    let has_lights = |rig: &Rig, group: usize| rig.lights.iter().any(|light| light.group == Some(group));
    for group in (0..before.groups.len()).rev() {
        if has_lights(before, group) && !has_lights(rig, group) {
            rig.groups.remove(group);
            let later = rig.lights.iter_mut().filter_map(|light| light.group.as_mut()).filter(|of| **of > group);
            later.for_each(|of| *of -= 1);
        }
    }
}
