//! Rays: bounding volume hierarchies, packets of shadow rays, the surface at a hit. Knows scenes, and nothing that is baked.

pub mod bvh;
mod coincident;
pub mod packet;
pub mod point_tree;
pub mod surface;
