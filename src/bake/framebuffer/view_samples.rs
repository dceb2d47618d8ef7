//! The layered deep framebuffer [Yang 2007, Tables 3.1 and 3.2], ray-cast, as a compact list of view samples.
//!
//! Layer 1 stores one sample per pixel, tile by tile. Deeper layers, and further samples of pixels on edges, are extra
//! samples: they exist only where a mirror, an edge or a surface behind a blending one is visible. The order is layer,
//! then pixel, so that neighbours in memory are neighbours in the scene.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::{BakeSettings, DeepFramebuffer, EmittedPixel};
use crate::physics::{brdf, octahedral};
use crate::scene::{AlphaMode, Camera, Emitters, Projection};
use crate::shared::{Brdf, ExtraPixel, ExtraSample, NO_BRDF, TILE_SIZE, ViewSample};
use crate::trace::bvh::{Hit, TracedScene, coverage, passes_by_chance};
use crate::trace::packet::{PACKET_SIZE, SamplePacket};
use crate::trace::surface::SurfacePoint;

/// An eye path ends below this share of a pixel: half of an 8-bit step at a thousandfold exposure.
const MIN_WEIGHT: f32 = 1e-6;

/// Surfaces that blend, and what is behind them, get separate samples without noise: up to this number of surfaces per
/// path, and down to a weight of [`MIN_WEIGHT_BEHIND`]. Beyond that one surface is chosen at random, as for all other
/// rays.
const MAX_BLENDS: u32 = 16;
/// See [`MAX_BLENDS`]: one 8-bit step.
const MIN_WEIGHT_BEHIND: f32 = 1.0 / 256.0;
/// Limit like [`MAX_BLENDS`], counting also surfaces whose coverage is 0 at the hit.
const MAX_STEPS: u32 = 256;

/// One surface along an eye path through mirrors and blending surfaces; mesh space.
#[derive(Clone, Copy)]
pub struct PathVertex {
    pub point: SurfacePoint,
    /// Unit, towards the previous vertex: the eye or a mirror.
    pub wo: Vec3,
    /// Product of BRDFs and cosines along the path up to here, of the transmittance of surfaces before it, and of its
    /// own coverage.
    pub weight: Vec3,
    /// Number of mirrors before it.
    pub layer: u32,
}

/// A straight part of an eye path between two surfaces, where a light can be seen; mesh space.
#[derive(Clone, Copy)]
pub struct PathSegment {
    pub origin: Vec3,
    /// Unit.
    pub direction: Vec3,
    /// Distances from the origin at which it begins and ends. The eye may lie before the origin.
    pub range: [f32; 2],
    /// Like [`PathVertex::weight`], of what is seen here.
    pub weight: Vec3,
    /// Number of mirrors before it.
    pub layer: u32,
    /// Triangle of the mirror at its origin; `None` if the eye sees it directly.
    pub mirror: Option<u32>,
}

/// What [`EyeRays::follow`] visits, in order along the path.
pub enum PathPart {
    Segment(PathSegment),
    Vertex(PathVertex),
}

/// A ray of an eye path.
#[derive(Clone, Copy)]
struct Segment {
    origin: Vec3,
    direction: Vec3,
    /// The blending triangle that the path passed last, and the distance up to which all blending surfaces are passed.
    passed: Option<(u32, f32)>,
    /// Length of the path before the origin.
    before: f32,
    weight: Vec3,
    layer: u32,
    mirror: Option<u32>,
}

/// Image points and pixels in tile order.
#[derive(Clone, Copy)]
pub struct Tiling {
    pub width: u32,
    pub height: u32,
}

