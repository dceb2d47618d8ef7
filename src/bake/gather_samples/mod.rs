//! Gather samples: surface points that represent an area and store its outgoing radiance as a few coefficients.
//!
//! [`GatherSamples::place`] also evaluates materials and textures: at each candidate point, by [`Place::surface`] with
//! footprint 0, which ends in [`Material::evaluate`](crate::scene::Material::evaluate). A sample's BRDF is the
//! [`average`] over the candidates of its cluster.

mod clusters;
pub mod light_rays;
mod surface_points;

use bytemuck::{Pod, Zeroable};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use self::surface_points::{Drawn, Patch, Place, Surfaces, Visited, is_back, is_from_behind, sides};

use self::clusters::Clusters;
use self::surface_points::is_enclosed;
use super::brdf_factors::{HarmonicProjection, NEAR_MIRROR_ALPHA};
use crate::physics::sequence::Points;
use crate::scene::{Material, Scene};
use crate::shared::Brdf;
use crate::storage::pods;
use crate::trace::bvh::TracedScene;
use crate::trace::packet::{PACKET_SIZE, SamplePacket};
use crate::trace::point_tree::{Point, PointTree, point};
use crate::trace::surface::SurfacePoint;

/// How gather samples are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placement {
    /// Random, uniform by area [Yang 2007, Section 4.1].
    Random,
    /// One sample in each of `count` compact clusters of the surface.
    Clustered {
        /// Points per cluster at which incident light is evaluated: 1 to 16.
        points: usize,
    },
}

/// One gather sample; mesh space.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct GatherSample {
    pub position: Vec3,
    /// Mesh space.
    pub area: f32,
    /// Unit; directions are expressed in the frame that [`GatherSample::frame`] returns.
    pub normal: Vec3,
    /// The mesh's triangle that `position` lies on.
    pub triangle: u32,
    /// Emitted radiance, the same in all directions.
    pub emission: Vec3,
    /// Index into the scene's materials; that of the central point if the sample covers several.
    pub material: u32,
    /// BRDF for light reflected by surfaces, averaged over its area. Excludes lobes narrower than
    /// [`NEAR_MIRROR_ALPHA`], which paths follow instead.
    pub brdf: Brdf,
    /// BRDF for light from light sources, averaged likewise. Paths cannot hit these sources, so narrow lobes are
    /// included, widened to what the basis can represent, with the same reflectance.
    pub direct_brdf: Brdf,
}

/// A point of a gather sample's area; mesh space.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct GatherPoint {
    /// Origin of rays, above the surface by [`SurfacePoint::lift`].
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit.
    pub geometric_normal: Vec3,
}

/// All gather samples of a scene, in the leaf order of a balanced tree. A node with samples `first..end` is split into
/// two children at [`crate::trace::point_tree::middle`].
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GatherSamples {
    #[serde(with = "pods")]
    pub samples: Vec<GatherSample>,
    /// `points_per_sample` points per sample; a sample receives the mean over its points.
    #[serde(with = "pods")]
    pub points: Vec<GatherPoint>,
    pub points_per_sample: usize,
    /// Group of each material. The samples of a group represent only surfaces of its materials. Empty: all are in one
    /// group.
    pub groups: Vec<u32>,
}

/// Candidate points per cluster.
const CANDIDATES: usize = 32;

/// Mean cosine of uniform illumination, where the albedo of a candidate is evaluated.
const MEAN_COSINE: f32 = 2.0 / 3.0;

/// A random point of the surface.
struct Candidate {
    triangle: u32,
    /// The area it represents, in mesh space.
    area: f64,
    /// Light that reaches the picture from that area: its weight in the sample's averages. Hidden surfaces hardly
    /// darken visible ones.
    light: f64,
    surface: SurfacePoint,
}

impl GatherSamples {
    /// At most `count` samples: fewer if less surface reflects light. Deterministic for a given `seed`.
    pub fn place(scene: &TracedScene, surfaces: &Surfaces, placement: Placement, count: usize, seed: u64) -> Self {
        match placement {
            Placement::Random => random(scene, surfaces, count, seed),
            Placement::Clustered { points } => clustered(scene, surfaces, count, points, seed),
        }
    }

    pub fn len(&self) -> usize {
        self.samples.len()
    }

    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Mesh space.
    pub fn area(&self) -> f64 {
        self.samples.iter().map(|s| f64::from(s.area)).sum()
    }

    /// All points, in the layout of the shadow tracer.
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

    /// The group of gather samples that surfaces of a material read.
    pub fn group(&self, material: u32) -> u32 {
        self.groups.get(material as usize).copied().unwrap_or(0)
    }

    /// Sorts samples, each with its points, into tree order.
    fn in_tree_order(
        samples: Vec<(GatherSample, Vec<GatherPoint>)>,
        points_per_sample: usize,
        groups: Vec<u32>,
    ) -> Self {
        let length = normal_length(samples.iter().map(|(s, _)| s.area));
        let places: Vec<_> = samples.iter().map(|(s, _)| point(s.position, s.normal, length)).collect();
        let tree = PointTree::new(&places);
        let in_order = || tree.order().iter().map(|&i| &samples[i as usize]);
        Self {
            samples: in_order().map(|(sample, _)| *sample).collect(),
            points: in_order().flat_map(|(_, points)| points.iter().copied()).collect(),
            points_per_sample,
            groups,
        }
    }
}

