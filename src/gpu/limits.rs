//! Limits of a device that scenes, pictures and settings can meet.
//!
//! Kernels use addresses, which `maxStorageBufferRange` does not bound: it is a limit of descriptors. Push constants,
//! workgroups, their shared memory and numbers of workgroups stay within what Vulkan 1.3 guarantees.

use ash::vk;

/// What a device can hold.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Limits {
    /// Size of a buffer.
    pub buffer_bytes: u64,
    /// Size of one allocation of memory, which holds at least a whole buffer or image.
    pub allocation_bytes: u64,
    /// Side of an image that is drawn into, pixels.
    pub image_side: u32,
    /// Index of a vertex that is drawn.
    pub vertex_index: u32,
}

/// Drivers round allocations up to pages, of at most this size.
const PAGE_BYTES: u64 = 1 << 16;
/// Kernels index at most three floats for each view sample of 32 bytes; SPIR-V reads indices as signed 32-bit numbers.
const MAX_INDEXED_BYTES: u64 = 1 << 34;

impl Limits {
    pub(super) fn new(
        core: &vk::PhysicalDeviceLimits,
        maintenance3: &vk::PhysicalDeviceMaintenance3Properties,
        vulkan13: &vk::PhysicalDeviceVulkan13Properties,
    ) -> Self {
        let [viewport_width, viewport_height] = core.max_viewport_dimensions;
        let sides = [
            core.max_image_dimension2_d,
            core.max_framebuffer_width,
            core.max_framebuffer_height,
            viewport_width,
            viewport_height,
        ];
        Self {
            buffer_bytes: vulkan13.max_buffer_size,
            allocation_bytes: maintenance3.max_memory_allocation_size,
            image_side: sides.into_iter().min().unwrap_or(0),
            vertex_index: core.max_draw_indexed_index_value,
        }
    }

    /// Size of the largest buffer that can be allocated and indexed.
    pub fn largest_buffer(&self) -> u64 {
        self.buffer_bytes.min(self.allocation_bytes / PAGE_BYTES * PAGE_BYTES).min(MAX_INDEXED_BYTES)
    }
}
