//! Visibility of a light with a size by interleaved sampling [Keller 2001]: each sample is traced towards one of 64
//! points of the light, its neighbours towards others.

use rayon::prelude::*;

use super::{PACKET_SIZE, SamplePacket, trace_in_turn};
use crate::shared::{PackedLight, SOFT_POINTS, TILE_SIZE};
use crate::trace::linked::LinkedScene;

/// Samples of 64 packets, regrouped into 64 packets such that all samples of one have the same point.
#[derive(Default)]
pub struct InterleavedPackets {
    packets: Vec<SamplePacket>,
    /// Which samples of each of `packets` see the light.
    seen: Vec<u64>,
    /// Which samples of each of `packets` face the light.
    facing: Vec<u64>,
    /// Where each original packet is: first packet of its group, and its lane there.
    places: Vec<[usize; 2]>,
    /// Columns and rows of the original packets that are tiles.
    tiles: [usize; 2],
    /// Samples of each original packet that see the light, and that face it.
    bits: Vec<[u64; 2]>,
}

/// Packets of a group: as many as points.
const GROUP: usize = SOFT_POINTS as usize;
/// Side of a tile, of a group of tiles, and of a window of pixels.
const SIDE: usize = TILE_SIZE as usize;
/// Pixels of a window before and behind its middle.
const BEFORE: usize = SIDE / 2;
const BEHIND: usize = SIDE - 1 - BEFORE;
/// Bits of the middle 4x4 pixels of a window.
const MIDDLE: u64 = 0x0000_3c3c_3c3c_0000;
/// Largest difference of two means of which the one over fewer samples may be off by chance.
const BY_CHANCE: f32 = 0.1;

/// Point of a pixel, by its lane in a tile. Points repeat after eight pixels in x and in y, so that each window of 8x8
/// pixels has all 64; their four low bits after four, so that the middle 4x4 have 16 that are far from each other.
fn point_of_pixel(lane: usize) -> usize {
    let (x, y) = (lane % SIDE, lane / SIDE);
    (x & 3) + 4 * (y & 3) + 16 * (x >> 2) + 32 * (y >> 2)
}

/// The same of a sample in a list: successive samples have points all over the light. Twin: glsl/lib/soft.glsl.
fn point_in_list(lane: usize) -> usize {
    ((5 * lane) & 15) + (lane & 48)
}

impl InterleavedPackets {
    /// `packets` begins with the tiles of a picture, `[columns, rows]` of them, by rows; a list follows.
    pub fn new(packets: &[SamplePacket], tiles: [usize; 2]) -> Self {
        let [columns, rows] = tiles;
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for y in (0..rows).step_by(SIDE) {
            for x in (0..columns).step_by(SIDE) {
                // In Morton order, so that the samples of a register are near each other.
                let bit = |i: usize, from: usize, to: usize| (i >> from & 1) << to;
                let column = |i| x + bit(i, 0, 0) + bit(i, 2, 1) + bit(i, 4, 2);
                let row = |i| y + bit(i, 1, 0) + bit(i, 3, 1) + bit(i, 5, 2);
                let places = (0..GROUP).map(|i| [column(i), row(i)]).filter(|[x, y]| *x < columns && *y < rows);
                groups.push(places.map(|[x, y]| y * columns + x).collect());
            }
        }
        let listed: Vec<usize> = (columns * rows..packets.len()).collect();
        groups.extend(listed.chunks(GROUP).map(<[usize]>::to_vec));
        let mut made = Self {
            packets: vec![SamplePacket::default(); groups.len() * GROUP],
            seen: vec![0; groups.len() * GROUP],
            facing: vec![0; groups.len() * GROUP],
            places: vec![[0; 2]; packets.len()],
            tiles,
            bits: vec![[0; 2]; packets.len()],
        };
        for (first, group) in (0..).step_by(GROUP).zip(&groups) {
            for (to, &from) in group.iter().enumerate() {
                made.places[from] = [first, to];
                for lane in 0..PACKET_SIZE {
                    let point = made.point(from, lane);
                    let (packet, original) = (&mut made.packets[first + point], &packets[from]);
                    for axis in 0..3 {
                        packet.position[axis][to] = original.position[axis][lane];
                        packet.normal[axis][to] = original.normal[axis][lane];
                        packet.geometric_normal[axis][to] = original.geometric_normal[axis][lane];
                    }
                }
            }
        }
        made
    }

    /// Point of a sample, given by original packet and lane.
    fn point(&self, packet: usize, lane: usize) -> usize {
        if packet < self.tile_count() { point_of_pixel(lane) } else { point_in_list(lane) }
    }

    fn tile_count(&self) -> usize {
        self.tiles[0] * self.tiles[1]
    }

    /// Point of the light that sample `index` is traced to.
    pub fn point_of(&self, index: usize) -> usize {
        self.point(index / PACKET_SIZE, index % PACKET_SIZE)
    }

