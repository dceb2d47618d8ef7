//! Compute kernels: GLSL compiled at build time, specialised at start.

use std::ffi::CStr;
use std::marker::PhantomData;
use std::sync::Arc;

use ash::vk;

use super::context::Context;
use super::vulkan_error::vulkan;
use crate::error::Result;
use crate::shared::gpu_struct::{Compute, Constants, Push};

/// File name and SPIR-V of every shader in `glsl/`; the build script writes the list.
static SPIRV: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/spirv.rs"));

pub(super) fn embedded_spirv(file_name: &str) -> Option<&'static [u8]> {
    SPIRV.iter().find(|(name, _)| *name == file_name).map(|(_, spirv)| *spirv)
}

/// One compute pipeline, of the kernel that `P` is for. It takes no other push constants:
///
/// ```compile_fail,E0308
/// # use relume::{gpu::{Kernel, Pass}, shared::{FitPush, ResolvePush}};
/// fn run(pass: Pass, kernel: &Kernel<FitPush>, push: &ResolvePush) {
///     pass.dispatch(kernel, push, 1);
/// }
/// ```
///
/// Shaders that draw are no compute kernels:
///
/// ```compile_fail,E0271
/// # use relume::{gpu::Kernel, shared::ShadowPush};
/// fn run(kernel: &Kernel<ShadowPush>) {}
/// ```
pub struct Kernel<P: Push<Pipeline = Compute>> {
    pipeline: vk::Pipeline,
    context: Arc<Context>,
    #[cfg(feature = "hot-reload")]
    constants: P::Constants,
    #[cfg(feature = "hot-reload")]
    modified: Option<std::time::SystemTime>,
    push: PhantomData<P>,
}

pub(super) const ENTRY_POINT: &CStr = c"main";

impl<P: Push<Pipeline = Compute>> Kernel<P> {
    /// Compiles the kernel for this device, or takes it from the pipeline cache.
    pub fn new(context: &Arc<Context>, constants: P::Constants) -> Result<Self> {
        let file = format!("{}.comp", P::KERNEL);
        let spirv = embedded_spirv(&file).unwrap_or_else(|| panic!("there is no glsl/{file}"));
        let pipeline = create_pipeline(context, P::KERNEL, spirv, &constants)?;
        Ok(Self {
            pipeline,
            context: context.clone(),
            #[cfg(feature = "hot-reload")]
            constants,
            #[cfg(feature = "hot-reload")]
            modified: None,
            push: PhantomData,
        })
    }

    pub(super) fn pipeline(&self) -> vk::Pipeline {
        self.pipeline
    }

    /// Compiles the kernel anew if its source changed since the last look; an error in it is logged and the kernel
    /// stays as it was. Looks at `glsl/` where this program was built. Returns whether it is a new one.
    #[cfg(feature = "hot-reload")]
    pub fn reload_if_changed(&mut self) -> bool {
        let path = format!("{}/glsl/{}.comp", env!("CARGO_MANIFEST_DIR"), P::KERNEL);
        let path = std::path::Path::new(&path);
        let folder = path.with_file_name("lib");
        let includes = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let times = includes.chain([path.to_owned()]).filter_map(|p| std::fs::metadata(p).ok()?.modified().ok());
        let Some(modified) = times.max() else { return false };
        let seen = self.modified.replace(modified);
        if seen.is_none_or(|seen| seen == modified) {
            return false;
        }
        let made = super::compile::compile(path)
            .map_err(|log| crate::error::Error::Shader { kernel: P::KERNEL.into(), log })
            .and_then(|spirv| create_pipeline(&self.context, P::KERNEL, bytemuck::cast_slice(&spirv), &self.constants));
        match made {
            Ok(pipeline) => {
                tracing::info!("reloaded {}", P::KERNEL);
                // SAFETY: frames are waited for before kernels can be borrowed mutably.
                unsafe { self.context.device.destroy_pipeline(self.pipeline, None) };
                self.pipeline = pipeline;
                true
            }
            Err(error) => {
                tracing::error!("{error}");
                false
            }
        }
    }
}

impl<P: Push<Pipeline = Compute>> Drop for Kernel<P> {
    fn drop(&mut self) {
        // SAFETY: every frame is waited for before its borrow of the kernel ends.
        unsafe { self.context.device.destroy_pipeline(self.pipeline, None) };
    }
}

fn create_pipeline(context: &Context, name: &str, spirv: &[u8], constants: &impl Constants) -> Result<vk::Pipeline> {
    let values: Vec<u8> = constants.list().iter().flat_map(|(.., value)| value.to_ne_bytes()).collect();
    let entries: Vec<_> = (0..values.len() as u32 / 4)
        .map(|id| vk::SpecializationMapEntry { constant_id: id, offset: 4 * id, size: 4 })
        .collect();
    let info = vk::SpecializationInfo::default().map_entries(&entries).data(&values);
    let module = ShaderModule::new(context, name, spirv)?;
    let stage = vk::PipelineShaderStageCreateInfo::default()
        .stage(vk::ShaderStageFlags::COMPUTE)
        .module(module.handle)
        .name(ENTRY_POINT)
        .specialization_info(&info);
    let create = vk::ComputePipelineCreateInfo::default().stage(stage).layout(context.pipeline_layout);
    // SAFETY: all pointers outlive the call.
    let pipelines = unsafe { context.device.create_compute_pipelines(context.pipeline_cache, &[create], None) }
        .map_err(|(_, error)| vulkan(format!("create the pipeline {name}"))(error))?;
    context.name(pipelines[0], name);
    Ok(pipelines[0])
}

/// A shader module that lives as long as pipelines are made from it.
pub(super) struct ShaderModule<'a> {
    pub handle: vk::ShaderModule,
    context: &'a Context,
}

impl<'a> ShaderModule<'a> {
    pub fn new(context: &'a Context, name: &str, spirv: &[u8]) -> Result<Self> {
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(spirv);
        let create = vk::ShaderModuleCreateInfo::default().code(&words);
        // SAFETY: shaderc made the code, and the words outlive the call.
        let handle = unsafe { context.device.create_shader_module(&create, None) }
            .map_err(vulkan(format!("load the shader {name}")))?;
        context.name(handle, name);
        Ok(Self { handle, context })
    }
}

impl Drop for ShaderModule<'_> {
    fn drop(&mut self) {
        // SAFETY: pipelines keep what they need of a module.
        unsafe { self.context.device.destroy_shader_module(self.handle, None) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Validation;

    /// Each compute kernel in `glsl/`; and each push struct has its kernel there.
    #[test]
    fn all_kernels_can_be_made() {
        let context = Context::new(None, Validation::On, None).expect("tools/setup installs a Vulkan device");
        for (name, _) in crate::shared::interfaces() {
            let is_there = |stage| embedded_spirv(&format!("{name}.{stage}")).is_some();
            assert!(is_there("comp") || is_there("vert"), "a push struct is for {name}, which is not in glsl/");
        }
        for (name, spirv) in SPIRV.iter().filter(|(name, _)| name.ends_with(".comp")) {
            let pipeline = create_pipeline(&context, name, spirv, &()).unwrap_or_else(|e| panic!("{name}: {e}"));
            // SAFETY: nothing uses it.
            unsafe { context.device.destroy_pipeline(pipeline, None) };
        }
        assert_eq!(context.validation_messages(), [""; 0]);
    }
}
