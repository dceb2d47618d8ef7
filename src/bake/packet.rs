//! Shadow rays in packets of 64 that share the light: exact visibility, several times faster than single rays.
//!
//! A packet is 64 view samples that lie close together. All its rays start at the light (or run along it, if it is
//! directional), so that a triangle's three edge functions are made once for 64 rays, and testing a ray is four dot
//! products; two triangles that share an edge compute it from the same numbers, so no ray slips between them. Rays are
//! tested a register at a time, and a bit for each register tells whether any of its rays is still concerned. `pulp`
//! finds the widest registers of the machine; products and sums are rounded one by one, so that all give the same.

use glam::{Vec2, Vec3};
use obvhs::bvh2::node::Bvh2Node;
use pulp::{Simd, WithSimd};

use super::bvh::{Bvh, is_hole};
use crate::scene::Scene;
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_SPOT, PackedLight};

/// Rays in a packet.
pub const PACKET_SIZE: usize = 64;
type Lanes = [f32; PACKET_SIZE];
/// Lights further away than so many radii of the scene are traced ray by ray from the samples: what packets compute
/// relative to the light is rounded relative to its distance.
const FAR_RADII: f32 = 32.0;
/// A node to visit, and a bit for each register of rays that met its parent.
type Entry = (u32, u64);

/// 64 view samples as the tracer wants them, mesh space. Lanes without a sample have zero normals.
#[derive(Clone)]
pub struct SamplePacket {
    pub position: [Lanes; 3],
    /// Shading normal; zero where nothing is reflected.
    pub normal: [Lanes; 3],
    /// Geometric normal.
    pub geometric_normal: [Lanes; 3],
}

impl Default for SamplePacket {
    fn default() -> Self {
        let zero = [[0.0; PACKET_SIZE]; 3];
        Self { position: zero, normal: zero, geometric_normal: zero }
    }
}

/// Traces `packets` towards `light`. `visibility` gets 255 a sample that sees it and faces it, else 0; 64 a packet.
pub fn trace_packets(bvh: &Bvh, scene: &Scene, light: &PackedLight, packets: &[SamplePacket], visibility: &mut [u8]) {
    pulp::Arch::new().dispatch(TracePackets { bvh, scene, light, packets, visibility });
}

struct TracePackets<'a> {
    bvh: &'a Bvh,
    scene: &'a Scene,
    light: &'a PackedLight,
    packets: &'a [SamplePacket],
    visibility: &'a mut [u8],
}

impl WithSimd for TracePackets<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if is_far(self.bvh, self.light) {
            self.trace_singly();
        } else if self.light.kind == LIGHT_DIRECTIONAL {
            self.trace::<S, true>(simd);
        } else {
            self.trace::<S, false>(simd);
        }
    }
}

fn is_far(bvh: &Bvh, light: &PackedLight) -> bool {
    light.kind != LIGHT_DIRECTIONAL && light.position.length() > FAR_RADII * bvh.radius
}

impl TracePackets<'_> {
    fn trace_singly(self) {
        let Self { bvh, scene, light, packets, visibility } = self;
        for (packet, visibility) in packets.iter().zip(visibility.chunks_exact_mut(PACKET_SIZE)) {
            for (lane, visible) in visibility.iter_mut().enumerate() {
                let sees = |ray: ShadowRay| !bvh.occluded(scene, ray.origin, ray.direction, ray.length);
                *visible = if packet.shadow_ray(bvh, light, lane).is_some_and(sees) { 255 } else { 0 };
            }
        }
    }

    #[inline(always)]
    fn trace<S: Simd, const DIRECTIONAL: bool>(self, simd: S) {
        let Self { bvh, scene, light, packets, visibility } = self;
        let shared = if DIRECTIONAL { -light.direction } else { light.position };
        let mut stack = Vec::with_capacity(128);
        let zero = [[0.0; PACKET_SIZE]; 3];
        let end = [-1.0; PACKET_SIZE];
        let (center, half) = (Vec3::ZERO, Vec3::ZERO);
        let mut rays = Rays { q: zero, inverse_q: zero, end, center, half, pyramid: None };
        for (packet, visibility) in packets.iter().zip(visibility.chunks_exact_mut(PACKET_SIZE)) {
            start_rays::<S, DIRECTIONAL>(simd, bvh, light, packet, &mut rays);
            let mut alive = 0;
            for (register, end) in S::as_simd_f32s(&rays.end).0.iter().enumerate() {
                alive |= u64::from(any_positive(simd, *end)) << register;
            }
            if alive != 0 {
                traverse::<S, DIRECTIONAL>(simd, bvh, scene, shared, &mut rays, alive, &mut stack);
            }
            for (visible, end) in visibility.iter_mut().zip(&rays.end) {
                *visible = if *end > 0.0 { 255 } else { 0 };
            }
        }
    }
}

