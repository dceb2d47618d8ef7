//! Everything that is independent of the lights: [`DeepFramebuffer`] and [`Transfer`](transfer::Transfer).
//!
//! ```text
//! scene -> framebuffer -> gather_samples -> transport -> compression -> transfer
//! ```

pub mod baselines;
pub mod brdf_factors;
pub mod cache;
pub mod channels;
pub mod compression;
pub mod csr_matrix;
pub mod framebuffer;
pub mod gather_samples;
mod linear;
mod low_priority;
pub mod transfer;
pub mod transport;

pub use self::framebuffer::{BakeSettings, DeepFramebuffer, Thing, bake};
pub use self::low_priority::{at_rest, low_priority};
