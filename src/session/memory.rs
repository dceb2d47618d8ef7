//! What does not fit this machine is refused before any work is done.

use std::path::Path;

use crate::error::{Error, Result};
use crate::relight::light_cache::LightCache;
use crate::scene::memory::available_bytes;

/// Bytes that a sample takes at the least: view sample, normal and packet, twice while they are collected; the samples
/// and nine lights' visibility on the device; two pictures.
const BYTES_A_SAMPLE: u64 = 2 * (32 + 12 + 36) + 32 + 9 + 16;
/// Share of the pixels that get several samples: 0.04 in the shipped scenes.
const SHARE_OF_EDGES: f64 = 0.04;

/// Refuses a picture that cannot fit this machine, before the system does so less kindly.
pub(super) fn check_memory(
    size: [u32; 2],
    samples: u32,
    forced_layers: u32,
    light_count: usize,
    path: &Path,
) -> Result<()> {
    let samples_a_pixel = 1.0 + SHARE_OF_EDGES * f64::from(samples - 1) + f64::from(forced_layers);
    // The fewest light images that work and their rest; each light's visibility while its shadow edges are looked for.
    let images = LightCache::slot_range(light_count).0 + 1;
    let edges = if samples > 1 { light_count } else { 0 };
    let bytes = BYTES_A_SAMPLE as f64 * samples_a_pixel + (12 * images + edges) as f64;
    let remedy = if samples > 1 { "choose a smaller --size or a smaller --samples" } else { "choose a smaller --size" };
    check_fits(size, f64::from(size[0]) * f64::from(size[1]) * bytes, remedy, path)
}

/// Refuses a picture that takes more bytes than are free.
pub fn check_fits(size: [u32; 2], bytes: f64, remedy: &str, path: &Path) -> Result<()> {
    let [width, height] = size;
    check_free(bytes, &format!("{width}x{height} pixels take"), remedy, path)
}

/// Refuses what takes more bytes than are free.
pub fn check_free(bytes: f64, what: &str, remedy: &str, path: &Path) -> Result<()> {
    let Some(free) = available_bytes() else { return Ok(()) };
    let (needed, free) = (bytes * 1e-9, free as f64 * 1e-9);
    if needed <= free {
        return Ok(());
    }
    let reason = format!("{what} {needed:.1} GB of memory, but {free:.1} GB are free; {remedy}");
    Err(Error::invalid(path.display().to_string(), reason))
}
