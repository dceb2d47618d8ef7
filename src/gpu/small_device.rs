//! A smaller device for tests: `RELUME_LIMITS=buffer:1000000,heap:50000000` lowers the limits that the device reports,
//! and calls that exceed them fail as those of such a device would. tests/limits.rs sets the variable.
//!
//! `buffer` and `allocation` are the largest ones, in bytes; `image` is the largest side, in pixels. `heap` gives the
//! device so many bytes of memory of its own beside the host's. This works with drivers that use the CPU, which have a
//! single type of memory: type 0 of the smaller device is the host's memory, type 1 the device's.
#![allow(non_snake_case)]

use std::collections::HashMap;
use std::ffi::{CStr, c_char};
use std::sync::Mutex;

use ash::vk;
use ash::vk::{AllocationCallbacks, Device, DeviceMemory};

use super::UNPOISONED;
use crate::error::{Error, Result};

#[derive(Clone, Copy)]
struct Small {
    buffer: u64,
    allocation: u64,
    image: u64,
    heap: Option<u64>,
}

/// Functions of the driver.
#[derive(Clone, Copy)]
struct Driver {
    get_device_proc_addr: vk::PFN_vkGetDeviceProcAddr,
    properties: vk::PFN_vkGetPhysicalDeviceProperties2,
    memory_properties: vk::PFN_vkGetPhysicalDeviceMemoryProperties,
}

/// Of the last instance: a driver is unloaded with its instance, and the next instance may load it elsewhere.
static SMALL: Mutex<Option<(Small, Driver)>> = Mutex::new(None);
/// The driver's functions of a device of this instance, found when the device is created.
static DEVICE: Mutex<Option<ash::DeviceFnV1_0>> = Mutex::new(None);
/// Bytes of each allocation on the device's heap.
static HELD: Mutex<Option<HashMap<DeviceMemory, u64>>> = Mutex::new(None);

/// If RELUME_LIMITS is set, `instance` and the devices created from it use our functions. Earlier instances, and
/// devices of another driver, may not be used any more.
pub(super) fn install(instance: &mut ash::Instance) -> Result<()> {
    let Some(wanted) = std::env::var_os("RELUME_LIMITS") else { return Ok(()) };
    let wanted = wanted.to_string_lossy();
    let small = parse(&wanted).ok_or_else(|| Error::NoDevice {
        reason: format!("RELUME_LIMITS={wanted} is not LIMIT:NUMBER,..., with buffer, allocation, image or heap"),
        source: None,
    })?;
    let (mut table, mut table_1_1) = (instance.fp_v1_0().clone(), instance.fp_v1_1().clone());
    let driver = Driver {
        get_device_proc_addr: table.get_device_proc_addr,
        properties: table_1_1.get_physical_device_properties2,
        memory_properties: table.get_physical_device_memory_properties,
    };
    *SMALL.lock().expect(UNPOISONED) = Some((small, driver));
    *DEVICE.lock().expect(UNPOISONED) = None;
    table.get_device_proc_addr = route;
    table_1_1.get_physical_device_properties2 = properties;
    if small.heap.is_some() {
        table.get_physical_device_memory_properties = memory_properties;
    }
    *instance = ash::Instance::from_parts_1_3(instance.handle(), table, table_1_1, instance.fp_v1_3().clone());
    Ok(())
}

fn parse(wanted: &str) -> Option<Small> {
    let mut small = Small { buffer: u64::MAX, allocation: u64::MAX, image: u64::MAX, heap: None };
    for part in wanted.split(',') {
        let (limit, number) = part.split_once(':')?;
        let number = number.parse().ok()?;
        match limit {
            "buffer" => small.buffer = number,
            "allocation" => small.allocation = number,
            "image" => small.image = number,
            "heap" => small.heap = Some(number),
            _ => return None,
        }
    }
    Some(small)
}

fn small() -> (Small, Driver) {
    SMALL.lock().expect(UNPOISONED).expect("set before functions are replaced")
}

fn device() -> ash::DeviceFnV1_0 {
    DEVICE.lock().expect(UNPOISONED).clone().expect("found before functions of the device are called")
}

unsafe extern "system" fn properties(handle: vk::PhysicalDevice, to: *mut vk::PhysicalDeviceProperties2) {
    let (small, driver) = small();
    // SAFETY: the caller passes a valid chain of structs, which the driver fills and which nothing else uses meanwhile.
    unsafe {
        (driver.properties)(handle, to);
        let limits = &mut (*to).properties.limits;
        limits.max_image_dimension2_d = small.image.min(limits.max_image_dimension2_d.into()) as u32;
        let mut next = (*to).p_next.cast::<vk::BaseOutStructure>();
        while !next.is_null() {
            match (*next).s_type {
                vk::StructureType::PHYSICAL_DEVICE_MAINTENANCE_3_PROPERTIES => {
                    let of = &mut *next.cast::<vk::PhysicalDeviceMaintenance3Properties>();
                    of.max_memory_allocation_size = small.allocation.min(of.max_memory_allocation_size);
                }
                vk::StructureType::PHYSICAL_DEVICE_VULKAN_1_3_PROPERTIES => {
                    let of = &mut *next.cast::<vk::PhysicalDeviceVulkan13Properties>();
                    of.max_buffer_size = small.buffer.min(of.max_buffer_size);
                }
                _ => (),
            }
            next = (*next).p_next;
        }
    }
}

