//! The materials of the room. Most are double-sided, as exporters write them.

use super::textures::{CLOTH_METRES, FLOOR_METRES, PLASTER_METRES, TILE_METRES, WOOD_METRES};
use crate::glb::Material;

/// A material and how large its textures lie on things.
#[derive(Clone, Copy)]
pub struct Look {
    pub material: Material,
    /// What the unit square of its textures is wide.
    pub metres: f64,
}

const fn painted(name: &'static str, base_color: [f64; 3], roughness: f64) -> Look {
    Look { material: Material { name, base_color, roughness, double_sided: true, ..Material::PLAIN }, metres: 1.0 }
}

const fn metal(name: &'static str, base_color: [f64; 3], roughness: f64) -> Look {
    Look { material: Material { name, base_color, metallic: 1.0, roughness, ..Material::PLAIN }, metres: 1.0 }
}

const fn plaster(name: &'static str, base_color: [f64; 3]) -> Look {
    let material = Material {
        name,
        base_color,
        roughness: 0.95,
        base_color_map: Some("plaster_color"),
        normal_map: Some("plaster_normal"),
        ..Material::PLAIN
    };
    Look { material, metres: PLASTER_METRES }
}

const fn wood(name: &'static str, base_color: [f64; 3]) -> Look {
    let material = Material {
        name,
        base_color,
        base_color_map: Some("wood_color"),
        metallic_roughness_map: Some("wood_roughness"),
        double_sided: true,
        ..Material::PLAIN
    };
    Look { material, metres: WOOD_METRES }
}

const fn cloth(name: &'static str, base_color: [f64; 3]) -> Look {
    let material = Material {
        name,
        base_color,
        base_color_map: Some("cloth_color"),
        normal_map: Some("cloth_normal"),
        double_sided: true,
        ..Material::PLAIN
    };
    Look { material, metres: CLOTH_METRES }
}

/// A texture shown once.
const fn print(name: &'static str, map: &'static str, roughness: f64) -> Look {
    let material = Material { name, base_color: [1.0; 3], roughness, base_color_map: Some(map), ..Material::PLAIN };
    Look { material, metres: 1.0 }
}

pub const WALL: Look = plaster("wall_plaster", [0.62, 0.60, 0.55]);
pub const CEILING: Look = plaster("ceiling_plaster", [0.80, 0.80, 0.78]);
pub const PLANKS: Look = Look {
    material: Material {
        name: "planks",
        base_color: [1.0; 3],
        base_color_map: Some("planks_color"),
        metallic_roughness_map: Some("planks_roughness"),
        normal_map: Some("planks_normal"),
        ..Material::PLAIN
    },
    metres: FLOOR_METRES,
};
pub const TILES: Look = Look {
    material: Material {
        name: "tiles",
        base_color: [1.0; 3],
        base_color_map: Some("tiles_color"),
        metallic_roughness_map: Some("tiles_roughness"),
        normal_map: Some("tiles_normal"),
        ..Material::PLAIN
    },
    metres: TILE_METRES,
};

pub const WHITE_PAINT: Look = painted("white_paint", [0.74, 0.73, 0.70], 0.42);
pub const SOOT: Look = painted("soot", [0.055, 0.050, 0.046], 0.95);
pub const PAPER: Look = painted("paper", [0.72, 0.67, 0.56], 0.95);
pub const CARDBOARD: Look = painted("passepartout", [0.76, 0.74, 0.69], 0.9);
pub const SOIL: Look = painted("soil", [0.045, 0.032, 0.024], 1.0);
pub const STEM: Look = painted("stem", [0.16, 0.15, 0.07], 0.7);
pub const BLACK_IRON: Look = painted("black_iron", [0.03, 0.03, 0.03], 0.45);
pub const PLASTIC: Look = painted("plastic", [0.70, 0.69, 0.66], 0.35);
pub const WAX: Look = painted("wax", [0.78, 0.72, 0.60], 0.5);
pub const APPLE: Look = painted("apple", [0.42, 0.07, 0.04], 0.3);
pub const PEAR: Look = painted("pear", [0.46, 0.42, 0.09], 0.4);

