//! Every texture of the room, painted by functions of (u, v) in the unit square, v downwards.

mod prints;
mod surfaces;

pub use prints::{BOOK_COLUMNS, BOOK_ROWS};

use glam::{DVec2, DVec3, dvec2, dvec3};
use rayon::prelude::*;

use crate::glb::Texture;

/// What the unit square of each texture that repeats is wide in the room, metres.
pub const FLOOR_METRES: f64 = 1.92;
pub const WOOD_METRES: f64 = 0.8;
pub const PLASTER_METRES: f64 = 1.6;
pub const CLOTH_METRES: f64 = 0.32;
pub const TILE_METRES: f64 = 0.6;

pub fn all() -> Vec<Texture> {
    [surfaces::all(), prints::all()].concat().into_par_iter().map(|paint| paint()).collect()
}

type Paint = fn() -> Texture;

/// sRGB colours in 0..1.
fn color(name: &'static str, side: u32, paint: impl Fn(DVec2) -> DVec3 + Sync) -> Texture {
    encoded(name, side, png::ColorType::Rgb, |uv| paint(uv).to_array().to_vec())
}

/// The same with alpha.
fn cut_out(name: &'static str, side: u32, paint: impl Fn(DVec2) -> (DVec3, f64) + Sync) -> Texture {
    encoded(name, side, png::ColorType::Rgba, |uv| {
        let (color, alpha) = paint(uv);
        vec![color.x, color.y, color.z, alpha]
    })
}

/// glTF's metallic-roughness texture of what is no metal.
fn roughness(name: &'static str, side: u32, paint: impl Fn(DVec2) -> f64 + Sync) -> Texture {
    encoded(name, side, png::ColorType::Rgb, |uv| vec![0.0, paint(uv), 0.0])
}

/// A normal map of `height`, metres over a square `metres` wide; it repeats.
fn normals(name: &'static str, side: u32, metres: f64, height: impl Fn(DVec2) -> f64 + Sync) -> Texture {
    let step = 1.0 / f64::from(side);
    encoded(name, side, png::ColorType::Rgb, |uv| {
        let slope = |axis: DVec2| (height(uv + axis * step) - height(uv - axis * step)) / (2.0 * step * metres);
        // +Y is up, v down.
        let normal = dvec3(-slope(DVec2::X), slope(DVec2::Y), 1.0).normalize();
        (normal * 0.5 + 0.5).to_array().to_vec()
    })
}

fn encoded(name: &'static str, side: u32, kind: png::ColorType, texel: impl Fn(DVec2) -> Vec<f64> + Sync) -> Texture {
    let row = |y: u32| {
        let at = move |x: u32| dvec2(f64::from(x) + 0.5, f64::from(y) + 0.5) / f64::from(side);
        (0..side).flat_map(|x| texel(at(x))).map(|c| (c * 255.0).round() as u8).collect::<Vec<_>>()
    };
    let texels: Vec<u8> = (0..side).into_par_iter().flat_map_iter(row).collect();
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, side, side);
    encoder.set_color(kind);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().expect("memory takes any header");
    writer.write_image_data(&texels).expect("as many texels as the header says");
    drop(writer);
    Texture { name, png }
}

fn smooth_step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
