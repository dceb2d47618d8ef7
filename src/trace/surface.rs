//! The surface at a ray hit: position, normals, BRDF, emission.

use glam::{Vec3, Vec4};

use super::bvh::{Hit, interpolate_attributes};
use crate::scene::{AlphaMode, Scene, Surface};
use crate::shared::Brdf;

/// Narrowest lobe that is not a perfect mirror: glTF roughness 1e-6. Float32 directions do not resolve narrower ones.
const MIN_ALPHA: f32 = 1e-12;

/// A surface point seen from one side; mesh space.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    pub position: Vec3,
    /// Height along `geometric_normal` at which rays to lights start. It is approximately on the smooth surface that
    /// the vertex normals describe, so that a coarse mesh does not shadow itself along its terminator [Hanika 2021].
    pub lift: f32,
    /// Unit shading normal, including the normal map; on the visible side if the material is double-sided.
    pub normal: Vec3,
    /// Unit geometric normal, on the same side.
    pub geometric_normal: Vec3,
    pub brdf: Brdf,
    /// Radiance that the surface emits towards the viewer.
    pub emission: Vec3,
    /// Coverage of a blending surface in [0, 1], averaged over the footprint; else 1.
    pub coverage: f32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Index into the scene's materials.
    pub material: u32,
    /// Whether the BRDF is constant over the material.
    pub uniform: bool,
}

impl SurfacePoint {
    /// Evaluates the surface at `hit`, seen along `direction`; `footprint` is the pixel width there, in mesh space.
    pub fn new(scene: &Scene, hit: &Hit, direction: Vec3, footprint: f32) -> Self {
        let mesh = &scene.mesh;
        let [a, b, c] = mesh.triangles[hit.triangle as usize];
        let corners = [a as usize, b as usize, c as usize];
        let (p0, p1, p2) = (mesh.positions[corners[0]], mesh.positions[corners[1]], mesh.positions[corners[2]]);
        let (u, v) = (hit.barycentric.x, hit.barycentric.y);
        let weights = [1.0 - u - v, u, v];
        let cross = (p1 - p0).cross(p2 - p0);
        let mut geometric_normal = cross.normalize_or_zero();
        let smooth: Vec3 = corners.iter().zip(weights).map(|(&v, w)| mesh.normals[v] * w).sum();
        let mut normal = smooth.try_normalize().unwrap_or(geometric_normal);

        let material = mesh.triangle_materials[hit.triangle as usize];
        let m = &scene.materials[material as usize];
        let uniform = mesh.colors.is_empty() && m.textures().next().is_none();
        let surface = if uniform {
            m.evaluate(&scene.textures, Default::default(), [0.0; 2], Vec4::ONE)
        } else {
            let (uvs, color) = interpolate_attributes(scene, hit.triangle, hit.barycentric);
            let footprints = [0, 1].map(|set| uv_footprint(scene, corners, set, cross.length(), footprint));
            m.evaluate(&scene.textures, uvs, footprints, color)
        };
        if m.normal_texture.is_some() && !mesh.tangents.is_empty() {
            let tangent: Vec4 = corners.iter().zip(weights).map(|(&v, w)| mesh.tangents[v] * w).sum();
            let bitangent = normal.cross(tangent.truncate()) * mesh.tangents[corners[0]].w;
            let n = surface.normal_t;
            let mapped = tangent.truncate() * n.x + bitangent * n.y + normal * n.z;
            normal = mapped.try_normalize().unwrap_or(normal);
        }
        let behind = geometric_normal.dot(direction) > 0.0;
        if behind && m.double_sided {
            normal = -normal;
            geometric_normal = -geometric_normal;
        }
        let emission = if behind && !m.double_sided { Vec3::ZERO } else { surface.emissive };
        let coverage = if m.alpha_mode == AlphaMode::Blend { AlphaMode::Blend.coverage(surface.alpha) } else { 1.0 };
        let position = p0 * weights[0] + p1 * weights[1] + p2 * weights[2];
        let lift = lift(scene, corners, weights, position, geometric_normal);
        Self {
            position,
            lift,
            normal,
            geometric_normal,
            brdf: brdf(&surface),
            emission,
            coverage,
            triangle: hit.triangle,
            material,
            uniform,
        }
    }

