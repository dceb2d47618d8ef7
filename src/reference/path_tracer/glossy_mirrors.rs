//! Glossy surfaces in which lights are mirrored, and aims at the mirror images. Planar surfaces are here, curved ones
//! in `curves`.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4};

use super::aims::{MirrorAim, MirrorAims};
use super::curves::Curve;
use super::lights::{ActiveLight, ActiveLights};
use crate::physics::brdf::specular_reflectance;
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
/// Maximum distance of the mirror point from the edge of the face, in widths of the lobe. Beyond it less than a
/// thousandth of the lobe remains.
const MAX_OUTSIDE: f32 = 6.0;
/// Glossy surfaces and the lights that they can mirror.
pub(super) struct GlossyMirrors {
    pairs: Vec<Pair>,
    curves: Vec<Curve>,
    /// Typical irradiance in the scene, to which the weights of aims are compared.
    typical: f64,
}

/// A light and a face that mirrors it.
struct Pair {
    light: usize,
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

impl GlossyMirrors {
    pub fn new(scene: &Scene, lights: &ActiveLights) -> Self {
        let (low, high) = scene.mesh.bounds();
        let radius = f64::from((high - low).length()) / 2.0;
        let mut faces = find_faces(scene, radius);
        faces.sort_by(|a, b| b.area().total_cmp(&a.area()));
        let mut pairs = Vec::new();
        for face in &faces {
            for (index, light) in lights.all.iter().enumerate() {
                let Some((image, height)) = face.mirrored(light) else { continue };
                pairs.push(Pair { light: index, face: face.clone(), image, height });
            }
        }
        pairs.truncate(MAX_PAIRS);
        let glossy = |material: u32| glossy(scene, material);
        let mut curves = Curve::find(scene, glossy);
        curves.retain(|curve| curve.area > MIN_AREA * radius * radius);
        curves.sort_by(|a, b| b.area.total_cmp(&a.area));
        curves.truncate(MAX_CURVES / lights.all.len().max(1));
        let arriving = |light: &ActiveLight| {
            let directional = light.packed.kind == LIGHT_DIRECTIONAL;
            let irradiance = if directional { 1.0 } else { f64::from(light.packed.strength) / (radius * radius) };
            light.scale.max_element() * irradiance
        };
        Self { pairs, curves, typical: lights.all.iter().map(arriving).sum() }
    }

    /// Aims of a visible surface point, at planar and curved surfaces. After a bounce, caustics are blurred and aims at
    /// curved surfaces cost more than they save.
    pub fn aim(&self, lights: &ActiveLights, point: &SurfacePoint) -> MirrorAims {
        let mut aims = MirrorAims::default();
        let curved =
            self.curves.iter().flat_map(|curve| lights.all.iter().filter_map(move |light| curve.aim(light, point)));
        aims.fill(self.planar(lights, point).chain(curved), self.typical);
        aims
    }

    /// Aims of a surface point after a bounce, only at planar surfaces.
    pub fn aim_at_planes(&self, aims: &mut MirrorAims, lights: &ActiveLights, point: &SurfacePoint) {
        aims.fill(self.planar(lights, point), self.typical);
    }

    fn planar(&self, lights: &ActiveLights, point: &SurfacePoint) -> impl Iterator<Item = MirrorAim> {
        self.pairs.iter().filter_map(move |pair| pair.aim(&lights.all[pair.light], point))
    }
}

impl Pair {
    fn aim(&self, light: &ActiveLight, point: &SurfacePoint) -> Option<MirrorAim> {
        let Face { normal, centre, brdf, .. } = self.face;
        let height = normal.dot(point.position - centre);
        if height <= 1e-6 * self.face.half_size.max_element() {
            return None;
        }
        let directional = light.packed.kind == LIGHT_DIRECTIONAL;
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
        let arriving = incident(&light.packed, mirror_point.as_dvec3())?.irradiance * light.scale.max_element();
        let weight = arriving * fresnel * share;
        (weight > 0.0).then(|| MirrorAim { axis: axis.as_dvec3().normalize(), width: width.into(), weight })
    }
}

impl Face {
    fn area(&self) -> f32 {
        4.0 * self.half_size.x * self.half_size.y
    }

    /// A light's mirror image and the light's height above the face; `None` if it lies behind the face, or all around.
    fn mirrored(&self, light: &ActiveLight) -> Option<(Vec3, f32)> {
        if light.is_all_around() {
            return None;
        }
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
