//! Visibility of lights: one byte per view sample and per point of a gather sample, traced or from shadow maps; the
//! hits of light rays; and what the lights' filters let through.

pub(super) mod cutouts;
pub(super) mod interleaved;
pub(super) mod method;
pub(super) mod shadow_culling;
pub(super) mod shadow_map;
pub(super) mod soft_light;

use std::sync::Arc;

use self::soft_light::SoftLight;
use super::indirect::light_rays::LightRayHits;
use super::light_factors::LightFactors;
use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context};
use crate::shared::{PackedLight, SOFT_POINTS};
use crate::trace::linked::LinkedScene;
use crate::trace::packet::half_resolution::HalfPackets;
use crate::trace::packet::interleaved::InterleavedPackets;
use crate::trace::packet::{PACKET_SIZE, SamplePacket, trace_all};

/// Visibility of one light. Four samples per word, 64 per packet.
pub struct Visibility {
    pub view_samples: Buffer<u32>,
    /// Points of gather samples.
    pub gather_points: Buffer<u32>,
    /// Contributions of its rays to gather samples.
    pub light_rays: LightRayHits,
    /// Of a light with a filter, or links that scale its light.
    pub factors: LightFactors,
    /// Points of an area light that moves, and its middle.
    pub points: Buffer<PackedLight>,
}

impl Visibility {
    /// Makes everything visible.
    pub fn clear(&mut self) {
        self.view_samples.host_mut().fill(u32::MAX);
        self.gather_points.host_mut().fill(u32::MAX);
        self.light_rays.clear();
    }

    /// Sets the points of a light that is sampled by interleaved points.
    pub fn set_points(&mut self, light: &SoftLight) {
        let (points, middle) = self.points.host_mut().split_at_mut(light.points.len());
        points.copy_from_slice(&light.points);
        middle[0] = light.middle;
    }
}

/// Index of a light's visibility among the buffers of a frame.
#[derive(Clone, Copy)]
pub struct VisibilitySlot(Option<usize>);

impl VisibilitySlot {
    /// Everything is visible: for lights without shadows.
    pub const ALL_VISIBLE: Self = Self(None);
}

/// Packets at half the resolution, for coarse images; empty unless rays are traced.
#[derive(Default)]
pub struct Half {
    pub view_samples: HalfPackets,
    pub gather_points: HalfPackets,
}

/// Maximum number of lights with shadows per frame.
const MAX_SHADOWED_LIGHTS_PER_FRAME: usize = 8;
/// Number of [`Visibility`]: of those lights, and of all that have no shadows.
pub const BUFFERS: usize = MAX_SHADOWED_LIGHTS_PER_FRAME + 1;

/// Visibility of the lights of one frame; reused by the next frame.
pub struct VisibilityBuffers {
    buffers: Vec<Visibility>,
    used: usize,
    half: Half,
    all_visible: Visibility,
    allows_factors: bool,
}

impl VisibilityBuffers {
    pub fn new(
        context: &Arc<Context>,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
        traced: bool,
        allows_factors: bool,
    ) -> Result<Self> {
        let all_visible = |packets: &[SamplePacket]| -> Result<Buffer<u32>> {
            let words = packets.len() * PACKET_SIZE / 4;
            let mut words = Buffer::new(context, "visibility", Access::HostWrites, words)?;
            words.host_mut().fill(u32::MAX);
            Ok(words)
        };
        let gather_packets = transfer.map_or(&[][..], |t| &t.packets);
        let new = |wanted: bool| -> Result<Visibility> {
            let mut points = Buffer::new(context, "points of a light", Access::HostWrites, SOFT_POINTS as usize + 1)?;
            points.host_mut().fill(bytemuck::Zeroable::zeroed());
            Ok(Visibility {
                view_samples: all_visible(&framebuffer.packets)?,
                gather_points: all_visible(gather_packets)?,
                light_rays: LightRayHits::empty(context, transfer)?,
                factors: LightFactors::new(context, framebuffer, transfer, wanted)?,
                points,
            })
        };
        let half = match traced {
            true => Half {
                view_samples: HalfPackets::new(&framebuffer.packets),
                gather_points: HalfPackets::new(gather_packets),
            },
            false => Half::default(),
        };
        Ok(Self {
            buffers: (0..MAX_SHADOWED_LIGHTS_PER_FRAME).map(|_| new(allows_factors)).collect::<Result<_>>()?,
            used: 0,
            half,
            all_visible: new(false)?,
            allows_factors,
        })
    }

    /// Makes room for factors on lights.
    pub fn allow_factors(
        &mut self,
        context: &Arc<Context>,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
    ) -> Result<()> {
        if !self.allows_factors {
            for buffers in &mut self.buffers {
                buffers.factors = LightFactors::new(context, framebuffer, transfer, true)?;
            }
            self.allows_factors = true;
        }
        Ok(())
    }

    pub fn allows_factors(&self) -> bool {
        self.allows_factors
    }

    /// Begins a new frame: all buffers are free.
    pub fn restart(&mut self) {
        self.used = 0;
    }

    /// Number of free buffers in this frame.
    pub fn left(&self) -> usize {
        self.buffers.len() - self.used
    }

    /// Takes a free buffer; at most [`Self::left`] times per frame.
    pub fn take(&mut self) -> (VisibilitySlot, &mut Visibility, &mut Half) {
        self.used += 1;
        let index = self.used - 1;
        (VisibilitySlot(Some(index)), &mut self.buffers[index], &mut self.half)
    }

    pub fn get(&self, slot: VisibilitySlot) -> &Visibility {
        slot.0.map_or(&self.all_visible, |index| &self.buffers[index])
    }
}

/// How the samples of a list are traced towards a light, on all cores.
pub enum Rays<'a> {
    /// All of them.
    Each(&'a [SamplePacket]),
    /// One of four.
    Half(&'a mut HalfPackets),
    /// Towards different points of the light; see [`InterleavedPackets::trace`].
    Interleaved(&'a mut InterleavedPackets, &'a [SamplePacket], Option<&'a [u64]>),
}

/// Traces samples towards `points` of a light: one, or all that are interleaved.
pub fn trace(words: &mut Buffer<u32>, scene: LinkedScene, rays: Rays, points: &[PackedLight]) {
    let visibility = bytemuck::cast_slice_mut(words.host_mut());
    match rays {
        Rays::Each(packets) => trace_all(scene, &points[0], packets, visibility),
        Rays::Half(half) => half.trace(scene, &points[0], visibility),
        Rays::Interleaved(interleaved, packets, similar) => {
            interleaved.trace(scene, packets, points, similar, visibility);
        }
    }
}
