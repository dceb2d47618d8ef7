//! Closed surfaces that face inwards, as some exporters write them; they would be black from every direction.
//!
//! A surface is a set of faces connected by their positions. It faces inwards if it is closed and its signed volume is
//! negative. Two kinds of such surfaces are intended and stay unchanged: those around other surfaces (the walls of a
//! room), and those inside a closed surface that is not much larger (the inside of a vessel).

use std::collections::HashMap;
use std::ops::Range;

use glam::DVec3;
use tobj::Mesh;

/// What to flip, for each polygon.
pub struct FlippedFaces {
    pub winding: Vec<bool>,
    /// Whether its normals point inwards too.
    pub normals: Vec<bool>,
    pub surface_count: usize,
}

/// One connected surface.
#[derive(Clone)]
struct Surface {
    /// Six times the signed volume, relative to `origin`.
    volume: f64,
    /// Twice the face areas, summed as vectors and as scalars; the vector sum of a closed surface is zero.
    area: DVec3,
    total_area: f64,
    origin: DVec3,
    low: DVec3,
    high: DVec3,
    /// Sum of n . face area: positive if the normals agree with the faces; 0 without normals.
    agreement: f64,
}

/// Tolerance for a closed surface, relative to its area and its box's volume: rounding in the file.
const ROUNDING: f64 = 1e-4;
/// Minimum volume of a vessel's inside, relative to its outside.
const VESSEL: f64 = 0.125;
/// Maximum number of pairs of surfaces to compare; scattered triangles are surfaces too.
const MAX_PAIRS: usize = 1 << 24;

/// Finds the polygons to flip; `polygons` are ranges of the mesh's corners.
pub fn flipped_faces(mesh: &Mesh, polygons: &[Range<usize>]) -> FlippedFaces {
    let surface_of = surfaces(mesh, polygons);
    let count = surface_of.iter().map(|&s| s as usize + 1).max().unwrap_or(0);
    let surfaces = measure(mesh, polygons, &surface_of, count);
    let may_flip: Vec<bool> = surfaces.iter().map(Surface::faces_inwards).collect();
    let flips = match may_flip.contains(&true) {
        true => {
            let closed = closed(mesh, polygons, &surface_of, &may_flip);
            let inwards: Vec<usize> = (0..count).filter(|&s| may_flip[s] && closed[s]).collect();
            let is_many = inwards.len().saturating_mul(count) > MAX_PAIRS;
            let mut flips = vec![false; count];
            inwards.iter().filter(|&&s| !is_many && !is_intended(&surfaces, s)).for_each(|&s| flips[s] = true);
            flips
        }
        false => vec![false; count],
    };
    let of = |flag: &dyn Fn(usize) -> bool| surface_of.iter().map(|&s| flag(s as usize)).collect();
    FlippedFaces {
        winding: of(&|s| flips[s]),
        normals: of(&|s| flips[s] && surfaces[s].agreement > 0.0),
        surface_count: flips.iter().filter(|&&t| t).count(),
    }
}

impl Surface {
    /// Whether its volume is clearly negative, and its area is that of a closed surface.
    fn faces_inwards(&self) -> bool {
        let size = self.high - self.low;
        self.is_closed() && self.volume < -ROUNDING * size.element_product().abs() && self.volume < 0.0
    }

    /// A necessary condition: the vector areas cancel.
    fn is_closed(&self) -> bool {
        self.area.length() <= ROUNDING * self.total_area
    }

    fn contains(&self, other: &Self) -> bool {
        self.low.cmple(other.low).all() && self.high.cmpge(other.high).all()
    }
}

/// Whether an inward-facing surface is intended: it encloses others, or is the inside of one.
fn is_intended(surfaces: &[Surface], inwards: usize) -> bool {
    let this = &surfaces[inwards];
    surfaces.iter().enumerate().filter(|(other, _)| *other != inwards).any(|(_, other)| {
        let is_vessel = other.volume > 0.0 && other.is_closed() && -this.volume >= VESSEL * other.volume;
        this.contains(other) || is_vessel && other.contains(this)
    })
}

