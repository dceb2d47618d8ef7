//! Outputs of the relighter: the last kernel and the pixels that it writes.

pub mod display_table;
pub mod exposure;
pub mod inspect;
pub mod sheet;

use std::sync::Arc;

use glam::UVec2;

use self::display_table::DisplayTable;
use super::ToneMap;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Kernel};
use crate::shared::gpu_struct::{Compute, Push};
use crate::shared::*;

/// Format and destination of a picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Scene-linear, for the host.
    Linear,
    /// 8-bit values of the display, for the host.
    Display { exposure: f32, tone_map: ToneMap },
    /// The same for a window, in its channel order.
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
    display_table: Option<DisplayTable>,
    pixel_count: usize,
    context: Arc<Context>,
}

impl Output {
    /// Stops.
    pub fn exposure(&self) -> f32 {
        match self {
            Self::Linear => 0.0,
            Self::Display { exposure, .. } | Self::Screen { exposure, .. } => *exposure,
        }
    }

    /// The term, brighter by the exposure.
    pub fn exposed(&self, term: SumTerm) -> SumTerm {
        SumTerm { scale: self.exposure().exp2() * term.scale, ..term }
    }

    pub fn is_blue_first(&self) -> bool {
        matches!(self, Self::Screen { blue_first: true, .. })
    }

    /// `None`: scene-linear.
    fn tone_map(&self) -> Option<&ToneMap> {
        match self {
            Self::Linear => None,
            Self::Display { tone_map, .. } | Self::Screen { tone_map, .. } => Some(tone_map),
        }
    }

    /// The `OUTPUT_` constant.
    fn kind(&self) -> u32 {
        match self.tone_map() {
            None => OUTPUT_LINEAR,
            Some(ToneMap::None) => OUTPUT_CLAMPED,
            Some(ToneMap::Agx) => OUTPUT_AGX,
            Some(ToneMap::PbrNeutral) => OUTPUT_PBR_NEUTRAL,
            Some(ToneMap::FalseColor) => OUTPUT_FALSE_COLOR,
            Some(ToneMap::View(_)) => OUTPUT_TABLE,
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
            display_table: None,
            pixel_count,
            context: context.clone(),
        }
    }

    /// Creates what `output` needs, for a contact sheet or a whole picture.
    pub fn prepare(&mut self, output: &Output, sheet: bool) -> Result<()> {
        let kind = output.kind();
        if sheet {
            prepare(&self.context, &mut self.sheet_kernels, kind)?;
        } else {
            prepare(&self.context, &mut self.kernels, kind)?;
        }
        if let Some(ToneMap::View(view)) = output.tone_map()
            && self.display_table.as_ref().is_none_or(|table| !table.is_of(view))
        {
            self.display_table = Some(DisplayTable::new(&self.context, view)?);
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
    pub fn kernel(&self, output: &Output) -> &Kernel<CompositePush> {
        self.kernels[output.kind() as usize].as_ref().expect("prepared")
    }

    /// The table of the display of `output`, if it has one.
    pub fn display_table(&self, output: &Output) -> Option<&Buffer<UVec2>> {
        let table = self.display_table.as_ref().filter(|_| output.kind() == OUTPUT_TABLE);
        table.map(DisplayTable::entries)
    }

    /// The contact sheet kernel of `output`, which must be prepared.
    pub fn sheet_kernel(&self, output: &Output) -> &Kernel<SheetPush> {
        self.sheet_kernels[output.kind() as usize].as_ref().expect("prepared")
    }

    /// Pixels of the last picture for a window. Panics if there was none.
    pub fn shown(&self) -> &Buffer<u32> {
        self.screen.as_ref().expect("there was a picture")
    }

    /// Pixels of `output`, which must be prepared.
    pub fn pixels(&self, output: &Output) -> &Buffer<u32> {
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
