//! The passes of a frame: visibility and shading of one light, sums of light images, the picture.

use glam::Vec4;

use super::gpu_baked::GpuBaked;
use super::indirect::{Indirect, Target};
use super::light_cache::{Detail, Source, Term};
use super::output::{Output, Outputs};
use super::shadow_map::ShadowMaps;
use super::visibility::{Visibility, VisibilityBuffers, trace, trace_half};
use super::watch::{self, Watch, Watched};
use super::{Kernels, Layers};
use crate::bake::Baked;
use crate::bake::bvh::Bvh;
use crate::gpu::{Buffer, Frame, Pass};
use crate::scene::{Light, Rig, Scene};
use crate::shared::*;

/// Draw a shadow map, look it up twice, shade, resolve.
const PASSES_A_LIGHT: usize = 5;

/// What passes touch, borrowed for one frame.
pub struct Parts<'a> {
    pub scene: &'a Scene,
    pub bvh: &'a Bvh,
    pub baked: &'a Baked,
    pub gpu: &'a GpuBaked,
    /// Absent where none is wanted.
    pub indirect: Option<&'a Indirect>,
    pub images: &'a [Buffer<Vec4>],
    pub rest: &'a Buffer<Vec4>,
    pub extras: &'a Buffer<f32>,
    pub kernels: &'a Kernels,
    pub rig: &'a Rig,
    pub layers: Layers,
    pub watch: Option<&'a Watch>,
}

/// One light's image to make.
pub struct Shade {
    pub light: usize,
    pub slot: usize,
    pub detail: Detail,
}

