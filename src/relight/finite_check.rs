//! Counts infinite and NaN values in the results of passes. A correct pass writes none; nothing is clamped.
//!
//! Sums pass on what is not finite, so only the picture is checked until it has such a value. Then it is rendered
//! again, and the results of all passes are checked.

use std::sync::Arc;

use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::shared::CountNonFinitePush;
use crate::shared::gpu_struct::Glsl;

/// Passes whose results are checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckedPass {
    ShadeLight,
    Transfer,
    Resolve,
    SeenLights,
    SumLights,
    /// Only to scene-linear pixels.
    Composite,
}

/// Names of [`CheckedPass`], in its order.
const NAMES: [&str; 6] = ["shade light", "transfer", "resolve", "seen lights", "sum lights", "composite"];
/// Maximum number of counting passes per light: pixels and extra samples after shading, after transfer and after seen
/// lights, and resolved pixels.
pub const MAX_CHECKS_PER_STEP: usize = 7;

/// Kernel and counters.
pub struct FiniteCheck {
    kernel: Kernel<CountNonFinitePush>,
    counts: Buffer<u32>,
    /// Whether all passes are checked.
    is_thorough: bool,
}

impl FiniteCheck {
    pub fn new(context: &Arc<Context>) -> Result<Self> {
        let mut counts = Buffer::new(context, "non-finite values", Access::HostWrites, NAMES.len())?;
        counts.host_mut().fill(0);
        Ok(Self { kernel: Kernel::new(context, ())?, counts, is_thorough: false })
    }

    /// Checks all passes from now on, with new counts, if only pictures were checked and one had a value that is not
    /// finite. Returns whether it did. All frames must be finished.
    pub fn becomes_thorough(&mut self) -> bool {
        if self.is_thorough || self.counts.host().iter().all(|&count| count == 0) {
            return false;
        }
        self.counts.host_mut().fill(0);
        self.is_thorough = true;
        true
    }

    /// Number of non-finite values so far, by pass. All frames must be finished.
    pub fn counts(&self) -> Vec<(&'static str, u32)> {
        NAMES.into_iter().zip(self.counts.host().iter().copied()).collect()
    }

    /// Counts in the first `length` floats of an image's three planes, which are `stride` floats apart.
    pub fn planes<T: Glsl>(
        &self,
        frame: &mut Frame,
        checked: CheckedPass,
        image: &Buffer<T>,
        length: u32,
        stride: u32,
    ) {
        if length == 0 || !(self.is_thorough || checked == CheckedPass::Composite) {
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
