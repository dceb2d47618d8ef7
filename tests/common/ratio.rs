//! How much indirect light there is, against the path tracer.

use glam::{DVec3, Vec3};
use relume::bake::transport::direct;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, TransferSettings};
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::reference::path_tracer::{Half, Layer, PathTracer, Settings};
use relume::scene::{Camera, Rig};
use relume::trace::bvh::TracedScene;

use super::drawn;

/// A scene under its lights, and a small picture of it.
pub struct Lit<'a> {
    pub scene: &'a TracedScene,
    pub camera: &'a Camera,
    pub rig: &'a Rig,
    pub size: [u32; 2],
}

impl Lit<'_> {
    pub fn bake(&self) -> DeepFramebuffer {
        let [width, height] = self.size;
        let settings = BakeSettings { width, height, layers: 4, samples: 1 };
        bake(self.scene, self.camera, self.rig, &settings, &|_| ())
    }

    /// λ0 of all lights together.
    pub fn direct(&self, transfer: &LightTransport) -> Vec<DVec3> {
        let mut sum = vec![DVec3::ZERO; transfer.fine.coefficient_count()];
        for light in &self.rig.lights {
            let unit = direct::shade(self.scene, &transfer.fine, &light.pack(self.scene.space));
            sum.iter_mut().zip(unit).for_each(|(sum, x)| *sum += light.scale().as_dvec3() * x);
        }
        sum
    }

    /// Mean of indirect light over all pixels, by our operator.
    pub fn mean(&self, settings: &TransferSettings) -> DVec3 {
        let framebuffer = self.bake();
        let transfer = LightTransport::new(self.scene, &framebuffer, settings, &|_| ());
        let all: Vec<u32> = (0..framebuffer.samples.len() as u32).collect();
        let image = transfer.apply(&[self.direct(&transfer)], &all, Lobe::All, &|_| ()).remove(0);
        let mut weights = vec![Vec3::ONE; framebuffer.pixel_stride()];
        framebuffer.extra_pixels.iter().for_each(|p| weights[p.pixel as usize] = Vec3::splat(p.first_weight));
        weights.extend(framebuffer.extra_samples.iter().map(|extra| extra.weight));
        let sum: DVec3 = image.into_iter().enumerate().map(|(i, radiance)| weights[i].as_dvec3() * radiance).sum();
        sum / f64::from(self.size[0] * self.size[1])
    }

    /// The same by the path tracer, with so many samples a pixel.
    pub fn traced_mean(&self, bounces: Option<u32>, samples: u32) -> DVec3 {
        let settings = Settings { max_bounces: bounces, ..drawn::tracing(self.size[0], self.size[1]) };
        let tracer = PathTracer::new(self.scene, self.camera, self.rig, &settings);
        let image = tracer.trace(samples, &|| false, &|_| ()).image(Half::Both, &[Layer::Indirect]);
        let pixels = &image.layer("indirect").expect("it was asked for").pixels;
        pixels.iter().map(|&p| Vec3::from(p).as_dvec3()).sum::<DVec3>() / pixels.len() as f64
    }
}
