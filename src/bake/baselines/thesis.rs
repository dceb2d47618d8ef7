//! Transfer as published [Yang 2007, Chapter 4]: random samples, form factors with squared distances, a truncated sum,
//! and BRDFs factored by singular values.
//!
//! Corrections of the text: λ0 includes the cosine that is missing there. The number of terms δ is chosen per material,
//! as every pair of samples has an entry: with δ = 8 everywhere, Φ of a picture of 512x512 with 2,304 samples would
//! take 19 GB. A textured material is factored at its mean.

use faer::Mat;
use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use crate::bake::DeepFramebuffer;
use crate::bake::brdf_factors::svd::{Factors, Terms};
use crate::bake::brdf_factors::{ALBEDO_CAP, HarmonicProjection};
use crate::bake::csr_matrix::CsrMatrix;
use crate::bake::gather_samples::{GatherSample, GatherSamples, Placement, Surfaces, average};
use crate::bake::transfer::dense::{explicit, last_matrix};
use crate::bake::transfer::{Transfer, TransferReport};
use crate::bake::transport::directions::Lobe;
use crate::bake::transport::emitted::Emitted;
use crate::bake::transport::level::local;
use crate::bake::transport::rows::Row;
use crate::bake::transport::solve;
use crate::bake::transport::{Outgoing, direct};
use crate::physics::brdf::Lobes;
use crate::physics::octahedral;
use crate::shared::{DISC_SIDE, FactoredSample, LIGHT_POINT, NO_BRDF, PackedLight};
use crate::storage::journal::Journal;
use crate::trace::bvh::TracedScene;
use crate::trace::packet::{PACKET_SIZE, SamplePacket, trace_packets};

/// Settings of the thesis's method.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ThesisSettings {
    /// `Diffuse` is Section 4.2, `Glossy` Section 4.3 with the number of terms given by `terms`.
    pub outgoing: Outgoing,
    /// Number of samples N; 2,304 in the thesis.
    pub samples: usize,
    /// Number of terms δ of a material.
    pub terms: Terms,
    /// Number of indirect bounces, counted at the pixel: 5 gives the published I + G + ... + G⁴.
    pub bounces: u32,
    pub seed: u64,
}

/// The thesis's transfer of one scene and camera.
pub struct Thesis<'a> {
    scene: &'a TracedScene,
    framebuffer: &'a DeepFramebuffer,
    pub bounces: u32,
    pub samples: GatherSamples,
    packets: Vec<SamplePacket>,
    /// By material; `None` if it has no sample.
    reflections: Vec<Option<Reflection>>,
    /// Coefficients of sample i: `first[i]..first[i + 1]`.
    pub first: Vec<u32>,
    pub frames: Vec<[Vec3; 3]>,
    /// G.
    pub g: CsrMatrix,
    /// Largest absolute eigenvalue of G: from 1 on the series diverges.
    pub spectral_radius: f64,
}

/// f(ωo, ωi) as h(ωo) · k(ωi).
enum Reflection {
    /// Hemispherical albedo over pi [Yang 2007, Section 4.2].
    Even(Vec3),
    Factors(Factors),
}

impl Reflection {
    fn terms(&self) -> usize {
        match self {
            Self::Even(_) => 1,
            Self::Factors(factors) => factors.terms,
        }
    }

    fn h(&self, wo: Vec3, values: &mut [Vec3]) {
        match self {
            Self::Even(_) => values[0] = Vec3::ONE,
            Self::Factors(factors) => factors.h(wo, values),
        }
    }

    fn k(&self, wi: Vec3, values: &mut [Vec3]) {
        match self {
            Self::Even(reflectance) => values[0] = *reflectance,
            Self::Factors(factors) => factors.k(wi, values),
        }
    }
}

