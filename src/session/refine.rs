//! Indirect light of a rig's lights, gathered anew until an error or a time.

use std::time::Instant;

use glam::Vec3;

use super::Session;
use super::memory::check_free;
use crate::error::Result;
use crate::final_gather::{Estimate, FinalGather, LEAST_PASSES, Refined};
use crate::image::luminance;
use crate::relight::{LightChanges, Relighter, Request};

/// When final gathering ends: at whichever comes first.
#[derive(Clone, Copy, Debug)]
pub struct Until {
    /// Expected error of a pixel, root mean square, relative to the mean luminance of the picture.
    pub error: Option<f64>,
    /// At least two passes are made.
    pub seconds: Option<f64>,
}

/// What final gathering makes of the pictures of a rig.
pub struct Refinement {
    /// Expected error of each pixel, row by row: root mean square over its channels, in the unit of the picture.
    pub errors: Vec<f32>,
    /// Expected error of a pixel, root mean square, relative to the mean luminance of the picture.
    pub error: f64,
    /// Most passes of a part of the picture.
    pub passes: u32,
    pub seconds: f64,
}

/// Passes between checks of the error, relative to those that were made.
const CHECK_EVERY: f64 = 0.25;
/// Bytes of each light: the operator's picture, sums and estimates of both halves, and the change.
const BYTES_A_SAMPLE: usize = 12 + 24 + 24 + 12;

impl Session {
    /// Gathers indirect light for the lights of the relighter's rig, and adds what its pictures of them lack. `tell`
    /// gets the expected error whenever it is known again. Only for sessions whose indirect light [has all
    /// bounces](super::IndirectSettings::has_all_bounces).
    ///
    /// # Errors
    /// Those of the device, and too many lights for the free memory.
    ///
    /// # Panics
    /// If it may not end.
    pub fn refine(&self, relighter: &mut Relighter, until: Until, seed: u64, tell: impl Fn(f64)) -> Result<Refinement> {
        assert!(until.error.is_some() || until.seconds.is_some(), "final gathering has to end: {until:?}");
        let start = Instant::now();
        let is_late = || until.seconds.is_some_and(|seconds| start.elapsed().as_secs_f64() >= seconds);
        let rig = relighter.rig().clone();
        let count = (0..rig.lights.len()).filter(|light| rig.scale(*light) != Vec3::ZERO).count();
        let bytes = (count * BYTES_A_SAMPLE * self.framebuffer.samples.len()) as f64;
        let what = format!("final gathering of {count} lights takes");
        check_free(bytes, &what, "choose a smaller --size, or fewer lights", &self.scene.path)?;
        let mut gather = FinalGather::new(&self.scene, &self.framebuffer, &rig, |_| true, seed, 0);
        let lights: Vec<usize> = gather.lights().collect();
        let beauty: Vec<Vec3> = relighter.linear(Request::default())?.iter().copied().map(Vec3::from).collect();
        let operator: Vec<Vec<Vec3>> = lights.iter().map(|&light| relighter.indirect(light)).collect::<Result<_>>()?;
        let refine = |gather: &FinalGather| {
            let estimates: Vec<Estimate> = (0..lights.len()).map(|source| gather.estimate(source)).collect();
            let of_light = |i: usize| (rig.scale(lights[i]), &operator[i][..], &estimates[i]);
            let of_lights: Vec<_> = (0..lights.len()).map(of_light).collect();
            let refined = Refined::new(self.size().0, &of_lights);
            let mut picture = beauty.clone();
            for (&light, change) in lights.iter().zip(&refined.changes) {
                picture.iter_mut().zip(change).for_each(|(pixel, change)| *pixel += rig.scale(light) * *change);
            }
            let luminances = picture.iter().map(|pixel| f64::from(luminance(pixel.to_array())));
            let mean = luminances.sum::<f64>() / picture.len() as f64;
            // A black picture has no error.
            let error = if refined.error() > 0.0 { refined.error() / mean.abs() } else { 0.0 };
            (refined, error)
        };
        let mut next_check = LEAST_PASSES;
        let (refined, error) = loop {
            let passes = gather.passes();
            gather.pass(&|| passes >= 2 && is_late());
            let may_end = is_late() || lights.is_empty() || gather.passes() >= next_check;
            if gather.passes() < 2 || !may_end {
                continue;
            }
            let (refined, error) = refine(&gather);
            tell(error);
            if is_late() || lights.is_empty() || !error.is_finite() || until.error.is_some_and(|asked| error <= asked) {
                break (refined, error);
            }
            gather.focus(&refined.errors2);
            next_check = gather.passes() + 1 + (CHECK_EVERY * f64::from(gather.passes())) as u32;
        };
        let mut changes = LightChanges::default();
        for (&light, change) in lights.iter().zip(&refined.changes) {
            changes.set(relighter.context(), &self.framebuffer, (&rig, light), change, lights.len())?;
        }
        relighter.set_changes(&changes)?;
        let errors = refined.errors2.iter().map(|error2| error2.sqrt() as f32).collect();
        Ok(Refinement { errors, error, passes: gather.passes(), seconds: start.elapsed().as_secs_f64() })
    }
}
