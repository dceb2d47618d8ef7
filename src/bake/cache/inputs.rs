//! What a deep framebuffer depends on, part by part: a key, and which parts differ from an earlier bake.

use std::path::Path;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{FORMAT, Key, Reader, files, hash_of, is_bake, name, serialized};
use crate::bake::BakeSettings;
use crate::bake::framebuffer::edges::edge_lights;
use crate::scene::texture::Texture;
use crate::scene::{Camera, Material, Rig, Scene};
use crate::storage::file::open;
use crate::storage::mapped::Mapping;

/// Hashes of the inputs of a deep framebuffer. Lights are an input only if their edges are anti-aliased. Names are
/// none, but for those of emitters; neither are materials and textures that no surface has.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Inputs {
    /// Of relume and of the file format.
    version: String,
    size: [u32; 2],
    settings: String,
    camera: String,
    /// Triangles, and which material each has.
    geometry: String,
    /// Name and hash, in the order of the scene; the hash of one that is not used is empty.
    materials: Vec<(String, String)>,
    shadow_edges: String,
}

/// The key in a file's metadata.
pub(super) const METADATA: &str = "inputs";

impl Inputs {
    pub fn of(scene: &Scene, camera: &Camera, rig: &Rig, settings: &BakeSettings) -> Self {
        let BakeSettings { width, height, layers, samples } = *settings;
        let mesh = &scene.mesh;
        let mut geometry = blake3::Hasher::new();
        geometry.update(&serialized(&scene.space));
        let arrays: [&[u8]; 8] = [
            bytemuck::cast_slice(&mesh.positions),
            bytemuck::cast_slice(&mesh.normals),
            bytemuck::cast_slice(&mesh.uvs[0]),
            bytemuck::cast_slice(&mesh.uvs[1]),
            bytemuck::cast_slice(&mesh.colors),
            bytemuck::cast_slice(&mesh.tangents),
            bytemuck::cast_slice(&mesh.triangles),
            bytemuck::cast_slice(&mesh.triangle_materials),
        ];
        for array in arrays {
            geometry.update(&(array.len() as u64).to_le_bytes());
            geometry.update_rayon(array);
        }
        let mut is_used = vec![false; scene.materials.len()];
        mesh.triangle_materials.iter().for_each(|&material| is_used[material as usize] = true);
        let textures: Vec<String> = scene.textures.iter().map(texture).collect();
        // One that shines is an emitter even if no surface has it.
        let hash = |(of, is_used): (&Material, bool)| match is_used || of.emissive != Vec3::ZERO {
            true => (of.name.clone(), material(of, &textures)),
            false => (of.name.clone(), String::new()),
        };
        Self {
            version: format!("{} {FORMAT}", env!("CARGO_PKG_VERSION")),
            size: [width, height],
            settings: hash_of(&(layers, samples)),
            camera: hash_of(&(camera.position, camera.world_from_camera, camera.projection)),
            geometry: name(&geometry.finalize()),
            materials: scene.materials.iter().zip(is_used).map(hash).collect(),
            shadow_edges: if samples > 1 { hash_of(&edge_lights(scene.space, rig)) } else { String::new() },
        }
    }

    /// Names the bake. Emitters are told apart by name; other names are not part of it.
    pub fn key(&self) -> Key {
        let hashes: Vec<&String> = self.materials.iter().map(|(_, hash)| hash).collect();
        let Self { version, size, settings, camera, geometry, shadow_edges, .. } = self;
        Key(hash_of(&(version, size, settings, camera, geometry, hashes, shadow_edges)))
    }