impl<'a> Thesis<'a> {
    /// `progress` counts samples whose row of G is done.
    pub fn new(
        scene: &'a TracedScene,
        framebuffer: &'a DeepFramebuffer,
        settings: &ThesisSettings,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Self {
        let samples =
            GatherSamples::place(scene, &Surfaces::even(scene), Placement::Random, settings.samples, settings.seed);
        let reflections: Vec<Option<Reflection>> =
            (0..scene.materials.len()).map(|material| reflection(&samples, material as u32, settings)).collect();
        let mut first = vec![0];
        for sample in &samples.samples {
            let terms = reflections[sample.material as usize].as_ref().map_or(0, Reflection::terms);
            first.push(first[first.len() - 1] + terms as u32);
        }
        let mut thesis = Self {
            scene,
            framebuffer,
            bounces: settings.bounces,
            packets: samples.packets(),
            frames: samples.samples.iter().map(GatherSample::frame).collect(),
            samples,
            reflections,
            first,
            g: CsrMatrix::default(),
            spectral_radius: 0.0,
        };
        let blocks: Vec<CsrMatrix> = (0..thesis.samples.len())
            .into_par_iter()
            .map_init(
                || thesis.scratch(),
                |scratch, sample| {
                    let block = thesis.block_row(sample, scratch);
                    progress(1);
                    block
                },
            )
            .collect();
        thesis.g = CsrMatrix::concatenated(blocks);
        thesis.spectral_radius = solve::spectral_radius(&thesis.g);
        thesis.bounces = thesis.bounces.min(solve::bounces_that_matter(thesis.spectral_radius));
        thesis
    }

    /// Number of coefficients of all samples.
    pub fn column_count(&self) -> usize {
        self.first[self.samples.len()] as usize
    }

    /// k of a sample for light from a unit direction in its frame, one value per coefficient.
    pub fn project(&self, sample: usize, wi: Vec3, values: &mut [Vec3]) {
        self.reflection(sample).k(wi, values);
    }

    /// Λ* from Λ0: the truncated sum over bounces.
    pub fn bounce(&self, direct: &[DVec3]) -> Vec<DVec3> {
        solve::sum_of_powers(&self.g, direct, self.bounces)
    }

    /// Rows of Φ for view samples, by index into [`DeepFramebuffer::samples`].
    pub fn rows(&self, view_samples: &[u32], lobe: Lobe) -> CsrMatrix {
        let row = |scratch: &mut Scratch, sample: &u32| {
            let mut rows = CsrMatrix::empty(0);
            self.view_row(*sample, lobe, scratch);
            scratch.rows[0].take(0, &mut rows);
            rows.first.push(rows.columns.len());
            rows
        };
        CsrMatrix::concatenated(view_samples.par_iter().map_init(|| self.scratch(), row).collect())
    }

    /// Tables of k for all materials, in the layout of shade_factored.comp, and the offset of each sample's table.
    pub fn k_tables(&self) -> (Vec<Vec4>, Vec<u32>) {
        let mut tables = Vec::new();
        let mut add = |reflection: &Option<Reflection>| {
            let first = tables.len() as u32;
            match reflection {
                Some(Reflection::Even(k)) => tables.extend([k.extend(1.0); (DISC_SIDE * DISC_SIDE) as usize]),
                Some(Reflection::Factors(factors)) => tables.extend(factors.k_map()),
                None => {}
            }
            first
        };
        let of_material: Vec<u32> = self.reflections.iter().map(&mut add).collect();
        let first = self.samples.samples.iter().map(|s| of_material[s.material as usize]).collect();
        (tables, first)
    }

    /// G* = I + G + ..., with as many terms as bounces, one matrix per channel. Only for few coefficients: takes six n²
    /// matrices.
    pub fn all_bounces(&self) -> [Mat<f32>; 3] {
        let n = self.column_count();
        [0, 1, 2].map(|channel| {
            let mut g = Mat::<f32>::zeros(n, n);
            for r in 0..n {
                self.g.row(r).for_each(|(column, value)| g[(r, column as usize)] += value[channel]);
            }
            let identity = Mat::<f32>::identity(n, n);
            match self.bounces {
                0 => Mat::zeros(n, n),
                bounces => (1..bounces).fold(identity.clone(), |sum, _| &g * sum + &identity),
            }
        })
    }

    fn reflection(&self, sample: usize) -> &Reflection {
        let material = self.samples.samples[sample].material;
        self.reflections[material as usize].as_ref().expect("its material has a sample")
    }

    fn scratch(&self) -> Scratch<'_> {
        let terms = self.reflections.iter().flatten().map(Reflection::terms).max().unwrap_or(1);
        Scratch {
            visibility: vec![0; self.packets.len() * PACKET_SIZE],
            rows: (0..terms).map(|_| Row::new(&self.first, u32::MAX)).collect(),
            h: vec![Vec3::ZERO; terms],
            k: vec![Vec3::ZERO; terms],
        }
    }

