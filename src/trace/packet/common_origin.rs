//! Closest hits of rays with a common origin: final gathering, 64 directions at a time.
//!
//! Packets of shadow rays share the light; these share the gathering point: a triangle's edge functions and its visible
//! side are the same for all rays. Coherent packets are faster, so callers sort the directions.

use glam::{Vec2, Vec3};
use pulp::{Simd, WithSimd};

use super::rays::{Rays, any, inverse, load, meets_box};
use super::triangle::Edges;
use super::{Entry, Lanes, PACKET_SIZE};
use crate::trace::bvh::{Hit, TracedScene, passes_by_chance};

/// 64 rays from one point, and their hits.
pub struct CommonOriginPacket {
    /// `q` are the directions; `end` is the hit distance, infinite before a hit, negative in lanes without a ray.
    rays: Rays,
    /// Index into the mesh's triangles, with bit `BEHIND` for hits from behind.
    triangles: [u32; PACKET_SIZE],
    barycentric: [Lanes; 2],
}

/// Flag in a triangle's index: the hit is from behind, along the triangle's geometric normal.
const BEHIND: u32 = 1 << 31;

impl Default for CommonOriginPacket {
    fn default() -> Self {
        let zero = [0.0; PACKET_SIZE];
        let rays = Rays { q: [zero; 3], inverse_q: [zero; 3], end: [-1.0; PACKET_SIZE] };
        Self { rays, triangles: [0; PACKET_SIZE], barycentric: [zero; 2] }
    }
}

impl CommonOriginPacket {
    /// Sets the ray of a lane; its direction need not be unit length.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, direction: Vec3) {
        (0..3).for_each(|axis| self.rays.q[axis][lane] = direction[axis]);
        self.rays.end[lane] = f32::INFINITY;
    }

    /// Removes the ray of a lane.
    pub fn clear(&mut self, lane: usize) {
        self.rays.end[lane] = -1.0;
    }

    /// The direction of a lane's ray.
    #[inline(always)]
    pub fn direction(&self, lane: usize) -> Vec3 {
        Vec3::from([0, 1, 2].map(|axis| self.rays.q[axis][lane]))
    }

    /// The hit of a lane's ray, and whether it is from behind.
    #[inline(always)]
    pub fn hit(&self, lane: usize) -> Option<(Hit, bool)> {
        let distance = self.rays.end[lane];
        let id = self.triangles[lane];
        let barycentric = Vec2::new(self.barycentric[0][lane], self.barycentric[1][lane]);
        let hit = Hit { triangle: id & !BEHIND, barycentric, distance };
        (0.0..f32::INFINITY).contains(&distance).then_some((hit, id & BEHIND != 0))
    }
}

/// Traces the rays of `packets` from `origin` to their closest hits.
pub fn trace_common_origin(scene: &TracedScene, origin: Vec3, packets: &mut [CommonOriginPacket]) {
    pulp::Arch::new().dispatch(TraceFans { scene, origin, packets });
}

struct TraceFans<'a> {
    scene: &'a TracedScene,
    origin: Vec3,
    packets: &'a mut [CommonOriginPacket],
}

impl WithSimd for TraceFans<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { scene, origin, packets } = self;
        let mut stack: Vec<Entry> = Vec::with_capacity(128);
        for packet in packets {
            inverse(simd, &mut packet.rays);
            stack.push((0, u64::MAX >> (64 - PACKET_SIZE / S::F32_LANES)));
            traverse(simd, scene, origin, packet, &mut stack);
        }
    }
}

