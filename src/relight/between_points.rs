//! What a light's rays find between the points of gather samples: see [`crate::bake::gather_samples::light_rays`].

use std::sync::Arc;

use super::indirect::Strided;
use crate::bake::brdf_factors::Projection;
use crate::bake::bvh::Bvh;
use crate::bake::gather_samples::light_rays::{LightRays, RAYS, per_power};
use crate::bake::octahedral;
use crate::bake::transfer::baked::BakedTransfer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::scene::Scene;
use crate::shared::*;

/// Casts rays from lights.
pub struct BetweenPoints {
    rays: LightRays,
    samples: Vec<LightSample>,
    projection: Projection,
    kernel: Kernel,
}

/// What rays of one light found.
pub struct Found {
    contributions: Buffer<Contribution>,
    count: usize,
    /// [`ShadeGatherPush::per_power`]
    pub per_power: f32,
}

impl BetweenPoints {
    /// There must be samples of ours.
    pub fn new(context: &Arc<Context>, transfer: &BakedTransfer) -> Result<Self> {
        let points = transfer.points.iter().map(|p| (p.position, octahedral::decode(p.normal)));
        Ok(Self {
            rays: LightRays::new(&transfer.samples, points),
            samples: transfer.samples.clone(),
            projection: Projection::from_tables(&transfer.projection),
            kernel: Kernel::new(context, "add_coefficients", &[])?,
        })
    }

    /// Casts the rays of `light`.
    pub fn find(&self, scene: &Scene, bvh: &Bvh, light: &PackedLight, found: &mut Found) {
        let contributions = found.contributions.host_mut();
        let mut count = 0;
        self.rays.shade(scene, bvh, &self.samples, &self.projection, light, |index, value| {
            contributions[count] = Contribution { value, index };
            count += 1;
        });
        found.count = count;
        found.per_power = per_power(light).unwrap_or(0.0);
    }

    /// Adds it to λ0.
    pub fn add(&self, frame: &mut Frame, found: &Found, vector: &Strided) {
        if found.count == 0 {
            return;
        }
        let mut pass = frame.pass("light between gather samples");
        let push = AddCoefficientsPush {
            contributions: pass.read(&found.contributions),
            coefficients: pass.write(vector.buffer),
            count: found.count as u32,
            stride: vector.stride,
            offset: vector.offset,
            unused: 0,
        };
        pass.dispatch(&self.kernel, &push, push.count);
    }
}

impl Found {
    /// Room for what the rays of a light may find; nothing found.
    pub fn none(context: &Arc<Context>, transfer: Option<&BakedTransfer>) -> Result<Self> {
        let samples = transfer.map_or(&[][..], |t| &t.samples);
        let functions = samples.iter().map(|s| s.degrees * s.degrees).max().unwrap_or(0) as usize;
        let count = RAYS.min(samples.len()) * functions;
        let contributions = Buffer::new(context, "light between gather samples", Access::HostWrites, count)?;
        Ok(Self { contributions, count: 0, per_power: 0.0 })
    }
}
