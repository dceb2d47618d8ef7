//! The last passes of a frame in a window: picture, user interface, presentation.

use std::sync::Arc;

use ash::vk;
use glam::UVec2;

use super::context::Context;
use super::frame::Frame;
use super::kernel::Kernel;
use super::memory::{Access, Buffer};
use super::surface::{COLOR, Presenting, Surface};
use super::ui::{UiFrame, UiRenderer};
use crate::error::Result;
use crate::shared::{FitConstants, FitPush};

/// Position and size of the picture in the window, physical pixels; may extend beyond the window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    pub left: i32,
    pub top: i32,
    pub width: u32,
    pub height: u32,
}

/// A window to draw into: surface, placement of the picture, and overlays.
pub struct Screen<'a> {
    pub surface: &'a mut Surface,
    pub placement: Placement,
    /// Second picture that covers the left part of the first.
    pub comparison: Option<ComparisonOverlay<'a>>,
    pub ui: Option<(&'a mut UiRenderer, &'a UiFrame)>,
}

/// 8-bit sRGB pixels with alpha, row by row, in the surface's order of channels.
#[derive(Clone, Copy)]
pub struct Pixels<'a> {
    pub buffer: &'a Buffer<u32>,
    pub width: u32,
    pub height: u32,
}

/// A second picture over the left part of the first, with the same placement.
#[derive(Clone, Copy)]
pub struct ComparisonOverlay<'a> {
    pub pixels: Pixels<'a>,
    /// Fraction of the picture's width that it covers, 0 to 1.
    pub share: f32,
}

/// Colour of the window around the picture: dark and neutral, to not affect the perception of the picture.
const BACKGROUND: [f32; 4] = [0.055, 0.055, 0.055, 1.0];

impl Surface {
    /// Creates the resampling kernel and its target of `pixels` pixels unless they exist. `is_comparison`: for the
    /// second picture.
    fn prepare_fit(&mut self, context: &Arc<Context>, shrinks: bool, pixels: usize, is_comparison: bool) -> Result<()> {
        let kernel = &mut self.fit[usize::from(shrinks)];
        if kernel.is_none() {
            *kernel = Some(Kernel::new(context, FitConstants { shrinks })?);
        }
        let fitted = &mut self.fitted[usize::from(is_comparison)];
        if fitted.as_ref().is_none_or(|fitted| fitted.len() < pixels) {
            *fitted = Some(Buffer::new(context, "pictures (fitted)", Access::Device, pixels)?);
        }
        Ok(())
    }
}

