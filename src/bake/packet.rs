//! Shadow rays in packets of 64 that share the light: exact visibility, several times faster than single rays.
//!
//! A packet is 64 view samples that lie close together. All its rays start at the light (or run along it, if it is
//! directional), so that a triangle's three edge functions are made once for 64 rays, and testing a ray is three dot
//! products; two triangles that share an edge compute it from the same numbers, so no ray slips between them. Rays are
//! tested eight by eight; a bit for each eight tells whether any of them is still concerned. Plain safe Rust: the
//! compiler vectorises the inner loops for the best instruction set of the machine, which `pulp` finds while running.

use glam::{Vec2, Vec3};

use super::bvh::{Bvh, is_hole};
use crate::scene::Scene;
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_SPOT, PackedLight};

/// Rays in a packet.
pub const PACKET_SIZE: usize = 64;
/// Rays in a group: one AVX register.
const GROUP: usize = 8;
const GROUPS: usize = PACKET_SIZE / GROUP;
type Lanes = [f32; PACKET_SIZE];
/// A node to visit, and a bit for each group of rays that met its parent.
type Entry = (u32, u32);

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
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            let mut stack = Vec::with_capacity(128);
            for (packet, visibility) in packets.iter().zip(visibility.chunks_exact_mut(PACKET_SIZE)) {
                if light.kind == LIGHT_DIRECTIONAL {
                    trace_packet::<true>(bvh, scene, light, packet, &mut stack, visibility);
                } else {
                    trace_packet::<false>(bvh, scene, light, packet, &mut stack, visibility);
                }
            }
        },
    );
}

/// The rays of one packet.
///
/// From a point: origin shared (the light), `q` the vectors to the samples, hits count between parameters 0 and 1.
/// Directional: direction shared (towards the light), `q` the samples, hits count from parameter 0 on.
struct Rays {
    q: [Lanes; 3],
    /// 1/q; only for points.
    inverse_q: [Lanes; 3],
    /// End of the ray: 1 while it has hit nothing, else negative, so that it meets no box; only for points.
    end: Lanes,
}

#[inline(always)]
fn trace_packet<const DIRECTIONAL: bool>(
    bvh: &Bvh,
    scene: &Scene,
    light: &PackedLight,
    packet: &SamplePacket,
    stack: &mut Vec<Entry>,
    visibility: &mut [u8],
) {
    let mut rays = Rays { q: [[0.0; PACKET_SIZE]; 3], inverse_q: [[0.0; PACKET_SIZE]; 3], end: [-1.0; PACKET_SIZE] };
    start_rays::<DIRECTIONAL>(bvh, light, packet, &mut rays);
    let alive = alive_groups(&rays.end);
    if alive != 0 {
        let shared = if DIRECTIONAL { -light.direction } else { light.position };
        traverse::<DIRECTIONAL>(bvh, scene, shared, &mut rays, alive, stack);
    }
    for (visible, end) in visibility.iter_mut().zip(&rays.end) {
        *visible = if *end > 0.0 { 255 } else { 0 };
    }
}

/// A ray from the light to a view sample, or from a sample along a directional light.
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
            let origin = self.target::<true>(bvh, light, lane)?;
            Some(ShadowRay { origin: origin.into(), direction: -light.direction, length: f32::INFINITY })
        } else {
            let target = Vec3::from(self.target::<false>(bvh, light, lane)?);
            Some(ShadowRay { origin: light.position, direction: target - light.position, length: 1.0 })
        }
    }

    /// Where the ray of a lane ends: off the surface, on the light's side. `None` if it need not be traced.
    #[inline(always)]
    fn target<const DIRECTIONAL: bool>(&self, bvh: &Bvh, light: &PackedLight, i: usize) -> Option<[f32; 3]> {
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
        let offset = bvh.shadow_offset(if DIRECTIONAL { 0.0 } else { distance });
        let offset = if gx * tx + gy * ty + gz * tz < 0.0 { -offset } else { offset };
        (facing & inside & in_range).then_some([px + gx * offset, py + gy * offset, pz + gz * offset])
    }
}

