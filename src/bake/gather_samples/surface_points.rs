//! Points distributed over the surfaces of a scene in proportion to area or to a given density.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::physics::brdf::cosine_direction;
use crate::physics::sequence;
use crate::scene::Scene;
use crate::trace::bvh::{Hit, TracedScene, coverage};
use crate::trace::surface::SurfacePoint;

/// A point on one side of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Weights of the second and third vertex.
    pub barycentric: Vec2,
    /// The side on which the vertices appear clockwise: only for double-sided materials.
    pub back: bool,
}

/// A side of a triangle, or a part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Patch {
    /// Twice the triangle's index, plus 1 for its back.
    pub side: u32,
    /// 1: the whole side. Part p has four quarters, cut between the midpoints of its edges: 4p to 4p + 3, the last in
    /// the centre.
    pub part: u32,
}

impl Patch {
    /// Maximum number of subdivisions of a side.
    pub const DEEPEST: u32 = 14;

    /// The part of a side, after `depth` subdivisions, that contains a point.
    pub fn around(side: u32, barycentric: Vec2, depth: u32) -> Self {
        let (mut at, mut part) = (barycentric, 1);
        for _ in 0..depth {
            at *= 2.0;
            let quarter = match at {
                Vec2 { x, .. } if x >= 1.0 => 1,
                Vec2 { y, .. } if y >= 1.0 => 2,
                Vec2 { x, y } if x + y < 1.0 => 0,
                _ => 3,
            };
            at = match quarter {
                0 => at,
                1 => at - Vec2::X,
                2 => at - Vec2::Y,
                _ => 1.0 - at,
            };
            part = 4 * part + quarter;
        }
        Self { side, part }
    }
}

/// The sides of triangles that reflect light, in the leaf order of the BVH, so that neighbours are near each other.
/// Each comes with its area in mesh space; double-sided triangles have two sides.
pub fn sides(scene: &TracedScene) -> Vec<(u32, f64)> {
    let of_triangle = |triangle: u32| {
        let [a, b, c] = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize].as_dvec3());
        let area = 0.5 * (b - a).cross(c - a).length();
        let material = &scene.materials[scene.mesh.triangle_materials[triangle as usize] as usize];
        (0..1 + u32::from(material.double_sided)).map(move |back| (2 * triangle + back, area))
    };
    scene.bvh.triangle_order().flat_map(of_triangle).collect()
}

/// Surface pieces with a sampling density.
pub struct Surfaces {
    /// Area of each piece, in mesh space.
    areas: Vec<f64>,
    /// Inclusive prefix sums of area times density.
    cumulative: Vec<f64>,
    points: Points,
}

/// Where points lie on a piece.
enum Points {
    /// Anywhere: pieces are whole sides.
    Sides(Vec<u32>),
    /// At visited places: those of piece p are `first[p]..first[p + 1]`. `until` has the inclusive prefix sums of their
    /// areas.
    Visited { first: Vec<usize>, places: Vec<Visited>, until: Vec<f64> },
}

/// A place that eye paths reached.
#[derive(Clone, Copy, Debug)]
pub struct Visited {
    pub place: Place,
    /// Its share of the piece's area, in mesh space.
    pub area: f64,
    /// Light that paths carry from there to the picture; not 0.
    pub light: f64,
}

/// A sampled point of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Drawn {
    pub place: Place,
    /// The area it represents, in mesh space.
    pub area: f64,
    /// Light that reaches the picture from that area; if unknown, the area itself.
    pub light: f64,
}

impl Surfaces {
    /// All surfaces of a scene, at uniform density.
    pub fn even(scene: &TracedScene) -> Self {
        let sides = sides(scene).into_iter().filter(|&(_, area)| area > 0.0);
        let (sides, areas): (Vec<u32>, Vec<f64>) = sides.unzip();
        Self { cumulative: cumulative(areas.iter().copied()), areas, points: Points::Sides(sides) }
    }

    /// Pieces with area, relative density of points, and visited places. A point is placed at one of these places with
    /// a probability proportional to its area. Pieces without places are omitted.
    pub fn visited(pieces: Vec<(f64, f32, Vec<Visited>)>) -> Self {
        let (mut areas, mut needs, mut first, mut places) = (Vec::new(), Vec::new(), vec![0], Vec::new());
        for (area, density, visited) in pieces {
            if area > 0.0 && density > 0.0 && !visited.is_empty() {
                areas.push(area);
                needs.push(area * f64::from(density));
                places.extend(visited);
                first.push(places.len());
            }
        }
        let until =
            first.windows(2).flat_map(|p| cumulative(places[p[0]..p[1]].iter().map(|v: &Visited| v.area))).collect();
        Self { areas, cumulative: cumulative(needs.into_iter()), points: Points::Visited { first, places, until } }
    }

    /// In mesh space; double-sided triangles count twice.
    pub fn area(&self) -> f64 {
        self.areas.iter().sum()
    }

    /// Index of the piece at a fraction `share` of the cumulative density.
    fn at(&self, share: f64) -> usize {
        let at = share * self.cumulative[self.cumulative.len() - 1];
        self.cumulative.partition_point(|&sum| sum <= at).min(self.areas.len() - 1)
    }