/// The surface index of each polygon.
fn surfaces(mesh: &Mesh, polygons: &[Range<usize>]) -> Vec<u32> {
    let welded = weld(mesh);
    let mut parents: Vec<u32> = (0..welded.len() as u32).collect();
    fn root(parents: &mut [u32], mut i: u32) -> u32 {
        while parents[i as usize] != i {
            parents[i as usize] = parents[parents[i as usize] as usize];
            i = parents[i as usize];
        }
        i
    }
    for polygon in polygons {
        let corners = &mesh.indices[polygon.clone()];
        let first = root(&mut parents, welded[corners[0] as usize]);
        for &corner in &corners[1..] {
            let other = root(&mut parents, welded[corner as usize]);
            parents[other as usize] = first;
        }
    }
    let mut numbers = HashMap::new();
    let number = |polygon: &Range<usize>| {
        let next = numbers.len() as u32;
        *numbers.entry(root(&mut parents, welded[mesh.indices[polygon.start] as usize])).or_insert(next)
    };
    polygons.iter().map(number).collect()
}

/// For each position, the index of the first equal one.
fn weld(mesh: &Mesh) -> Vec<u32> {
    let mut firsts = HashMap::with_capacity(mesh.positions.len() / 3);
    let place = |p: &[f64]| [p[0], p[1], p[2]].map(|x| (x + 0.0).to_bits());
    let positions = mesh.positions.chunks_exact(3).zip(0u32..);
    positions.map(|(p, i)| *firsts.entry(place(p)).or_insert(i)).collect()
}

fn measure(mesh: &Mesh, polygons: &[Range<usize>], surface_of: &[u32], count: usize) -> Vec<Surface> {
    let (low, high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (area, origin) = (DVec3::ZERO, DVec3::NAN);
    let empty = Surface { volume: 0.0, area, total_area: 0.0, origin, low, high, agreement: 0.0 };
    let mut surfaces = vec![empty; count];
    let three = |values: &[f64], i: u32| DVec3::from_slice(&values[3 * i as usize..]);
    for (polygon, &surface) in polygons.iter().zip(surface_of) {
        let surface = &mut surfaces[surface as usize];
        let corners = &mesh.indices[polygon.clone()];
        let first = three(&mesh.positions, corners[0]);
        if surface.origin.is_nan() {
            surface.origin = first;
        }
        let mut of_face = DVec3::ZERO;
        for pair in corners[1..].windows(2) {
            let [b, c] = [pair[0], pair[1]].map(|i| three(&mesh.positions, i));
            of_face += (b - first).cross(c - first);
        }
        for &corner in corners {
            let position = three(&mesh.positions, corner);
            (surface.low, surface.high) = (surface.low.min(position), surface.high.max(position));
        }
        surface.volume += (first - surface.origin).dot(of_face);
        surface.area += of_face;
        surface.total_area += of_face.length();
        for &normal in mesh.normal_indices.get(polygon.clone()).unwrap_or_default() {
            let normal = mesh.normals.get(3 * normal as usize..).filter(|n| n.len() >= 3);
            surface.agreement += normal.map_or(0.0, |n| DVec3::from_slice(n).dot(of_face));
        }
    }
    surfaces
}

/// Which of the candidate surfaces are closed: each edge is traversed equally often in both directions.
fn closed(mesh: &Mesh, polygons: &[Range<usize>], surface_of: &[u32], in_question: &[bool]) -> Vec<bool> {
    let welded = weld(mesh);
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    let asked = || polygons.iter().zip(surface_of).filter(|(_, surface)| in_question[**surface as usize]);
    let edges_of = |polygon: &Range<usize>| {
        let corners: Vec<u32> = mesh.indices[polygon.clone()].iter().map(|&i| welded[i as usize]).collect();
        let next: Vec<u32> = corners.iter().copied().cycle().skip(1).take(corners.len()).collect();
        corners.into_iter().zip(next).filter(|(a, b)| a != b)
    };
    for (polygon, _) in asked() {
        for (a, b) in edges_of(polygon) {
            *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
        }
    }
    let mut closed = in_question.to_vec();
    for (polygon, &surface) in asked() {
        if edges_of(polygon).any(|(a, b)| edges[&(a.min(b), a.max(b))] != 0) {
            closed[surface as usize] = false;
        }
    }
    closed
}
