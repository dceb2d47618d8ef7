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
    /// Number of original packets that are tiles.
    tile_count: usize,
}

/// Packets of a group: as many as points.
const GROUP: usize = SOFT_POINTS as usize;
/// Side of a group of tiles.
const SIDE: usize = TILE_SIZE as usize;

/// Point of a pixel, by its lane in a tile: the four low bits repeat after four pixels in x and in y, so that each
/// window of 4x4 pixels has all 16.
pub fn point_of_pixel(lane: usize) -> usize {
    let (x, y) = (lane % SIDE, lane / SIDE);
    (x & 3) + 4 * (y & 3) + 16 * (x >> 2) + 32 * (y >> 2)
}

/// Point of a sample in a list, by its index modulo 64: few successive samples have points all over the light. Twin:
/// glsl/lib/soft.glsl.
pub fn point_in_list(lane: usize) -> usize {
    ((5 * lane) & 15) + (lane & 48)
}

/// Point of each sample of a packet.
fn points_by_lane(is_tile: bool) -> [usize; PACKET_SIZE] {
    std::array::from_fn(if is_tile { point_of_pixel } else { point_in_list })
}

impl InterleavedPackets {
    /// `packets` begins with the tiles of a picture, `[columns, rows]` of them, by rows; a list follows.
    pub fn new(packets: &[SamplePacket], [columns, rows]: [usize; 2]) -> Self {
        let tile_count = columns * rows;
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for y in (0..rows).step_by(SIDE) {
            for x in (0..columns).step_by(SIDE) {
                // In Morton order, so that the samples of a register are near each other.
                let bit = |i: usize, from: usize, to: usize| (i >> from & 1) << to;
                let column = |i| x + bit(i, 0, 0) + bit(i, 2, 1) + bit(i, 4, 2);
                let row = |i| y + bit(i, 1, 0) + bit(i, 3, 1) + bit(i, 5, 2);
                let tiles = (0..GROUP).filter(|&i| column(i) < columns && row(i) < rows);
                groups.push(tiles.map(|i| row(i) * columns + column(i)).collect());
            }
        }
        let listed: Vec<usize> = (tile_count..packets.len()).collect();
        groups.extend(listed.chunks(GROUP).map(<[usize]>::to_vec));
        let mut places = vec![[0; 2]; packets.len()];
        let mut regrouped = vec![SamplePacket::default(); groups.len() * GROUP];
        for (first, group) in (0..).step_by(GROUP).zip(&groups) {
            for (to, &from) in group.iter().enumerate() {
                places[from] = [first, to];
                for (lane, point) in points_by_lane(from < tile_count).into_iter().enumerate() {
                    let (packet, original) = (&mut regrouped[first + point], &packets[from]);
                    for axis in 0..3 {
                        packet.position[axis][to] = original.position[axis][lane];
                        packet.normal[axis][to] = original.normal[axis][lane];
                        packet.geometric_normal[axis][to] = original.geometric_normal[axis][lane];
                    }
                }
            }
        }
        let none = vec![0; regrouped.len()];
        Self { facing: none.clone(), packets: regrouped, seen: none, places, tile_count }
    }

    /// Traces each sample towards its point of the light, on all cores; `visibility` receives 64 values for each of the
    /// original packets, 255 or 0: behind blending surfaces as often as the light is attenuated. With `similar`, which has
    /// for each sample a bit for each in its [`window`], a value is the mean over the similar ones that face the light.
    pub fn trace(
        &mut self,
        scene: LinkedScene,
        points: &[PackedLight],
        similar: Option<&[u16]>,
        visibility: &mut [u8],
    ) {
        let Self { packets, seen, facing, places, tile_count } = self;
        seen.par_chunks_mut(GROUP).zip(facing.par_chunks_mut(GROUP)).zip(packets.par_chunks(GROUP)).for_each(
            |((seen, facing), packets)| {
                let mut bytes = [0; GROUP * PACKET_SIZE];
                trace_in_turn(scene, points, packets, &mut bytes, facing);
                for (point, (seen, bytes)) in seen.iter_mut().zip(bytes.chunks(PACKET_SIZE)).enumerate() {
                    // Other thresholds in the other cells of a window.
                    let threshold = 16 * (point as u8 & 15) + 7;
                    *seen = bytes.iter().rev().fold(0, |bits, &byte| bits << 1 | u64::from(byte > threshold));
                }
            },
        );
        let (seen, facing, tile_count) = (&*seen, &*facing, *tile_count);
        visibility.par_chunks_mut(PACKET_SIZE).zip(&mut *places).with_min_len(GROUP).enumerate().for_each(
            |(from, (visibility, [first, to]))| {
                let is_tile = from < tile_count;
                let points = points_by_lane(is_tile);
                let by_lane = |bits: &[u64]| {
                    points.iter().rev().fold(0, |by_lane, point| by_lane << 1 | (bits[*first + point] >> *to & 1))
                };
                let seen = by_lane(seen);
                match similar {
                    Some(similar) => {
                        let similar = &similar[from * PACKET_SIZE..][..PACKET_SIZE];
                        filter(seen, by_lane(facing), similar, is_tile, visibility);
                    }
                    None => visibility.iter_mut().enumerate().for_each(|(i, v)| *v = 255 * (seen >> i & 1) as u8),
                }
            },
        );
    }
}

