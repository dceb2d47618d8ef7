//! Shadow maps: an array of depth images, and the graphics pipelines that draw into it.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use ash::vk;
use gpu_allocator::vulkan::Allocation;

use super::context::{Context, vulkan};
use super::frame::Pass;
use super::kernel::{ENTRY_POINT, ShaderModule, embedded_spirv};
use super::memory::{Access, Buffer, allocate, owner, release};
use crate::error::Result;
use crate::shared::gpu_struct::Push;

const FORMAT: vk::Format = vk::Format::D32_SFLOAT;

static NEXT_ID: AtomicU64 = AtomicU64::new(1 << 63); // disjoint from the buffers' ids

/// Array of square depth images, sampled with comparison. Depth is reversed: 1 is near, 0 is at infinity.
pub struct DepthArray {
    pub(super) name: String,
    pub(super) id: u64,
    pub(super) set: vk::DescriptorSet,
    size: u32,
    image: vk::Image,
    sampled_view: vk::ImageView,
    layer_views: Vec<vk::ImageView>,
    sampler: vk::Sampler,
    pool: vk::DescriptorPool,
    allocation: Option<Allocation>,
    context: Arc<Context>,
}

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

impl DepthArray {
    /// `layers` images of `size` x `size` pixels.
    pub fn new(context: &Arc<Context>, name: &str, size: u32, layers: u32) -> Result<Self> {
        let action = || format!("create {layers} depth images of {size} x {size} pixels");
        let device = &context.device;
        let image_info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(FORMAT)
            .extent(vk::Extent3D { width: size, height: size, depth: 1 })
            .mip_levels(1)
            .array_layers(layers)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(vk::ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT | vk::ImageUsageFlags::SAMPLED);
        let sampler_info = vk::SamplerCreateInfo::default()
            .mag_filter(vk::Filter::LINEAR)
            .min_filter(vk::Filter::LINEAR)
            .address_mode_u(vk::SamplerAddressMode::CLAMP_TO_EDGE)
            .address_mode_v(vk::SamplerAddressMode::CLAMP_TO_EDGE)
            .compare_enable(true)
            .compare_op(vk::CompareOp::GREATER_OR_EQUAL);
        let pool_sizes =
            [vk::DescriptorPoolSize { ty: vk::DescriptorType::COMBINED_IMAGE_SAMPLER, descriptor_count: 1 }];
        let pool_info = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&pool_sizes);
        let mut array = Self {
            name: name.into(),
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            set: vk::DescriptorSet::null(),
            size,
            image: vk::Image::null(),
            sampled_view: vk::ImageView::null(),
            layer_views: Vec::new(),
            sampler: vk::Sampler::null(),
            pool: vk::DescriptorPool::null(),
            allocation: None,
            context: context.clone(),
        };
        // SAFETY: the infos are valid and their pointers outlive the calls; if a step fails, `array` destroys the
        // objects created so far and ignores null handles.
        unsafe {
            array.image = device.create_image(&image_info, None).map_err(vulkan(action()))?;
            let requirements = device.get_image_memory_requirements(array.image);
            let allocation = allocate(context, name, Access::Device, requirements, false)?;
            context.count_memory(owner(name), allocation.size());
            let bound = device.bind_image_memory(array.image, allocation.memory(), allocation.offset());
            array.allocation = Some(allocation);
            bound.map_err(vulkan(action()))?;
            array.sampled_view = array.view(vk::ImageViewType::TYPE_2D_ARRAY, 0, layers)?;
            for layer in 0..layers {
                let view = array.view(vk::ImageViewType::TYPE_2D, layer, 1)?;
                array.layer_views.push(view);
            }
            array.sampler = device.create_sampler(&sampler_info, None).map_err(vulkan(action()))?;
            array.pool = device.create_descriptor_pool(&pool_info, None).map_err(vulkan(action()))?;
            let set_info = vk::DescriptorSetAllocateInfo::default()
                .descriptor_pool(array.pool)
                .set_layouts(std::slice::from_ref(&context.set_layout));
            array.set = device.allocate_descriptor_sets(&set_info).map_err(vulkan(action()))?[0];
            let images = [vk::DescriptorImageInfo::default()
                .sampler(array.sampler)
                .image_view(array.sampled_view)
                .image_layout(vk::ImageLayout::DEPTH_READ_ONLY_OPTIMAL)];
            let write = vk::WriteDescriptorSet::default()
                .dst_set(array.set)
                .descriptor_type(vk::DescriptorType::COMBINED_IMAGE_SAMPLER)
                .image_info(&images);
            device.update_descriptor_sets(&[write], &[]);
        }
        context.name(array.image, name);
        context.name(array.sampled_view, name);
        context.name(array.sampler, name);
        context.name(array.pool, name);
        context.name(array.set, name);
        Ok(array)
    }

    /// Side of an image in pixels.
    pub fn size(&self) -> u32 {
        self.size
    }

    fn view(&self, view_type: vk::ImageViewType, first: u32, count: u32) -> Result<vk::ImageView> {
        let create = vk::ImageViewCreateInfo::default()
            .image(self.image)
            .view_type(view_type)
            .format(FORMAT)
            .subresource_range(depth_layers(first, count));
        // SAFETY: the image has memory and these layers.
        let view = unsafe { self.context.device.create_image_view(&create, None) }
            .map_err(vulkan(format!("create a view of {}", self.name)))?;
        self.context.name(view, &self.name);
        Ok(view)
    }

    /// Transitions layers from one layout to another.
    fn transition(
        &self,
        commands: vk::CommandBuffer,
        layers: Range<u32>,
        (from, from_stage, from_access): (vk::ImageLayout, vk::PipelineStageFlags2, vk::AccessFlags2),
        (to, to_stage, to_access): (vk::ImageLayout, vk::PipelineStageFlags2, vk::AccessFlags2),
    ) {
        let barriers = [vk::ImageMemoryBarrier2::default()
            .image(self.image)
            .old_layout(from)
            .new_layout(to)
            .src_stage_mask(from_stage)
            .src_access_mask(from_access)
            .dst_stage_mask(to_stage)
            .dst_access_mask(to_access)
            .subresource_range(depth_layers(layers.start, layers.end - layers.start))];
        let info = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: the command buffer is being recorded, outside of rendering.
        unsafe { self.context.device.cmd_pipeline_barrier2(commands, &info) };
    }
}

impl Drop for DepthArray {
    fn drop(&mut self) {
        let device = &self.context.device;
        // SAFETY: every frame is waited for before its borrow of the image ends; null handles are ignored.
        unsafe {
            device.destroy_descriptor_pool(self.pool, None);
            device.destroy_sampler(self.sampler, None);
            for &view in self.layer_views.iter().chain([&self.sampled_view]) {
                device.destroy_image_view(view, None);
            }
            device.destroy_image(self.image, None);
        }
        release(&self.context, &self.name, self.allocation.take());
    }
}

fn depth_layers(first: u32, count: u32) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange {
        aspect_mask: vk::ImageAspectFlags::DEPTH,
        base_mip_level: 0,
        level_count: 1,
        base_array_layer: first,
        layer_count: count,
    }
}

impl<P: Push> DepthKernel<P> {
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
    pub fn draw_depth<P: Push, Q: Push>(
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

fn draw_indexed<P: Push>(
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

fn draw_unindexed<P: Push>(
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
