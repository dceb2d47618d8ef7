//! Gather samples for clusters of the surface.
//!
//! Who looks at a surface [reads](super::cells) a mean over a few samples. So that no light is lost between them, a sample
//! receives what light does at the same places, by the same weights: as these sum to one everywhere, the light that all
//! readers get is what those places have, however unlike neighbouring samples are. Places count by the light that the
//! picture gets from there.

use glam::Vec3;
use rayon::prelude::*;

use super::cells::Cells;
use super::clusters::Clusters;
use super::surface_points::{Drawn, Place, Surfaces, is_enclosed};
use super::{
    GatherPoint, GatherSample, GatherSamples, average, carries_light, held, normal_length, tree_order, widened,
};
use crate::bake::bvh::Bvh;
use crate::bake::point_tree::{Point, point};
use crate::bake::surface::SurfacePoint;
use crate::scene::Scene;
use crate::sequence::Points;

/// Points of the surface for each cluster.
const CANDIDATES: usize = 32;

/// One of these.
struct Candidate {
    place: Place,
    /// What it stands for, in mesh space.
    area: f64,
    /// How much light comes from there: its weight in what a sample's surface is like and gets.
    light: f64,
    surface: SurfacePoint,
}

/// A compact piece of surface.
struct Piece {
    /// Candidates, neighbours together.
    members: Vec<u32>,
    mean: Point,
}

/// A candidate, and the share of it that a sample gets.
type Share = (u32, f64);

pub fn clustered(
    scene: &Scene,
    bvh: &Bvh,
    surfaces: &Surfaces,
    count: usize,
    points_per_sample: usize,
    seed: u64,
) -> GatherSamples {
    let candidates = candidates(scene, bvh, surfaces, count * CANDIDATES, seed);
    let length = normal_length(candidates.iter().map(|c| c.area as f32 * CANDIDATES as f32));
    let places: Vec<_> = candidates.par_iter().map(|c| point(c.surface.position, c.surface.normal, length)).collect();
    let (groups, grouped) = groups(scene, &candidates);
    let pieces = pieces(&places, &grouped, count);
    let centres: Vec<_> = pieces.par_iter().map(|piece| centre(piece, &candidates, &places)).collect();
    let order = tree_order(&centres);
    let samples = order.iter().map(|&i| centres[i as usize]).collect();
    let mut samples = GatherSamples { samples, groups, points_per_sample, ..Default::default() };
    samples.cells = Cells::new(scene, &samples);
    let members: Vec<&[u32]> = order.iter().map(|&i| &pieces[i as usize].members[..]).collect();
    let shares = shares(&samples, &members, &candidates);
    let finish = |(sample, shares): (&mut GatherSample, &Vec<Share>)| {
        let weights = weights(shares, &candidates);
        fill(sample, shares, &weights, &candidates);
        points(shares, &weights, &candidates, points_per_sample)
    };
    let points: Vec<_> = samples.samples.par_iter_mut().zip(&shares).map(finish).collect();
    samples.points = points.concat();
    samples
}

fn candidates(scene: &Scene, bvh: &Bvh, surfaces: &Surfaces, count: usize, seed: u64) -> Vec<Candidate> {
    surfaces
        .stratified(Points::new(seed, 0), count)
        .into_par_iter()
        .enumerate()
        .filter(|(_, drawn)| !drawn.place.is_hole(scene))
        .map(|(i, Drawn { place, area, light })| {
            // Texel by texel: a mean over many, in which those of other surfaces may lie beside, is made of all candidates.
            let surface = place.surface(scene, 0.0);
            // What blends meets fewer rays, and sends out as much less.
            (i, Candidate { place, area: area * f64::from(surface.coverage), light, surface })
        })
        .filter(|(i, Candidate { surface, .. })| {
            carries_light(surface) && !is_enclosed(scene, bvh, surface, Points::new(seed, 1 + *i as u64))
        })
        .map(|(_, candidate)| candidate)
        .collect()
}

/// Materials whose candidates are enough for a sample have samples of their own: those of a dark wall tell nothing of the white
/// skirting before it. All others are one group. Returns each material's group, and each group's candidates.
fn groups(scene: &Scene, candidates: &[Candidate]) -> (Vec<u32>, Vec<Vec<u32>>) {
    let mut members = vec![Vec::new(); scene.materials.len()];
    candidates.iter().enumerate().for_each(|(i, c)| members[c.surface.material as usize].push(i as u32));
    let mut grouped = vec![Vec::new()];
    let group = |members: Vec<u32>| {
        if members.len() < CANDIDATES {
            grouped[0].extend(members);
            return 0;
        }
        grouped.push(members);
        grouped.len() as u32 - 1
    };
    let groups = members.into_iter().map(group).collect();
    grouped.retain(|members| !members.is_empty());
    (groups, grouped)
}

