//! Indirect light of lights drawn at random, against our own path tracer.

mod common;

use common::drawn::{self, Drawn};
use common::not_run;
use glam::{DVec3, Vec3};
use relume::bake::transfer::rows::Lobe;
use relume::bake::transfer::{Outgoing, Transfer, TransferSettings};
use relume::bake::{BakeSettings, bake};
use relume::image::Image;
use relume::image::compare::{Figures, Pictures, Settings};
use relume::reference::gather;

const SIZE: u32 = 256;

/// Figures of indirect light by pixel, and of indirect light and the whole picture on 4x4 means.
fn figures(indirect: &[DVec3], [a, b]: &[Image; 2]) -> [Figures; 3] {
    let layer = |image: &Image, name: &str| image.layer(name).expect("truths have it").pixels.clone();
    let sum = |a: Vec<[f32; 3]>, b: &[[f32; 3]]| -> Vec<[f32; 3]> {
        a.into_iter().zip(b).map(|(a, b)| (Vec3::from(a) + Vec3::from(*b)).to_array()).collect()
    };
    let size = SIZE as usize;
    let ours: Vec<[f32; 3]> = indirect.iter().map(|p| p.as_vec3().to_array()).collect();
    let [reference, second] = [a, b].map(|truth| layer(truth, "indirect"));
    let of = |image, reference, second, block| {
        let second = Some(second);
        Pictures { width: size, height: size, image, reference, second, mask: None }
            .figures(Settings { block, trim: 0.0 })
    };
    let whole = |indirect: &[[f32; 3]]| sum(layer(a, "direct"), indirect);
    [
        of(ours.clone(), reference.clone(), second.clone(), 1),
        of(ours.clone(), reference.clone(), second.clone(), 4),
        of(whole(&ours), whole(&reference), whole(&second), 4),
    ]
}

/// Prints a line a light. `samples` a pixel in each half of the truth.
fn measure(name: &str, settings: &TransferSettings, samples: u32) {
    let Some(Drawn { scene, bvh, lights }) = drawn::load(name) else { return };
    let size = BakeSettings { width: SIZE, height: SIZE, layers: 4, samples: 1 };
    let baked = bake(&scene, &bvh, &scene.cameras[0], &scene.rig, &size, &|_| ());
    let transfer = Transfer::new(&scene, &bvh, &baked, settings, &|_| ());
    let direct: Vec<_> =
        lights.iter().map(|light| gather::shade(&scene, &bvh, &transfer.fine, &light.pack(scene.origin))).collect();
    let pixels: Vec<u32> = (0..baked.tiling.len() as u32).collect();
    let images = transfer.apply(&direct, &pixels, Lobe::All, &|_| ());
    for (light, image) in lights.iter().zip(images) {
        let rows = (0..SIZE).flat_map(|y| (0..SIZE).map(move |x| (x, y)));
        let image: Vec<DVec3> = rows.map(|(x, y)| image[baked.tiling.index(x, y)]).collect();
        let truth = drawn::truth(&scene, &bvh, light, SIZE, samples);
        let [by_pixel, on_blocks, beauty] = figures(&image, &truth);
        let percent = |x: Option<f64>| 100.0 * x.unwrap_or(f64::NAN);
        println!(
            "| {name} | {} | {} | {} | {:?} | {:.2} % | {:.2} % | {:+.2} % | {:.3} | {:.3} |",
            settings.samples,
            settings.coarse_samples,
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

/// The table of docs/transfer.md.
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
        let settings = TransferSettings {
            outgoing: Outgoing::Glossy { functions: None },
            samples,
            coarse_samples,
            points: 16,
            rays: 1024,
            layers: 4,
            bounces: None,
            seed: 1,
        };
        measure(name, &settings, 128);
    }
}
