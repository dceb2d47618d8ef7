//! Drawing of shadow maps: graphics pipelines that write the layers of a [`DepthArray`].

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::context::Context;
use super::depth_array::{DepthArray, FORMAT};
use super::frame::Pass;
use super::kernel::{ENTRY_POINT, ShaderModule, embedded_spirv};
use super::memory::Buffer;
use super::vulkan_error::vulkan;
use crate::error::Result;
use crate::shared::gpu_struct::{DrawDepth, Push};

/// Graphics pipeline that writes only depth, with the shaders of the push constants `P`.
pub struct DepthKernel<P> {
    pipeline: vk::Pipeline,
    context: Arc<Context>,
    push: PhantomData<P>,
}

/// Draw calls for one layer: push constants, and ranges of indices or of vertices.
pub struct DepthDraw<'a, P> {
    pub push: P,
    pub ranges: &'a [Range<u32>],
}

impl<P: Push<Pipeline = DrawDepth>> DepthKernel<P> {
    /// Creates the pipeline of the vertex shader and, if it exists, the fragment shader. No face culling: both sides of
    /// a triangle block light.
    pub fn new(context: &Arc<Context>) -> Result<Self> {
        let name = P::KERNEL;
        let spirv = embedded_spirv(&format!("{name}.vert")).unwrap_or_else(|| panic!("there is no glsl/{name}.vert"));
        let module = ShaderModule::new(context, name, spirv)?;
        let fragment = embedded_spirv(&format!("{name}.frag"));
        let fragment = fragment.map(|spirv| ShaderModule::new(context, name, spirv)).transpose()?;
        let stage = |stage, module: &ShaderModule| {
            vk::PipelineShaderStageCreateInfo::default().stage(stage).module(module.handle).name(ENTRY_POINT)
        };
        let stages: Vec<_> = [stage(vk::ShaderStageFlags::VERTEX, &module)]
            .into_iter()
            .chain(fragment.as_ref().map(|module| stage(vk::ShaderStageFlags::FRAGMENT, module)))
            .collect();
        let vertex_input = vk::PipelineVertexInputStateCreateInfo::default();
        let assembly =
            vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
        let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
        let rasterization = vk::PipelineRasterizationStateCreateInfo::default()
            .cull_mode(vk::CullModeFlags::NONE)
            .depth_clamp_enable(true) // geometry in front of the near plane still casts shadows
            .depth_bias_enable(true)
            // Reversed depth: negative is away from the light. The filter has a radius of two texels along each axis,
            // so 2 sqrt(2) diagonally. With a slope factor of -2, floors diagonal to both axes were 2 % too dark.
            .depth_bias_constant_factor(-2.0)
            .depth_bias_slope_factor(-3.0)
            .line_width(1.0);
        let multisample =
            vk::PipelineMultisampleStateCreateInfo::default().rasterization_samples(vk::SampleCountFlags::TYPE_1);
        let depth = vk::PipelineDepthStencilStateCreateInfo::default()
            .depth_test_enable(true)
            .depth_write_enable(true)
            .depth_compare_op(vk::CompareOp::GREATER_OR_EQUAL);
        let dynamic = vk::PipelineDynamicStateCreateInfo::default()
            .dynamic_states(&[vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR]);
        let mut rendering = vk::PipelineRenderingCreateInfo::default().depth_attachment_format(FORMAT);
        let create = vk::GraphicsPipelineCreateInfo::default()
            .stages(&stages)
            .vertex_input_state(&vertex_input)
            .input_assembly_state(&assembly)
            .viewport_state(&viewport)
            .rasterization_state(&rasterization)
            .multisample_state(&multisample)
            .depth_stencil_state(&depth)
            .dynamic_state(&dynamic)
            .layout(context.pipeline_layout)
            .push_next(&mut rendering);
        // SAFETY: all pointers outlive the call.
        let pipelines = unsafe { context.device.create_graphics_pipelines(context.pipeline_cache, &[create], None) }
            .map_err(|(_, error)| vulkan(format!("create the pipeline {name}"))(error))?;
        context.name(pipelines[0], name);
        Ok(Self { pipeline: pipelines[0], context: context.clone(), push: PhantomData })
    }
}

impl<P> Drop for DepthKernel<P> {
    fn drop(&mut self) {
        // SAFETY: every frame is waited for before its borrow of the pipeline ends.
        unsafe { self.context.device.destroy_pipeline(self.pipeline, None) };
    }
}

