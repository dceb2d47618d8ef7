//! Light that landed on surfaces as photons, and its density around a point [Jensen 1996].

use std::f64::consts::PI;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use super::point_tree::{PointTree, point};

/// Photons, found by position.
pub struct PhotonMap {
    photons: Vec<Photon>,
    tree: PointTree,
}

/// Light that landed on a surface.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Photon {
    /// Mesh space.
    pub position: Vec3,
    /// Unit, on the side that it landed on.
    pub geometric_normal: Vec3,
    /// Unit, back to where it came from.
    pub wi: Vec3,
    /// RGB flux in units of mesh space.
    pub flux: Vec3,
}

/// Number of photons whose density is taken.
const NEAREST: usize = 64;
/// Least cosine between the normals of surfaces that share photons.
const MIN_NORMAL_COSINE: f32 = 0.9;
/// Largest height of photons above a surface, relative to their distance: they may lie on a parallel one. Rays start
/// above surfaces, so a share of the largest distance is added.
const OFF_PLANE: f32 = 0.3;
const LIFTED: f32 = 0.02;
/// Least cosine by which irradiance is divided.
const MIN_COSINE: f64 = 0.05;

impl PhotonMap {
    pub fn new(photons: Vec<Photon>) -> Self {
        let positions: Vec<_> = photons.iter().map(|photon| point(photon.position, Vec3::ZERO, 0.0)).collect();
        Self { photons, tree: PointTree::new(&positions) }
    }

    pub fn photons(&self) -> &[Photon] {
        &self.photons
    }

    pub fn is_empty(&self) -> bool {
        self.photons.is_empty()
    }

    /// Light that arrives around a point of a surface: `arrive` gets its unit direction, and its irradiance on a plane
    /// that faces it, RGB. `reach2`: largest squared distance of photons, mesh space.
    pub fn arriving(&self, position: Vec3, geometric_normal: Vec3, reach2: f32, mut arrive: impl FnMut(DVec3, DVec3)) {
        let lifted = LIFTED * reach2.sqrt();
        let alike = |i: u32| {
            let photon = &self.photons[i as usize];
            let offset = photon.position - position;
            photon.geometric_normal.dot(geometric_normal) > MIN_NORMAL_COSINE
                && offset.dot(geometric_normal).abs() <= OFF_PLANE * offset.length() + lifted
        };
        let found = self.tree.nearest_within::<NEAREST>(&point(position, Vec3::ZERO, 0.0), reach2, alike);
        let found = found.items();
        // The last one lies on the edge of the disc and is not counted.
        let (inside, radius2) = match found.split_last() {
            Some((&(distance2, _), inside)) if found.len() == NEAREST => (inside, distance2),
            _ => (found, reach2),
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
