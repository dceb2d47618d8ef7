//! Files that the selected lights take: IES profiles, gobos and environment maps.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::Desk;
use super::describe::kind_name;
use super::selection::Selection;
use crate::error::Result;
use crate::scene::light_filter::{Attached, Gobo, RigFiles};
use crate::scene::{DomeMap, Light, LightKind, SkyMap};

/// What takes an environment map.
#[derive(Clone, PartialEq)]
pub enum TakesMap {
    Selection(Selection),
    NewDome,
}

impl Desk {
    /// What takes a file that the user dropped, as an environment map; `None` if it is none. An image is the map of a
    /// selected dome.
    pub fn takes_map(&self, path: &Path) -> Option<TakesMap> {
        let is = |wanted: &str| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(wanted));
        let is_dome = self.selected_light().is_some_and(|light| light.kind == LightKind::Dome);
        match is_dome {
            _ if is("ies") => None,
            true => Some(TakesMap::Selection(self.selection().clone())),
            false => (is("hdr") || is("exr")).then_some(TakesMap::NewDome),
        }
    }

    /// Gives the selected lights a file that the user dropped and that is no map: an IES profile by its extension, else
    /// a gobo.
    pub fn attach(&mut self, path: &Path) {
        let name = path.to_string_lossy();
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ies")) {
            self.attach_profile(Path::new(""), &name);
        } else {
            self.attach_gobo(Path::new(""), &name);
        }
    }

    /// Gives the selected domes an environment map, or removes theirs.
    pub fn set_map(&mut self, map: Option<Attached<SkyMap>>) {
        let map = map.map(DomeMap::File);
        self.edit_each(|_, light| match light.kind {
            LightKind::Dome => Ok(Light { map: map.clone(), ..light.clone() }),
            _ => Err("only domes have a map"),
        });
    }

    /// Adds a dome with an environment map, as bright as the map.
    pub fn add_dome(&mut self, map: Attached<SkyMap>) {
        let map = Some(DomeMap::File(map));
        let light = Light::point(&self.light_names().claim(kind_name(LightKind::Dome)), DVec3::ZERO);
        self.insert(vec![Light { kind: LightKind::Dome, map, visible: true, ..light }]);
    }

    /// Gives the selected lights the IES profile `name` in `folder`, and its intensity; an empty name removes theirs.
    pub fn attach_profile(&mut self, folder: &Path, name: &str) {
        let Some(profile) = self.read(name, |name| RigFiles::new(folder).profile(name)) else { return };
        self.edit_each(|_, light| {
            let mut light = light.clone();
            if !light.kind.has_position() {
                return Err("a light without a position has no IES profile");
            }
            if let Some(profile) = &profile {
                light.intensity = profile.max();
            }
            light.filter.ies = profile.clone();
            Ok(light)
        });
    }

    /// Gives the selected lights the image `name` in `folder` as a gobo; an empty name removes theirs.
    pub fn attach_gobo(&mut self, folder: &Path, name: &str) {
        let Some(image) = self.read(name, |name| RigFiles::new(folder).image(name)) else { return };
        self.edit_each(|_, light| {
            if !light.kind.is_aimed() {
                return Err("only spots, disks and rectangles have a gobo");
            }
            let gobo = |image| match &light.filter.gobo {
                Some(gobo) => Gobo { image, ..gobo.clone() },
                None => Gobo { image, rotation: 0.0, scale: 1.0, tint: Vec3::ONE },
            };
            let mut light: Light = light.clone();
            light.filter.gobo = image.clone().map(gobo);
            Ok(light)
        });
    }

    /// The content of file `name`, or `Some(None)` if the name is empty. On an error, shows it and returns `None`.
    fn read<T>(&mut self, name: &str, read: impl FnOnce(&str) -> Result<T>) -> Option<Option<T>> {
        if name.trim().is_empty() {
            return Some(None);
        }
        let read = read(name.trim());
        if let Err(error) = &read {
            self.message = error.chain();
        }
        read.ok().map(Some)
    }
}
