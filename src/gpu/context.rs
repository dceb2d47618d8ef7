//! Vulkan device, queue and allocator, each with one owner and destroyed in the right order.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use ash::vk::Handle;
use ash::{ext, khr, vk};
use gpu_allocator::AllocationSizes;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use raw_window_handle::HasDisplayHandle;

use super::UNPOISONED;
use super::device::{self, DeviceInfo};
use super::instance::{Display, Instance, Validation};
use super::measurements::Measurements;
use super::vulkan_error::vulkan;
use crate::error::{Error, Result};

/// A Vulkan device with its queue and allocator. Every object created from it holds an `Arc` of it.
pub struct Context {
    pub info: DeviceInfo,
    pub measurements: Measurements,
    /// Nanoseconds per timestamp tick.
    pub(super) timestamp_period: f64,
    pub(super) device: ash::Device,
    pub(super) queue: vk::Queue,
    pub(super) queue_family: u32,
    pub(super) debug_utils: Option<ext::debug_utils::Device>,
    pub(super) pipeline_cache: vk::PipelineCache,
    /// Shared by all pipelines: 128 bytes of push constants and one sampled image.
    pub(super) pipeline_layout: vk::PipelineLayout,
    pub(super) set_layout: vk::DescriptorSetLayout,
    /// `None` only during drop.
    pub(super) allocator: Mutex<Option<Allocator>>,
    /// Device memory in use, by the first word of the owner's name.
    memory: Mutex<BTreeMap<String, u64>>,
    pipeline_cache_file: Option<PathBuf>,
    pub(super) instance: Instance,
}

impl Context {
    /// Opens the device that `wanted` names by index or by part of its name; `None`: the best one by its kind,
    /// without a measurement.
    ///
    /// Compiled pipelines and measurements are kept in `cache_dir`.
    pub fn new(wanted: Option<&str>, validation: Validation, cache_dir: Option<&Path>) -> Result<Arc<Self>> {
        Self::create(wanted, validation, cache_dir, None)
    }

    /// Like [`Context::new`], for a device that can draw into windows on `display`.
    pub fn for_display(
        wanted: Option<&str>,
        validation: Validation,
        cache_dir: Option<&Path>,
        display: &dyn HasDisplayHandle,
    ) -> Result<Arc<Self>> {
        Self::create(wanted, validation, cache_dir, Some(display))
    }

