//! Surface and swapchain of a window.

use std::sync::Arc;

use ash::{khr, vk};
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};

use super::context::Context;
use super::kernel::Kernel;
use super::memory::Buffer;
use super::vulkan_error::vulkan;
use crate::error::{Error, Result};
use crate::shared::FitPush;

/// Requirements of a surface on a window.
pub trait Window: HasWindowHandle + HasDisplayHandle {}
impl<W: HasWindowHandle + HasDisplayHandle> Window for W {}

/// Whether presenting waits for the display.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vsync {
    /// No tearing: mailbox if the driver supports it, else FIFO.
    On,
    /// Without waiting; may tear.
    Off,
}

/// A window's surface with its swapchain.
pub struct Surface {
    surface: vk::SurfaceKHR,
    swapchain: vk::SwapchainKHR,
    pub(super) format: vk::Format,
    color_space: vk::ColorSpaceKHR,
    vsync: Vsync,
    /// Size of the window, physical pixels; the swapchain is resized before the next frame.
    wanted: [u32; 2],
    pub(super) extent: vk::Extent2D,
    pub(super) targets: Vec<Target>,
    pub(super) acquired: vk::Semaphore,
    /// Kernels that enlarge and shrink pictures, created on first use; `fitted` are their targets.
    pub(super) fit: [Option<Kernel<FitPush>>; 2],
    pub(super) fitted: [Option<Buffer<u32>>; 2],
    surfaces: khr::surface::Instance,
    swapchains: khr::swapchain::Device,
    context: Arc<Context>,
    _window: Arc<dyn Window>,
}

/// One image of the swapchain.
pub(super) struct Target {
    pub image: vk::Image,
    pub view: vk::ImageView,
    /// Signalled when the image is drawn. One per image, since only the next acquisition of the image shows that
    /// presentation has waited for the semaphore.
    pub rendered: vk::Semaphore,
}

/// A window's image that a frame draws into.
#[derive(Clone, Copy)]
pub(super) struct Presenting {
    pub index: u32,
    /// Signalled when the image can be drawn into; the frame waits for it before its first transfer.
    pub acquired: vk::Semaphore,
    /// The frame signals it.
    pub rendered: vk::Semaphore,
}

impl Surface {
    /// Creates the surface of `window`, of `wanted` physical pixels. `context` must be created for its display.
    pub fn new(context: &Arc<Context>, window: Arc<dyn Window>, wanted: [u32; 2], vsync: Vsync) -> Result<Self> {
        let unusable = |reason: &str| Error::invalid("the window", reason);
        let display = window.display_handle().map_err(|e| unusable(&e.to_string()))?.as_raw();
        let handle = window.window_handle().map_err(|e| unusable(&e.to_string()))?.as_raw();
        let surfaces = khr::surface::Instance::new(&context.instance.entry, &context.instance.handle);
        // SAFETY: both handles are alive, since the surface owns a reference to the window.
        let surface = unsafe {
            ash_window::create_surface(&context.instance.entry, &context.instance.handle, display, handle, None)
        }
        .map_err(vulkan("create the window's surface"))?;
        let mut this = Self {
            surface,
            swapchain: vk::SwapchainKHR::null(),
            format: vk::Format::UNDEFINED,
            color_space: vk::ColorSpaceKHR::SRGB_NONLINEAR,
            vsync,
            wanted,
            extent: vk::Extent2D::default(),
            targets: Vec::new(),
            acquired: vk::Semaphore::null(),
            fit: [None, None],
            fitted: [None, None],
            surfaces,
            swapchains: khr::swapchain::Device::new(&context.instance.handle, &context.device),
            context: context.clone(),
            _window: window,
        };
        // SAFETY: the surface and the device belong to this instance. If a step fails, `drop` destroys
        // the objects created so far.
        unsafe {
            let device = context.info.handle;
            let presents = this.surfaces.get_physical_device_surface_support(device, context.queue_family, surface);
            if !presents.map_err(vulkan("query whether the device supports the window"))? {
                return Err(unusable(&format!("{} cannot draw into it; try another --device", context.info.name)));
            }
            let formats = this.surfaces.get_physical_device_surface_formats(device, surface);
            let formats = formats.map_err(vulkan("list the window's formats"))?;
            this.format = choose_format(&formats).ok_or_else(|| unusable("it supports no 8-bit sRGB format"))?;
            this.acquired =
                context.device.create_semaphore(&Default::default(), None).map_err(vulkan("create a semaphore"))?;
        }
        context.name(this.acquired, "window image acquired");
        Ok(this)
    }

