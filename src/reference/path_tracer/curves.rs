//! Curved glossy surfaces as mirrors: finds the point on them at which a light is seen mirrored.
//!
//! At the mirror point the normal bisects the angle between light and viewer. A convex surface has one point for each
//! normal. A fixed-point iteration, which looks up the point for the half vector and recomputes the half vector there,
//! converges in a few steps. On other surfaces it finds some point or none. A wrong aim increases the variance but adds
//! no bias.

use std::collections::BTreeMap;

use glam::Vec3;

use super::aims::MirrorAim;
use super::lights::ActiveLight;
use crate::physics::brdf::specular_reflectance;
use crate::physics::light::incident;
use crate::physics::octahedral;
use crate::scene::Scene;
use crate::shared::{Brdf, LIGHT_DIRECTIONAL};
use crate::trace::surface::SurfacePoint;

/// Cells along each side of the octahedral map of normals. A cell is 3 degrees wide, less than a lobe.
const CELLS: usize = 64;
/// Maximum iterations.
const STEPS: usize = 4;
/// The iteration ends if a step changes the normal by less than a quarter of the lobe's width; this is the ratio
/// squared.
const CLOSE: f32 = 1.0 / 16.0;

/// A connected curved surface of one glossy material.
pub(super) struct Curve {
    /// By octahedral cell of the normal; `None` if no vertex has such a normal.
    points: Vec<Option<Point>>,
    centre: Vec3,
    brdf: Brdf,
    pub area: f64,
}

#[derive(Clone, Copy)]
struct Point {
    position: Vec3,
    normal: Vec3,
    /// Rotation of the normal per unit length of mesh space.
    curvature: f32,
}

impl Curve {
    /// Finds connected components of curved triangles of a glossy material. `is_glossy` returns the BRDF of a glossy
    /// material.
    pub fn find(scene: &Scene, is_glossy: impl Fn(u32) -> Option<Brdf>) -> Vec<Self> {
        let mesh = &scene.mesh;
        let mut parent: Vec<u32> = (0..mesh.positions.len() as u32).collect();
        fn root(parent: &mut [u32], mut i: u32) -> u32 {
            while parent[i as usize] != i {
                parent[i as usize] = parent[parent[i as usize] as usize];
                i = parent[i as usize];
            }
            i
        }
        for [a, b, c] in &mesh.triangles {
            let to = root(&mut parent, *a);
            for other in [*b, *c] {
                let from = root(&mut parent, other);
                parent[from as usize] = to;
            }
        }
        let mut found: BTreeMap<(u32, u32), Self> = BTreeMap::new();
        for (corners, &material) in mesh.triangles.iter().zip(&mesh.triangle_materials) {
            let Some(brdf) = is_glossy(material) else { continue };
            let positions = corners.map(|v| mesh.positions[v as usize]);
            let normals = corners.map(|v| mesh.normals[v as usize]);
            let bend = (0..3).map(|i| normals[i].distance(normals[(i + 1) % 3])).sum::<f32>();
            let length = (0..3).map(|i| positions[i].distance(positions[(i + 1) % 3])).sum::<f32>();
            if bend < 1e-3 {
                continue; // flat
            }
            let empty = || Self { points: vec![None; CELLS * CELLS], centre: Vec3::ZERO, brdf, area: 0.0 };
            let curve = found.entry((root(&mut parent, corners[0]), material)).or_insert_with(empty);
            let area = (positions[1] - positions[0]).cross(positions[2] - positions[0]).length() / 2.0;
            curve.area += f64::from(area);
            curve.centre += area * positions.iter().sum::<Vec3>() / 3.0;
            for (position, normal) in positions.into_iter().zip(normals) {
                curve.points[cell(normal)] = Some(Point { position, normal, curvature: bend / length });
            }
        }
        found.into_values().map(|curve| Self { centre: curve.centre / curve.area as f32, ..curve }).collect()
    }

    /// Aim at the mirror image of `light` as seen from a surface point.
    pub fn aim(&self, light: &ActiveLight, point: &SurfacePoint) -> Option<MirrorAim> {
        if light.is_all_around() {
            return None;
        }
        let directional = light.packed.kind == LIGHT_DIRECTIONAL;
        let to_light = |from: Vec3| match directional {
            true => -light.packed.direction,
            false => (light.packed.position - from).normalize_or_zero(),
        };
        let mut at = Point { position: self.centre, normal: Vec3::ZERO, curvature: 0.0 };
        for _ in 0..STEPS {
            let half = (to_light(at.position) + (point.position - at.position).normalize_or_zero()).try_normalize()?;
            let moved = half.distance_squared(at.normal);
            at = self.points[cell(half)]?;
            // Extrapolates from the vertex as if the surface were a sphere.
            at.position += (half - at.normal) / at.curvature;
            at.normal = half;
            if moved < CLOSE * self.brdf.alpha * self.brdf.alpha {
                break;
            }
        }
        let to_surface = at.position - point.position;
        let near = to_surface.length();
        let axis = to_surface.try_normalize()?;
        let (cosine_here, cosine) = (point.normal.dot(axis), -at.normal.dot(axis));
        if cosine_here <= 0.0 || cosine <= 0.0 || at.normal.dot(to_light(at.position)) <= 0.0 {
            return None;
        }
        let far = if directional { f32::INFINITY } else { light.packed.position.distance(at.position) };
        // Rotation of the half vector per rotation of the direction from `point`, perpendicular to the plane of
        // reflection and in it.
        let turns = [1.0, 1.0 / cosine].map(|slant| 0.5 * (1.0 + near / far) + near * at.curvature * slant);
        let width = self.brdf.alpha / (turns[0] * turns[1]).sqrt();
        // Spread of the reflected beam: its original divergence plus twice the rotation of the surface normal.
        let spread = [cosine, 1.0 / cosine].map(|slant| 1.0 + near / far + 2.0 * near * at.curvature * slant);
        let arriving = incident(&light.packed, at.position.as_dvec3())?.irradiance * light.scale.max_element();
        let fresnel = specular_reflectance(&self.brdf, cosine.into()).max_element();
        let weight = arriving * fresnel * f64::from(cosine_here / (spread[0] * spread[1]));
        (weight > 0.0).then(|| MirrorAim { axis: axis.as_dvec3().normalize(), width: width.into(), weight })
    }
}

fn cell(normal: Vec3) -> usize {
    let place = |x: f32| (((x + 1.0) * 0.5 * CELLS as f32) as usize).min(CELLS - 1);
    let e = octahedral::encode(normal);
    place(e.y) * CELLS + place(e.x)
}
