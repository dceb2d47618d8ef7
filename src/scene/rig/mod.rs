//! Rig files: lights, groups and a camera as TOML.
//!
//! Angles are radians in memory and degrees in the file. The file gets the shortest degrees that read back as the same
//! radians or, if there are none, the nearest (1e-15 relative).

mod blackbody;
pub mod diff;
mod keys;
pub mod merge_patch;
pub mod patch;
mod read;
mod read_light;
mod rig_text;
mod shots;
mod write;

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::path::Path;

pub use blackbody::{KELVIN, TINT, kelvin_and_tint_of, kelvin_to_rgb, xyz_to_rgb};
pub use shots::Shot;

use super::light_filter::Attached;
use super::{Camera, DomeMap, Light, LightGroup, LightKind, ObjectSet, RigFiles, usd};
use crate::error::{Error, Result};
use crate::storage::file;

/// Everything in a scene that an artist edits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    pub camera: Option<Camera>,
    pub groups: Vec<LightGroup>,
    /// Names that lights' links use.
    pub sets: Vec<ObjectSet>,
    pub lights: Vec<Light>,
    /// What lights have only in pictures of one camera; see [`Rig::of_shot`].
    pub shots: Vec<Shot>,
    /// Other states of the lights, for the lighting desk; renders ignore them.
    pub snapshots: Vec<RigSnapshot>,
}

/// Number of snapshots that a rig can have.
pub const SLOTS: usize = 9;

/// A stored state of a rig's lights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigSnapshot {
    /// Unique in its rig, below [`SLOTS`]; files count from 1.
    pub slot: usize,
    /// Note of the user.
    pub note: String,
    /// Groups, sets and lights; without camera, shots and snapshots.
    pub rig: Rig,
}

impl Rig {
    /// Reads a rig file and the files that it names, or the lights of a USD file; errors name the line of a rig file.
    pub fn load(path: &Path) -> Result<Self> {
        if usd::is_usd(path) {
            return usd::load(path);
        }
        let text = super::files::read(path)?;
        let text = String::from_utf8(text).map_err(|e| Error::import_from(path, "is not UTF-8 text", e))?;
        let files = RigFiles::new(path.parent().unwrap_or(Path::new("")));
        Self::from_toml(&text, files).map_err(|reason| Error::import(path, reason))
    }

    /// Parses a TOML document and reads the files that it names; an error begins with its line.
    pub fn from_toml(text: &str, files: RigFiles) -> std::result::Result<Self, String> {
        read::parse(text, files)
    }

    /// The rig as a TOML document that [`Rig::load`] reads back as equal from a file in `folder`.
    ///
    /// Exactly equal except for angles (1e-15 relative) and the camera's axes (1e-12).
    pub fn to_toml(&self, folder: &Path) -> String {
        write::to_toml(self, folder)
    }

    /// Writes [`Rig::to_toml`] to `path` atomically; lights for USD if it ends in `.usda` ([`usd::save`]).
    pub fn save(&self, path: &Path) -> Result<()> {
        if usd::is_usd(path) {
            return usd::save(self, path);
        }
        let text = self.to_toml(path.parent().unwrap_or(Path::new("")));
        file::write_whole(path, |out| out.write_all(text.as_bytes()).map_err(Error::io("write", path)))
    }

    /// Light `index` as the table `[[light]]` of [`Rig::to_toml`], with absolute paths.
    pub fn light_entry(&self, index: usize) -> toml::Table {
        write::light_entry(self, index)
    }

    /// Group `index` as the table `[[group]]` of [`Rig::to_toml`].
    pub fn group_entry(&self, index: usize) -> toml::Table {
        write::group_entry(&self.groups[index])
    }

