//! The text of a rig file, for errors that name a line.

pub struct RigText<'a>(pub &'a str);

/// Range of bytes.
pub type Span = std::ops::Range<usize>;

impl RigText<'_> {
    /// Prefixes `reason` with the line number of `at`.
    pub fn line(&self, at: Span, reason: impl std::fmt::Display) -> String {
        let before = &self.0.as_bytes()[..at.start.min(self.0.len())];
        let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
        format!("line {line}: {reason}")
    }
}
