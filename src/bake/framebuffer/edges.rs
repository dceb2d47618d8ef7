//! Pixels that need more than one sample: surface, normal or visibility differs between neighbouring pixels, or only
//! one of them shows a light itself.

use glam::Vec3;
use rayon::prelude::*;

use super::DeepFramebuffer;
use super::view_samples::{EyeRays, PathSegment, segments};
use crate::physics::octahedral::decode;
use crate::scene::{Light, LightKind, MeshSpace, Rig};
use crate::shared::NO_BRDF;
use crate::trace::light_surface::{LightInScene, LightSurface};
use crate::trace::packet::{PACKET_SIZE, trace_all};

/// Normals that differ by more than this form an edge: 8 degrees.
const NORMAL_COSINE: f32 = 0.99;
/// Two neighbours form an edge if the line between them leaves the tangent plane by more than this slope.
const PLANE_SLOPE: f32 = 0.2;

/// Visibility differences above this, of 255, form an edge: light through a patterned curtain mostly does not.
const VISIBLE_STEP: u8 = 16;

/// What the edges of a rig's lights depend on.
pub fn edge_lights(space: MeshSpace, rig: &Rig) -> Vec<u8> {
    let mut bytes = Vec::new();
    for light in with_edges(rig).filter(|light| light.shadows || !light.is_punctual()) {
        bytes.extend_from_slice(bytemuck::bytes_of(&light.pack(space)));
        if !light.is_punctual() {
            let Light { radius, size: [width, height], angle, spread, .. } = *light;
            bytes.extend_from_slice(bytemuck::bytes_of(&[radius, width, height, angle, spread]));
            bytes.extend_from_slice(bytemuck::bytes_of(&light.axes().map(|axis| axis.to_array())));
            bytes.extend([light.shadows, light.two_sided, light.visible].map(u8::from));
        }
    }
    bytes
}

/// Lights that may have edges besides those of surfaces.
fn with_edges(rig: &Rig) -> impl Iterator<Item = &Light> {
    rig.lights.iter().filter(|light| light.enabled && !matches!(light.kind, LightKind::Emitter | LightKind::Dome))
}

/// Pixels on edges, in tile order, sorted. Edges of visibility and of lights are those of `rig`'s lights.
pub(super) fn find(eye: &EyeRays, framebuffer: &DeepFramebuffer, rig: &Rig) -> Vec<u32> {
    let mut visible: Vec<Vec<u8>> = Vec::new();
    for light in with_edges(rig).filter(|light| light.shadows) {
        let light = light.pack(eye.scene.space);
        let mut visibility = vec![0u8; framebuffer.packets.len() * PACKET_SIZE];
        trace_all(eye.scene, &light, &framebuffer.packets, &mut visibility);
        visible.push(visibility);
    }
    let shown = lights_shown(eye, framebuffer, rig);
    // Extra samples of each pixel: one in each layer, and those behind surfaces that blend.
    let pixel_count = framebuffer.pixel_stride();
    let mut extras: Vec<&[u32]> = vec![&[]; pixel_count];
    for p in &framebuffer.extra_pixels {
        extras[p.pixel as usize] = &framebuffer.extra_indices[p.first as usize..(p.first + p.count) as usize];
    }
    let materials = eye.scene.materials.len() as u32;
    let tiling = eye.tiling;
    let differs = |a: usize, b: usize| {
        let (extra_a, extra_b) = (extras[a], extras[b]);
        let deeper = || {
            extra_a.iter().zip(extra_b).any(|(&a, &b)| {
                let layer = |i: u32| framebuffer.extra_samples[i as usize].layer;
                layer(a) != layer(b)
                    || samples_differ(
                        framebuffer,
                        materials,
                        &visible,
                        pixel_count + a as usize,
                        pixel_count + b as usize,
                    )
            })
        };
        let shows_other_lights = shown.iter().any(|pixels| pixels[a] != pixels[b]);
        shows_other_lights
            || samples_differ(framebuffer, materials, &visible, a, b)
            || extra_a.len() != extra_b.len()
            || deeper()
    };
    let mut on_edge: Vec<u32> = (0..pixel_count)
        .into_par_iter()
        .filter(|&index| {
            let (x, y) = tiling.pixel(index);
            let inside = tiling.contains((x, y));
            inside
                && (-1..=1).any(|dy: i32| {
                    (-1..=1).any(|dx: i32| {
                        let neighbour = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                        tiling.contains(neighbour) && differs(index, tiling.index(neighbour.0, neighbour.1))
                    })
                })
        })
        .map(|index| index as u32)
        .collect();
    on_edge.sort_unstable();
    on_edge
}

/// For each area light, whether the eye sees the light itself in each pixel, directly or in mirrors.
fn lights_shown(eye: &EyeRays, framebuffer: &DeepFramebuffer, rig: &Rig) -> Vec<Vec<bool>> {
    let surface = |light| Some((light, LightSurface::new(light, eye.scene.space, None)?));
    let lights: Vec<(&Light, LightSurface)> = with_edges(rig).filter_map(surface).collect();
    let from_eye = lights.iter().any(|(light, _)| light.visible);
    if lights.is_empty() || !(from_eye || eye.scene.has_mirrors()) {
        return Vec::new();
    }
    let segments = segments(eye.scene, framebuffer, |segment| from_eye || segment.mirror.is_some());
    let shown = |(light, surface): &(&Light, LightSurface)| {
        let light = LightInScene { light, surface, filter: None, scene: eye.scene.into() };
        let mut pixels = vec![false; framebuffer.pixel_stride()];
        for (pixel, PathSegment { origin, direction, range, mirror, .. }) in &segments {
            pixels[*pixel as usize] |= light.seen(*mirror, [*origin, *direction], *range).is_some();
        }
        pixels
    };
    lights.par_iter().map(shown).collect()
}

fn samples_differ(framebuffer: &DeepFramebuffer, materials: u32, visible: &[Vec<u8>], a: usize, b: usize) -> bool {
    let (sa, sb) = (&framebuffer.samples[a], &framebuffer.samples[b]);
    let (ga, gb) = (framebuffer.geometric_normals[a], framebuffer.geometric_normals[b]);
    if (ga == Vec3::ZERO) != (gb == Vec3::ZERO) {
        return true;
    }
    if ga == Vec3::ZERO {
        return false;
    }
    // BRDFs from index `materials` on belong to single textured samples: they differ everywhere.
    let material = |brdf: u32| if (materials..NO_BRDF).contains(&brdf) { materials } else { brdf };
    let between = sb.position - sa.position;
    let off_plane = between.dot(ga).abs().max(between.dot(gb).abs());
    material(sa.brdf) != material(sb.brdf)
        || decode(sa.normal).dot(decode(sb.normal)) < NORMAL_COSINE
        || off_plane > PLANE_SLOPE * between.length()
        || visible.iter().any(|v| v[a].abs_diff(v[b]) > VISIBLE_STEP)
}