/// Fraction of the similar samples around each of a packet that see the light, of those that face it. A sample that has
/// none keeps what it sees.
fn filter(seen: u64, facing: u64, similar: &[u16], is_tile: bool, fractions: &mut [u8]) {
    let windows = |bits: u64| -> [u16; WINDOWS * WINDOWS] {
        std::array::from_fn(|i| {
            let corner = if is_tile { i / WINDOWS * SIDE + i % WINDOWS } else { 16 * (i & 3) };
            let bits = bits >> corner;
            match is_tile {
                true => (0..4).fold(0, |window, row| window | (bits >> (SIDE * row) & 15) << (4 * row)) as u16,
                false => bits as u16,
            }
        })
    };
    let (seen_by, facing_by) = (windows(seen & facing), windows(facing));
    for (lane, (fraction, similar)) in fractions.iter_mut().zip(similar).enumerate() {
        let window = window_of(lane, is_tile);
        let count = (facing_by[window] & similar).count_ones();
        let seen_count = (seen_by[window] & similar).count_ones();
        let own = 255 * (seen >> lane & 1) as u32;
        *fraction = ((255 * seen_count + count / 2).checked_div(count)).unwrap_or(own) as u8;
    }
}

/// Number of windows of four pixels along a side of a tile.
const WINDOWS: usize = SIDE - 3;

/// Index of the window around a sample.
fn window_of(lane: usize, is_tile: bool) -> usize {
    let [left, top] = [lane % SIDE, lane / SIDE].map(|x| x.saturating_sub(2).min(WINDOWS - 1));
    if is_tile { top * WINDOWS + left } else { lane / 16 }
}

/// Lanes of the 16 samples around one: of a tile 4x4 pixels, of a list 16 successive ones. They all see different cells
/// of the light.
pub fn window(lane: usize, is_tile: bool) -> impl Iterator<Item = usize> {
    let window = window_of(lane, is_tile);
    (0..16).map(move |i| match is_tile {
        true => (window / WINDOWS + i / 4) * SIDE + window % WINDOWS + i % 4,
        false => 16 * window + i,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_have_a_point_in_each_cell() {
        for is_tile in [true, false] {
            let points = points_by_lane(is_tile);
            let mut sorted = points;
            sorted.sort_unstable();
            assert!(sorted.into_iter().eq(0..PACKET_SIZE));
            for lane in 0..PACKET_SIZE {
                let lanes: Vec<usize> = window(lane, is_tile).collect();
                assert!(lanes.contains(&lane));
                let mut cells: Vec<usize> = lanes.into_iter().map(|lane| points[lane] % 16).collect();
                cells.sort_unstable();
                assert!(cells.into_iter().eq(0..16), "window of {lane}");
            }
        }
        // Points of a gather sample are as far apart as they can be.
        assert!((0..PACKET_SIZE).step_by(8).all(|lane| point_in_list(lane) % 16 != point_in_list(lane + 1) % 16));
    }

    #[test]
    fn fractions_are_means_over_similar_samples_that_face_the_light() {
        let fractions = |seen: u64, facing: u64, similar: u16, is_tile: bool| {
            let mut fractions = [7; PACKET_SIZE];
            filter(seen, facing, &[similar; PACKET_SIZE], is_tile, &mut fractions);
            fractions
        };
        for is_tile in [true, false] {
            assert_eq!(fractions(u64::MAX, u64::MAX, u16::MAX, is_tile), [255; PACKET_SIZE]);
            assert_eq!(fractions(0, u64::MAX, u16::MAX, is_tile), [0; PACKET_SIZE]);
            // Those that do not face the light do not count.
            let odd = 0xaaaa_aaaa_aaaa_aaaa;
            assert_eq!(fractions(odd, u64::MAX, u16::MAX, is_tile), [128; PACKET_SIZE]);
            assert_eq!(fractions(odd, odd, u16::MAX, is_tile), [255; PACKET_SIZE]);
            // Without any similar sample each keeps what it sees.
            let alone = fractions(odd, u64::MAX, 0, is_tile);
            assert!((0..PACKET_SIZE).all(|lane| alone[lane] == if lane % 2 == 1 { 255 } else { 0 }));
            // One neighbour alone is seen.
            for lane in 0..PACKET_SIZE {
                for (i, other) in window(lane, is_tile).enumerate() {
                    assert_eq!(fractions(1 << other, u64::MAX, 1 << i, is_tile)[lane], 255, "{lane} {other}");
                    assert_eq!(fractions(!(1 << other), u64::MAX, 1 << i, is_tile)[lane], 0, "{lane} {other}");
                }
            }
        }
    }
}