impl Tiling {
    /// Number of pixels, padded to whole tiles.
    pub fn len(&self) -> usize {
        let tiles = |size: u32| size.div_ceil(TILE_SIZE) as usize;
        tiles(self.width) * tiles(self.height) * PACKET_SIZE
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Pixel (x, y) at an index in tile order. It can lie outside the image, in the padding of a tile.
    pub fn pixel(&self, index: usize) -> (u32, u32) {
        let tiles_x = self.width.div_ceil(TILE_SIZE) as usize;
        let (tile, inside) = (index / PACKET_SIZE, (index % PACKET_SIZE) as u32);
        let (tile_x, tile_y) = ((tile % tiles_x) as u32, (tile / tiles_x) as u32);
        (tile_x * TILE_SIZE + inside % TILE_SIZE, tile_y * TILE_SIZE + inside / TILE_SIZE)
    }

    /// Index of pixel (x, y) in tile order.
    pub fn index(&self, x: u32, y: u32) -> usize {
        let tiles_x = self.width.div_ceil(TILE_SIZE);
        let tile = (y / TILE_SIZE) * tiles_x + x / TILE_SIZE;
        tile as usize * PACKET_SIZE + ((y % TILE_SIZE) * TILE_SIZE + x % TILE_SIZE) as usize
    }

    pub fn contains(&self, (x, y): (u32, u32)) -> bool {
        x < self.width && y < self.height
    }

    /// An index in tile order, renumbered so that the pixels of a tile are along a Z-order curve.
    pub fn along_curve(index: u32) -> u32 {
        const { assert!(TILE_SIZE == 8) };
        let digit = |from: u32, to: u32| (index >> from & 1) << to;
        let inside = digit(0, 0) | digit(3, 1) | digit(1, 2) | digit(4, 3) | digit(2, 4) | digit(5, 5);
        index & !63 | inside
    }
}

/// Casts rays from one camera into one scene.
pub struct EyeRays<'a> {
    pub scene: &'a TracedScene,
    pub camera: &'a Camera,
    pub tiling: Tiling,
    /// Maximum number of layers of a path: the number of its mirrors, plus 1.
    pub layers: u32,
}

