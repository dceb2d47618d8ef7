//! All Vulkan code, and all `unsafe` code except that for mapped files. Provides buffers, kernels and passes;
//! independent of lights.
#![allow(unsafe_code)]

#[cfg(feature = "hot-reload")]
mod compile;
pub mod context;
pub mod depth_array;
pub mod device;
mod faults;
pub mod frame;
mod instance;
pub mod kernel;
pub mod limits;
pub mod measurements;
pub mod memory;
pub mod present;
pub mod raster;
mod small_device;
pub mod surface;
pub mod ui;
mod upload;
mod vulkan_error;

pub use context::Context;
pub use depth_array::DepthArray;
pub use device::{DeviceInfo, find_device, list_devices};
pub use frame::{Frame, Frames, HostPass, Pass, PassTime, Processor};
pub use instance::Validation;
pub use kernel::Kernel;
pub use limits::Limits;
pub use measurements::Measurements;
pub use memory::{Access, Buffer, SharedFloat};
pub use present::{ComparisonOverlay, Pixels, Placement, Screen};
pub use raster::DepthKernel;
pub use surface::{Surface, Vsync, Window};
pub use ui::{UiFrame, UiRenderer};
pub use vulkan_error::is_out_of_memory;

/// Reason why a lock is never poisoned: no thread panics while it holds one of our locks.
const UNPOISONED: &str = "no thread panics while it holds this lock";