unsafe extern "system" fn memory_properties(handle: vk::PhysicalDevice, to: *mut vk::PhysicalDeviceMemoryProperties) {
    let (small, driver) = small();
    // SAFETY: as above.
    let memory = unsafe {
        (driver.memory_properties)(handle, to);
        &mut *to
    };
    let host = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
    memory.memory_type_count = 2;
    memory.memory_types[0].property_flags = host | vk::MemoryPropertyFlags::HOST_CACHED;
    memory.memory_types[1] =
        vk::MemoryType { property_flags: host | vk::MemoryPropertyFlags::DEVICE_LOCAL, heap_index: 1 };
    memory.memory_heap_count = 2;
    memory.memory_heaps[0].flags = vk::MemoryHeapFlags::empty();
    let size = small.heap.expect("replaced only then");
    memory.memory_heaps[1] = vk::MemoryHeap { size, flags: vk::MemoryHeapFlags::DEVICE_LOCAL };
}

type Function = unsafe extern "system" fn();

/// Replaces vkGetDeviceProcAddr.
unsafe extern "system" fn route(handle: Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
    let (small, driver) = small();
    let find = driver.get_device_proc_addr;
    // SAFETY: the caller fulfils the driver's requirements, and casts functions back to the signatures of their names.
    unsafe {
        DEVICE.lock().expect(UNPOISONED).get_or_insert_with(|| {
            ash::DeviceFnV1_0::load(|name| {
                find(handle, name.as_ptr()).map_or(std::ptr::null(), |found| found as *const _)
            })
        });
        let found = find(handle, name)?;
        let has_heap = small.heap.is_some();
        Some(match CStr::from_ptr(name).to_bytes() {
            b"vkCreateBuffer" => std::mem::transmute::<vk::PFN_vkCreateBuffer, Function>(create_buffer),
            b"vkCreateImage" => std::mem::transmute::<vk::PFN_vkCreateImage, Function>(create_image),
            b"vkAllocateMemory" => std::mem::transmute::<vk::PFN_vkAllocateMemory, Function>(allocate_memory),
            b"vkFreeMemory" => std::mem::transmute::<vk::PFN_vkFreeMemory, Function>(free_memory),
            b"vkGetBufferMemoryRequirements" if has_heap => {
                std::mem::transmute::<vk::PFN_vkGetBufferMemoryRequirements, Function>(buffer_requirements)
            }
            b"vkGetImageMemoryRequirements" if has_heap => {
                std::mem::transmute::<vk::PFN_vkGetImageMemoryRequirements, Function>(image_requirements)
            }
            _ => found,
        })
    }
}

unsafe extern "system" fn create_buffer(
    handle: Device,
    info: *const vk::BufferCreateInfo<'_>,
    allocator: *const AllocationCallbacks<'_>,
    made: *mut vk::Buffer,
) -> vk::Result {
    // SAFETY: the caller fulfils the driver's requirements; so below.
    unsafe {
        match (*info).size > small().0.buffer {
            true => vk::Result::ERROR_OUT_OF_DEVICE_MEMORY,
            false => (device().create_buffer)(handle, info, allocator, made),
        }
    }
}

unsafe extern "system" fn create_image(
    handle: Device,
    info: *const vk::ImageCreateInfo<'_>,
    allocator: *const AllocationCallbacks<'_>,
    made: *mut vk::Image,
) -> vk::Result {
    // SAFETY: as above.
    unsafe {
        match u64::from((*info).extent.width.max((*info).extent.height)) > small().0.image {
            true => vk::Result::ERROR_OUT_OF_DEVICE_MEMORY,
            false => (device().create_image)(handle, info, allocator, made),
        }
    }
}

unsafe extern "system" fn allocate_memory(
    handle: Device,
    info: *const vk::MemoryAllocateInfo<'_>,
    allocator: *const AllocationCallbacks<'_>,
    made: *mut DeviceMemory,
) -> vk::Result {
    let small = small().0;
    let mut held = HELD.lock().expect(UNPOISONED);
    let held = held.get_or_insert_default();
    // SAFETY: as above.
    unsafe {
        let (bytes, is_host) = ((*info).allocation_size, (*info).memory_type_index == 0);
        let free = small.heap.filter(|_| !is_host).map_or(u64::MAX, |heap| heap - held.values().sum::<u64>());
        if bytes > small.allocation.min(free) {
            return vk::Result::ERROR_OUT_OF_DEVICE_MEMORY;
        }
        let result = (device().allocate_memory)(handle, &(*info).memory_type_index(0), allocator, made);
        if result == vk::Result::SUCCESS && !is_host {
            held.insert(*made, bytes);
        }
        result
    }
}

unsafe extern "system" fn free_memory(handle: Device, memory: DeviceMemory, allocator: *const AllocationCallbacks<'_>) {
    HELD.lock().expect(UNPOISONED).get_or_insert_default().remove(&memory);
    // SAFETY: as above.
    unsafe { (device().free_memory)(handle, memory, allocator) };
}

unsafe extern "system" fn buffer_requirements(handle: Device, buffer: vk::Buffer, to: *mut vk::MemoryRequirements) {
    // SAFETY: as above.
    unsafe {
        (device().get_buffer_memory_requirements)(handle, buffer, to);
        (*to).memory_type_bits = 0b11;
    }
}

unsafe extern "system" fn image_requirements(handle: Device, image: vk::Image, to: *mut vk::MemoryRequirements) {
    // SAFETY: as above.
    unsafe {
        (device().get_image_memory_requirements)(handle, image, to);
        (*to).memory_type_bits = 0b11;
    }
}
