//! Visibility of an area light by interleaved sampling [Keller 2001]: each sample is traced towards one of 64
//! points of the light, its neighbours towards others. A quarter of the samples is traced first, and more of them where
//! shadows would be noisy.

mod filter;

use glam::Vec3;
use rayon::prelude::*;

use self::filter::PointLanes;
use super::{PACKET_SIZE, SamplePacket, trace_towards};
use crate::shared::{LIGHT_DIRECTIONAL, PackedLight, SOFT_POINTS, TILE_SIZE};
use crate::trace::linked::LinkedScene;

/// Which samples of packets see a light, each another one of [`SOFT_POINTS`] points of it.
pub struct InterleavedPackets {
    /// Columns and rows of the packets that are tiles of a picture; a list follows.
    tiles: [usize; 2],
    /// Packets in the order in which they are traced: neighbours together.
    order: Vec<u32>,
    /// Those of `order` of which more samples are traced.
    noisy: Vec<u32>,
    /// Of each packet.
    seen: Vec<Seen>,
    /// Number of samples in each packet that face the light, and that see it.
    counts: Vec<[u32; 2]>,
    /// Of packets that are traced together, each with one point.
    found: Vec<Seen>,
    /// Position and normal of one sample in each packet.
    places: Vec<[Vec3; 2]>,
    /// Irradiance there without shadows, relative to that of other packets.
    irradiance: Vec<f32>,
}

/// Samples of a packet that were traced and face the light, and those of them that see it.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    facing: u64,
    lit: u64,
}

/// Points of the light, and samples of a window.
const POINTS: usize = SOFT_POINTS as usize;
/// Points that are traced together: one in each of 4x4 cells of the light, for one pixel of each 2x2.
const CELLS: usize = POINTS / 4;
/// Side of a tile, of a group of tiles, and of a window of pixels.
const SIDE: usize = TILE_SIZE as usize;
/// Pixels of a window before and behind its middle.
const BEFORE: usize = SIDE / 2;
/// Variance of the fraction of a packet that sees the light, relative to the mean square of the picture, above which
/// more samples are traced.
const MOST_NOISE: f32 = 0.06 * 0.06;
/// Packets of one task.
const PACKETS_A_TASK: usize = 64;

/// Point of a pixel, by its lane in a tile. Points repeat after eight pixels in x and in y, so that each window of 8x8
/// pixels has all 64.
fn point_of_pixel(lane: usize) -> usize {
    let (x, y) = (lane % SIDE, lane / SIDE);
    let cell = (x & 3) + 4 * (y & 3);
    let [turn_x, turn_y] = turns(cell);
    cell + CELLS * ((x >> 2 ^ turn_x) + 2 * (y >> 2 ^ turn_y))
}

/// Inverse of [`point_of_pixel`].
fn pixel_of_point(point: usize) -> usize {
    let (cell, quarter) = (point % CELLS, point / CELLS);
    let [turn_x, turn_y] = turns(cell);
    (cell & 3) + 4 * (quarter & 1 ^ turn_x) + SIDE * ((cell >> 2) + 4 * (quarter >> 1 ^ turn_y))
}

/// In which quarter of a tile the pixel of a cell is traced first: such that each 2x2 pixels have one of them.
fn turns(cell: usize) -> [usize; 2] {
    let bit = |i: usize| cell >> i & 1;
    [bit(0) ^ bit(3), bit(2) ^ bit(1)]
}

/// Point of a sample in a list: successive samples have points all over the light, each four together those of a cell.
/// Twin: glsl/lib/soft.glsl.
fn point_in_list(lane: usize) -> usize {
    5 * (lane / 4) % CELLS + CELLS * (lane % 4)
}

/// Inverse of [`point_in_list`].
fn lane_in_list(point: usize) -> usize {
    4 * (13 * (point % CELLS) % CELLS) + point / CELLS
}