    /// Traces each sample towards its point of the light, on all cores; `visibility` receives 64 values for each of the
    /// original packets, 255 or 0: behind blending surfaces as often as the light is attenuated. With `similar`, which has
    /// for each sample a bit for each in its [`window`](Self::window), a value is the mean over the similar ones that face
    /// the light.
    pub fn trace(
        &mut self,
        scene: LinkedScene,
        points: &[PackedLight],
        similar: Option<&[u64]>,
        visibility: &mut [u8],
    ) {
        let Self { packets, seen, facing, .. } = self;
        seen.par_chunks_mut(GROUP).zip(facing.par_chunks_mut(GROUP)).zip(packets.par_chunks(GROUP)).for_each(
            |((seen, facing), packets)| {
                let mut bytes = [0; GROUP * PACKET_SIZE];
                trace_in_turn(scene, points, packets, &mut bytes, facing);
                for (point, (seen, bytes)) in seen.iter_mut().zip(bytes.chunks(PACKET_SIZE)).enumerate() {
                    // Another threshold for each of the middle samples of a window.
                    let threshold = 16 * (point as u8 & 15) + 7;
                    *seen = bytes.iter().rev().fold(0, |bits, &byte| bits << 1 | u64::from(byte > threshold));
                }
            },
        );
        let mut bits = std::mem::take(&mut self.bits);
        bits.par_iter_mut().with_min_len(PACKETS_A_TASK).enumerate().for_each(|(packet, bits)| {
            let [first, to] = self.places[packet];
            *bits = [0; 2];
            for lane in 0..PACKET_SIZE {
                let point = self.point(packet, lane);
                let bit = |bits: &[u64]| (bits[first + point] >> to & 1) << lane;
                *bits = [bits[0] | bit(&self.seen), bits[1] | bit(&self.facing)];
            }
        });
        self.bits = bits;
        let fractions = visibility.par_chunks_mut(PACKET_SIZE).with_min_len(PACKETS_A_TASK).enumerate();
        fractions.for_each(|(packet, fractions)| match similar {
            Some(similar) => self.filter(packet, &similar[packet * PACKET_SIZE..][..PACKET_SIZE], fractions),
            None => {
                let [seen, _] = self.bits[packet];
                fractions
                    .iter_mut()
                    .enumerate()
                    .for_each(|(lane, fraction)| *fraction = 255 * (seen >> lane & 1) as u8);
            }
        });
    }

    /// Fraction of the similar samples around each of a packet that see the light, of those that face it: over all of the
    /// window, unless the middle of it tells otherwise. A sample that has none keeps what it sees.
    fn filter(&self, packet: usize, similar: &[u64], fractions: &mut [u8]) {
        let rows = (packet < self.tile_count()).then(|| self.rows_around(packet));
        let own = self.bits[packet];
        for (lane, (fraction, similar)) in fractions.iter_mut().zip(similar).enumerate() {
            let [seen, facing] = match &rows {
                Some(rows) => [0, 1].map(|of| {
                    let row = |r: usize| u64::from(rows[lane / SIDE + r][of] >> (lane % SIDE) & 255) << (SIDE * r);
                    (0..SIDE).fold(0, |window, r| window | row(r))
                }),
                None => own,
            };
            let mean = |window: u64| {
                let count = (facing & similar & window).count_ones();
                (count > 0).then(|| (seen & facing & similar & window).count_ones() as f32 / count as f32)
            };
            let middle = if rows.is_some() { mean(MIDDLE) } else { None };
            let all = mean(u64::MAX).unwrap_or((own[0] >> lane & 1) as f32);
            let mean = middle.filter(|middle| (middle - all).abs() > BY_CHANCE).unwrap_or(all);
            *fraction = (255.0 * mean + 0.5) as u8;
        }
    }

    /// Bits of a tile and of the pixels around it, of those that see the light and those that face it: rows of which each
    /// begins [`BEFORE`] pixels before the tile.
    fn rows_around(&self, tile: usize) -> [[u16; 2]; SIDE + BEFORE + BEHIND] {
        let [columns, rows] = self.tiles;
        let (column, row) = (tile % columns, tile / columns);
        let [left, right] = [column > 0, column + 1 < columns];
        std::array::from_fn(|r| {
            let y = row * SIDE + r;
            if y < BEFORE || y - BEFORE >= rows * SIDE {
                return [0; 2];
            }
            let (tile, shift) = ((y - BEFORE) / SIDE * columns + column, (y - BEFORE) % SIDE * SIDE);
            [0, 1].map(|of| {
                let row = |tile: usize| (self.bits[tile][of] >> shift & 255) as u16;
                let before = if left { row(tile - 1) >> (SIDE - BEFORE) } else { 0 };
                let behind = if right { row(tile + 1) << (SIDE + BEFORE) } else { 0 };
                before | row(tile) << BEFORE | behind
            })
        })
    }

