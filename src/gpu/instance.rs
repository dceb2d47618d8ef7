//! Vulkan instance, and the messages of the validation layer.

use std::borrow::Cow;
use std::ffi::{CStr, c_char, c_void};
use std::sync::Mutex;

use ash::{ext, vk};
use raw_window_handle::HasDisplayHandle;

use super::vulkan_error::vulkan;
use super::{UNPOISONED, faults, small_device};
use crate::error::{Error, Result};

/// Whether the Khronos validation layer is enabled, with synchronization validation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validation {
    Off,
    On,
}

/// The Vulkan instance, and the validation layer's messages.
pub(super) struct Instance {
    messages: Box<Messages>,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    pub handle: ash::Instance,
    pub entry: ash::Entry,
}

/// Messages of the validation layer.
#[derive(Default)]
struct Messages(Mutex<Vec<String>>);

/// Display on which windows will be opened, if any.
pub(super) type Display<'a> = Option<&'a dyn HasDisplayHandle>;

impl Instance {
    pub fn new(validation: Validation, display: Display) -> Result<Self> {
        let (entry, handle, validate) = create_instance(validation, display)?;
        let mut instance = Self { messages: Box::default(), messenger: None, handle, entry };
        if validate {
            instance.messenger = Some(create_messenger(&instance.entry, &instance.handle, &instance.messages)?);
        }
        faults::install(&mut instance.handle)?;
        small_device::install(&mut instance.handle)?;
        Ok(instance)
    }

    pub fn is_validated(&self) -> bool {
        self.messenger.is_some()
    }

    /// All messages of the validation layer so far.
    pub fn messages(&self) -> Vec<String> {
        self.messages.0.lock().expect(UNPOISONED).clone()
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // SAFETY: everything created from the instance is dropped before it.
        unsafe {
            if let Some((loader, messenger)) = self.messenger.take() {
                loader.destroy_debug_utils_messenger(messenger, None);
            }
            self.handle.destroy_instance(None);
        }
    }
}

fn create_instance(validation: Validation, display: Display) -> Result<(ash::Entry, ash::Instance, bool)> {
    let no_device = |reason: &str| {
        let reason = reason.to_owned();
        |source: Box<dyn std::error::Error + Send + Sync>| Error::NoDevice { reason, source: Some(source) }
    };
    // SAFETY: loads the system's Vulkan loader, which is trusted to behave.
    let entry = unsafe { ash::Entry::load() }
        .map_err(|e| no_device("no Vulkan loader was found; tools/setup installs one")(e.into()))?;
    // SAFETY: the entry is loaded.
    let layers = unsafe { entry.enumerate_instance_layer_properties() }.map_err(vulkan("list layers"))?;
    let layer = c"VK_LAYER_KHRONOS_validation";
    let validate = validation == Validation::On && layers.iter().any(|l| l.layer_name_as_c_str() == Ok(layer));
    if validation == Validation::On && !validate {
        tracing::warn!("the Vulkan validation layer is not installed: validation is off");
    }
    let application = vk::ApplicationInfo::default().application_name(c"relume").api_version(vk::API_VERSION_1_3);
    let layer_names = [layer.as_ptr()];
    let mut extension_names = surface_extensions(display)?;
    if validate {
        extension_names.push(ext::debug_utils::NAME.as_ptr());
    }
    let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
    let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
    let mut create =
        vk::InstanceCreateInfo::default().application_info(&application).enabled_extension_names(&extension_names);
    if validate {
        create = create.enabled_layer_names(&layer_names).push_next(&mut features);
    }
    // SAFETY: all pointers outlive the call.
    let instance = unsafe { entry.create_instance(&create, None) }
        .map_err(|e| no_device("the Vulkan instance cannot be created; tools/setup installs a driver")(e.into()))?;
    Ok((entry, instance, validate))
}

/// Instance extensions for windows on `display`.
fn surface_extensions(display: Display) -> Result<Vec<*const c_char>> {
    let Some(display) = display else { return Ok(Vec::new()) };
    let no_window = |source: crate::error::Cause| Error::NoDevice {
        reason: "this display does not support Vulkan windows".into(),
        source: Some(source),
    };
    let handle = display.display_handle().map_err(|e| no_window(e.into()))?;
    let names = ash_window::enumerate_required_extensions(handle.as_raw()).map_err(|e| no_window(e.into()))?;
    Ok(names.to_vec())
}

fn create_messenger(
    entry: &ash::Entry,
    instance: &ash::Instance,
    messages: &Messages,
) -> Result<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)> {
    use vk::{DebugUtilsMessageSeverityFlagsEXT as Severity, DebugUtilsMessageTypeFlagsEXT as Type};
    let loader = ext::debug_utils::Instance::new(entry, instance);
    let create = vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(Severity::ERROR | Severity::WARNING)
        .message_type(Type::GENERAL | Type::VALIDATION | Type::PERFORMANCE)
        .pfn_user_callback(Some(on_message))
        .user_data(std::ptr::from_ref(messages).cast_mut().cast());
    // SAFETY: `messages` is boxed and outlives the messenger.
    let messenger =
        unsafe { loader.create_debug_utils_messenger(&create, None) }.map_err(vulkan("create the debug messenger"))?;
    Ok((loader, messenger))
}

unsafe extern "system" fn on_message(
    severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _type: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    messages: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes a valid struct; `messages` is the pointer that `create_messenger` passed.
    let (text, messages) = unsafe {
        let pointer: *const c_char = (*data).p_message;
        let text = if pointer.is_null() { Cow::Borrowed("") } else { CStr::from_ptr(pointer).to_string_lossy() };
        (text, &*messages.cast::<Messages>())
    };
    tracing::error!("Vulkan validation, {severity:?}: {text}");
    if let Ok(mut messages) = messages.0.lock() {
        messages.push(text.into_owned());
    }
    vk::FALSE
}
