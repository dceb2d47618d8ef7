//! Fault injection for tests: `RELUME_FAULT=vkQueueSubmit2:3:device-lost` makes the third and all later calls of
//! vkQueueSubmit2 fail. Our functions replace the driver's in the device's function table. tests/faults.rs sets the
//! variable.
#![allow(non_upper_case_globals, non_snake_case)]

use std::ffi::{CStr, c_char, c_void};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, OnceLock};

use ash::vk;
use ash::vk::{AllocationCallbacks, CommandBuffer, Device, DeviceSize, Fence, Queue, SwapchainKHR};

use super::UNPOISONED;
use crate::error::{Error, Result};

struct Fault {
    call: String,
    /// Number of the first call that fails, from 1.
    first: u32,
    /// Number of calls so far.
    made: AtomicU32,
    result: vk::Result,
}

static FAULT: OnceLock<Fault> = OnceLock::new();
/// Of the last instance: a loader is unloaded with its instance, and the next instance may load it elsewhere.
static DRIVER: Mutex<Option<vk::PFN_vkGetDeviceProcAddr>> = Mutex::new(None);

const RESULTS: [(&str, vk::Result); 3] = [
    ("device-lost", vk::Result::ERROR_DEVICE_LOST),
    ("out-of-device-memory", vk::Result::ERROR_OUT_OF_DEVICE_MEMORY),
    ("out-of-host-memory", vk::Result::ERROR_OUT_OF_HOST_MEMORY),
];

/// If RELUME_FAULT is set, devices created from `instance` use our functions. All devices of the process then call the
/// functions of the first device's driver, so there may be only one.
pub(super) fn install(instance: &mut ash::Instance) -> Result<()> {
    let Some(wanted) = std::env::var_os("RELUME_FAULT") else { return Ok(()) };
    let wanted = wanted.to_string_lossy();
    let fault = parse(&wanted).ok_or_else(|| Error::NoDevice {
        reason: format!("RELUME_FAULT={wanted} is not CALL:FIRST:RESULT, as in vkQueueSubmit2:3:device-lost"),
        source: None,
    })?;
    FAULT.get_or_init(|| fault);
    let mut table = instance.fp_v1_0().clone();
    *DRIVER.lock().expect(UNPOISONED) = Some(table.get_device_proc_addr);
    table.get_device_proc_addr = route;
    let (table_1_1, table_1_3) = (instance.fp_v1_1().clone(), instance.fp_v1_3().clone());
    *instance = ash::Instance::from_parts_1_3(instance.handle(), table, table_1_1, table_1_3);
    Ok(())
}

fn parse(wanted: &str) -> Option<Fault> {
    let parts: Vec<&str> = wanted.split(':').collect();
    let [call, first, result] = parts[..] else { return None };
    let first = first.parse().ok().filter(|&first| first > 0)?;
    let (_, result) = *RESULTS.iter().find(|(name, _)| *name == result)?;
    CALLS.contains(&call).then(|| Fault { call: call.into(), first, made: AtomicU32::new(0), result })
}

/// Result that this call must return without calling the driver, if any.
fn due(call: &str) -> Option<vk::Result> {
    let fault = FAULT.get().filter(|fault| fault.call == call)?;
    (fault.made.fetch_add(1, Ordering::Relaxed) + 1 >= fault.first).then_some(fault.result)
}

type Function = unsafe extern "system" fn();

/// Declares a replacement for each listed Vulkan function, and the function that looks them up.
macro_rules! calls {
    ($($call:ident($($argument:ident: $type:ty),*);)*) => {
        /// Functions that can be made to fail.
        const CALLS: &[&str] = &[$(stringify!($call)),*];

        mod driver {
            use super::*;
            $(pub static $call: OnceLock<unsafe extern "system" fn($($type),*) -> vk::Result> = OnceLock::new();)*
        }

        $(
            unsafe extern "system" fn $call($($argument: $type),*) -> vk::Result {
                let driver = driver::$call.get().expect("routed before it is called");
                // SAFETY: the caller fulfils the driver's requirements.
                due(stringify!($call)).unwrap_or_else(|| unsafe { driver($($argument),*) })
            }
        )*

        /// Replaces vkGetDeviceProcAddr.
        unsafe extern "system" fn route(device: Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
            let find = DRIVER.lock().expect(UNPOISONED).expect("set before the table is");
            // SAFETY: the caller fulfils the driver's requirements.
            let (found, name) = unsafe { (find(device, name)?, CStr::from_ptr(name)) };
            match name.to_str() {
                $(Ok(stringify!($call)) => {
                    type Call = unsafe extern "system" fn($($type),*) -> vk::Result;
                    // SAFETY: the Vulkan function of this name has this signature.
                    driver::$call.get_or_init(|| unsafe { std::mem::transmute::<Function, Call>(found) });
                    // SAFETY: the caller casts it back to the signature of this name.
                    Some(unsafe { std::mem::transmute::<Call, Function>($call) })
                })*
                _ => Some(found),
            }
        }
    };
}

type Allocator = *const AllocationCallbacks<'static>;
type In<T> = *const T;
type Out<T> = *mut T;