    /// Records the new size of the window, physical pixels.
    pub fn resize(&mut self, size: [u32; 2]) {
        self.wanted = size;
    }

    /// Whether the last picture was lost because the window changed, so that it must be drawn again.
    pub fn lost_picture(&self) -> bool {
        self.extent == vk::Extent2D::default()
    }

    /// Whether pixels have blue in the lowest byte, instead of red.
    pub fn wants_blue_first(&self) -> bool {
        matches!(self.format, vk::Format::B8G8R8A8_UNORM | vk::Format::B8G8R8A8_SRGB)
    }

    /// Whether the surface applies the sRGB encoding to drawn colours.
    pub(super) fn is_srgb(&self) -> bool {
        matches!(self.format, vk::Format::B8G8R8A8_SRGB | vk::Format::R8G8B8A8_SRGB)
    }

    /// Recreates the swapchain with the window's current size; returns `false` if the window has zero size.
    fn rebuild(&mut self) -> Result<bool> {
        let device = &self.context.device;
        // SAFETY: the surface is alive; every frame was waited for, and device_wait_idle waits for presentation.
        let (capabilities, modes) = unsafe {
            device.device_wait_idle().map_err(vulkan("wait for the device"))?;
            let physical = self.context.info.handle;
            (
                self.surfaces.get_physical_device_surface_capabilities(physical, self.surface),
                self.surfaces.get_physical_device_surface_present_modes(physical, self.surface),
            )
        };
        let capabilities = capabilities.map_err(vulkan("query the window's capabilities"))?;
        let modes = modes.map_err(vulkan("list the window's present modes"))?;
        let (lo, hi) = (capabilities.min_image_extent, capabilities.max_image_extent);
        let extent = match capabilities.current_extent {
            // The swapchain determines the size of the surface.
            vk::Extent2D { width: u32::MAX, .. } => vk::Extent2D {
                width: self.wanted[0].clamp(lo.width, hi.width),
                height: self.wanted[1].clamp(lo.height, hi.height),
            },
            current => current,
        };
        if extent.width == 0 || extent.height == 0 {
            return Ok(false);
        }
        let most = if capabilities.max_image_count == 0 { u32::MAX } else { capabilities.max_image_count };
        let alpha = match capabilities.supported_composite_alpha {
            flags if flags.contains(vk::CompositeAlphaFlagsKHR::OPAQUE) => vk::CompositeAlphaFlagsKHR::OPAQUE,
            _ => vk::CompositeAlphaFlagsKHR::INHERIT,
        };
        let old = self.swapchain;
        let create = vk::SwapchainCreateInfoKHR::default()
            .surface(self.surface)
            .min_image_count((capabilities.min_image_count + 1).min(most))
            .image_format(self.format)
            .image_color_space(self.color_space)
            .image_extent(extent)
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST | vk::ImageUsageFlags::COLOR_ATTACHMENT)
            .pre_transform(capabilities.current_transform)
            .composite_alpha(alpha)
            .present_mode(choose_mode(&modes, self.vsync))
            .clipped(true)
            .old_swapchain(old);
        // SAFETY: nothing is in flight, see above.
        unsafe {
            self.swapchain = self.swapchains.create_swapchain(&create, None).map_err(vulkan("create a swapchain"))?;
            self.release_targets();
            self.swapchains.destroy_swapchain(old, None);
        }
        self.make_targets()?;
        self.extent = extent;
        self.wanted = [extent.width, extent.height];
        Ok(true)
    }

    fn make_targets(&mut self) -> Result<()> {
        let device = &self.context.device;
        // SAFETY: the swapchain is alive; if a step fails, `release_targets` destroys the objects
        // created so far.
        unsafe {
            let images = self.swapchains.get_swapchain_images(self.swapchain).map_err(vulkan("list window images"))?;
            for image in images {
                let rendered =
                    device.create_semaphore(&Default::default(), None).map_err(vulkan("create a semaphore"))?;
                self.targets.push(Target { image, view: vk::ImageView::null(), rendered });
                let create = vk::ImageViewCreateInfo::default()
                    .image(image)
                    .view_type(vk::ImageViewType::TYPE_2D)
                    .format(self.format)
                    .subresource_range(COLOR);
                let view = device.create_image_view(&create, None).map_err(vulkan("create a window image's view"))?;
                self.targets.last_mut().expect("pushed above").view = view;
                self.context.name(view, "window image");
                self.context.name(rendered, "window image rendered");
            }
        }
        Ok(())
    }

    fn release_targets(&mut self) {
        for target in self.targets.drain(..) {
            // SAFETY: the device is idle whenever this is called.
            unsafe {
                self.context.device.destroy_image_view(target.view, None);
                self.context.device.destroy_semaphore(target.rendered, None);
            }
        }
    }

    /// Acquires the next image to draw into; `None` while the window has zero size.
    pub(super) fn acquire(&mut self) -> Result<Option<u32>> {
        // While a window is resized, its swapchain may become out of date at any time; retry a few times.
        for _ in 0..8 {
            let fits = self.wanted == [self.extent.width, self.extent.height];
            if (self.swapchain == vk::SwapchainKHR::null() || !fits) && !self.rebuild()? {
                return Ok(None);
            }
            // SAFETY: the semaphore is unsignalled: the last frame that waited for it is finished.
            let next = unsafe {
                self.swapchains.acquire_next_image(self.swapchain, u64::MAX, self.acquired, vk::Fence::null())
            };
            match next {
                Ok((index, _suboptimal)) => return Ok(Some(index)),
                Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => self.extent = vk::Extent2D::default(),
                Err(error) => return Err(vulkan("acquire a window image")(error)),
            }
        }
        Ok(None)
    }

    /// Queues the image for display, after the work that signals its semaphore.
    pub(super) fn present(&mut self, presenting: &Presenting) -> Result<()> {
        let (swapchains, indices) = ([self.swapchain], [presenting.index]);
        let rendered = [presenting.rendered];
        let info =
            vk::PresentInfoKHR::default().wait_semaphores(&rendered).swapchains(&swapchains).image_indices(&indices);
        // SAFETY: the image was acquired, and its frame submitted.
        match unsafe { self.swapchains.queue_present(self.context.queue, &info) } {
            Ok(_suboptimal) => {} // the window reports changes of its size
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => self.extent = vk::Extent2D::default(), // the next frame rebuilds
            Err(error) => return Err(vulkan("show a picture")(error)),
        }
        Ok(())
    }
}

