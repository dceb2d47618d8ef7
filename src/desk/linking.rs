//! Which objects the selected lights light, and which cast their shadows.

use super::Desk;
use crate::scene::links::ResolvedLinks;
use crate::scene::{Links, ObjectSet, Scene};

/// What an edit of links concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkEdit {
    /// The light that an object receives.
    Light,
    /// The shadow that it casts.
    Shadow,
}

/// An object under the mouse.
#[derive(Clone, Copy)]
pub struct PickedObject<'a> {
    pub scene: &'a Scene,
    /// Name of its node or material.
    pub name: &'a str,
    pub triangle: u32,
}

impl Desk {
    /// Switches the light of the selected lights on an object, or its shadows from them: all take the opposite of the
    /// primary light's state.
    pub fn edit_links(&mut self, edit: LinkEdit, object: PickedObject) {
        let Some(primary) = self.selected_light() else {
            self.message = "no light is selected".into();
            return;
        };
        let on = !object.has(edit, &primary.links, &self.rig.sets);
        self.edit_each(|desk, light| {
            let (mut light, sets) = (light.clone(), &desk.rig.sets);
            if object.has(edit, &light.links, sets) != on {
                object.set(edit, &mut light.links, sets, on);
            }
            match object.has(edit, &light.links, sets) == on {
                true => Ok(light),
                false => Err("a set has the name of this object; edit the links in the rig file"),
            }
        });
    }
}

impl PickedObject<'_> {
    /// Whether the object is lit, or casts a shadow. Links whose names the scene lacks have no effect.
    fn has(&self, edit: LinkEdit, links: &Links, sets: &[ObjectSet]) -> bool {
        let mesh = &self.scene.mesh;
        ResolvedLinks::new(links, sets, self.scene).is_ok_and(|links| match edit {
            LinkEdit::Light => links.factor(mesh, self.triangle) > 0.0,
            LinkEdit::Shadow => links.casts_shadow(mesh, self.triangle),
        })
    }

    fn set(&self, edit: LinkEdit, links: &mut Links, sets: &[ObjectSet], on: bool) {
        match (edit, on) {
            (LinkEdit::Light, false) => links.except.push(self.name.into()),
            (LinkEdit::Shadow, false) => links.no_shadow_from.push(self.name.into()),
            (LinkEdit::Shadow, true) => self.remove_from(&mut links.no_shadow_from, sets),
            (LinkEdit::Light, true) => {
                self.remove_from(&mut links.except, sets);
                links.factor.remove(self.name);
                let dark = links.factor.iter().filter(|(_, factor)| **factor == 0.0);
                let mut dark: Vec<String> = dark.map(|(name, _)| name.clone()).collect();
                links.factor.retain(|_, factor| *factor != 0.0);
                self.remove_from(&mut dark, sets);
                links.factor.extend(dark.into_iter().map(|name| (name, 0.0)));
                if !links.only.is_empty() && !self.is_in(&links.only, sets) {
                    links.only.push(self.name.into());
                }
            }
        }
    }

    /// Removes the names that include the object. Of a set its other items remain.
    fn remove_from(&self, names: &mut Vec<String>, sets: &[ObjectSet]) {
        let mut left = Vec::new();
        for name in std::mem::take(names) {
            match sets.iter().find(|set| set.name == name) {
                _ if !self.is_in(std::slice::from_ref(&name), sets) => left.push(name),
                Some(set) => {
                    let others = set.items.iter().filter(|item| !self.is_in(std::slice::from_ref(*item), &[]));
                    left.extend(others.cloned());
                }
                None => {}
            }
        }
        for name in left {
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }

    /// Whether names include the object.
    fn is_in(&self, names: &[String], sets: &[ObjectSet]) -> bool {
        let links = Links { except: names.to_vec(), ..Links::default() };
        !self.has(LinkEdit::Light, &links, sets)
    }
}
