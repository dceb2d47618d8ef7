//! Rays from a view sample in directions that its BRDF draws, sorted into packets.

use glam::Vec3;

use super::directions::{Directions, Lobe};
use super::paths::Paths;
use crate::bake::framebuffer::view_samples::Tiling;
use crate::physics::sequence::{BLOCK, SharedPoints};
use crate::shared::Brdf;
use crate::trace::bvh::Hit;
use crate::trace::packet::PACKET_SIZE;
use crate::trace::packet::common_origin::{CommonOriginPacket, trace_common_origin};

/// Rays of one view sample; its buffers serve one after another.
#[derive(Default)]
pub struct Fan {
    directions: Directions,
    /// Part of the hemisphere that each direction belongs to.
    parts: Vec<u8>,
    /// To be traced.
    pub packets: Vec<CommonOriginPacket>,
    /// For each ray in `packets`: index, and weight of its radiance.
    rays: Vec<(u32, Vec3)>,
}

/// Parts of the hemisphere along each axis of the disc that it projects to.
const PARTS: usize = 8;
/// The part of directions with weight 0.
const NO_LIGHT: u8 = (PARTS * PARTS) as u8;

impl Fan {
    /// Draws one ray for each of `points`, in mesh space. `sample` is the index of the view sample. `normal` and `wo`
    /// are unit, `specular` is the share of directions from the specular lobe,
    /// [`crate::physics::brdf::Lobes::specular_share`].
    pub fn draw(
        &mut self,
        brdf: &Brdf,
        (normal, wo, specular): (Vec3, Vec3, f32),
        lobe: Lobe,
        points: &SharedPoints,
        sample: u32,
    ) {
        self.directions.draw(
            brdf,
            (normal.dot(wo), specular),
            lobe,
            points,
            points.shifts(Tiling::along_curve(sample).into()),
        );
        self.fill_packets(frame_towards(normal, wo));
    }

    /// Traces the rays from a point of a surface.
    pub fn trace(&mut self, paths: &Paths, position: Vec3, geometric_normal: Vec3) {
        let origin = paths.off(position, geometric_normal, geometric_normal, 0.0);
        trace_common_origin(paths.scene, origin, &mut self.packets);
    }

    /// Of each ray its index among the points, the weight of its radiance, its direction, and once it is traced, its
    /// hit and whether that is from behind.
    #[inline(always)]
    pub fn rays(&self) -> impl Iterator<Item = (u32, Vec3, Vec3, Option<(Hit, bool)>)> {
        self.rays.iter().enumerate().map(|(i, &(ray, weight))| {
            let (packet, lane) = (&self.packets[i / PACKET_SIZE], i % PACKET_SIZE);
            (ray, weight, packet.direction(lane), packet.hit(lane))
        })
    }

    /// [`Self::rays`], [traced](Self::trace) from the same point; those that start below the face are traced here.
    #[inline(always)]
    pub fn rays_from(
        &self,
        paths: &Paths,
        position: Vec3,
        geometric_normal: Vec3,
    ) -> impl Iterator<Item = (u32, Vec3, Vec3, Option<(Hit, bool)>)> {
        self.rays().map(move |(ray, weight, direction, hit)| {
            // Above the horizon of an interpolated normal, but below the face: such rays start on the other side.
            let hit = match direction.dot(geometric_normal) < 0.0 {
                true => paths.first_hit(position, geometric_normal, direction),
                false => hit,
            };
            (ray, weight, direction, hit)
        })
    }

    /// Sorts directions of nonzero weight by their part of the hemisphere, and transforms them to mesh space by
    /// `frame`.
    fn fill_packets(&mut self, frame: [Vec3; 3]) {
        let part = |x: f32| ((0.5 + 0.5 * x) * PARTS as f32).clamp(0.0, PARTS as f32 - 1.0) as usize;
        let mut next = [0; PARTS * PARTS + 1];
        self.parts.clear();
        for block in self.directions.blocks() {
            for (wi, weight) in (0..BLOCK).map(|i| block.get(i)) {
                let part = if weight.max_element() > 0.0 { ALONG_CURVE[part(wi.y)][part(wi.x)] } else { NO_LIGHT };
                next[usize::from(part)] += 1;
                self.parts.push(part);
            }
        }
        let mut count = 0usize;
        next[..PARTS * PARTS].iter_mut().for_each(|next| count += std::mem::replace(next, count));
        self.packets.resize_with(count.div_ceil(PACKET_SIZE), CommonOriginPacket::default);
        self.rays.resize(count, (0, Vec3::ZERO));
        for (i, &part) in self.parts.iter().enumerate() {
            if part == NO_LIGHT {
                continue;
            }
            let (wi, weight) = self.directions.blocks()[i / BLOCK].get(i % BLOCK);
            let place = &mut next[usize::from(part)];
            self.rays[*place] = (i as u32, weight);
            let direction = frame[0] * wi.x + frame[1] * wi.y + frame[2] * wi.z;
            self.packets[*place / PACKET_SIZE].set(*place % PACKET_SIZE, direction);
            *place += 1;
        }
        (count..self.packets.len() * PACKET_SIZE).for_each(|i| self.packets[i / PACKET_SIZE].clear(i % PACKET_SIZE));
    }
}

/// Index of each part along a Z-order curve, which mostly preserves neighbourhoods.
const ALONG_CURVE: [[u8; PARTS]; PARTS] = {
    let mut places = [[0; PARTS]; PARTS];
    let mut i = 0;
    while i < PARTS * PARTS {
        let (mut x, mut y, mut bit) = (0, 0, 0);
        while bit < 3 {
            x |= (i >> (2 * bit) & 1) << bit;
            y |= (i >> (2 * bit + 1) & 1) << bit;
            bit += 1;
        }
        places[y][x] = i as u8;
        i += 1;
    }
    places
};

/// Two tangents and the normal; `wo` is in the half plane of the normal and the first tangent.
fn frame_towards(normal: Vec3, wo: Vec3) -> [Vec3; 3] {
    let tangent = (wo - normal * normal.dot(wo)).try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
    [tangent, normal.cross(tangent), normal]
}
