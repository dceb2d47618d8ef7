//! A frame: a sequence of passes, each with barrier, debug label and timestamps.
//!
//! A frame waits once, at its end. Where kernels run on the CPU, passes [on the host](Frame::host_pass) may lie between
//! those of the device; the frame waits before each such pass that follows one of the device.
//!
//! A pass gets the address of a buffer only from [`Pass::read`] or [`Pass::write`], so every access is declared, and
//! barriers are derived from the declarations. Two mistakes panic: reading a buffer that was never written, and
//! declaring a buffer twice in a pass unless both only read. (Synchronization validation cannot see buffer addresses,
//! and on lavapipe missing barriers have no visible effect.)

use std::cell::RefCell;
use std::collections::HashMap;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use ash::vk;

use super::context::Context;
use super::depth_array::DepthArray;
use super::kernel::Kernel;
use super::memory::{Access, Buffer, RawBuffer};
use super::surface::{Presenting, Surface};
use super::vulkan_error::vulkan;
use crate::error::Result;
use crate::shared::gpu_struct::{Compute, Exchange, Glsl, Push, Read, Write};
use crate::shared::{GROUP_SIZE, MAX_COLUMNS, TILE_SIZE};

/// Where a pass ran.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Processor {
    Gpu,
    Cpu,
}

/// Time of one pass or CPU stage of a finished frame.
#[derive(Clone, Copy, Debug)]
pub struct PassTime {
    pub name: &'static str,
    pub processor: Processor,
    /// Since the start of the frame.
    pub start_ms: f64,
    pub ms: f64,
}

/// Maximum passes per frame. Callers with more work check [`Frame::passes_left`] and use several frames.
pub const MAX_PASSES: usize = 1024;
/// Size of the buffer for small per-frame data, such as shadow faces.
pub const UPLOAD_BYTES: usize = 1 << 20;

const STAGES: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::from_raw(
    vk::PipelineStageFlags2::COMPUTE_SHADER.as_raw()
        | vk::PipelineStageFlags2::ALL_GRAPHICS.as_raw()
        | vk::PipelineStageFlags2::ALL_TRANSFER.as_raw(),
);

/// Resources of frames, created once. Frames run one at a time.
pub struct Frames {
    context: Arc<Context>,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    queries: vk::QueryPool,
    upload: Buffer<u8>,
    upload_used: usize,
    uses: HashMap<u64, Use>,
    accesses: Vec<(u64, Touch)>,
    /// Number of the pass before which the last barrier was recorded.
    synced: usize,
    pass_count: usize,
    barrier_count: usize,
    names: Vec<&'static str>,
    ticks: Vec<u64>,
    times: Vec<PassTime>,
    began: Instant,
    presenting: Option<Presenting>,
    /// Number of passes of this frame that were submitted.
    submitted: usize,
    /// Time of the first submission since the start of the frame.
    submitted_ms: f64,
    /// Of the buffers that the pass on the host has slices of: whether it has.
    lent: Vec<Arc<AtomicBool>>,
}

/// The last passes of this frame that touched a buffer.
#[derive(Clone, Copy, Default)]
struct Use {
    written: Option<usize>,
    read: Option<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Touch {
    Read,
    Write,
}

/// A frame being recorded. If it is dropped without [`Frame::finish`], passes after the last one on the host are not
/// executed.
pub struct Frame<'a> {
    frames: &'a mut Frames,
}

/// A pass being declared; ends with `dispatch`.
pub struct Pass<'f> {
    frames: &'f mut Frames,
    name: &'static str,
    sampled: Option<vk::DescriptorSet>,
}

/// A pass on the host, which declares its accesses like one of the device.
pub struct HostPass<'f> {
    frames: RefCell<&'f mut Frames>,
    name: &'static str,
}

impl Glsl for u8 {
    fn name() -> String {
        unreachable!("the upload buffer is never addressed as bytes")
    }
}

