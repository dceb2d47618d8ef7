//! A triangle tested against the rays of a packet.

use glam::{Vec2, Vec3};
use pulp::Simd;

use super::Lanes;
use super::rays::{Rays, any, any_positive, load};
use crate::trace::bvh::MIN_TRANSMITTANCE;

/// A triangle in the form that all rays of a packet test: edge function i of a ray is `normals[i] . q + offsets[i]`; it
/// belongs to the edge opposite corner i. All three have the same sign if the ray's line hits the triangle [Kensler
/// 2006].
///
/// Each edge enters as its sum and difference: rounding is relative to the edge's length, and a neighbour, which has
/// the corners in the other order, gets exactly the negative.
pub(super) struct Edges {
    normals: [Vec3; 3],
    /// Zero with a common origin.
    offsets: [f32; 3],
    /// The plane: normal . x = plane_offset, x relative to a common origin.
    normal: Vec3,
    pub plane_offset: f32,
    /// normal . common direction; only for directional lights.
    along: f32,
}

impl Edges {
    #[inline(always)]
    pub fn new<const DIRECTIONAL: bool>(shared: Vec3, corners: [Vec3; 3]) -> Self {
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

    /// Whether rays from a common origin hit the triangle from behind, along its geometric normal.
    #[inline(always)]
    pub fn is_behind(&self) -> bool {
        self.plane_offset > 0.0
    }

    /// Weights of the second and third corner, and the distance, where a ray from a common origin hits the triangle.
    pub fn meet(&self, q: Vec3) -> Option<(Vec2, f32)> {
        let (w, inside) = self.edge_functions(q);
        let distance = self.plane_offset / self.normal.dot(q);
        let barycentric = Vec2::new(w[1], w[2]) / (w[0] + w[1] + w[2]);
        (inside && distance > 0.0 && barycentric.is_finite()).then_some((barycentric, distance))
    }

    /// Edge functions and normal . q for a register of rays from a common origin.
    #[inline(always)]
    pub fn functions<S: Simd>(&self, simd: S, rays: &Rays, register: usize) -> ([S::f32s; 3], S::f32s) {
        let q = [0, 1, 2].map(|axis| load::<S>(&rays.q[axis], register));
        let dot = |n: Vec3| dot(simd, n, q);
        ([dot(self.normals[0]), dot(self.normals[1]), dot(self.normals[2])], dot(self.normal))
    }

    /// The three edge functions of a ray, and whether its line hits the triangle.
    fn edge_functions(&self, q: Vec3) -> ([f32; 3], bool) {
        let w = [0, 1, 2].map(|k| self.normals[k].dot(q) + self.offsets[k]);
        (w, w.iter().all(|w| *w >= 0.0) || w.iter().all(|w| *w <= 0.0))
    }

    /// The three edge functions of a ray, and whether it hits the triangle between its ends.
    fn test<const DIRECTIONAL: bool>(&self, q: Vec3) -> ([f32; 3], bool) {
        let (w, inside) = self.edge_functions(q);
        let plane = self.normal.dot(q);
        let within = if DIRECTIONAL {
            (self.plane_offset - plane) * self.along > 0.0
        } else {
            self.plane_offset * plane > 0.0 && self.plane_offset.abs() < plane.abs()
        };
        (w, inside && within)
    }
}

#[inline(always)]
fn dot<S: Simd>(simd: S, n: Vec3, q: [S::f32s; 3]) -> S::f32s {
    let x = simd.mul_f32s(simd.splat_f32s(n.x), q[0]);
    let y = simd.mul_f32s(simd.splat_f32s(n.y), q[1]);
    let z = simd.mul_f32s(simd.splat_f32s(n.z), q[2]);
    simd.add_f32s(simd.add_f32s(x, y), z)
}

/// Ends the rays of a register that hit the triangle: [`Edges::test`] for a register. Returns whether any ray is still
/// active.
#[inline(always)]
pub(super) fn block<S: Simd, const DIRECTIONAL: bool>(
    simd: S,
    edges: &Edges,
    rays: &mut Rays,
    register: usize,
) -> bool {
    let q = [0, 1, 2].map(|axis| load::<S>(&rays.q[axis], register));
    let dot = |n: Vec3| dot(simd, n, q);
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
        return true; // most registers miss; unchanged, with an active ray
    }
    let plane = dot(edges.normal);
    let offset = simd.splat_f32s(edges.plane_offset);
    let within = if DIRECTIONAL {
        let ahead = simd.mul_f32s(simd.sub_f32s(offset, plane), simd.splat_f32s(edges.along));
        simd.less_than_f32s(zero, ahead)
    } else {
        // 0 < plane_offset / plane < 1, without a division.
        let ahead = simd.less_than_f32s(zero, simd.mul_f32s(offset, plane));
        simd.and_m32s(ahead, simd.less_than_f32s(simd.abs_f32s(offset), simd.abs_f32s(plane)))
    };
    let end = simd.select_f32s(simd.and_m32s(inside, within), simd.splat_f32s(-1.0), end);
    S::as_mut_simd_f32s(&mut rays.end).0[register] = end;
    any_positive(simd, end)
}

/// The same for triangles that transmit light: `blocked_share` is the blocked share at barycentric coordinates. A ray
/// ends if nothing of its share in `left` remains.
#[inline(never)]
pub(super) fn attenuate<const DIRECTIONAL: bool>(
    edges: &Edges,
    rays: &mut Rays,
    left: &mut Lanes,
    register: usize,
    lanes: usize,
    blocked_share: impl Fn(Vec2) -> f32,
) -> bool {
    let mut any = false;
    for (i, left) in left.iter_mut().enumerate().skip(register * lanes).take(lanes) {
        let (w, hit) = edges.test::<DIRECTIONAL>(Vec3::new(rays.q[0][i], rays.q[1][i], rays.q[2][i]));
        if hit && rays.end[i] > 0.0 {
            let now = *left * (1.0 - blocked_share(Vec2::new(w[1], w[2]) / (w[0] + w[1] + w[2])));
            if now < MIN_TRANSMITTANCE {
                rays.end[i] = -1.0;
            } else {
                *left = now;
            }
        }
        any |= rays.end[i] > 0.0;
    }
    any
}
