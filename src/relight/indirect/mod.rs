//! Indirect light on the device: computes λ0 of a light, applies the chain of block matrices and adds the result to its
//! image. [`Indirect::add`] records these passes:
//!
//! 1. `shade gather samples` (shade_gather.comp): λ0 at points, for each light.
//! 2. Light rays (add_light_rays.comp) and the Haar transform (haar.comp, haar_sums.comp), if there are any.
//! 3. `transfer` (multiply_blocks.comp): all matrices of the chain except the last. Reads and writes the vector.
//! 4. `transfer to pixels` (multiply_blocks.comp): the last matrix. Adds to the images of the lights and to the
//!    radiance of extra samples. For row wavelets a sparse product (multiply_sparse.comp) takes the place of 3 and 4.
//!
//! Where kernels run on the CPU, the Haar transform (haar.rs) and the products of 3 and 4 (host_product.rs) are
//! computed on the host.
//!
//! Each pass declares what it accesses by `pass.read` and `pass.write`; [`LightTargets`] does this for the images.
//! [`Frame`] derives the barriers.

pub(super) mod block_product;
pub(super) mod haar;
pub mod host_product;
pub mod host_sum;
pub(super) mod images;
pub(super) mod light_rays;
pub(super) mod sky_importance;
pub(super) mod sky_light;
pub(super) mod sparse;

use std::sync::Arc;

use glam::Vec4;

use self::block_product::{Product, Products};
use self::haar::HaarTransform;
use self::light_rays::RayCaster;
use self::sky_light::SkyLight;
use self::sparse::SparseProduct;
use super::Site;
use super::light_cache::Detail;
use super::light_target::{LightTarget, LightTargets};
use super::visibility::interleaved::{Strided, vectors};
use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel, is_out_of_memory};
use crate::shared::*;

/// The transfer on the device.
pub struct Indirect {
    /// Points of gather samples.
    pub points: Buffer<ViewSample>,
    samples: GatherShading,
    /// `None` for gather samples of the thesis's method.
    pub ray_caster: Option<RayCaster>,
    /// λ0 and the results of the chain, for one light or interleaved for [`MAX_LIGHTS_PER_PASS`] lights.
    vector: Buffer<Vec4>,
    /// Number of lights that the vector has room for.
    pub lights_at_once: usize,
    haar: Option<HaarTransform>,
    /// The matrices of the chain except the last.
    inner: Vec<Product>,
    /// Replaces `inner` in coarse pictures; empty: `inner` is used.
    coarse: Vec<Product>,
    /// The last matrix, to view samples.
    last: Vec<Product>,
    /// Replaces the chain for sparse transfers.
    sparse: Vec<SparseProduct>,
    /// `None` if there is no dome, or if its light does not arrive.
    pub sky: Option<SkyLight>,
    /// Bytes of the budget that factors take.
    pub device_bytes: u64,
}

/// Gather samples and the kernel that computes λ0.
enum GatherShading {
    Projected {
        samples: Buffer<LightSample>,
        tables: Buffer<f32>,
        /// For one point of a light, and for interleaved points.
        kernels: [Kernel<ShadeGatherPush>; 2],
    },
    /// Those of the thesis's method.
    Factored { samples: Buffer<FactoredSample>, tables: Buffer<Vec4>, kernels: [Kernel<ShadeFactoredPush>; 2] },
}

impl Indirect {
    /// Uploads `transfer`. Factors beyond `budget_bytes` stay in host memory; kernels read them from there in every
    /// frame. With products on the host no factors are uploaded.
    pub fn new(context: &Arc<Context>, transfer: &Transfer, site: Site, budget_bytes: u64) -> Result<Self> {
        // What is always needed comes before the factors.
        let points = Buffer::from_slice(context, "gather samples (points)", &transfer.points)?;
        let samples = GatherShading::new(context, transfer)?;
        let ray_caster = (!transfer.samples.is_empty()).then(|| RayCaster::new(context, transfer)).transpose()?;
        let haar = || HaarTransform::new(context, site, &transfer.first(), &transfer.needed());
        let haar = transfer.haar.then(haar).transpose()?;
        let (vector, lights_at_once) = vector(context, transfer.vector_length)?;
        let mut products = Products::new(context, site, budget_bytes);
        let (inner, last) = transfer.chain.split_at(transfer.chain.len().saturating_sub(1));
        let (inner, coarse, last) =
            (products.of(inner, false)?, products.of(&transfer.coarse, false)?, products.of(last, true)?);
        let sparse = transfer.sparse.as_ref().map_or(Ok(Vec::new()), |matrix| products.of_sparse(matrix))?;
        let sky = transfer.sky.as_ref().map(|sky| SkyLight::new(context, sky, &mut products)).transpose()?.flatten();
        let budget = products.budget;
        if budget.streamed > 0 {
            let [streamed_mb, budget_mb] = [budget.streamed, budget_bytes].map(|bytes| bytes as f64 * 1e-6);
            tracing::info!(
                "{streamed_mb:.0} MB of the transfer are read from host memory in every frame: the budget allows {budget_mb:.0} MB"
            );
        }
        Ok(Self {
            device_bytes: budget_bytes - budget.left,
            sky,
            points,
            samples,
            ray_caster,
            vector,
            lights_at_once,
            haar,
            inner,
            coarse,
            last,
            sparse,
        })
    }

