//! Typed, named buffers that own their memory; `upload.rs` fills them.

use std::marker::PhantomData;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::UNPOISONED;
use super::context::Context;
use super::vulkan_error::vulkan;
use crate::error::Result;
use crate::shared::gpu_struct::Glsl;

/// How the host accesses a buffer; determines its memory type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// The host does not access it.
    Device,
    /// The host writes it, kernels read it.
    HostWrites,
    /// Kernels write it, the host reads it.
    HostReads,
    /// The host writes it once; kernels read it from host memory.
    Streamed,
}

/// A float that several threads may access at once.
#[repr(transparent)]
pub struct SharedFloat(AtomicU32);

/// `[T]` in memory that kernels access by device address.
pub struct Buffer<T> {
    raw: RawBuffer,
    len: usize,
    element: PhantomData<T>,
}

/// The untyped part of a buffer.
pub(super) struct RawBuffer {
    pub name: String,
    /// Unique in this process, unlike addresses, which are reused.
    pub id: u64,
    pub address: u64,
    pub handle: vk::Buffer,
    /// Whether the buffer was ever written.
    pub written: AtomicBool,
    pub access: Access,
    /// Whether a pass on the host has slices of it.
    pub lent: Arc<AtomicBool>,
    allocation: Option<Allocation>,
    context: Arc<Context>,
}

static NEXT_ID: AtomicU64 = AtomicU64::new(0);

impl<T: Glsl> Buffer<T> {
    /// An uninitialised buffer of `len` elements. The first word of `name` is the owner in the memory report.
    pub fn new(context: &Arc<Context>, name: &str, access: Access, len: usize) -> Result<Self> {
        let raw = RawBuffer::new(context, name, access, (len * size_of::<T>()) as u64)?;
        Ok(Self { raw, len, element: PhantomData })
    }

    pub fn len(&self) -> usize {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The contents, which kernels wrote. Panics for [`Access::Device`].
    pub fn host(&self) -> &[T] {
        let bytes = self.raw.mapped().unwrap_or_else(|| panic!("{} is not host memory", self.raw.name));
        bytemuck::cast_slice(&bytes[..self.len * size_of::<T>()])
    }

    /// The contents, for the host to write before the frame that reads them is recorded. Panics for [`Access::Device`].
    pub fn host_mut(&mut self) -> &mut [T] {
        self.raw.written.store(true, Ordering::Relaxed);
        let bytes = self.len * size_of::<T>();
        let Self { raw, .. } = self;
        let allocation = raw.allocation.as_mut().expect("held until dropped");
        let mapped = if raw.access == Access::Device { None } else { allocation.mapped_slice_mut() };
        bytemuck::cast_slice_mut(&mut mapped.unwrap_or_else(|| panic!("{} is not host memory", raw.name))[..bytes])
    }

    pub(super) fn raw(&self) -> &RawBuffer {
        &self.raw
    }
}

impl SharedFloat {
    pub fn of(floats: &mut [f32]) -> &[Self] {
        // SAFETY: both types have the size and alignment of `u32`, and all their bits are valid. While the slice
        // returned lives, nobody else has access.
        unsafe { std::slice::from_raw_parts(floats.as_mut_ptr().cast(), floats.len()) }
    }

    pub fn get(&self) -> f32 {
        f32::from_bits(self.0.load(Ordering::Relaxed))
    }