impl Frames {
    pub fn new(context: &Arc<Context>) -> Result<Self> {
        let device = &context.device;
        let pool_info = vk::CommandPoolCreateInfo::default()
            .flags(vk::CommandPoolCreateFlags::TRANSIENT)
            .queue_family_index(context.queue_family);
        let query_info =
            vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(2 * MAX_PASSES as u32);
        let mut frames = Self {
            upload: Buffer::new(context, "frame upload", Access::HostWrites, UPLOAD_BYTES)?,
            context: context.clone(),
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            fence: vk::Fence::null(),
            queries: vk::QueryPool::null(),
            upload_used: 0,
            uses: HashMap::new(),
            accesses: Vec::new(),
            synced: 0,
            pass_count: 0,
            barrier_count: 0,
            names: Vec::with_capacity(MAX_PASSES),
            ticks: vec![0; 2 * MAX_PASSES],
            times: Vec::with_capacity(MAX_PASSES),
            began: Instant::now(),
            presenting: None,
            submitted: 0,
            submitted_ms: 0.0,
            lent: Vec::new(),
        };
        // SAFETY: all infos are valid. `drop` destroys what was made if a step fails, and ignores null handles.
        unsafe {
            frames.pool = device.create_command_pool(&pool_info, None).map_err(vulkan("create a command pool"))?;
            let allocate = vk::CommandBufferAllocateInfo::default()
                .command_pool(frames.pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            frames.commands = device.allocate_command_buffers(&allocate).map_err(vulkan("allocate commands"))?[0];
            frames.fence = device.create_fence(&Default::default(), None).map_err(vulkan("create a fence"))?;
            frames.queries = device.create_query_pool(&query_info, None).map_err(vulkan("create a query pool"))?;
        }
        context.name(frames.pool, "frame pool");
        context.name(frames.commands, "frame commands");
        context.name(frames.fence, "frame fence");
        context.name(frames.queries, "frame timestamps");
        Ok(frames)
    }

    /// Times of the last finished frame: what ran on the CPU first, then passes of the device.
    pub fn times(&self) -> &[PassTime] {
        &self.times
    }

    /// Number of barriers between passes in the last frame.
    pub fn barrier_count(&self) -> usize {
        self.barrier_count
    }

    /// Begins to record a frame.
    pub fn begin(&mut self) -> Result<Frame<'_>> {
        self.began = Instant::now();
        self.upload_used = 0;
        self.uses.clear();
        self.synced = 0;
        self.pass_count = 0;
        self.barrier_count = 0;
        self.names.clear();
        self.times.clear();
        self.submitted = 0;
        // SAFETY: the last frame was waited for or never submitted.
        unsafe { self.context.device.reset_query_pool(self.queries, 0, 2 * MAX_PASSES as u32) };
        self.record()?;
        Ok(Frame { frames: self })
    }

    /// Begins to record commands.
    fn record(&mut self) -> Result<()> {
        let device = &self.context.device;
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: what was recorded before was waited for or never submitted.
        unsafe {
            device.reset_command_pool(self.pool, Default::default()).map_err(vulkan("reset a command pool"))?;
            device.begin_command_buffer(self.commands, &begin).map_err(vulkan("begin a frame"))?;
        }
        // Earlier submissions are finished, but only a barrier makes their writes visible to kernels.
        let access = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
        self.barrier(STAGES, vk::AccessFlags2::MEMORY_WRITE, STAGES, access);
        Ok(())
    }

