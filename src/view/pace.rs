//! How closely pictures are made while a hand drags, and what becomes of them when it rests.

use std::time::{Duration, Instant};

use crate::relight::Detail;

/// Keeps frames within their budget: a light whose exact picture takes longer is shaded coarsely while it is dragged, and
/// exactly once nothing has happened for a while.
pub struct Pace {
    budget: Duration,
    /// How long the last exact frame took that shaded lights.
    exact: Option<Duration>,
    /// When the last edit was shown.
    edited: Option<Instant>,
}

/// Edits that follow each other no later than this are one drag: keys repeat within a tenth of a second.
const REST: Duration = Duration::from_millis(180);

impl Pace {
    /// A budget of zero never makes anything coarse.
    pub fn new(budget: Duration) -> Self {
        Self { budget, exact: None, edited: None }
    }

    /// How closely an edit at `now` is to be shown.
    pub fn detail(&self, now: Instant) -> Detail {
        let dragging = self.edited.is_some_and(|edited| now - edited < REST);
        let slow = self.exact.is_some_and(|exact| exact > self.budget);
        if dragging && slow && !self.budget.is_zero() { Detail::Coarse } else { Detail::Exact }
    }

    /// A frame that shaded lights was shown, after an edit or to finish one; it took so long.
    pub fn shown(&mut self, now: Instant, edited: bool, detail: Detail, took: Duration) {
        if edited {
            self.edited = Some(now);
        }
        if detail == Detail::Exact {
            self.exact = Some(took);
        }
    }

    /// When a coarse picture is to be finished.
    pub fn rests_at(&self) -> Option<Instant> {
        Some(self.edited? + REST)
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
        let mut pace = Pace::new(ms(33));
        let start = Instant::now();
        assert_eq!(pace.detail(start), Detail::Exact, "nobody knows yet how long it takes");
        pace.shown(start + ms(80), true, Detail::Exact, ms(80));
        assert_eq!(pace.detail(start + ms(90)), Detail::Coarse);
        pace.shown(start + ms(120), true, Detail::Coarse, ms(25));
        assert_eq!(pace.detail(start + ms(125)), Detail::Coarse, "the exact picture is no faster for that");
        assert_eq!(pace.rests_at(), Some(start + ms(300)));
        assert_eq!(pace.detail(start + ms(300)), Detail::Exact);
        pace.shown(start + ms(390), false, Detail::Exact, ms(85));
        assert_eq!(pace.detail(start + ms(400)), Detail::Exact, "to finish a picture is no edit");
    }

    #[test]
    fn fast_drags_and_no_budget_stay_exact() {
        for (budget, took) in [(33, 20), (0, 500)] {
            let mut pace = Pace::new(ms(budget));
            let start = Instant::now();
            pace.shown(start, true, Detail::Exact, ms(took));
            assert_eq!(pace.detail(start + ms(10)), Detail::Exact);
        }
    }
}
