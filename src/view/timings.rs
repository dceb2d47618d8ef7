//! What frames took: for the overlay over the last seconds, for reports from the first on.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::PassReport;
use crate::gpu::{PassTime, Site};

/// How far back the overlay looks.
const WINDOW: Duration = Duration::from_secs(5);

#[derive(Default)]
pub struct Timings {
    /// When each frame was shown, and its latency: from its first event to the return of its presentation.
    recent: VecDeque<(Instant, f64)>,
    /// Latencies of all frames that relit the picture, milliseconds.
    relit: Vec<f64>,
    /// Passes of frames that relit the picture: milliseconds of all of them, the last frame last.
    passes: Vec<Pass>,
}

/// One pass in all frames that relit the picture.
struct Pass {
    name: &'static str,
    site: Site,
    /// Of the frame it was last in.
    frame: usize,
    /// When it began there.
    start_ms: f64,
    ms: Vec<f64>,
}

impl Timings {
    /// A frame whose first event came at `event` was shown; `passes` if it relit the picture.
    pub fn frame(&mut self, event: Instant, passes: Option<&[PassTime]>) {
        let now = Instant::now();
        let latency = (now - event).as_secs_f64() * 1e3;
        if let Some(passes) = passes {
            self.relit.push(latency);
            for pass in passes {
                self.pass(pass);
            }
        }
        self.recent.push_back((now, latency));
        while self.recent.front().is_some_and(|(at, _)| now - *at > WINDOW) {
            self.recent.pop_front();
        }
    }

    fn pass(&mut self, time: &PassTime) {
        let frame = self.relit.len();
        match self.passes.iter_mut().find(|pass| (pass.name, pass.site) == (time.name, time.site)) {
            Some(pass) if pass.frame == frame => *pass.ms.last_mut().expect("it was in this frame") += time.ms,
            Some(pass) => {
                (pass.frame, pass.start_ms) = (frame, time.start_ms);
                pass.ms.push(time.ms);
            }
            None => {
                let PassTime { name, site, start_ms, ms } = *time;
                self.passes.push(Pass { name, site, frame, start_ms, ms: vec![ms] });
            }
        }
    }

    /// Passes of the last relit frame in their order, several of one name added.
    pub fn passes(&self) -> impl Iterator<Item = (&'static str, Site, f64)> {
        let mut last: Vec<&Pass> = self.passes.iter().filter(|pass| pass.frame == self.relit.len()).collect();
        last.sort_by(|a, b| a.start_ms.total_cmp(&b.start_ms));
        last.into_iter().map(|pass| (pass.name, pass.site, *pass.ms.last().expect("none is empty")))
    }

    /// What passes took in the frames that had them.
    pub fn median_passes(&self) -> Vec<PassReport> {
        let report = |pass: &Pass| {
            let [median_ms] = quantiles(&mut pass.ms.clone(), [0.5]).expect("none is empty");
            PassReport { name: pass.name, on: pass.site, median_ms }
        };
        self.passes.iter().map(report).collect()
    }

    /// Median and 95th percentile of latency over the last seconds, milliseconds.
    pub fn recent(&self) -> Option<[f64; 2]> {
        let mut latencies: Vec<f64> = self.recent.iter().map(|(_, ms)| *ms).collect();
        quantiles(&mut latencies, [0.5, 0.95])
    }

    /// Latency of the last frame, milliseconds.
    pub fn last(&self) -> Option<f64> {
        self.recent.back().map(|(_, ms)| *ms)
    }

    /// Of all frames that relit the picture: their number; best, median and 95th percentile of latency.
    pub fn relit(&self) -> (usize, Option<[f64; 3]>) {
        (self.relit.len(), quantiles(&mut self.relit.clone(), [0.0, 0.5, 0.95]))
    }
}

/// Nearest ranks; `None` of nothing.
fn quantiles<const N: usize>(values: &mut [f64], shares: [f64; N]) -> Option<[f64; N]> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(shares.map(|share| values[(share * last as f64).round() as usize]))
}
