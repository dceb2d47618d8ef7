//! Vulkan errors, with a remedy where the user can apply one.

use ash::vk;
use gpu_allocator::AllocationError;

use crate::error::{Cause, Error};

/// Converts a Vulkan error to an `Error` that names the failed `action`.
pub(super) fn vulkan<E>(action: impl Into<String>) -> impl FnOnce(E) -> Error
where
    E: std::error::Error + Send + Sync + 'static,
{
    let action = action.into();
    move |source| {
        let source: Cause = match remedy(&source) {
            Some(remedy) => Box::new(Remedied { remedy, source: Box::new(source) }),
            None => Box::new(source),
        };
        Error::Vulkan { action, source }
    }
}

/// An error with a remedy, which is reported before it.
#[derive(Debug, thiserror::Error)]
#[error("{remedy}")]
struct Remedied {
    remedy: &'static str,
    source: Cause,
}

/// A remedy that the user can apply, if there is one.
fn remedy(error: &(dyn std::error::Error + 'static)) -> Option<&'static str> {
    let result = match error.downcast_ref() {
        Some(AllocationError::OutOfMemory) => vk::Result::ERROR_OUT_OF_DEVICE_MEMORY,
        _ => *error.downcast_ref()?,
    };
    match result {
        vk::Result::ERROR_DEVICE_LOST => {
            Some("the device was lost: its driver failed; `relume devices` lists others for --device")
        }
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY => Some(OUT_OF_MEMORY),
        _ => None,
    }
}

/// Whether the device had no room for a buffer or an image.
pub fn is_out_of_memory(error: &Error) -> bool {
    let Error::Vulkan { source, .. } = error else { return false };
    source.downcast_ref::<Remedied>().is_some_and(|remedied| remedied.remedy == OUT_OF_MEMORY)
}

const OUT_OF_MEMORY: &str = "the device is out of memory; reduce the picture size (--size), the memory budget (--budget) or the gather samples (--gather)";