/// Sets up rays to samples that face the light and lie in its cone and range; the others stay dead.
#[inline(always)]
fn start_rays<const DIRECTIONAL: bool>(bvh: &Bvh, light: &PackedLight, packet: &SamplePacket, rays: &mut Rays) {
    let origin = if DIRECTIONAL { Vec3::ZERO } else { light.position };
    for i in 0..PACKET_SIZE {
        let target = packet.target::<DIRECTIONAL>(bvh, light, i);
        let end = target.unwrap_or_default();
        for axis in 0..3 {
            let q = end[axis] - origin[axis];
            rays.q[axis][i] = q;
            // Parallel to a slab: a huge number with the right sign, so that no 0 * inf arises.
            rays.inverse_q[axis][i] = if q.abs() > 1e-30 { 1.0 / q } else { 1e30f32.copysign(q) };
        }
        rays.end[i] = if target.is_some() { 1.0 } else { -1.0 };
    }
}

#[inline(always)]
fn alive_groups(end: &Lanes) -> u32 {
    let mut alive = 0;
    for group in 0..GROUPS {
        let mut any = false;
        for i in group * GROUP..(group + 1) * GROUP {
            any |= end[i] > 0.0;
        }
        alive |= u32::from(any) << group;
    }
    alive
}

#[inline(always)]
fn traverse<const DIRECTIONAL: bool>(
    bvh: &Bvh,
    scene: &Scene,
    shared: Vec3,
    rays: &mut Rays,
    mut alive: u32,
    stack: &mut Vec<Entry>,
) {
    let nodes = &bvh.binary.nodes;
    let inverse_direction = shared.recip().clamp(Vec3::splat(-1e30), Vec3::splat(1e30));
    stack.clear();
    stack.push((0, alive));
    while let Some((node_index, groups)) = stack.pop() {
        let node = &nodes[node_index as usize];
        let groups = groups & alive;
        let bounds = node.aabb();
        let (lo, hi) = (Vec3::from(bounds.min), Vec3::from(bounds.max));
        let mut met = 0;
        let mut left = groups;
        while left != 0 {
            let group = left.trailing_zeros() as usize;
            left &= left - 1;
            let any = match DIRECTIONAL {
                false => group_meets_box(rays, group, lo - shared, hi - shared),
                true => group_meets_box_along(rays, group, lo, hi, inverse_direction),
            };
            met |= u32::from(any) << group;
        }
        if met != 0 {
            let first = node.first_index;
            if node.is_leaf() {
                for corners in &bvh.binary_corners[first as usize..(first + node.prim_count) as usize] {
                    let edges = Edges::new::<DIRECTIONAL>(shared, corners.v);
                    let mut left = met;
                    while left != 0 {
                        let group = left.trailing_zeros() as usize;
                        left &= left - 1;
                        let live = if bvh.has_masks {
                            block_unless_hole::<DIRECTIONAL>(&edges, rays, group, |b| {
                                is_hole(scene, corners.triangle, b)
                            })
                        } else {
                            block::<DIRECTIONAL>(&edges, rays, group)
                        };
                        if !live {
                            met &= !(1 << group);
                            alive &= !(1 << group);
                        }
                    }
                    if met == 0 {
                        break;
                    }
                }
                if alive == 0 {
                    return;
                }
            } else {
                stack.push((first + 1, met));
                stack.push((first, met));
            }
        }
    }
}

/// Whether any live ray of the group, from a shared origin, meets the box given relative to it.
#[inline(always)]
fn group_meets_box(rays: &Rays, group: usize, lo: Vec3, hi: Vec3) -> bool {
    let range = group * GROUP..(group + 1) * GROUP;
    let (ix, iy, iz) =
        (&rays.inverse_q[0][range.clone()], &rays.inverse_q[1][range.clone()], &rays.inverse_q[2][range.clone()]);
    let end = &rays.end[range];
    let mut any = false;
    for i in 0..GROUP {
        let (x0, x1) = (lo.x * ix[i], hi.x * ix[i]);
        let (y0, y1) = (lo.y * iy[i], hi.y * iy[i]);
        let (z0, z1) = (lo.z * iz[i], hi.z * iz[i]);
        let near = x0.min(x1).max(y0.min(y1)).max(z0.min(z1).max(0.0));
        let far = x0.max(x1).min(y0.max(y1)).min(z0.max(z1).min(end[i]));
        // Four roundings of slack [Ize 2013].
        any |= near <= far * (1.0 + 4.0 * f32::EPSILON);
    }
    any
}