    /// The parts that differ from an earlier bake's, in words.
    pub fn changes_since(&self, earlier: &Self) -> Vec<String> {
        let mut changes = Vec::new();
        let mut part = |differs: bool, what: &str| changes.extend(differs.then(|| what.to_owned()));
        part(self.version != earlier.version, "the version of relume");
        part(self.size != earlier.size, "the size of the picture");
        part(self.settings != earlier.settings, "layers or samples");
        part(self.camera != earlier.camera, "the camera");
        part(self.geometry != earlier.geometry, "geometry");
        part(self.shadow_edges != earlier.shadow_edges, "lights, whose shadow edges --samples smooths");
        let counts_differ = self.materials.len() != earlier.materials.len();
        part(counts_differ, "the number of materials");
        if !counts_differ {
            let pairs = self.materials.iter().zip(&earlier.materials);
            let changed: Vec<_> = pairs.filter(|(now, then)| now.1 != then.1).map(|(now, _)| &*now.0).collect();
            match &changed[..] {
                [] => {}
                [one] => changes.push(format!("the material \"{one}\"")),
                [one, two] => changes.push(format!("the materials \"{one}\" and \"{two}\"")),
                many => changes.push(format!("{} of {} materials", many.len(), self.materials.len())),
            }
        }
        changes
    }

    /// What differs from the most similar bake of the scene called `name` in a cache folder; `None` if there is none.
    pub fn changes(&self, dir: &Path, name: &str) -> Option<String> {
        let earlier = |path: &Path| {
            let reader = Reader::new(Mapping::new(&open(path).ok()?.0).ok()?)?;
            let is_of_scene = reader.text("scene") == Some(name);
            serde_json::from_str::<Self>(reader.text(METADATA).filter(|_| is_of_scene)?).ok()
        };
        let bakes = files(dir, is_bake).ok()?;
        let changes = bakes.iter().filter_map(|path| earlier(path)).map(|earlier| self.changes_since(&earlier));
        let fewest = changes.filter(|changes| !changes.is_empty()).min_by_key(Vec::len)?;
        Some(fewest.join(", "))
    }
}

/// A material with the content of its textures, wherever they are in the scene.
fn material(material: &Material, textures: &[String]) -> String {
    let mut anonymous = material.clone();
    if material.emissive == Vec3::ZERO {
        anonymous.name.clear();
    }
    let contents: Vec<&String> = material.textures().map(|of| &textures[of.texture]).collect();
    anonymous.textures_mut().into_iter().flatten().for_each(|of| of.texture = 0);
    hash_of(&(anonymous, contents))
}

fn texture(texture: &Texture) -> String {
    let finest = &texture.levels[0];
    let mut hasher = blake3::Hasher::new();
    hasher.update(&serialized(&(texture.encoding, finest.width, finest.height)));
    hasher.update_rayon(bytemuck::cast_slice(&finest.texels));
    hasher.update_rayon(bytemuck::cast_slice(&finest.low));
    name(&hasher.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inputs(materials: &[(&str, &str)]) -> Inputs {
        let own = |(name, hash): &(&str, &str)| (name.to_string(), hash.to_string());
        Inputs {
            version: "1".into(),
            size: [3, 2],
            settings: "s".into(),
            camera: "c".into(),
            geometry: "g".into(),
            materials: materials.iter().map(own).collect(),
            shadow_edges: String::new(),
        }
    }

    #[test]
    fn changes_are_named() {
        let one = inputs(&[("wall", "a"), ("sofa", "b"), ("rug", "c")]);
        let changes = |other: &Inputs| other.changes_since(&one).join(", ");
        assert_eq!(changes(&one), "");
        let renamed = inputs(&[("Wall", "a"), ("sofa", "b"), ("rug", "c")]);
        assert_eq!((changes(&renamed), renamed.key()), (String::new(), one.key()));
        let repainted = inputs(&[("wall", "a"), ("sofa", "x"), ("rug", "c")]);
        assert_eq!(changes(&repainted), "the material \"sofa\"");
        assert_ne!(repainted.key(), one.key());
        let all = Inputs { camera: "d".into(), ..inputs(&[("wall", "x"), ("sofa", "y"), ("rug", "z")]) };
        assert_eq!(changes(&all), "the camera, 3 of 3 materials");
        let more = inputs(&[("wall", "a")]);
        assert_eq!(changes(&more), "the number of materials");
    }
}