    /// Submits the recorded commands, presents on `surface` if anything was drawn for it, and waits for all of it.
    /// Returns whether that was presented.
    fn submit(&mut self, surface: Option<&mut Surface>) -> Result<Result<()>> {
        let host = vk::AccessFlags2::HOST_READ | vk::AccessFlags2::HOST_WRITE;
        self.barrier(STAGES, vk::AccessFlags2::MEMORY_WRITE, vk::PipelineStageFlags2::HOST, host);
        if self.submitted == 0 {
            self.submitted_ms = self.began.elapsed().as_secs_f64() * 1e3;
        }
        self.submitted = self.pass_count;
        let device = &self.context.device;
        let commands = [vk::CommandBufferSubmitInfo::default().command_buffer(self.commands)];
        let presenting = self.presenting.take();
        let semaphore = |semaphore, stage| vk::SemaphoreSubmitInfo::default().semaphore(semaphore).stage_mask(stage);
        let acquired = presenting.map(|p| semaphore(p.acquired, vk::PipelineStageFlags2::ALL_TRANSFER));
        let rendered = presenting.map(|p| semaphore(p.rendered, vk::PipelineStageFlags2::ALL_COMMANDS));
        let submit = [vk::SubmitInfo2::default()
            .command_buffer_infos(&commands)
            .wait_semaphore_infos(acquired.as_slice())
            .signal_semaphore_infos(rendered.as_slice())];
        // SAFETY: the commands were recorded from live objects, whose owners outlive this wait.
        unsafe {
            device.end_command_buffer(self.commands).map_err(vulkan("end a frame"))?;
            device.reset_fences(&[self.fence]).map_err(vulkan("reset a fence"))?;
            device.queue_submit2(self.context.queue, &submit, self.fence).map_err(vulkan("submit a frame"))?;
        }
        let shown = match (surface, presenting) {
            (Some(surface), Some(presenting)) => surface.present(&presenting),
            _ => Ok(()),
        };
        // SAFETY: as above; the submission signals the fence.
        unsafe {
            device.wait_for_fences(&[self.fence], true, u64::MAX).map_err(|error| {
                // After an error the frame's resources may be dropped, so wait until it no longer runs. A lost device
                // runs nothing.
                let _ = device.device_wait_idle();
                vulkan("wait for a frame")(error)
            })?;
        }
        Ok(shown)
    }

    /// Declares an access of the current pass.
    fn touch(&mut self, name: &str, raw: &RawBuffer, touch: Touch) -> u64 {
        match touch {
            Touch::Read => {
                assert!(raw.written.load(Ordering::Relaxed), "pass {name:?} reads {:?}, which nothing wrote", raw.name)
            }
            Touch::Write => raw.written.store(true, Ordering::Relaxed),
        }
        let is_lent = raw.lent.load(Ordering::Acquire) && !self.has_lent(raw);
        assert!(!is_lent, "pass {name:?} declares {:?}, which another pass has on the host", raw.name);
        self.touch_id(name, raw.id, &raw.name, touch);
        raw.address
    }

    /// Whether the current pass, which is on the host, has slices of a buffer.
    fn has_lent(&self, raw: &RawBuffer) -> bool {
        self.lent.iter().any(|lent| Arc::ptr_eq(lent, &raw.lent))
    }

    fn touch_id(&mut self, name: &str, id: u64, object: &str, touch: Touch) {
        for &(other, other_touch) in &self.accesses {
            let conflict = other == id && (touch, other_touch) != (Touch::Read, Touch::Read);
            assert!(!conflict, "pass {name:?} declares {object:?} twice: {other_touch:?} and {touch:?}");
        }
        self.accesses.push((id, touch));
    }

    /// Begins a pass on the device: barrier if its declared accesses need one, label, timestamp.
    fn begin_pass(&mut self, name: &'static str) {
        assert!(self.pass_count < MAX_PASSES, "pass {name:?} is one more than the {MAX_PASSES} of a frame");
        let this = self.pass_count;
        let mut hazard = false;
        for &(id, touch) in &self.accesses {
            let used = self.uses.entry(id).or_default();
            let pending = |pass: Option<usize>| pass.is_some_and(|pass| pass >= self.synced);
            hazard |= pending(used.written) || (touch == Touch::Write && pending(used.read));
            match touch {
                Touch::Read => used.read = Some(this),
                Touch::Write => used.written = Some(this),
            }
        }
        self.accesses.clear();
        if hazard {
            self.synced = this;
            self.barrier_count += 1;
            let access = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
            self.barrier(STAGES, access, STAGES, access);
        }
        self.label_begin(name);
        self.timestamp(2 * this as u32);
    }

    fn end_pass(&mut self, name: &'static str) {
        self.timestamp(2 * self.pass_count as u32 + 1);
        if let Some(debug_utils) = &self.context.debug_utils {
            // SAFETY: a label was begun in `begin_pass`.
            unsafe { debug_utils.cmd_end_debug_utils_label(self.commands) };
        }
        self.names.push(name);
        self.pass_count += 1;
    }

