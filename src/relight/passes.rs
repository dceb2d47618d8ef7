//! The passes of a frame: visibility and shading of one light, sums of light images, the picture.

use std::collections::HashMap;

use glam::{Vec3, Vec4};

use super::finite_check::{self, CheckedPass, FiniteCheck};
use super::gpu_framebuffer::GpuFramebuffer;
use super::indirect::sky_importance::{SkyImportances, point_of};
use super::indirect::sky_light::{SkyLight, SkyTerms, suns};
use super::indirect::{Indirect, host_sum};
use super::light_cache::{Detail, LightPoints, Shade, Source, Term};
use super::light_changes::LightChanges;
use super::light_factors::{self, LightFactors, SampleTriangles};
use super::light_sights::{LightSights, directions_per_point};
use super::light_target::{LightTarget, LightTargets};
use super::output::{Output, Outputs};
use super::some_points::SomePoints;
use super::visibility::shadow_map::ShadowMaps;
use super::visibility::soft_light::{SoftLight, SoftLights};
use super::visibility::{Rays, VisibilityBuffers, VisibilitySlot, trace};
use super::{Kernels, Layers, Site};
use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Buffer, Frame, HostPass, Pass};
use crate::physics::distribution::GridDistribution;
use crate::physics::sequence::fibonacci_lattice;
use crate::scene::light_filter::PosedFilter;
use crate::scene::{Light, LightKind, Links, ResolvedLinks, Rig};
use crate::shared::gpu_struct::Glsl;
use crate::shared::*;
use crate::trace::bvh::TracedScene;
use crate::trace::light_surface::{LightInScene, LightSurface};
use crate::trace::linked::LinkedScene;
use crate::trace::packet::interleaved::InterleavedPackets;

/// Draw a shadow map, look it up for view and for gather samples, shade or darken twice, resolve, add seen lights.
const MAX_PASSES_PER_LIGHT: usize = 7;

/// Resources of the passes, borrowed for one frame.
pub struct FrameResources<'a> {
    pub scene: &'a TracedScene,
    pub framebuffer: &'a DeepFramebuffer,
    pub transfer: Option<&'a Transfer>,
    pub gpu: &'a GpuFramebuffer,
    /// `None` if no indirect light is shown.
    pub indirect: Option<&'a Indirect>,
    pub images: &'a [Buffer<Vec4>],
    /// See [`Source::SomePoints`]; `None` if all lights are without size.
    pub some_points: Option<&'a SomePoints>,
    pub changes: &'a LightChanges,
    pub rest: &'a Buffer<Vec4>,
    /// Radiance of extra samples, for each light of a batch.
    pub extras: &'a [Buffer<f32>],
    pub kernels: &'a Kernels,
    pub rig: &'a Rig,
    /// Of the lights that have any.
    pub links: &'a HashMap<usize, ResolvedLinks>,
    pub skies: &'a SkyImportances,
    /// `None` if no light has links that scale its light.
    pub triangles: Option<&'a SampleTriangles>,
    pub layers: Layers,
    pub finite_check: Option<&'a FiniteCheck>,
    pub site: Site,
}

/// Buffers that a frame fills with what surfaces see of its lights.
pub struct Seeing<'a> {
    pub visibility: &'a mut VisibilityBuffers,
    pub shadow_maps: Option<&'a mut ShadowMaps>,
    pub sights: Option<&'a mut LightSights>,
    /// Of area lights.
    pub soft: Option<&'a mut SoftLights>,
    /// Of domes.
    pub sky_terms: Option<&'a mut SkyTerms>,
}

impl Seeing<'_> {
    /// Whether an area light finds free buffers.
    pub fn has_room(&self) -> bool {
        self.sights.as_ref().is_none_or(|sights| sights.has_room())
            && self.sky_terms.as_ref().is_none_or(|terms| terms.has_room())
    }
}

