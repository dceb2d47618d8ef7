//! Outputs of the relighter: the last kernel and the pixels that it writes.

use std::sync::Arc;

use super::ToneMap;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Kernel};
use crate::shared::gpu_struct::{Compute, Push};
use crate::shared::*;

/// Format and destination of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// Scene-linear, for the host.
    Linear,
    /// 8-bit sRGB, for the host.
    Display { exposure: f32, tone_map: ToneMap },
    /// 8-bit sRGB, for a window, in its channel order.
    Screen { exposure: f32, tone_map: ToneMap, blue_first: bool },
}

/// Kernels and buffers of all outputs, each created on first use.
pub struct Outputs {
    /// By `OUTPUT_` constant, for whole pictures; `sheet_kernels` for cells of the contact sheet.
    kernels: [Option<Kernel<CompositePush>>; OUTPUT_COUNT as usize],
    sheet_kernels: [Option<Kernel<SheetPush>>; OUTPUT_COUNT as usize],
    linear: Option<Buffer<u32>>,
    display: Option<Buffer<u32>>,
    screen: Option<Buffer<u32>>,
    pixel_count: usize,
    context: Arc<Context>,
}

impl Output {
    /// Stops.
    pub fn exposure(self) -> f32 {
        match self {
            Self::Linear => 0.0,
            Self::Display { exposure, .. } | Self::Screen { exposure, .. } => exposure,
        }
    }

    pub fn is_blue_first(self) -> bool {
        matches!(self, Self::Screen { blue_first: true, .. })
    }

    /// The `OUTPUT_` constant.
    fn kind(self) -> u32 {
        match self {
            Self::Linear => OUTPUT_LINEAR,
            Self::Display { tone_map, .. } | Self::Screen { tone_map, .. } => match tone_map {
                ToneMap::None => OUTPUT_CLAMPED,
                ToneMap::Agx => OUTPUT_AGX,
                ToneMap::PbrNeutral => OUTPUT_PBR_NEUTRAL,
                ToneMap::FalseColor => OUTPUT_FALSE_COLOR,
            },
        }
    }
}

impl Outputs {
    pub fn new(context: &Arc<Context>, pixel_count: usize) -> Self {
        Self {
            kernels: Default::default(),
            sheet_kernels: Default::default(),
            linear: None,
            display: None,
            screen: None,
            pixel_count,
            context: context.clone(),
        }
    }

    /// Creates kernel and buffer of `output`, for a contact sheet or a whole picture.
    pub fn prepare(&mut self, output: Output, sheet: bool) -> Result<()> {
        let kind = output.kind();
        if sheet {
            prepare(&self.context, &mut self.sheet_kernels, kind)?;
        } else {
            prepare(&self.context, &mut self.kernels, kind)?;
        }
        let (buffer, access, words) = match output {
            Output::Linear => (&mut self.linear, Access::HostReads, 3),
            Output::Display { .. } => (&mut self.display, Access::HostReads, 1),
            Output::Screen { .. } => (&mut self.screen, Access::Device, 1),
        };
        if buffer.is_none() {
            *buffer = Some(Buffer::new(&self.context, "pictures", access, words * self.pixel_count)?);
        }
        Ok(())
    }

    /// The composite kernel of `output`, which must be prepared.
    pub fn kernel(&self, output: Output) -> &Kernel<CompositePush> {
        self.kernels[output.kind() as usize].as_ref().expect("prepared")
    }

    /// The contact sheet kernel of `output`, which must be prepared.
    pub fn sheet_kernel(&self, output: Output) -> &Kernel<SheetPush> {
        self.sheet_kernels[output.kind() as usize].as_ref().expect("prepared")
    }

    /// Pixels of the last picture for a window. Panics if there was none.
    pub fn shown(&self) -> &Buffer<u32> {
        self.screen.as_ref().expect("there was a picture")
    }

    /// Pixels of `output`, which must be prepared.
    pub fn pixels(&self, output: Output) -> &Buffer<u32> {
        let buffer = match output {
            Output::Linear => &self.linear,
            Output::Display { .. } => &self.display,
            Output::Screen { .. } => &self.screen,
        };
        buffer.as_ref().expect("prepared")
    }

    #[cfg(feature = "hot-reload")]
    pub fn reload_changed_kernels(&mut self) -> bool {
        let wholes = self.kernels.iter_mut().flatten().map(Kernel::reload_if_changed);
        let sheets = self.sheet_kernels.iter_mut().flatten().map(Kernel::reload_if_changed);
        wholes.chain(sheets).fold(false, |changed, is_new| changed | is_new)
    }
}

/// Makes the kernel for an `OUTPUT_` constant.
fn prepare<P>(context: &Arc<Context>, kernels: &mut [Option<Kernel<P>>], output: u32) -> Result<()>
where
    P: Push<Pipeline = Compute, Constants = OutputConstants>,
{
    let kernel = &mut kernels[output as usize];
    if kernel.is_none() {
        *kernel = Some(Kernel::new(context, OutputConstants { output })?);
    }
    Ok(())
}
