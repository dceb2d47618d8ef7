//! View samples clustered by position and normal: superclusters of tiles.

use std::ops::Range;

use glam::Vec3;

use crate::bake::DeepFramebuffer;
use crate::physics::octahedral;
use crate::shared::ViewSample;
use crate::trace::point_tree::{Point, point};

/// Minimum and maximum number of view samples of a tile, which share one small basis; always a multiple of the minimum.
const TILE: [usize; 2] = [64, 256];
/// Maximum number of tiles of a supercluster, which share one projection of light; small pictures have fewer.
const SUPERCLUSTER: usize = 16;
/// Number of tiles of a picture, if the tile size permits: images of a tile are similar because it is a small part of
/// the scene, regardless of its number of pixels.
const TILES: usize = 1024;

/// View samples that reflect light, tile by tile; all tiles except the last are full.
pub struct Clusters {
    /// Indices into [`DeepFramebuffer::samples`](crate::bake::DeepFramebuffer::samples).
    pub samples: Vec<u32>,
    /// View samples per tile.
    tile: usize,
    /// Tiles per supercluster.
    supercluster: usize,
}

impl Clusters {
    pub fn new(framebuffer: &DeepFramebuffer) -> Self {
        let (samples, lit) = (&framebuffer.samples, framebuffer.reflecting());
        let tile = (lit.len() / TILES).next_multiple_of(TILE[0]).clamp(TILE[0], TILE[1]);
        let length = normal_length(samples, &lit, tile);
        let mut items: Vec<(Point, u32)> = lit
            .into_iter()
            .map(|i| {
                let sample = &samples[i as usize];
                (point(sample.position, octahedral::decode(sample.normal), length), i)
            })
            .collect();
        let supercluster = (items.len() / tile / SUPERCLUSTER).clamp(1, SUPERCLUSTER);
        split(&mut items, tile, supercluster);
        Self { samples: items.into_iter().map(|(_, i)| i).collect(), tile, supercluster }
    }

    /// The range of tiles of each supercluster.
    pub fn superclusters(&self) -> impl Iterator<Item = Range<usize>> {
        let tiles = self.samples.len().div_ceil(self.tile);
        (0..tiles).step_by(self.supercluster).map(move |first| first..(first + self.supercluster).min(tiles))
    }

    /// Range in `samples` of the rows of a range of tiles.
    pub fn rows(&self, tiles: &Range<usize>) -> Range<usize> {
        tiles.start * self.tile..(tiles.end * self.tile).min(self.samples.len())
    }
}

/// Length of normals in [`point`]: twice the width of a tile, if tiles were spread evenly over the faces of the bounds.
fn normal_length(samples: &[ViewSample], lit: &[u32], tile: usize) -> f32 {
    let positions = || lit.iter().map(|&i| samples[i as usize].position);
    let size = positions().fold(Vec3::NEG_INFINITY, Vec3::max) - positions().fold(Vec3::INFINITY, Vec3::min);
    let area = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
    let tiles = lit.len().div_ceil(tile).max(1);
    if area.is_finite() { 2.0 * (area / tiles as f32).sqrt() } else { 0.0 }
}

/// Orders items so that tiles and superclusters are compact. Splits at the middle of the longest side of their bounds,
/// at a multiple of the supercluster size while there are several superclusters, then at a multiple of the tile size.
fn split(items: &mut [(Point, u32)], tile: usize, supercluster: usize) {
    let unit = if items.len() > tile * supercluster { tile * supercluster } else { tile };
    let units = items.len().div_ceil(unit);
    if units < 2 {
        items.sort_unstable_by_key(|item| item.1);
        return;
    }
    let (mut low, mut high) = ([f32::INFINITY; 6], [f32::NEG_INFINITY; 6]);
    for (point, _) in items.iter() {
        for axis in 0..6 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    let longer = |a: usize, b: usize| if high[b] - low[b] > high[a] - low[a] { b } else { a };
    let axis = (1..6).fold(0, longer);
    let half = units / 2 * unit;
    items.select_nth_unstable_by(half, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (left, right) = items.split_at_mut(half);
    rayon::join(|| split(left, tile, supercluster), || split(right, tile, supercluster));
}
