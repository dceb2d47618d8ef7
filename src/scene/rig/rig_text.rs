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

    /// The line in which `at` begins.
    pub fn source_line(&self, at: Span) -> &str {
        let at = self.0.floor_char_boundary(at.start);
        let begin = self.0[..at].rfind('\n').map_or(0, |before| before + 1);
        self.0[begin..].lines().next().unwrap_or_default().trim()
    }
}
