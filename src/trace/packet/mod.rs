//! Shadow rays in packets of 64 that share the light: exact visibility, several times faster than single rays.
//!
//! A packet is 64 view samples that are close together. All its rays start at the light (or are parallel to it, if it
//! is directional), so a triangle's three edge functions are set up once for 64 rays, and a ray test is four dot
//! products. Two triangles that share an edge compute it from the same numbers, so no ray passes between them. Rays are
//! tested one register at a time, and a bit mask marks the registers that still have active rays. `pulp` selects the
//! widest registers of the machine; products and sums are rounded separately, so all machines give the same result.

pub mod common_origin;
pub mod half_resolution;
pub mod interleaved;
mod rays;
mod triangle;

use glam::Vec3;
use obvhs::bvh2::node::Bvh2Node;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use self::rays::{Rays, any_positive, meets_box, meets_box_along, start_rays};
use self::triangle::{Edges, attenuate, block};
use super::bvh::{Bvh, blocked_share};
use super::linked::LinkedScene;
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_FACET, LIGHT_SPOT, LIGHT_TWO_SIDED_FACET, PackedLight, TILE_SIZE};

/// Rays in a packet: one tile of pixels.
pub const PACKET_SIZE: usize = (TILE_SIZE * TILE_SIZE) as usize;
/// Packets per task: about 50 microseconds of work.
const PACKETS_A_TASK: usize = 16;
type Lanes = [f32; PACKET_SIZE];
/// Lights further away than this many radii of the scene are traced with single rays from the samples: packets compute
/// relative to the light, so their rounding errors grow with its distance.
const FAR_RADII: f32 = 32.0;
/// A node to visit, and a bit mask of the registers whose rays may hit it.
type Entry = (u32, u64);

/// 64 view samples in the layout of the tracer, mesh space. Lanes without a sample have zero normals.
#[derive(Clone)]
pub struct SamplePacket {
    /// Origins of rays, above the surface by [`super::surface::SurfacePoint::lift`].
    pub position: [Lanes; 3],
    /// Shading normal; zero if nothing is reflected.
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

/// Traces `packets` towards `light`. `visibility` receives 64 values per packet: 255 for samples that face the light
/// and see it, 0 for those that do not, and values in between behind blending surfaces.
pub fn trace_packets<'a>(
    scene: impl Into<LinkedScene<'a>>,
    light: &PackedLight,
    packets: &[SamplePacket],
    visibility: &mut [u8],
) {
    pulp::Arch::new().dispatch(TracePackets { scene: scene.into(), light, packets, visibility, facing: &mut [] });
}

/// As [`trace_packets`], for one packet. `facing` receives which samples face the light.
fn trace_towards(
    scene: LinkedScene,
    light: &PackedLight,
    packet: &SamplePacket,
    visibility: &mut [u8; PACKET_SIZE],
    facing: &mut u64,
) {
    let (packets, facing) = (std::slice::from_ref(packet), std::slice::from_mut(facing));
    pulp::Arch::new().dispatch(TracePackets { scene, light, packets, visibility, facing });
}

/// [`trace_packets`] on all cores.
pub fn trace_all<'a>(
    scene: impl Into<LinkedScene<'a>>,
    light: &PackedLight,
    packets: &[SamplePacket],
    visibility: &mut [u8],
) {
    let scene = scene.into();
    visibility
        .par_chunks_mut(PACKETS_A_TASK * PACKET_SIZE)
        .zip(packets.par_chunks(PACKETS_A_TASK))
        .for_each(|(visibility, packets)| trace_packets(scene, light, packets, visibility));
}

struct TracePackets<'a> {
    scene: LinkedScene<'a>,
    light: &'a PackedLight,
    packets: &'a [SamplePacket],
    visibility: &'a mut [u8],
    /// Empty if not wanted.
    facing: &'a mut [u64],
}