impl EyeRays<'_> {
    /// Follows the ray through image point (x, y), in pixels, through perfect mirrors and blending surfaces. Calls
    /// `visit` for each segment and the surface at its end, the frontmost first.
    pub fn follow(&self, x: f64, y: f64, mut visit: impl FnMut(PathPart)) {
        let (width, height) = (f64::from(self.tiling.width), f64::from(self.tiling.height));
        let (origin, direction) = self.camera.ray(x / width, y / height, width / height);
        // Moves the origin close to the scene in double precision, so that a distant camera costs no precision.
        let space = self.scene.space;
        let origin = space.from_world(origin);
        let start = (-origin.dot(direction) - f64::from(self.scene.bvh.radius)).max(0.0);
        // Width of a pixel at distance d: fixed + growing * d.
        let (fixed, growing) = match self.camera.projection {
            Projection::Perspective { yfov } => (0.0, (2.0 * (yfov / 2.0).tan() / height) as f32),
            Projection::Orthographic { ymag } => ((2.0 * ymag / height / space.unit) as f32, 0.0),
        };
        let mut next = Some(Segment {
            origin: (origin + start * direction).as_vec3(),
            direction: direction.as_vec3(),
            passed: None,
            before: start as f32,
            weight: Vec3::ONE,
            layer: 0,
            mirror: None,
        });
        // Segments that continue behind blending surfaces.
        let mut behind: Vec<Segment> = Vec::new();
        let (mut met, mut steps) = (0, 0);
        while let Some(segment) = next.take().or_else(|| behind.pop()) {
            let in_a_row = met < MAX_BLENDS && steps < MAX_STEPS && segment.weight.max_element() >= MIN_WEIGHT_BEHIND;
            let hit = self.first_hit(&segment, in_a_row);
            visit(PathPart::Segment(segment.until(hit)));
            let Some(hit) = hit else { continue };
            let distance = segment.before + hit.distance;
            let point = SurfacePoint::new(self.scene, &hit, segment.direction, fixed + growing * distance)
                .facing(-segment.direction);
            let mut weight = segment.weight;
            if in_a_row && point.coverage < 1.0 {
                let passed = Some((hit.triangle, hit.distance + self.scene.bvh.shadow_offset(hit.distance)));
                behind.push(Segment { passed, weight: weight * (1.0 - point.coverage), ..segment });
                steps += 1;
                if point.coverage <= 0.0 {
                    continue;
                }
                weight *= point.coverage;
                met += 1;
            }
            visit(PathPart::Vertex(PathVertex { point, wo: -segment.direction, weight, layer: segment.layer }));
            next = self.mirrored(&segment, &point, hit.distance, weight);
        }
    }

    /// The first surface not yet passed. With `in_a_row` a blending surface is always hit, as its coverage is averaged
    /// over a pixel; otherwise it is hit with a probability equal to its coverage.
    fn first_hit(&self, segment: &Segment, in_a_row: bool) -> Option<Hit> {
        let Segment { origin, direction, passed, .. } = *segment;
        if !self.scene.bvh.has_blends {
            return self.scene.closest_hit(origin, direction, f32::INFINITY);
        }
        // Traced again from the same origin: the hit behind is bitwise the same as without the surfaces before it.
        self.scene.closest_hit_unless(origin, direction, |hit| {
            let coverage = coverage(self.scene, hit.triangle, hit.barycentric);
            let is_passed = |(last, beyond)| hit.triangle == last || (hit.distance <= beyond && coverage < 1.0);
            let material = &self.scene.materials[self.scene.mesh.triangle_materials[hit.triangle as usize] as usize];
            let stops = in_a_row && material.alpha_mode == AlphaMode::Blend;
            let by_chance = || passes_by_chance(self.scene, hit.triangle, hit.barycentric, [origin, direction]);
            passed.is_some_and(is_passed) || !stops && by_chance()
        })
    }

    /// The continuation of a path at a mirror.
    fn mirrored(&self, segment: &Segment, point: &SurfacePoint, distance: f32, weight: Vec3) -> Option<Segment> {
        let wo = -segment.direction;
        let cosine = point.normal.dot(wo);
        // Single-sided and seen from behind, or the last layer.
        if cosine <= 0.0 || segment.layer + 1 >= self.layers {
            return None;
        }
        let weight = weight * brdf::mirror(&point.brdf, cosine.into()).as_vec3();
        if weight.max_element() < MIN_WEIGHT {
            return None;
        }
        let direction = point.mirrored(wo);
        let origin = point.leave(direction, self.scene.bvh.shadow_offset(distance));
        let before = segment.before + distance;
        let (layer, mirror) = (segment.layer + 1, Some(point.triangle));
        Some(Segment { origin, direction, passed: None, before, weight, layer, mirror })
    }
}

impl Segment {
    /// The segment from the surface that the path passed last to `hit`.
    fn until(&self, hit: Option<Hit>) -> PathSegment {
        let Self { origin, direction, weight, layer, mirror, .. } = *self;
        let eye = if layer == 0 { -self.before } else { 0.0 };
        let begin = self.passed.map_or(eye, |(_, beyond)| beyond);
        let range = [begin, hit.map_or(f32::INFINITY, |hit| hit.distance)];
        PathSegment { origin, direction, range, weight, layer, mirror }
    }
}

/// Collects path vertices as view samples.
#[derive(Default)]
struct Collector {
    samples: Vec<ViewSample>,
    geometric_normals: Vec<Vec3>,
    lifts: Vec<f32>,
    /// Only those that differ from their material's.
    brdfs: Vec<Brdf>,
}

impl Collector {
    fn push(&mut self, vertex: &PathVertex) {
        let SurfacePoint { position, lift, normal, geometric_normal, brdf, material, uniform, .. } = vertex.point;
        let brdf = if !brdf.reflects_directly() || normal.dot(vertex.wo) <= 0.0 {
            NO_BRDF
        } else if uniform {
            material
        } else {
            self.brdfs.push(brdf);
            OWN_BRDF
        };
        let (normal, wo) = (octahedral::encode(normal), octahedral::encode(vertex.wo));
        self.samples.push(ViewSample { position, brdf, normal, wo });
        self.geometric_normals.push(geometric_normal);
        self.lifts.push(lift);
    }

