//! Aims: sampling of directions towards lights mirrored in glossy surfaces. Planar surfaces are here, curved ones in
//! `curves`.
//!
//! A light in front of a glossy face causes a caustic that next-event estimation cannot find and BRDF sampling rarely
//! hits: seen from a matt surface, it comes from the few directions in which the face mirrors the light, those towards
//! the light's mirror image. A fraction of the directions is sampled around them, with the width of the face's lobe.
//! Weighting by the density of the whole mixture keeps the estimate unbiased.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4};

use super::curves::Curve;
use super::lights::{Lamp, Lamps};
use crate::physics::brdf::{basis, specular_reflectance};
use crate::physics::light::incident;
use crate::scene::Scene;
use crate::shared::{Brdf, LIGHT_DIRECTIONAL};
use crate::trace::surface::{SurfacePoint, brdf};

/// Maximum alpha of a surface that is aimed at, glTF roughness 0.5. Caustics of rougher surfaces are too faint.
const MAX_ALPHA: f32 = 0.25;
/// Maximum number of pairs of light and face, largest faces first. Each pair costs time at every bounce.
const MAX_PAIRS: usize = 24;
/// Maximum number of pairs of light and curved surface.
const MAX_CURVES: usize = 8;
/// Minimum area of a surface, in squares of the scene's radius. Smaller ones reflect little light.
const MIN_AREA: f64 = 1e-3;
/// Maximum number of aims per surface point.
const MAX_AIMS: usize = 8;
/// Maximum distance of the mirror point from the edge of the face, in widths of the lobe. Beyond it less than a
/// thousandth of the lobe remains.
const MAX_OUTSIDE: f32 = 6.0;
/// Maximum fraction of directions that are sampled from aims.
const MAX_SHARE: f64 = 0.5;

/// Glossy surfaces and the lights that they can mirror.
pub(super) struct Faces {
    pairs: Vec<Pair>,
    curves: Vec<Curve>,
    /// Typical irradiance in the scene, to which the weights of aims are compared.
    typical: f64,
}

/// A light and a face that mirrors it.
struct Pair {
    lamp: usize,
    face: Face,
    /// Mirror image of the light's position; for a directional light, direction towards its mirror image.
    image: Vec3,
    /// Height of the light above the face.
    height: f32,
}

/// Bounding rectangle of coplanar triangles with one material.
#[derive(Clone)]
struct Face {
    normal: Vec3,
    centre: Vec3,
    tangents: [Vec3; 2],
    half_size: Vec2,
    brdf: Brdf,
}

/// Aims of one surface point.
#[derive(Default)]
pub(super) struct Aims {
    aims: [Aim; MAX_AIMS],
    count: usize,
    /// Fraction of directions that are sampled from aims.
    pub share: f64,
}

/// A distribution of directions around an axis.
#[derive(Clone, Copy, Default)]
pub(super) struct Aim {
    pub axis: DVec3,
    /// Tangent of the angle from the axis that contains half of the directions.
    pub width: f64,
    /// Estimated irradiance from there; after `fill`, its fraction of the sum of all aims.
    pub weight: f64,
}

impl Faces {
    pub fn new(scene: &Scene, lamps: &Lamps) -> Self {
        let (low, high) = scene.mesh.bounds();
        let radius = f64::from((high - low).length()) / 2.0;
        let mut faces = find_faces(scene, radius);
        faces.sort_by(|a, b| b.area().total_cmp(&a.area()));
        let mut pairs = Vec::new();
        for face in &faces {
            for (lamp, light) in lamps.lamps.iter().enumerate() {
                let Some((image, height)) = face.mirrored(light) else { continue };
                pairs.push(Pair { lamp, face: face.clone(), image, height });
            }
        }
        pairs.truncate(MAX_PAIRS);
        let glossy = |material: u32| glossy(scene, material);
        let mut curves = Curve::find(scene, glossy);
        curves.retain(|curve| curve.area > MIN_AREA * radius * radius);
        curves.sort_by(|a, b| b.area.total_cmp(&a.area));
        curves.truncate(MAX_CURVES / lamps.lamps.len().max(1));
        let arriving = |lamp: &Lamp| {
            let directional = lamp.packed.kind == LIGHT_DIRECTIONAL;
            let irradiance = if directional { 1.0 } else { f64::from(lamp.packed.strength) / (radius * radius) };
            lamp.scale.max_element() * irradiance
        };
        Self { pairs, curves, typical: lamps.lamps.iter().map(arriving).sum() }
    }

