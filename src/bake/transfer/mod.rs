//! The baked indirect light, independent of the method: gather samples as receivers of direct light, and the chain of
//! block matrices from there to view samples.

pub mod blocks;
mod coarse;
pub mod dense;
mod nested;
pub mod sky;
pub mod sparse;
mod spread;
mod upsampled;

use bytemuck::Zeroable;
use glam::{DVec3, Vec3, Vec4};

use self::blocks::BlockMatrix;
use self::sky::SkyTransfer;
use self::sparse::SellMatrix;
use crate::bake::compression::clusters::Clusters;
use crate::bake::compression::haar::Haar;
use crate::bake::framebuffer::view_samples::pack;
use crate::bake::gather_samples::GatherSamples;
use crate::bake::transport::LightTransport;
use crate::bake::transport::emitted::EmitterLight;
use crate::bake::transport::level::Level;
use crate::bake::{DeepFramebuffer, compression};
use crate::physics::octahedral;
use crate::shared::{DISC_SIDE, FactoredSample, HARMONIC_DEGREES, LightSample, ViewSample};
use crate::trace::packet::SamplePacket;

/// Indirect light of one scene and camera, in the layout of the device.
#[derive(Clone, Default)]
pub struct Transfer {
    /// Samples of our method; empty for the thesis's.
    pub samples: Vec<LightSample>,
    /// Whether the kernel that shades them handles all harmonics although no sample has so many. Not stored in the
    /// cache.
    pub all_degrees: bool,
    /// Samples of the thesis's method, with the tables of k that they refer to; empty for ours.
    pub factored: Vec<FactoredSample>,
    pub tables: Vec<Vec4>,
    /// `points_per_sample` points per sample; only position and normal are used.
    pub points: Vec<ViewSample>,
    pub points_per_sample: usize,
    /// Unit geometric normal of each point.
    pub geometric_normals: Vec<Vec3>,
    /// The same points in the layout of the shadow tracer.
    pub packets: Vec<SamplePacket>,
    /// Length of the vector that the chain operates on. It begins with λ0; every matrix except the last writes a part
    /// that later ones read.
    pub vector_length: usize,
    /// Whether λ0 is Haar-transformed first, in place.
    pub haar: bool,
    /// The outputs of the last matrix are view samples.
    pub chain: Vec<BlockMatrix>,
    /// Replaces all matrices of the chain except the last for fast previews; if empty, the chain itself is used. Not
    /// stored in the cache.
    pub coarse: Vec<BlockMatrix>,
    /// Maps λ0 to view samples if there is no chain.
    pub sparse: Option<SellMatrix>,
    /// Indirect light of emitters.
    pub emission: Vec<EmitterLight>,
    /// Light of the sky; `None` if it was not asked for. Stored in a file of its own.
    pub sky: Option<SkyTransfer>,
    pub report: TransferReport,
}

/// Figures that tell how accurate a transfer is.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct TransferReport {
    pub method: String,
    pub form: String,
    /// Largest absolute eigenvalue of G.
    pub spectral_radius: f64,
    /// Residual of the light after all bounces: see [`LightTransport::residual`]. `None` for a fixed number of bounces.
    pub residual: Option<f64>,
    /// Share of all reflected light that is removed so that no bounce amplifies light: see
    /// [`Certificate::capped`](crate::bake::transport::Certificate::capped).
    pub capped: f64,
    /// Share of all surface area that no pixel sees, even after bounces.
    pub unseen: f64,
    /// Number of indirect bounces, counted at the pixel; `None`: all.
    pub bounces: Option<u32>,
    /// Errors of the compressed form on held-out lights.
    pub held_out: Option<compression::FitReport>,
}

impl TransferReport {
    /// For our operator, stored as `form`.
    pub(in crate::bake) fn robust(
        form: &str,
        transfer: &LightTransport,
        residual: Option<f64>,
        held_out: Option<compression::FitReport>,
    ) -> Self {
        Self {
            method: "robust".into(),
            form: form.into(),
            spectral_radius: transfer.certificate.spectral_radius,
            residual,
            capped: transfer.certificate.capped,
            unseen: transfer.certificate.unseen,
            bounces: transfer.bounces(),
            held_out,
        }
    }
}

impl Transfer {
    /// Applies `chain` to the direct light of `level`.
    pub fn new(level: &Level, vector_length: usize, chain: Vec<BlockMatrix>) -> Self {
        let samples = level.light_samples.clone();
        Self { samples, vector_length, chain, ..Self::lit_at(&level.samples) }.with_packets()
    }

    /// Only the points of gather samples.
    pub(in crate::bake) fn lit_at(samples: &GatherSamples) -> Self {
        let point = |point: &crate::bake::gather_samples::GatherPoint| ViewSample {
            position: point.position,
            brdf: 0,
            normal: octahedral::encode(point.normal),
            wo: Zeroable::zeroed(),
        };
        Self {
            points: samples.points.iter().map(point).collect(),
            geometric_normals: samples.points.iter().map(|p| p.geometric_normal).collect(),
            points_per_sample: samples.points_per_sample,
            ..Default::default()
        }
    }

    /// Adds the points in the layout of the shadow tracer.
    pub(in crate::bake) fn with_packets(self) -> Self {
        let packets = pack(&self.points, &self.geometric_normals, &[], 0);
        Self { packets, ..self }
    }

    /// Number of gather samples.
    pub fn sample_count(&self) -> usize {
        self.samples.len() + self.factored.len()
    }

