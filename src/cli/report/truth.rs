//! The truth of a scene: two halves of our own path tracer, kept in the report's folder.

use std::path::Path;

use relume::image::compare::{Pictures, Settings as CompareSettings};
use relume::image::{Image, exr};
use relume::reference::path_tracer::{Film, Filter, Half, Layer, PathTracer, Settings};
use relume::report::{Errors, Floors};
use relume::{Error, Result, Session};

use crate::cli::options::ViewOptions;
use crate::cli::output_file::make_parent;
use crate::cli::progress;

/// Whole pictures and their indirect light, with independent noise.
pub struct Truth {
    width: usize,
    height: usize,
    halves: [Image; 2],
}

const LAYERS: [Layer; 2] = [Layer::Beauty, Layer::Indirect];

/// Traces `samples` a pixel, whole and indirect light, both halves together; an even number.
pub fn trace(session: &Session, view: &ViewOptions, samples: u32, seed: u64) -> Film {
    let (width, height) = session.size();
    let settings = Settings {
        width: width as u32,
        height: height as u32,
        layers: view.layers,
        max_bounces: None,
        filter: Filter::Centre,
        bounce_layers: 0,
        light_layers: false,
        seed,
    };
    let tracer = PathTracer::new(&session.scene, &session.framebuffer.camera, &session.rig, &settings);
    let bar = progress::bar("path tracing", (samples / 2) as usize * tracer.tile_count());
    let film = tracer.trace(samples / 2, &|| false, &|count| bar.inc(count));
    bar.finish_and_clear();
    film
}

/// A picture of this size that this report wrote, whole and indirect light.
pub fn read(path: &Path, (width, height): (usize, usize)) -> Result<Image> {
    let image = exr::read(path)?;
    let layers = ["", "indirect"].iter().all(|name| image.layer(name).is_some());
    match (image.width, image.height) == (width, height) && layers {
        true => Ok(image),
        false => Err(Error::import(path, "not what this report wrote; remove it to measure anew")),
    }
}

/// Both layers of a traced picture.
pub fn picture(film: &Film) -> Image {
    film.image(Half::Both, &LAYERS)
}

impl Truth {
    /// From `PATH.a.exr` and `PATH.b.exr` if both are there, else traced and written.
    pub fn get(path: &Path, session: &Session, view: &ViewOptions, samples: u32) -> Result<Self> {
        let (width, height) = session.size();
        let paths = ["a", "b"].map(|half| {
            let mut name = path.as_os_str().to_owned();
            name.push(format!(".{half}.exr"));
            std::path::PathBuf::from(name)
        });
        if !paths.iter().all(|path| path.exists()) {
            make_parent(path)?;
            let film = trace(session, view, samples, view.seed ^ TRUTH);
            for (path, half) in paths.iter().zip([Half::A, Half::B]) {
                exr::write(path, &film.image(half, &LAYERS))?;
            }
        }
        let [a, b] = paths.map(|path| read(&path, (width, height)));
        Ok(Self { width, height, halves: [a?, b?] })
    }

    /// `image` against the truth, in one layer.
    fn against(&self, image: &Image, layer: &str) -> Pictures {
        let take = |image: &Image| image.layer(layer).map_or_else(Vec::new, |layer| layer.pixels.clone());
        Pictures {
            width: self.width,
            height: self.height,
            image: take(image),
            reference: take(&self.halves[0]),
            second: Some(take(&self.halves[1])),
            mask: None,
        }
    }

    /// None where the truth is black, or nothing of the image is a number.
    pub fn errors(&self, image: &Image) -> Option<Errors> {
        let indirect = self.against(image, "indirect");
        let fine = indirect.figures(CompareSettings { block: 1, trim: 1e-3 });
        let coarse = indirect.figures(CompareSettings { block: 4, trim: 0.0 });
        let whole = self.against(image, "").figures(CompareSettings::default());
        Some(Errors {
            indirect: fine.rel_rmse?,
            indirect_4x4: coarse.rel_rmse?,
            indirect_trimmed: fine.trimmed?,
            indirect_bias: fine.bias?,
            whole: whole.rel_rmse?,
            flip: whole.flip_mean?,
            non_finite: fine.non_finite.max(whole.non_finite),
        })
    }

    /// What the truth's own noise does.
    pub fn floors(&self) -> Floors {
        let [a, b] = self.halves.each_ref().map(|half| &half.layer("indirect").expect("traced or read with it").pixels);
        let (mut squares, mut sum) = (0.0, 0.0);
        let (mut variance, mut fourth) = (0.0, 0.0);
        for (a, b) in a.iter().zip(b) {
            let ab: f64 = (0..3).map(|c| f64::from(a[c]) * f64::from(b[c])).sum();
            // Of one half, from the difference of both.
            let own: f64 = (0..3).map(|c| f64::from(a[c] - b[c]).powi(2) / 2.0).sum();
            squares += ab;
            sum += (0..3).map(|c| f64::from(a[c] + b[c]) / 2.0).sum::<f64>();
            variance += own;
            // A square of such an estimate is three times that of what it estimates, were the noise normal; channels
            // share it.
            fourth += own * own / 3.0;
        }
        let flip = self.against(&self.halves[0], "").figures(CompareSettings::default()).flip_floor;
        if squares <= 0.0 {
            return Floors::default();
        }
        Floors {
            // Σ (x - a)(x - b) of a picture without error has variance Σ σ⁴.
            indirect: (fourth.sqrt() / squares).sqrt(),
            noise: (variance / 2.0 / squares).sqrt(),
            flip: flip.unwrap_or(0.0) / 2.0,
            mean: sum / (3.0 * a.len() as f64 * squares).sqrt(),
        }
    }

    pub fn has_indirect(&self) -> bool {
        self.indirect().iter().flatten().any(|&v| v > 0.0)
    }

    /// The mean of both halves.
    pub fn mean(&self) -> Vec<[f32; 3]> {
        self.mean_of("")
    }

    fn mean_of(&self, layer: &str) -> Vec<[f32; 3]> {
        let [a, b] = self.halves.each_ref().map(|half| half.layer(layer).map_or(&[][..], |layer| &layer.pixels));
        a.iter().zip(b).map(|(a, b)| [0, 1, 2].map(|c| (a[c] + b[c]) / 2.0)).collect()
    }

    /// What makes the mean of the whole picture 0.5, as FLIP looks at it; none of a black one.
    pub fn exposure(&self) -> Option<f64> {
        let mean = self.mean();
        let sum: f64 = mean.iter().flatten().map(|&v| f64::from(v)).sum();
        (sum > 0.0).then(|| 0.5 * mean.len() as f64 * 3.0 / sum)
    }

    /// The mean of both halves' indirect light.
    pub fn indirect(&self) -> Vec<[f32; 3]> {
        self.mean_of("indirect")
    }

    /// |x - r| of the whole picture times `scale`, 8-bit sRGB.
    pub fn difference(&self, image: &Image, scale: f32) -> Vec<[u8; 3]> {
        self.against(image, "").difference_map(1, scale)
    }
}

/// Keeps the truth's numbers apart from those of the pictures that it judges.
const TRUTH: u64 = 0x7472_7574_6800_0000;
