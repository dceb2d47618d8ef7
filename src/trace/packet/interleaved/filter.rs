//! Filters what interleaved samples see: the fraction of the light that a sample sees, from its neighbours on the same
//! surface.

use glam::Vec3;

use super::{BEFORE, InterleavedPackets, POINTS, SIDE, Seen};
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT, PackedLight};
use crate::trace::packet::{Lanes, PACKET_SIZE, SamplePacket};

/// Rows of a tile and of what its windows have around it.
const ROWS: usize = 2 * SIDE - 1;
/// Weights are alike beyond this many times the size of the light.
const FAR: f32 = 5.0;
/// Weights are accurate enough at this distance, relative to that of the light.
const REACH: f32 = 0.1;
/// Cosine between normals up to which weights are accurate enough.
const LIKE: f32 = 0.95;

impl InterleavedPackets {
    /// Fraction of the similar samples around each of a packet that see the light, of those that face it; each
    /// counts by the irradiance of its point.
    pub(super) fn filter(
        &self,
        packet: usize,
        samples: &SamplePacket,
        lanes: &PointLanes,
        similar: &[u64],
        values: &mut [u8],
    ) {
        let own = self.seen[packet];
        let rows = (packet < self.tile_count()).then(|| self.rows_around(packet));
        let around = rows.iter().flatten();
        let [some_lit, some_dark] = around.fold([own.lit != 0, own.facing & !own.lit != 0], |[lit, dark], row| {
            [lit | (row.lit != 0), dark | (row.facing & !row.lit != 0)]
        });
        if !(some_lit && some_dark) {
            values.fill(if some_lit { 255 } else { 0 });
            return;
        }
        let mut weights: Option<Weights> = None;
        for (lane, (value, similar)) in values.iter_mut().zip(similar).enumerate() {
            let Seen { facing, lit } = rows.as_ref().map_or(own, |rows| window(rows, lane));
            // Where no similar one was traced, the others have to do.
            let facing = if facing & similar != 0 { facing & similar } else { facing };
            let lit = lit & facing;
            let fraction = lit.count_ones() as f32 / facing.count_ones().max(1) as f32;
            if lit == 0 || lit == facing || lanes.looks_small(samples.lane(lane).0) {
                *value = (255.0 * fraction + 0.5) as u8;
                continue;
            }
            let bits = [facing, lit].map(|bits| if rows.is_some() { by_pixel(bits, lane) } else { bits });
            if !weights.as_ref().is_some_and(|weights| weights.fit(samples, lane)) {
                weights = Some(Weights::new(lanes, samples, lane));
            }
            let weights = weights.as_ref().expect("made above");
            let [sum, lit_sum] = bits.map(|bits| weights.sum(bits));
            let mean = if sum > 0.0 && sum.is_finite() { lit_sum / sum } else { fraction };
            *value = (255.0 * mean + 0.5) as u8;
        }
    }

    /// Bits of a tile and of the pixels around it: rows of which each begins [`BEFORE`] pixels before the tile.
    fn rows_around(&self, tile: usize) -> [Row; ROWS] {
        let [columns, rows] = self.tiles;
        let (column, row) = (tile % columns, tile / columns);
        let [left, right] = [column > 0, column + 1 < columns];
        std::array::from_fn(|r| {
            let y = row * SIDE + r;
            if y < BEFORE || y - BEFORE >= rows * SIDE {
                return Row::default();
            }
            let (tile, shift) = ((y - BEFORE) / SIDE * columns + column, (y - BEFORE) % SIDE * SIDE);
            let bits = |of: fn(&Seen) -> u64| {
                let row = |tile: usize| (of(&self.seen[tile]) >> shift & 255) as u16;
                let before = if left { row(tile - 1) >> (SIDE - BEFORE) } else { 0 };
                let behind = if right { row(tile + 1) << (SIDE + BEFORE) } else { 0 };
                before | row(tile) << BEFORE | behind
            };
            Row { facing: bits(|seen| seen.facing), lit: bits(|seen| seen.lit) }
        })
    }
}

/// [`Seen`] of a row of pixels.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    facing: u16,
    lit: u16,
}

/// The window of a lane.
fn window(rows: &[Row; ROWS], lane: usize) -> Seen {
    let (mut seen, shift) = (Seen::default(), lane % SIDE);
    for (r, row) in rows[lane / SIDE..][..SIDE].iter().enumerate() {
        seen.facing |= u64::from(row.facing >> shift & 255) << (SIDE * r);
        seen.lit |= u64::from(row.lit >> shift & 255) << (SIDE * r);
    }
    seen
}

/// Bits of the window of `lane`, ordered by the lane that a pixel has in its own tile.
fn by_pixel(bits: u64, lane: usize) -> u64 {
    let [left, up] = [(lane + BEFORE) % SIDE, (lane / SIDE + BEFORE) % SIDE];
    let low = u64::from_ne_bytes([(0xff_u32 << left) as u8; 8]);
    let turned = (bits << left) & low | (bits >> (SIDE - left)) & !low;
    turned.rotate_left((SIDE * up) as u32)
}

