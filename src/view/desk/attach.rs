//! Files that the selected lights take: IES profiles, gobos and environment maps.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::Desk;
use crate::error::Result;
use crate::scene::light_filter::{Attached, Gobo, RigFiles};
use crate::scene::{DomeMap, Light, LightKind, SkyMap};
use crate::view::describe::kind_name;

impl Desk {
    /// Gives the selected lights the file that the user dropped: by its extension an IES profile or an environment map,
    /// else a gobo. A map makes a new dome if none is selected, an image is the map of a selected dome.
    pub fn attach(&mut self, path: &Path) {
        let name = path.to_string_lossy();
        let is = |wanted: &str| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(wanted));
        let is_dome = self.selected_light().is_some_and(|light| light.kind == LightKind::Dome);
        if is("ies") {
            self.attach_profile(Path::new(""), &name);
        } else if is_dome {
            self.attach_map(Path::new(""), &name);
        } else if is("hdr") || is("exr") {
            self.add_dome(&name);
        } else {
            self.attach_gobo(Path::new(""), &name);
        }
    }

    /// Gives the selected domes the environment map `name` in `folder`; an empty name removes theirs.
    pub fn attach_map(&mut self, folder: &Path, name: &str) {
        if let Some(map) = self.read(name, |name| RigFiles::new(folder).sky_map(name)) {
            self.set_map(map);
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

    /// Adds a dome with the environment map `name`, as bright as the map.
    fn add_dome(&mut self, name: &str) {
        let Some(map) = self.read(name, |name| RigFiles::new(Path::new("")).sky_map(name)) else { return };
        let map = map.map(DomeMap::File);
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
