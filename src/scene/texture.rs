//! Textures: decoded once, looked up while baking.

use glam::{Vec2, Vec4};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    Repeat,
    Mirror,
    Clamp,
}

pub struct Texture {}

impl Texture {
    pub fn sample(&self, uv: Vec2, wrap: [Wrap; 2], footprint: f32) -> Vec4 {
        let _ = (uv, wrap, footprint);
        todo!()
    }
}