    /// Files that lights are made of: maps, profiles and gobos.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.lights.iter().flat_map(|light| {
            let map = light.map.as_ref().and_then(|map| match map {
                DomeMap::File(map) => Some(map.path()),
                DomeMap::Physical(_) => None,
            });
            let filter = &light.filter;
            let gobo = filter.gobo.as_ref().map(|gobo| gobo.image.path());
            [map, filter.ies.as_ref().map(Attached::path), gobo].into_iter().flatten()
        })
    }

    /// Whether any light has a size.
    pub fn has_sizes(&self) -> bool {
        self.lights.iter().any(|light| !light.is_punctual())
    }

    /// Whether any light is a dome.
    pub fn has_domes(&self) -> bool {
        self.lights.iter().any(|light| light.kind == LightKind::Dome)
    }

    /// Whether any light has a filter, or links that scale its light.
    pub fn has_factors(&self) -> bool {
        self.lights.iter().any(Light::has_factors)
    }

    /// The rig with solo applied: if any light or group is solo, all other lights are off. Disabled lights stay
    /// disabled.
    pub fn with_solo_applied(&self) -> Cow<'_, Self> {
        let is_solo = |light: &Light| light.solo || light.group.is_some_and(|group| self.groups[group].solo);
        if !self.lights.iter().any(is_solo) {
            return Cow::Borrowed(self);
        }
        let mut rig = self.clone();
        rig.lights.iter_mut().for_each(|light| light.enabled &= is_solo(light));
        Cow::Owned(rig)
    }

    /// Removes the lights for which `stays` does not hold; their followers follow no light any more.
    pub fn retain_lights(&mut self, stays: impl Fn(usize, &Light) -> bool) {
        let leaves = self.lights.iter().enumerate().filter(|(index, light)| !stays(*index, light));
        let leaves: Vec<String> = leaves.map(|(_, light)| light.name.clone()).collect();
        self.shots.iter_mut().for_each(|shot| shot.forget("lights", &leaves));
        let stays: Vec<bool> = self.lights.iter().enumerate().map(|(index, light)| stays(index, light)).collect();
        let stay_before = |light: usize| stays[..light].iter().filter(|stays| **stays).count();
        for light in &mut self.lights {
            light.follows = light.follows.filter(|leader| stays[*leader]).map(stay_before);
        }
        let mut stays = stays.iter();
        self.lights.retain(|_| *stays.next().expect("there is one for each light"));
    }

    /// Indices of all lights, leaders before their followers; `Err` is a light whose chain of leaders is cyclic.
    pub fn leaders_first(&self) -> std::result::Result<Vec<usize>, usize> {
        let mut order = Vec::with_capacity(self.lights.len());
        let mut is_in = vec![false; self.lights.len()];
        for light in 0..self.lights.len() {
            let mut chain = Vec::new();
            let mut next = Some(light);
            while let Some(one) = next.filter(|&one| !is_in[one]) {
                chain.push(one);
                if chain.len() > self.lights.len() {
                    return Err(light);
                }
                next = self.lights[one].follows;
            }
            chain.iter().for_each(|&one| is_in[one] = true);
            order.extend(chain.iter().rev());
        }
        Ok(order)
    }

    /// Factor on the unit image of light `index`, including its group's; ignores solo.
    pub fn scale(&self, index: usize) -> glam::Vec3 {
        let light = &self.lights[index];
        light.scale() * light.group.map_or(glam::Vec3::ONE, |group| self.groups[group].scale())
    }
}

/// Makes names of lights, groups and cameras unique and removes their dots, because image layers are called
/// `light.NAME`.
#[derive(Default)]
pub struct UniqueNames {
    taken: HashSet<String>,
    /// By name: the number to try next, so that many equal names do not try all of them.
    next: HashMap<String, u64>,
}

impl UniqueNames {
    /// `name` without dots, with suffix `_2`, `_3`, ... if it is taken.
    pub fn claim(&mut self, name: &str) -> String {
        let name = without_dots(name);
        if self.taken.insert(name.clone()) {
            return name;
        }
        let next = self.next.entry(name.clone()).or_insert(2);
        loop {
            let numbered = format!("{name}_{next}");
            *next += 1;
            if self.taken.insert(numbered.clone()) {
                return numbered;
            }
        }
    }
}

/// A light's or group's name as it is in memory: dots become underscores.
pub fn without_dots(name: &str) -> String {
    name.replace('.', "_")
}