impl Frame<'_> {
    /// Draws picture and user interface into the window's next image; [`Frame::finish_on`] presents it. Draws nothing
    /// while the window has zero size.
    pub fn draw(&mut self, screen: &mut Screen, pixels: Option<Pixels>) -> Result<()> {
        let Screen { surface, placement, comparison, ui } = screen;
        let placement = *placement;
        let context = self.context().clone();
        let Some(index) = surface.acquire()? else { return Ok(()) };
        let target = &surface.targets[index as usize];
        let (image, view, extent) = (target.image, target.view, surface.extent);
        self.will_present(Presenting { index, acquired: surface.acquired, rendered: target.rendered });

        let comparison = comparison.filter(|_| pixels.is_some());
        let both = [pixels, comparison.map(|comparison| comparison.pixels)];
        let needs_fit = |pixels: &Pixels| [pixels.width, pixels.height] != [placement.width, placement.height];
        let shrinks = |pixels: &Pixels| pixels.width > placement.width || pixels.height > placement.height;
        for (index, pixels) in both.iter().enumerate() {
            if let Some(pixels) = pixels.filter(needs_fit) {
                let room = placement.width as usize * placement.height as usize;
                surface.prepare_fit(&context, shrinks(&pixels), room, index == 1)?;
            }
        }
        let mut fitted = |index: usize| {
            let pixels: Pixels = both[index]?;
            if !needs_fit(&pixels) {
                return Some(pixels.buffer);
            }
            let kernel = surface.fit[usize::from(shrinks(&pixels))].as_ref().expect("prepared");
            let target = surface.fitted[index].as_ref().expect("prepared");
            self.fit(pixels, placement, kernel, target);
            Some(target)
        };
        let (shown, shown_comparison) = (fitted(0), fitted(1));
        let mut pass = self.pass("present");
        for pixels in [shown, shown_comparison].into_iter().flatten() {
            let _ = pass.read(pixels);
        }
        let after = if ui.is_some() { DRAWN } else { SHOWN };
        pass.record(|context, commands| {
            let recorder = Recorder { device: &context.device, commands };
            recorder.transition(image, ACQUIRED, COPIED);
            let visible = shown.and_then(|_| visible(placement, extent));
            if visible.is_none_or(|part| part.extent != extent) {
                recorder.clear(image);
                recorder.transition(image, COPIED, COPIED);
            }
            if let Some((pixels, part)) = shown.zip(visible) {
                let [left, right] = split(placement, part, comparison.map_or(0.0, |comparison| comparison.share));
                for (pixels, part) in [(shown_comparison, left), (Some(pixels), right)] {
                    if let Some((pixels, part)) = pixels.zip(part) {
                        recorder.copy(pixels, placement, part, image);
                    }
                }
            }
            recorder.transition(image, COPIED, after);
        });
        let Some((renderer, ui)) = ui else { return Ok(()) };
        let mut drawn = Ok(());
        self.pass("user interface").record(|context, commands| {
            let recorder = Recorder { device: &context.device, commands };
            recorder.begin_rendering(view, extent);
            drawn = renderer.record(commands, extent, ui);
            recorder.end_rendering();
            recorder.transition(image, DRAWN, SHOWN);
        });
        drawn
    }

    fn fit(&mut self, pixels: Pixels, placement: Placement, kernel: &Kernel<FitPush>, fitted: &Buffer<u32>) {
        let mut pass = self.pass("fit");
        let push = FitPush {
            source: pass.read(pixels.buffer),
            target: pass.write(fitted),
            source_size: UVec2::new(pixels.width, pixels.height),
            target_size: UVec2::new(placement.width, placement.height),
        };
        pass.dispatch(kernel, &push, placement.width * placement.height);
    }
}

/// Layout, stage and access of an image at one point of the frame.
type Usage = (vk::ImageLayout, vk::PipelineStageFlags2, vk::AccessFlags2);

/// The contents are undefined. The stage is that at which the submission waits for the acquisition.
const ACQUIRED: Usage = (vk::ImageLayout::UNDEFINED, vk::PipelineStageFlags2::ALL_TRANSFER, vk::AccessFlags2::NONE);
const COPIED: Usage =
    (vk::ImageLayout::TRANSFER_DST_OPTIMAL, vk::PipelineStageFlags2::ALL_TRANSFER, vk::AccessFlags2::TRANSFER_WRITE);
const DRAWN: Usage = (
    vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL,
    vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT,
    vk::AccessFlags2::from_raw(
        vk::AccessFlags2::COLOR_ATTACHMENT_READ.as_raw() | vk::AccessFlags2::COLOR_ATTACHMENT_WRITE.as_raw(),
    ),
);
const SHOWN: Usage = (vk::ImageLayout::PRESENT_SRC_KHR, vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);

const LAYERS: vk::ImageSubresourceLayers = vk::ImageSubresourceLayers {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    mip_level: 0,
    base_array_layer: 0,
    layer_count: 1,
};

struct Recorder<'a> {
    device: &'a ash::Device,
    commands: vk::CommandBuffer,
}