/// Length of normals in [`point`] for samples of such areas: twice their mean width, which is scale-invariant.
fn normal_length(areas: impl ExactSizeIterator<Item = f32>) -> f32 {
    let count = areas.len().max(1) as f64;
    2.0 * (areas.map(|area| f64::from(area.sqrt())).sum::<f64>() / count) as f32
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
        let SurfacePoint { normal, geometric_normal, .. } = *surface;
        Self { position: surface.lifted(), normal, geometric_normal }
    }

    /// The frame of its sample, rotated so that its normal is the point's own.
    pub fn frame(&self, sample: &GatherSample) -> [Vec3; 3] {
        turned(sample.frame(), self.normal)
    }
}

/// A sample's frame under the smallest rotation that takes its normal to `normal`.
fn turned([s, t, n]: [Vec3; 3], normal: Vec3) -> [Vec3; 3] {
    let turn = glam::Quat::from_rotation_arc(n, normal);
    [turn * s, turn * t, normal]
}

fn random(scene: &Scene, surfaces: &Surfaces, count: usize, seed: u64) -> GatherSamples {
    let area = (surfaces.area() / count as f64) as f32;
    let sample = |place: &Place| {
        let surface = place.surface(scene, area.sqrt());
        let SurfacePoint { position, normal, emission, brdf, material, .. } = surface;
        let (triangle, area) = (place.triangle, area * place.coverage(scene));
        let sample = GatherSample { position, area, normal, triangle, emission, material, brdf, direct_brdf: brdf };
        (sample, vec![GatherPoint::new(&surface)])
    };
    let places = surfaces.random(Points::new(seed, 0), count);
    let samples = places.par_iter().filter(|place| !place.is_hole(scene)).map(sample).collect();
    GatherSamples::in_tree_order(samples, 1, Vec::new())
}

fn clustered(
    scene: &TracedScene,
    surfaces: &Surfaces,
    count: usize,
    points_per_sample: usize,
    seed: u64,
) -> GatherSamples {
    let candidate_count = count * CANDIDATES;
    let candidates: Vec<Candidate> = surfaces
        .stratified(Points::new(seed, 0), candidate_count)
        .into_par_iter()
        .enumerate()
        .filter(|(_, drawn)| !drawn.place.is_hole(scene))
        .map(|(i, Drawn { place, area, light })| {
            // Footprint 0: texels are averaged over candidates, as a filtered texel can include those of other
            // surfaces.
            let surface = place.surface(scene, 0.0);
            // A blending surface is hit by fewer rays and emits proportionally less.
            (i, Candidate { triangle: place.triangle, area: area * f64::from(surface.coverage), light, surface })
        })
        .filter(|(i, Candidate { surface, .. })| {
            carries_light(surface) && !is_enclosed(scene, surface, Points::new(seed, 1 + *i as u64))
        })
        .map(|(_, candidate)| candidate)
        .collect();
    let length = normal_length(candidates.iter().map(|c| c.area as f32 * CANDIDATES as f32));
    let places: Vec<_> = candidates.par_iter().map(|c| point(c.surface.position, c.surface.normal, length)).collect();
    let (groups, grouped) = groups(scene, &candidates);
    let in_all = candidates.len().max(1);
    let mut done = 0;
    // Samples in proportion to each group's candidates, and at least one.
    let clusters: Vec<(Vec<u32>, Point)> = grouped
        .into_iter()
        .flat_map(|members| {
            let before = done * count / in_all;
            done += members.len();
            let here: Vec<Point> = members.iter().map(|&i| places[i as usize]).collect();
            let clusters = Clusters::new(&here, (done * count / in_all - before).max(1));
            let of_all = |cluster: usize| clusters.members(cluster).iter().map(|&i| members[i as usize]).collect();
            (0..clusters.len()).map(|cluster| (of_all(cluster), clusters.means[cluster])).collect::<Vec<_>>()
        })
        .collect();
    let sample = |(members, mean): &(Vec<u32>, Point)| {
        let distance2 =
            |&&i: &&u32| -> f32 { places[i as usize].iter().zip(mean).map(|(a, b)| (a - b) * (a - b)).sum() };
        let nearest = members.iter().min_by(|a, b| distance2(a).total_cmp(&distance2(b))).expect("none is empty");
        let Candidate { triangle, surface: centre, .. } = &candidates[*nearest as usize];
        let of_members = || members.iter().map(|&i| &candidates[i as usize]);
        let area: f64 = of_members().map(|c| c.area).sum();
        let light: f64 = of_members().map(|c| c.light).sum();
        let weight = |c: &Candidate| (c.light / light) as f32;
        let normal: Vec3 = of_members().map(|c| weight(c) * c.surface.normal).sum();
        let sample = GatherSample {
            position: centre.position,
            area: area as f32,
            normal: normal.try_normalize().unwrap_or(centre.normal),
            triangle: *triangle,
            material: centre.material,
            emission: of_members().map(|c| weight(c) * c.surface.emission).sum::<Vec3>(),
            brdf: average(of_members().map(|c| (narrow_lobe_as_mirror(&c.surface.brdf), c.light))),
            direct_brdf: average(of_members().map(|c| (widened(&c.surface.brdf), c.light))),
        };
        // Light on dark texels is not reflected, so that points are weighted by albedo too.
        let reflected = |c: &Candidate| {
            let albedo = HarmonicProjection::get().albedo(&c.surface.brdf, MEAN_COSINE).element_sum();
            c.light * f64::from(albedo.max(f32::MIN_POSITIVE))
        };
        // Members are in tree order: points at equal steps of cumulative weight are spread over the cluster.
        let step = of_members().map(reflected).sum::<f64>() / points_per_sample as f64;
        let mut points = Vec::with_capacity(points_per_sample);
        let mut covered = 0.0;
        for member in of_members() {
            covered += reflected(member) / step;
            while points.len() < points_per_sample && points.len() as f64 + 0.5 < covered {
                points.push(GatherPoint::new(&member.surface));
            }
        }
        // Rounding can omit the last point.
        points.resize(points_per_sample, GatherPoint::new(centre));
        (sample, points)
    };
    GatherSamples::in_tree_order(clusters.par_iter().map(sample).collect(), points_per_sample, groups)
}