    /// Replaces the shading normal by the geometric normal if both are on the same side of the surface, but only the
    /// shading normal faces away from the viewer: silhouettes and creases of coarse meshes and steep normal maps are then
    /// not black. `wo` is unit, towards the eye or the surface that reflects the light on.
    pub fn facing(self, wo: Vec3) -> Self {
        let faces_eye = self.normal.dot(wo) > 0.0 || self.geometric_normal.dot(wo) <= 0.0;
        let is_turned_away = !faces_eye && self.normal.dot(self.geometric_normal) > 0.0;
        Self { normal: if is_turned_away { self.geometric_normal } else { self.normal }, ..self }
    }

    /// Origin of rays to lights.
    pub fn lifted(&self) -> Vec3 {
        self.position + self.lift * self.geometric_normal
    }

    /// Unit direction of perfect mirror reflection for `wo`. If the interpolated normal reflects it into the surface,
    /// it is bent out of the surface [Keller 2017].
    pub fn mirrored(&self, wo: Vec3) -> Vec3 {
        let direction = (2.0 * self.normal.dot(wo) * self.normal - wo).normalize();
        let height = self.geometric_normal.dot(direction);
        if height > 0.0 { direction } else { (direction + (GRAZING - height) * self.geometric_normal).normalize() }
    }

    /// Origin of a ray in `direction`: offset from the surface, towards that side.
    pub fn leave(&self, direction: Vec3, offset: f32) -> Vec3 {
        self.position + self.geometric_normal * offset.copysign(self.geometric_normal.dot(direction))
    }
}

/// Cosine between a normal and a direction that barely leaves the surface.
const GRAZING: f32 = 0.01;

/// Minimum cosine between a triangle and its vertex normals, 26 degrees, for a smooth surface. On a box with one normal
/// per corner, the faces would otherwise be lifted by a considerable part of its size.
const SMOOTH: f32 = 0.9;

/// Height above a triangle, on the side of `geometric_normal`, of a smooth surface: the weighted mean of the
/// projections of `position` onto the tangent planes of the corners; only planes above `position` count [Hanika 2021].
fn lift(scene: &Scene, corners: [usize; 3], weights: [f32; 3], position: Vec3, geometric_normal: Vec3) -> f32 {
    let mesh = &scene.mesh;
    let normals = corners.map(|v| mesh.normals[v]);
    let is_flat = normals[0] == normals[1] && normals[0] == normals[2];
    let is_smooth = normals.iter().all(|normal| normal.dot(geometric_normal).abs() > SMOOTH);
    if is_flat || !is_smooth {
        return 0.0;
    }
    let onto_plane = |i: usize| {
        let normal = normals[i] * 1f32.copysign(normals[i].dot(geometric_normal));
        normal.dot(mesh.positions[corners[i]] - position).max(0.0) * normal.dot(geometric_normal)
    };
    weights[0] * onto_plane(0) + weights[1] * onto_plane(1) + weights[2] * onto_plane(2)
}

/// Pixel width in texture coordinates: its width on the surface times the square root of the ratio of areas.
fn uv_footprint(scene: &Scene, corners: [usize; 3], set: usize, double_area: f32, footprint: f32) -> f32 {
    let uvs = &scene.mesh.uvs[set];
    if uvs.is_empty() {
        return 0.0;
    }
    let [a, b, c] = corners.map(|v| uvs[v]);
    footprint * ((b - a).perp_dot(c - a).abs() / double_area).sqrt()
}

/// Converts the parameters of glTF's material model to a BRDF [glTF 2.0, Appendix B; KHR_materials_specular].
pub fn brdf(s: &Surface) -> Brdf {
    let normal_incidence = ((s.ior - 1.0) / (s.ior + 1.0)).powi(2);
    let dielectric_f0 = (normal_incidence * s.specular_color).min(Vec3::ONE) * s.specular;
    let alpha = s.roughness * s.roughness;
    Brdf {
        diffuse: s.base_color * ((1.0 - s.metallic) * s.diffuse_weight),
        alpha: if s.roughness > 0.0 { alpha.max(MIN_ALPHA) } else { 0.0 },
        f0: dielectric_f0.lerp(s.base_color, s.metallic),
        f90: s.specular * (1.0 - s.metallic) + s.metallic,
        dielectric_f0: dielectric_f0.max_element(),
        dielectric_f90: s.specular,
    }
}