impl Recorder<'_> {
    fn transition(&self, image: vk::Image, from: Usage, to: Usage) {
        let barriers = [vk::ImageMemoryBarrier2::default()
            .image(image)
            .old_layout(from.0)
            .new_layout(to.0)
            .src_stage_mask(from.1)
            .src_access_mask(from.2)
            .dst_stage_mask(to.1)
            .dst_access_mask(to.2)
            .subresource_range(COLOR)];
        let info = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: the command buffer is being recorded, outside of rendering.
        unsafe { self.device.cmd_pipeline_barrier2(self.commands, &info) };
    }

    fn clear(&self, image: vk::Image) {
        let color = vk::ClearColorValue { float32: BACKGROUND };
        // SAFETY: the image is in this layout.
        unsafe { self.device.cmd_clear_color_image(self.commands, image, COPIED.0, &color, &[COLOR]) };
    }

    /// Copies a visible part of the picture, which has the size of `placement`.
    fn copy(&self, pixels: &Buffer<u32>, placement: Placement, part: vk::Rect2D, image: vk::Image) {
        let inside = [part.offset.x - placement.left, part.offset.y - placement.top].map(|x| x as u64);
        let region = vk::BufferImageCopy::default()
            .buffer_offset(4 * (inside[1] * u64::from(placement.width) + inside[0]))
            .buffer_row_length(placement.width)
            .image_subresource(LAYERS)
            .image_offset(vk::Offset3D { x: part.offset.x, y: part.offset.y, z: 0 })
            .image_extent(vk::Extent3D { width: part.extent.width, height: part.extent.height, depth: 1 });
        let buffer = pixels.raw().handle;
        // SAFETY: the part lies within the image and within the placement, whose pixels the buffer contains.
        unsafe { self.device.cmd_copy_buffer_to_image(self.commands, buffer, image, COPIED.0, &[region]) };
    }

    fn begin_rendering(&self, view: vk::ImageView, extent: vk::Extent2D) {
        let attachments = [vk::RenderingAttachmentInfo::default()
            .image_view(view)
            .image_layout(DRAWN.0)
            .load_op(vk::AttachmentLoadOp::LOAD)
            .store_op(vk::AttachmentStoreOp::STORE)];
        let area = vk::Rect2D { offset: vk::Offset2D::default(), extent };
        let info = vk::RenderingInfo::default().render_area(area).layer_count(1).color_attachments(&attachments);
        // SAFETY: the command buffer is being recorded; the view is of an image in this layout.
        unsafe { self.device.cmd_begin_rendering(self.commands, &info) };
    }

    fn end_rendering(&self) {
        // SAFETY: rendering was begun.
        unsafe { self.device.cmd_end_rendering(self.commands) };
    }
}

/// Splits a visible part of the picture at a fraction `share` of the picture's width.
fn split(placement: Placement, part: vk::Rect2D, share: f32) -> [Option<vk::Rect2D>; 2] {
    let line = placement.left + (share.clamp(0.0, 1.0) * placement.width as f32).round() as i32;
    let (start, end) = (part.offset.x, part.offset.x + part.extent.width as i32);
    let line = line.clamp(start, end);
    let between = |start: i32, end: i32| {
        let offset = vk::Offset2D { x: start, y: part.offset.y };
        let extent = vk::Extent2D { width: (end - start) as u32, height: part.extent.height };
        (end > start).then_some(vk::Rect2D { offset, extent })
    };
    [between(start, line), between(line, end)]
}

/// Part of the window that the picture covers; `None` if it is empty.
fn visible(placement: Placement, extent: vk::Extent2D) -> Option<vk::Rect2D> {
    let axis = |start: i32, length: u32, window: u32| {
        let end = (i64::from(start) + i64::from(length)).min(i64::from(window));
        let length = u32::try_from(end - i64::from(start.max(0))).ok().filter(|&length| length > 0);
        Some((start.max(0), length?))
    };
    let (x, width) = axis(placement.left, placement.width, extent.width)?;
    let (y, height) = axis(placement.top, placement.height, extent.height)?;
    Some(vk::Rect2D { offset: vk::Offset2D { x, y }, extent: vk::Extent2D { width, height } })
}
