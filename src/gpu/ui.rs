//! Draws egui's user interface over the picture.

use std::mem::ManuallyDrop;
use std::sync::Arc;

use ash::vk;
use egui_ash_renderer::allocator::DefaultAllocator;
use egui_ash_renderer::{DynamicRendering, Options, RenderMode, Renderer};

use super::context::Context;
use super::surface::Surface;
use super::vulkan_error::vulkan;
use crate::error::Result;

/// Tessellated user interface of one frame.
pub struct UiFrame {
    pub primitives: Vec<egui::ClippedPrimitive>,
    pub pixels_per_point: f32,
}

/// Draws the user interface. The memory report does not include its textures and buffers.
pub struct UiRenderer {
    /// Dropped before the device.
    renderer: ManuallyDrop<Renderer<DefaultAllocator>>,
    /// Textures that no frame after the last one uses.
    unused: Vec<egui::TextureId>,
    /// For texture uploads.
    pool: vk::CommandPool,
    context: Arc<Context>,
}

impl UiRenderer {
    pub fn new(context: &Arc<Context>, surface: &Surface) -> Result<Self> {
        let mode = RenderMode::DynamicRendering(DynamicRendering {
            color_attachment_format: surface.format,
            depth_attachment_format: None,
            stencil_attachment_format: None,
        });
        let options = Options { srgb_framebuffer: surface.is_srgb(), ..Options::default() };
        let (instance, device) = (&context.instance.handle, context.device.clone());
        let renderer = Renderer::with_default_allocator(instance, context.info.handle, device, mode, options)
            .map_err(vulkan("set up the user interface"))?;
        let pool_info = vk::CommandPoolCreateInfo::default()
            .flags(vk::CommandPoolCreateFlags::TRANSIENT)
            .queue_family_index(context.queue_family);
        // SAFETY: the info is valid.
        let pool = unsafe { context.device.create_command_pool(&pool_info, None) };
        let pool = pool.map_err(vulkan("create a command pool"))?;
        context.name(pool, "user interface upload");
        Ok(Self { renderer: ManuallyDrop::new(renderer), unused: Vec::new(), pool, context: context.clone() })
    }

    /// Uploads changed textures, such as new glyphs; call it before the frame that uses them.
    pub fn update_textures(&mut self, delta: &egui::TexturesDelta) -> Result<()> {
        for id in self.unused.drain(..) {
            self.renderer.free_texture(id).map_err(vulkan("free a texture of the user interface"))?;
        }
        for (id, image) in delta.set.iter().flat_map(|(id, images)| images.iter().map(move |image| (id, image))) {
            self.renderer
                .set_texture(self.context.queue, self.pool, *id, image)
                .map_err(vulkan("upload a texture of the user interface"))?;
        }
        self.unused.extend(&delta.free);
        Ok(())
    }

    /// Records draw commands; rendering to a target of `extent` pixels must have begun.
    pub(super) fn record(&mut self, commands: vk::CommandBuffer, extent: vk::Extent2D, ui: &UiFrame) -> Result<()> {
        self.renderer
            .cmd_draw(commands, extent, ui.pixels_per_point, &ui.primitives)
            .map_err(vulkan("draw the user interface"))
    }
}

impl Drop for UiRenderer {
    fn drop(&mut self) {
        // SAFETY: every frame was waited for; the renderer is not used again.
        unsafe {
            ManuallyDrop::drop(&mut self.renderer);
            self.context.device.destroy_command_pool(self.pool, None);
        }
    }
}