    fn label_begin(&self, name: &str) {
        let Some(debug_utils) = &self.context.debug_utils else { return };
        let name = std::ffi::CString::new(name).expect("names hold no zero byte");
        let label = vk::DebugUtilsLabelEXT::default().label_name(&name);
        // SAFETY: the command buffer is being recorded.
        unsafe { debug_utils.cmd_begin_debug_utils_label(self.commands, &label) };
    }

    fn timestamp(&self, query: u32) {
        // SAFETY: the command buffer is being recorded, the query is within the pool and was reset.
        unsafe {
            self.context.device.cmd_write_timestamp2(
                self.commands,
                vk::PipelineStageFlags2::ALL_COMMANDS,
                self.queries,
                query,
            )
        }
    }

    fn barrier(
        &self,
        source: vk::PipelineStageFlags2,
        source_access: vk::AccessFlags2,
        target: vk::PipelineStageFlags2,
        target_access: vk::AccessFlags2,
    ) {
        let barriers = [vk::MemoryBarrier2::default()
            .src_stage_mask(source)
            .src_access_mask(source_access)
            .dst_stage_mask(target)
            .dst_access_mask(target_access)];
        let info = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: the command buffer is being recorded, outside of rendering.
        unsafe { self.context.device.cmd_pipeline_barrier2(self.commands, &info) };
    }

    fn upload<T: Glsl>(&mut self, data: &[T]) -> Read<T> {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let start = self.upload_used.next_multiple_of(16);
        let end = start + bytes.len();
        assert!(end <= UPLOAD_BYTES, "{} bytes do not fit the {UPLOAD_BYTES} that a frame can upload", bytes.len());
        self.upload_used = end;
        self.upload.host_mut()[start..end].copy_from_slice(bytes);
        Read::from(self.upload.raw().address + start as u64)
    }

    fn add_cpu_time(&mut self, name: &'static str, start: Instant) {
        self.times.push(PassTime {
            name,
            processor: Processor::Cpu,
            start_ms: (start - self.began).as_secs_f64() * 1e3,
            ms: start.elapsed().as_secs_f64() * 1e3,
        });
    }

    /// Converts the timestamps of the finished frame to [`PassTime`]s.
    fn collect_times(&mut self) -> Result<()> {
        let ticks = &mut self.ticks[..2 * self.pass_count];
        if ticks.is_empty() {
            return Ok(());
        }
        // SAFETY: all these queries were written by the frame that was waited for.
        unsafe { self.context.device.get_query_pool_results(self.queries, 0, ticks, vk::QueryResultFlags::TYPE_64) }
            .map_err(vulkan("read timestamps"))?;
        let ms = |ticks: u64| ticks as f64 * self.context.timestamp_period * 1e-6;
        let first = ticks[0];
        for (name, pair) in self.names.iter().zip(ticks.chunks_exact(2)) {
            self.times.push(PassTime {
                name,
                processor: Processor::Gpu,
                start_ms: self.submitted_ms + ms(pair[0].saturating_sub(first)),
                ms: ms(pair[1].saturating_sub(pair[0])),
            });
        }
        Ok(())
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        let device = &self.context.device;
        // SAFETY: `submit` waits, so no frame is in flight.
        unsafe {
            device.destroy_query_pool(self.queries, None);
            device.destroy_fence(self.fence, None);
            device.destroy_command_pool(self.pool, None);
        }
    }
}

