//! `relume render --final ERROR` and `--seconds S`: indirect light gathered anew for known lights, better with time.

use relume::relight::Relighter;
use relume::session::{IndirectSettings, Refinement, Session, Until};
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
            Some(indirect) if indirect.has_all_bounces() => Ok(()),
            Some(_) => Err(Error::invalid(option, "gathers all bounces: leave out --bounces and --method thesis")),
        }
    }

    /// Refines the relighter's pictures of its rig.
    pub fn refine(&self, session: &Session, relighter: &mut Relighter, seed: u64) -> Result<Refinement> {
        let bar = progress::spinner("final gathering");
        let tell = |error: f64| bar.set_message(format!("final gathering: {:.2} %", 100.0 * error));
        let until = Until { error: self.error, seconds: self.seconds };
        let refinement = session.refine(relighter, until, seed, tell)?;
        bar.finish_and_clear();
        let Refinement { error, passes, seconds, .. } = refinement;
        tracing::info!("final gathering: {passes} passes in {seconds:.1} s; expected error {:.2} %", 100.0 * error);
        if self.error.is_some_and(|asked| error > asked) {
            tracing::warn!("after {seconds:.0} s the expected error of a pixel is {:.2} %", 100.0 * error);
        }
        Ok(refinement)
    }
}

/// For `--stats`.
pub fn figures(refinement: &Refinement) -> Value {
    json!({ "estimated_error": refinement.error, "passes": refinement.passes, "seconds": refinement.seconds })
}
