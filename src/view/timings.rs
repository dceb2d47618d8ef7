//! Frame times: of the last seconds for the overlay, of all frames for reports.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::PassReport;
use crate::gpu::{PassTime, Processor};

/// Number of frames in the graph.
const GRAPH_FRAMES: usize = 240;
/// Time span of the overlay's statistics.
const WINDOW: Duration = Duration::from_secs(5);

/// Times of frames and their passes.
#[derive(Default)]
pub struct Timings {
    /// When each frame was shown, and its latency: milliseconds from its first event to the return of its presentation.
    recent: VecDeque<(Instant, f64)>,
    /// Latencies of all frames that relit the picture, milliseconds.
    relit: Vec<f64>,
    /// Passes of frames that relit the picture.
    passes: Vec<Pass>,
    coarse_frames: usize,
    /// The last frames that relit the picture.
    graph: VecDeque<GraphFrame>,
}

/// One frame that relit the picture.
#[derive(Default)]
pub struct GraphFrame {
    pub latency_ms: f64,
    /// Index in [`Timings::names`], and milliseconds; passes of one name are summed.
    pub passes: Vec<(usize, f64)>,
    /// Whether the picture is coarse.
    pub coarse: bool,
}

/// Statistics of a time, milliseconds.
#[derive(Clone, Copy)]
pub struct Spread {
    pub median: f64,
    pub p95: f64,
    pub max: f64,
}

/// One pass in all frames that relit the picture.
struct Pass {
    name: &'static str,
    processor: Processor,
    /// Number of the last relit frame that has the pass.
    frame: usize,
    /// Start of the pass in that frame.
    start_ms: f64,
    /// Milliseconds in each frame that has the pass.
    ms: Vec<f64>,
}

impl Timings {
    /// Records a frame that was shown, and whose first event came at `event`; `passes` is given if it relit the
    /// picture.
    pub fn frame(&mut self, event: Instant, passes: Option<&[PassTime]>, coarse: bool) {
        let now = Instant::now();
        let latency = (now - event).as_secs_f64() * 1e3;
        if let Some(passes) = passes {
            self.relit.push(latency);
            self.coarse_frames += usize::from(coarse);
            // The list of the oldest frame is reused.
            let oldest = if self.graph.len() == GRAPH_FRAMES { self.graph.pop_front() } else { None };
            let mut of_graph = GraphFrame { latency_ms: latency, coarse, ..oldest.unwrap_or_default() };
            of_graph.passes.clear();
            for pass in passes {
                let index = self.pass(pass);
                match of_graph.passes.iter_mut().find(|(i, _)| *i == index) {
                    Some((_, ms)) => *ms += pass.ms,
                    None => of_graph.passes.push((index, pass.ms)),
                }
            }
            self.graph.push_back(of_graph);
        }
        self.recent.push_back((now, latency));
        while self.recent.front().is_some_and(|(at, _)| now - *at > WINDOW) {
            self.recent.pop_front();
        }
    }

    /// Records a pass; returns its index.
    fn pass(&mut self, time: &PassTime) -> usize {
        let frame = self.relit.len();
        let found = self.passes.iter().position(|pass| (pass.name, pass.processor) == (time.name, time.processor));
        let index = found.unwrap_or(self.passes.len());
        match self.passes.get_mut(index) {
            Some(pass) if pass.frame == frame => *pass.ms.last_mut().expect("it was in this frame") += time.ms,
            Some(pass) => {
                (pass.frame, pass.start_ms) = (frame, time.start_ms);
                pass.ms.push(time.ms);
            }
            None => {
                let PassTime { name, processor, start_ms, ms } = *time;
                self.passes.push(Pass { name, processor, frame, start_ms, ms: vec![ms] });
            }
        }
        index
    }

    /// Returns the number of relit frames that were coarse.
    pub fn coarse_frames(&self) -> usize {
        self.coarse_frames
    }

    /// Returns the frames of the graph, oldest first; at most [`Self::capacity`].
    pub fn frames(&self) -> impl Iterator<Item = &GraphFrame> {
        self.graph.iter()
    }

    pub fn capacity(&self) -> usize {
        GRAPH_FRAMES
    }