    fn push_empty(&mut self) {
        self.samples.push(EMPTY_SAMPLE);
        self.geometric_normals.push(Vec3::ZERO);
        self.lifts.push(0.0);
    }
}

/// Marks the collector's next BRDF until collectors are joined.
const OWN_BRDF: u32 = NO_BRDF - 1;
pub(super) const EMPTY_SAMPLE: ViewSample =
    ViewSample { position: Vec3::ZERO, brdf: NO_BRDF, normal: Vec2::ZERO, wo: Vec2::ZERO };

/// The view samples of one tile of pixels.
#[derive(Default)]
struct Tile {
    first: Collector,
    extra: Collector,
    /// Pixel in tile order, weight and layer of each extra sample.
    extra_of: Vec<(u32, ExtraSample)>,
    /// Pixels whose first sample covers them partly, in tile order, and its coverage.
    covered: Vec<(u32, f32)>,
    /// Material, pixel in tile order, and radiance.
    emission: Vec<(u32, u32, Vec3)>,
}

/// The deep framebuffer with one path per pixel, through its centre; `edges` lists pixels that get `samples` paths.
pub(super) fn collect(
    eye: &EyeRays,
    settings: &BakeSettings,
    edges: &[u32],
    progress: &(dyn Fn(usize) + Sync),
) -> DeepFramebuffer {
    let tile_count = eye.tiling.len() / PACKET_SIZE;
    let tiles: Vec<Tile> = (0..tile_count)
        .into_par_iter()
        .map(|tile| {
            let range = (tile * PACKET_SIZE) as u32..((tile + 1) * PACKET_SIZE) as u32;
            let from = edges.partition_point(|&pixel| pixel < range.start);
            let to = edges.partition_point(|&pixel| pixel < range.end);
            let result = collect_tile(eye, range, &edges[from..to], settings.samples);
            progress(1);
            result
        })
        .collect();
    join(eye, settings, edges, tiles)
}

fn collect_tile(eye: &EyeRays, pixels: std::ops::Range<u32>, edges: &[u32], samples: u32) -> Tile {
    let mut tile = Tile::default();
    let first_pixel = pixels.start;
    for pixel in pixels {
        let (x, y) = eye.tiling.pixel(pixel as usize);
        let index = tile.first.samples.len();
        if eye.tiling.contains((x, y)) {
            let share = if edges.binary_search(&pixel).is_ok() { 1.0 / samples as f32 } else { 1.0 };
            eye.follow(f64::from(x) + 0.5, f64::from(y) + 0.5, |part| tile.add(&part, pixel, share, Some(index)));
        }
        if tile.first.samples.len() == index {
            tile.first.push_empty();
        }
        debug_assert_eq!(tile.first.samples.len() as u32, pixel - first_pixel + 1);
    }
    for &pixel in edges {
        let (x, y) = eye.tiling.pixel(pixel as usize);
        for (u, v) in image_points(samples).skip(1) {
            let share = 1.0 / samples as f32;
            eye.follow(f64::from(x) + u, f64::from(y) + v, |part| tile.add(&part, pixel, share, None));
        }
    }
    tile
}

impl Tile {
    /// The first vertex of a path through a pixel's centre becomes sample `first` of the tile's layer 1.
    fn add(&mut self, part: &PathPart, pixel: u32, share: f32, first: Option<usize>) {
        let PathPart::Vertex(vertex) = part else { return };
        if vertex.point.emission != Vec3::ZERO {
            self.emission.push((vertex.point.material, pixel, vertex.weight * share * vertex.point.emission));
        }
        if first == Some(self.first.samples.len()) {
            self.first.push(vertex);
            if vertex.weight.x < 1.0 {
                self.covered.push((pixel, vertex.weight.x));
            }
        } else if vertex.point.brdf.reflects_directly() && vertex.point.normal.dot(vertex.wo) > 0.0 {
            self.extra.push(vertex);
            self.extra_of.push((pixel, ExtraSample { weight: vertex.weight * share, layer: vertex.layer }));
        }
    }
}

