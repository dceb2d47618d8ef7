//! Indirect light of lights drawn at random, against our own path tracer.

mod common;

use common::drawn::{self, Drawn};
use common::{not_run, transfer};
use glam::{DVec3, Vec3};
use relume::bake::compression::CompressionSettings;
use relume::bake::framebuffer::view_samples::resolve;
use relume::bake::transfer::Transfer;
use relume::bake::transport::direct;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, TransferSettings};
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::image::Image;
use relume::image::compare::{Figures, Pictures, Settings};
use relume::scene::{Light, LightKind};
use relume::storage::journal::Journal;

/// Samples a pixel in each half of a truth.
const SAMPLES: u32 = 128;

/// A scene under drawn lights, and the operator without compression.
struct Lit<'a> {
    drawn: &'a Drawn,
    framebuffer: &'a DeepFramebuffer,
    transfer: LightTransport<'a>,
}

fn bake_drawn(Drawn { scene, .. }: &Drawn, size: u32) -> DeepFramebuffer {
    let settings = BakeSettings { width: size, height: size, layers: 4, samples: 1 };
    bake(scene, &scene.cameras[0], &scene.rig, &settings, &|_| ())
}

impl<'a> Lit<'a> {
    fn new(drawn: &'a Drawn, framebuffer: &'a DeepFramebuffer, settings: &TransferSettings) -> Self {
        let transfer = LightTransport::new(&drawn.scene, framebuffer, settings, &|_| ());
        Self { drawn, framebuffer, transfer }
    }

    /// What each light leaves in gather samples.
    fn direct(&self) -> Vec<Vec<DVec3>> {
        let Drawn { scene, lights } = self.drawn;
        let shade = |light: &Light| direct::shade(scene, &self.transfer.fine, &light.pack(scene.space));
        lights.iter().map(shade).collect()
    }

    /// Each light's indirect light on view samples, by the operator without compression.
    fn rows(&self, direct: &[Vec<DVec3>]) -> Vec<Vec<DVec3>> {
        let all: Vec<u32> = (0..self.framebuffer.samples.len() as u32).collect();
        self.transfer.apply(direct, &all, Lobe::All, &|_| ())
    }

    /// Figures of light on view samples: indirect light by pixel, indirect light and the whole picture on 4x4 means.
    fn figures(&self, light: &Light, radiance: &[DVec3]) -> [Figures; 3] {
        let framebuffer = self.framebuffer;
        let tiling = framebuffer.tiling;
        let (pixels, extras) = radiance.split_at(framebuffer.pixel_stride());
        let mut image = pixels.to_vec();
        resolve(
            &framebuffer.extra_pixels,
            &framebuffer.extra_indices,
            &framebuffer.extra_samples,
            extras,
            u32::MAX,
            &mut image,
        );
        let [width, height] = [tiling.width, tiling.height];
        let [a, b] = drawn::truth(&self.drawn.scene, light, width, SAMPLES);
        let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let ours: Vec<[f32; 3]> = rows.map(|(x, y)| image[tiling.index(x, y)].as_vec3().to_array()).collect();
        let layer = |image: &Image, name: &str| image.layer(name).expect("truths have it").pixels.clone();
        let [direct, reference, second] =
            [(&a, "direct"), (&a, "indirect"), (&b, "indirect")].map(|(image, name)| layer(image, name));
        let whole = |indirect: &[[f32; 3]]| -> Vec<[f32; 3]> {
            indirect.iter().zip(&direct).map(|(a, b)| (Vec3::from(*a) + Vec3::from(*b)).to_array()).collect()
        };
        let of = |[image, reference, second]: [Vec<[f32; 3]>; 3], block| {
            let (width, height, second) = (width as usize, height as usize, Some(second));
            Pictures { width, height, image, reference, second, mask: None }.figures(Settings { block, trim: 0.0 })
        };
        let indirect = || [ours.clone(), reference.clone(), second.clone()];
        [of(indirect(), 1), of(indirect(), 4), of(indirect().map(|image| whole(&image)), 4)]
    }
}

fn percent(x: Option<f64>) -> f64 {
    100.0 * x.unwrap_or(f64::NAN)
}

