//! Images of the indirect light of single lights, beside the images of the picture.

use glam::{DVec3, Vec3};

use crate::error::Result;
use crate::relight::frame::FinalOutput;
use crate::relight::gpu_framebuffer::indirect_of_emitter;
use crate::relight::light_cache::LightCache;
use crate::relight::light_images::LightImages;
use crate::relight::output::Output;
use crate::relight::some_points::SomePoints;
use crate::relight::{Layers, Picture, Relighter};
use crate::scene::{Emitters, LightKind};

/// Images of indirect light, one light at a time.
pub(in crate::relight) struct IndirectImages {
    cache: LightCache,
    images: LightImages,
    /// `None` if all lights are without size.
    some_points: Option<SomePoints>,
}

/// The image of a light, and what points are compared with.
const IMAGES: usize = 2;

impl Relighter {
    /// The indirect light of a light at unit strength, scene-linear, row by row; without changes by final gathering.
    pub fn indirect(&mut self, light: usize) -> Result<Vec<Vec3>> {
        loop {
            if let Some(image) = self.indirect_step(light)? {
                return Ok(image);
            }
        }
    }

    /// The same in steps, each as short as the picture of one point of a light; `None` until it is complete.
    pub fn indirect_step(&mut self, light: usize) -> Result<Option<Vec<Vec3>>> {
        if self.rig().lights[light].kind == LightKind::Emitter {
            return Ok(Some(self.light_of_emitter(light)));
        }
        let mut others = match self.indirect_images.take() {
            Some(others) => others,
            None => self.new_indirect_images()?,
        };
        others.cache.set_rig(self.cache.rig(), IMAGES);
        others.cache.take_points(&self.cache, light);
        if others.some_points.is_none() && self.some_points.is_some() {
            others.some_points = Some(SomePoints::new(&self.context, &self.framebuffer)?);
        }
        let layers = std::mem::replace(&mut self.layers, Layers::Indirect);
        self.exchange_images(&mut others);
        let outcome = self.step_or_read(light);
        self.exchange_images(&mut others);
        self.layers = layers;
        self.shown = None;
        // After an error their images are not those that their cache describes.
        self.indirect_images = outcome.is_ok().then_some(others);
        outcome
    }

    fn step_or_read(&mut self, light: usize) -> Result<Option<Vec<Vec3>>> {
        if !self.cache.is_complete(light) {
            let plan = self.cache.plan_part(light, 1);
            return self.execute(&plan, None).map(|()| None);
        }
        let plan = self.cache.plan_unit(light);
        self.outputs.prepare(&Output::Linear, false)?;
        self.execute(&plan, Some(FinalOutput::linear(Picture::Light(light))))?;
        let pixels: &[[f32; 3]] = bytemuck::cast_slice(self.outputs.pixels(&Output::Linear).host());
        Ok(Some(pixels.iter().copied().map(Vec3::from).collect()))
    }

    fn new_indirect_images(&self) -> Result<IndirectImages> {
        Ok(IndirectImages {
            cache: LightCache::new(self.cache.rig(), IMAGES, Default::default()),
            images: LightImages::new(&self.context, &self.framebuffer, "light images (indirect)", IMAGES)?,
            some_points: None,
        })
    }

    fn exchange_images(&mut self, others: &mut IndirectImages) {
        std::mem::swap(&mut self.cache, &mut others.cache);
        std::mem::swap(&mut self.images, &mut others.images);
        std::mem::swap(&mut self.some_points, &mut others.some_points);
    }

    fn light_of_emitter(&self, light: usize) -> Vec<Vec3> {
        let tiling = &self.framebuffer.tiling;
        let names = Emitters::of(&self.scene).names;
        let material = self.rig().lights[light].material.as_ref();
        let emitter = names.iter().position(|name| Some(name) == material);
        let transfer = self.transfer.as_deref();
        let image = emitter.and_then(|emitter| indirect_of_emitter(emitter as u32, &self.framebuffer, transfer));
        let image = image.unwrap_or_else(|| vec![DVec3::ZERO; self.framebuffer.pixel_stride()]);
        let pixels = (0..tiling.height).flat_map(|y| (0..tiling.width).map(move |x| (x, y)));
        pixels.map(|(x, y)| image[tiling.index(x, y)].as_vec3()).collect()
    }
}
