//! Comparison of the picture with that of a snapshot: a wipe, or the difference.

use std::sync::Arc;

use crate::desk::Desk;
use crate::error::Result;
use crate::gpu::{Access, Buffer, ComparisonOverlay, Context, Pixels};
use crate::image::png::srgb8_from_linear;
use crate::relight::{Picture, Relighter, Request, ToneMap};

/// An active comparison with a snapshot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparing {
    pub slot: usize,
    pub kind: Comparison,
}

/// A way to compare two pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Comparison {
    /// The snapshot left of this share of the picture's width, the current lights right of it.
    Wipe { at: f32 },
    /// Absolute difference of each channel, with exposure but without tone curve.
    Difference,
}

/// Pixels drawn over the picture, and the inputs they were computed from.
pub struct ComparisonImage {
    buffer: Buffer<u32>,
    size: [u32; 2],
    made_for: Option<MadeFor>,
    /// Scene-linear pixels of a snapshot, with its id.
    linear: Option<(u64, Vec<[f32; 3]>)>,
}

#[derive(Clone, PartialEq)]
struct MadeFor {
    snapshot: u64,
    exposure: f32,
    blue_first: bool,
    /// Set for a wipe.
    tone_map: Option<ToneMap>,
    /// Version of the desk; set for a difference.
    version: Option<u64>,
}

impl ComparisonImage {
    pub fn new(context: &Arc<Context>, size: [u32; 2]) -> Result<Self> {
        let count = size[0] as usize * size[1] as usize;
        let buffer = Buffer::new(context, "pictures (compared)", Access::HostWrites, count)?;
        Ok(Self { buffer, size, made_for: None, linear: None })
    }

    /// Discards the pixels, because the light images have changed without an edit.
    pub fn invalidate(&mut self) {
        self.made_for = None;
        self.linear = None;
    }

    /// Computes the pixels if they are out of date. Returns whether the relighter is left with the snapshot's lights.
    pub fn make(
        &mut self,
        comparing: Comparing,
        desk: &Desk,
        relighter: &mut Relighter,
        (exposure, tone_map, blue_first): (f32, ToneMap, bool),
    ) -> Result<bool> {
        let Some((snapshot, rig)) = desk.snapshots().get(comparing.slot).zip(desk.snapshot_rig(comparing.slot)) else {
            return Ok(false);
        };
        let is_wipe = matches!(comparing.kind, Comparison::Wipe { .. });
        let wanted = MadeFor {
            snapshot: snapshot.id,
            exposure,
            blue_first,
            tone_map: is_wipe.then(|| tone_map.clone()),
            version: (!is_wipe).then_some(desk.version()),
        };
        if self.made_for.as_ref() == Some(&wanted) {
            return Ok(false);
        }
        let mut relit = false;
        if is_wipe {
            relighter.set_rig(&rig)?;
            relighter.select(&[]);
            let pixels = relighter.display(Request { exposure, tone_map, ..Request::default() })?;
            write(&mut self.buffer, pixels.iter().copied(), blue_first);
            relit = true;
        } else {
            // The current lights come first, since the relighter has them.
            let now = relighter.linear(Picture::Whole)?.to_vec();
            if self.linear.as_ref().is_none_or(|(id, _)| *id != snapshot.id) {
                relighter.set_rig(&rig)?;
                relighter.select(&[]);
                self.linear = Some((snapshot.id, relighter.linear(Picture::Whole)?.to_vec()));
                relit = true;
            }
            let (_, then) = self.linear.as_ref().expect("made above");
            let scale = exposure.exp2();
            let apart = |(a, b): (&[f32; 3], &[f32; 3])| {
                let channel = |c: usize| srgb8_from_linear(scale * (a[c] - b[c]).abs());
                [channel(0), channel(1), channel(2), 255]
            };
            write(&mut self.buffer, now.iter().zip(then).map(apart), blue_first);
        }
        self.made_for = Some(wanted);
        Ok(relit)
    }

    /// Returns the pixels to draw over the picture, and the share of its width that they cover.
    pub fn overlay(&self, comparison: Comparison) -> ComparisonOverlay<'_> {
        let share = match comparison {
            Comparison::Wipe { at } => at,
            Comparison::Difference => 1.0,
        };
        ComparisonOverlay { pixels: Pixels { buffer: &self.buffer, width: self.size[0], height: self.size[1] }, share }
    }
}

fn write(buffer: &mut Buffer<u32>, pixels: impl Iterator<Item = [u8; 4]>, blue_first: bool) {
    for (word, [r, g, b, a]) in buffer.host_mut().iter_mut().zip(pixels) {
        *word = u32::from_le_bytes(if blue_first { [b, g, r, a] } else { [r, g, b, a] });
    }
}
