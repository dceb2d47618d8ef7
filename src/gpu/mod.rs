//! All Vulkan code, and all `unsafe` code except that for mapped files. Provides buffers, kernels and passes;
//! independent of lights.
#![allow(unsafe_code)]

#[cfg(feature = "hot-reload")]
mod compile;
pub mod context;
pub mod device;
mod faults;
pub mod frame;
pub mod kernel;
pub mod memory;
pub mod present;
pub mod raster;
pub mod surface;
pub mod ui;

pub use context::{Context, Validation};
pub use device::{DeviceInfo, list_devices};
pub use frame::{Frame, Frames, Pass, PassTime, Site};
pub use kernel::Kernel;
pub use memory::{Access, Buffer};
pub use present::{Over, Pixels, Placement, Screen};
pub use raster::{DepthArray, DepthKernel};
pub use surface::{Surface, Vsync, Window};
pub use ui::{UiFrame, UiRenderer};