/// Points of a light in the order of the lanes of a packet.
pub(super) struct PointLanes {
    kind: u32,
    /// Positions, or directions of a directional light.
    at: [Lanes; 3],
    middle: Vec3,
    /// Mean squared distance from the middle.
    size2: f32,
    /// Direction of emission of a flat light.
    axis: Vec3,
}

impl PointLanes {
    /// `point`: of a lane.
    pub fn new(points: &[PackedLight], point: fn(usize) -> usize) -> Self {
        let light = &points[0];
        let at = |i: usize| if light.kind == LIGHT_DIRECTIONAL { -points[i].direction } else { points[i].position };
        let mean = 1.0 / points.len() as f32;
        let middle = (0..points.len()).map(at).sum::<Vec3>() * mean;
        Self {
            kind: light.kind,
            at: [0, 1, 2].map(|axis| std::array::from_fn(|lane| at(point(lane))[axis])),
            middle,
            size2: (0..points.len()).map(|i| at(i).distance_squared(middle)).sum::<f32>() * mean,
            axis: light.direction,
        }
    }

    /// Irradiance of each point at a sample, without shadows, range and spread; relative to the strength of a point.
    fn irradiance(&self, samples: &SamplePacket, lane: usize) -> Lanes {
        let (position, normal) = samples.lane(lane);
        let shading_normal = Vec3::from(samples.normal.map(|axis| axis[lane]));
        let normal = if normal.dot(shading_normal) < 0.0 { -normal } else { normal };
        let origin = if self.kind == LIGHT_DIRECTIONAL { Vec3::ZERO } else { position };
        let (mut cosines, mut emitted, mut distances2) = ([0.0; PACKET_SIZE], [0.0; PACKET_SIZE], [0.0; PACKET_SIZE]);
        for i in 0..PACKET_SIZE {
            let to_light = Vec3::new(self.at[0][i], self.at[1][i], self.at[2][i]) - origin;
            cosines[i] = normal.dot(to_light).max(0.0);
            emitted[i] = self.axis.dot(to_light).abs();
            distances2[i] = to_light.length_squared().max(f32::MIN_POSITIVE);
        }
        let middle2 = self.distance2(position);
        match self.kind {
            LIGHT_DIRECTIONAL => cosines,
            // Points in a ball are spread evenly over the directions to it.
            LIGHT_POINT => std::array::from_fn(|i| cosines[i] / (distances2[i].sqrt() * middle2)),
            LIGHT_SPOT => std::array::from_fn(|i| cosines[i] / (distances2[i].sqrt() * distances2[i])),
            _ => std::array::from_fn(|i| cosines[i] * emitted[i] / (distances2[i] * distances2[i])),
        }
    }

    /// Whether all points send about the same light there.
    fn looks_small(&self, position: Vec3) -> bool {
        self.distance2(position) > FAR * FAR * self.size2
    }

    /// Squared distance to the middle of the light; 1 for directions, whose ends are on the unit sphere.
    fn distance2(&self, position: Vec3) -> f32 {
        match self.kind {
            LIGHT_DIRECTIONAL => 1.0,
            _ => self.middle.distance_squared(position).max(f32::MIN_POSITIVE),
        }
    }
}

/// Irradiance of the points at a sample, summed for the 16 values of each four bits.
struct Weights {
    sums: [[f32; 16]; POINTS / 4],
    position: Vec3,
    normal: Vec3,
    /// Squared distance of other samples for which the weights are accurate enough.
    reach2: f32,
}

impl Weights {
    /// At sample `lane`.
    fn new(points: &PointLanes, samples: &SamplePacket, lane: usize) -> Self {
        let irradiance = points.irradiance(samples, lane);
        let mut sums = [[0.0; 16]; POINTS / 4];
        for (four, sums) in sums.iter_mut().enumerate() {
            for bit in 0..4 {
                let weight = irradiance[4 * four + bit];
                (0..1 << bit).for_each(|lower| sums[lower | 1 << bit] = sums[lower] + weight);
            }
        }
        let (position, normal) = samples.lane(lane);
        let reach2 = match points.kind {
            LIGHT_DIRECTIONAL => f32::INFINITY,
            _ => REACH * REACH * points.distance2(position),
        };
        Self { sums, position, normal, reach2 }
    }

    /// Whether they are accurate enough for another sample.
    fn fit(&self, samples: &SamplePacket, lane: usize) -> bool {
        let (position, normal) = samples.lane(lane);
        normal.dot(self.normal) > LIKE && position.distance_squared(self.position) < self.reach2
    }