    /// Maximum number of passes on the device per light that [`Self::add`] records.
    pub fn pass_count(&self) -> usize {
        let count = |products: &[Product]| products.iter().map(Product::pass_count).sum::<usize>();
        let inner = count(&self.inner).max(count(&self.coarse));
        let sky = self.sky.as_ref().map_or(0, SkyLight::pass_count);
        2 + self.haar.as_ref().map_or(0, HaarTransform::pass_count)
            + inner
            + count(&self.last)
            + self.sparse.len()
            + sky
    }

    /// Adds the indirect light of each light to its image.
    pub fn add(&self, frame: &mut Frame, targets: &LightTargets, detail: Detail) -> Result<()> {
        if self.points.is_empty() {
            return Ok(());
        }
        let count = targets.lights.len();
        for (offset, points) in targets.lights.iter().enumerate() {
            let vector = Strided { buffer: &self.vector, stride: vectors(count), offset: offset as u32 };
            for (number, point) in points.iter().enumerate() {
                self.samples.shade(frame, point, &self.points, &vector, number > 0);
            }
            if let Some(ray_caster) = &self.ray_caster {
                points.iter().for_each(|point| ray_caster.add(frame, &point.visibility.light_rays, &vector));
            }
        }
        if let Some(haar) = &self.haar {
            haar.run(frame, &self.vector, count)?;
        }
        let coarse = detail == Detail::Coarse && !self.coarse.is_empty();
        for product in if coarse { &self.coarse } else { &self.inner }.iter().chain(&self.last) {
            product.run(frame, &self.vector, targets)?;
        }
        for product in &self.sparse {
            product.run(frame, &self.vector, targets);
        }
        Ok(())
    }
}

/// The vector for [`MAX_LIGHTS_PER_PASS`] lights; for one if the device has no room for more.
fn vector(context: &Arc<Context>, length: usize) -> Result<(Buffer<Vec4>, usize)> {
    let with =
        |lights: usize| Ok((Buffer::new(context, "transfer (vector)", Access::Device, lights * length)?, lights));
    let most = MAX_LIGHTS_PER_PASS as usize;
    let is_allowed = (most * length * size_of::<Vec4>()) as u64 <= context.info.limits.largest_buffer();
    match with(if is_allowed { most } else { 1 }) {
        Err(error) if is_out_of_memory(&error) => with(1),
        made => made,
    }
}

impl GatherShading {
    fn new(context: &Arc<Context>, transfer: &Transfer) -> Result<Self> {
        if !transfer.factored.is_empty() {
            return Ok(Self::Factored {
                samples: Buffer::from_slice(context, "gather samples", &transfer.factored)?,
                tables: Buffer::from_slice(context, "gather samples (tables)", &transfer.tables)?,
                kernels: [
                    Kernel::new(context, ShadeFactoredConstants { soft: false })?,
                    Kernel::new(context, ShadeFactoredConstants { soft: true })?,
                ],
            });
        }
        let degrees = match transfer.all_degrees {
            true => HARMONIC_DEGREES,
            false => transfer.samples.iter().map(|s| s.degrees).max().unwrap_or(0),
        };
        let points_per_sample = transfer.points_per_sample as u32;
        let kernel = |soft| Kernel::new(context, ShadeGatherConstants { degrees, points_per_sample, soft });
        Ok(Self::Projected {
            samples: Buffer::from_slice(context, "gather samples", &transfer.samples)?,
            tables: Buffer::from_slice(context, "gather samples (tables)", &HarmonicProjection::get().tables())?,
            kernels: [kernel(false)?, kernel(true)?],
        })
    }

    /// Computes λ0 of one light, or of one of its points. `accumulate` adds to that of other points.
    fn shade(
        &self,
        frame: &mut Frame,
        target: &LightTarget,
        points: &Buffer<ViewSample>,
        vector: &Strided,
        accumulate: bool,
    ) {
        let mut pass = frame.pass("shade gather samples");
        match self {
            Self::Projected { samples, tables, kernels } => {
                let push = ShadeGatherPush {
                    samples: pass.read(samples),
                    points: pass.read(points),
                    visibility: pass.read(&target.visibility.gather_points),
                    factors: pass.read(&target.visibility.factors.gather_points),
                    tables: pass.read(tables),
                    coefficients: pass.write(vector.buffer),
                    lights: pass.read(&target.visibility.points),
                    light: target.light,
                    sample_count: samples.len() as u32,
                    stride: vector.stride,
                    offset: vector.offset,
                    per_solid_angle: target.visibility.light_rays.per_solid_angle,
                    flags: u32::from(accumulate) * ACCUMULATE + u32::from(target.has_factors) * HAS_FACTORS,
                };
                pass.dispatch(&kernels[usize::from(target.soft.is_some())], &push, push.sample_count);
            }
            Self::Factored { samples, tables, kernels } => {
                let push = ShadeFactoredPush {
                    samples: pass.read(samples),
                    points: pass.read(points),
                    visibility: pass.read(&target.visibility.gather_points),
                    factors: pass.read(&target.visibility.factors.gather_points),
                    tables: pass.read(tables),
                    coefficients: pass.write(vector.buffer),
                    lights: pass.read(&target.visibility.points),
                    light: target.light,
                    sample_count: samples.len() as u32,
                    stride: vector.stride,
                    offset: vector.offset,
                    accumulate: u32::from(accumulate),
                    has_factors: u32::from(target.has_factors),
                };
                pass.dispatch(&kernels[usize::from(target.soft.is_some())], &push, push.sample_count);
            }
        }
    }
}
