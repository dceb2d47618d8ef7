//! Shadow maps: an array of depth images.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use ash::vk;
use gpu_allocator::vulkan::Allocation;

use super::context::Context;
use super::memory::{Access, allocate, owner, release};
use super::vulkan_error::vulkan;
use crate::error::Result;

pub(super) const FORMAT: vk::Format = vk::Format::D32_SFLOAT;

static NEXT_ID: AtomicU64 = AtomicU64::new(1 << 63); // disjoint from the buffers' ids

/// Array of square depth images, sampled with comparison. Depth is reversed: 1 is near, 0 is at infinity.
pub struct DepthArray {
    pub(super) name: String,
    pub(super) id: u64,
    pub(super) set: vk::DescriptorSet,
    pub(super) size: u32,
    image: vk::Image,
    sampled_view: vk::ImageView,
    pub(super) layer_views: Vec<vk::ImageView>,
    sampler: vk::Sampler,
    pool: vk::DescriptorPool,
    allocation: Option<Allocation>,
    context: Arc<Context>,
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
    pub(super) fn transition(
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
