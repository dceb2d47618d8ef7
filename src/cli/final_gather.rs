//! `relume render --final ERROR` and `--seconds S`: indirect light gathered anew for known lights, better with time.

use std::time::Instant;

use glam::Vec3;
use relume::final_gather::{Combination, FinalGather};
use relume::image::luminance;
use relume::relight::{Layers, Picture, Relighter, Request};
use relume::scene::{Emitters, LightKind, Rig};
use relume::session::{IndirectSettings, Session};
use relume::{Error, Result};
use serde_json::{Value, json};

use super::options::parse_seconds;
use super::progress;

#[derive(clap::Args)]
pub struct FinalOptions {
    /// Gathers indirect light anew for the lights of the rig, until the expected error of a pixel, relative to the mean of
    /// the picture, is at most this: a fraction, or percent with %.
    #[arg(id = "final", long, value_name = "ERROR", value_parser = parse_error)]
    error: Option<f64>,
    /// The same for this time in seconds; with --final, for at most so long. It takes two passes at least.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
}

fn parse_error(text: &str) -> Result<f64, String> {
    let (number, scale) = text.strip_suffix('%').map_or((text, 1.0), |number| (number, 0.01));
    let error = number.trim().parse::<f64>().ok().map(|error| error * scale);
    error
        .filter(|error| *error > 0.0 && *error < 1.0)
        .ok_or("expected an error like 0.01 or 1%: more than 0, less than 1".into())
}

/// What final gathering makes of the pictures of a rig.
pub struct Refinement {
    /// By light of the rig: what is added to its picture.
    changes: Vec<Option<Vec<Vec3>>>,
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
            Some(IndirectSettings::Robust { bounces: None, .. }) => Ok(()),
            Some(_) => Err(Error::invalid(option, "gathers all bounces: leave out --bounces and --method thesis")),
        }
    }

    /// Refines the picture of the relighter's rig.
    pub fn refine(&self, session: &Session, relighter: &mut Relighter, seed: u64) -> Result<Refinement> {
        let start = Instant::now();
        let is_late = || self.seconds.is_some_and(|seconds| start.elapsed().as_secs_f64() >= seconds);
        let bar = progress::spinner("final gathering");
        let rig = relighter.rig().clone();
        let mut gather = FinalGather::new(&session.scene, &session.framebuffer, &rig, seed);
        let lights: Vec<usize> = gather.lights().collect();
        let beauty = vectors(relighter.linear(Request::default())?);
        // Of each light, its indirect light by the operator.
        let operator: Vec<Vec<Vec3>> =
            lights.iter().map(|&light| indirect(session, relighter, &rig, light)).collect::<Result<_>>()?;
        let halves = |gather: &FinalGather, i: usize| {
            let scale = rig.scale(lights[i]);
            [0, 1].map(|half| gather.image(half, i).into_iter().map(|pixel| pixel * scale).collect::<Vec<_>>())
        };
        let combine = |gather: &FinalGather| {
            let [mut biased, mut a, mut b] = [(); 3].map(|()| vec![Vec3::ZERO; beauty.len()]);
            for (i, of_light) in operator.iter().enumerate() {
                let halves = halves(gather, i);
                add(&mut biased, of_light);
                add(&mut a, &halves[0]);
                add(&mut b, &halves[1]);
            }
            let combination = Combination::new(session.size().0, &biased, [&a, &b]);
            let errors2 = combination.errors2();
            let square = errors2.iter().copied().map(f64::from).sum::<f64>() / errors2.len() as f64;
            let changed = beauty.iter().zip(biased.iter().zip(a.iter().zip(&b)));
            let refined = changed.map(|(beauty, (biased, (a, b)))| *beauty - *biased + (*a + *b) * 0.5);
            let sum: f64 = refined.map(|pixel| f64::from(luminance(pixel.to_array()))).sum();
            let mean = sum / beauty.len() as f64;
            (combination, if square > 0.0 { square.sqrt() / mean.abs() } else { 0.0 })
        };
        let mut next_check = 2;
        let (combination, error) = loop {
            gather.pass(&is_late);
            let may_end = is_late() || lights.is_empty() || self.error.is_some() && gather.passes() >= next_check;
            if gather.passes() < 2 || !may_end {
                continue;
            }
            let (combination, error) = combine(&gather);
            bar.set_message(format!("final gathering: {:.2} %", 100.0 * error));
            if is_late() || lights.is_empty() || !error.is_finite() || self.error.is_some_and(|asked| error <= asked) {
                break (combination, error);
            }
            next_check = gather.passes() + 1 + (CHECK_EVERY * f64::from(gather.passes())) as u32;
        };
        bar.finish_and_clear();
        let mut changes = vec![None; rig.lights.len()];
        for (i, &light) in lights.iter().enumerate() {
            let [a, b] = halves(&gather, i);
            changes[light] = Some(combination.change(&operator[i], [&a, &b]));
        }
        let seconds = start.elapsed().as_secs_f64();
        let refinement = Refinement { changes, error, passes: gather.passes(), seconds };
        let Refinement { passes, .. } = refinement;
        tracing::info!("final gathering: {passes} passes in {seconds:.1} s; expected error {:.2} %", 100.0 * error);
        if self.error.is_some_and(|asked| error > asked) {
            tracing::warn!("after {seconds:.0} s the expected error of a pixel is {:.2} %", 100.0 * error);
        }
        Ok(refinement)
    }
}

impl Refinement {
    /// Adds the changes of the lights that are `meant` to a picture.
    pub fn add_to(&self, pixels: &mut [[f32; 3]], meant: impl Fn(usize) -> bool) {
        for (_, change) in self.changes.iter().enumerate().filter(|(light, _)| meant(*light)) {
            let changes = pixels.iter_mut().zip(change.iter().flatten());
            changes.for_each(|(pixel, change)| *pixel = (Vec3::from(*pixel) + *change).to_array());
        }
    }

    /// For `--stats`.
    pub fn figures(&self) -> Value {
        json!({ "expected_error": self.error, "passes": self.passes, "seconds": self.seconds })
    }
}

/// Indirect light of a light by the operator.
fn indirect(session: &Session, relighter: &mut Relighter, rig: &Rig, light: usize) -> Result<Vec<Vec3>> {
    let picture = Picture::Light(light);
    let mut all = vectors(relighter.linear(picture)?);
    let rest = match rig.lights[light].kind {
        LightKind::Emitter => emission(session, rig, light),
        _ => vectors(relighter.linear(Request { picture, layers: Layers::FirstHand, ..Request::default() })?),
    };
    all.iter_mut().zip(rest).for_each(|(all, rest)| *all -= rest);
    Ok(all)
}

/// What pixels see of an emitter.
fn emission(session: &Session, rig: &Rig, light: usize) -> Vec<Vec3> {
    let names = Emitters::of(&session.scene).names;
    let (width, height) = session.size();
    let mut image = vec![Vec3::ZERO; width * height];
    for part in &session.framebuffer.emission {
        if rig.lights[light].material.as_ref() == Some(&names[part.emitter as usize]) {
            let (x, y) = session.framebuffer.tiling.pixel(part.pixel as usize);
            image[y as usize * width + x as usize] += part.radiance * rig.scale(light);
        }
    }
    image
}

fn vectors(pixels: &[[f32; 3]]) -> Vec<Vec3> {
    pixels.iter().copied().map(Vec3::from).collect()
}

fn add(sum: &mut [Vec3], image: &[Vec3]) {
    sum.iter_mut().zip(image).for_each(|(sum, value)| *sum += *value);
}