#[inline(always)]
fn traverse<S: Simd>(
    simd: S,
    scene: &TracedScene,
    origin: Vec3,
    packet: &mut CommonOriginPacket,
    stack: &mut Vec<Entry>,
) {
    let nodes = &scene.bvh.binary.nodes;
    let towards: Vec3 = [0, PACKET_SIZE / 2].iter().map(|&lane| packet.direction(lane)).sum();
    while let Some((index, concerned)) = stack.pop() {
        let node = &nodes[index as usize];
        // Tested when it is visited, not with its parent: rays may have ended before it in the meantime.
        let (lo, hi) = (node.min - origin, node.max - origin);
        let (mut met, mut left) = (0, concerned);
        while left != 0 {
            let register = left.trailing_zeros() as usize;
            left &= left - 1;
            met |= u64::from(meets_box(simd, &packet.rays, register, lo, hi)) << register;
        }
        if met == 0 {
            continue;
        }
        let first = node.first_index;
        if !node.is_leaf() {
            let [a, b] = [first, first + 1].map(|child| &nodes[child as usize]);
            let swap = ((b.min + b.max) - (a.min + a.max)).dot(towards) < 0.0;
            let [near, far] = if swap { [first + 1, first] } else { [first, first + 1] };
            stack.push((far, met));
            stack.push((near, met));
            continue;
        }
        for corners in &scene.bvh.binary_corners[first as usize..(first + node.prim_count) as usize] {
            let edges = Edges::new::<false>(origin, corners.v);
            let id = corners.triangle | if edges.is_behind() { BEHIND } else { 0 };
            let is_masked = scene.is_masked(corners.triangle);
            let mut left = met;
            while left != 0 {
                let register = left.trailing_zeros() as usize;
                left &= left - 1;
                if is_masked {
                    let passes = |at, direction| passes_by_chance(scene, corners.triangle, at, [origin, direction]);
                    meet_unless(&edges, id, packet, register, S::F32_LANES, passes);
                } else {
                    meet(simd, &edges, id, packet, register);
                }
            }
        }
    }
}

/// Ends the rays of a register where they hit the triangle.
#[inline(always)]
fn meet<S: Simd>(simd: S, edges: &Edges, id: u32, packet: &mut CommonOriginPacket, register: usize) {
    let (w, plane) = edges.functions(simd, &packet.rays, register);
    let (zero, end) = (simd.splat_f32s(0.0), load::<S>(&packet.rays.end, register));
    let low = simd.min_f32s(simd.min_f32s(w[0], w[1]), w[2]);
    let high = simd.max_f32s(simd.max_f32s(w[0], w[1]), w[2]);
    let inside = simd.or_m32s(simd.less_than_or_equal_f32s(zero, low), simd.less_than_or_equal_f32s(high, zero));
    // offset / plane < end without a division, because both have the same sign.
    let offset = simd.splat_f32s(edges.plane_offset);
    let ahead = simd.less_than_f32s(zero, simd.mul_f32s(offset, plane));
    let nearer = simd.less_than_f32s(simd.abs_f32s(offset), simd.mul_f32s(simd.abs_f32s(plane), end));
    let within = simd.and_m32s(simd.and_m32s(inside, ahead), nearer);
    if !any(simd, within) {
        return;
    }
    let sum = simd.add_f32s(simd.add_f32s(w[0], w[1]), w[2]);
    let within = simd.and_m32s(within, simd.less_than_f32s(zero, simd.abs_f32s(sum)));
    let set = |lanes: &mut Lanes, value: S::f32s| {
        let lanes = &mut S::as_mut_simd_f32s(lanes).0[register];
        *lanes = simd.select_f32s(within, value, *lanes);
    };
    set(&mut packet.rays.end, simd.div_f32s(offset, plane));
    set(&mut packet.barycentric[0], simd.div_f32s(w[1], sum));
    set(&mut packet.barycentric[1], simd.div_f32s(w[2], sum));
    let triangles = &mut S::as_mut_simd_u32s(&mut packet.triangles).0[register];
    *triangles = simd.select_u32s(within, simd.splat_u32s(id), *triangles);
}

/// The same for triangles that are not opaque: `passes` decides by barycentric coordinates and direction.
#[inline(never)]
fn meet_unless(
    edges: &Edges,
    id: u32,
    packet: &mut CommonOriginPacket,
    register: usize,
    lanes: usize,
    passes: impl Fn(Vec2, Vec3) -> bool,
) {
    for lane in register * lanes..(register + 1) * lanes {
        let direction = packet.direction(lane);
        let Some((barycentric, distance)) = edges.meet(direction) else { continue };
        if distance < packet.rays.end[lane] && !passes(barycentric, direction) {
            packet.rays.end[lane] = distance;
            packet.triangles[lane] = id;
            (0..2).for_each(|i| packet.barycentric[i][lane] = barycentric[i]);
        }
    }
}