/// Where the eye paths of a pixel meet it: the first in its centre.
fn image_points(samples: u32) -> impl Iterator<Item = (f64, f64)> {
    std::iter::once((0.5, 0.5)).chain((1..samples).map(|i| (radical_inverse(2, i), radical_inverse(3, i))))
}

/// The segments of the eye paths of a baked view that are `wanted`, each with its pixel, in tile order. Weights include
/// the share of the path in its pixel.
pub fn segments(
    scene: &TracedScene,
    framebuffer: &DeepFramebuffer,
    wanted: impl Fn(&PathSegment) -> bool + Sync,
) -> Vec<(u32, PathSegment)> {
    parts(scene, framebuffer, |part, paths| match part {
        PathPart::Segment(segment) if wanted(&segment) => {
            Some(PathSegment { weight: segment.weight / paths, ..segment })
        }
        _ => None,
    })
}

/// What is seen directly, not in mirrors: the pixel in tile order, the point, and how much of the pixel it covers.
pub fn seen(scene: &TracedScene, framebuffer: &DeepFramebuffer) -> Vec<(u32, (SurfacePoint, f32))> {
    parts(scene, framebuffer, |part, paths| match part {
        PathPart::Vertex(vertex) if vertex.layer == 0 => Some((vertex.point, vertex.weight.x / paths)),
        _ => None,
    })
}

/// What is `wanted` of the eye paths of a baked view, each with its pixel, in tile order. `wanted` gets the number of
/// paths of the pixel.
fn parts<T: Send>(
    scene: &TracedScene,
    framebuffer: &DeepFramebuffer,
    wanted: impl Fn(PathPart, f32) -> Option<T> + Sync,
) -> Vec<(u32, T)> {
    let DeepFramebuffer { camera, tiling, asked_layers, edges, samples_on_edges, .. } = framebuffer;
    let eye = EyeRays { scene, camera, tiling: *tiling, layers: *asked_layers };
    let of_pixel = |pixel: usize| {
        let (x, y) = tiling.pixel(pixel);
        let is_on_edge = edges.binary_search(&(pixel as u32)).is_ok();
        let samples = if is_on_edge { *samples_on_edges } else { 1 };
        let mut found = Vec::new();
        for (u, v) in image_points(samples).filter(|_| tiling.contains((x, y))) {
            eye.follow(f64::from(x) + u, f64::from(y) + v, |part| {
                found.extend(wanted(part, samples as f32).map(|wanted| (pixel as u32, wanted)));
            });
        }
        found
    };
    (0..tiling.len()).into_par_iter().flat_map_iter(of_pixel).collect()
}

/// [van der Corput 1935; Halton 1960].
fn radical_inverse(base: u32, mut index: u32) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / f64::from(base));
    while index > 0 {
        value += digit * f64::from(index % base);
        index /= base;
        digit /= f64::from(base);
    }
    value
}