impl WithSimd for TracePackets<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        if is_far(&self.scene.bvh, self.light) {
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
        let Self { scene, light, packets, visibility, facing } = self;
        let mut facing = facing.iter_mut();
        let visibility = visibility.chunks_exact_mut(PACKET_SIZE);
        for (packet, visibility) in packets.iter().zip(visibility) {
            let mut faces = 0;
            for (lane, visible) in visibility.iter_mut().enumerate() {
                let ray = packet.shadow_ray(&scene.bvh, light, lane);
                faces |= u64::from(ray.is_some()) << lane;
                let share = |ray: ShadowRay| scene.transmittance(ray.origin, ray.direction, ray.length);
                *visible = in_8_bits(ray.map_or(0.0, share));
            }
            facing.next().into_iter().for_each(|facing| *facing = faces);
        }
    }

    #[inline(always)]
    fn trace<S: Simd, const DIRECTIONAL: bool>(self, simd: S) {
        let Self { scene, light, packets, visibility, facing } = self;
        let mut facing = facing.iter_mut();
        let mut stack = Vec::with_capacity(128);
        let zero = [[0.0; PACKET_SIZE]; 3];
        let mut rays = Rays { q: zero, inverse_q: zero, end: [-1.0; PACKET_SIZE] };
        let mut left = [1.0; PACKET_SIZE];
        let visibility = visibility.chunks_exact_mut(PACKET_SIZE);
        for (packet, visibility) in packets.iter().zip(visibility) {
            let shared = if DIRECTIONAL { -light.direction } else { light.position };
            start_rays::<S, DIRECTIONAL>(simd, &scene.bvh, light, packet, &mut rays);
            if let Some(facing) = facing.next() {
                *facing = rays.end.iter().rev().fold(0, |bits, end| bits << 1 | u64::from(*end > 0.0));
            }
            let mut alive = 0;
            for (register, end) in S::as_simd_f32s(&rays.end).0.iter().enumerate() {
                alive |= u64::from(any_positive(simd, *end)) << register;
            }
            if alive != 0 {
                traverse::<S, DIRECTIONAL>(simd, scene, shared, (&mut rays, &mut left), alive, &mut stack);
            }
            for (visible, end) in visibility.iter_mut().zip(&rays.end) {
                *visible = if *end > 0.0 { 255 } else { 0 };
            }
            if scene.bvh.has_blends {
                for ((visible, end), left) in visibility.iter_mut().zip(&rays.end).zip(&mut left) {
                    *visible = if *end > 0.0 { in_8_bits(*left) } else { 0 };
                    *left = 1.0;
                }
            }
        }
    }
}

fn in_8_bits(share: f32) -> u8 {
    (255.0 * share).round() as u8
}

/// A ray from the light to a view sample, or from a sample towards a directional or far light.
pub struct ShadowRay {
    pub origin: Vec3,
    pub direction: Vec3,
    /// In units of the length of `direction`.
    pub length: f32,
}

/// The ray that decides whether a surface point sees `light`; `None` if the point faces away or is outside the light's
/// cone or range. Unit normals, mesh space.
pub fn shadow_ray(
    bvh: &Bvh,
    light: &PackedLight,
    position: Vec3,
    normal: Vec3,
    geometric_normal: Vec3,
) -> Option<ShadowRay> {
    let [p, n, g] = [position, normal, geometric_normal].map(|v| v.to_array());
    if light.kind == LIGHT_DIRECTIONAL {
        let (needed, origin) = target::<true>(bvh, light, p, n, g);
        needed.then_some(ShadowRay { origin: origin.into(), direction: -light.direction, length: f32::INFINITY })
    } else {
        let (needed, target) = target::<false>(bvh, light, p, n, g);
        let (origin, end) = match is_far(bvh, light) {
            true => (Vec3::from(target), light.position),
            false => (light.position, Vec3::from(target)),
        };
        needed.then_some(ShadowRay { origin, direction: end - origin, length: 1.0 })
    }
}

impl SamplePacket {
    /// Position and geometric normal of one lane.
    pub fn lane(&self, lane: usize) -> (Vec3, Vec3) {
        let [position, normal] = [&self.position, &self.geometric_normal].map(|v| v.map(|axis| axis[lane]).into());
        (position, normal)
    }