    /// Aims of a visible surface point, at planar and curved surfaces. After a bounce, caustics are blurred and aims at
    /// curved surfaces cost more than they save.
    pub fn aim(&self, lamps: &Lamps, point: &SurfacePoint) -> Aims {
        let mut aims = Aims::default();
        let curved =
            self.curves.iter().flat_map(|curve| lamps.lamps.iter().filter_map(move |lamp| curve.aim(lamp, point)));
        aims.fill(self.planar(lamps, point).chain(curved), self.typical);
        aims
    }

    /// Aims of a surface point after a bounce, only at planar surfaces.
    pub fn aim_at_planes(&self, aims: &mut Aims, lamps: &Lamps, point: &SurfacePoint) {
        aims.fill(self.planar(lamps, point), self.typical);
    }

    fn planar(&self, lamps: &Lamps, point: &SurfacePoint) -> impl Iterator<Item = Aim> {
        self.pairs.iter().filter_map(move |pair| pair.aim(&lamps.lamps[pair.lamp], point))
    }
}

impl Pair {
    fn aim(&self, lamp: &Lamp, point: &SurfacePoint) -> Option<Aim> {
        let Face { normal, centre, brdf, .. } = self.face;
        let height = normal.dot(point.position - centre);
        if height <= 1e-6 * self.face.half_size.max_element() {
            return None;
        }
        let directional = lamp.packed.kind == LIGHT_DIRECTIONAL;
        let to_image = if directional { self.image } else { self.image - point.position };
        if point.normal.dot(to_image) <= 0.0 {
            return None;
        }
        let axis = to_image.normalize_or_zero();
        let fall = -normal.dot(axis);
        if fall <= 0.0 {
            return None;
        }
        let to_face = height / fall;
        let mirror_point = point.position + axis * to_face;
        // The deflection of the path at the face is twice the tilt of the microfacet. Seen from the point, it is scaled
        // by the fraction of the path length that lies beyond the face.
        let behind = if directional { 1.0 } else { self.height / (self.height + height) };
        let width = 2.0 * brdf.alpha * behind;
        let outside = self.face.distance(mirror_point) / (width * to_face).max(f32::MIN_POSITIVE);
        if outside > MAX_OUTSIDE {
            return None;
        }
        // The beam diverges after the face as it did before.
        let cut = behind / (1.0 + outside * outside);
        let share = f64::from(point.normal.dot(axis) * cut * cut);
        let fresnel = specular_reflectance(&brdf, fall.into()).max_element();
        let arriving = incident(&lamp.packed, mirror_point.as_dvec3())?.irradiance * lamp.scale.max_element();
        let weight = arriving * fresnel * share;
        (weight > 0.0).then(|| Aim { axis: axis.as_dvec3().normalize(), width: width.into(), weight })
    }
}

impl Face {
    fn area(&self) -> f32 {
        4.0 * self.half_size.x * self.half_size.y
    }

    /// A light's mirror image and the light's height above the face; `None` if it lies behind the face.
    fn mirrored(&self, light: &Lamp) -> Option<(Vec3, f32)> {
        if light.packed.kind == LIGHT_DIRECTIONAL {
            let direction = -light.packed.direction;
            let height = self.normal.dot(direction);
            return (height > 0.0).then_some((direction - 2.0 * height * self.normal, height));
        }
        let position = light.packed.position;
        let height = self.normal.dot(position - self.centre);
        (height > 0.0).then_some((position - 2.0 * height * self.normal, height))
    }

    /// Distance of a point of the plane from the rectangle; 0 inside.
    fn distance(&self, point: Vec3) -> f32 {
        let across = Vec2::from_array(self.tangents.map(|t| t.dot(point - self.centre)));
        (across.abs() - self.half_size).max(Vec2::ZERO).length()
    }
}

impl Aims {
    fn fill(&mut self, found: impl Iterator<Item = Aim>, typical: f64) {
        (self.count, self.share) = (0, 0.0);
        let mut total = 0.0;
        for (place, aim) in self.aims.iter_mut().zip(found) {
            *place = aim;
            self.count += 1;
            total += aim.weight;
        }
        if self.count == 0 {
            return;
        }
        // Compares the caustic with other bounced light, which is estimated as 3 % of direct light.
        self.share = MAX_SHARE * total / (total + 0.03 * typical);
        self.aims[..self.count].iter_mut().for_each(|aim| aim.weight /= total);
    }