pub const PORCELAIN: Look = painted("porcelain", [0.70, 0.69, 0.65], 0.12);
pub const BLUE_GLAZE: Look = painted("blue_glaze", [0.05, 0.12, 0.24], 0.10);
pub const CELADON: Look = painted("celadon", [0.30, 0.42, 0.36], 0.15);
pub const TERRACOTTA: Look = painted("terracotta", [0.44, 0.20, 0.12], 0.75);

pub const STEEL: Look = metal("steel", [0.62, 0.61, 0.59], 0.22);
pub const BRASS: Look = metal("brass", [0.72, 0.52, 0.24], 0.28);
pub const GILT: Look = metal("gilt", [0.68, 0.50, 0.24], 0.42);
/// The layered framebuffer reflects it exactly.
pub const MIRROR: Look = metal("mirror", [0.90, 0.91, 0.90], 0.0);

pub const OAK: Look = wood("oak", [0.42, 0.27, 0.15]);
pub const WALNUT: Look = wood("walnut", [0.22, 0.115, 0.06]);
pub const BEECH: Look = wood("beech", [0.40, 0.235, 0.12]);

pub const SOFA: Look = cloth("sofa_cloth", [0.20, 0.25, 0.26]);
pub const MUSTARD: Look = cloth("mustard_cloth", [0.55, 0.34, 0.08]);
pub const CREAM: Look = cloth("cream_cloth", [0.68, 0.62, 0.52]);
pub const CURTAIN: Look = cloth("curtain_cloth", [0.58, 0.50, 0.40]);

pub const RUG: Look = print("rug", "rug_color", 1.0);
pub const BOOKS: Look = print("books", "books_color", 0.6);
pub const PICTURES: Look = print("pictures", "pictures_color", 0.35);
pub const LEAF: Look = Look {
    material: Material {
        name: "leaf",
        base_color: [1.0; 3],
        roughness: 0.38,
        base_color_map: Some("leaf_color"),
        alpha_cutoff: Some(0.5),
        double_sided: true,
        ..Material::PLAIN
    },
    metres: 1.0,
};

/// Thin cloth with the lamp behind it.
pub const SHADE: Look = shade([4.0, 2.75, 1.5]);
/// As the only lamp at night.
pub const LIT_SHADE: Look = shade([14.0, 8.6, 3.9]);

const fn shade(emissive: [f64; 3]) -> Look {
    let material = Material {
        name: "lamp_shade",
        base_color: [0.38, 0.32, 0.23],
        emissive,
        base_color_map: Some("cloth_color"),
        emissive_map: Some("cloth_color"),
        double_sided: true,
        ..Material::PLAIN
    };
    Look { material, metres: CLOTH_METRES }
}

pub const BULB: Look = glow("reading_bulb", [700.0, 470.0, 240.0]);
pub const CEILING_GLOW: Look = glow("ceiling_glow", [180.0, 150.0, 110.0]);
pub const SCREEN: Look = glow("screen", [3.0, 5.0, 9.0]);

const fn glow(name: &'static str, emissive: [f64; 3]) -> Look {
    Look { material: Material { name, base_color: [0.02; 3], emissive, ..Material::PLAIN }, metres: 1.0 }
}

/// Overcast: what the window shows.
pub const GARDEN: Look = garden([7.0, 7.6, 8.2]);
pub const DUSK: Look = garden([0.35, 0.55, 1.1]);

const fn garden(emissive: [f64; 3]) -> Look {
    let material = Material {
        name: "garden",
        base_color: [0.0; 3],
        emissive,
        emissive_map: Some("garden_color"),
        ..Material::PLAIN
    };
    Look { material, metres: 1.0 }
}
