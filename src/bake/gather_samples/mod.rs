//! Gather samples: points on surfaces that stand for an area and carry outgoing radiance as a few coefficients.

mod clusters;
mod surface_points;

use glam::Vec3;
use rayon::prelude::*;

pub use self::surface_points::{Place, is_back, is_from_behind};

use self::clusters::Clusters;
use self::surface_points::{Sides, is_enclosed};
use super::brdf_factors::NEAR_MIRROR_ALPHA;
use super::bvh::Bvh;
use super::packet::{PACKET_SIZE, SamplePacket};
use super::point_tree::{PointTree, point};
use super::surface::SurfacePoint;
use crate::scene::Scene;
use crate::sequence::Points;
use crate::shared::Brdf;

/// How gather samples are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placement {
    /// Random, uniform by area [Yang 2007, Section 4.1].
    Random,
    /// One for each of as many compact clusters of the surface.
    Clustered {
        /// Points of a cluster at which light is looked at: 1 to 16.
        points: usize,
    },
}

/// One gather sample; mesh space.
#[derive(Clone, Copy, Debug)]
pub struct GatherSample {
    pub position: Vec3,
    /// Square metres.
    pub area: f32,
    /// Unit; its directions are counted in the frame that [`GatherSample::frame`] gives.
    pub normal: Vec3,
    /// Radiance that it emits, the same in all directions.
    pub emission: Vec3,
    /// Index into the scene's materials; of the middle, if there are several.
    pub material: u32,
    /// Its reflection, averaged over its area. Lobes narrower than [`NEAR_MIRROR_ALPHA`] are no part of it: rays go on
    /// through them.
    pub brdf: Brdf,
}

/// A point of a gather sample's area; mesh space.
#[derive(Clone, Copy, Debug)]
pub struct GatherPoint {
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit.
    pub geometric_normal: Vec3,
}

/// All gather samples of a scene, in the order of the leaves of a balanced tree: a node that holds the samples
/// `first..end` has as children what lies before and after [`super::point_tree::middle`].
#[derive(Clone, Debug, Default)]
pub struct GatherSamples {
    pub samples: Vec<GatherSample>,
    /// `points_per_sample` of each sample in turn: what it receives is the mean over them.
    pub points: Vec<GatherPoint>,
    pub points_per_sample: usize,
}

/// Points of the surface for each cluster.
const CANDIDATES: usize = 32;

impl GatherSamples {
    /// At most `count` samples: fewer where less surface reflects light. Everything random follows from `seed`.
    pub fn place(scene: &Scene, bvh: &Bvh, placement: Placement, count: usize, seed: u64) -> Self {
        let sides = Sides::new(scene, bvh);
        match placement {
            Placement::Random => random(scene, &sides, count, seed),
            Placement::Clustered { points } => clustered(scene, bvh, &sides, count, points, seed),
        }
    }

    pub fn len(&self) -> usize {
        self.samples.len()
    }

    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Square metres.
    pub fn area(&self) -> f64 {
        self.samples.iter().map(|s| f64::from(s.area)).sum()
    }

    /// How far apart opposite faces count when samples are compared: twice a sample's width. Scale-free.
    pub fn normal_length(&self) -> f32 {
        normal_length(self.area(), self.len())
    }

    /// All points, as shadow rays want them.
    pub fn packets(&self) -> Vec<SamplePacket> {
        let packet = |points: &[GatherPoint]| {
            let mut packet = SamplePacket::default();
            for (lane, point) in points.iter().enumerate() {
                for axis in 0..3 {
                    packet.position[axis][lane] = point.position[axis];
                    packet.normal[axis][lane] = point.normal[axis];
                    packet.geometric_normal[axis][lane] = point.geometric_normal[axis];
                }
            }
            packet
        };
        self.points.chunks(PACKET_SIZE).map(packet).collect()
    }

    /// A sample's points.
    pub fn points_of(&self, sample: usize) -> &[GatherPoint] {
        &self.points[sample * self.points_per_sample..][..self.points_per_sample]
    }

    /// Puts samples, each with its points, into the order of the tree.
    fn in_tree_order(samples: Vec<(GatherSample, Vec<GatherPoint>)>, points_per_sample: usize) -> Self {
        let area = samples.iter().map(|(s, _)| f64::from(s.area)).sum();
        let length = normal_length(area, samples.len());
        let places: Vec<_> = samples.iter().map(|(s, _)| point(s.position, s.normal, length)).collect();
        let tree = PointTree::new(&places);
        let in_order = || tree.order().iter().map(|&i| &samples[i as usize]);
        Self {
            samples: in_order().map(|(sample, _)| *sample).collect(),
            points: in_order().flat_map(|(_, points)| points.iter().copied()).collect(),
            points_per_sample,
        }
    }
}

fn normal_length(area: f64, count: usize) -> f32 {
    2.0 * (area / count.max(1) as f64).sqrt() as f32
}

impl GatherSample {
    /// Two tangents and the normal.
    pub fn frame(&self) -> [Vec3; 3] {
        let (s, t) = self.normal.any_orthonormal_pair();
        [s, t, self.normal]
    }
}

impl GatherPoint {
    fn new(surface: &SurfacePoint) -> Self {
        let SurfacePoint { position, normal, geometric_normal, .. } = *surface;
        Self { position, normal, geometric_normal }
    }

