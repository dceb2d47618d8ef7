//! Peak rates of this device, measured with kernels of known work, for comparison with other kernels.

use std::sync::Arc;

use glam::{Vec3, Vec4};

use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frames, Kernel};
use crate::shared::{MAX_TERMS, SumImagesPush, SumTerm, YardstickPush};

/// Kernels and buffers for the measurements.
pub struct Roofline {
    frames: Frames,
    yardstick: Kernel<YardstickPush>,
    sum_images: Kernel<SumImagesPush>,
    samples: Buffer<Vec4>,
    results: Buffer<f32>,
    source: Buffer<Vec4>,
    copy: Buffer<Vec4>,
}

/// Scalar multiply-adds per sample of the yardstick kernel.
pub const YARDSTICK_MULTIPLY_ADDS: u32 = 128;
/// Enough work that the time of memory accesses is negligible.
const MANY_MULTIPLY_ADDS: u32 = 4096;
/// vec4s per plane of the copied image: 96 MiB in all, more than a cache.
const COPY_PLANE: usize = 2 << 20;

impl Roofline {
    /// `sample_count`: samples that the yardstick kernel processes.
    pub fn new(context: &Arc<Context>, sample_count: usize) -> Result<Self> {
        let samples: Vec<Vec4> = (0..2 * sample_count).map(|i| Vec4::splat(1.0 / (1 + i % 7) as f32)).collect();
        Ok(Self {
            frames: Frames::new(context)?,
            yardstick: Kernel::new(context, ())?,
            sum_images: Kernel::new(context, ())?,
            samples: Buffer::from_slice(context, "yardstick samples", &samples)?,
            results: Buffer::new(context, "yardstick results", Access::Device, 3 * sample_count)?,
            source: Buffer::from_slice(context, "yardstick image", &vec![Vec4::ONE; 3 * COPY_PLANE])?,
            copy: Buffer::new(context, "yardstick copy", Access::Device, 3 * COPY_PLANE)?,
        })
    }

    /// Milliseconds of the yardstick kernel, which reads 32 bytes, does 128 multiply-adds and writes 12 bytes per
    /// sample.
    pub fn yardstick_ms(&mut self) -> Result<f64> {
        self.multiply_add_ms(YARDSTICK_MULTIPLY_ADDS)
    }

    /// Arithmetic rate in GFLOP/s; a multiply-add counts as two operations.
    pub fn fma_gflop_s(&mut self) -> Result<f64> {
        let ms = self.multiply_add_ms(MANY_MULTIPLY_ADDS)?;
        let operations = 2.0 * f64::from(MANY_MULTIPLY_ADDS) * (self.samples.len() / 2) as f64;
        Ok(operations / ms * 1e-6)
    }

    /// Memory bandwidth in GB/s, the sum of bytes read and written.
    pub fn copy_gb_s(&mut self) -> Result<f64> {
        let mut frame = self.frames.begin()?;
        let mut pass = frame.pass("copy");
        let mut terms: [SumTerm; MAX_TERMS as usize] = bytemuck::Zeroable::zeroed();
        terms[0] = SumTerm { image: pass.read(&self.source), scale: Vec3::ONE, unused: 0 };
        let push = SumImagesPush {
            terms,
            sum: pass.write(&self.copy),
            term_count: 1,
            plane_length: COPY_PLANE as u32,
            kept: 0.0,
            unused: 0,
        };
        pass.dispatch(&self.sum_images, &push, 3 * push.plane_length);
        frame.finish()?;
        let bytes = 2.0 * 16.0 * 3.0 * COPY_PLANE as f64;
        Ok(bytes / self.frames.times()[0].ms * 1e-6)
    }

    fn multiply_add_ms(&mut self, multiply_adds: u32) -> Result<f64> {
        let mut frame = self.frames.begin()?;
        let mut pass = frame.pass("yardstick");
        let push = YardstickPush {
            samples: pass.read(&self.samples),
            results: pass.write(&self.results),
            sample_count: (self.samples.len() / 2) as u32,
            multiply_adds,
        };
        pass.dispatch(&self.yardstick, &push, push.sample_count);
        frame.finish()?;
        Ok(self.frames.times()[0].ms)
    }
}