    /// The 64 samples around one, with different points: of a picture 8x8 pixels, of a list those of its packet; by index,
    /// `None` outside of the picture.
    pub fn window(&self, index: usize) -> impl Iterator<Item = Option<usize>> {
        let (packet, lane) = (index / PACKET_SIZE, index % PACKET_SIZE);
        let (is_tile, [columns, rows]) = (packet < self.tile_count(), self.tiles);
        let [x, y] = match is_tile {
            true => [packet % columns * SIDE + lane % SIDE, packet / columns * SIDE + lane / SIDE],
            false => [0; 2],
        };
        (0..GROUP).map(move |i| {
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

/// Packets of one task.
const PACKETS_A_TASK: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    /// 3 x 2 tiles and two packets of a list.
    fn packets() -> InterleavedPackets {
        InterleavedPackets::new(&vec![SamplePacket::default(); 8], [3, 2])
    }

    #[test]
    fn windows_have_all_points() {
        let packets = packets();
        let different = |mut points: Vec<usize>| {
            let count = points.len();
            points.sort_unstable();
            points.dedup();
            (points.len() == count).then_some(count)
        };
        for index in 0..8 * PACKET_SIZE {
            let window: Vec<Option<usize>> = packets.window(index).collect();
            assert!(window.contains(&Some(index)));
            let points = window.iter().flatten().map(|&other| packets.point_of(other)).collect();
            let count = different(points).expect("no point twice");
            let [x, y] = [index / PACKET_SIZE % 3 * SIDE + index % SIDE, index / PACKET_SIZE / 3 * SIDE];
            let y = y + index % PACKET_SIZE / SIDE;
            let is_inside = index >= 6 * PACKET_SIZE || (4..21).contains(&x) && (4..13).contains(&y);
            assert!(!is_inside || count == GROUP, "window of {index} has {count}");
            if is_inside && index < 6 * PACKET_SIZE {
                let middle = window.iter().enumerate().filter(|(i, _)| MIDDLE >> i & 1 != 0);
                let cells = middle.map(|(_, other)| packets.point_of(other.unwrap()) % 16).collect();
                assert_eq!(different(cells), Some(16));
            }
        }
    }

    #[test]
    fn fractions_are_means_over_similar_samples_that_face_the_light() {
        let mut packets = packets();
        let mut fractions = |seen: u64, facing: u64, similar: u64| {
            packets.bits.fill([seen, facing]);
            let mut fractions = [7; 8 * PACKET_SIZE];
            for (packet, fractions) in fractions.chunks_mut(PACKET_SIZE).enumerate() {
                packets.filter(packet, &[similar; PACKET_SIZE], fractions);
            }
            fractions
        };
        assert_eq!(fractions(u64::MAX, u64::MAX, u64::MAX), [255; 8 * PACKET_SIZE]);
        assert_eq!(fractions(0, u64::MAX, u64::MAX), [0; 8 * PACKET_SIZE]);
        let odd = 0xaaaa_aaaa_aaaa_aaaa;
        assert!(fractions(odd, u64::MAX, u64::MAX)[6 * PACKET_SIZE..].iter().all(|&fraction| fraction == 128));
        // Those that do not face the light do not count.
        assert_eq!(fractions(odd, odd, u64::MAX), [255; 8 * PACKET_SIZE]);
        // Without any similar sample each keeps what it sees.
        let alone = fractions(odd, u64::MAX, 0);
        assert!(alone.iter().enumerate().all(|(i, &fraction)| fraction == if i % 2 == 1 { 255 } else { 0 }));
    }

    /// The middle of a window decides where it differs much from the rest.
    #[test]
    fn edges_of_shadows_are_kept() {
        let mut packets = packets();
        // All left of x = 12.
        for (tile, bits) in packets.bits.iter_mut().enumerate() {
            *bits = [[u64::MAX, 0x0f0f_0f0f_0f0f_0f0f, 0][tile % 3], u64::MAX];
        }
        let mut fractions = [0; PACKET_SIZE];
        packets.filter(1, &[u64::MAX; PACKET_SIZE], &mut fractions);
        // The middle of the window begins two pixels before.
        let quarters = [4, 4, 4, 3, 2, 1, 0, 0];
        assert_eq!(fractions[24..32], quarters.map(|quarters| (255.0 * quarters as f32 / 4.0 + 0.5) as u8));
    }

    /// One sample sees the light: it counts in the windows that have it, by the bit that the window has for it.
    #[test]
    fn filters_read_the_window() {
        let mut packets = packets();
        for seen in (0..8 * PACKET_SIZE).step_by(37) {
            packets.bits.fill([0, u64::MAX]);
            packets.bits[seen / PACKET_SIZE][0] = 1 << (seen % PACKET_SIZE);
            for index in 0..8 * PACKET_SIZE {
                for (i, other) in packets.window(index).enumerate() {
                    let (packet, lane) = (index / PACKET_SIZE, index % PACKET_SIZE);
                    let (mut fractions, mut similar) = ([0; PACKET_SIZE], [0; PACKET_SIZE]);
                    similar[lane] = 1 << i;
                    packets.filter(packet, &similar, &mut fractions);
                    let wanted = if other == Some(seen) || other.is_none() && index == seen { 255 } else { 0 };
                    assert_eq!(fractions[lane], wanted, "{seen} in the window of {index}");
                }
            }
        }
    }
}