calls! {
    vkAllocateMemory(device: Device, info: In<vk::MemoryAllocateInfo<'static>>, a: Allocator, made: Out<vk::DeviceMemory>);
    vkMapMemory(device: Device, memory: vk::DeviceMemory, from: DeviceSize, size: DeviceSize, flags: vk::MemoryMapFlags, made: Out<*mut c_void>);
    vkBindBufferMemory(device: Device, buffer: vk::Buffer, memory: vk::DeviceMemory, offset: DeviceSize);
    vkBindImageMemory(device: Device, image: vk::Image, memory: vk::DeviceMemory, offset: DeviceSize);
    vkCreateBuffer(device: Device, info: In<vk::BufferCreateInfo<'static>>, a: Allocator, made: Out<vk::Buffer>);
    vkCreateImage(device: Device, info: In<vk::ImageCreateInfo<'static>>, a: Allocator, made: Out<vk::Image>);
    vkCreateImageView(device: Device, info: In<vk::ImageViewCreateInfo<'static>>, a: Allocator, made: Out<vk::ImageView>);
    vkCreateSampler(device: Device, info: In<vk::SamplerCreateInfo<'static>>, a: Allocator, made: Out<vk::Sampler>);
    vkCreateShaderModule(device: Device, info: In<vk::ShaderModuleCreateInfo<'static>>, a: Allocator, made: Out<vk::ShaderModule>);
    vkCreatePipelineCache(device: Device, info: In<vk::PipelineCacheCreateInfo<'static>>, a: Allocator, made: Out<vk::PipelineCache>);
    vkGetPipelineCacheData(device: Device, cache: vk::PipelineCache, size: Out<usize>, data: Out<c_void>);
    vkCreateDescriptorSetLayout(device: Device, info: In<vk::DescriptorSetLayoutCreateInfo<'static>>, a: Allocator, made: Out<vk::DescriptorSetLayout>);
    vkCreatePipelineLayout(device: Device, info: In<vk::PipelineLayoutCreateInfo<'static>>, a: Allocator, made: Out<vk::PipelineLayout>);
    vkCreateComputePipelines(device: Device, cache: vk::PipelineCache, count: u32, infos: In<vk::ComputePipelineCreateInfo<'static>>, a: Allocator, made: Out<vk::Pipeline>);
    vkCreateGraphicsPipelines(device: Device, cache: vk::PipelineCache, count: u32, infos: In<vk::GraphicsPipelineCreateInfo<'static>>, a: Allocator, made: Out<vk::Pipeline>);
    vkCreateDescriptorPool(device: Device, info: In<vk::DescriptorPoolCreateInfo<'static>>, a: Allocator, made: Out<vk::DescriptorPool>);
    vkAllocateDescriptorSets(device: Device, info: In<vk::DescriptorSetAllocateInfo<'static>>, made: Out<vk::DescriptorSet>);
    vkCreateCommandPool(device: Device, info: In<vk::CommandPoolCreateInfo<'static>>, a: Allocator, made: Out<vk::CommandPool>);
    vkAllocateCommandBuffers(device: Device, info: In<vk::CommandBufferAllocateInfo<'static>>, made: Out<CommandBuffer>);
    vkResetCommandPool(device: Device, pool: vk::CommandPool, flags: vk::CommandPoolResetFlags);
    vkBeginCommandBuffer(commands: CommandBuffer, info: In<vk::CommandBufferBeginInfo<'static>>);
    vkEndCommandBuffer(commands: CommandBuffer);
    vkCreateFence(device: Device, info: In<vk::FenceCreateInfo<'static>>, a: Allocator, made: Out<Fence>);
    vkResetFences(device: Device, count: u32, fences: In<Fence>);
    vkWaitForFences(device: Device, count: u32, fences: In<Fence>, all: vk::Bool32, nanoseconds: u64);
    vkCreateSemaphore(device: Device, info: In<vk::SemaphoreCreateInfo<'static>>, a: Allocator, made: Out<vk::Semaphore>);
    vkCreateQueryPool(device: Device, info: In<vk::QueryPoolCreateInfo<'static>>, a: Allocator, made: Out<vk::QueryPool>);
    vkGetQueryPoolResults(device: Device, pool: vk::QueryPool, first: u32, count: u32, size: usize, data: Out<c_void>, stride: DeviceSize, flags: vk::QueryResultFlags);
    vkQueueSubmit2(queue: Queue, count: u32, submits: In<vk::SubmitInfo2<'static>>, fence: Fence);
    vkDeviceWaitIdle(device: Device);
    vkCreateSwapchainKHR(device: Device, info: In<vk::SwapchainCreateInfoKHR<'static>>, a: Allocator, made: Out<SwapchainKHR>);
    vkGetSwapchainImagesKHR(device: Device, swapchain: SwapchainKHR, count: Out<u32>, images: Out<vk::Image>);
    vkAcquireNextImageKHR(device: Device, swapchain: SwapchainKHR, nanoseconds: u64, semaphore: vk::Semaphore, fence: Fence, index: Out<u32>);
    vkQueuePresentKHR(queue: Queue, info: In<vk::PresentInfoKHR<'static>>);
}