    /// Block row of a receiving sample: T(gj, gi) k(gj, ωi) ⊗ h(gi, -ωi) [Yang 2007, Eq. 4.8].
    fn block_row(&self, receiver: usize, scratch: &mut Scratch) -> CsrMatrix {
        let GatherSample { position, normal, .. } = self.samples.samples[receiver];
        let point = &self.samples.points_of(receiver)[0];
        let terms = self.reflection(receiver).terms();
        let mut k = std::mem::take(&mut scratch.k);
        self.each_visible(position, normal, point.geometric_normal, scratch, |scratch, sender, wi, transfer| {
            self.reflection(receiver).k(local(&self.frames[receiver], wi), &mut k[..terms]);
            let Scratch { rows, h, .. } = scratch;
            rows.iter_mut().zip(&k[..terms]).for_each(|(row, k)| row.add_colored(sender, h, *k * transfer));
        });
        scratch.k = k;
        let mut block = CsrMatrix::empty(0);
        for row in &mut scratch.rows[..terms] {
            row.take(0, &mut block);
            block.first.push(block.columns.len());
        }
        block
    }

    /// Row of a view sample: T(v, gj) f(v, ωo, ωi) h(gj, -ωi).
    fn view_row(&self, view_sample: u32, lobe: Lobe, scratch: &mut Scratch) {
        let view = &self.framebuffer.samples[view_sample as usize];
        if view.brdf == NO_BRDF {
            return;
        }
        let (normal, wo) = (octahedral::decode(view.normal), octahedral::decode(view.wo));
        let brdf = &self.framebuffer.brdfs[view.brdf as usize];
        let Some(lobes) = Lobes::new(brdf, normal.as_dvec3().normalize(), wo.as_dvec3().normalize()) else { return };
        let geometric_normal = self.framebuffer.geometric_normals[view_sample as usize];
        self.each_visible(view.position, normal, geometric_normal, scratch, |scratch, sender, wi, transfer| {
            let at = lobes.at(wi.as_dvec3());
            let reflected = match lobe {
                Lobe::All => at.sum(),
                Lobe::Specular => at.specular,
            };
            // T contains the cosine that is also in `reflected`.
            let light = reflected.as_vec3() * (transfer / normal.dot(wi));
            scratch.rows[0].add_colored(sender, &scratch.h, light);
        });
    }

