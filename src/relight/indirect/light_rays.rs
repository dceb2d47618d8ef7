//! Contributions of light rays to gather samples: see [`crate::bake::gather_samples::light_rays`].

use std::sync::Arc;

use crate::bake::brdf_factors::HarmonicProjection;
use crate::bake::gather_samples::light_rays::{LightRays, RAYS, per_solid_angle};
use crate::bake::transfer::Transfer;
use crate::error::Result;
use crate::gpu::{Access, Buffer, Context, Frame, Kernel};
use crate::physics::octahedral;
use crate::relight::visibility::interleaved::Strided;
use crate::scene::light_filter::PosedFilter;
use crate::shared::*;
use crate::trace::linked::LinkedScene;

/// Casts rays from lights and adds their contributions to λ0.
pub struct RayCaster {
    rays: LightRays,
    kernel: Kernel<AddLightRaysPush>,
}

/// Contributions of one light's rays to gather samples.
pub struct LightRayHits {
    contributions: Buffer<Contribution>,
    count: usize,
    /// [`ShadeGatherPush::per_solid_angle`]
    pub per_solid_angle: f32,
}

impl RayCaster {
    /// `transfer.samples` must not be empty.
    pub fn new(context: &Arc<Context>, transfer: &Transfer) -> Result<Self> {
        let points = transfer.points.iter().map(|p| (p.position, octahedral::decode(p.normal)));
        Ok(Self { rays: LightRays::new(&transfer.samples, points), kernel: Kernel::new(context, ())? })
    }

    /// Casts the rays of a light, from its points `lights` in turn. `transfer` is the one that was given to
    /// [`Self::new`].
    pub fn cast(
        &self,
        scene: LinkedScene,
        transfer: &Transfer,
        lights: &[PackedLight],
        filter: Option<&PosedFilter>,
        hits: &mut LightRayHits,
    ) {
        let contributions = hits.contributions.host_mut();
        let mut count = 0;
        self.rays.shade(scene, &transfer.samples, HarmonicProjection::get(), lights, filter, |index, value| {
            contributions[count] = Contribution { value, index };
            count += 1;
        });
        hits.count = count;
        hits.per_solid_angle = per_solid_angle(&lights[0]).unwrap_or(0.0);
    }

    /// Adds the contributions to λ0.
    pub fn add(&self, frame: &mut Frame, hits: &LightRayHits, vector: &Strided) {
        if hits.count == 0 {
            return;
        }
        let mut pass = frame.pass("add light rays");
        let push = AddLightRaysPush {
            contributions: pass.read(&hits.contributions),
            coefficients: pass.write(vector.buffer),
            count: hits.count as u32,
            stride: vector.stride,
            offset: vector.offset,
            unused: 0,
        };
        pass.dispatch(&self.kernel, &push, push.count);
    }
}

impl LightRayHits {
    /// Removes all contributions, and the weight of rays with them.
    pub fn clear(&mut self) {
        (self.count, self.per_solid_angle) = (0, 0.0);
    }

    /// No contributions, with capacity for all that the rays of one light can make.
    pub fn empty(context: &Arc<Context>, transfer: Option<&Transfer>) -> Result<Self> {
        let samples = transfer.map_or(&[][..], |t| &t.samples);
        let functions = samples.iter().map(|s| s.degrees * s.degrees).max().unwrap_or(0) as usize;
        let count = RAYS.min(samples.len()) * functions;
        let contributions = Buffer::new(context, "light rays", Access::HostWrites, count)?;
        Ok(Self { contributions, count: 0, per_solid_angle: 0.0 })
    }
}