/// About `count` pieces: as many of each group as it has of all candidates, and one at least.
fn pieces(places: &[Point], grouped: &[Vec<u32>], count: usize) -> Vec<Piece> {
    let mut done = 0;
    let mut pieces = Vec::with_capacity(count);
    for members in grouped {
        let before = done * count / places.len();
        done += members.len();
        let here: Vec<Point> = members.iter().map(|&i| places[i as usize]).collect();
        let clusters = Clusters::new(&here, (done * count / places.len() - before).max(1));
        pieces.extend((0..clusters.len()).map(|cluster| Piece {
            members: clusters.members(cluster).iter().map(|&i| members[i as usize]).collect(),
            mean: clusters.means[cluster],
        }));
    }
    pieces
}

/// A sample where the middle of a piece is.
fn centre(piece: &Piece, candidates: &[Candidate], places: &[Point]) -> GatherSample {
    let distance2 =
        |&&i: &&u32| -> f32 { places[i as usize].iter().zip(&piece.mean).map(|(a, b)| (a - b) * (a - b)).sum() };
    let nearest = piece.members.iter().min_by(|a, b| distance2(a).total_cmp(&distance2(b))).expect("none is empty");
    let Candidate { place, surface, .. } = &candidates[*nearest as usize];
    let of_members = || piece.members.iter().map(|&i| &candidates[i as usize]);
    let normal: Vec3 = of_members().map(|c| c.area as f32 * c.surface.normal).sum();
    GatherSample {
        position: surface.position,
        area: of_members().map(|c| c.area).sum::<f64>() as f32,
        normal: normal.try_normalize().unwrap_or(surface.normal),
        triangle: place.triangle,
        material: surface.material,
        emission: surface.emission,
        brdf: surface.brdf,
        lit: surface.brdf,
    }
}

/// What of candidates each sample gets: as much as those who look at them read of it. `members` are each sample's own, which it
/// keeps where nobody reads any.
fn shares(samples: &GatherSamples, members: &[&[u32]], candidates: &[Candidate]) -> Vec<Vec<Share>> {
    let mut shares = vec![Vec::new(); samples.len()];
    for (own, members) in members.iter().enumerate() {
        for &member in *members {
            let place = &candidates[member as usize].place;
            let cell = samples.cells.index(place).map(|cell| samples.cells.get(cell)).filter(|cell| !cell.is_black());
            match cell {
                Some(cell) => cell.read().for_each(|(sample, weight)| shares[sample].push((member, weight.into()))),
                None => shares[own].push((member, 1.0)),
            }
        }
    }
    for (shares, members) in shares.iter_mut().zip(members).filter(|(shares, _)| shares.is_empty()) {
        shares.extend(members.iter().map(|&member| (member, 1.0)));
    }
    shares
}

/// The weights by which a sample is the mean of its shares.
fn weights(shares: &[Share], candidates: &[Candidate]) -> Vec<f64> {
    let all = || shares.iter().map(|&(i, share)| (&candidates[i as usize], share));
    let area: f64 = all().map(|(c, share)| share * c.area).sum();
    let light: f64 = all().map(|(c, share)| share * c.light).sum();
    all().map(|(c, share)| share * c.area * evened(c.light / c.area * area / light)).collect()
}

/// Weight of a place whose area brings `ratio` times the light that its sample's area brings on average. Visits are few: what
/// differs by a quarter counts as alike, so that all energy is there where everything is seen alike; what is hidden
/// counts less and less, lest what nobody sees darkens what is seen.
fn evened(ratio: f64) -> f64 {
    if ratio < ALIKE { ratio / ALIKE } else { (ratio * ALIKE).max(1.0) }
}

/// See [`evened`].
const ALIKE: f64 = 0.8;

/// Makes a sample the mean of its shares.
fn fill(sample: &mut GatherSample, shares: &[Share], weights: &[f64], candidates: &[Candidate]) {
    let all = || shares.iter().zip(weights).map(|(&(i, _), &weight)| (&candidates[i as usize], weight));
    let sum: f64 = weights.iter().sum();
    sample.area = shares.iter().map(|&(i, share)| share * candidates[i as usize].area).sum::<f64>() as f32;
    sample.emission = all().map(|(c, weight)| (weight / sum) as f32 * c.surface.emission).sum();
    sample.brdf = average(all().map(|(c, weight)| (held(&c.surface.brdf), weight)));
    sample.lit = average(all().map(|(c, weight)| (widened(&c.surface.brdf), weight)));
}

/// `count` of a sample's candidates, picked evenly among their weights: as neighbours lie together, they are spread over all.
fn points(shares: &[Share], weights: &[f64], candidates: &[Candidate], count: usize) -> Vec<GatherPoint> {
    let sum: f64 = weights.iter().sum();
    let mut points = Vec::with_capacity(count);
    let mut covered = 0.0;
    for (&(candidate, _), weight) in shares.iter().zip(weights) {
        covered += weight * count as f64 / sum;
        while points.len() < count && points.len() as f64 + 0.5 < covered {
            points.push(GatherPoint::new(&candidates[candidate as usize].surface));
        }
    }
    // Where rounding leaves the last one out.
    let last = &candidates[shares[shares.len() - 1].0 as usize].surface;
    points.resize(count, GatherPoint::new(last));
    points
}
