//! Light linking: which objects a light lights, how strongly, and which of them cast its shadow.

use std::collections::{BTreeMap, HashMap};

use super::{Mesh, Rig, Scene};

/// Links of a light, by names of nodes, materials or sets. A node's name includes its descendants.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Links {
    /// The light lights only these; empty: everything.
    pub only: Vec<String>,
    /// The light does not light these.
    pub except: Vec<String>,
    /// Factors on the light that these receive, 0 <= factor <= [`MAX_FACTOR`].
    pub factor: BTreeMap<String, f64>,
    /// These cast no shadow.
    pub no_shadow_from: Vec<String>,
}

impl Links {
    /// Whether they scale the light that any object receives.
    pub fn scale_light(&self) -> bool {
        !(self.only.is_empty() && self.except.is_empty() && self.factor.is_empty())
    }
}

/// A name for several nodes and materials.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectSet {
    /// Unique in its rig; takes precedence over nodes and materials of this name.
    pub name: String,
    pub items: Vec<String>,
}

/// Larger factors are mistakes, and would overflow half precision.
pub const MAX_FACTOR: f64 = 1_000.0;

/// [`Links`] with their names looked up in a scene.
#[derive(Clone)]
pub struct ResolvedLinks {
    only: Option<Cover>,
    /// Includes `except`, with the factor 0.
    factors: Vec<(Cover, f32)>,
    shadowless: Option<Cover>,
}

impl ResolvedLinks {
    /// An error names the key and a name that neither `sets` nor the scene knows.
    pub fn new(links: &Links, sets: &[ObjectSet], scene: &Scene) -> Result<Self, String> {
        let cover = |key: &str, names: &[String]| {
            let cover = (!names.is_empty()).then(|| Cover::new(names, sets, scene)).transpose();
            cover.map_err(|reason| format!("{key}: {reason}"))
        };
        let except = cover("except", &links.except)?.map(|cover| (cover, 0.0));
        let mut factors = Vec::from_iter(except);
        for (name, &factor) in &links.factor {
            factors.extend(cover("factor", std::slice::from_ref(name))?.map(|cover| (cover, factor as f32)));
        }
        Ok(Self {
            only: cover("only", &links.only)?,
            factors,
            shadowless: cover("no_shadow_from", &links.no_shadow_from)?,
        })
    }

    /// Factor on the light that a triangle receives, at most [`MAX_FACTOR`]; 0 if it is not lit.
    pub fn factor(&self, mesh: &Mesh, triangle: u32) -> f32 {
        if self.only.as_ref().is_some_and(|only| !only.has(mesh, triangle)) {
            return 0.0;
        }
        let factors = self.factors.iter().filter(|(cover, _)| cover.has(mesh, triangle)).map(|(_, factor)| factor);
        factors.product::<f32>().min(MAX_FACTOR as f32)
    }

    /// Whether everything receives all of the light.
    pub fn light_evenly(&self) -> bool {
        self.only.is_none() && self.factors.is_empty()
    }

    /// Whether a triangle casts a shadow.
    pub fn casts_shadow(&self, mesh: &Mesh, triangle: u32) -> bool {
        self.shadowless.as_ref().is_none_or(|shadowless| !shadowless.has(mesh, triangle))
    }

    /// Whether everything casts a shadow.
    pub fn everything_casts_shadow(&self) -> bool {
        self.shadowless.is_none()
    }
}

impl Rig {
    /// Looks up the names of all lights that have links in `scene`; by index of the light. An error names the light.
    pub fn resolve_links(&self, scene: &Scene) -> Result<HashMap<usize, ResolvedLinks>, String> {
        let linked = self.lights.iter().enumerate().filter(|(_, light)| light.links != Links::default());
        linked
            .map(|(index, light)| match ResolvedLinks::new(&light.links, &self.sets, scene) {
                Ok(links) => Ok((index, links)),
                Err(reason) => Err(format!("light \"{}\": {reason}", light.name)),
            })
            .collect()
    }

    /// Whether `scene` has all names that lights' links use, those of shots too. An error names the light.
    pub fn check_links(&self, scene: &Scene) -> Result<(), String> {
        self.resolve_links(scene)?;
        self.shots.iter().try_for_each(|shot| {
            let resolved = self.of_shot(&shot.camera)?.resolve_links(scene);
            resolved.map(drop).map_err(|reason| format!("shot \"{}\": {reason}", shot.camera))
        })
    }

    /// Snapshots whose links, and sets of which a name, are not in `scene`, with reasons: no light uses them now.
    pub fn stale_links(&self, scene: &Scene) -> Vec<String> {
        let of_set =
            |set: &ObjectSet| Some(format!("set \"{}\": {}", set.name, Cover::new(&set.items, &[], scene).err()?));
        let of_snapshots = self.snapshots.iter().filter_map(|snapshot| {
            Some(format!("snapshot {}: {}", snapshot.slot + 1, snapshot.rig.resolve_links(scene).err()?))
        });
        self.sets.iter().filter_map(of_set).chain(of_snapshots).collect()
    }
}

/// What some names stand for.
#[derive(Clone)]
struct Cover {
    /// Per object of the scene, and per material.
    objects: Vec<bool>,
    materials: Vec<bool>,
}

impl Cover {
    fn new(names: &[String], sets: &[ObjectSet], scene: &Scene) -> Result<Self, String> {
        let mut cover =
            Self { objects: vec![false; scene.objects.len()], materials: vec![false; scene.materials.len()] };
        for name in names {
            let set = sets.iter().find(|set| set.name == *name);
            for item in set.map_or(std::slice::from_ref(name), |set| &set.items) {
                cover.add(item, scene)?;
            }
        }
        for (index, object) in scene.objects.iter().enumerate() {
            cover.objects[index] |= cover.objects[object.parent as usize];
        }
        Ok(cover)
    }

    fn add(&mut self, name: &str, scene: &Scene) -> Result<(), String> {
        let objects = self.objects.iter_mut().zip(scene.objects.iter().map(|object| &object.name));
        let materials = self.materials.iter_mut().zip(scene.materials.iter().map(|material| &material.name));
        let mut is_known = false;
        for (covered, _) in objects.chain(materials).filter(|(_, known)| *known == name && !name.is_empty()) {
            (*covered, is_known) = (true, true);
        }
        if is_known { Ok(()) } else { Err(unknown(name, scene)) }
    }

    fn has(&self, mesh: &Mesh, triangle: u32) -> bool {
        self.objects[mesh.object(triangle)] || self.materials[mesh.triangle_materials[triangle as usize] as usize]
    }
}

fn unknown(name: &str, scene: &Scene) -> String {
    let names = scene.objects.iter().map(|object| &object.name).chain(scene.materials.iter().map(|m| &m.name));
    let likeness = |known: &str| strsim::normalized_damerau_levenshtein(known, name);
    let nearest = names.max_by(|a, b| likeness(a).total_cmp(&likeness(b))).filter(|known| likeness(known) > 0.5);
    let hint = nearest.map_or(String::new(), |known| format!("; did you mean \"{known}\"?"));
    format!("the scene has no node or material \"{name}\"{hint}")
}
