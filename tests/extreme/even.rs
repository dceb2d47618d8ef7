//! Closed scenes whose every surface shines with radiance 1 and reflects the same share ρ of light: whatever their
//! shape, indirect light is ρ/(1-ρ) at every pixel.

use glam::{DVec3, Vec3};
use relume::bake::baselines::thesis::{Thesis, ThesisSettings};
use relume::bake::brdf_factors::svd::Terms;
use relume::bake::compression::CompressionSettings;
use relume::bake::transfer::Transfer;
use relume::bake::transport::directions::Lobe;
use relume::bake::transport::{LightTransport, Outgoing, TransferSettings};
use relume::bake::{BakeSettings, DeepFramebuffer, bake};
use relume::final_gather::{FinalGather, Refined};
use relume::reference::path_tracer::{Half, Layer, PathTracer};
use relume::scene::{Camera, Material, Projection, Rig, Scene};
use relume::shared::NO_BRDF;
use relume::storage::journal::Journal;
use relume::trace::bvh::TracedScene;

use crate::common::drawn::tracing;
use crate::common::stage::{lambert, look};
use crate::common::transfer;
use crate::table::{Row, full};

pub fn shining(albedo: f32) -> Material {
    Material { emissive: Vec3::ONE, ..lambert(Vec3::splat(albedo)) }
}

pub fn settings(samples: usize, coarse_samples: usize, rays: u32) -> TransferSettings {
    TransferSettings { points: 16, ..transfer::settings(samples, coarse_samples, rays) }
}

pub fn thesis_settings(samples: usize) -> ThesisSettings {
    ThesisSettings { outgoing: Outgoing::Diffuse, samples, terms: Terms::Count(8), bounces: 5, seed: 1 }
}

/// A scene and what its camera sees, without indirect light.
pub struct Stage {
    pub scene: TracedScene,
    pub framebuffer: DeepFramebuffer,
}

impl Stage {
    /// Seen from the middle of its bounds.
    pub fn inside(scene: Scene) -> Self {
        let eye = scene.space.origin;
        let size = (scene.mesh.bounds().1 - scene.mesh.bounds().0).max_element();
        let to = eye + scene.space.unit * f64::from(size) * DVec3::new(0.2, -0.1, 1.0);
        let camera = look(eye, to, DVec3::Y, Projection::Perspective { yfov: 1.5 });
        Self::new(scene, &camera, [32, 32])
    }

    pub fn new(scene: Scene, camera: &Camera, [width, height]: [u32; 2]) -> Self {
        let scene = TracedScene::new(scene);
        let settings = BakeSettings { width, height, layers: 4, samples: 1 };
        let framebuffer = bake(&scene, camera, &scene.rig, &settings, &|_| ());
        Self { scene, framebuffer }
    }

    pub fn transfer(&self, settings: &TransferSettings) -> LightTransport<'_> {
        LightTransport::new(&self.scene, &self.framebuffer, settings, &|_| ())
    }

    pub fn thesis(&self, samples: usize) -> Thesis<'_> {
        Thesis::new(&self.scene, &self.framebuffer, &thesis_settings(samples), &|_| ())
    }

    /// View samples that reflect light.
    pub fn lit(&self) -> Vec<u32> {
        let lit = |&i: &u32| self.framebuffer.samples[i as usize].brdf != NO_BRDF;
        (0..self.framebuffer.samples.len() as u32).filter(lit).collect()
    }
}

pub fn compressed(transfer: &LightTransport, error: f64) -> Transfer {
    let settings = CompressionSettings { error, lights: 64, lobe: Lobe::All, seed: 1 };
    Transfer::nested(transfer, &settings, &mut Journal::default(), &|_| ()).unwrap()
}

/// Mean of both halves of what final gathering finds of each light, row by row, at unit strength.
pub fn gathered(scene: &TracedScene, framebuffer: &DeepFramebuffer, rig: &Rig, passes: u32) -> Vec<Vec<[f32; 3]>> {
    let mut gather = FinalGather::new(scene, framebuffer, rig, |_| true, 1, 0);
    (0..passes).for_each(|_| gather.pass(&|| false));
    let image = |source: usize| {
        let [a, b] = [0, 1].map(|half| gather.image(half, source));
        a.iter().zip(b).map(|(a, b)| (0.5 * (*a + b)).to_array()).collect()
    };
    (0..gather.lights().count()).map(image).collect()
}

/// Relative errors of indirect light, root mean square over pixels.
pub struct Errors {
    /// Of the operator.
    ours: f64,
    /// Of its compressed form.
    compressed: f64,
    /// Noise of rows that compression leaves out, as it reports it.
    noise: f64,
    /// `None` unless the table is written.
    thesis: Option<f64>,
    /// `None` where light bounces so often, or pixels are so few, that it takes minutes.
    noisy: Option<NoisyErrors>,
}

/// The same where light is gathered anew.
struct NoisyErrors {
    /// Of final gathering alone and of the path tracer, mean over the picture.
    gathered: f64,
    traced: f64,
    /// Of the compressed form, refined by final gathering.
    refined: f64,
}

/// Error that compression is asked for.
const COMPRESSION: f64 = 0.01;

