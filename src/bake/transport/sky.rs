//! Light of the sky: its [cells](sky_cells) send light as gather samples do, with one coefficient each, the mean
//! radiance.
//!
//! ```text
//! light of a sky e = (D + Φ_c (I - G_cc)⁻¹ G_cs) e
//! ```
//!
//! D is what view samples receive from the sky, G_cs what gather samples of the coarse level do, or those of the only
//! level. Both have two columns for each cell: one for rays that leave the scene straight, and one for those that left
//! it by mirrors.

use std::sync::LazyLock;

use super::paths::Escape;
use crate::physics::sky_cells;

/// Number of columns: straight rays first.
pub const COLUMNS: usize = 2 * sky_cells::COUNT;

/// Each column is one coefficient.
pub static FIRST: LazyLock<Vec<u32>> = LazyLock::new(|| (0..=COLUMNS as u32).collect());

/// The column of a ray that leaves the scene.
pub fn column(escape: &Escape) -> usize {
    sky_cells::index(escape.direction) + if escape.by_mirrors { sky_cells::COUNT } else { 0 }
}