fn settings(samples: usize, coarse_samples: usize) -> TransferSettings {
    TransferSettings { points: 16, ..transfer::settings(samples, coarse_samples, 1024) }
}

/// The table of docs/accuracy.md, "Lights drawn at random".
#[test]
fn drawn_lights_against_the_truth() {
    if std::env::var_os("RELUME_FULL").is_none() {
        return not_run("truths of drawn lights take a quarter of an hour: RELUME_FULL=1");
    }
    println!("| scene | N | coarse | K | light | rel_rmse | 4x4 | bias | FLIP | its floor |");
    for (name, samples, coarse_samples) in [
        ("cornell-diffuse", 9216, 9216),
        ("cornell-diffuse", 9216, 2304),
        ("cornell-glossy-floor-rougher", 9216, 1152),
        ("cornell-glossy", 9216, 1152),
        ("buddha", 9216, 1152),
        ("buddha", 16_384, 1152),
        ("buddha", 65_536, 1152),
    ] {
        let settings = settings(samples, coarse_samples);
        let Some(drawn) = drawn::load(name) else { return };
        let framebuffer = bake_drawn(&drawn, 256);
        let lit = Lit::new(&drawn, &framebuffer, &settings);
        for (light, image) in drawn.lights.iter().zip(lit.rows(&lit.direct())) {
            let [by_pixel, on_blocks, beauty] = lit.figures(light, &image);
            println!(
                "| {name} | {samples} | {coarse_samples} | {} | {:?} | {:.2} % | {:.2} % | {:+.2} % | {:.3} | {:.3} |",
                settings.rays,
                light.kind,
                percent(by_pixel.rel_rmse),
                percent(on_blocks.rel_rmse),
                percent(by_pixel.bias),
                beauty.flip_mean.unwrap_or(f64::NAN),
                beauty.flip_floor.unwrap_or(f64::NAN),
            );
            // What all scenes keep to; the page tells how far each is from its goals.
            let bias = by_pixel.bias.expect("there is light");
            assert!(by_pixel.non_finite == 0 && bias.abs() < 0.05, "{name}, {}: bias {bias}", light.name);
        }
    }
}

/// The table of docs/accuracy.md, "End to end".
#[test]
fn compressed_light_against_the_truth() {
    if std::env::var_os("RELUME_FULL").is_none() {
        return not_run("compressed light against the truth takes a quarter of an hour: RELUME_FULL=1");
    }
    println!("| scene | size | light | rows | compressed | rows, 4x4 | compressed, 4x4 |");
    for (name, size) in [("cornell-diffuse", 256), ("cornell-glossy", 128), ("bunny-dragon-2", 128), ("buddha", 128)] {
        let Some(drawn) = drawn::load(name) else { return };
        let framebuffer = bake_drawn(&drawn, size);
        let lit = Lit::new(&drawn, &framebuffer, &settings(16_384, 2304));
        let compression = CompressionSettings { error: 0.01, lights: 512, lobe: Lobe::All, seed: 1 };
        let nested = Transfer::nested(&lit.transfer, &compression, &mut Journal::default(), &|_| ()).unwrap();
        let direct = lit.direct();
        let mut farther = Vec::new();
        for ((light, rows), direct) in drawn.lights.iter().zip(lit.rows(&direct)).zip(&direct) {
            let [rows, compressed] = [&rows, &nested.apply(direct)].map(|image| lit.figures(light, image));
            let [pixel, block] = [0, 1].map(|i| [&rows, &compressed].map(|figures| percent(figures[i].rel_rmse)));
            println!(
                "| {name} | {size} | {:?} | {:.2} % | {:.2} % | {:.2} % | {:.2} % |",
                light.kind, pixel[0], pixel[1], block[0], block[1]
            );
            if light.kind == LightKind::Point {
                farther.push(pixel[1] - pixel[0]);
            }
        }
        let mean = farther.iter().sum::<f64>() / farther.len() as f64;
        println!("{name}: {mean:+.2} points under point lights");
        assert!(mean < 1.0, "{name}: compression adds {mean:.2} points of error");
    }
}