impl InterleavedPackets {
    /// `packets` begins with the tiles of a picture, `[columns, rows]` of them, by rows; a list follows.
    pub fn new(packets: &[SamplePacket], tiles: [usize; 2]) -> Self {
        let count = packets.len();
        let [columns, rows] = tiles;
        let mut order: Vec<u32> = (0..count as u32).collect();
        // Groups of 8x8 tiles, in Morton order within, so that the samples of a register are near each other.
        order.sort_by_cached_key(|&packet| {
            let packet = packet as usize;
            if packet >= columns * rows {
                return [usize::MAX, packet, 0];
            }
            let (x, y) = (packet % columns, packet / columns);
            let spread = |i: usize| (0..3).fold(0, |bits, bit| bits | (i >> bit & 1) << (2 * bit));
            [y / SIDE, x / SIDE, spread(x) | spread(y) << 1]
        });
        Self {
            tiles,
            order,
            noisy: Vec::with_capacity(count),
            seen: vec![Seen::default(); count],
            counts: vec![[0; 2]; count],
            found: vec![Seen::default(); count.div_ceil(PACKET_SIZE) * CELLS],
            places: packets.iter().map(a_place).collect(),
            irradiance: vec![0.0; count],
        }
    }

    /// Point of a sample, given by packet and lane.
    fn point(&self, packet: usize, lane: usize) -> usize {
        if packet < self.tile_count() { point_of_pixel(lane) } else { point_in_list(lane) }
    }

    /// Inverse of [`Self::point`].
    fn lane(&self, packet: usize, point: usize) -> usize {
        if packet < self.tile_count() { pixel_of_point(point) } else { lane_in_list(point) }
    }

