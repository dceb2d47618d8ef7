//! Products of block matrices with the vector of light: on the device, or on the host if that is where kernels run.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

use glam::{UVec4, Vec3, Vec4};

use super::host_product::{Results, multiply};
use super::sparse::SparseProduct;
use crate::bake::transfer::blocks::{BlockMatrix, Piece};
use crate::bake::transfer::sparse::SellMatrix;
use crate::error::Result;
use crate::gpu::{Buffer, Context, Frame};
use crate::relight::Site;
use crate::relight::factor_budget::FactorBudget;
use crate::relight::light_target::LightTargets;
use crate::relight::visibility::interleaved::{KernelVariants, LightVectors};
use crate::shared::{GROUP_SIZE, MultiplyBlocksConstants, MultiplyBlocksPush, Panel};

/// A product with a block matrix.
pub enum Product {
    Device(Box<DeviceProduct>),
    Host(HostProduct),
}

/// A block matrix on the device, or some of its rows.
pub struct DeviceProduct {
    name: &'static str,
    panels: Buffer<Panel>,
    values: Buffer<UVec4>,
    inputs: Buffer<u32>,
    tints: Buffer<Vec3>,
    outputs: Buffer<u32>,
    kernels: Arc<KernelVariants<MultiplyBlocksPush>>,
}

/// A block matrix in host memory; its factors may lie in the mapped cache file.
pub struct HostProduct {
    name: &'static str,
    matrix: BlockMatrix,
    to_view_samples: bool,
}

/// Uploads matrices within a budget; those of one kind share a kernel.
pub struct Products<'a> {
    context: &'a Arc<Context>,
    site: Site,
    pub budget: FactorBudget,
    /// By number of channels, and whether the outputs are view samples.
    kernels: HashMap<(u32, bool), Arc<KernelVariants<MultiplyBlocksPush>>>,
    piece_bytes: usize,
}

/// Maximum bytes of a part of a matrix that is multiplied at once. Kernels index its factors with 32 bits.
const PIECE_BYTES: u64 = 1 << 30;

impl<'a> Products<'a> {
    pub fn new(context: &'a Arc<Context>, site: Site, budget_bytes: u64) -> Self {
        let piece_bytes = PIECE_BYTES.min(context.info.limits.largest_buffer()) as usize;
        Self { context, site, budget: FactorBudget::new(budget_bytes), kernels: HashMap::new(), piece_bytes }
    }

    /// Of matrices that are applied one after another.
    pub fn of(&mut self, matrices: &[BlockMatrix], to_view_samples: bool) -> Result<Vec<Product>> {
        let mut products = Vec::new();
        let name = if to_view_samples { "transfer to pixels" } else { "transfer" };
        for matrix in matrices.iter().filter(|matrix| !matrix.panels.is_empty()) {
            if self.site == Site::Host {
                products.push(Product::Host(HostProduct { name, matrix: matrix.clone(), to_view_samples }));
                continue;
            }
            let kernels = self.kernels(matrix.channels, to_view_samples)?;
            for panels in matrix.pieces(self.piece_bytes) {
                let piece = matrix.piece(panels);
                let product = DeviceProduct::new(self.context, name, &piece, kernels.clone(), &mut self.budget)?;
                products.push(Product::Device(Box::new(product)));
            }
        }
        Ok(products)
    }

    pub fn of_sparse(&mut self, matrix: &SellMatrix) -> Result<Vec<SparseProduct>> {
        let pieces = matrix.pieces(self.piece_bytes).into_iter();
        pieces.map(|piece| SparseProduct::new(self.context, &matrix.piece(piece), &mut self.budget)).collect()
    }

    fn kernels(&mut self, channels: u32, to_view_samples: bool) -> Result<Arc<KernelVariants<MultiplyBlocksPush>>> {
        Ok(match self.kernels.entry((channels, to_view_samples)) {
            Entry::Occupied(made) => made.get().clone(),
            Entry::Vacant(place) => {
                let wide = self.context.has_wide_subgroups();
                let constants = |lights| MultiplyBlocksConstants { channels, to_view_samples, lights, wide };
                place.insert(Arc::new(KernelVariants::new(self.context, constants)?)).clone()
            }
        })
    }
}

impl Product {
    /// Number of passes on the device.
    pub fn pass_count(&self) -> usize {
        usize::from(matches!(self, Self::Device(_)))
    }

    /// Multiplies the vector of each target; outputs that are view samples are added to their images.
    pub fn run(&self, frame: &mut Frame, vector: &Buffer<Vec4>, targets: &LightTargets) -> Result<()> {
        match self {
            Self::Device(product) => product.run(frame, vector, targets),
            Self::Host(product) => product.run(frame, vector, targets)?,
        }
        Ok(())
    }
}

impl HostProduct {
    fn run(&self, frame: &mut Frame, vector: &Buffer<Vec4>, targets: &LightTargets) -> Result<()> {
        let lights = targets.lights.len();
        frame.host_pass(self.name, |pass| {
            let vectors = LightVectors::new(pass, vector, lights);
            match self.to_view_samples {
                true => multiply(&self.matrix, vectors, Results::ToViewSamples(&targets.view_samples(pass))),
                false => multiply(&self.matrix, vectors, Results::ToVectors),
            }
        })
    }
}

impl DeviceProduct {
    fn new(
        context: &Arc<Context>,
        name: &'static str,
        matrix: &Piece,
        kernels: Arc<KernelVariants<MultiplyBlocksPush>>,
        budget: &mut FactorBudget,
    ) -> Result<Self> {
        Ok(Self {
            name,
            panels: budget.upload(context, "transfer (panels)", &matrix.panels)?,
            values: budget.upload(context, "transfer (factors)", matrix.values)?,
            inputs: budget.upload(context, "transfer (inputs)", matrix.inputs)?,
            tints: budget.upload(context, "transfer (tints)", matrix.tints)?,
            outputs: budget.upload(context, "transfer (outputs)", matrix.outputs)?,
            kernels,
        })
    }

    fn run(&self, frame: &mut Frame, vector: &Buffer<Vec4>, targets: &LightTargets) {
        let mut pass = frame.pass(self.name);
        let push = MultiplyBlocksPush {
            panels: pass.read(&self.panels),
            values: pass.read(&self.values),
            inputs: pass.read(&self.inputs),
            tints: pass.read(&self.tints),
            outputs: pass.read(&self.outputs),
            vector: pass.write(vector),
            images: targets.images(&mut pass),
            extras: targets.extras(&mut pass),
            panel_count: self.panels.len() as u32,
            pixel_stride: targets.pixel_stride,
            extra_stride: targets.extra_stride,
            light_count: targets.lights.len() as u32,
        };
        pass.dispatch(self.kernels.get(targets.lights.len()), &push, push.panel_count * GROUP_SIZE);
    }
}
