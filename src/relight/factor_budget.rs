//! The budget of device memory for factors of the transfer.

use std::sync::Arc;

use glam::UVec4;

use crate::error::Result;
use crate::gpu::{Access, Buffer, Context};

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

    /// Stores factors on the device while there is room, else in host memory, from which kernels stream them.
    pub fn upload(&mut self, context: &Arc<Context>, name: &str, factors: &[UVec4]) -> Result<Buffer<UVec4>> {
        let bytes = size_of_val(factors) as u64;
        if bytes <= self.left {
            self.left -= bytes;
            return Buffer::from_slice(context, name, factors);
        }
        self.streamed += bytes;
        Buffer::holding(context, name, Access::Streamed, factors)
    }
}
