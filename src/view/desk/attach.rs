//! Files that the selected lights take: IES profiles and gobos.

use std::path::Path;

use glam::Vec3;

use super::Desk;
use crate::error::Result;
use crate::scene::light_filter::{Gobo, RigFiles};
use crate::scene::{Light, LightKind};

impl Desk {
    /// Gives the selected lights the file that the user dropped: an IES profile by its extension, else a gobo.
    pub fn attach(&mut self, path: &Path) {
        let name = path.to_string_lossy();
        match path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ies")) {
            true => self.attach_profile(Path::new(""), &name),
            false => self.attach_gobo(Path::new(""), &name),
        }
    }

    /// Gives the selected lights the IES profile `name` in `folder`, and its intensity; an empty name removes theirs.
    pub fn attach_profile(&mut self, folder: &Path, name: &str) {
        let Some(profile) = self.read(name, |name| RigFiles::new(folder).profile(name)) else { return };
        self.edit_each(|_, light| {
            let mut light = light.clone();
            if light.kind == LightKind::Directional {
                return Err("a directional light has no IES profile");
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
            if matches!(light.kind, LightKind::Directional | LightKind::Point) {
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