    /// Calls `visit` with every sample visible from a point, the direction to it, and T [Yang 2007, Eq. 4.4];
    /// `scratch.h` contains its h towards the point.
    fn each_visible(
        &self,
        position: Vec3,
        normal: Vec3,
        geometric_normal: Vec3,
        scratch: &mut Scratch,
        mut visit: impl FnMut(&mut Scratch, usize, Vec3, f32),
    ) {
        // Visibility as for a point light at the point: exact, and 64 samples at a time.
        let light = PackedLight {
            position: position + geometric_normal * self.scene.bvh.shadow_offset(0.0),
            kind: LIGHT_POINT,
            direction: Vec3::NEG_Z,
            inverse_range: 0.0,
            cone_scale: 1.0,
            cone_versine: 1.0,
            narrowing: 0.0,
            squared_radius: 0.0,
            strength: 1.0,
        };
        trace_packets(self.scene, &light, &self.packets, &mut scratch.visibility);
        for sender in 0..self.samples.len() {
            let seen = f32::from(scratch.visibility[sender]) / 255.0;
            if seen == 0.0 {
                continue;
            }
            let sample = &self.samples.samples[sender];
            let between = sample.position - position;
            let (wi, r2) = (between.normalize_or_zero(), between.length_squared());
            let cosines = normal.dot(wi).max(0.0) * (-sample.normal.dot(wi)).max(0.0);
            if cosines == 0.0 || r2 == 0.0 {
                continue;
            }
            let terms = self.reflection(sender).terms();
            scratch.h.resize(terms, Vec3::ZERO);
            self.reflection(sender).h(local(&self.frames[sender], -wi), &mut scratch.h);
            visit(scratch, sender, wi, seen * sample.area * cosines / r2);
        }
    }
}

/// Buffers that a thread reuses between rows.
struct Scratch<'a> {
    visibility: Vec<u8>,
    rows: Vec<Row<'a>>,
    h: Vec<Vec3>,
    k: Vec<Vec3>,
}

fn reflection(samples: &GatherSamples, material: u32, settings: &ThesisSettings) -> Option<Reflection> {
    let of_material = || samples.samples.iter().filter(|s| s.material == material).map(|s| (s.brdf, f64::from(s.area)));
    of_material().next()?;
    let brdf = average(of_material());
    Some(match settings.outgoing {
        Outgoing::Diffuse => {
            Reflection::Even(HarmonicProjection::get().hemispherical_albedo(&brdf, ALBEDO_CAP) / std::f32::consts::PI)
        }
        Outgoing::Glossy { .. } => Reflection::Factors(Factors::new(&brdf, settings.terms)),
    })
}

/// [`direct::shade`] with the thesis's factors.
pub fn shade_thesis(scene: &TracedScene, thesis: &Thesis, light: &PackedLight) -> Vec<DVec3> {
    let project = |sample: usize, wi: Vec3, _: f64, values: &mut [Vec3]| thesis.project(sample, wi, values);
    direct::shade_with(scene, &thesis.samples, &thesis.first, project, light)
}

impl Transfer {
    /// The thesis's operator: G* and Φ [Yang 2007, Eq. 4.5 to 4.9]. Rows of Φ found in `journal` are reused. `progress`
    /// counts view samples.
    pub fn thesis(
        thesis: &Thesis,
        framebuffer: &DeepFramebuffer,
        lobe: Lobe,
        journal: &mut Journal,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Self {
        let count = thesis.column_count();
        let all = thesis.all_bounces();
        let bounce = explicit(count, count, |row, column| all.each_ref().map(|matrix| matrix[(row, column)]));
        let gather = |samples: &[u32]| thesis.rows(samples, lobe);
        let (last, _) =
            last_matrix(framebuffer, 2 * count, count as u32, &Emitted::default(), gather, journal, progress);
        let (tables, table_of) = thesis.k_tables();
        let sample = |i: usize| FactoredSample {
            normal: thesis.frames[i][2],
            tangent: thesis.frames[i][0],
            table: table_of[i],
            terms: thesis.first[i + 1] - thesis.first[i],
            first: thesis.first[i],
        };
        let report = TransferReport {
            method: "thesis".into(),
            form: "dense".into(),
            spectral_radius: thesis.spectral_radius,
            bounces: Some(thesis.bounces),
            ..Default::default()
        };
        let transfer = Self {
            factored: (0..thesis.samples.len()).map(sample).collect(),
            tables,
            vector_length: 2 * count,
            chain: vec![bounce, last],
            report,
            ..Self::lit_at(&thesis.samples)
        };
        transfer.with_packets()
    }
}