impl Parts<'_> {
    /// Passes that a step takes at most.
    pub fn passes_a_step(&self) -> usize {
        let counts = self.watch.map_or(0, |_| watch::PASSES_A_STEP);
        PASSES_A_LIGHT + counts + self.indirect.map_or(0, Indirect::pass_count)
    }

    /// What view samples and gather samples see of a light; unchanged where only indirect light is shown.
    fn see<'v>(
        &self,
        frame: &mut Frame,
        visibility: &'v mut VisibilityBuffers,
        shadow_maps: Option<&mut ShadowMaps>,
        (light, packed): (&Light, &PackedLight),
        detail: Detail,
    ) -> &'v Visibility {
        if !light.shadows {
            return visibility.all_seen();
        }
        let (seen, half) = visibility.take();
        match shadow_maps {
            None => {
                if self.layers.direct() {
                    let words = &mut seen.view_samples;
                    let half = &mut half.view_samples;
                    frame.cpu("trace shadows", || match detail {
                        Detail::Exact => trace(words, self.bvh, self.scene, &self.baked.packets, packed),
                        Detail::Coarse => trace_half(words, self.bvh, self.scene, half, packed),
                    });
                }
                if let Some(transfer) = self.baked.transfer.as_ref().filter(|_| self.indirect.is_some()) {
                    let words = &mut seen.gather_points;
                    let half = &mut half.gather_points;
                    frame.cpu("trace gather samples", || match detail {
                        Detail::Exact => trace(words, self.bvh, self.scene, &transfer.packets, packed),
                        Detail::Coarse => trace_half(words, self.bvh, self.scene, half, packed),
                    });
                }
            }
            Some(maps) => {
                let view = self.layers.direct().then_some((&self.gpu.samples, &seen.view_samples));
                let gather = self.indirect.map(|indirect| (&indirect.points, &seen.gather_points));
                let lists: Vec<_> = view.into_iter().chain(gather).collect();
                maps.run(frame, light, packed, &lists);
            }
        }
        seen
    }

    /// Visibility and shading of one light at unit intensity into the image `slot`.
    pub fn shade(
        &self,
        frame: &mut Frame,
        visibility: &mut VisibilityBuffers,
        shadow_maps: Option<&mut ShadowMaps>,
        shade: &Shade,
    ) {
        let light = &self.rig.lights[shade.light];
        let packed = light.pack(self.scene.origin);
        let seen = self.see(frame, visibility, shadow_maps, (light, &packed), shade.detail);
        let image = &self.images[shade.slot];
        let pixel_stride = self.baked.pixel_stride() as u32;
        let extra_stride = (self.extras.len() / 3) as u32;
        let mut pass = frame.pass("shade light");
        let push = ShadeLightPush {
            samples: pass.read(&self.gpu.samples),
            brdfs: pass.read(&self.gpu.brdfs),
            visibility: pass.read(&seen.view_samples),
            image: pass.write_as(image),
            extras: pass.write(self.extras),
            light: packed,
            sample_count: self.baked.samples.len() as u32,
            pixel_stride,
            extra_stride,
            layers: if self.layers.direct() { self.layers.mask() } else { 0 },
        };
        pass.dispatch(&self.kernels.shade_light, &push, push.sample_count);
        let count = |frame: &mut Frame, watched: Watched| {
            let Some(watch) = self.watch else { return };
            watch.planes(frame, watched, image, pixel_stride, pixel_stride);
            let extras = self.baked.extra_samples.len() as u32;
            watch.planes(frame, watched, self.extras, extras, extra_stride);
        };
        count(frame, Watched::ShadeLight);

        if let Some(indirect) = self.indirect {
            let target = Target { image, extras: self.extras, pixel_stride, extra_stride };
            indirect.add(frame, &packed, &seen.gather_points, &target, shade.detail);
            count(frame, Watched::Transfer);
        }

        if self.gpu.extra_pixels.is_empty() {
            return;
        }
        let mut pass = frame.pass("resolve");
        let push = ResolvePush {
            pixels: pass.read(&self.gpu.extra_pixels),
            indices: pass.read(&self.gpu.extra_indices),
            samples: pass.read(&self.gpu.extra_samples),
            extras: pass.read(self.extras),
            image: pass.write_as(image),
            pixel_count: self.gpu.extra_pixels.len() as u32,
            pixel_stride,
            extra_stride,
            layers: self.layers.mask(),
        };
        pass.dispatch(&self.kernels.resolve, &push, push.pixel_count);
        if let Some(watch) = self.watch {
            watch.planes(frame, Watched::Resolve, image, pixel_stride, pixel_stride);
        }
    }

    fn image(&self, source: Source) -> &Buffer<Vec4> {
        match source {
            Source::Slot(slot) => &self.images[slot],
            Source::Rest => self.rest,
            Source::Emission => unreachable!("emission is read as floats"),
        }
    }

    /// Sums images into one.
    pub fn sum(&self, frame: &mut Frame, target: Source, terms: &[Term], accumulate: bool) {
        let mut pass = frame.pass("sum lights");
        let push = SumImagesPush {
            term_count: terms.len() as u32,
            terms: self.read_terms(&mut pass, terms),
            sum: pass.write(self.image(target)),
            plane_length: (self.baked.pixel_stride() / 4) as u32,
            accumulate: u32::from(accumulate),
            unused: 0,
        };
        pass.dispatch(&self.kernels.sum_images, &push, 3 * push.plane_length);
        if let Some(watch) = self.watch {
            let pixel_stride = self.baked.pixel_stride() as u32;
            watch.planes(frame, Watched::SumLights, self.image(target), pixel_stride, pixel_stride);
        }
    }

    /// Sums images into pixels, exposed and tone-mapped.
    pub fn composite(&self, frame: &mut Frame, terms: &[Term], outputs: &Outputs, output: Output) {
        let mut pass = frame.pass("composite");
        let push = CompositePush {
            term_count: terms.len() as u32,
            terms: self.read_terms(&mut pass, terms),
            target: pass.write(outputs.pixels(output)),
            pixel_stride: self.baked.pixel_stride() as u32,
            width: self.baked.tiling.width,
            height: self.baked.tiling.height,
            exposure: output.exposure().exp2(),
            blue_first: u32::from(output.is_blue_first()),
        };
        pass.dispatch(outputs.kernel(output), &push, push.pixel_stride);
        if let Some(watch) = self.watch.filter(|_| output == Output::Linear) {
            let pixels = push.width * push.height;
            watch.planes(frame, Watched::Composite, outputs.pixels(output), pixels, pixels);
        }
    }

    pub(super) fn read_terms(&self, pass: &mut Pass, terms: &[Term]) -> [SumTerm; MAX_TERMS as usize] {
        assert!(terms.len() <= MAX_TERMS as usize, "{} terms, push constants hold {MAX_TERMS}", terms.len());
        let mut read: [SumTerm; MAX_TERMS as usize] = bytemuck::Zeroable::zeroed();
        for (read, term) in read.iter_mut().zip(terms) {
            read.scale = term.scale;
            read.image = match (term.source, &self.gpu.emission) {
                (Source::Emission, Some(emission)) => pass.read_as(emission),
                _ => pass.read(self.image(term.source)),
            };
        }
        read
    }
}