    /// Of what belongs to tiles, and to a list, that of a packet.
    fn choose<'a, T>(&self, [of_tiles, of_list]: &'a [T; 2], packet: usize) -> &'a T {
        if packet < self.tile_count() { of_tiles } else { of_list }
    }

    fn tile_count(&self) -> usize {
        self.tiles[0] * self.tiles[1]
    }

    /// Point of the light that sample `index` is traced to.
    pub fn point_of(&self, index: usize) -> usize {
        self.point(index / PACKET_SIZE, index % PACKET_SIZE)
    }

    /// Traces samples towards their points of the light, on all cores; `visibility` receives 64 values for each of
    /// `packets`, 0 to 255. With `similar`, which has for each sample a bit for each in its [`window`](Self::window), a
    /// value is the mean over the similar ones that face the light, each weighted by the irradiance of its point.
    /// Without, one sample of each four in the list is traced for all of them. Behind blending surfaces a sample sees
    /// the light as often as it is attenuated.
    pub fn trace(
        &mut self,
        scene: LinkedScene,
        packets: &[SamplePacket],
        points: &[PackedLight],
        similar: Option<&[u64]>,
        visibility: &mut [u8],
    ) {
        let lanes = [point_of_pixel, point_in_list].map(|point| PointLanes::new(points, point));
        self.seen.fill(Seen::default());
        let order = std::mem::take(&mut self.order);
        self.trace_points(scene, packets, points, 0, &order);
        if similar.is_some() {
            self.find_irradiance(points);
            let mut noisy = std::mem::take(&mut self.noisy);
            noisy.clone_from(&order);
            let most = MOST_NOISE * self.mean_square();
            for first in (CELLS..POINTS).step_by(CELLS) {
                noisy.retain(|&packet| self.variance(packet as usize) > most * first as f32);
                self.trace_points(scene, packets, points, first, &noisy);
            }
            self.noisy = noisy;
        }
        self.order = order;
        let values = visibility.par_chunks_mut(PACKET_SIZE).with_min_len(PACKETS_A_TASK).enumerate();
        values.for_each(|(packet, values)| match similar {
            Some(similar) => {
                let similar = &similar[packet * PACKET_SIZE..][..PACKET_SIZE];
                self.filter(packet, &packets[packet], self.choose(&lanes, packet), similar, values);
            }
            None => {
                let Seen { facing, lit } = self.seen[packet];
                let mean = (255 * lit.count_ones() / facing.count_ones().max(1)) as u8;
                values.iter_mut().enumerate().for_each(|(lane, value)| {
                    let bit = |bits: u64| bits >> (lane & !3) & 1 != 0;
                    *value = [mean, if bit(lit) { 255 } else { 0 }][usize::from(bit(facing))];
                });
            }
        });
    }

    /// Traces the samples of `chosen` packets that have one of [`CELLS`] points from `first`.
    fn trace_points(
        &mut self,
        scene: LinkedScene,
        packets: &[SamplePacket],
        points: &[PackedLight],
        first: usize,
        chosen: &[u32],
    ) {
        let group = |index: usize| &chosen[index * PACKET_SIZE..chosen.len().min((index + 1) * PACKET_SIZE)];
        let group_count = chosen.len().div_ceil(PACKET_SIZE);
        let mut found = std::mem::take(&mut self.found);
        let of_points = found[..group_count * CELLS].par_iter_mut().enumerate();
        of_points.for_each(|(i, found)| {
            let (group, point) = (group(i / CELLS), first + i % CELLS);
            let mut same_point = SamplePacket::default();
            for (to, &packet) in group.iter().enumerate() {
                let (from, packet) = (self.lane(packet as usize, point), &packets[packet as usize]);
                for axis in 0..3 {
                    same_point.position[axis][to] = packet.position[axis][from];
                    same_point.normal[axis][to] = packet.normal[axis][from];
                    same_point.geometric_normal[axis][to] = packet.geometric_normal[axis][from];
                }
            }
            let (mut values, mut facing) = ([0; PACKET_SIZE], 0);
            trace_towards(scene, &points[point], &same_point, &mut values, &mut facing);
            // Another threshold for each cell.
            let threshold = 16 * (point % CELLS) as u8 + 7;
            let lit = values.iter().rev().fold(0, |bits, &value| bits << 1 | u64::from(value > threshold));
            *found = Seen { facing, lit };
        });
        for (group, found) in chosen.chunks(PACKET_SIZE).zip(found.chunks(CELLS)) {
            for (to, &packet) in group.iter().enumerate() {
                let mut seen = self.seen[packet as usize];
                for (point, found) in (first..).zip(found) {
                    let lane = self.lane(packet as usize, point);
                    seen.facing |= (found.facing >> to & 1) << lane;
                    seen.lit |= (found.lit >> to & 1) << lane;
                }
                self.seen[packet as usize] = seen;
                self.counts[packet as usize] = [seen.facing, seen.lit].map(u64::count_ones);
            }
        }
        self.found = found;
    }

    fn find_irradiance(&mut self, points: &[PackedLight]) {
        let Self { places, irradiance, .. } = self;
        irradiance.par_iter_mut().zip(places).with_min_len(PACKETS_A_TASK).for_each(|(sum, place)| {
            // One cell in each row and column.
            *sum = points[..CELLS].iter().step_by(5).map(|point| irradiance_at(*place, point)).sum();
        });
    }

    /// Of the light on tiles.
    fn mean_square(&self) -> f32 {
        let tiles = (0..self.tile_count()).into_par_iter().with_min_len(PACKETS_A_TASK);
        tiles.map(|tile| (self.irradiance[tile] * self.lit_around(tile)).powi(2)).sum::<f32>()
            / self.tile_count() as f32
    }

    /// Of the light of one sample in a packet.
    fn variance(&self, packet: usize) -> f32 {
        let lit = self.lit_around(packet);
        self.irradiance[packet].powi(2) * lit * (1.0 - lit)
    }

    /// Fraction of the traced samples of a packet, and of the tiles around it, that see the light.
    fn lit_around(&self, packet: usize) -> f32 {
        let [columns, rows] = self.tiles;
        let (mut lit, mut facing) = (0, 0);
        let mut add = |packet: usize| {
            facing += self.counts[packet][0];
            lit += self.counts[packet][1];
        };
        match packet < self.tile_count() {
            true => {
                let (x, y) = (packet % columns, packet / columns);
                for y in y.saturating_sub(1)..rows.min(y + 2) {
                    (x.saturating_sub(1)..columns.min(x + 2)).for_each(|x| add(y * columns + x));
                }
            }
            false => add(packet),
        }
        lit as f32 / facing.max(1) as f32
    }

    /// The 64 samples around one, with different points: of a picture 8x8 pixels, of a list those of its packet; by
    /// index, `None` outside of the picture.
    pub fn window(&self, index: usize) -> impl Iterator<Item = Option<usize>> {
        let (packet, lane) = (index / PACKET_SIZE, index % PACKET_SIZE);
        let (is_tile, [columns, rows]) = (packet < self.tile_count(), self.tiles);
        let [x, y] = match is_tile {
            true => [packet % columns * SIDE + lane % SIDE, packet / columns * SIDE + lane / SIDE],
            false => [0; 2],
        };
        (0..POINTS).map(move |i| {
            if !is_tile {
                return Some(packet * PACKET_SIZE + i);
            }
            let [x, y] = [(x + i % SIDE).checked_sub(BEFORE)?, (y + i / SIDE).checked_sub(BEFORE)?];
            let is_inside = x < columns * SIDE && y < rows * SIDE;
            let tile = y / SIDE * columns + x / SIDE;
            is_inside.then_some(tile * PACKET_SIZE + y % SIDE * SIDE + x % SIDE)
        })
    }
}

