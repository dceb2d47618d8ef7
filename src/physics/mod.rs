//! Pure functions: glTF's BRDF, punctual lights, sampling sequences, directions on the sphere, tone curves.

pub mod brdf;
pub mod distribution;
pub mod light;
pub mod octahedral;
pub mod sequence;
pub mod sky_cells;
pub mod tone_curve;