impl FrameResources<'_> {
    /// Maximum number of passes per step; for a batch of lights, per light, and for points of a light, per point.
    pub fn max_passes_per_step(&self) -> usize {
        let counts = self.finite_check.map_or(0, |_| finite_check::MAX_CHECKS_PER_STEP);
        MAX_PASSES_PER_LIGHT + counts + self.indirect.map_or(0, Indirect::pass_count)
    }

    /// Determines the visibility of a light from view samples and gather samples, and what its filter lets through to
    /// them. Skips view samples if only indirect light is shown. `points`: one, or `light`'s interleaved ones.
    fn compute_visibility(
        &self,
        frame: &mut Frame,
        Seeing { visibility, shadow_maps, soft, .. }: &mut Seeing,
        (index, packed, light): (usize, &PackedLight, Option<&SoftLight>),
        filter: Option<&PosedFilter>,
        detail: Detail,
    ) -> VisibilitySlot {
        let Light { shadows, .. } = self.rig.lights[index];
        let has_factors = self.rig.lights[index].has_factors();
        if !shadows && !has_factors && light.is_none() {
            return VisibilitySlot::ALL_VISIBLE;
        }
        let scene = self.scene.linked(self.links.get(&index));
        let (slot, bytes, half) = visibility.take();
        if let Some(light) = light {
            bytes.set_points(light);
        }
        let points = light.map_or(std::slice::from_ref(packed), |light| &light.points[..]);
        if has_factors {
            let soft = soft.as_deref().filter(|_| light.is_some());
            frame.cpu("filter light", || self.compute_factors(&mut bytes.factors, scene, filter, points, soft));
        }
        if !shadows {
            bytes.clear();
            return slot;
        }
        let direct = self.layers.direct();
        let transfer = self.transfer.filter(|_| self.indirect.is_some());
        // A shadow map has the shadows of all objects, and one point of a light.
        match shadow_maps.as_mut().filter(|_| scene.everything_casts_shadow() && light.is_none()) {
            None => {
                // Half packets exist only if all lights are traced.
                let is_half = detail == Detail::Coarse && !half.view_samples.is_empty();
                let soft = soft.as_deref_mut().filter(|_| light.is_some());
                let [packets, gather_packets] = [&self.framebuffer.packets[..], transfer.map_or(&[], |t| &t.packets)];
                let [view_rays, gather_rays] = match soft {
                    Some(SoftLights { view_samples, gather_points, similar, .. }) => [
                        Rays::Interleaved(view_samples, packets, Some(similar)),
                        Rays::Interleaved(gather_points, gather_packets, None),
                    ],
                    None if is_half => [&mut half.view_samples, &mut half.gather_points].map(Rays::Half),
                    None => [packets, gather_packets].map(Rays::Each),
                };
                if direct {
                    frame.cpu("trace shadows", || trace(&mut bytes.view_samples, scene, view_rays, points));
                }
                if transfer.is_some() {
                    frame.cpu("trace gather samples", || trace(&mut bytes.gather_points, scene, gather_rays, points));
                }
            }
            Some(maps) => {
                let view = direct.then_some((&self.gpu.samples, &bytes.view_samples));
                let gather = self.indirect.map(|indirect| (&indirect.points, &bytes.gather_points));
                let lists: Vec<_> = view.into_iter().chain(gather).collect();
                maps.run(frame, &self.rig.lights[index], packed, &lists);
            }
        }
        let ray_caster = self.indirect.and_then(|indirect| indirect.ray_caster.as_ref());
        if let (Some(ray_caster), Some(transfer)) = (ray_caster, transfer) {
            let hits = &mut bytes.light_rays;
            frame.cpu("trace light rays", || ray_caster.cast(scene, transfer, points, filter, hits));
        }
        slot
    }

    /// Computes what multiplies a light at view samples and points of gather samples. `points`: of the light; one, or
    /// all that are interleaved.
    fn compute_factors(
        &self,
        factors: &mut LightFactors,
        scene: LinkedScene,
        filter: Option<&PosedFilter>,
        points: &[PackedLight],
        soft: Option<&SoftLights>,
    ) {
        // Of the point that a sample sees.
        let color = |packets: Option<&InterleavedPackets>, index: usize, position: Vec3| {
            let point = &points[packets.map_or(0, |packets| packets.point_of(index))];
            filter.map_or(Vec3::ONE, |filter| filter.factor((position - point.position).normalize_or_zero()))
        };
        let is_filtered = filter.is_some();
        if self.layers.direct() {
            let triangles = self.triangles.map(|triangles| &triangles.view_samples[..]);
            let packets = soft.map(|soft| &soft.view_samples);
            let color = |index, position| color(packets, index, position);
            let samples = &self.framebuffer.samples;
            light_factors::compute(&mut factors.view_samples, is_filtered.then_some(color), scene, samples, triangles);
        }
        if let Some(transfer) = self.transfer.filter(|_| self.indirect.is_some()) {
            let triangles = self.triangles.map(|triangles| &triangles.gather_points[..]);
            let packets = soft.map(|soft| &soft.gather_points);
            let color = |index, position| color(packets, index, position);
            let samples = &transfer.points;
            light_factors::compute(&mut factors.gather_points, is_filtered.then_some(color), scene, samples, triangles);
        }
    }

    /// Visibility and shading at unit intensity, each into its target: of one to [`MAX_LIGHTS_PER_PASS`] lights without
    /// size, or of points of one light.
    pub fn shade(&self, frame: &mut Frame, seeing: &mut Seeing, shades: &[Shade]) -> Result<()> {
        let detail = shades[0].detail;
        debug_assert!(shades.iter().all(|shade| shade.detail == detail), "a plan has one detail");
        debug_assert!(shades.len() == 1 || shades.iter().all(|shade| shade.points == LightPoints::One));
        let filters: Vec<Option<PosedFilter>> =
            shades.iter().map(|shade| PosedFilter::new(&self.rig.lights[shade.light])).collect();
        let first = &self.rig.lights[shades[0].light];
        let warp = self.skies.warp(first);
        let surface = LightSurface::new(first, self.scene.space, warp.clone());
        let sky = self.sky_light(first);
        // A dome that moves: suns are traced, the cells of the sky have the rest.
        let is_glow = sky.is_some() && self.layers == Layers::All && shades[0].points == LightPoints::Interleaved;
        let soft = (shades[0].points == LightPoints::Interleaved && !is_glow)
            .then(|| SoftLight::new(first, self.scene.space, warp.as_ref()));
        let points: Vec<(usize, PackedLight)> = match is_glow {
            true => suns(first, self.scene.space, detail).into_iter().map(|packed| (0, packed)).collect(),
            false => shades
                .iter()
                .enumerate()
                .flat_map(|(i, shade)| {
                    let light = &self.rig.lights[shade.light];
                    self.points(light, shade.points, warp.as_ref()).map(move |packed| (i, packed))
                })
                .collect(),
        };
        let seen: Vec<(usize, PackedLight, VisibilitySlot)> = points
            .into_iter()
            .map(|(i, packed)| {
                let light = (shades[i].light, &packed, soft.as_ref());
                (i, packed, self.compute_visibility(frame, seeing, light, filters[i].as_ref(), detail))
            })
            .collect();
        let sight = seeing.sights.as_deref_mut().zip(surface.as_ref()).filter(|_| self.layers.direct());
        let sight_points = if is_glow { LightPoints::One } else { shades[0].points };
        let per_point = directions_per_point(sight_points);
        let drawn_area =
            |packed: &PackedLight| (surface.as_ref()).map_or(0.0, |surface| surface.size(packed) as f32 * per_point);
        let has_sights = sight.is_some() && !is_glow;
        let seen_light = sight.and_then(|(sights, surface)| {
            let (shade, filter) = (Shade { points: sight_points, ..shades[0] }, filters[0].as_ref());
            frame.cpu("look for lights", || self.look(sights, shade, surface, filter))
        });
        let sky = sky.filter(|sky| is_glow || (sky.has_mirrors && self.layers.indirect()));
        let sky_terms = seeing.sky_terms.as_deref_mut().filter(|_| sky.is_some());
        let sky_terms = sky_terms.map(|terms| frame.cpu("cells of the sky", || terms.compute(first, is_glow, detail)));
        let (visibility, soft_kernel) = (&*seeing.visibility, seeing.soft.as_deref());
        let target = |&(i, light, seen): &(usize, PackedLight, VisibilitySlot)| LightTarget {
            light,
            soft: soft.as_ref().zip(soft_kernel),
            visibility: visibility.get(seen),
            has_factors: self.rig.lights[shades[i].light].has_factors(),
            drawn_area: if has_sights { drawn_area(&light) } else { 0.0 },
            image: self.image(shades[i].target),
            extras: &self.extras[i],
        };
        let mut lights: Vec<LightTarget> = seen.iter().map(target).collect();
        let is_dark = lights.is_empty();
        if is_dark {
            lights.push(target(&(0, first.pack(self.scene.space), VisibilitySlot::ALL_VISIBLE)));
        }
        // Points of one light add up in its image.
        let groups: Vec<&[LightTarget]> = if shades.len() == 1 { vec![&lights] } else { lights.chunks(1).collect() };
        for points in &groups {
            match self.layers.direct() && !is_dark {
                true => (0..).zip(*points).for_each(|(n, point)| self.shade_view_samples(frame, point, n > 0)),
                false => self.darken(frame, &points[0]),
            }
        }
        if let Some(indirect) = self.indirect {
            let (pixel_stride, extra_stride) = (self.framebuffer.pixel_stride() as u32, self.extra_stride());
            let targets = LightTargets { lights: &groups, pixel_stride, extra_stride };
            if !is_dark {
                indirect.add(frame, &targets, detail)?;
            }
            if let (Some(sky), Some(index), Some(terms)) = (sky, sky_terms, &seeing.sky_terms) {
                sky.add(frame, terms.buffer(index), &targets)?;
            }
            groups.iter().for_each(|points| self.count(frame, CheckedPass::Transfer, &points[0]));
        }
        groups.iter().for_each(|points| self.resolve(frame, &points[0]));
        if let (Some(index), Some(sights)) = (seen_light, &seeing.sights) {
            let pixel_stride = self.framebuffer.pixel_stride() as u32;
            sights.add(frame, index, lights[0].image, pixel_stride);
            self.count(frame, CheckedPass::SeenLights, &lights[0]);
        }
        Ok(())
    }

    /// The map from the sky, for domes that it is true for: what it leaves out, and whose light is blocked by all.
    fn sky_light(&self, light: &Light) -> Option<&SkyLight> {
        let sky = self.indirect.and_then(|indirect| indirect.sky.as_ref());
        sky.filter(|_| light.kind == LightKind::Dome && light.shadows && light.links == Links::default())
    }

    /// Looks for an area light where the eye may see it; see [`LightSights::look`].
    fn look(
        &self,
        sights: &mut LightSights,
        shade: Shade,
        surface: &LightSurface,
        filter: Option<&PosedFilter>,
    ) -> Option<usize> {
        let scene = self.scene.linked(self.links.get(&shade.light));
        let light = LightInScene { light: &self.rig.lights[shade.light], surface, filter, scene };
        let triangles = self.triangles.map(|triangles| &triangles.view_samples[..]);
        sights.look(self.framebuffer, light, shade.points, self.layers, triangles)
    }

    /// Some points of a light; their sum is the mean over them. `warp`: see [`point_of`].
    fn points(
        &self,
        light: &Light,
        points: LightPoints,
        warp: Option<&GridDistribution>,
    ) -> impl Iterator<Item = PackedLight> {
        let (range, of) = match points {
            LightPoints::Some { first, end, of } => (first..end, of),
            LightPoints::One | LightPoints::Interleaved => (0..1, 1),
        };
        range.map(move |index| match points {
            LightPoints::One | LightPoints::Interleaved => light.pack(self.scene.space),
            LightPoints::Some { .. } => {
                let at = fibonacci_lattice(index, of);
                let mut packed = point_of(light, self.scene.space, at, of, warp);
                packed.strength /= points.count() as f32;
                packed
            }
        })
    }

    /// Direct light of one light, or of one of its points, on all view samples of the shown layers; darkness on others.
    /// `accumulate` adds to that of other points.
    fn shade_view_samples(&self, frame: &mut Frame, target: &LightTarget, accumulate: bool) {
        if let Some((light, lights)) = target.soft {
            return self.shade_softly(frame, target, light, lights);
        }
        let mut pass = frame.pass("shade light");
        let push = ShadeLightPush {
            samples: pass.read(&self.gpu.samples),
            brdfs: pass.read(&self.gpu.brdfs),
            visibility: pass.read(&target.visibility.view_samples),
            factors: pass.read(&target.visibility.factors.view_samples),
            image: pass.write_as(target.image),
            extras: pass.write(target.extras),
            light: target.light,
            sample_count: self.framebuffer.samples.len() as u32,
            pixel_stride: self.framebuffer.pixel_stride() as u32,
            extra_stride: self.extra_stride(),
            layers: self.layers.mask(),
            accumulate: u32::from(accumulate),
            has_factors: u32::from(target.has_factors),
            drawn_area: target.drawn_area,
        };
        pass.dispatch(&self.kernels.shade_light, &push, push.sample_count);
        self.count(frame, CheckedPass::ShadeLight, target);
    }

    /// No light in an image and on extra samples. It takes the place of shading, and its name.
    fn darken(&self, frame: &mut Frame, target: &LightTarget) {
        self.sum_into(frame, "shade light", target.image, self.framebuffer.pixel_stride() as u32, &[], 0.0);
        self.sum_into(frame, "shade light", target.extras, self.extra_stride(), &[], 0.0);
    }

    /// Direct light of a light with interleaved points on all view samples.
    fn shade_softly(&self, frame: &mut Frame, target: &LightTarget, light: &SoftLight, lights: &SoftLights) {
        let mut pass = frame.pass("shade light");
        let push = ShadeSoftPush {
            samples: pass.read(&self.gpu.samples),
            brdfs: pass.read(&self.gpu.brdfs),
            visibility: pass.read(&target.visibility.view_samples),
            factors: pass.read(&target.visibility.factors.view_samples),
            image: pass.write_as(target.image),
            extras: pass.write(target.extras),
            points: pass.read(&target.visibility.points),
            across: light.across,
            half_height: light.half_height,
            sample_count: self.framebuffer.samples.len() as u32,
            pixel_stride: self.framebuffer.pixel_stride() as u32,
            layers: self.layers.mask(),
            unused: 0,
        };
        pass.dispatch(lights.kernel(light), &push, push.sample_count);
        self.count(frame, CheckedPass::ShadeLight, target);
    }

    /// Counts non-finite radiance values of all samples if the check is enabled.
    fn count(&self, frame: &mut Frame, checked: CheckedPass, target: &LightTarget) {
        let Some(finite_check) = self.finite_check else { return };
        let pixel_stride = self.framebuffer.pixel_stride() as u32;
        finite_check.planes(frame, checked, target.image, pixel_stride, pixel_stride);
        finite_check.planes(
            frame,
            checked,
            target.extras,
            self.framebuffer.extra_samples.len() as u32,
            self.extra_stride(),
        );
    }

    fn extra_stride(&self) -> u32 {
        (self.extras[0].len() / 3) as u32
    }

    /// Adds the weighted extra samples to their pixels.
    fn resolve(&self, frame: &mut Frame, target: &LightTarget) {
        if self.gpu.extra_pixels.is_empty() {
            return;
        }
        let pixel_stride = self.framebuffer.pixel_stride() as u32;
        let mut pass = frame.pass("resolve");
        let push = ResolvePush {
            pixels: pass.read(&self.gpu.extra_pixels),
            indices: pass.read(&self.gpu.extra_indices),
            samples: pass.read(&self.gpu.extra_samples),
            extras: pass.read(target.extras),
            image: pass.write_as(target.image),
            pixel_count: self.gpu.extra_pixels.len() as u32,
            pixel_stride,
            extra_stride: self.extra_stride(),
            layers: self.layers.mask(),
        };
        pass.dispatch(&self.kernels.resolve, &push, push.pixel_count);
        if let Some(finite_check) = self.finite_check {
            finite_check.planes(frame, CheckedPass::Resolve, target.image, pixel_stride, pixel_stride);
        }
    }

    fn image(&self, source: Source) -> &Buffer<Vec4> {
        match source {
            Source::Slot(slot) => &self.images[slot],
            Source::Rest => self.rest,
            Source::SomePoints => &self.some_points.expect("a light has a size").mean,
            Source::Checkpoint => &self.some_points.expect("a light has a size").checkpoint,
            Source::Emitter(_) | Source::Change(_) => unreachable!("they are read as floats"),
        }
    }

    /// Compares the image of a light with its checkpoint.
    pub fn compare(&self, frame: &mut Frame, image: Source) {
        let some_points = self.some_points.expect("a light has a size");
        some_points.compare(frame, self.image(image));
    }

    /// Sums images into one.
    pub fn sum(&self, frame: &mut Frame, target: Source, terms: &[Term], kept: f32) -> Result<()> {
        let stride = self.framebuffer.pixel_stride();
        match self.site {
            Site::Device => self.sum_into(frame, "sum lights", self.image(target), stride as u32, terms, kept),
            Site::Host => frame.host_pass("sum lights", |pass| {
                let read = self.read_terms_on_host(pass, terms);
                host_sum::sum(pass.write(self.image(target)), stride, &read[..terms.len()], kept);
            })?,
        }
        if let Some(finite_check) = self.finite_check {
            let pixel_stride = self.framebuffer.pixel_stride() as u32;
            finite_check.planes(frame, CheckedPass::SumLights, self.image(target), pixel_stride, pixel_stride);
        }
        Ok(())
    }

    /// `stride`: floats of each of the three planes of `sum`.
    fn sum_into<T: Glsl>(
        &self,
        frame: &mut Frame,
        name: &'static str,
        sum: &Buffer<T>,
        stride: u32,
        terms: &[Term],
        kept: f32,
    ) {
        let mut pass = frame.pass(name);
        let push = SumImagesPush {
            term_count: terms.len() as u32,
            terms: self.read_terms(&mut pass, terms),
            sum: pass.write_as(sum),
            plane_length: stride / 4,
            kept,
            unused: 0,
        };
        pass.dispatch(&self.kernels.sum_images, &push, 3 * push.plane_length);
    }

    /// Sums images into pixels, exposed and tone-mapped.
    pub fn composite(&self, frame: &mut Frame, terms: &[Term], outputs: &Outputs, output: &Output) {
        let mut pass = frame.pass("composite");
        let push = CompositePush {
            term_count: terms.len() as u32,
            terms: self.read_terms(&mut pass, terms).map(|term| output.exposed(term)),
            target: pass.write(outputs.pixels(output)),
            display_table: outputs.display_table(output).map_or(bytemuck::Zeroable::zeroed(), |table| pass.read(table)),
            width: self.framebuffer.tiling.width,
            height: self.framebuffer.tiling.height,
            blue_first: u32::from(output.is_blue_first()),
        };
        pass.dispatch_tiles(outputs.kernel(output), &push, [push.width, push.height]);
        if let Some(finite_check) = self.finite_check.filter(|_| *output == Output::Linear) {
            let pixels = push.width * push.height;
            finite_check.planes(frame, CheckedPass::Composite, outputs.pixels(output), pixels, pixels);
        }
    }

    fn read_terms_on_host<'p>(&'p self, pass: &'p HostPass, terms: &[Term]) -> [(&'p [f32], Vec3); MAX_TERMS as usize] {
        assert!(terms.len() <= MAX_TERMS as usize, "{} terms, there is room for {MAX_TERMS}", terms.len());
        let mut read = [(&[][..], Vec3::ZERO); MAX_TERMS as usize];
        for (read, term) in read.iter_mut().zip(terms) {
            let image = match term.source {
                Source::Emitter(index) => pass.read(self.gpu.emitters.image(index)),
                Source::Change(number) => pass.read(self.changes.image(number)),
                source => pass.read(self.image(source)),
            };
            *read = (image, term.scale);
        }
        read
    }

    pub(super) fn read_terms(&self, pass: &mut Pass, terms: &[Term]) -> [SumTerm; MAX_TERMS as usize] {
        assert!(terms.len() <= MAX_TERMS as usize, "{} terms, push constants hold {MAX_TERMS}", terms.len());
        let mut read: [SumTerm; MAX_TERMS as usize] = bytemuck::Zeroable::zeroed();
        for (read, term) in read.iter_mut().zip(terms) {
            read.scale = term.scale;
            read.image = match term.source {
                Source::Emitter(index) => pass.read_as(self.gpu.emitters.image(index)),
                Source::Change(number) => pass.read_as(self.changes.image(number)),
                source => pass.read(self.image(source)),
            };
        }
        read
    }
}