/// Position and normal of the first sample that reflects light, or of any.
fn a_place(packet: &SamplePacket) -> [Vec3; 2] {
    let reflects = |lane: &usize| packet.normal.iter().any(|axis| axis[*lane] != 0.0);
    let (position, normal) = packet.lane((0..PACKET_SIZE).find(reflects).unwrap_or(0));
    [position, normal]
}

/// Irradiance of a point of a light, without shadows, emission and strength of the light.
fn irradiance_at([position, normal]: [Vec3; 2], point: &PackedLight) -> f32 {
    let is_directional = point.kind == LIGHT_DIRECTIONAL;
    let to_light = if is_directional { -point.direction } else { point.position - position };
    let distance2 = to_light.length_squared().max(f32::MIN_POSITIVE);
    let cosine = normal.dot(to_light).abs() / distance2.sqrt();
    if is_directional { cosine } else { cosine / distance2 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 3 x 2 tiles and two packets of a list.
    fn packets() -> InterleavedPackets {
        InterleavedPackets::new(&vec![SamplePacket::default(); 8], [3, 2])
    }

    #[test]
    fn points_and_lanes_are_inverse() {
        let packets = packets();
        for packet in [0, 7] {
            for point in 0..POINTS {
                assert_eq!(packets.point(packet, packets.lane(packet, point)), point);
            }
        }
    }

    /// Points that are traced together are in all cells of the light, and each 2x2 pixels have one of them.
    #[test]
    fn quarters_are_spread_over_light_and_pixels() {
        for quarter in 0..4 {
            let pixels: Vec<usize> = (0..CELLS).map(|cell| pixel_of_point(quarter * CELLS + cell)).collect();
            let mut blocks: Vec<usize> =
                pixels.iter().map(|lane| lane % SIDE / 2 + lane / SIDE / 2 * (SIDE / 2)).collect();
            blocks.sort_unstable();
            assert!(blocks.into_iter().eq(0..CELLS));
        }
    }

    #[test]
    fn windows_have_all_points() {
        let packets = packets();
        for index in 0..8 * PACKET_SIZE {
            let window: Vec<Option<usize>> = packets.window(index).collect();
            assert!(window.contains(&Some(index)));
            let mut points: Vec<usize> = window.iter().flatten().map(|&other| packets.point_of(other)).collect();
            points.sort_unstable();
            points.dedup();
            assert_eq!(points.len(), window.iter().flatten().count(), "points of the window of {index}");
            let [x, y] = [index / PACKET_SIZE % 3 * SIDE + index % SIDE, index / PACKET_SIZE / 3 * SIDE];
            let y = y + index % PACKET_SIZE / SIDE;
            let is_inside = index >= 6 * PACKET_SIZE || (4..21).contains(&x) && (4..13).contains(&y);
            assert!(!is_inside || window.iter().all(Option::is_some), "window of {index}");
        }
    }
}