impl Frame<'_> {
    /// Begins the declaration of a pass.
    pub fn pass(&mut self, name: &'static str) -> Pass<'_> {
        self.frames.accesses.clear();
        Pass { frames: self.frames, name, sampled: None }
    }

    /// Runs a CPU stage and records its time like that of a pass.
    pub fn cpu<R>(&mut self, name: &'static str, stage: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = stage();
        self.frames.add_cpu_time(name, start);
        result
    }

    /// Uploads a few elements for kernels of this frame.
    pub fn upload<T: Glsl>(&mut self, data: &[T]) -> Read<T> {
        self.frames.upload(data)
    }

    /// Number of further passes that fit into this frame.
    pub fn passes_left(&self) -> usize {
        MAX_PASSES - self.frames.pass_count
    }

    /// Runs a pass on the host, after all passes before it and before those that follow. Only on devices whose kernels
    /// run on the CPU; see [`HostPass`].
    pub fn host_pass(&mut self, name: &'static str, run: impl FnOnce(&HostPass)) -> Result<()> {
        let frames = &mut *self.frames;
        assert!(
            frames.context.is_cpu(),
            "pass {name:?} is on the host, but kernels run on {}",
            frames.context.info.name
        );
        assert!(frames.presenting.is_none(), "pass {name:?} comes after what is presented");
        if frames.submitted < frames.pass_count {
            frames.submit(None)??;
            frames.record()?;
            frames.synced = frames.pass_count;
        }
        frames.accesses.clear();
        let start = Instant::now();
        run(&HostPass { frames: RefCell::new(frames), name });
        self.frames.add_cpu_time(name, start);
        Ok(())
    }

    /// Submits the frame and waits until it is finished.
    pub fn finish(self) -> Result<()> {
        self.frames.submit(None)??;
        self.frames.collect_times()
    }

    /// Like [`Frame::finish`], and presents on `surface` what [`Frame::draw`] drew.
    pub fn finish_on(self, surface: &mut Surface) -> Result<()> {
        let shown = self.frames.submit(Some(surface))?;
        self.frames.collect_times()?;
        shown
    }

    pub(super) fn context(&self) -> &Arc<Context> {
        &self.frames.context
    }

    /// The command buffer, which is being recorded.
    pub(super) fn commands(&self) -> vk::CommandBuffer {
        self.frames.commands
    }

    /// Records that the frame draws into a window's image.
    pub(super) fn will_present(&mut self, presenting: Presenting) {
        self.frames.presenting = Some(presenting);
    }
}

impl Pass<'_> {
    /// Declares that the pass reads `buffer`.
    pub fn read<T: Glsl>(&mut self, buffer: &Buffer<T>) -> Read<T> {
        Read::from(self.frames.touch(self.name, buffer.raw(), Touch::Read))
    }

    /// Declares that the pass writes `buffer`, and perhaps reads what earlier passes or the same thread wrote.
    pub fn write<T: Glsl>(&mut self, buffer: &Buffer<T>) -> Write<T> {
        Write::from(self.frames.touch(self.name, buffer.raw(), Touch::Write))
    }

    /// Declares that the pass writes `buffer`, and that threads of a workgroup read what others of it wrote.
    pub fn exchange<T: Glsl>(&mut self, buffer: &Buffer<T>) -> Exchange<T> {
        Exchange::from(self.frames.touch(self.name, buffer.raw(), Touch::Write))
    }

    /// Like [`Pass::read`], for a kernel that reinterprets the elements as another type.
    pub fn read_as<T: Glsl, U: Glsl>(&mut self, buffer: &Buffer<T>) -> Read<U> {
        Read::from(self.frames.touch(self.name, buffer.raw(), Touch::Read))
    }

    /// Like [`Pass::write`], for a kernel that reinterprets the elements as another type.
    pub fn write_as<T: Glsl, U: Glsl>(&mut self, buffer: &Buffer<T>) -> Write<U> {
        Write::from(self.frames.touch(self.name, buffer.raw(), Touch::Write))
    }

    /// Declares that the kernel samples `depth`, which is bound to set 0.
    pub fn sample(&mut self, depth: &DepthArray) {
        self.frames.touch_id(self.name, depth.id, &depth.name, Touch::Read);
        self.sampled = Some(depth.set);
    }

    /// Runs `kernel` with at least `thread_count` threads; the kernel itself discards the excess ones.
    pub fn dispatch<P: Push<Pipeline = Compute>>(self, kernel: &Kernel<P>, push: &P, thread_count: u32) {
        let groups = thread_count.div_ceil(GROUP_SIZE).max(1);
        let columns = groups.min(MAX_COLUMNS);
        self.launch(kernel, push, [columns, groups.div_ceil(columns)]);
    }

    /// Runs `kernel` with a workgroup for each tile of a picture of `size` pixels: workgroup and tile have the same
    /// column and row, and a thread finds its pixel without a division.
    pub fn dispatch_tiles<P: Push<Pipeline = Compute>>(self, kernel: &Kernel<P>, push: &P, size: [u32; 2]) {
        const { assert!(TILE_SIZE * TILE_SIZE == GROUP_SIZE) };
        self.launch(kernel, push, size.map(|pixels| pixels.div_ceil(TILE_SIZE).max(1)));
    }

    fn launch<P: Push<Pipeline = Compute>>(self, kernel: &Kernel<P>, push: &P, [columns, rows]: [u32; 2]) {
        let Self { frames, name, sampled } = self;
        frames.begin_pass(name);
        let device = &frames.context.device;
        let layout = frames.context.pipeline_layout;
        let stages = vk::ShaderStageFlags::COMPUTE | vk::ShaderStageFlags::VERTEX | vk::ShaderStageFlags::FRAGMENT;
        // SAFETY: the command buffer is being recorded. Addresses in `push` come from declared buffers; their owners,
        // such as the relighter, drop them only after `finish`.
        unsafe {
            device.cmd_bind_pipeline(frames.commands, vk::PipelineBindPoint::COMPUTE, kernel.pipeline());
            device.cmd_push_constants(frames.commands, layout, stages, 0, bytemuck::bytes_of(push));
            if let Some(set) = sampled {
                let bind_point = vk::PipelineBindPoint::COMPUTE;
                device.cmd_bind_descriptor_sets(frames.commands, bind_point, layout, 0, &[set], &[]);
            }
            device.cmd_dispatch(frames.commands, columns, rows, 1);
        }
        frames.end_pass(name);
    }

    /// Declares that the pass draws into `depth`.
    pub(super) fn write_depth(&mut self, depth: &DepthArray) {
        self.frames.touch_id(self.name, depth.id, &depth.name, Touch::Write);
    }

    /// Records commands other than a dispatch; see [`super::raster`] and [`super::present`].
    pub(super) fn record(self, record: impl FnOnce(&Context, vk::CommandBuffer)) {
        let Self { frames, name, .. } = self;
        frames.begin_pass(name);
        record(&frames.context, frames.commands);
        frames.end_pass(name);
    }
}

