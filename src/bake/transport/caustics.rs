//! Caustics: light of emitters that mirrors throw onto surfaces, by photons [Jensen 1996].
//!
//! Rays from a surface find it rarely, if a small mirror throws light of a small emitter: few pixels get a lot. So
//! photons go from the emitters to the mirrors, and a surface takes the density of those that land around it.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::paths::{Encounter, Paths};
use crate::bake::gather_samples::Place;
use crate::physics::sequence::Points;
use crate::trace::bvh::TracedScene;
use crate::trace::emitting_triangles::{EmittingTriangles, Receiver};
use crate::trace::photon_map::{Photon, PhotonMap};

/// Photons of one emitter, where they landed.
pub struct Caustics {
    map: PhotonMap,
    /// Largest squared distance at which photons are looked for, mesh space.
    reach2: f32,
}

/// Photons that set out from all emitters towards mirrors, and the most from one.
const PHOTONS: usize = 1 << 20;
const PHOTONS_OF_ONE: usize = 1 << 18;
/// Largest distance of photons that a surface takes, relative to the scene's radius.
const REACH: f32 = 0.05;

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
        Self::with((0..count).into_par_iter().flat_map_iter(land).collect(), paths.scene)
    }

    /// With photons of an earlier one.
    pub fn with(photons: Vec<Photon>, scene: &TracedScene) -> Self {
        let reach = REACH * scene.bvh.radius;
        Self { map: PhotonMap::new(photons), reach2: reach * reach }
    }

    pub fn photons(&self) -> &[Photon] {
        self.map.photons()
    }

    /// See [`PhotonMap::arriving`].
    pub fn arriving(&self, position: Vec3, geometric_normal: Vec3, arrive: impl FnMut(DVec3, DVec3)) {
        self.map.arriving(position, geometric_normal, self.reach2, arrive);
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
