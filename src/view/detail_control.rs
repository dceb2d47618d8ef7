//! Level of detail of pictures during a drag and at rest.

use std::time::{Duration, Instant};

use crate::relight::Detail;

/// Keeps frames within a time budget: if an exact frame exceeds it, lights are shaded coarsely during a drag and
/// exactly at rest.
pub struct DetailControl {
    budget: Duration,
    /// Duration of the last exact frame that shaded lights.
    exact: Option<Duration>,
    /// Time at which the last edit was shown.
    edited: Option<Instant>,
}

/// Edits at shorter intervals are one drag; keys repeat within 0.1 s.
const DRAG_INTERVAL: Duration = Duration::from_millis(180);

impl DetailControl {
    /// A budget of zero disables coarse pictures.
    pub fn new(budget: Duration) -> Self {
        Self { budget, exact: None, edited: None }
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

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn slow_drags_are_coarse_from_their_second_frame_and_rest_finishes_them() {
        let mut control = DetailControl::new(ms(33));
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
    fn fast_drags_and_no_budget_stay_exact() {
        for (budget, took) in [(33, 20), (0, 500)] {
            let mut control = DetailControl::new(ms(budget));
            let start = Instant::now();
            control.shown(start, true, Detail::Progressive, ms(took));
            assert_eq!(control.detail(start + ms(10)), Detail::Progressive);
        }
    }
}
