//! Counts what no pass may leave behind: infinities and what is not a number. Nothing is clamped.

use std::sync::Arc;

use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::shared::CountNonFinitePush;
use crate::shared::gpu_struct::Glsl;

/// Passes that are looked after.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckedPass {
    ShadeLight,
    Transfer,
    Resolve,
    SumLights,
    /// To scene-linear pixels.
    Composite,
}

/// Names of [`CheckedPass`], in its order.
const NAMES: [&str; 5] = ["shade light", "transfer", "resolve", "sum lights", "composite"];
/// Counts of a light's step at most: of pixels and of extra samples after shading and transfer, of resolved pixels.
pub const PASSES_A_STEP: usize = 5;

pub struct FiniteCheck {
    kernel: Kernel<CountNonFinitePush>,
    counts: Buffer<u32>,
}

impl FiniteCheck {
    pub fn new(context: &Arc<Context>) -> Result<Self> {
        let mut counts = Buffer::new(context, "non-finite values", Access::HostWrites, NAMES.len())?;
        counts.host_mut().fill(0);
        Ok(Self { kernel: Kernel::new(context, ())?, counts })
    }

    /// Values so far, by pass; all frames are finished.
    pub fn counts(&self) -> Vec<(&'static str, u32)> {
        NAMES.into_iter().zip(self.counts.host().iter().copied()).collect()
    }

    /// Counts in an image's three planes: their first `length` floats, `stride` floats apart.
    pub fn planes<T: Glsl>(
        &self,
        frame: &mut Frame,
        checked: CheckedPass,
        image: &Buffer<T>,
        length: u32,
        stride: u32,
    ) {
        if length == 0 {
            return;
        }
        let mut pass = frame.pass("count non-finite");
        let push = CountNonFinitePush {
            values: pass.read_as(image),
            counts: pass.write(&self.counts),
            plane_length: length,
            plane_stride: stride,
            slot: checked as u32,
            unused: 0,
        };
        pass.dispatch(&self.kernel, &push, length);
    }
}