/// Materials with enough candidates for a sample get their own samples: the radiance of a dark wall says nothing about
/// the white skirting in front of it. So do emissive ones, which are lights of their own. All other materials form one
/// group. Returns the group of each material and the candidates of each group.
fn groups(scene: &Scene, candidates: &[Candidate]) -> (Vec<u32>, Vec<Vec<u32>>) {
    let mut members = vec![Vec::new(); scene.materials.len()];
    candidates.iter().enumerate().for_each(|(i, c)| members[c.surface.material as usize].push(i as u32));
    let mut grouped = vec![Vec::new()];
    let group = |(material, members): (&Material, Vec<u32>)| {
        if members.is_empty() || members.len() < CANDIDATES && material.emissive == Vec3::ZERO {
            grouped[0].extend(members);
            return 0;
        }
        grouped.push(members);
        grouped.len() as u32 - 1
    };
    let groups = scene.materials.iter().zip(members).map(group).collect();
    grouped.retain(|members| !members.is_empty());
    (groups, grouped)
}

/// Whether a surface emits or reflects light that a sample can store.
pub fn carries_light(surface: &SurfacePoint) -> bool {
    surface.emission != Vec3::ZERO || surface.brdf.reflects_directly()
}

/// The part of a BRDF that a gather sample stores: a lobe so narrow that paths follow it is replaced by a perfect
/// mirror.
pub fn narrow_lobe_as_mirror(brdf: &Brdf) -> Brdf {
    if brdf.alpha >= NEAR_MIRROR_ALPHA { *brdf } else { Brdf { alpha: 0.0, ..*brdf } }
}

/// A BRDF with a lobe no narrower than [`NEAR_MIRROR_ALPHA`]; perfect mirrors are unchanged.
fn widened(brdf: &Brdf) -> Brdf {
    if brdf.has_lobe() { Brdf { alpha: brdf.alpha.max(NEAR_MIRROR_ALPHA), ..*brdf } } else { *brdf }
}

/// The weighted mean of BRDFs. Reflectances are averaged over all of them, and roughness over those with a lobe. If
/// there is any lobe, mirrors contribute only their diffuse part.
pub fn average(brdfs: impl Iterator<Item = (Brdf, f64)>) -> Brdf {
    let (mut all, mut diffuse, mut dielectric) = (0.0, DVec3::ZERO, DVec2::ZERO);
    // F0 and F90, of lobes and of mirrors.
    let (mut lobes, mut mirrors) = ([DVec3::ZERO; 2], [DVec3::ZERO; 2]);
    let (mut roughness, mut rough) = (0.0, 0.0);
    for (brdf, weight) in brdfs {
        all += weight;
        diffuse += weight * brdf.diffuse.as_dvec3();
        dielectric += weight * DVec2::new(brdf.dielectric_f0.into(), brdf.dielectric_f90.into());
        let specular = [brdf.f0, Vec3::splat(brdf.f90)].map(|f| weight * f.as_dvec3());
        let sums = if brdf.has_lobe() { &mut lobes } else { &mut mirrors };
        sums.iter_mut().zip(specular).for_each(|(sum, f)| *sum += f);
        if brdf.has_lobe() {
            roughness += weight * f64::from(brdf.alpha.sqrt());
            rough += weight;
        }
    }
    let [f0, f90] = if rough > 0.0 { lobes } else { mirrors }.map(|f| (f / all).as_vec3());
    let dielectric = (dielectric / all).as_vec2();
    Brdf {
        diffuse: (diffuse / all).as_vec3(),
        alpha: if rough > 0.0 { (roughness / rough).powi(2) as f32 } else { 0.0 },
        f0,
        f90: f90.x,
        dielectric_f0: dielectric.x,
        dielectric_f90: dielectric.y,
    }
}