    fn create(
        wanted: Option<&str>,
        validation: Validation,
        cache_dir: Option<&Path>,
        display: Display,
    ) -> Result<Arc<Self>> {
        let instance = Instance::new(validation, display)?;
        let info = device::choose(&instance.handle, wanted)?;
        tracing::info!("device: {} ({})", info.name, info.driver);
        warn_of_slow_lavapipe(&info);

        // SAFETY: the handle comes from this instance.
        let (limits, families) = unsafe {
            (
                instance.handle.get_physical_device_properties(info.handle).limits,
                instance.handle.get_physical_device_queue_family_properties(info.handle),
            )
        };
        let both = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
        let queue_family = families.iter().position(|f| f.queue_flags.contains(both)).ok_or_else(|| {
            Error::NoDevice { reason: format!("{} has no queue for graphics and compute", info.name), source: None }
        })? as u32;
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&[1.0])];
        let core = vk::PhysicalDeviceFeatures::default().depth_clamp(true);
        let mut features12 = vk::PhysicalDeviceVulkan12Features::default()
            .buffer_device_address(true)
            .scalar_block_layout(true)
            .host_query_reset(true);
        let mut features13 =
            vk::PhysicalDeviceVulkan13Features::default().synchronization2(true).dynamic_rendering(true);
        let extension_names: Vec<_> = display.iter().map(|_| khr::swapchain::NAME.as_ptr()).collect();
        let create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&extension_names)
            .enabled_features(&core)
            .push_next(&mut features12)
            .push_next(&mut features13);
        // SAFETY: `choose` checked every feature asked for; all pointers outlive the call.
        let device = unsafe { instance.handle.create_device(info.handle, &create, None) }
            .map_err(vulkan("create the device"))?;
        let is_validated = instance.is_validated();
        // Objects that do not exist yet are null handles, which drop ignores.
        let mut context = Self {
            timestamp_period: f64::from(limits.timestamp_period),
            // SAFETY: the queue was asked for above.
            queue: unsafe { device.get_device_queue(queue_family, 0) },
            queue_family,
            debug_utils: is_validated.then(|| ext::debug_utils::Device::new(&instance.handle, &device)),
            pipeline_cache: vk::PipelineCache::null(),
            pipeline_layout: vk::PipelineLayout::null(),
            set_layout: vk::DescriptorSetLayout::null(),
            allocator: Mutex::default(),
            memory: Mutex::default(),
            pipeline_cache_file: cache_dir.map(|dir| dir.join(info.file_name("pipelines", "bin"))),
            measurements: Measurements::of(&info, cache_dir),
            device,
            instance,
            info,
        };
        context.fill()?;
        Ok(Arc::new(context))
    }

    /// Creates the allocator, layouts and pipeline cache.
    fn fill(&mut self) -> Result<()> {
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: self.instance.handle.clone(),
            device: self.device.clone(),
            physical_device: self.info.handle,
            debug_settings: Default::default(),
            buffer_device_address: true,
            allocation_sizes: block_sizes(&self.info),
        })
        .map_err(vulkan("create the allocator"))?;
        self.allocator = Mutex::new(Some(allocator));
        let bindings = [vk::DescriptorSetLayoutBinding::default()
            .binding(0)
            .descriptor_type(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
            .descriptor_count(1)
            .stage_flags(vk::ShaderStageFlags::COMPUTE)];
        let create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        // SAFETY: all pointers outlive the call.
        self.set_layout = unsafe { self.device.create_descriptor_set_layout(&create, None) }
            .map_err(vulkan("create the descriptor set layout"))?;
        let push = [vk::PushConstantRange::default()
            .stage_flags(vk::ShaderStageFlags::COMPUTE | vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT)
            .size(128)];
        let create = vk::PipelineLayoutCreateInfo::default()
            .set_layouts(std::slice::from_ref(&self.set_layout))
            .push_constant_ranges(&push);
        // SAFETY: as above.
        self.pipeline_layout = unsafe { self.device.create_pipeline_layout(&create, None) }
            .map_err(vulkan("create the pipeline layout"))?;
        self.pipeline_cache = create_pipeline_cache(&self.device, self.pipeline_cache_file.as_deref())?;
        Ok(())
    }

    /// Whether kernels run on the CPU.
    pub fn is_cpu(&self) -> bool {
        self.info.is_cpu()
    }

    /// Whether 8 neighbouring threads are always in one subgroup, so that they can share what each of them read.
    pub fn has_wide_subgroups(&self) -> bool {
        self.info.wide_subgroups
    }

    /// Whether the validation layer watches: it may not be installed.
    pub fn is_validated(&self) -> bool {
        self.instance.is_validated()
    }

    /// All messages of the validation layer so far. Tests assert that there are none.
    pub fn validation_messages(&self) -> Vec<String> {
        self.instance.messages()
    }

    /// Device memory in use, as (owner, bytes).
    pub fn memory_by_owner(&self) -> Vec<(String, u64)> {
        self.memory.lock().expect(UNPOISONED).iter().map(|(owner, bytes)| (owner.clone(), *bytes)).collect()
    }

    pub(super) fn count_memory(&self, owner: &str, bytes: u64) {
        *self.memory.lock().expect(UNPOISONED).entry(owner.to_owned()).or_default() += bytes;
    }

    pub(super) fn uncount_memory(&self, owner: &str, bytes: u64) {
        let mut memory = self.memory.lock().expect(UNPOISONED);
        let left = memory.get_mut(owner).expect("it was counted");
        *left -= bytes;
        if *left == 0 {
            memory.remove(owner);
        }
    }

    /// Names an object for validation messages and debuggers.
    pub(super) fn name<T: vk::Handle>(&self, object: T, name: &str) {
        let Some(debug_utils) = &self.debug_utils else { return };
        let name = std::ffi::CString::new(name).expect("names hold no zero byte");
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
        // SAFETY: the object belongs to this device. Failing to set a name is ignored.
        let _ = unsafe { debug_utils.set_debug_utils_object_name(&info) };
    }

    fn save_pipeline_cache(&self) -> Result<()> {
        let Some(file) = self.pipeline_cache_file.as_ref().filter(|_| !self.pipeline_cache.is_null()) else {
            return Ok(());
        };
        // SAFETY: the cache is alive.
        let data = unsafe { self.device.get_pipeline_cache_data(self.pipeline_cache) }
            .map_err(vulkan("read the pipeline cache"))?;
        let unchanged = std::fs::read(file).is_ok_and(|old| old == data);
        if unchanged { Ok(()) } else { crate::storage::file::write_bytes(file, &data) }
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        if let Err(error) = self.save_pipeline_cache() {
            tracing::debug!("pipelines are not cached: {error}"); // the cache folder may be read-only
        }
        for (owner, bytes) in self.memory.lock().expect(UNPOISONED).iter() {
            tracing::error!("leaked: {bytes} bytes of {owner}");
        }
        // SAFETY: every object created from the device holds an Arc of this context, so all are destroyed; every frame
        // was waited for before it was dropped.
        unsafe {
            self.device.destroy_pipeline_cache(self.pipeline_cache, None);
            self.device.destroy_pipeline_layout(self.pipeline_layout, None);
            self.device.destroy_descriptor_set_layout(self.set_layout, None);
            drop(self.allocator.lock().expect(UNPOISONED).take());
            self.device.destroy_device(None);
        }
    }
}

/// Sizes of the blocks that small buffers share: those of the allocator, or less on a device with little memory.
fn block_sizes(info: &DeviceInfo) -> AllocationSizes {
    // The allocator wants multiples of 4 MB.
    let most = (info.memory_bytes / 64).min(info.limits.allocation_bytes) & !((4 << 20) - 1);
    AllocationSizes::new(most.min(256 << 20), most.min(64 << 20))
}

fn warn_of_slow_lavapipe(info: &DeviceInfo) {
    // "llvmpipe Mesa 25.0.7-2 (LLVM 15.0.6)"
    let major = info.driver.split_once("Mesa ").and_then(|(_, v)| v.split('.').next()?.parse::<u32>().ok());
    if info.is_cpu() && major.is_some_and(|major| major < 25) {
        tracing::warn!(
            "{} runs relume 8 to 20 times slower than Mesa 25; tools/setup installs a newer one",
            info.driver
        );
    }
}

fn create_pipeline_cache(device: &ash::Device, file: Option<&Path>) -> Result<vk::PipelineCache> {
    let data = file.and_then(|file| std::fs::read(file).ok()).unwrap_or_default();
    let create = vk::PipelineCacheCreateInfo::default().initial_data(&data);
    // SAFETY: the data outlives the call; drivers check its header and ignore data of other drivers.
    unsafe { device.create_pipeline_cache(&create, None) }.map_err(vulkan("create the pipeline cache"))
}
