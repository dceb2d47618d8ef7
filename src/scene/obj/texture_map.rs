//! Texture statements of MTL: options, then a file name.

use glam::{Mat3, Vec2, Vec3};

use super::words::{number, split_word};
use crate::scene::{TextureRef, Wrap};

/// A texture statement: options, then a file name.
pub struct TextureMap {
    pub file: String,
    pub offset: Vec2,
    pub scale: Vec2,
    pub clamp: bool,
    /// `-bm`, the strength of a normal map.
    pub strength: f32,
}

impl TextureMap {
    /// Parses the arguments of a texture statement.
    pub fn parse(rest: &str) -> Result<Self, String> {
        let (offset, scale) = (Vec2::ZERO, Vec2::ONE);
        let mut map = Self { file: String::new(), offset, scale, clamp: false, strength: 1.0 };
        let mut rest = rest;
        while rest.starts_with('-') {
            let (option, mut after) = split_word(rest);
            match option {
                "-o" | "-s" | "-t" => {
                    // One to three numbers.
                    let mut values = Vec::new();
                    while let (word, next) = split_word(after)
                        && values.len() < 3
                        && let Ok(value) = number(word)
                    {
                        values.push(value as f32);
                        after = next;
                    }
                    let default = if option == "-s" { 1.0 } else { 0.0 };
                    let value = |i: usize| values.get(i).copied().unwrap_or(default);
                    match option {
                        "-o" => map.offset = Vec2::new(value(0), value(1)),
                        "-s" => map.scale = Vec2::new(value(0), value(1)),
                        _ => {}
                    }
                }
                "-mm" => after = split_word(split_word(after).1).1,
                "-bm" => {
                    let (word, next) = split_word(after);
                    (map.strength, after) = (number(word)? as f32, next);
                }
                "-clamp" => {
                    let (word, next) = split_word(after);
                    (map.clamp, after) = (word == "on", next);
                }
                "-blendu" | "-blendv" | "-boost" | "-cc" | "-imfchan" | "-texres" | "-type" => {
                    after = split_word(after).1;
                }
                _ => return Err(format!("option {option} is unknown")),
            }
            rest = after;
        }
        map.file = rest.replace('\\', "/");
        if map.file.is_empty() { Err("names no file".into()) } else { Ok(map) }
    }

    /// Reference to `texture` with the map's transform and wrap mode.
    pub fn reference(&self, texture: usize) -> TextureRef {
        let wrap = if self.clamp { Wrap::Clamp } else { Wrap::Repeat };
        // OBJ's v points the other way, so v is flipped before and after the transform.
        let turned = Mat3::from_cols(Vec3::X, -Vec3::Y, Vec3::new(0.0, 1.0, 1.0));
        let uv_transform = turned * Mat3::from_translation(self.offset) * Mat3::from_scale(self.scale) * turned;
        TextureRef { texture, uv_set: 0, uv_transform, wrap: [wrap; 2], is_nearest: false }
    }

    /// Whether two maps have the same offset, scale and wrap mode.
    pub fn is_aligned(&self, other: &Self) -> bool {
        let places = |map: &Self| -> (Vec2, Vec2, bool) { (map.offset, map.scale, map.clamp) };
        places(self) == places(other)
    }
}