impl Drop for Surface {
    fn drop(&mut self) {
        // SAFETY: device_wait_idle waits for presentation; null handles are ignored.
        unsafe {
            let _ = self.context.device.device_wait_idle();
            self.release_targets();
            self.context.device.destroy_semaphore(self.acquired, None);
            self.swapchains.destroy_swapchain(self.swapchain, None);
            self.surfaces.destroy_surface(self.surface, None);
        }
    }
}

/// Prefers UNORM formats of 8 bits per channel, since pictures are already sRGB-encoded.
fn choose_format(formats: &[vk::SurfaceFormatKHR]) -> Option<vk::Format> {
    let order =
        [vk::Format::B8G8R8A8_UNORM, vk::Format::R8G8B8A8_UNORM, vk::Format::B8G8R8A8_SRGB, vk::Format::R8G8B8A8_SRGB];
    let fits =
        |f: &vk::SurfaceFormatKHR, wanted| f.format == wanted && f.color_space == vk::ColorSpaceKHR::SRGB_NONLINEAR;
    order.into_iter().find(|&wanted| formats.iter().any(|f| fits(f, wanted)))
}

fn choose_mode(modes: &[vk::PresentModeKHR], vsync: Vsync) -> vk::PresentModeKHR {
    let order = match vsync {
        Vsync::On => [vk::PresentModeKHR::MAILBOX, vk::PresentModeKHR::FIFO],
        Vsync::Off => [vk::PresentModeKHR::IMMEDIATE, vk::PresentModeKHR::MAILBOX],
    };
    // FIFO is always supported.
    order.into_iter().find(|mode| modes.contains(mode)).unwrap_or(vk::PresentModeKHR::FIFO)
}

pub(super) const COLOR: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};
