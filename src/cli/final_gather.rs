//! `relume render --final ERROR` and `--seconds S`: indirect light gathered anew for known lights, better with time.

use std::time::Instant;

use glam::Vec3;
use relume::final_gather::{Estimate, FinalGather, LEAST_PASSES, Refined};
use relume::image::luminance;
use relume::relight::{LightChanges, Relighter, Request};
use relume::session::{IndirectSettings, Session};
use relume::{Error, Result};
use serde_json::{Value, json};

use super::options::parse_seconds;
use super::progress;

#[derive(clap::Args, Clone)]
pub struct FinalOptions {
    /// Gathers indirect light anew for the lights of the rig, until the expected error of a pixel, relative to the mean
    /// of the picture, is at most this: a fraction, or percent with %.
    #[arg(id = "final", long, value_name = "ERROR", value_parser = parse_error)]
    error: Option<f64>,
    /// The same for this time in seconds; with --final, for at most so long. It takes two passes at least.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
}

/// Parses an expected error.
pub fn parse_error(text: &str) -> Result<f64, String> {
    let (number, scale) = text.strip_suffix('%').map_or((text, 1.0), |number| (number, 0.01));
    let error = number.trim().parse::<f64>().ok().map(|error| error * scale);
    error
        .filter(|error| *error > 0.0 && *error < 1.0)
        .ok_or("expected an error like 0.01 or 1%: more than 0, less than 1".into())
}

/// What final gathering makes of the pictures of a rig.
pub struct Refinement {
    /// Expected error of each pixel, row by row: root mean square over its channels.
    pub errors: Vec<f32>,
    /// Expected error of a pixel, root mean square, relative to the mean luminance of the picture.
    error: f64,
    /// Most passes of a part of the picture.
    passes: u32,
    seconds: f64,
}

/// Passes between checks of the error, relative to those that were made.
const CHECK_EVERY: f64 = 0.25;

impl FinalOptions {
    pub fn is_wanted(&self) -> bool {
        self.error.is_some() || self.seconds.is_some()
    }

    /// Refuses, before anything is baked, indirect light that final gathering does not estimate.
    pub fn check(&self, indirect: Option<&IndirectSettings>) -> Result<()> {
        let option = if self.error.is_some() { "--final" } else { "--seconds" };
        match indirect {
            _ if !self.is_wanted() => Ok(()),
            None => Err(Error::invalid(option, "with --gi off there is no indirect light to gather")),
            Some(indirect) if indirect.has_all_light() => Ok(()),
            Some(_) => {
                let reason =
                    "gathers glossy light of all bounces: leave out --bounces, --gi diffuse and --method thesis";
                Err(Error::invalid(option, reason))
            }
        }
    }

    /// Refines the relighter's pictures of its rig.
    pub fn refine(&self, session: &Session, relighter: &mut Relighter, seed: u64) -> Result<Refinement> {
        let start = Instant::now();
        let is_late = || self.seconds.is_some_and(|seconds| start.elapsed().as_secs_f64() >= seconds);
        let bar = progress::spinner("final gathering");
        let rig = relighter.rig().clone();
        let mut gather = FinalGather::new(&session.scene, &session.framebuffer, &rig, |_| true, seed, 0);
        let lights: Vec<usize> = gather.lights().collect();
        let beauty: Vec<Vec3> = relighter.linear(Request::default())?.iter().copied().map(Vec3::from).collect();
        let operator: Vec<Vec<Vec3>> = lights.iter().map(|&light| relighter.indirect(light)).collect::<Result<_>>()?;
        let refine = |gather: &FinalGather| {
            let estimates: Vec<Estimate> = (0..lights.len()).map(|source| gather.estimate(source)).collect();
            let of_light = |i: usize| (rig.scale(lights[i]), &operator[i][..], &estimates[i]);
            let of_lights: Vec<_> = (0..lights.len()).map(of_light).collect();
            let refined = Refined::new(session.size().0, &of_lights);
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
            bar.set_message(format!("final gathering: {:.2} %", 100.0 * error));
            if is_late() || lights.is_empty() || !error.is_finite() || self.error.is_some_and(|asked| error <= asked) {
                break (refined, error);
            }
            gather.focus(&refined.errors2);
            next_check = gather.passes() + 1 + (CHECK_EVERY * f64::from(gather.passes())) as u32;
        };
        bar.finish_and_clear();
        let mut changes = LightChanges::default();
        for (&light, change) in lights.iter().zip(&refined.changes) {
            changes.set(relighter.context(), &session.framebuffer, (&rig, light), change, lights.len())?;
        }
        relighter.set_changes(&changes)?;
        let seconds = start.elapsed().as_secs_f64();
        let passes = gather.passes();
        tracing::info!("final gathering: {passes} passes in {seconds:.1} s; expected error {:.2} %", 100.0 * error);
        if self.error.is_some_and(|asked| error > asked) {
            tracing::warn!("after {seconds:.0} s the expected error of a pixel is {:.2} %", 100.0 * error);
        }
        let errors = refined.errors2.iter().map(|error2| error2.sqrt() as f32).collect();
        Ok(Refinement { errors, error, passes, seconds })
    }
}

impl Refinement {
    /// For `--stats`.
    pub fn figures(&self) -> Value {
        json!({ "estimated_error": self.error, "passes": self.passes, "seconds": self.seconds })
    }
}