    fn sum(&self, bits: u64) -> f32 {
        self.sums.iter().enumerate().map(|(four, sums)| sums[(bits >> (4 * four) & 15) as usize]).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::LIGHT_FACET;
    use crate::trace::packet::interleaved::{point_in_list, point_of_pixel};

    /// 3 x 2 tiles and two packets of a list.
    fn packets() -> InterleavedPackets {
        InterleavedPackets::new(&vec![SamplePacket::default(); 8], [3, 2])
    }

    /// On the plane z = 0.
    fn samples() -> SamplePacket {
        let mut samples = SamplePacket::default();
        (samples.normal[2], samples.geometric_normal[2]) = ([1.0; PACKET_SIZE], [1.0; PACKET_SIZE]);
        samples
    }

    /// Of a light with this height, and points in the unit square.
    fn points(height: f32) -> Vec<PackedLight> {
        let at = |i: usize| Vec3::new((i % 8) as f32 / 7.0, (i / 8) as f32 / 7.0, height);
        let facet = PackedLight { kind: LIGHT_FACET, direction: Vec3::NEG_Z, ..bytemuck::Zeroable::zeroed() };
        (0..POINTS).map(|i| PackedLight { position: at(i), ..facet }).collect()
    }

    /// By [`InterleavedPackets::filter`], if the samples are similar that have a bit in `similar`.
    fn filtered(packets: &InterleavedPackets, packet: usize, similar: [u64; PACKET_SIZE], height: f32) -> [u8; 64] {
        let lanes = PointLanes::new(&points(height), if packet < 6 { point_of_pixel } else { point_in_list });
        let mut values = [7; PACKET_SIZE];
        packets.filter(packet, &samples(), &lanes, &similar, &mut values);
        values
    }

    const FAR_AWAY: f32 = 100.0;

    #[test]
    fn fractions_are_means_over_similar_samples_that_face_the_light() {
        let mut packets = packets();
        let mut fractions = |lit: u64, facing: u64, similar: u64| {
            packets.seen.fill(Seen { facing, lit });
            [1, 7].map(|packet| filtered(&packets, packet, [similar; PACKET_SIZE], FAR_AWAY))
        };
        assert_eq!(fractions(u64::MAX, u64::MAX, u64::MAX), [[255; PACKET_SIZE]; 2]);
        assert_eq!(fractions(0, u64::MAX, u64::MAX), [[0; PACKET_SIZE]; 2]);
        let odd = 0xaaaa_aaaa_aaaa_aaaa;
        assert_eq!(fractions(odd, u64::MAX, u64::MAX)[1], [128; PACKET_SIZE]);
        // Those that do not face the light do not count.
        assert_eq!(fractions(odd, odd, u64::MAX), [[255; PACKET_SIZE]; 2]);
        // Of similar ones alone; without any, of all.
        assert_eq!(fractions(odd, u64::MAX, odd)[1], [255; PACKET_SIZE]);
        assert_eq!(fractions(odd, u64::MAX, 0)[1], [128; PACKET_SIZE]);
    }

    /// One sample sees the light: it counts in the windows that have it, by the bit that the window has for it.
    #[test]
    fn filters_read_the_window() {
        let mut packets = packets();
        for lit in (0..8 * PACKET_SIZE).step_by(37) {
            packets.seen.fill(Seen { facing: u64::MAX, lit: 0 });
            packets.seen[lit / PACKET_SIZE].lit = 1 << (lit % PACKET_SIZE);
            for index in 0..8 * PACKET_SIZE {
                let (packet, lane) = (index / PACKET_SIZE, index % PACKET_SIZE);
                for (i, other) in packets.window(index).enumerate().filter(|(_, other)| other.is_some()) {
                    let mut similar = [0; PACKET_SIZE];
                    similar[lane] = 1 << i;
                    let value = filtered(&packets, packet, similar, FAR_AWAY)[lane];
                    assert_eq!(value, if other == Some(lit) { 255 } else { 0 }, "{lit} in the window of {index}");
                }
            }
        }
    }

    /// Where the light looks large, its points count by their irradiance.
    #[test]
    fn points_nearby_count_more() {
        let (height, mut packets) = (0.5, packets());
        let points = points(height);
        let irradiance = |point: usize| {
            f64::from(height / points[point].position.length()).powi(2)
                / f64::from(points[point].position.length_squared())
        };
        let sum = |is_in: &dyn Fn(usize) -> bool| (0..POINTS).filter(|&i| is_in(i)).map(irradiance).sum::<f64>();
        // The half of the light that is nearer in x.
        let is_lit = |point: usize| point % 8 < 4;
        let wanted = sum(&is_lit) / sum(&|_| true);
        for packet in [1, 7] {
            for (other, seen) in packets.seen.iter_mut().enumerate() {
                let point = |lane| if other < 6 { point_of_pixel(lane) } else { point_in_list(lane) };
                let lit = (0..PACKET_SIZE).map(|lane| u64::from(is_lit(point(lane))) << lane).sum();
                *seen = Seen { facing: u64::MAX, lit };
            }
            // In the middle of the lower row of tiles, and in the list.
            let values = filtered(&packets, packet, [u64::MAX; PACKET_SIZE], height);
            let value = f64::from(values[if packet == 1 { 36 } else { 5 }]) / 255.0;
            assert!((value - wanted).abs() < 0.003, "{value} instead of {wanted}");
        }
    }
}
