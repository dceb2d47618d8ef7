//! Which parts of the sky light the picture: directions of domes are drawn where they matter.
//!
//! All samples see a dome from the same directions. Drawn by the map alone, most of them would be lost outside of a
//! room with one window. So the share of light that arrives is measured once for each cell of the sky, at some of the
//! samples, and warps the unit square from which directions are drawn. ([Atanasov 2018] learns such shares for each
//! part of a scene.)

use std::collections::HashMap;
use std::f64::consts::TAU;

use glam::{DVec3, FloatExt, Vec3};
use rayon::prelude::*;

use crate::bake::DeepFramebuffer;
use crate::bake::transfer::Transfer;
use crate::physics::distribution::GridDistribution;
use crate::physics::sequence::Points;
use crate::scene::{Light, LightKind, MeshSpace, ResolvedLinks, Rig};
use crate::shared::{NO_BRDF, PackedLight};
use crate::trace::bvh::TracedScene;
use crate::trace::linked::LinkedScene;

/// Of the domes of a rig.
#[derive(Default)]
pub struct SkyImportances(Vec<SkyImportance>);

/// A sample that is lit.
struct Receiver {
    /// Where rays start.
    origin: Vec3,
    normal: Vec3,
}

/// How strongly each part of the sky lights the samples.
struct SkyImportance {
    /// Root mean square of cosine times visibility, in cells of equal solid angle; rows from the top.
    cells: Vec<f32>,
    /// Of the domes that it is for.
    shadows: bool,
    no_shadow_from: Vec<String>,
}

/// Rows and columns of cells of the sky.
const CELLS: [usize; 2] = [16, 32];
/// Samples of the picture, and gather samples, that stand for all.
const RECEIVERS: usize = 512;
/// Rows and columns of the warped unit square.
const WARP: usize = 64;
/// Share of the directions that are drawn as if all parts of the sky were alike: what no sample sees may still light
/// others.
const EVEN_SHARE: f64 = 0.1;
/// Least gain from a warp that is used. Warped lattices are less even: an open floor, whose gain is 8/3, would have
/// several times the error of the spherical lattice.
const LEAST_GAIN: f32 = 3.0;

impl SkyImportances {
    /// Measures for domes of `rig` what is not measured yet. `links`: of the lights that have any.
    pub fn update(
        &mut self,
        scene: &TracedScene,
        framebuffer: &DeepFramebuffer,
        transfer: Option<&Transfer>,
        rig: &Rig,
        links: &HashMap<usize, ResolvedLinks>,
    ) {
        let mut receivers = None;
        for (index, light) in rig.lights.iter().enumerate().filter(|(_, light)| light.kind == LightKind::Dome) {
            if self.of(light).is_none() {
                let receivers = receivers.get_or_insert_with(|| receivers_of(scene, framebuffer, transfer));
                self.0.push(SkyImportance::measure(light, scene.linked(links.get(&index)), receivers));
            }
        }
    }

    /// Forgets everything: samples, or objects that links name, have changed.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    fn of(&self, light: &Light) -> Option<&SkyImportance> {
        self.0.iter().find(|of| of.shadows == light.shadows && of.no_shadow_from == light.links.no_shadow_from)
    }

    /// The warp of the unit square for [`point_of`]; `None` for lights that are no domes, and where it gains little.
    pub fn warp(&self, light: &Light) -> Option<GridDistribution> {
        let importance = if light.kind == LightKind::Dome { self.of(light)? } else { return None };
        (importance.gain() >= LEAST_GAIN).then(|| importance.warp(light))
    }
}

/// Some samples of the picture, and some gather samples.
fn receivers_of(scene: &TracedScene, framebuffer: &DeepFramebuffer, transfer: Option<&Transfer>) -> Vec<Receiver> {
    let offset = scene.bvh.shadow_offset(0.0);
    let receiver = |position: Vec3, normal: Vec3, lift: f32| {
        let origin = position + normal * (lift + offset);
        Receiver { origin, normal }
    };
    let reflects = |i: &usize| framebuffer.samples[*i].brdf != NO_BRDF;
    let lit: Vec<usize> = (0..framebuffer.samples.len()).filter(reflects).collect();
    let views = some(lit.len())
        .map(|i| lit[i])
        .map(|i| receiver(framebuffer.samples[i].position, framebuffer.geometric_normals[i], framebuffer.lifts[i]));
    let gathers = transfer.into_iter().flat_map(|transfer| {
        some(transfer.points.len()).map(|i| receiver(transfer.points[i].position, transfer.geometric_normals[i], 0.0))
    });
    views.chain(gathers).collect()
}