impl Errors {
    /// What the table says of them. `few`: why few photons answer, if that is known.
    pub fn rows(&self, case: &str, albedo: f32, few: Option<&'static str>) -> Vec<Row> {
        let asked = format!("every pixel ρ/(1-ρ), ρ = {albedo}");
        let compressed = "the same, compressed: noise and 1 %";
        let by_photons = |row: Row| match few {
            Some(few) => row.short(few),
            None => row,
        };
        let mut rows = vec![
            Row::new(case, asked, 1e-3, self.ours).thesis(|| self.thesis.expect("it was computed")),
            Row::new(case, compressed, self.noise + COMPRESSION, self.compressed),
        ];
        if let Some(NoisyErrors { gathered, traced, refined }) = self.noisy {
            let bound = self.noise + COMPRESSION;
            rows.extend([
                by_photons(Row::new(case, "the same, refined by final gathering", bound, refined)),
                by_photons(Row::new(case, "the same, gathered alone, mean over pixels", MEANS, gathered)),
                Row::new(case, "the same, path-traced, mean over pixels", MEANS, traced),
            ]);
        }
        rows
    }
}

/// Error of the mean of noisy pictures.
const MEANS: f64 = 2e-2;
/// Passes of final gathering.
fn passes() -> u32 {
    if full() { 16 } else { 6 }
}

/// Albedo from which light bounces so often that [`NoisyErrors`] take long.
const WHITE: f32 = 0.99;
/// Pixels below which they do: each pixel needs more samples.
const FEW_PIXELS: usize = 512;

/// How far a closed scene of [`shining`] material is from its answer.
pub fn errors(stage: &Stage, albedo: f32) -> Errors {
    errors_with(stage, albedo, &settings(512, 128, 128))
}

pub fn errors_with(stage: &Stage, albedo: f32, settings: &TransferSettings) -> Errors {
    let lit = stage.lit();
    assert!(!lit.is_empty(), "no pixel sees anything");
    let want = f64::from(albedo) / (1.0 - f64::from(albedo));
    let error = |pixels: &[DVec3]| {
        let square: f64 = pixels.iter().map(|p| (*p / want - 1.0).length_squared() / 3.0).sum();
        (square / pixels.len() as f64).sqrt()
    };
    let transfer = stage.transfer(settings);
    let emission = transfer.emission();
    let rows = transfer.apply(std::slice::from_ref(&emission), &lit, Lobe::All, &|_| ()).remove(0);
    let nested = compressed(&transfer, COMPRESSION);
    let noise = nested.report.held_out.as_ref().map_or(0.0, |report| report.noise);
    let all = nested.apply(&emission);
    let compressed: Vec<DVec3> = lit.iter().map(|&i| all[i as usize]).collect();
    let of_thesis = || {
        let thesis = stage.thesis(settings.samples);
        let emitted: Vec<DVec3> = thesis.samples.samples.iter().map(|s| s.emission.as_dvec3()).collect();
        error(&thesis.rows(&lit, Lobe::All).multiply(&thesis.bounce(&emitted)))
    };
    Errors {
        ours: error(&rows),
        compressed: error(&compressed),
        noise,
        thesis: full().then(of_thesis),
        noisy: (full() || (albedo < WHITE && stage.framebuffer.tiling.len() >= FEW_PIXELS))
            .then(|| noisy_errors(stage, albedo, &all)),
    }
}

/// `operator`: indirect light by view sample.
fn noisy_errors(stage: &Stage, albedo: f32, operator: &[DVec3]) -> NoisyErrors {
    let want = f64::from(albedo) / (1.0 - f64::from(albedo));
    let Stage { scene, framebuffer } = stage;
    let mut gather = FinalGather::new(scene, framebuffer, &Rig::default(), |_| true, 1, 0);
    let DeepFramebuffer { tiling, camera, .. } = framebuffer;
    // Fewer pixels need more samples for a mean of the same noise.
    let times = (1024.0 / tiling.len() as f32).max(1.0);
    (0..passes() * times as u32).for_each(|_| gather.pass(&|| false));
    let estimate = gather.estimate(0);
    let pixels: Vec<(u32, u32)> = (0..tiling.height).flat_map(|y| (0..tiling.width).map(move |x| (x, y))).collect();
    let operator: Vec<Vec3> = pixels.iter().map(|&(x, y)| operator[tiling.index(x, y)].as_vec3()).collect();
    let Refined { changes, .. } = Refined::new(tiling.width as usize, &[(Vec3::ONE, &operator, &estimate)]);
    let squares = operator.iter().zip(&changes[0]).map(|(operator, change)| {
        let refined = (*operator + *change).as_dvec3();
        (refined / want - 1.0).length_squared() / 3.0
    });
    let of_mean = |pixels: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = pixels.fold((0.0, 0.0), |(sum, count), pixel| (sum + pixel, count + 1.0));
        (sum / count / want - 1.0).abs()
    };
    // Paths between nearly white surfaces are long.
    let samples = (320.0 * (1.0 - albedo)).clamp(1.0, 32.0) * times;
    let traced = tracing(tiling.width, tiling.height);
    let tracer = PathTracer::new(scene, camera, &Rig::default(), &traced);
    let film = tracer.trace(samples as u32, &|| false, &|_| ());
    NoisyErrors {
        gathered: of_mean(&mut estimate.halves.iter().flatten().map(|pixel| f64::from(pixel.x))),
        // What surfaces emit themselves is no indirect light.
        traced: of_mean(&mut film.layer(Half::Both, Layer::Emission).iter().map(|pixel| f64::from(pixel[0]) - 1.0)),
        refined: (squares.sum::<f64>() / operator.len() as f64).sqrt(),
    }
}