    pub fn set(&self, value: f32) {
        self.0.store(value.to_bits(), Ordering::Relaxed);
    }
}

impl RawBuffer {
    fn new(context: &Arc<Context>, name: &str, access: Access, bytes: u64) -> Result<Self> {
        let action = || format!("allocate {bytes} bytes for {name}");
        let create = vk::BufferCreateInfo::default()
            // Vulkan forbids empty buffers, but a scene can lack lights. 16: vec4 reads may pass a ragged end.
            .size(bytes.next_multiple_of(16).max(16))
            .usage(
                vk::BufferUsageFlags::STORAGE_BUFFER
                    | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS
                    | vk::BufferUsageFlags::INDEX_BUFFER
                    | vk::BufferUsageFlags::TRANSFER_SRC
                    | vk::BufferUsageFlags::TRANSFER_DST,
            );
        // SAFETY: the create info is valid; the handle is owned by the struct returned.
        let handle = unsafe { context.device.create_buffer(&create, None) }.map_err(vulkan(action()))?;
        let mut raw = Self {
            name: name.into(),
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            address: 0,
            handle,
            written: AtomicBool::new(false),
            access,
            lent: Arc::default(),
            allocation: None,
            context: context.clone(),
        };
        // SAFETY: the new buffer has no memory yet; `raw` frees both if a step fails.
        unsafe {
            let requirements = context.device.get_buffer_memory_requirements(handle);
            let allocation = allocate(context, name, access, requirements, true)?;
            context.count_memory(owner(name), allocation.size());
            let bound = context.device.bind_buffer_memory(handle, allocation.memory(), allocation.offset());
            raw.allocation = Some(allocation);
            bound.map_err(vulkan(action()))?;
            raw.address =
                context.device.get_buffer_device_address(&vk::BufferDeviceAddressInfo::default().buffer(handle));
        }
        assert!(raw.address.is_multiple_of(16), "{name} is at {:#x}; kernels read 16 bytes at once", raw.address);
        context.name(handle, name);
        Ok(raw)
    }

    /// Memory that the host may read; `None` for [`Access::Device`].
    fn mapped(&self) -> Option<&[u8]> {
        self.allocation.as_ref().filter(|_| self.access != Access::Device)?.mapped_slice()
    }

    /// Start of the memory of a buffer that the host does not access otherwise. Panics for other buffers, and where
    /// device memory is not mapped.
    pub fn mapped_floats(&self) -> NonNull<f32> {
        assert!(self.access == Access::Device, "the host accesses {} by itself", self.name);
        let allocation = self.allocation.as_ref().expect("held until dropped");
        allocation.mapped_ptr().unwrap_or_else(|| panic!("{} is not host memory", self.name)).cast()
    }
}

impl Drop for RawBuffer {
    fn drop(&mut self) {
        // SAFETY: every frame is waited for before its borrow of the buffers ends, so none is in use.
        unsafe { self.context.device.destroy_buffer(self.handle, None) };
        release(&self.context, &self.name, self.allocation.take());
    }
}

/// Owner in the memory report: the first word of an object's name.
pub(super) fn owner(name: &str) -> &str {
    name.split(' ').next().unwrap_or(name)
}

pub(super) fn allocate(
    context: &Context,
    name: &str,
    access: Access,
    requirements: vk::MemoryRequirements,
    linear: bool,
) -> Result<Allocation> {
    let location = match access {
        Access::Device => MemoryLocation::GpuOnly,
        Access::HostWrites => MemoryLocation::CpuToGpu,
        // Not CpuToGpu, which would take a part of the small heap that is both device-local and host-visible.
        Access::HostReads | Access::Streamed => MemoryLocation::GpuToCpu,
    };
    let mut allocator = context.allocator.lock().expect(UNPOISONED);
    let allocator = allocator.as_mut().expect("held until the context drops");
    let size = requirements.size;
    allocator
        .allocate(&AllocationCreateDesc {
            name,
            requirements,
            location,
            linear,
            allocation_scheme: AllocationScheme::GpuAllocatorManaged,
        })
        .map_err(vulkan(format!("allocate {size} bytes for {name}")))
}

pub(super) fn release(context: &Context, name: &str, allocation: Option<Allocation>) {
    let Some(allocation) = allocation else { return };
    context.uncount_memory(owner(name), allocation.size());
    let mut allocator = context.allocator.lock().expect(UNPOISONED);
    let freed = allocator.as_mut().expect("held until the context drops").free(allocation);
    if let Err(error) = freed {
        tracing::error!("cannot free {name}: {error}");
    }
}
