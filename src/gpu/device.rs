//! Lists Vulkan devices and the required features that each lacks, and finds one by name or kind.

use std::ffi::CStr;

use ash::vk;

use super::instance::{Instance, Validation};
use super::limits::Limits;
use super::vulkan_error::vulkan;
use crate::error::{Error, Result};
use crate::shared::PANEL_COLUMNS;

/// One line of `relume devices`.
#[derive(Clone, Debug, serde::Serialize)]
pub struct DeviceInfo {
    /// Position in Vulkan's order.
    pub index: usize,
    pub name: String,
    pub driver: String,
    /// discrete, integrated, virtual, cpu or other.
    pub kind: &'static str,
    /// Vulkan version.
    pub api: String,
    /// Size of the largest device-local heap.
    pub memory_bytes: u64,
    pub limits: Limits,
    /// Required features that the device lacks; empty if it can be used.
    pub lacks: Vec<String>,
    /// Whether a subgroup never has fewer than 8 threads, and any of them can tell all others a value.
    #[serde(skip)]
    pub(super) wide_subgroups: bool,
    #[serde(skip)]
    pub(super) handle: vk::PhysicalDevice,
}

/// What may help where a required feature is missing.
const ADVICE: &str = "a newer graphics driver may have it (NVIDIA 510, Mesa 22.1, AMD or Intel of 2022, or later); tools/setup installs a driver that uses the CPU instead";

impl DeviceInfo {
    /// Whether kernels run on the CPU.
    pub fn is_cpu(&self) -> bool {
        self.kind == "cpu"
    }

    /// Device memory for buffers and images, bytes: three quarters; the rest is for the driver, for other programs, and
    /// for gaps between allocations.
    pub fn usable_bytes(&self) -> u64 {
        self.memory_bytes / 4 * 3
    }

    /// What the device lacks, and what may help; `None` if it can be used.
    pub fn shortcoming(&self) -> Option<String> {
        (!self.lacks.is_empty()).then(|| format!("lacks {}; {ADVICE}", self.lacks.join(", ")))
    }

    /// Name of a file in the cache folder that belongs to this device and this version of its driver.
    pub(super) fn file_name(&self, what: &str, extension: &str) -> String {
        let key = blake3::hash(format!("{} {} {}", self.name, self.driver, self.api).as_bytes());
        format!("{what}-{}.{extension}", &key.to_hex()[..16])
    }
}

/// The device that `wanted` names by index or by part of its name; `None`: the best one.
pub fn find_device(wanted: Option<&str>) -> Result<DeviceInfo> {
    choose(&Instance::new(Validation::Off, None)?.handle, wanted)
}

/// All devices, in Vulkan's order.
pub fn list_devices() -> Result<Vec<DeviceInfo>> {
    enumerate(&Instance::new(Validation::Off, None)?.handle)
}

/// Finds the device that `wanted` names by index or by part of its name; `None`: the best GPU, or a CPU if there is no
/// GPU.
pub(super) fn choose(instance: &ash::Instance, wanted: Option<&str>) -> Result<DeviceInfo> {
    let devices = enumerate(instance)?;
    let no_device = |reason: String| Error::NoDevice { reason, source: None };
    if let Some(wanted) = wanted {
        let matches = |d: &&DeviceInfo| match wanted.parse::<usize>() {
            Ok(index) => d.index == index,
            Err(_) => d.name.to_lowercase().contains(&wanted.to_lowercase()),
        };
        let found = devices.iter().find(matches).ok_or_else(|| {
            let names: Vec<_> = devices.iter().map(|d| format!("{} {}", d.index, d.name)).collect();
            no_device(format!("none is called {wanted:?}; there are: {}", names.join(", ")))
        })?;
        return match found.shortcoming() {
            None => Ok(found.clone()),
            Some(shortcoming) => Err(no_device(format!("{} {shortcoming}", found.name))),
        };
    }
    let rank =
        |d: &&DeviceInfo| ["discrete", "integrated", "virtual", "cpu", "other"].iter().position(|k| *k == d.kind);
    devices.iter().filter(|d| d.lacks.is_empty()).min_by_key(rank).cloned().ok_or_else(|| {
        no_device(match devices.is_empty() {
            true => "no Vulkan driver is installed; install Mesa's lavapipe (tools/setup) or a GPU driver".into(),
            false => {
                let each: Vec<_> = devices.iter().map(|d| format!("{} lacks {}", d.name, d.lacks.join(", "))).collect();
                format!("{}; {ADVICE}", each.join("; "))
            }
        })
    })
}