    /// The frame of its sample, turned the short way round until its normal is the point's own.
    pub fn frame(&self, sample: &GatherSample) -> [Vec3; 3] {
        let turn = glam::Quat::from_rotation_arc(sample.normal, self.normal);
        let [s, t, _] = sample.frame();
        [turn * s, turn * t, self.normal]
    }
}

fn random(scene: &Scene, sides: &Sides, count: usize, seed: u64) -> GatherSamples {
    let area = (sides.area() / count as f64) as f32;
    let sample = |place: &Place| {
        let surface = place.surface(scene, area.sqrt());
        let SurfacePoint { position, normal, emission, brdf, material, .. } = surface;
        (GatherSample { position, area, normal, emission, material, brdf }, vec![GatherPoint::new(&surface)])
    };
    let places = sides.random(Points::new(seed, 0), count);
    let samples = places.par_iter().filter(|place| !place.is_hole(scene)).map(sample).collect();
    GatherSamples::in_tree_order(samples, 1)
}

fn clustered(
    scene: &Scene,
    bvh: &Bvh,
    sides: &Sides,
    count: usize,
    points_per_sample: usize,
    seed: u64,
) -> GatherSamples {
    let candidate_count = count * CANDIDATES;
    let area_each = sides.area() / candidate_count as f64;
    let footprint = area_each.sqrt() as f32;
    let candidates: Vec<SurfacePoint> = sides
        .stratified(Points::new(seed, 0), candidate_count)
        .into_par_iter()
        .enumerate()
        .filter(|(_, place)| !place.is_hole(scene))
        .map(|(i, place)| (i, place.surface(scene, footprint)))
        .filter(|(i, surface)| {
            carries_light(surface) && !is_enclosed(scene, bvh, surface, Points::new(seed, 1 + *i as u64))
        })
        .map(|(_, surface)| surface)
        .collect();
    let length = normal_length(candidates.len() as f64 * area_each, count);
    let places: Vec<_> = candidates.par_iter().map(|c| point(c.position, c.normal, length)).collect();
    let clusters = Clusters::new(&places, count);
    let sample = |cluster: usize| {
        let members = clusters.members(cluster);
        let distance2 = |&&i: &&u32| -> f32 {
            places[i as usize].iter().zip(&clusters.means[cluster]).map(|(a, b)| (a - b) * (a - b)).sum()
        };
        let nearest = members.iter().min_by(|a, b| distance2(a).total_cmp(&distance2(b))).expect("none is empty");
        let centre = &candidates[*nearest as usize];
        let of_members = || members.iter().map(|&i| &candidates[i as usize]);
        let sample = GatherSample {
            position: centre.position,
            area: (members.len() as f64 * area_each) as f32,
            normal: of_members().map(|c| c.normal).sum::<Vec3>().try_normalize().unwrap_or(centre.normal),
            material: centre.material,
            emission: of_members().map(|c| c.emission).sum::<Vec3>() / members.len() as f32,
            brdf: average(of_members().map(|c| &c.brdf), members.len()),
        };
        // Members lie in tree order: points picked evenly among them are spread over the cluster.
        let pick = |i: usize| members[(2 * i + 1) * members.len() / (2 * points_per_sample)];
        let points = (0..points_per_sample).map(|i| GatherPoint::new(&candidates[pick(i) as usize])).collect();
        (sample, points)
    };
    GatherSamples::in_tree_order((0..clusters.len()).into_par_iter().map(sample).collect(), points_per_sample)
}

/// Whether a sample has anything to carry there.
pub fn carries_light(surface: &SurfacePoint) -> bool {
    surface.emission != Vec3::ZERO || held(&surface.brdf).reflects_directly()
}

/// What a gather sample holds of a BRDF: a lobe so narrow that rays go on through it is a perfect mirror's.
pub fn held(brdf: &Brdf) -> Brdf {
    if brdf.alpha >= NEAR_MIRROR_ALPHA { *brdf } else { Brdf { alpha: 0.0, ..*brdf } }
}

/// The mean of BRDFs: of every reflectance, and of roughness over those that have a lobe. Among these mirrors reflect
/// diffusely alone.
pub fn average<'a>(brdfs: impl Iterator<Item = &'a Brdf>, count: usize) -> Brdf {
    let mut sum =
        Brdf { diffuse: Vec3::ZERO, alpha: 0.0, f0: Vec3::ZERO, f90: 0.0, dielectric_f0: 0.0, dielectric_f90: 0.0 };
    let (mut roughness, mut lobes) = (0.0, 0);
    let mut mirrors = (Vec3::ZERO, 0.0);
    for brdf in brdfs.map(held) {
        sum.diffuse += brdf.diffuse;
        sum.dielectric_f0 += brdf.dielectric_f0;
        sum.dielectric_f90 += brdf.dielectric_f90;
        if brdf.has_lobe() {
            sum.f0 += brdf.f0;
            sum.f90 += brdf.f90;
            roughness += brdf.alpha.sqrt();
            lobes += 1;
        } else {
            mirrors.0 += brdf.f0;
            mirrors.1 += brdf.f90;
        }
    }
    if lobes == 0 {
        (sum.f0, sum.f90) = mirrors;
    }
    let share = 1.0 / count as f32;
    Brdf {
        diffuse: sum.diffuse * share,
        alpha: if lobes > 0 { (roughness / lobes as f32).powi(2) } else { 0.0 },
        f0: sum.f0 * share,
        f90: sum.f90 * share,
        dielectric_f0: sum.dielectric_f0 * share,
        dielectric_f90: sum.dielectric_f90 * share,
    }
}
