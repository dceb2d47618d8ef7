//! Items of a file that are ignored, each kind reported once.

use std::path::Path;

/// Number of ignored items of each kind.
#[derive(Default)]
pub struct IgnoredCounts {
    pub points_and_lines: usize,
    pub missing_uvs: usize,
    /// Texture coordinates that are no numbers.
    pub bad_uvs: usize,
    /// Primitives with vertex colours whose material shows its own colour.
    pub unlit_colors: usize,
    pub without_positions: usize,
    /// Nodes and copies of zero scale.
    pub vanished: usize,
}

impl IgnoredCounts {
    pub fn warn(&self, path: &Path) {
        let path = path.display();
        if self.vanished > 0 {
            let objects =
                if self.vanished == 1 { "1 object has".into() } else { format!("{} objects have", self.vanished) };
            tracing::warn!("{path}: {objects} a scale of zero and cannot be seen");
        }
        if self.without_positions > 0 {
            tracing::warn!("{path}: skipped {} primitives without positions", self.without_positions);
        }
        if self.points_and_lines > 0 {
            tracing::warn!("{path}: skipped {} primitives of points or lines", self.points_and_lines);
        }
        if self.missing_uvs > 0 {
            let count = self.missing_uvs;
            tracing::warn!("{path}: {count} primitives lack texture coordinates that their material uses");
        }
        if self.bad_uvs > 0 {
            tracing::warn!("{path}: {} texture coordinates are no numbers and were replaced by 0", self.bad_uvs);
        }
        if self.unlit_colors > 0 {
            let count = self.unlit_colors;
            tracing::warn!("{path}: {count} primitives have unlit materials: their vertex colours are ignored");
        }
    }
}
