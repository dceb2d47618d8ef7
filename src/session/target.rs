//! The device on which a session's pictures are to be made, asked before it bakes for them.

use std::path::Path;

use super::plan::TransferPlan;
use super::survey::{FramebufferCounts, Survey};
use crate::error::Result;
use crate::gpu::{DeviceInfo, find_device};
use crate::relight::choose_device;
use crate::relight::footprint::{Footprint, GatherFootprint, MapFootprint};
use crate::relight::{RelightSettings, VisibilityMethod};
use crate::scene::Rig;
use crate::trace::bvh::TracedScene;

/// A device, and how pictures are made there.
#[derive(Clone, Debug)]
pub struct Target {
    pub device: DeviceInfo,
    pub relight: RelightSettings,
}

impl Target {
    /// `device`: its index or a part of its name; `None`: the fastest one, see [`choose_device`], which keeps what it
    /// measures in `cache_dir`.
    pub fn new(device: Option<&str>, cache_dir: Option<&Path>, relight: RelightSettings) -> Result<Self> {
        let device = choose_device(device, cache_dir)?;
        Ok(Self { device: find_device(device.as_deref())?, relight })
    }

    /// Whether shadow rays are probably traced there: [`VisibilityMethod::Auto`] is measured only later.
    pub fn traces(&self, scene: &TracedScene) -> bool {
        match self.relight.visibility {
            VisibilityMethod::Auto => self.device.is_cpu() || scene.bvh.has_blends,
            method => method == VisibilityMethod::Traced,
        }
    }

    /// What pictures of `size` pixels take of the device's memory.
    pub(super) fn footprint(
        &self,
        scene: &TracedScene,
        rig: &Rig,
        size: [u32; 2],
        counts: &FramebufferCounts,
        transfer: Option<&TransferPlan>,
    ) -> Footprint {
        let gather = transfer.map(|plan| {
            let (samples, points_per_sample, functions) = plan.gather();
            GatherFootprint { samples, points_per_sample, functions, site: self.relight.site_on(self.device.is_cpu()) }
        });
        Footprint {
            size,
            extra_samples: counts.samples - counts.pixels,
            brdfs: scene.materials.len() + counts.own_brdfs,
            emitters: counts.emitters,
            lights: rig.lights.len(),
            sizes: rig.has_sizes(),
            domes: rig.has_domes(),
            factors: rig.has_factors(),
            gather,
            maps: (!self.traces(scene)).then(|| MapFootprint::new(scene, self.relight.shadow_size)),
        }
    }
}

impl Survey {
    /// What pictures on `target` take of its memory.
    pub fn footprint(&self, target: &Target) -> Footprint {
        target.footprint(&self.scene, &self.rig, self.size, &self.counts, self.transfer.as_ref())
    }
}
