//! Material extensions that [`Material`] cannot represent. Exact conversions are made; the others are counted and
//! reported once per file, with their visible effect.

use glam::Vec3;
use serde_json::{Map, Value};

use super::document::Document;
use crate::scene::Material;

/// An unsupported extension. It has an effect if any of `factors` is not zero; `effect` describes it in the warning.
struct UnsupportedExtension {
    extension: &'static str,
    factors: &'static [&'static str],
    effect: &'static str,
}

/// Volume and dispersion are visible only through a transmissive surface, so they have no warning of their own.
const UNSUPPORTED: [UnsupportedExtension; 6] = [
    UnsupportedExtension {
        extension: "KHR_materials_clearcoat",
        factors: &["clearcoatFactor"],
        effect: "their coat's highlight is missing",
    },
    UnsupportedExtension {
        extension: "KHR_materials_transmission",
        factors: &["transmissionFactor"],
        effect: "nothing is seen through them",
    },
    UnsupportedExtension {
        extension: "KHR_materials_diffuse_transmission",
        factors: &["diffuseTransmissionFactor"],
        effect: "no light shines through them",
    },
    UnsupportedExtension {
        extension: "KHR_materials_sheen",
        factors: &["sheenColorFactor"],
        effect: "their sheen is missing",
    },
    UnsupportedExtension {
        extension: "KHR_materials_anisotropy",
        factors: &["anisotropyStrength"],
        effect: "their highlights are round",
    },
    UnsupportedExtension {
        extension: "KHR_materials_iridescence",
        factors: &["iridescenceFactor"],
        effect: "their reflections lack the colours of thin films",
    },
];

/// Number of materials per unsupported extension.
#[derive(Default)]
pub struct Missing {
    counts: [usize; UNSUPPORTED.len()],
    unlit: usize,
    pub short_of_uv_sets: usize,
}

impl Missing {
    /// Counts the unsupported extensions of one material.
    pub fn count(&mut self, extensions: &Map<String, Value>) {
        for (count, unsupported) in self.counts.iter_mut().zip(&UNSUPPORTED) {
            let Some(extension) = extensions.get(unsupported.extension) else { continue };
            // All these factors default to zero.
            let is_zero = |value: &Value| match value {
                Value::Array(items) => items.iter().all(|item| item.as_f64() == Some(0.0)),
                value => value.as_f64() == Some(0.0),
            };
            let counts = unsupported.factors.iter().any(|&key| extension.get(key).is_some_and(|value| !is_zero(value)));
            *count += usize::from(counts);
        }
        self.unlit += usize::from(extensions.contains_key("KHR_materials_unlit"));
    }

    pub fn warn(&self, document: &Document) {
        let path = document.path.display();
        let have = |count: usize| if count == 1 { "1 material has".into() } else { format!("{count} materials have") };
        for (&count, unsupported) in self.counts.iter().zip(&UNSUPPORTED).filter(|(count, _)| **count > 0) {
            tracing::warn!("{path}: {} {}: {}", have(count), unsupported.extension, unsupported.effect);
        }
        if self.unlit > 0 {
            let effect = "no light falls on them, their base colour is emitted instead";
            tracing::warn!("{path}: {} KHR_materials_unlit: {effect}", have(self.unlit));
        }
        if self.short_of_uv_sets > 0 {
            let count = have(self.short_of_uv_sets);
            tracing::warn!(
                "{path}: {count} textures on more than two sets of texture coordinates; the others are ignored"
            );
        }
        if let Some(names) = variants(document).filter(|names| !names.is_empty()) {
            tracing::warn!("{path}: shows the default of its variants ({})", names.join(", "));
        }
    }
}

/// Names of `KHR_materials_variants`; the materials that primitives refer to directly are the default.
fn variants(document: &Document) -> Option<Vec<String>> {
    let extensions = document.root.extensions.as_ref()?;
    let variants = extensions.others.get("KHR_materials_variants")?.get("variants")?.as_array()?;
    // As many as fit on a line.
    Some(variants.iter().filter_map(|v| v.get("name")?.as_str().map(crate::scene::files::shortened)).take(8).collect())
}

/// `KHR_materials_unlit`: the base colour is visible as it is. Nothing is reflected, so it is emitted; alpha is
/// unchanged.
pub fn make_unlit(material: &mut Material) {
    material.emissive = material.base_color.truncate();
    material.emissive_texture = material.base_color_texture;
    material.base_color = Vec3::ZERO.extend(material.base_color.w);
    (material.metallic, material.roughness, material.specular) = (0.0, 1.0, 0.0);
    material.metallic_roughness_texture = None;
    (material.normal_texture, material.specular_texture, material.specular_color_texture) = (None, None, None);
}
