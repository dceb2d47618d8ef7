//! relume: interactive relighting of scenes with fixed camera, geometry and materials.
//!
//! Data flows one way: [`scene`] -> [`bake`] -> [`relight`]; [`gpu`] is all Vulkan and all `unsafe`.

pub mod bake;
pub mod error;
pub mod gpu;
pub mod image;
pub mod reference;
pub mod relight;
pub mod scene;
pub mod shared;

pub use error::{Error, Result};
