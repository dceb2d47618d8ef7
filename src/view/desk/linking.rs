//! Which objects the selected lights light, and which cast their shadows.

use super::Desk;
use crate::scene::Links;

/// What an edit of links concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkEdit {
    /// The light that an object receives.
    Light,
    /// The shadow that it casts.
    Shadow,
}

impl Desk {
    /// Switches the light of the selected lights on the object `name`, or its shadows from them: all take the opposite of
    /// the primary light's state.
    pub fn edit_links(&mut self, edit: LinkEdit, name: &str) {
        let Some(primary) = self.selected_light() else {
            self.message = "no light is selected".into();
            return;
        };
        let on = match edit {
            LinkEdit::Light => !lights(&primary.links, name),
            LinkEdit::Shadow => primary.links.no_shadow_from.iter().any(|other| other == name),
        };
        self.edit_each(|_, light| {
            let mut light = light.clone();
            match edit {
                LinkEdit::Light => set_light(&mut light.links, name, on),
                LinkEdit::Shadow => set(&mut light.links.no_shadow_from, name, !on),
            }
            Ok(light)
        });
    }
}

fn lights(links: &Links, name: &str) -> bool {
    let has = |list: &[String]| list.iter().any(|other| other == name);
    !has(&links.except) && (links.only.is_empty() || has(&links.only)) && links.factor.get(name) != Some(&0.0)
}

/// Exceptions count more than what a light lights only, by whatever name that is listed.
fn set_light(links: &mut Links, name: &str, on: bool) {
    links.factor.remove(name);
    set(&mut links.except, name, !on);
    if on && !links.only.is_empty() {
        set(&mut links.only, name, true);
    }
}

fn set(list: &mut Vec<String>, name: &str, on: bool) {
    list.retain(|other| other != name);
    if on {
        list.push(name.into());
    }
}
