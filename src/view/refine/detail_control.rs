//! Level of detail of pictures during a drag and at rest.

use std::time::{Duration, Instant};

use crate::gpu::PassTime;
use crate::relight::Detail;

/// Keeps frames within a time budget: if an exact frame exceeds it, lights are shaded coarsely during a drag and
/// exactly at rest. Thousands of lights, and points of area lights, are shaded over several frames, so that the
/// window answers meanwhile.
pub struct DetailControl {
    budget: Duration,
    /// See [`DetailControl::most_points`].
    most_points: f64,
    /// Duration of the last exact frame that shaded lights.
    exact: Option<Duration>,
    /// Time at which the last edit was shown.
    edited: Option<Instant>,
}

/// Edits at shorter intervals are one drag; keys repeat within 0.1 s.
const DRAG_INTERVAL: Duration = Duration::from_millis(180);
/// Time in which a frame shades lights outside of the focus, milliseconds.
const REST_MS: f64 = 100.0;
/// Points times pixels that the first such frame shades. A processor takes about that time for them.
const FIRST_PIXELS: f64 = (1 << 21) as f64;

impl DetailControl {
    /// A budget of zero disables coarse pictures. `size`: of the picture, pixels.
    pub fn new(budget: Duration, size: [u32; 2]) -> Self {
        let most_points = FIRST_PIXELS / (f64::from(size[0]) * f64::from(size[1]));
        Self { budget, most_points, exact: None, edited: None }
    }

    /// Returns how many points of lights a frame may shade; see [`Request::most_points`](crate::relight::Request).
    pub fn most_points(&self) -> usize {
        self.most_points.max(1.0) as usize
    }

    /// Records the passes of a frame, and how many points of lights outside of the focus it shaded.
    pub fn shaded(&mut self, points: usize, passes: &[PassTime]) {
        if points == 0 {
            return;
        }
        let composite = passes.iter().find(|pass| pass.name == "composite").map(|pass| pass.start_ms);
        let ends = passes.iter().map(|pass| pass.start_ms + pass.ms);
        let fitting = points as f64 * REST_MS / composite.unwrap_or_else(|| ends.fold(0.0, f64::max)).max(1.0);
        self.most_points = fitting.clamp(0.25 * self.most_points, 4.0 * self.most_points).clamp(1.0, 1e6);
    }

    /// Returns the level of detail for an edit at `now`.
    pub fn detail(&self, now: Instant) -> Detail {
        let dragging = self.edited.is_some_and(|edited| now - edited < DRAG_INTERVAL);
        let slow = self.exact.is_some_and(|exact| exact > self.budget);
        if dragging && slow && !self.budget.is_zero() { Detail::Coarse } else { Detail::Progressive }
    }

    /// Records a frame that shaded lights, after an edit or to complete a coarse picture, and its duration `took`.
    pub fn shown(&mut self, now: Instant, edited: bool, detail: Detail, took: Duration) {
        if edited {
            self.edited = Some(now);
        }
        if detail != Detail::Coarse {
            self.exact = Some(took);
        }
    }

    /// Returns when a coarse picture is to be completed.
    pub fn exact_due_at(&self) -> Option<Instant> {
        Some(self.edited? + DRAG_INTERVAL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::Processor;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn slow_drags_are_coarse_from_their_second_frame_and_rest_finishes_them() {
        let mut control = DetailControl::new(ms(33), [64, 64]);
        let start = Instant::now();
        assert_eq!(control.detail(start), Detail::Progressive, "its duration is not known yet");
        control.shown(start + ms(80), true, Detail::Progressive, ms(80));
        assert_eq!(control.detail(start + ms(90)), Detail::Coarse);
        control.shown(start + ms(120), true, Detail::Coarse, ms(25));
        assert_eq!(control.detail(start + ms(125)), Detail::Coarse, "the exact picture is still slow");
        assert_eq!(control.exact_due_at(), Some(start + ms(300)));
        assert_eq!(control.detail(start + ms(300)), Detail::Progressive);
        control.shown(start + ms(390), false, Detail::Progressive, ms(85));
        assert_eq!(control.detail(start + ms(400)), Detail::Progressive, "completing a picture is not an edit");
    }

    #[test]
    fn frames_shade_as_many_points_as_their_time_allows() {
        let mut control = DetailControl::new(ms(33), [3840, 2160]);
        assert_eq!(control.most_points(), 1);
        let pass = |name, start_ms, ms| PassTime { name, processor: Processor::Gpu, start_ms, ms };
        for _ in 0..20 {
            let points = control.most_points();
            let took = 2.0 * points as f64;
            control.shaded(points, &[pass("shade light", 0.0, took), pass("composite", took, 900.0)]);
        }
        let before = control.most_points();
        control.shaded(0, &[pass("composite", 0.0, 900.0)]);
        assert_eq!(control.most_points(), before, "a frame that shades nothing tells nothing");
        assert!((48..53).contains(&before), "{before} points of 2 ms");
    }

    #[test]
    fn fast_drags_and_no_budget_stay_exact() {
        for (budget, took) in [(33, 20), (0, 500)] {
            let mut control = DetailControl::new(ms(budget), [64, 64]);
            let start = Instant::now();
            control.shown(start, true, Detail::Progressive, ms(took));
            assert_eq!(control.detail(start + ms(10)), Detail::Progressive);
        }
    }
}