/// Whether any live ray of the group, in a shared direction from `q`, meets the box.
#[inline(always)]
fn group_meets_box_along(rays: &Rays, group: usize, lo: Vec3, hi: Vec3, inverse: Vec3) -> bool {
    let range = group * GROUP..(group + 1) * GROUP;
    let (qx, qy, qz) = (&rays.q[0][range.clone()], &rays.q[1][range.clone()], &rays.q[2][range.clone()]);
    let end = &rays.end[range];
    let mut any = false;
    for i in 0..GROUP {
        let (x0, x1) = ((lo.x - qx[i]) * inverse.x, (hi.x - qx[i]) * inverse.x);
        let (y0, y1) = ((lo.y - qy[i]) * inverse.y, (hi.y - qy[i]) * inverse.y);
        let (z0, z1) = ((lo.z - qz[i]) * inverse.z, (hi.z - qz[i]) * inverse.z);
        let near = x0.min(x1).max(y0.min(y1)).max(z0.min(z1).max(0.0));
        let far = x0.max(x1).min(y0.max(y1)).min(z0.max(z1));
        any |= (near <= far * (1.0 + 4.0 * f32::EPSILON)) & (end[i] > 0.0);
    }
    any
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

    /// The three edge functions of a ray, and whether it meets the triangle within its ends.
    #[inline(always)]
    fn test<const DIRECTIONAL: bool>(&self, q: [f32; 3]) -> ([f32; 3], bool) {
        let dot = |n: Vec3| n.x * q[0] + n.y * q[1] + n.z * q[2];
        let w = [0, 1, 2].map(|k| dot(self.normals[k]) + self.offsets[k]);
        let low = w[0].min(w[1]).min(w[2]);
        let high = w[0].max(w[1]).max(w[2]);
        let inside = (low >= 0.0) | (high <= 0.0);
        let plane = dot(self.normal);
        let within = if DIRECTIONAL {
            (self.plane_offset - plane) * self.along > 0.0
        } else {
            // 0 < plane_offset / plane < 1, without the division.
            (self.plane_offset * plane > 0.0) & (self.plane_offset.abs() < plane.abs())
        };
        (w, inside & within)
    }
}

/// Ends the rays of a group that meet the triangle. Returns whether any is left.
#[inline(always)]
fn block<const DIRECTIONAL: bool>(edges: &Edges, rays: &mut Rays, group: usize) -> bool {
    let range = group * GROUP..(group + 1) * GROUP;
    let (qx, qy, qz) = (&rays.q[0][range.clone()], &rays.q[1][range.clone()], &rays.q[2][range.clone()]);
    let end = &mut rays.end[range];
    let mut any = false;
    for i in 0..GROUP {
        let (_, hit) = edges.test::<DIRECTIONAL>([qx[i], qy[i], qz[i]]);
        end[i] = if hit { -1.0 } else { end[i] };
        any |= end[i] > 0.0;
    }
    any
}

/// The same for triangles with holes: `hole` tells by barycentric coordinates.
#[inline(never)]
fn block_unless_hole<const DIRECTIONAL: bool>(
    edges: &Edges,
    rays: &mut Rays,
    group: usize,
    hole: impl Fn(Vec2) -> bool,
) -> bool {
    let mut any = false;
    for i in group * GROUP..(group + 1) * GROUP {
        let (w, hit) = edges.test::<DIRECTIONAL>([rays.q[0][i], rays.q[1][i], rays.q[2][i]]);
        if hit && rays.end[i] > 0.0 && !hole(Vec2::new(w[1], w[2]) / (w[0] + w[1] + w[2])) {
            rays.end[i] = -1.0;
        }
        any |= rays.end[i] > 0.0;
    }
    any
}