/// Joins the tiles: layer 1 in tile order, then the extra samples by layer and pixel.
fn join(eye: &EyeRays, settings: &BakeSettings, edges: &[u32], tiles: Vec<Tile>) -> DeepFramebuffer {
    let pixel_count = eye.tiling.len();
    let mut brdfs: Vec<Brdf> = eye
        .scene
        .materials
        .iter()
        .map(|m| {
            crate::trace::surface::brdf(&m.evaluate(&eye.scene.textures, Default::default(), [0.0; 2], glam::Vec4::ONE))
        })
        .collect();
    let mut samples = Vec::with_capacity(pixel_count);
    let mut geometric_normals = Vec::with_capacity(pixel_count);
    let mut lifts = Vec::with_capacity(pixel_count);
    let mut append = |collector: &Collector, order: &mut dyn Iterator<Item = usize>, brdf_of: &[u32]| {
        for i in order {
            let mut sample = collector.samples[i];
            if sample.brdf == OWN_BRDF {
                sample.brdf = brdf_of[i];
            }
            samples.push(sample);
            geometric_normals.push(collector.geometric_normals[i]);
            lifts.push(collector.lifts[i]);
        }
    };
    let mut place_brdfs = |collector: &Collector| -> Vec<u32> {
        let mut next = brdfs.len() as u32;
        brdfs.extend_from_slice(&collector.brdfs);
        let own = collector.samples.iter().map(|s| {
            let this = next;
            next += u32::from(s.brdf == OWN_BRDF);
            this
        });
        own.collect()
    };
    for tile in &tiles {
        let brdf_of = place_brdfs(&tile.first);
        append(&tile.first, &mut (0..tile.first.samples.len()), &brdf_of);
    }
    let extra_brdfs: Vec<Vec<u32>> = tiles.iter().map(|tile| place_brdfs(&tile.extra)).collect();

    let layer_total = tiles.iter().flat_map(|t| &t.extra_of).map(|(_, e)| e.layer + 1).max().unwrap_or(1);
    let mut extra_samples = Vec::new();
    let mut owners: Vec<(u32, u32)> = Vec::new();
    for layer in 0..layer_total {
        for (tile, brdf_of) in tiles.iter().zip(&extra_brdfs) {
            let in_layer = |&i: &usize| tile.extra_of[i].1.layer == layer;
            append(&tile.extra, &mut (0..tile.extra_of.len()).filter(in_layer), brdf_of);
            for i in (0..tile.extra_of.len()).filter(in_layer) {
                owners.push((tile.extra_of[i].0, extra_samples.len() as u32));
                extra_samples.push(tile.extra_of[i].1);
            }
        }
    }
    let mut layers = vec![0; layer_total as usize];
    layers[0] = geometric_normals[..pixel_count].iter().filter(|n| **n != Vec3::ZERO).count();
    for extra in &extra_samples {
        layers[extra.layer as usize] += 1;
    }

    // Pixels on edges, or with a blending surface in front, are listed even if their extra rays hit nothing, as their
    // first sample has a weight below 1.
    owners.sort_unstable();
    let covered: Vec<(u32, f32)> = tiles.iter().flat_map(|tile| tile.covered.iter().copied()).collect();
    let in_part = covered.iter().map(|&(pixel, _)| pixel).chain(edges.iter().copied());
    let mut pixels: Vec<u32> = owners.iter().map(|&(pixel, _)| pixel).chain(in_part).collect();
    pixels.sort_unstable();
    pixels.dedup();
    let mut first = 0;
    let extra_pixels = pixels
        .into_iter()
        .map(|pixel| {
            let count = owners[first..].iter().take_while(|owner| owner.0 == pixel).count();
            let on_edge = edges.binary_search(&pixel).is_ok();
            let share = if on_edge { 1.0 / settings.samples as f32 } else { 1.0 };
            let coverage = covered.binary_search_by_key(&pixel, |c| c.0).map_or(1.0, |i| covered[i].1);
            let first_weight = share * coverage;
            let listed = ExtraPixel { pixel, first: first as u32, count: count as u32, first_weight };
            first += count;
            listed
        })
        .collect();

    let emitters = Emitters::of(eye.scene);
    let emitted = |&(material, pixel, radiance): &_| EmittedPixel {
        emitter: emitters.index(material).expect("an emissive material has an emitter"),
        pixel,
        radiance,
    };
    let mut emission: Vec<EmittedPixel> = tiles.iter().flat_map(|tile| &tile.emission).map(emitted).collect();
    emission.sort_by_key(|part| (part.emitter, part.pixel));
    emission.dedup_by(|part, sum| {
        let is_same = (part.emitter, part.pixel) == (sum.emitter, sum.pixel);
        sum.radiance += if is_same { part.radiance } else { Vec3::ZERO };
        is_same
    });
    let has_specular = samples.iter().any(|s| s.brdf != NO_BRDF && brdfs[s.brdf as usize].has_lobe());
    DeepFramebuffer {
        camera: eye.camera.clone(),
        tiling: eye.tiling,
        has_specular,
        packets: pack(&samples, &geometric_normals, &lifts, pixel_count),
        samples,
        geometric_normals,
        lifts,
        brdfs,
        extra_samples,
        extra_indices: owners.into_iter().map(|(_, extra)| extra).collect(),
        extra_pixels,
        edges: edges.to_vec(),
        samples_on_edges: settings.samples,
        emission,
        layers,
        asked_layers: eye.layers,
    }
}

