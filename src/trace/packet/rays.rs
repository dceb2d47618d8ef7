//! The rays of a packet in registers, and their box tests.

use glam::Vec3;
use pulp::Simd;

use super::{Lanes, PACKET_SIZE, SamplePacket};
use crate::shared::PackedLight;
use crate::trace::bvh::Bvh;

/// The rays of one packet.
///
/// - Point or spot light: common origin (the light), `q` the vectors to the samples, hits between parameters 0 and 1.
/// - Directional light: common direction (towards the light), `q` the samples, hits from parameter 0.
/// - In a [`super::common_origin::CommonOriginPacket`]: common origin, `q` the directions, hits between 0 and `end`.
pub(super) struct Rays {
    pub q: [Lanes; 3],
    /// 1/q; only with a common origin.
    pub inverse_q: [Lanes; 3],
    /// End of the ray. 1 for an active shadow ray; negative once a ray has ended, so that it hits no box.
    pub end: Lanes,
}

/// Sets up rays to samples that face the light and are in its cone and range; the others stay inactive.
#[inline(always)]
pub(super) fn start_rays<S: Simd, const DIRECTIONAL: bool>(
    simd: S,
    bvh: &Bvh,
    light: &PackedLight,
    packet: &SamplePacket,
    rays: &mut Rays,
) {
    let origin = if DIRECTIONAL { Vec3::ZERO } else { light.position };
    let [qx, qy, qz] = &mut rays.q;
    for i in 0..PACKET_SIZE {
        let (needed, target) = packet.target::<DIRECTIONAL>(bvh, light, i);
        (qx[i], qy[i], qz[i]) = (target[0] - origin.x, target[1] - origin.y, target[2] - origin.z);
        rays.end[i] = if needed { 1.0 } else { -1.0 };
    }
    inverse(simd, rays);
}

/// Sets 1/q.
#[inline(always)]
pub(super) fn inverse<S: Simd>(simd: S, rays: &mut Rays) {
    for (q, inverse) in rays.q.iter().zip(&mut rays.inverse_q) {
        for (q, inverse) in S::as_simd_f32s(q).0.iter().zip(S::as_mut_simd_f32s(inverse).0) {
            // Parallel to a slab: a huge number instead of infinity, so that 0 * inf does not occur.
            let parallel = simd.less_than_f32s(simd.abs_f32s(*q), simd.splat_f32s(1e-30));
            let divisor = simd.select_f32s(parallel, simd.splat_f32s(1e-30), *q);
            *inverse = simd.div_f32s(simd.splat_f32s(1.0), divisor);
        }
    }
}

#[inline(always)]
pub(super) fn any<S: Simd>(simd: S, mask: S::m32s) -> bool {
    simd.first_true_m32s(mask) < S::F32_LANES
}

#[inline(always)]
pub(super) fn any_positive<S: Simd>(simd: S, a: S::f32s) -> bool {
    any(simd, simd.less_than_f32s(simd.splat_f32s(0.0), a))
}

#[inline(always)]
pub(super) fn load<S: Simd>(lanes: &Lanes, register: usize) -> S::f32s {
    S::as_simd_f32s(lanes).0[register]
}

/// Enlarges the far end of a box by four roundings [Ize 2013].
const SLACK: f32 = 1.0 + 4.0 * f32::EPSILON;

/// Whether any active ray of a register, from a common origin, hits the box; `lo` and `hi` are relative to the origin.
#[inline(always)]
pub(super) fn meets_box<S: Simd>(simd: S, rays: &Rays, register: usize, lo: Vec3, hi: Vec3) -> bool {
    let mut near = simd.splat_f32s(0.0);
    let mut far = load::<S>(&rays.end, register);
    for axis in 0..3 {
        let inverse = load::<S>(&rays.inverse_q[axis], register);
        let a = simd.mul_f32s(simd.splat_f32s(lo[axis]), inverse);
        let b = simd.mul_f32s(simd.splat_f32s(hi[axis]), inverse);
        near = simd.max_f32s(near, simd.min_f32s(a, b));
        far = simd.min_f32s(far, simd.max_f32s(a, b));
    }
    any(simd, simd.less_than_or_equal_f32s(near, simd.mul_f32s(far, simd.splat_f32s(SLACK))))
}

/// Whether any active ray of a register, in a common direction from `q`, hits the box.
#[inline(always)]
pub(super) fn meets_box_along<S: Simd>(
    simd: S,
    rays: &Rays,
    register: usize,
    lo: Vec3,
    hi: Vec3,
    inverse: Vec3,
) -> bool {
    let mut near = simd.splat_f32s(0.0);
    // Active rays have no end.
    let mut far = simd.mul_f32s(load::<S>(&rays.end, register), simd.splat_f32s(f32::MAX));
    for axis in 0..3 {
        let q = load::<S>(&rays.q[axis], register);
        let inverse = simd.splat_f32s(inverse[axis]);
        let a = simd.mul_f32s(simd.sub_f32s(simd.splat_f32s(lo[axis]), q), inverse);
        let b = simd.mul_f32s(simd.sub_f32s(simd.splat_f32s(hi[axis]), q), inverse);
        near = simd.max_f32s(near, simd.min_f32s(a, b));
        far = simd.min_f32s(far, simd.max_f32s(a, b));
    }
    any(simd, simd.less_than_or_equal_f32s(near, simd.mul_f32s(far, simd.splat_f32s(SLACK))))
}
