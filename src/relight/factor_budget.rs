//! The budget of device memory for factors of the transfer.

use std::sync::Arc;

use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, is_out_of_memory};
use crate::shared::gpu_struct::Glsl;

/// Bytes of device memory left for factors, and bytes of factors that did not fit.
pub struct FactorBudget {
    pub left: u64,
    pub streamed: u64,
}

impl FactorBudget {
    /// A budget of `bytes`, none of it used.
    pub fn new(bytes: u64) -> Self {
        Self { left: bytes, streamed: 0 }
    }

    /// Stores factors or their indices on the device while there is room, else in host memory, from which kernels
    /// stream them.
    pub fn upload<T: Glsl>(&mut self, context: &Arc<Context>, name: &str, factors: &[T]) -> Result<Buffer<T>> {
        let bytes = size_of_val(factors) as u64;
        if bytes <= self.left {
            match Buffer::from_slice(context, name, factors) {
                // The device may have less memory than the budget says.
                Err(error) if is_out_of_memory(&error) => (),
                uploaded => {
                    self.left -= bytes;
                    return uploaded;
                }
            }
        }
        self.streamed += bytes;
        Buffer::holding(context, name, Access::Streamed, factors)
    }
}
