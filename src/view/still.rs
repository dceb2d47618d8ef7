//! Pictures of data: channels of the deep framebuffer, errors of indirect light.

use std::sync::Arc;

use glam::Vec3;

use super::LoadedScene;
use super::refine::final_gathering::FinalGathering;
use super::views::{View, Views};
use crate::bake::channels::Channel;
use crate::error::Result;
use crate::gpu::{Buffer, Context, Pixels};
use crate::image::png::srgb8_from_linear;
use crate::relight::output::exposure::stop_color;
use crate::scene::Rig;

/// A picture, and the values that its colours show.
pub struct Still {
    view: View,
    layer: u32,
    /// Version of the errors that final gathering expects.
    version: u64,
    values: Vec<Option<Vec3>>,
    pixels: Buffer<u32>,
    size: [u32; 2],
}

/// Colour of pixels without a value: a grey that is rare in channels.
const NOTHING: [u8; 3] = [28, 28, 34];
/// Relative error in the middle of the colour scale.
pub const MIDDLE_ERROR: f32 = 0.01;

impl Still {
    /// Returns the still for `views`; reuses `still` if it matches.
    pub fn get(
        still: Option<Self>,
        context: &Arc<Context>,
        opened: &LoadedScene,
        views: &Views,
        blue_first: bool,
        (gathering, rig): (&FinalGathering, &Rig),
    ) -> Result<Self> {
        let version = gathering.version();
        if let Some(still) = still
            && (still.view, still.layer, still.version) == (views.view, views.layer, version)
        {
            return Ok(still);
        }
        let framebuffer = &opened.framebuffer;
        let size = [framebuffer.tiling.width, framebuffer.tiling.height];
        let nothing = || vec![None; (size[0] * size[1]) as usize];
        let (values, colors): (Vec<Option<Vec3>>, Vec<[u8; 3]>) = match views.view {
            View::Channel(channel) => {
                let values = framebuffer.channel(channel, views.layer, opened.scene.space);
                let colors = channel_colors(channel, &values);
                (values, colors)
            }
            _ => {
                let of_transfer = || opened.transfer.as_ref().and_then(|t| t.errors(framebuffer));
                let gathered = gathering.errors(rig).map(|errors| errors.into_iter().map(Some).collect());
                let errors: Option<Vec<Option<f32>>> = gathered.or_else(of_transfer);
                let values = errors.map_or_else(nothing, |e| e.into_iter().map(|e| e.map(Vec3::splat)).collect());
                let color = |value: &Option<Vec3>| value.map_or(NOTHING, |v| stop_color((v.x / MIDDLE_ERROR).log2()));
                let colors = values.iter().map(color).collect();
                (values, colors)
            }
        };
        let order = |[r, g, b]: [u8; 3]| if blue_first { [b, g, r, 255] } else { [r, g, b, 255] };
        let words: Vec<u32> = colors.into_iter().map(|color| u32::from_le_bytes(order(color))).collect();
        let pixels = Buffer::from_slice(context, "pictures (still)", &words)?;
        Ok(Self { view: views.view, layer: views.layer, version, values, pixels, size })
    }

    pub fn pixels(&self) -> Pixels<'_> {
        Pixels { buffer: &self.pixels, width: self.size[0], height: self.size[1] }
    }

    pub fn value(&self, [x, y]: [u32; 2]) -> Option<Vec3> {
        *self.values.get((y * self.size[0] + x) as usize)?
    }
}

fn channel_colors(channel: Channel, values: &[Option<Vec3>]) -> Vec<[u8; 3]> {
    let known = || values.iter().flatten().copied();
    let low = known().reduce(Vec3::min).unwrap_or_default();
    let high = known().reduce(Vec3::max).unwrap_or_default();
    let size = (high - low).max(Vec3::splat(f32::MIN_POSITIVE));
    let plain = |v: Vec3| v.clamp(Vec3::ZERO, Vec3::ONE).to_array().map(|x| (255.0 * x).round() as u8);
    let color = |v: Vec3| match channel {
        Channel::Normal | Channel::GeometricNormal => plain(0.5 + 0.5 * v),
        // Near surfaces are bright.
        Channel::Distance => plain((high - v) / size),
        Channel::Position => plain((v - low) / size),
        Channel::BaseColor | Channel::Weight => v.to_array().map(srgb8_from_linear),
        Channel::Metallic | Channel::Roughness => plain(v),
        Channel::Layers | Channel::Samples => plain(v / high.max(Vec3::ONE)),
    };
    values.iter().map(|value| value.map_or(NOTHING, color)).collect()
}
