//! Inspection of a picture: luminance histogram, and the radiance of one pixel.

use std::sync::Arc;

use glam::{UVec2, Vec3};

use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::relight::light_cache::Term;
use crate::relight::passes::FrameResources;
use crate::shared::*;

/// What to compute for a picture besides its pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inspection {
    /// See [`crate::relight::Relighter::histogram`].
    pub histogram: bool,
    /// Pixel, from the top left; see [`crate::relight::Relighter::probed`].
    pub probe: Option<[u32; 2]>,
}

/// Kernels and their results.
pub(in crate::relight) struct Inspector {
    histogram: Kernel<InspectPush>,
    probe: Kernel<InspectPush>,
    counts: Buffer<u32>,
    radiance: Buffer<u32>,
    /// Whether `counts` belong to the current picture.
    counted: bool,
    /// The pixel whose radiance is in `radiance`.
    probed: Option<[u32; 2]>,
}

impl Inspector {
    pub fn new(context: &Arc<Context>) -> Result<Self> {
        let buffer = |count| Buffer::new(context, "inspection", Access::HostWrites, count);
        Ok(Self {
            histogram: Kernel::new(context, InspectConstants { histogram: true })?,
            probe: Kernel::new(context, InspectConstants { histogram: false })?,
            counts: buffer(HISTOGRAM_BINS as usize)?,
            radiance: buffer(3)?,
            counted: false,
            probed: None,
        })
    }

    /// Inspects the picture that is the sum of `terms`. A histogram that is up to date is not recomputed. `exposure` in
    /// stops.
    pub fn run(
        &mut self,
        frame: &mut Frame,
        resources: &FrameResources,
        terms: &[Term],
        wanted: Inspection,
        exposure: f32,
    ) {
        let tiling = resources.framebuffer.tiling;
        if wanted.histogram && !self.counted {
            self.counts.host_mut().fill(0);
            let size = UVec2::new(tiling.width, tiling.height);
            let threads = (tiling.len() as u32).div_ceil(TILES_PER_GROUP);
            dispatch(
                frame,
                resources,
                terms,
                &InspectPass { kernel: &self.histogram, result: &self.counts, pixels: size, exposure, threads },
            );
            self.counted = true;
        }
        self.probed = wanted.probe.filter(|&[x, y]| tiling.contains((x, y)));
        if let Some([x, y]) = self.probed {
            let pixels = UVec2::new(tiling.index(x, y) as u32, 0);
            dispatch(
                frame,
                resources,
                terms,
                &InspectPass { kernel: &self.probe, result: &self.radiance, pixels, exposure: 1.0, threads: 1 },
            );
        }
    }

    /// Discards the results: the picture changed.
    pub fn invalidate(&mut self) {
        (self.counted, self.probed) = (false, None);
    }

    pub fn counts(&self) -> Option<&[u32]> {
        self.counted.then(|| self.counts.host())
    }

    pub fn probed(&self) -> Option<([u32; 2], Vec3)> {
        let bits = self.radiance.host();
        self.probed.map(|pixel| (pixel, Vec3::from_array([0, 1, 2].map(|c| f32::from_bits(bits[c])))))
    }
}

/// Parameters of one inspection pass.
struct InspectPass<'a> {
    kernel: &'a Kernel<InspectPush>,
    result: &'a Buffer<u32>,
    pixels: UVec2,
    exposure: f32,
    threads: u32,
}

fn dispatch(frame: &mut Frame, resources: &FrameResources, terms: &[Term], inspect: &InspectPass) {
    let mut pass = frame.pass("inspect");
    let push = InspectPush {
        term_count: terms.len() as u32,
        terms: resources.read_terms(&mut pass, terms),
        result: pass.write(inspect.result),
        pixel_stride: resources.framebuffer.pixel_stride() as u32,
        pixels: inspect.pixels,
        exposure: inspect.exposure.exp2(),
        unused: 0,
    };
    pass.dispatch(inspect.kernel, &push, inspect.threads);
}
