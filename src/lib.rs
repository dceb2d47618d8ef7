//! relume: interactive relighting of scenes with fixed camera, geometry and materials.
//!
//! Data flows one way: [`scene`] -> [`bake`] -> [`relight`]; [`gpu`] is all Vulkan and all `unsafe`.

pub mod error;
pub mod image;
pub mod scene;

pub use error::{Error, Result};