/// The rays of one packet.
///
/// From a point: origin shared (the light), `q` the vectors to the samples, hits count between parameters 0 and 1.
/// Directional: direction shared (towards the light), `q` the samples, hits count from parameter 0 on.
struct Rays {
    q: [Lanes; 3],
    /// 1/q; only for points.
    inverse_q: [Lanes; 3],
    /// End of the ray: 1 while it has hit nothing, else negative, so that it meets no box.
    end: Lanes,
    /// Box around the `q` of all live rays: its centre, and half its size.
    center: Vec3,
    half: Vec3,
    /// The pyramid around all live rays from a point, if they advance along a common axis.
    pyramid: Option<Pyramid>,
}

/// Rays from a point along one axis, between two slopes in the others; most boxes are told from it without a look at
/// single rays [Reshetov 2005].
#[derive(Clone, Copy)]
struct Pyramid {
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
    fn misses(&self, lo: Vec3, hi: Vec3) -> bool {
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

/// A ray from the light to a view sample, or from a sample towards a directional or far light.
pub struct ShadowRay {
    pub origin: Vec3,
    pub direction: Vec3,
    /// In lengths of `direction`.
    pub length: f32,
}

impl SamplePacket {
    /// The ray that [`trace_packets`] traces for one lane; `None` if it faces away from the light or lies outside of
    /// its cone or range.
    pub fn shadow_ray(&self, bvh: &Bvh, light: &PackedLight, lane: usize) -> Option<ShadowRay> {
        if light.kind == LIGHT_DIRECTIONAL {
            let (needed, origin) = self.target::<true>(bvh, light, lane);
            needed.then_some(ShadowRay { origin: origin.into(), direction: -light.direction, length: f32::INFINITY })
        } else {
            let (needed, target) = self.target::<false>(bvh, light, lane);
            let (origin, end) = match is_far(bvh, light) {
                true => (Vec3::from(target), light.position),
                false => (light.position, Vec3::from(target)),
            };
            needed.then_some(ShadowRay { origin, direction: end - origin, length: 1.0 })
        }
    }

    /// Whether the ray of a lane needs to be traced, and where it ends: off the surface, on the light's side.
    #[inline(always)]
    fn target<const DIRECTIONAL: bool>(&self, bvh: &Bvh, light: &PackedLight, i: usize) -> (bool, [f32; 3]) {
        let [px, py, pz] = [self.position[0][i], self.position[1][i], self.position[2][i]];
        let [nx, ny, nz] = [self.normal[0][i], self.normal[1][i], self.normal[2][i]];
        let [gx, gy, gz] = [self.geometric_normal[0][i], self.geometric_normal[1][i], self.geometric_normal[2][i]];
        let (l, d) = (light.position, light.direction);
        let (tx, ty, tz) = if DIRECTIONAL { (-d.x, -d.y, -d.z) } else { (l.x - px, l.y - py, l.z - pz) };
        let distance2 = tx * tx + ty * ty + tz * tz;
        let distance = distance2.sqrt();
        let facing = nx * tx + ny * ty + nz * tz > 0.0;
        // A little wider than the cone, whose edge is black.
        let cone = if light.kind == LIGHT_SPOT { 1.0 - light.cone_versine - 1e-5 } else { -2.0 };
        let inside = DIRECTIONAL | (-(tx * d.x + ty * d.y + tz * d.z) >= cone * distance);
        let in_range = DIRECTIONAL | (distance * light.inverse_range < 1.0);
        let offset = bvh.shadow_offset(if DIRECTIONAL { 0.0 } else { distance.min(FAR_RADII * bvh.radius) });
        let offset = if gx * tx + gy * ty + gz * tz < 0.0 { -offset } else { offset };
        (facing & inside & in_range, [px + gx * offset, py + gy * offset, pz + gz * offset])
    }
}

/// Sets up rays to samples that face the light and lie in its cone and range; the others stay dead.
#[inline(always)]
fn start_rays<S: Simd, const DIRECTIONAL: bool>(
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
fn any<S: Simd>(simd: S, mask: S::m32s) -> bool {
    simd.first_true_m32s(mask) < S::F32_LANES
}

#[inline(always)]
fn any_positive<S: Simd>(simd: S, a: S::f32s) -> bool {
    any(simd, simd.less_than_f32s(simd.splat_f32s(0.0), a))
}

#[inline(always)]
fn traverse<S: Simd, const DIRECTIONAL: bool>(
    simd: S,
    bvh: &Bvh,
    scene: &Scene,
    shared: Vec3,
    rays: &mut Rays,
    mut alive: u64,
    stack: &mut Vec<Entry>,
) {
    let nodes = &bvh.binary.nodes;
    let inverse_direction = shared.recip().clamp(Vec3::splat(-1e30), Vec3::splat(1e30));
    let meets = |node: &Bvh2Node, rays: &Rays, concerned: u64| {
        let bounds = node.aabb();
        let (lo, hi) = (Vec3::from(bounds.min), Vec3::from(bounds.max));
        if rays.pyramid.is_some_and(|pyramid| pyramid.misses(lo - shared, hi - shared)) {
            return 0;
        }
        let mut met = 0;
        let mut left = concerned;
        while left != 0 {
            let register = left.trailing_zeros() as usize;
            left &= left - 1;
            let meets = match DIRECTIONAL {
                false => meets_box(simd, rays, register, lo - shared, hi - shared),
                true => meets_box_along(simd, rays, register, lo, hi, inverse_direction),
            };
            met |= u64::from(meets) << register;
        }
        met
    };
    stack.clear();
    stack.push((0, alive));
    while let Some((node_index, concerned)) = stack.pop() {
        let node = &nodes[node_index as usize];
        let mut met = concerned & alive;
        let first = node.first_index;
        if !node.is_leaf() {
            for child in [first + 1, first] {
                let met = meets(&nodes[child as usize], rays, met);
                if met != 0 {
                    stack.push((child, met));
                }
            }
            continue;
        }
        for corners in &bvh.binary_corners[first as usize..(first + node.prim_count) as usize] {
            let edges = Edges::new::<DIRECTIONAL>(shared, corners.v);
            if edges.miss_all::<DIRECTIONAL>(rays) {
                continue;
            }
            let mut left = met;
            while left != 0 {
                let register = left.trailing_zeros() as usize;
                left &= left - 1;
                let some_left = if bvh.has_masks {
                    let hole = |barycentric| is_hole(scene, corners.triangle, barycentric);
                    block_unless_hole::<DIRECTIONAL>(&edges, rays, register, S::F32_LANES, hole)
                } else {
                    block::<S, DIRECTIONAL>(simd, &edges, rays, register)
                };
                if !some_left {
                    met &= !(1 << register);
                    alive &= !(1 << register);
                }
            }
            if met == 0 {
                break;
            }
        }
        if alive == 0 {
            return;
        }
    }
}

#[inline(always)]
fn load<S: Simd>(lanes: &Lanes, register: usize) -> S::f32s {
    S::as_simd_f32s(lanes).0[register]
}

/// Enlarges the far end of a box by four roundings [Ize 2013].
const SLACK: f32 = 1.0 + 4.0 * f32::EPSILON;

/// Whether any live ray of a register, from a shared origin, meets the box given relative to it.
#[inline(always)]
fn meets_box<S: Simd>(simd: S, rays: &Rays, register: usize, lo: Vec3, hi: Vec3) -> bool {
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
fn meets_box_along<S: Simd>(simd: S, rays: &Rays, register: usize, lo: Vec3, hi: Vec3, inverse: Vec3) -> bool {
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

/// A triangle as seen by all rays of a packet: edge function i of a ray is `normals[i] . q + offsets[i]`; it belongs to
/// the edge opposite to corner i. All three have one sign where the ray's line meets the triangle [Kensler 2006].
///
/// Each edge enters as its sum and difference: rounding is relative to the edge's length, and a neighbour, which has
/// the corners in the other order, gets exactly the negative.
struct Edges {
    normals: [Vec3; 3],
    /// Zero from a point.
    offsets: [f32; 3],
    /// The plane: normal . x = plane_offset, x relative to a shared origin.
    normal: Vec3,
    plane_offset: f32,
    /// normal . shared direction; only for directional.
    along: f32,
}

impl Edges {
    #[inline(always)]
    fn new<const DIRECTIONAL: bool>(shared: Vec3, corners: [Vec3; 3]) -> Self {
        let v = if DIRECTIONAL { corners } else { corners.map(|v| v - shared) };
        let normal = (v[1] - v[0]).cross(v[2] - v[0]);
        let edges = [(v[1], v[2]), (v[2], v[0]), (v[0], v[1])];
        let moments = edges.map(|(a, b)| (a + b).cross(b - a));
        let (normals, offsets) = match DIRECTIONAL {
            true => (edges.map(|(a, b)| 2.0 * shared.cross(b - a)), moments.map(|m| shared.dot(m))),
            false => (moments, [0.0; 3]),
        };
        Self { normals, offsets, normal, plane_offset: normal.dot(v[0]), along: normal.dot(shared) }
    }

    /// Whether every ray of the packet surely passes by, by interval arithmetic on the box around its `q`.
    #[inline(always)]
    fn miss_all<const DIRECTIONAL: bool>(&self, rays: &Rays) -> bool {
        // Where a ray meets the triangle ahead of its start, all edge functions have this sign.
        let facing = if DIRECTIONAL { self.along } else { self.plane_offset };
        let sign = 1f32.copysign(facing);
        (0..3).any(|k| {
            let (n, offset) = (self.normals[k], self.offsets[k]);
            let reach = n.abs().dot(rays.half);
            let middle = (n.dot(rays.center) + offset) * sign;
            // Slack for the rounding of both sides.
            middle + reach < -1e-6 * (n.abs().dot(rays.center.abs()) + reach + offset.abs())
        })
    }

    /// The three edge functions of a ray, and whether it meets the triangle within its ends.
    fn test<const DIRECTIONAL: bool>(&self, q: Vec3) -> ([f32; 3], bool) {
        let w = [0, 1, 2].map(|k| self.normals[k].dot(q) + self.offsets[k]);
        let inside = w.iter().all(|w| *w >= 0.0) || w.iter().all(|w| *w <= 0.0);
        let plane = self.normal.dot(q);
        let within = if DIRECTIONAL {
            (self.plane_offset - plane) * self.along > 0.0
        } else {
            self.plane_offset * plane > 0.0 && self.plane_offset.abs() < plane.abs()
        };
        (w, inside && within)
    }
}

/// Ends the rays of a register that meet the triangle. Returns whether any is left. [`Edges::test`], many at once.
#[inline(always)]
fn block<S: Simd, const DIRECTIONAL: bool>(simd: S, edges: &Edges, rays: &mut Rays, register: usize) -> bool {
    let q = [0, 1, 2].map(|axis| load::<S>(&rays.q[axis], register));
    let dot = |n: Vec3| {
        let x = simd.mul_f32s(simd.splat_f32s(n.x), q[0]);
        let y = simd.mul_f32s(simd.splat_f32s(n.y), q[1]);
        let z = simd.mul_f32s(simd.splat_f32s(n.z), q[2]);
        simd.add_f32s(simd.add_f32s(x, y), z)
    };
    let edge = |k: usize| match DIRECTIONAL {
        true => simd.add_f32s(dot(edges.normals[k]), simd.splat_f32s(edges.offsets[k])),
        false => dot(edges.normals[k]),
    };
    let (w0, w1, w2) = (edge(0), edge(1), edge(2));
    let low = simd.min_f32s(simd.min_f32s(w0, w1), w2);
    let high = simd.max_f32s(simd.max_f32s(w0, w1), w2);
    let zero = simd.splat_f32s(0.0);
    let inside = simd.or_m32s(simd.less_than_or_equal_f32s(zero, low), simd.less_than_or_equal_f32s(high, zero));
    let end = load::<S>(&rays.end, register);
    if !any(simd, simd.and_m32s(inside, simd.less_than_f32s(zero, end))) {
        return true; // most registers miss; it is left as it was, and some of it was alive
    }
    let plane = dot(edges.normal);
    let offset = simd.splat_f32s(edges.plane_offset);
    let within = if DIRECTIONAL {
        let ahead = simd.mul_f32s(simd.sub_f32s(offset, plane), simd.splat_f32s(edges.along));
        simd.less_than_f32s(zero, ahead)
    } else {
        // 0 < plane_offset / plane < 1, without the division.
        let ahead = simd.less_than_f32s(zero, simd.mul_f32s(offset, plane));
        simd.and_m32s(ahead, simd.less_than_f32s(simd.abs_f32s(offset), simd.abs_f32s(plane)))
    };
    let end = simd.select_f32s(simd.and_m32s(inside, within), simd.splat_f32s(-1.0), end);
    S::as_mut_simd_f32s(&mut rays.end).0[register] = end;
    any_positive(simd, end)
}

/// The same for triangles with holes: `hole` tells by barycentric coordinates.
#[inline(never)]
fn block_unless_hole<const DIRECTIONAL: bool>(
    edges: &Edges,
    rays: &mut Rays,
    register: usize,
    lanes: usize,
    hole: impl Fn(Vec2) -> bool,
) -> bool {
    let mut any = false;
    for i in register * lanes..(register + 1) * lanes {
        let (w, hit) = edges.test::<DIRECTIONAL>(Vec3::new(rays.q[0][i], rays.q[1][i], rays.q[2][i]));
        if hit && rays.end[i] > 0.0 && !hole(Vec2::new(w[1], w[2]) / (w[0] + w[1] + w[2])) {
            rays.end[i] = -1.0;
        }
        any |= rays.end[i] > 0.0;
    }
    any
}
