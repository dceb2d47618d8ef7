//! Caustics: light of emitters that mirrors throw onto surfaces, by photons [Jensen 1996].
//!
//! Rays from a surface find it rarely, if a small mirror throws light of a small emitter: few pixels get a lot. So photons
//! go from the emitters to the mirrors, and a surface takes the density of those that land around it.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::paths::{Encounter, Paths};
use crate::bake::gather_samples::Place;
use crate::physics::sequence::Points;
use crate::trace::emitting_triangles::{EmittingTriangles, Receiver};
use crate::trace::point_tree::{PointTree, point};

/// Photons of one emitter, where they landed.
pub struct Caustics {
    photons: Vec<Photon>,
    /// By position only; normals are compared separately.
    tree: PointTree,
    /// Largest squared distance at which photons are looked for, mesh space.
    reach2: f32,
}

/// Light that landed on a surface.
struct Photon {
    /// Mesh space.
    position: Vec3,
    /// Unit, on the side that it landed on.
    geometric_normal: Vec3,
    /// Unit, back towards the mirror.
    wi: Vec3,
    /// RGB flux in units of mesh space.
    flux: Vec3,
}

/// Photons that set out from all emitters towards mirrors, and the most from one.
const PHOTONS: usize = 1 << 20;
const PHOTONS_OF_ONE: usize = 1 << 18;
/// Number of photons whose density is taken.
const NEAREST: usize = 64;
/// Largest distance of these, relative to the scene's radius.
const REACH: f32 = 0.05;
/// Least cosine between the normals of surfaces that share photons.
const MIN_NORMAL_COSINE: f32 = 0.9;
/// Largest height of photons above a surface, relative to their distance: they may lie on a parallel one. Rays start above
/// surfaces, so a share of the largest distance is added.
const OFF_PLANE: f32 = 0.3;
const LIFTED: f32 = 0.02;
/// Least cosine by which irradiance is divided.
const MIN_COSINE: f64 = 0.05;

impl Caustics {
    /// Sends photons from the triangles of one of `emitters` emitters towards triangles of mirrors.
    pub fn new(
        paths: &Paths,
        emitter: &EmittingTriangles,
        emitters: usize,
        mirrors: &EmittingTriangles,
        points: &Points,
    ) -> Self {
        let count = match mirrors.is_empty() || emitter.is_empty() {
            true => 0,
            false => (PHOTONS / emitters).min(PHOTONS_OF_ONE) as u32,
        };
        let land = |i: u32| land(paths, emitter, mirrors, f64::from(count), |set| points.at(i, set));
        let photons: Vec<Photon> = (0..count).into_par_iter().flat_map_iter(land).collect();
        let positions: Vec<_> = photons.iter().map(|photon| point(photon.position, Vec3::ZERO, 0.0)).collect();
        let reach = REACH * paths.scene.bvh.radius;
        Self { photons, tree: PointTree::new(&positions), reach2: reach * reach }
    }

    /// Light that arrives around a point of a surface: `arrive` gets its unit direction, and its irradiance on a plane that
    /// faces it, RGB.
    pub fn arriving(&self, position: Vec3, geometric_normal: Vec3, mut arrive: impl FnMut(DVec3, DVec3)) {
        let lifted = LIFTED * self.reach2.sqrt();
        let alike = |i: u32| {
            let photon = &self.photons[i as usize];
            let offset = photon.position - position;
            photon.geometric_normal.dot(geometric_normal) > MIN_NORMAL_COSINE
                && offset.dot(geometric_normal).abs() <= OFF_PLANE * offset.length() + lifted
        };
        let found = self.tree.nearest_within::<NEAREST>(&point(position, Vec3::ZERO, 0.0), self.reach2, alike);
        let found = found.items();
        // The last one lies on the edge of the disc and is not counted.
        let (inside, radius2) = match found.split_last() {
            Some((&(distance2, _), inside)) if found.len() == NEAREST => (inside, distance2),
            _ => (found, self.reach2),
        };
        if radius2 <= 0.0 {
            return;
        }
        for &(_, i) in inside {
            let Photon { wi, flux, .. } = &self.photons[i as usize];
            let cosine = f64::from(geometric_normal.dot(*wi)).max(MIN_COSINE);
            arrive(wi.as_dvec3().normalize(), flux.as_dvec3() / (PI * f64::from(radius2) * cosine));
        }
    }
}

/// The photons of one of `count` paths from an emitter, one at each surface after a mirror.
fn land(
    paths: &Paths,
    emitter: &EmittingTriangles,
    mirrors: &EmittingTriangles,
    count: f64,
    random: impl Fn(u32) -> [f64; 4],
) -> Vec<Photon> {
    let scene = paths.scene;
    let mut landed = Vec::new();
    let [u, v, w, side] = random(0);
    let Some((triangle, barycentric)) = emitter.place([u, v, w]) else { return landed };
    let material = scene.mesh.triangle_materials[triangle as usize];
    let sides = if scene.materials[material as usize].double_sided { 2.0 } else { 1.0 };
    let from = Place { triangle, barycentric, back: sides > 1.0 && side < 0.5 }.surface(scene, 0.0);
    let receiver = Receiver { normal: from.geometric_normal, ..(&from).into() };
    let [u, v, w, _] = random(1);
    let Some(towards) = mirrors.draw(scene, &receiver, [u, v, w]) else { return landed };
    let cosine = from.geometric_normal.as_dvec3().dot(towards.wi);
    let density = emitter.area_density(material) * towards.density * count;
    let flux = (from.emission.as_dvec3() * (cosine * sides / density)).as_vec3();
    let mut is_thrown = false;
    let at_mirror = |layer: u32| {
        let [u, v, w, _] = random(2 + layer);
        [u, v, w]
    };
    paths.follow(from.position, from.geometric_normal, towards.wi.as_vec3(), at_mirror, |met| {
        let Encounter::Surface(arrival) = met else { return };
        if std::mem::replace(&mut is_thrown, true) {
            let surface = arrival.place.surface(scene, 0.0);
            landed.push(Photon {
                position: surface.position,
                geometric_normal: surface.geometric_normal,
                wi: arrival.wo,
                flux: flux * arrival.tint,
            });
        }
    });
    landed
}