    /// Whether every index that a kernel follows is valid, for images of `view_samples` samples.
    pub fn is_consistent(&self, view_samples: usize) -> bool {
        let within = |first: u32, count: u32, length: usize| first as usize + count as usize <= length;
        let ours = |s: &LightSample| {
            (1..=HARMONIC_DEGREES).contains(&s.degrees)
                && s.roughness.is_finite()
                && s.area.is_finite()
                && s.area > 0.0
                && within(s.first, s.degrees * s.degrees, self.vector_length)
        };
        let texels = DISC_SIDE * DISC_SIDE;
        let thesis = |s: &FactoredSample| {
            s.terms <= 1 << 16
                && within(s.first, s.terms, self.vector_length)
                && within(s.table, s.terms * texels, self.tables.len())
        };
        let multiplies = match (&self.chain[..], &self.sparse) {
            ([_, ..], None) => reads_only_what_is_there(&self.chain, self.vector_length, view_samples),
            ([], Some(sparse)) => {
                let (inputs, outputs) = (sparse.input_count as usize, sparse.output_count as usize);
                sparse.is_consistent() && (inputs, outputs) == (self.vector_length, view_samples)
            }
            _ => false,
        };
        multiplies
            && self.sample_count().checked_mul(self.points_per_sample) == Some(self.points.len())
            && self.points.len() == self.geometric_normals.len()
            && (self.samples.is_empty() || self.factored.is_empty())
            && (self.factored.is_empty() || self.points_per_sample == 1)
            && self.samples.iter().all(ours)
            && self.factored.iter().all(thesis)
            && self.emission.iter().all(|light| light.radiance.len() == view_samples)
    }

    /// Indirect radiance of all view samples from the coefficients of direct light, in double precision: a twin of the
    /// device's kernels.
    pub fn apply(&self, direct: &[DVec3]) -> Vec<DVec3> {
        let mut vector = if self.haar { Haar::new(&self.first()).terms(direct) } else { direct.to_vec() };
        vector.resize(self.vector_length, DVec3::ZERO);
        if let Some(sparse) = &self.sparse {
            return sparse.multiply(&vector);
        }
        multiply_chain(&self.chain, vector)
    }

    /// Error of each pixel's tile under held-out lights, as measured by the compressor: root mean square in units of
    /// the image's root mean square, row by row. `None` unless the transfer is compressed; pixels without indirect
    /// light are `None`.
    pub fn errors(&self, framebuffer: &DeepFramebuffer) -> Option<Vec<Option<f32>>> {
        let report = self.report.held_out.as_ref()?;
        let clusters = Clusters::new(framebuffer);
        let tiles: Vec<_> = clusters.superclusters().flatten().collect();
        if tiles.len() != report.tiles.len() {
            return None; // row wavelets have no tiles
        }
        let mut errors = vec![None; framebuffer.samples.len()];
        for (tile, error) in tiles.into_iter().zip(&report.tiles) {
            for &sample in &clusters.samples[clusters.rows(&(tile..tile + 1))] {
                errors[sample as usize] = Some(*error as f32);
            }
        }
        let pixels = |y: u32| (0..framebuffer.tiling.width).map(move |x| framebuffer.tiling.index(x, y));
        Some((0..framebuffer.tiling.height).flat_map(pixels).map(|pixel| errors[pixel]).collect())
    }

    /// Coefficients of sample i of our method: `first[i]..first[i + 1]`.
    pub fn first(&self) -> Vec<u32> {
        let end = self.samples.last().map(|s| s.first + s.degrees * s.degrees);
        self.samples.iter().map(|s| s.first).chain(end).collect()
    }

    /// For each element of λ0, Haar-transformed if applicable: whether any product reads it.
    pub fn needed(&self) -> Vec<bool> {
        let mut needed = vec![false; self.vector_length];
        let of_chain = self.chain.iter().chain(&self.coarse).flat_map(|m| m.inputs.iter().copied());
        of_chain.chain(self.sparse.iter().flat_map(SellMatrix::inputs)).for_each(|i| needed[i as usize] = true);
        needed.truncate(self.first().last().map_or(0, |end| *end as usize));
        needed
    }

    /// Bytes read by all products per light, and their multiply-adds.
    pub fn cost(&self) -> (usize, u64) {
        let of_sparse = self.sparse.iter().map(|m| (m.bytes(), m.multiply_adds()));
        of_sparse.fold(cost(&self.chain), |(bytes, adds), (b, a)| (bytes + b, adds + a))
    }
}

/// Bytes that a chain reads for each light, and its multiply-adds.
fn cost(chain: &[BlockMatrix]) -> (usize, u64) {
    chain.iter().fold((0, 0), |(bytes, adds), m| (bytes + m.bytes(), adds + m.multiply_adds()))
}

/// Whether every index of a chain is valid, for a vector of `vector_length` elements.
fn reads_only_what_is_there(chain: &[BlockMatrix], vector_length: usize, view_samples: usize) -> bool {
    let (last, inner) = chain.split_last().expect("there is a matrix");
    chain.iter().all(|m| m.is_consistent() && m.input_count as usize == vector_length)
        && inner.iter().all(|m| m.output_count as usize == vector_length)
        && last.output_count as usize == view_samples
}

/// Applies the matrices of a chain, one after another.
fn multiply_chain(chain: &[BlockMatrix], mut vector: Vec<DVec3>) -> Vec<DVec3> {
    let (last, inner) = chain.split_last().expect("there is a matrix");
    for matrix in inner {
        let product = matrix.multiply(&vector);
        matrix.outputs.iter().for_each(|&o| vector[o as usize] = product[o as usize]);
    }
    last.multiply(&vector)
}