    /// The ray that [`trace_packets`] traces for one lane; `None` if the sample faces away from the light or is outside
    /// its cone or range.
    pub fn shadow_ray(&self, bvh: &Bvh, light: &PackedLight, lane: usize) -> Option<ShadowRay> {
        let [position, normal, geometric_normal] = [&self.position, &self.normal, &self.geometric_normal]
            .map(|v| Vec3::new(v[0][lane], v[1][lane], v[2][lane]));
        shadow_ray(bvh, light, position, normal, geometric_normal)
    }

    /// [`target`] of one lane.
    #[inline(always)]
    fn target<const DIRECTIONAL: bool>(&self, bvh: &Bvh, light: &PackedLight, i: usize) -> (bool, [f32; 3]) {
        let [position, normal, geometric_normal] =
            [&self.position, &self.normal, &self.geometric_normal].map(|v| [v[0][i], v[1][i], v[2][i]]);
        target::<DIRECTIONAL>(bvh, light, position, normal, geometric_normal)
    }
}

/// Whether a shadow ray needs to be traced, and where it ends: off the surface, on the light's side.
#[inline(always)]
fn target<const DIRECTIONAL: bool>(
    bvh: &Bvh,
    light: &PackedLight,
    [px, py, pz]: [f32; 3],
    [nx, ny, nz]: [f32; 3],
    [gx, gy, gz]: [f32; 3],
) -> (bool, [f32; 3]) {
    let (l, d) = (light.position, light.direction);
    let (tx, ty, tz) = if DIRECTIONAL { (-d.x, -d.y, -d.z) } else { (l.x - px, l.y - py, l.z - pz) };
    let distance2 = tx * tx + ty * ty + tz * tz;
    let distance = distance2.sqrt();
    let facing = nx * tx + ny * ty + nz * tz > 0.0;
    // Slightly wider than the cone or spread, whose edge is black.
    let cone = match light.kind {
        LIGHT_SPOT => 1.0 - light.cone_versine - 1e-5,
        LIGHT_FACET | LIGHT_TWO_SIDED_FACET => (1.0 + light.narrowing.powi(-2)).sqrt().recip() - 1e-5,
        _ => -2.0,
    };
    let along_axis = -(tx * d.x + ty * d.y + tz * d.z);
    let along_axis = if light.kind == LIGHT_TWO_SIDED_FACET { along_axis.abs() } else { along_axis };
    let inside = DIRECTIONAL | (along_axis >= cone * distance);
    let in_range = DIRECTIONAL | (distance * light.inverse_range < 1.0);
    let offset = bvh.shadow_offset(if DIRECTIONAL { 0.0 } else { distance.min(FAR_RADII * bvh.radius) });
    let offset = if gx * tx + gy * ty + gz * tz < 0.0 { -offset } else { offset };
    (facing & inside & in_range, [px + gx * offset, py + gy * offset, pz + gz * offset])
}

/// Ends the rays that are blocked and attenuates others: `left_of_light` is the remaining share of their light.
#[inline(always)]
fn traverse<S: Simd, const DIRECTIONAL: bool>(
    simd: S,
    scene: LinkedScene,
    shared: Vec3,
    (rays, left_of_light): (&mut Rays, &mut Lanes),
    mut alive: u64,
    stack: &mut Vec<Entry>,
) {
    let nodes = &scene.bvh.binary.nodes;
    let inverse_direction = shared.recip().clamp(Vec3::splat(-1e30), Vec3::splat(1e30));
    let meets = |node: &Bvh2Node, rays: &Rays, concerned: u64| {
        let bounds = node.aabb();
        let (lo, hi) = (Vec3::from(bounds.min), Vec3::from(bounds.max));
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
        for corners in &scene.bvh.binary_corners[first as usize..(first + node.prim_count) as usize] {
            if !scene.casts_shadow(corners.triangle) {
                continue;
            }
            let edges = Edges::new::<DIRECTIONAL>(shared, corners.v);
            let is_masked = scene.is_masked(corners.triangle);
            let mut left = met;
            while left != 0 {
                let register = left.trailing_zeros() as usize;
                left &= left - 1;
                let some_left = if is_masked {
                    let blocked_share = |barycentric| blocked_share(&scene, corners.triangle, barycentric);
                    attenuate::<DIRECTIONAL>(&edges, rays, left_of_light, register, S::F32_LANES, blocked_share)
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
