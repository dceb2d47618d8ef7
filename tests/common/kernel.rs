//! What tests of kernels share: how a pass is run, what it writes into, what float32 may be off by.

use glam::DVec3;
use relume::gpu::{Access, Buffer, Frame, Frames};

use super::Gpu;

/// Half a unit in the last place of 1.
pub const ROUNDING: f64 = 1.0 / 16_777_216.0;
/// What a dot or cross product of unit vectors, each decoded or normalised in float32, may be off by: eight roundings.
pub const ANGLE: f64 = 8.0 * ROUNDING;
/// Stands in memory that a kernel must write, or must not.
pub const SENTINEL: f32 = -1234.5;

/// Sizes that are one element, less than a subgroup, around a workgroup, and many workgroups and a bit.
pub const RAGGED: [usize; 7] = [1, 3, 63, 64, 65, 130, 10_007];

/// Records one frame and waits for it.
pub fn run(frames: &mut Frames, record: impl FnOnce(&mut Frame)) {
    let mut frame = frames.begin().unwrap();
    record(&mut frame);
    frame.finish().unwrap();
}

/// Room for `len` floats and as many again behind, all sentinels.
pub fn output(gpu: &Gpu, len: usize) -> Buffer<f32> {
    let mut buffer = Buffer::new(gpu, "test output", Access::HostReads, len + 64).unwrap();
    buffer.host_mut().fill(SENTINEL);
    buffer
}

/// Pixel `i` of three planes.
pub fn pixel(planes: &[f32], stride: usize, i: usize) -> DVec3 {
    DVec3::new(planes[i].into(), planes[i + stride].into(), planes[i + 2 * stride].into())
}
