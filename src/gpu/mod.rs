//! All Vulkan, all `unsafe`. Knows buffers, kernels and passes; knows no lights.
#![allow(unsafe_code)]

#[cfg(feature = "hot-reload")]
mod compile;
pub mod context;
pub mod device;
pub mod frame;
pub mod gpu_struct;
pub mod kernel;
pub mod memory;
pub mod raster;

pub use context::{Context, Validation};
pub use device::{DeviceInfo, list_devices};
pub use frame::{Frame, Frames, Pass, PassTime, Site};
pub use kernel::{Kernel, Specialization};
pub use memory::{Access, Buffer};
pub use raster::{DepthArray, DepthKernel};
