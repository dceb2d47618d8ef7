//! The rays of a packet in registers, and boxes against them.

use glam::Vec3;
use pulp::Simd;

use super::{Lanes, PACKET_SIZE, SamplePacket};
use crate::bake::bvh::Bvh;
use crate::shared::PackedLight;

/// The rays of one packet.
///
/// From a point: origin shared (the light), `q` the vectors to the samples, hits count between parameters 0 and 1.
/// Directional: direction shared (towards the light), `q` the samples, hits count from parameter 0 on.
pub(super) struct Rays {
    pub q: [Lanes; 3],
    /// 1/q; only for points.
    pub inverse_q: [Lanes; 3],
    /// End of the ray: 1 while it has hit nothing, else negative, so that it meets no box.
    pub end: Lanes,
    /// Box around the `q` of all live rays: its centre, and half its size.
    pub center: Vec3,
    pub half: Vec3,
    /// The pyramid around all live rays from a point, if they advance along a common axis.
    pub pyramid: Option<Pyramid>,
}

/// Rays from a point along one axis, between two slopes in the others; most boxes are told from it without a look at
/// single rays [Reshetov 2005].
#[derive(Clone, Copy)]
pub(super) struct Pyramid {
    /// The axis along which all rays advance, and the others.
    axes: [usize; 3],
    /// Which way along it.
    sign: f32,
    /// How far.
    end: f32,
    /// Slopes in the other two axes, a little widened.
    slopes: [(f32, f32); 2],
}

impl Pyramid {
    /// Around the live rays, whose `q` lie in a box.
    #[inline(always)]
    fn new<S: Simd>(simd: S, rays: &Rays, lo: Vec3, hi: Vec3) -> Option<Self> {
        let center = (lo + hi).abs();
        let axes = match () {
            _ if center.x >= center.y && center.x >= center.z => [0, 1, 2],
            _ if center.y >= center.z => [1, 2, 0],
            _ => [2, 0, 1],
        };
        let sign = 1f32.copysign(lo[axes[0]] + hi[axes[0]]);
        let (near, end) = if sign > 0.0 { (lo[axes[0]], hi[axes[0]]) } else { (-hi[axes[0]], -lo[axes[0]]) };
        if near <= 0.0 {
            return None;
        }
        let inverse = S::as_simd_f32s(&rays.inverse_q[axes[0]]).0;
        let ends = S::as_simd_f32s(&rays.end).0;
        let slopes = [axes[1], axes[2]].map(|axis| {
            let q = S::as_simd_f32s(&rays.q[axis]).0;
            let (mut low, mut high) = (simd.splat_f32s(f32::MAX), simd.splat_f32s(f32::MIN));
            for register in 0..q.len() {
                let slope = simd.mul_f32s(simd.mul_f32s(q[register], inverse[register]), simd.splat_f32s(sign));
                let live = simd.less_than_f32s(simd.splat_f32s(0.0), ends[register]);
                low = simd.select_f32s(live, simd.min_f32s(low, slope), low);
                high = simd.select_f32s(live, simd.max_f32s(high, slope), high);
            }
            let (low, high) = (simd.reduce_min_f32s(low), simd.reduce_max_f32s(high));
            let slack = 1e-6 * (low.abs() + high.abs());
            (low - slack, high + slack)
        });
        Some(Self { axes, sign, end, slopes })
    }

    /// Whether the pyramid surely passes by a box given relative to its tip.
    #[inline(always)]
    pub fn misses(&self, lo: Vec3, hi: Vec3) -> bool {
        let [along, u, v] = self.axes;
        let (near, far) = if self.sign > 0.0 { (lo[along], hi[along]) } else { (-hi[along], -lo[along]) };
        let (near, far) = (near.max(0.0), far.min(self.end) * SLACK);
        let passes = |axis: usize, (low, high): (f32, f32)| {
            let low = if low < 0.0 { low * far } else { low * near };
            let high = if high < 0.0 { high * near } else { high * far };
            low > hi[axis] || high < lo[axis]
        };
        near > far || passes(u, self.slopes[0]) || passes(v, self.slopes[1])
    }
}

/// Sets up rays to samples that face the light and lie in its cone and range; the others stay dead.
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
    for axis in 0..3 {
        let q = S::as_simd_f32s(&rays.q[axis]).0;
        let end = S::as_simd_f32s(&rays.end).0;
        let inverse = S::as_mut_simd_f32s(&mut rays.inverse_q[axis]).0;
        let (mut lo, mut hi) = (simd.splat_f32s(f32::MAX), simd.splat_f32s(f32::MIN));
        for register in 0..q.len() {
            let q = q[register];
            // Parallel to a slab: a huge number instead of infinity, so that no 0 * inf arises.
            let parallel = simd.less_than_f32s(simd.abs_f32s(q), simd.splat_f32s(1e-30));
            let divisor = simd.select_f32s(parallel, simd.splat_f32s(1e-30), q);
            inverse[register] = simd.div_f32s(simd.splat_f32s(1.0), divisor);
            let live = simd.less_than_f32s(simd.splat_f32s(0.0), end[register]);
            lo = simd.select_f32s(live, simd.min_f32s(lo, q), lo);
            hi = simd.select_f32s(live, simd.max_f32s(hi, q), hi);
        }
        let (lo, hi) = (simd.reduce_min_f32s(lo), simd.reduce_max_f32s(hi));
        rays.center[axis] = (lo + hi) / 2.0;
        rays.half[axis] = (hi - lo) / 2.0;
    }
    let (lo, hi) = (rays.center - rays.half, rays.center + rays.half);
    rays.pyramid = if DIRECTIONAL { None } else { Pyramid::new(simd, rays, lo, hi) };
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

/// Whether any live ray of a register, from a shared origin, meets the box given relative to it.
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

/// Whether any live ray of a register, in a shared direction from `q`, meets the box.
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
    // Without an end while it lives.
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
