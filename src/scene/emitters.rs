//! Emitters: what glows. All emissive materials of one name are one emitter, which is a light of the rig.

use std::borrow::Cow;

use glam::{DVec3, Vec3};

use super::rig::UniqueNames;
use super::{Light, LightKind, Rig, Scene};

/// Each emitter has an image in memory. In a scene with more emissive materials, the last ones shine together.
const MAX_EMITTERS: usize = 32;

/// The emitters of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Emitters {
    /// Names of their materials; unique.
    pub names: Vec<String>,
    /// By index of the material: index of its emitter.
    of_material: Vec<Option<u32>>,
}

impl Emitters {
    pub fn of(scene: &Scene) -> Self {
        let mut names: Vec<String> = Vec::new();
        let mut emitter = |name: &String| {
            let known = names.iter().position(|known| known == name);
            let index = known.unwrap_or(names.len()).min(MAX_EMITTERS - 1);
            if index == names.len() {
                names.push(name.clone());
            }
            index as u32
        };
        let of_material =
            scene.materials.iter().map(|m| (m.emissive != Vec3::ZERO).then(|| emitter(&m.name))).collect();
        Self { names, of_material }
    }

    pub fn len(&self) -> usize {
        self.names.len()
    }

    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Index of the emitter of a material.
    pub fn index(&self, material: u32) -> Option<u32> {
        self.of_material[material as usize]
    }

    /// For each material, the lights of a complete rig that make it shine: index, and factor on its emission.
    pub fn lights(&self, rig: &Rig) -> Vec<Vec<(usize, DVec3)>> {
        let rig = rig.with_solo_applied();
        let of_emitter = |emitter: u32| {
            let name = self.names[emitter as usize].as_str();
            let named = (0..rig.lights.len()).filter(|&i| rig.lights[i].material.as_deref() == Some(name));
            named.map(|i| (i, rig.scale(i).as_dvec3())).collect()
        };
        self.of_material.iter().map(|emitter| emitter.map_or_else(Vec::new, of_emitter)).collect()
    }

    /// The rig with a light for each emitter: one that the rig does not name shines as its material says.
    pub fn complete<'a>(&self, rig: &'a Rig) -> Cow<'a, Rig> {
        let is_named = |name: &str| rig.lights.iter().any(|light| light.material.as_deref() == Some(name));
        let missing: Vec<&String> = self.names.iter().filter(|name| !is_named(name)).collect();
        if missing.is_empty() {
            return Cow::Borrowed(rig);
        }
        let mut taken = UniqueNames::default();
        rig.lights.iter().for_each(|light| drop(taken.claim(&light.name)));
        let mut rig = rig.clone();
        rig.lights.extend(missing.into_iter().map(|material| Light::emitter(&taken.claim(material), material)));
        for snapshot in &mut rig.snapshots {
            snapshot.rig = self.complete(&snapshot.rig).into_owned();
        }
        Cow::Owned(rig)
    }

    /// Whether all emitters of a rig are in the scene. An error names the light.
    pub fn check(&self, rig: &Rig) -> Result<(), String> {
        let unknown = |light: &&Light| light.material.as_ref().is_some_and(|material| !self.names.contains(material));
        let Some(light) = rig.lights.iter().find(unknown) else { return Ok(()) };
        let (name, material) = (&light.name, light.material.as_deref().unwrap_or_default());
        Err(match self.names.is_empty() {
            true => format!("light \"{name}\": nothing in the scene emits light"),
            false => {
                let names = self.names.join(", ");
                format!("light \"{name}\": there is no emissive material \"{material}\"; there are: {names}")
            }
        })
    }
}

impl Light {
    /// The emitter of a material, as bright as that says.
    pub fn emitter(name: &str, material: &str) -> Self {
        Self { kind: LightKind::Emitter, material: Some(material.into()), ..Self::point(name, DVec3::ZERO) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, MeshSpace};

    fn scene(materials: impl IntoIterator<Item = (String, bool)>) -> Scene {
        let material = |(name, glows)| Material {
            name,
            emissive: if glows { Vec3::ONE } else { Vec3::ZERO },
            ..Material::default()
        };
        Scene {
            path: "made.glb".into(),
            mesh: Default::default(),
            space: MeshSpace::WORLD,
            materials: materials.into_iter().map(material).collect(),
            objects: Vec::new(),
            textures: Vec::new(),
            cameras: Vec::new(),
            rig: Rig::default(),
            image_size: None,
        }
    }

    #[test]
    fn materials_of_one_name_are_one_emitter() {
        let scene =
            scene([("shade", true), ("wall", false), ("screen", true), ("shade", true)].map(|(n, g)| (n.into(), g)));
        let emitters = Emitters::of(&scene);
        assert_eq!(emitters.names, ["shade", "screen"]);
        assert_eq!([0, 1, 2, 3].map(|material| emitters.index(material)), [Some(0), None, Some(1), Some(0)]);
    }

    #[test]
    fn a_rig_gets_those_that_it_does_not_name() {
        let scene = scene([("a.b", true), ("c", true)].map(|(n, g)| (n.into(), g)));
        let emitters = Emitters::of(&scene);
        let mut rig =
            Rig { lights: vec![Light::point("a_b", DVec3::ZERO), Light::emitter("mine", "c")], ..Rig::default() };
        rig.lights[1].stops = 1.0;
        let complete = emitters.complete(&rig).into_owned();
        assert_eq!(complete.lights[..2], rig.lights);
        assert_eq!(complete.lights[2..], [Light::emitter("a_b_2", "a.b")]);
        assert_eq!(emitters.lights(&complete), [[(2, DVec3::ONE)], [(1, DVec3::splat(2.0))]]);
        let solo =
            Rig { lights: vec![Light { solo: true, ..rig.lights[0].clone() }, rig.lights[1].clone()], ..rig.clone() };
        assert_eq!(emitters.lights(&solo), [vec![], vec![(1, DVec3::ZERO)]], "solo switches emitters off too");
        assert!(emitters.check(&rig).is_ok());
        rig.lights[1].material = Some("d".into());
        assert!(emitters.check(&rig).unwrap_err().contains("a.b, c"));
    }

    #[test]
    fn the_last_of_many_shine_together() {
        let emitters = Emitters::of(&scene((0..100).map(|i| (i.to_string(), true))));
        assert_eq!(emitters.len(), MAX_EMITTERS);
        assert_eq!([0, 31, 32, 99].map(|material| emitters.index(material)), [0, 31, 31, 31].map(Some));
    }
}
