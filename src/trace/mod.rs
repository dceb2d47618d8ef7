//! Ray tracing: bounding volume hierarchies, packets of shadow rays, the surface at a hit. Depends on scenes, not on
//! baked data.

pub mod bvh;
mod coincident;
pub mod emitting_triangles;
pub mod light_surface;
pub mod linked;
pub mod packet;
pub mod photon_map;
pub mod point_tree;
pub mod surface;
pub mod triangle_lookup;