fn enumerate(instance: &ash::Instance) -> Result<Vec<DeviceInfo>> {
    // SAFETY: the instance is alive.
    let handles = unsafe { instance.enumerate_physical_devices() }.map_err(vulkan("list devices"))?;
    Ok(handles.into_iter().enumerate().map(|(index, handle)| describe(instance, index, handle)).collect())
}

fn describe(instance: &ash::Instance, index: usize, handle: vk::PhysicalDevice) -> DeviceInfo {
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut subgroups = vk::PhysicalDeviceSubgroupProperties::default();
    let mut maintenance3 = vk::PhysicalDeviceMaintenance3Properties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default()
        .push_next(&mut driver)
        .push_next(&mut subgroups)
        .push_next(&mut maintenance3);
    let mut features12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut features13 = vk::PhysicalDeviceVulkan13Features::default();
    // SAFETY: the handle comes from this instance, and the calls fill the chained structs.
    unsafe { instance.get_physical_device_properties2(handle, &mut properties) };
    let properties = properties.properties;
    let api = properties.api_version;
    let has_13 = api >= vk::API_VERSION_1_3;
    let mut properties13 = vk::PhysicalDeviceVulkan13Properties::default();
    if has_13 {
        let mut more = vk::PhysicalDeviceProperties2::default().push_next(&mut properties13);
        // SAFETY: as above; the struct of 1.3 is chained only where 1.3 is.
        unsafe { instance.get_physical_device_properties2(handle, &mut more) };
    }
    let mut features = vk::PhysicalDeviceFeatures2::default();
    if has_13 {
        features = features.push_next(&mut features12).push_next(&mut features13);
    }
    // SAFETY: as above; 1.3 structs are only chained if the device supports 1.3.
    let memory = unsafe {
        instance.get_physical_device_features2(handle, &mut features);
        instance.get_physical_device_memory_properties(handle)
    };
    let core = features.features;
    let has_ballots = subgroups.supported_operations.contains(vk::SubgroupFeatureFlags::BALLOT)
        && subgroups.supported_stages.contains(vk::ShaderStageFlags::COMPUTE);
    let needs = [
        ("Vulkan 1.3", has_13),
        ("bufferDeviceAddress", features12.buffer_device_address == vk::TRUE),
        ("scalarBlockLayout", features12.scalar_block_layout == vk::TRUE),
        ("hostQueryReset", features12.host_query_reset == vk::TRUE),
        ("synchronization2", features13.synchronization2 == vk::TRUE),
        ("dynamicRendering", features13.dynamic_rendering == vk::TRUE),
        ("depthClamp", core.depth_clamp == vk::TRUE),
        ("subgroups with ballots", has_ballots),
        ("timestamps", properties.limits.timestamp_compute_and_graphics == vk::TRUE),
    ];
    let text = |bytes: Option<&CStr>| bytes.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let heaps = &memory.memory_heaps[..memory.memory_heap_count as usize];
    DeviceInfo {
        index,
        name: text(properties.device_name_as_c_str().ok()),
        driver: format!("{} {}", text(driver.driver_name_as_c_str().ok()), text(driver.driver_info_as_c_str().ok())),
        kind: match properties.device_type {
            vk::PhysicalDeviceType::DISCRETE_GPU => "discrete",
            vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated",
            vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual",
            vk::PhysicalDeviceType::CPU => "cpu",
            _ => "other",
        },
        api: format!("{}.{}.{}", vk::api_version_major(api), vk::api_version_minor(api), vk::api_version_patch(api)),
        memory_bytes: heaps
            .iter()
            .filter(|h| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL))
            .map(|h| h.size)
            .max()
            .unwrap_or(0),
        limits: Limits::new(&properties.limits, &maintenance3, &properties13),
        wide_subgroups: has_ballots && properties13.min_subgroup_size >= PANEL_COLUMNS,
        lacks: needs.iter().filter(|(_, has)| !has).map(|(what, _)| what.to_string()).collect(),
        handle,
    }
}