    /// Samples a unit direction; at least one aim must exist.
    pub fn draw(&self, choice: f64, u: f64, v: f64) -> DVec3 {
        let mut left = choice;
        let aims = &self.aims[..self.count];
        let picked = aims.iter().find(|aim| {
            left -= aim.weight;
            left < 0.0
        });
        picked.or(aims.last()).expect("a share above 0 has an aim").draw(u, v)
    }

    /// Density of [`Self::draw`], 1/sr.
    pub fn density(&self, direction: DVec3) -> f64 {
        self.aims[..self.count].iter().map(|aim| aim.weight * aim.density(direction)).sum()
    }
}

impl Aim {
    /// Tangents are distributed as those of GGX half vectors, so that the tails match those of the caustic.
    fn draw(&self, u: f64, v: f64) -> DVec3 {
        let tangent = self.width * (u / (1.0 - u)).sqrt();
        let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
        let (y, x) = (TAU * v).sin_cos();
        (basis(self.axis) * (cosine * DVec3::new(tangent * x, tangent * y, 1.0))).normalize()
    }

    fn density(&self, direction: DVec3) -> f64 {
        let cosine = self.axis.dot(direction);
        if cosine <= 0.0 {
            return 0.0;
        }
        let sine2 = self.axis.cross(direction).length_squared();
        // width² / (pi cos³ (width² + tan²)²)
        let spread = self.width * self.width * cosine * cosine + sine2;
        self.width * self.width * cosine / (PI * spread * spread)
    }
}

/// BRDF of a material that causes caustics; `None` for others and for textured materials.
fn glossy(scene: &Scene, material: u32) -> Option<Brdf> {
    let m = &scene.materials[material as usize];
    let brdf = brdf(&m.evaluate(&scene.textures, Default::default(), [0.0; 2], Vec4::ONE));
    (brdf.has_lobe() && brdf.alpha <= MAX_ALPHA && m.textures().next().is_none()).then_some(brdf)
}

/// Finds planar faces of glossy materials; coplanar triangles form one face, small faces are discarded.
fn find_faces(scene: &Scene, radius: f64) -> Vec<Face> {
    let mesh = &scene.mesh;
    let mut found: BTreeMap<(u32, [i64; 4]), Vec<usize>> = BTreeMap::new();
    for (i, corners) in mesh.triangles.iter().enumerate() {
        let material = mesh.triangle_materials[i];
        if glossy(scene, material).is_none() {
            continue;
        }
        let [a, b, c] = corners.map(|v| mesh.positions[v as usize].as_dvec3());
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
        // With interpolated normals the surface is curved; see `curves`.
        if corners.iter().any(|&v| mesh.normals[v as usize].as_dvec3().dot(normal) < 1.0 - 1e-6) {
            continue;
        }
        let rounded = (normal * 1e3).round();
        let offset = (normal.dot(a) / radius * 1e4).round();
        let plane = [rounded.x, rounded.y, rounded.z, offset].map(|x| x as i64);
        found.entry((material, plane)).or_default().push(i);
    }
    let faces = found.into_iter().map(|((material, _), triangles)| face(scene, material, &triangles));
    faces.filter(|face| f64::from(face.area()) > MIN_AREA * radius * radius).collect()
}

/// Bounding rectangle of coplanar triangles; its first side is parallel to an edge of the first triangle.
fn face(scene: &Scene, material: u32, triangles: &[usize]) -> Face {
    let corner = |&i: &usize| scene.mesh.triangles[i].map(|v| scene.mesh.positions[v as usize].as_dvec3());
    let [a, b, c] = corner(&triangles[0]);
    let normal = (b - a).cross(c - a).normalize();
    let along = (b - a).normalize();
    let tangents = [along, normal.cross(along)];
    let place = |p: DVec3| DVec2::from_array(tangents.map(|t| t.dot(p - a)));
    let places = || triangles.iter().flat_map(corner).map(place);
    let low = places().fold(DVec2::INFINITY, DVec2::min);
    let high = places().fold(DVec2::NEG_INFINITY, DVec2::max);
    let middle = (low + high) / 2.0;
    let brdf = glossy(scene, material).expect("faces are glossy");
    Face {
        normal: normal.as_vec3(),
        centre: (a + tangents[0] * middle.x + tangents[1] * middle.y).as_vec3(),
        tangents: tangents.map(|t| t.as_vec3()),
        half_size: ((high - low) / 2.0).as_vec2(),
        brdf,
    }
}