    /// `count` independent random points; empty if there is no surface. Uniform by area for [`Self::even`] [Yang 2007,
    /// Section 4.1].
    pub fn random(&self, points: sequence::Points, count: usize) -> Vec<Place> {
        let place = |i: usize| {
            let [share, u, v, _] = points.at(0, i as u32);
            self.points.place(self.at(share), [u, v], 0.5).0
        };
        if self.areas.is_empty() { Vec::new() } else { (0..count).into_par_iter().map(place).collect() }
    }

    /// `count` points, one in each of `count` equal strata; empty if there is no surface. Steps within a piece start at
    /// a random place, because its texture may be as regular as they are. A piece's area and light are divided evenly
    /// among its points; those of pieces without points go to the next piece with points.
    pub fn stratified(&self, points: sequence::Points, count: usize) -> Vec<Drawn> {
        if self.areas.is_empty() {
            return Vec::new();
        }
        let piece = |i: usize| self.at((i as f64 + points.at(i as u32, 0)[0]) / count as f64);
        let pieces: Vec<usize> = (0..count).into_par_iter().map(piece).collect();
        let mut first = 0;
        let mut result = Vec::with_capacity(count);
        for of_piece in pieces.chunk_by(|a, b| a == b) {
            let (drawn, count_here) = (result.len(), of_piece.len());
            let end = if drawn + count_here == count { self.areas.len() } else { of_piece[0] + 1 };
            let share = 1.0 / count_here as f64;
            let area = share * self.areas[first..end].iter().sum::<f64>();
            let start = points.at(drawn as u32, 0)[3];
            result.extend((0..count_here).map(|i| {
                let [_, u, v, _] = points.at((drawn + i) as u32, 0);
                let (place, light) = self.points.place(of_piece[0], [u, v], (i as f64 + start) * share);
                Drawn { place, area, light: light * area }
            }));
            first = end;
        }
        result
    }
}

impl Points {
    /// A point of a piece, and the light per unit area there. A whole side is sampled by a point [u, v] of the unit
    /// square, visited places by a fraction `share` of their area.
    fn place(&self, piece: usize, [u, v]: [f64; 2], share: f64) -> (Place, f64) {
        match self {
            Self::Sides(sides) => {
                // Folding the square along its diagonal preserves neighbourhoods.
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let (side, barycentric) = (sides[piece], Vec2::new(u as f32, v as f32));
                (Place { triangle: side / 2, barycentric, back: side % 2 == 1 }, 1.0)
            }
            Self::Visited { first, places, until } => {
                let here = first[piece]..first[piece + 1];
                let at = share * until[here.end - 1];
                let past = until[here.clone()].partition_point(|&area| area <= at).min(here.len() - 1);
                let Visited { place, area, light } = places[here.start + past];
                (place, light / area)
            }
        }
    }
}

fn cumulative(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut total = 0.0;
    values
        .map(|value| {
            total += value;
            total
        })
        .collect()
}

impl Place {
    /// The surface at the point; texels are averaged over `footprint`, in mesh space.
    pub fn surface(&self, scene: &Scene, footprint: f32) -> SurfacePoint {
        let [a, b, c] = scene.mesh.triangles[self.triangle as usize].map(|v| scene.mesh.positions[v as usize]);
        let normal = (b - a).cross(c - a);
        let seen_along = if self.back { normal } else { -normal };
        let hit = Hit { triangle: self.triangle, barycentric: self.barycentric, distance: 0.0 };
        SurfacePoint::new(scene, &hit, seen_along, footprint)
    }

    /// Coverage of the surface at the point.
    pub fn coverage(&self, scene: &Scene) -> f32 {
        coverage(scene, self.triangle, self.barycentric)
    }

    /// Whether the surface has a hole there.
    pub fn is_hole(&self, scene: &Scene) -> bool {
        self.coverage(scene) == 0.0
    }
}

/// Whether a point lies inside a solid, where there is no light: most of its rays hit the backs of single-sided faces.
///
/// Four rays usually suffice. If any of them hits a back, twelve more are traced.
pub fn is_enclosed(scene: &TracedScene, point: &SurfacePoint, points: sequence::Points) -> bool {
    let origin = point.position + point.geometric_normal * scene.bvh.shadow_offset(0.0);
    let (s, t) = point.geometric_normal.any_orthonormal_pair();
    let backs = |rays: std::ops::Range<u32>| {
        let meets_back = |&i: &u32| {
            let [u, v, ..] = points.at(i, 0);
            let d = cosine_direction(u, v).as_vec3();
            let direction = s * d.x + t * d.y + point.geometric_normal * d.z;
            scene.closest_hit(origin, direction, f32::INFINITY).is_some_and(|hit| is_back(scene, &hit, direction))
        };
        rays.filter(meets_back).count()
    };
    match backs(0..4) {
        0 => false,
        some => some + backs(4..16) > 8,
    }
}

/// Whether a ray hit the back of a single-sided face, which is black and reflects nothing.
pub fn is_back(scene: &Scene, hit: &Hit, direction: Vec3) -> bool {
    let material = scene.mesh.triangle_materials[hit.triangle as usize];
    !scene.materials[material as usize].double_sided && is_from_behind(scene, hit.triangle, direction)
}

/// Whether a direction and a triangle's geometric normal lie in the same hemisphere.
pub fn is_from_behind(scene: &Scene, triangle: u32, direction: Vec3) -> bool {
    let [a, b, c] = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize]);
    (b - a).cross(c - a).dot(direction) > 0.0
}