/// Adds the extra view samples to their pixels of a light's image. Twin of resolve.comp.
///
/// `image` is indexed by pixel. `extras` is the radiance of the extra samples. Bit l of `layers` is set if layer l
/// counts.
pub fn resolve(
    pixels: &[ExtraPixel],
    indices: &[u32],
    samples: &[ExtraSample],
    extras: &[DVec3],
    layers: u32,
    image: &mut [DVec3],
) {
    for p in pixels {
        let listed = &indices[p.first as usize..][..p.count as usize];
        let counted = listed.iter().map(|&i| i as usize).filter(|&i| layers >> samples[i].layer.min(31) & 1 != 0);
        let deeper: DVec3 = counted.map(|i| samples[i].weight.as_dvec3() * extras[i]).sum();
        let pixel = &mut image[p.pixel as usize];
        *pixel = f64::from(p.first_weight) * *pixel + deeper;
    }
}

/// Packets of 64 samples; a packet holds either samples of layer 1 or extra ones. Without `lifts` rays start on the
/// surfaces.
pub(in crate::bake) fn pack(
    samples: &[ViewSample],
    geometric_normals: &[Vec3],
    lifts: &[f32],
    pixel_count: usize,
) -> Vec<SamplePacket> {
    assert_eq!(pixel_count % PACKET_SIZE, 0, "layer 1 is padded to whole tiles");
    samples
        .par_chunks(PACKET_SIZE)
        .zip(geometric_normals.par_chunks(PACKET_SIZE))
        .enumerate()
        .map(|(i, (samples, geometric_normals))| {
            let lift = |lane: usize| lifts.get(i * PACKET_SIZE + lane).copied().unwrap_or(0.0);
            let mut packet = SamplePacket::default();
            for (lane, (sample, geometric_normal)) in samples.iter().zip(geometric_normals).enumerate() {
                let lit = sample.brdf != NO_BRDF;
                let start = sample.position + lift(lane) * geometric_normal;
                let normal = if lit { octahedral::decode(sample.normal) } else { Vec3::ZERO };
                for axis in 0..3 {
                    packet.position[axis][lane] = start[axis];
                    packet.normal[axis][lane] = normal[axis];
                    packet.geometric_normal[axis][lane] = geometric_normal[axis];
                }
            }
            packet
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Aligned groups of 4 and 16 pixels are squares, and tiles stay tiles.
    #[test]
    fn groups_along_the_curve_are_squares() {
        let tiling = Tiling { width: 24, height: 16 };
        let mut pixels = vec![None; tiling.len()];
        for index in 0..tiling.len() {
            pixels[Tiling::along_curve(index as u32) as usize] = Some(tiling.pixel(index));
        }
        let pixels: Vec<(u32, u32)> = pixels.into_iter().map(|pixel| pixel.expect("each has one index")).collect();
        for side in [2, 4, TILE_SIZE] {
            for group in pixels.chunks((side * side) as usize) {
                let corner = |(x, y): (u32, u32)| (x / side, y / side);
                assert!(group.iter().all(|&pixel| corner(pixel) == corner(group[0])), "side {side}: {group:?}");
            }
        }
    }
}
