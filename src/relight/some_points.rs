//! What images of area lights are made of: some of a light's points, and what the image was with fewer.

use std::sync::Arc;

use glam::{Vec2, Vec4};

use super::light_images::light_image;
use crate::bake::DeepFramebuffer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::shared::CompareImagesPush;

/// Images that join the image of a light, and that it is compared with.
pub struct SomePoints {
    /// The mean over some points.
    pub mean: Buffer<Vec4>,
    /// The image with fewer points.
    pub checkpoint: Buffer<Vec4>,
    /// Of each thread.
    sums: Buffer<Vec2>,
    kernel: Kernel<CompareImagesPush>,
}

/// Vectors of four floats that a thread compares.
const A_THREAD: u32 = 64;

impl SomePoints {
    pub fn new(context: &Arc<Context>, framebuffer: &DeepFramebuffer) -> Result<Self> {
        let [mean, checkpoint] = ["points of a light", "a light with fewer points"]
            .map(|name| light_image(context, framebuffer, &format!("light images ({name})")));
        let mean = mean?;
        let threads = mean.len().div_ceil(A_THREAD as usize);
        Ok(Self {
            mean,
            checkpoint: checkpoint?,
            sums: Buffer::new(context, "sums of squares", Access::HostReads, threads)?,
            kernel: Kernel::new(context, ())?,
        })
    }

    /// Compares the image of a light with its checkpoint.
    pub fn compare(&self, frame: &mut Frame, image: &Buffer<Vec4>) {
        let mut pass = frame.pass("compare points");
        let push = CompareImagesPush {
            image: pass.read(image),
            other: pass.read(&self.checkpoint),
            sums: pass.write(&self.sums),
            count: image.len() as u32,
            threads: self.sums.len() as u32,
        };
        pass.dispatch(&self.kernel, &push, push.threads);
    }

    /// What the last comparison found: root mean square of the change, relative to that of the image. Zero for black
    /// images.
    pub fn change(&self) -> f32 {
        let [change, image] = [0, 1].map(|i| self.sums.host().iter().map(|sums| f64::from(sums[i])).sum::<f64>());
        if change > 0.0 { (change / image).sqrt() as f32 } else { 0.0 }
    }
}
