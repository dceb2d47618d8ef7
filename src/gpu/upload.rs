//! Buffers with given contents, which a frame of its own copies to memory that the host does not access.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ash::vk;
use rayon::prelude::*;

use super::context::Context;
use super::frame::Frames;
use super::memory::{Access, Buffer, RawBuffer};
use crate::error::Result;
use crate::shared::gpu_struct::Glsl;

impl<T: Glsl> Buffer<T> {
    /// A buffer that contains `data` and is only read from now on.
    pub fn from_slice(context: &Arc<Context>, name: &str, data: &[T]) -> Result<Self> {
        let access = if context.is_cpu() { Access::HostWrites } else { Access::Device };
        Self::holding(context, name, access, data)
    }

    /// Like [`Self::from_slice`], with a given access.
    pub fn holding(context: &Arc<Context>, name: &str, access: Access, data: &[T]) -> Result<Self> {
        let mut buffer = Self::new(context, name, access, data.len())?;
        if access != Access::Device {
            copy(buffer.host_mut(), data);
        } else if !data.is_empty() {
            let mut staging = Self::new(context, "staging", Access::HostWrites, data.len())?;
            copy(staging.host_mut(), data);
            copy_once(context, staging.raw(), buffer.raw(), size_of_val(data) as u64)?;
        }
        buffer.raw().written.store(true, Ordering::Relaxed);
        Ok(buffer)
    }
}

/// Copies on all cores: most of the time of a large copy is spent on page faults, not on moving bytes.
fn copy<T: Glsl>(to: &mut [T], from: &[T]) {
    let (to, from): (&mut [u8], &[u8]) = (bytemuck::cast_slice_mut(to), bytemuck::cast_slice(from));
    let chunks = to.par_chunks_mut(COPY_BYTES).zip(from.par_chunks(COPY_BYTES));
    chunks.for_each(|(to, from)| to.copy_from_slice(from));
}

/// Bytes that one task copies, a fraction of a millisecond of work.
const COPY_BYTES: usize = 1 << 20;

/// Copies a buffer in a separate frame and waits.
fn copy_once(context: &Arc<Context>, from: &RawBuffer, to: &RawBuffer, bytes: u64) -> Result<()> {
    let mut frames = Frames::new(context)?;
    let frame = frames.begin()?;
    let region = [vk::BufferCopy::default().size(bytes)];
    // SAFETY: the command buffer is being recorded; both buffers hold `bytes` and outlive the wait below.
    unsafe { context.device.cmd_copy_buffer(frame.commands(), from.handle, to.handle, &region) };
    frame.finish()?;
    Ok(())
}