    /// Returns name and processor of all passes so far.
    pub fn names(&self) -> impl Iterator<Item = (&'static str, Processor)> {
        self.passes.iter().map(|pass| (pass.name, pass.processor))
    }

    /// Returns statistics of one pass over the frames of the graph that have it.
    pub fn pass_spread(&self, index: usize) -> Option<Spread> {
        let of_pass = |frame: &GraphFrame| frame.passes.iter().find(|(i, _)| *i == index).map(|(_, ms)| *ms);
        Spread::new(self.graph.iter().filter_map(of_pass).collect())
    }

    /// Returns statistics of the latency over the frames of the graph.
    pub fn latency_spread(&self) -> Option<Spread> {
        Spread::new(self.graph.iter().map(|frame| frame.latency_ms).collect())
    }

    /// Returns the passes of the last relit frame in order of execution; passes of one name are summed.
    pub fn passes(&self) -> impl Iterator<Item = (&'static str, Processor, f64)> {
        let mut last: Vec<&Pass> = self.passes.iter().filter(|pass| pass.frame == self.relit.len()).collect();
        last.sort_by(|a, b| a.start_ms.total_cmp(&b.start_ms));
        last.into_iter().map(|pass| (pass.name, pass.processor, *pass.ms.last().expect("none is empty")))
    }

    /// Returns the median time of each pass over the frames that have it.
    pub fn median_passes(&self) -> Vec<PassReport> {
        let report = |pass: &Pass| {
            let [median_ms] = quantiles(&mut pass.ms.clone(), [0.5]).expect("none is empty");
            PassReport { name: pass.name, on: pass.processor, median_ms }
        };
        self.passes.iter().map(report).collect()
    }

    /// Returns median and 95th percentile of the latency over the last seconds, milliseconds.
    pub fn recent(&self) -> Option<[f64; 2]> {
        let mut latencies: Vec<f64> = self.recent.iter().map(|(_, ms)| *ms).collect();
        quantiles(&mut latencies, [0.5, 0.95])
    }

    /// Returns the latency of the last frame, milliseconds.
    pub fn last(&self) -> Option<f64> {
        self.recent.back().map(|(_, ms)| *ms)
    }

    /// Returns the number of relit frames, and best, median and 95th percentile of their latency, milliseconds.
    pub fn relit(&self) -> (usize, Option<[f64; 3]>) {
        (self.relit.len(), quantiles(&mut self.relit.clone(), [0.0, 0.5, 0.95]))
    }
}

impl Spread {
    /// Returns `None` without values.
    fn new(mut values: Vec<f64>) -> Option<Self> {
        quantiles(&mut values, [0.5, 0.95, 1.0]).map(|[median, p95, max]| Self { median, p95, max })
    }
}

/// Returns quantiles by nearest rank, `None` without values. Sorts `values`.
fn quantiles<const N: usize>(values: &mut [f64], shares: [f64; N]) -> Option<[f64; N]> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(shares.map(|share| values[(share * last as f64).round() as usize]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_graph_keeps_the_last_frames_and_adds_passes_of_one_name() {
        let mut timings = Timings::default();
        let time = |name, start_ms, ms| PassTime { name, processor: Processor::Gpu, start_ms, ms };
        for frame in 0..GRAPH_FRAMES + 10 {
            let passes = [time("shade", 0.0, frame as f64), time("shade", 1.0, 1.0), time("sum", 2.0, 0.5)];
            timings.frame(Instant::now(), Some(&passes), frame % 2 == 1);
        }
        timings.frame(Instant::now(), None, false); // nothing was relit
        assert_eq!(timings.frames().count(), timings.capacity());
        let first = timings.frames().next().unwrap();
        assert_eq!((first.passes.as_slice(), first.coarse), (&[(0, 11.0), (1, 0.5)][..], false));
        let spread = timings.pass_spread(0).unwrap();
        assert_eq!((spread.max, spread.median), (250.0, 131.0));
        assert!(spread.p95 > 235.0 && spread.p95 < 240.0, "{}", spread.p95);
        assert!(timings.pass_spread(2).is_none());
    }
}