/// [`Light::pack_point`] where the unit square is warped.
pub fn point_of(
    light: &Light,
    space: MeshSpace,
    at: [f64; 2],
    count: u32,
    warp: Option<&GridDistribution>,
) -> PackedLight {
    let Some(warp) = warp else { return light.pack_point(space, at, Some(count)) };
    let (at, density) = warp.warp(at);
    let packed = light.pack_point(space, at, Some(count));
    PackedLight {
        strength: (f64::from(packed.strength) / density) as f32,
        squared_radius: (f64::from(packed.squared_radius) / density) as f32,
        ..packed
    }
}

impl SkyImportance {
    fn measure(light: &Light, scene: LinkedScene, receivers: &[Receiver]) -> Self {
        let [rows, columns] = CELLS;
        let light_from = |cell: usize| {
            let points = Points::new(0, cell as u64);
            let squared = |(i, receiver): (usize, &Receiver)| {
                let [u, v, ..] = points.at(i as u32, 0);
                let direction = direction([(cell / columns) as f64 + u, (cell % columns) as f64 + v]).as_vec3();
                let cosine = receiver.normal.dot(direction);
                let passes = match light.shadows && cosine > 0.0 {
                    true => scene.transmittance(receiver.origin, direction, f32::INFINITY),
                    false => 1.0,
                };
                (cosine.max(0.0) * passes).powi(2)
            };
            (receivers.iter().enumerate().map(squared).sum::<f32>() / receivers.len().max(1) as f32).sqrt()
        };
        let measured: Vec<f32> = (0..rows * columns).into_par_iter().map(light_from).collect();
        let at = |row: usize, column: usize| measured[row * columns + column % columns];
        let blurred = |cell: usize| {
            let (row, column) = (cell / columns, cell % columns + columns);
            let along = |row: usize| 0.25 * at(row, column - 1) + 0.5 * at(row, column) + 0.25 * at(row, column + 1);
            0.25 * along(row.saturating_sub(1)) + 0.5 * along(row) + 0.25 * along((row + 1).min(rows - 1))
        };
        Self {
            cells: (0..rows * columns).map(blurred).collect(),
            shadows: light.shadows,
            no_shadow_from: light.links.no_shadow_from.clone(),
        }
    }

    /// How many times as many directions would be needed without it, under an even sky. 0 if no light arrives.
    fn gain(&self) -> f32 {
        let [sum, squares] = [1, 2].map(|power| self.cells.iter().map(|x| x.powi(power)).sum::<f32>());
        if sum > 0.0 { squares * self.cells.len() as f32 / (sum * sum) } else { 0.0 }
    }

    /// Of a unit direction towards the sky; interpolated.
    fn at(&self, direction: DVec3) -> f64 {
        let [rows, columns] = CELLS;
        let row = (0.5 * (1.0 - direction.y) * rows as f64 - 0.5).clamp(0.0, (rows - 1) as f64);
        let column = (direction.x.atan2(direction.z) / TAU).rem_euclid(1.0) * columns as f64 + columns as f64 - 0.5;
        let at = |row: usize, column: usize| f64::from(self.cells[row.min(rows - 1) * columns + column % columns]);
        let along = |row: usize| at(row, column as usize).lerp(at(row, column as usize + 1), column.fract());
        along(row as usize).lerp(along(row as usize + 1), row.fract())
    }

    fn warp(&self, light: &Light) -> GridDistribution {
        let (sky, turn) = (light.sky(), light.turn());
        let weight = |cell: usize| {
            let [x, y] = [cell % WARP, cell / WARP].map(|i| (i as f64 + 0.5) / WARP as f64);
            self.at(turn * sky.draw([y, x]).direction)
        };
        let weights: Vec<f64> = (0..WARP * WARP).into_par_iter().map(weight).collect();
        let even = EVEN_SHARE / (1.0 - EVEN_SHARE) * weights.iter().sum::<f64>() / weights.len() as f64;
        GridDistribution::new([WARP; 2], |x, y| weights[y * WARP + x] + even)
    }
}

/// The direction at a row and a column of cells, both with fractions.
fn direction([row, column]: [f64; 2]) -> DVec3 {
    let cosine = 1.0 - 2.0 * row / CELLS[0] as f64;
    let (sin, cos) = (TAU * column / CELLS[1] as f64).sin_cos();
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    DVec3::new(sine * sin, cosine, sine * cos)
}

/// At most [`RECEIVERS`] of `count` indices, spread evenly.
fn some(count: usize) -> impl Iterator<Item = usize> {
    let some = count.min(RECEIVERS);
    (0..some).map(move |i| (2 * i + 1) * count / (2 * some))
}
