//! Visibility at half resolution: one sample in four is traced, and its neighbours share the result.

use glam::Vec3;

use super::{PACKET_SIZE, SamplePacket, trace_all};
use crate::shared::{PackedLight, TILE_SIZE};
use crate::trace::linked::LinkedScene;

/// One sample of each block of 2x2 pixels in a tile, or of each four in a list, as separate packets.
#[derive(Default)]
pub struct HalfPackets {
    packets: Vec<SamplePacket>,
    /// Visibility of the samples in `packets`.
    seen: Vec<u8>,
}

/// Blocks per packet.
const BLOCKS: usize = PACKET_SIZE / 4;

/// Lanes of a block.
fn lanes(block: usize) -> [usize; 4] {
    let side = TILE_SIZE as usize;
    let (x, y) = (2 * (block % (side / 2)), 2 * (block / (side / 2)));
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (y + dy) * side + x + dx)
}

impl HalfPackets {
    /// Selects one sample per block of `packets`.
    pub fn new(packets: &[SamplePacket]) -> Self {
        let gather = |four: &[SamplePacket]| {
            let mut half = SamplePacket::default();
            for (i, packet) in four.iter().enumerate() {
                for block in 0..BLOCKS {
                    // The first sample that reflects light represents its block.
                    let normal = |lane: usize| Vec3::from_array([0, 1, 2].map(|axis| packet.normal[axis][lane]));
                    let lanes = lanes(block);
                    let lane = lanes.into_iter().find(|&lane| normal(lane) != Vec3::ZERO).unwrap_or(lanes[0]);
                    let to = i * BLOCKS + block;
                    for axis in 0..3 {
                        half.position[axis][to] = packet.position[axis][lane];
                        half.normal[axis][to] = packet.normal[axis][lane];
                        half.geometric_normal[axis][to] = packet.geometric_normal[axis][lane];
                    }
                }
            }
            half
        };
        let packets: Vec<_> = packets.chunks(PACKET_SIZE / BLOCKS).map(gather).collect();
        Self { seen: vec![0; packets.len() * PACKET_SIZE], packets }
    }

    pub fn is_empty(&self) -> bool {
        self.packets.is_empty()
    }

    /// Traces them towards `light`, on all cores; `visibility` receives 64 values for each of the original packets.
    pub fn trace(&mut self, scene: LinkedScene, light: &PackedLight, visibility: &mut [u8]) {
        trace_all(scene, light, &self.packets, &mut self.seen);
        for (packet, seen) in visibility.chunks_mut(PACKET_SIZE).zip(self.seen.chunks(BLOCKS)) {
            for (block, &seen) in seen.iter().enumerate() {
                lanes(block).into_iter().for_each(|lane| packet[lane] = seen);
            }
        }
    }
}