impl Pass<'_> {
    /// Clears layers 0, 1, ... of `target` and draws one [`DepthDraw`] of indexed triangles into each, and then one of
    /// `unindexed` triangles with another kernel.
    pub fn draw_depth<P: Push<Pipeline = DrawDepth>, Q: Push<Pipeline = DrawDepth>>(
        mut self,
        target: &DepthArray,
        (kernel, indices, draws): (&DepthKernel<P>, &Buffer<u32>, &[DepthDraw<P>]),
        unindexed: Option<(&DepthKernel<Q>, &[DepthDraw<Q>])>,
    ) {
        use vk::{AccessFlags2 as Rights, ImageLayout as Layout, PipelineStageFlags2 as Stage};
        let _ = self.read(indices);
        let count = draws.len() as u32;
        assert!(draws.len() <= target.layer_views.len(), "{count} draws, {} layers", target.layer_views.len());
        let attachment = (
            Layout::DEPTH_ATTACHMENT_OPTIMAL,
            Stage::EARLY_FRAGMENT_TESTS | Stage::LATE_FRAGMENT_TESTS,
            Rights::DEPTH_STENCIL_ATTACHMENT_READ | Rights::DEPTH_STENCIL_ATTACHMENT_WRITE,
        );
        self.write_depth(target);
        self.record(|context, commands| {
            let sampled = (Layout::DEPTH_READ_ONLY_OPTIMAL, Stage::COMPUTE_SHADER, Rights::SHADER_SAMPLED_READ);
            let undefined = (Layout::UNDEFINED, sampled.1, sampled.2);
            target.transition(commands, 0..count, undefined, attachment);
            // The descriptor covers all layers, so those not drawn need the sampled layout too.
            if (count as usize) < target.layer_views.len() {
                target.transition(commands, count..target.layer_views.len() as u32, undefined, sampled);
            }
            for (layer, draw) in draws.iter().enumerate() {
                begin_layer(context, commands, target, layer);
                draw_indexed(context, commands, kernel, indices, draw);
                if let Some((kernel, draws)) = unindexed {
                    draw_unindexed(context, commands, kernel, &draws[layer]);
                }
                // SAFETY: rendering was begun above.
                unsafe { context.device.cmd_end_rendering(commands) };
            }
            target.transition(commands, 0..count, attachment, sampled);
        });
    }
}

fn begin_layer(context: &Context, commands: vk::CommandBuffer, target: &DepthArray, layer: usize) {
    let device = &context.device;
    let extent = vk::Extent2D { width: target.size, height: target.size };
    let area = vk::Rect2D { offset: vk::Offset2D::default(), extent };
    let side = target.size as f32;
    let viewport = vk::Viewport { x: 0.0, y: 0.0, width: side, height: side, min_depth: 0.0, max_depth: 1.0 };
    let depth = vk::RenderingAttachmentInfo::default()
        .image_view(target.layer_views[layer])
        .image_layout(vk::ImageLayout::DEPTH_ATTACHMENT_OPTIMAL)
        .load_op(vk::AttachmentLoadOp::CLEAR)
        .store_op(vk::AttachmentStoreOp::STORE)
        .clear_value(vk::ClearValue { depth_stencil: vk::ClearDepthStencilValue { depth: 0.0, stencil: 0 } });
    let rendering = vk::RenderingInfo::default().render_area(area).layer_count(1).depth_attachment(&depth);
    // SAFETY: the command buffer is being recorded; viewport and scissor are dynamic in every pipeline.
    unsafe {
        device.cmd_begin_rendering(commands, &rendering);
        device.cmd_set_viewport(commands, 0, &[viewport]);
        device.cmd_set_scissor(commands, 0, &[area]);
    }
}

const STAGES: vk::ShaderStageFlags = vk::ShaderStageFlags::from_raw(
    vk::ShaderStageFlags::COMPUTE.as_raw()
        | vk::ShaderStageFlags::VERTEX.as_raw()
        | vk::ShaderStageFlags::FRAGMENT.as_raw(),
);

fn draw_indexed<P: Push<Pipeline = DrawDepth>>(
    context: &Context,
    commands: vk::CommandBuffer,
    kernel: &DepthKernel<P>,
    indices: &Buffer<u32>,
    draw: &DepthDraw<P>,
) {
    let device = &context.device;
    // SAFETY: rendering was begun; indices were checked against the vertices when the mesh was imported, and ranges
    // are checked below.
    unsafe {
        device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::GRAPHICS, kernel.pipeline);
        device.cmd_push_constants(commands, context.pipeline_layout, STAGES, 0, bytemuck::bytes_of(&draw.push));
        device.cmd_bind_index_buffer(commands, indices.raw().handle, 0, vk::IndexType::UINT32);
        for range in draw.ranges {
            assert!(range.end as usize <= indices.len(), "{range:?} of {} indices", indices.len());
            device.cmd_draw_indexed(commands, range.end - range.start, 1, range.start, 0, 0);
        }
    }
}

fn draw_unindexed<P: Push<Pipeline = DrawDepth>>(
    context: &Context,
    commands: vk::CommandBuffer,
    kernel: &DepthKernel<P>,
    draw: &DepthDraw<P>,
) {
    let device = &context.device;
    // SAFETY: rendering was begun; clusters only have ranges of existing vertices.
    unsafe {
        device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::GRAPHICS, kernel.pipeline);
        device.cmd_push_constants(commands, context.pipeline_layout, STAGES, 0, bytemuck::bytes_of(&draw.push));
        for range in draw.ranges {
            device.cmd_draw(commands, range.end - range.start, 1, range.start, 0);
        }
    }
}