impl HostPass<'_> {
    /// Declares that the pass reads `buffer`, and returns its contents as floats.
    pub fn read<'p, T: Glsl>(&'p self, buffer: &'p Buffer<T>) -> &'p [f32] {
        if buffer.raw().access != Access::Device {
            self.frames.borrow_mut().touch(self.name, buffer.raw(), Touch::Read);
            return bytemuck::cast_slice(buffer.host());
        }
        let (start, count) = self.borrow(buffer, Touch::Read);
        // SAFETY: as in `write`.
        unsafe { std::slice::from_raw_parts(start.as_ptr(), count) }
    }

    /// Declares that the pass writes `buffer`, and perhaps reads what earlier passes wrote. Returns its contents as
    /// floats.
    #[allow(clippy::mut_from_ref, reason = "each buffer is lent once")]
    pub fn write<'p, T: Glsl>(&'p self, buffer: &'p Buffer<T>) -> &'p mut [f32] {
        let (start, count) = self.borrow(buffer, Touch::Write);
        // SAFETY: the memory is mapped as long as the buffer lives, and all bits are floats. Nobody else has a slice of
        // it: `host` and `host_mut` refuse buffers of the device, and `borrow` a second one until this pass ends. No
        // kernel accesses it: frames waited for those before this pass, and buffers are passed to no other frame
        // meanwhile.
        unsafe { std::slice::from_raw_parts_mut(start.as_ptr(), count) }
    }

    fn borrow<T: Glsl>(&self, buffer: &Buffer<T>, touch: Touch) -> (NonNull<f32>, usize) {
        let mut frames = self.frames.borrow_mut();
        frames.touch(self.name, buffer.raw(), touch);
        if !frames.has_lent(buffer.raw()) {
            let was_lent = buffer.raw().lent.swap(true, Ordering::AcqRel);
            assert!(!was_lent, "{:?} is lent to another pass", buffer.raw().name);
            frames.lent.push(buffer.raw().lent.clone());
        }
        (buffer.raw().mapped_floats(), buffer.len() * size_of::<T>() / size_of::<f32>())
    }
}

impl Drop for HostPass<'_> {
    fn drop(&mut self) {
        let frames = self.frames.get_mut();
        frames.lent.drain(..).for_each(|lent| lent.store(false, Ordering::Release));
    }
}
