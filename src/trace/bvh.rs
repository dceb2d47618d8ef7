//! Bounding volume hierarchies: obvhs behind `closest_hit()` and `occluded()`; packets of shadow rays are in
//! [`super::packet`].

use std::ops::Deref;

use glam::{BVec4A, Vec2, Vec3, Vec3A, Vec4, Vec4Swizzles};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::bvh2_to_cwbvh::bvh2_to_cwbvh;
use obvhs::ploc::PlocBuilder;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use obvhs::{Boundable, BvhBuildParams};
use pulp::{Simd, WithSimd};

use super::coincident::CoincidentSets;
use crate::scene::{AlphaMode, Scene};

/// A scene and the hierarchy over its triangles.
pub struct TracedScene {
    scene: Scene,
    pub bvh: Bvh,
}

/// Ray tracing reads the scene as often as the hierarchy over it.
impl Deref for TracedScene {
    type Target = Scene;

    fn deref(&self) -> &Scene {
        &self.scene
    }
}

/// Hierarchy over all triangles of a scene. Ray directions need not be unit length; distances are in units of their
/// length.
pub struct Bvh {
    /// Wide nodes for single rays.
    wide: CwBvh,
    wide_corners: Vec<Lanes>,
    /// Binary nodes for packets: their rays are so coherent that wide nodes would test too many boxes.
    pub(super) binary: Bvh2,
    pub(super) binary_corners: Vec<Corners>,
    /// Half the diagonal of the bounds: 1, except for scenes made in code.
    pub radius: f32,
    is_empty: bool,
    /// Whether any material is not opaque.
    pub has_masks: bool,
    /// Whether any material blends.
    pub has_blends: bool,
}

/// A triangle in leaf order, as traversal reads it.
#[derive(Clone, Copy)]
pub(super) struct Corners {
    pub v: [Vec3; 3],
    /// Index into the mesh's triangles.
    pub triangle: u32,
}

/// The same with one corner per lane, for single rays: the three edges are tested in parallel.
#[derive(Clone, Copy)]
struct Lanes {
    /// x, y and z of the corners; the fourth lane repeats the first corner.
    axes: [Vec4; 3],
    triangle: u32,
}

/// Where a ray hits a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Weights of the second and third corner.
    pub barycentric: Vec2,
    pub distance: f32,
}

impl TracedScene {
    /// Builds the hierarchy over `scene`.
    pub fn new(scene: Scene) -> Self {
        Self { bvh: Bvh::build(&scene), scene }
    }

    /// First surface along the ray between its origin and `max_distance`. A blending surface is hit with a probability
    /// equal to its coverage, so that the mean over rays is the blended result [Enderton 2010]. Equal rays get equal
    /// hits.
    pub fn closest_hit(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        let passes = |hit: &Hit| passes_by_chance(self, hit.triangle, hit.barycentric, [origin, direction]);
        let may_pass = self.bvh.has_masks;
        SingleRay { bvh: &self.bvh, origin, direction, max_distance, may_pass, passes }.closest_hit()
    }

    /// First surface along the ray that the ray does not pass. `passes` is called in any order.
    pub fn closest_hit_unless(&self, origin: Vec3, direction: Vec3, passes: impl Fn(&Hit) -> bool) -> Option<Hit> {
        let max_distance = f32::INFINITY;
        SingleRay { bvh: &self.bvh, origin, direction, max_distance, may_pass: true, passes }.closest_hit()
    }

    /// First surface along the ray with a coverage of at least one half.
    pub fn closest_solid_hit(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        self.closest_hit_unless(origin, direction, |hit| coverage(self, hit.triangle, hit.barycentric) < 0.5)
    }

    /// Whether anything blocks the ray between its origin and `max_distance`; blending surfaces do so by chance, as in
    /// [`Self::closest_hit`].
    pub fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        let passes = |hit: &Hit| passes_by_chance(self, hit.triangle, hit.barycentric, [origin, direction]);
        let may_pass = self.bvh.has_masks;
        SingleRay { bvh: &self.bvh, origin, direction, max_distance, may_pass, passes }.occluded()
    }

    /// Share of light that passes along the ray from its origin to `max_distance`, through all blending surfaces: 0 or
    /// 1 if no surface blends.
    pub fn transmittance(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> f32 {
        self.linked(None).transmittance(origin, direction, max_distance)
    }

    /// Whether the material of a triangle is not opaque.
    #[inline(always)]
    pub fn is_masked(&self, triangle: u32) -> bool {
        let material = || self.mesh.triangle_materials[triangle as usize] as usize;
        self.bvh.has_masks && self.materials[material()].alpha_mode != AlphaMode::Opaque
    }
}

impl Bvh {
    fn build(scene: &Scene) -> Self {
        let mesh = &scene.mesh;
        let mut corners: Vec<Corners> = mesh
            .triangles
            .iter()
            .enumerate()
            .map(|(i, t)| Corners { v: t.map(|v| mesh.positions[v as usize]), triangle: i as u32 })
            .collect();
        // An empty scene gets a point that no ray hits, because traversal starts at a root.
        let is_empty = corners.is_empty();
        if is_empty {
            corners.push(Corners { v: [Vec3::ZERO; 3], triangle: 0 });
        }
        let triangles: Vec<Triangle> = corners
            .iter()
            .map(|c| {
                let [v0, v1, v2] = c.v.map(Vec3A::from);
                Triangle { v0, v1, v2 }
            })
            .collect();
        let params = BvhBuildParams::medium_build();
        let boxes: Vec<Aabb> = triangles.iter().map(Boundable::aabb).collect();
        // Key of opaque triangles of one material and object with equal corners and winding.
        let same = |i: u32| {
            let material = *mesh.triangle_materials.get(i as usize)?;
            let is_opaque = scene.materials[material as usize].alpha_mode == AlphaMode::Opaque;
            let mut corners = corners[i as usize].v.map(|v| v.to_array().map(|x| (x + 0.0).to_bits()));
            let first = (0..3).min_by_key(|&k| corners[k])?;
            corners.rotate_left(first);
            is_opaque.then_some((corners, material, mesh.object(i)))
        };
        let coincident = CoincidentSets::find(&boxes, same);
        let leaves = coincident.as_ref().map_or(&boxes, |coincident| &coincident.boxes);
        let mut binary = PlocBuilder::with_capacity(leaves.len()).build(
            params.ploc_search_distance,
            leaves,
            (0..leaves.len() as u32).collect(),
            params.sort_precision,
            params.search_depth_threshold,
        );
        let mut reinsertion = ReinsertionOptimizer::default();
        reinsertion.run(&mut binary, params.reinsertion_batch_ratio, None);
        let has_sets = coincident.is_some();
        if let Some(coincident) = coincident {
            coincident.expand(&mut binary, &boxes);
        }
        let (lo, hi) = mesh.bounds();
        let radius = if is_empty { 1.0 } else { (hi - lo).length() / 2.0 };
        let wide = bvh2_to_cwbvh(&padded(&binary, radius), 3, true, false);
        collapse(&mut binary, params.max_prims_per_leaf, params.collapse_traversal_cost);
        if !has_sets {
            let again = params.post_collapse_reinsertion_batch_ratio_multiplier;
            reinsertion.run(&mut binary, params.reinsertion_batch_ratio * again, None);
        }
        // Nodes and triangles in order of traversal: half of a packet's time is waiting for memory.
        binary.reorder_in_stack_traversal_order();

        let in_order = |indices: &[u32]| indices.iter().map(|&i| corners[i as usize]).collect::<Vec<_>>();
        let masked = |m: &crate::scene::Material| m.alpha_mode != AlphaMode::Opaque;
        Self {
            wide_corners: in_order(&wide.primitive_indices).iter().map(Lanes::new).collect(),
            binary_corners: in_order(&binary.primitive_indices),
            wide,
            binary,
            radius,
            is_empty,
            has_masks: scene.materials.iter().any(masked),
            has_blends: scene.materials.iter().any(|m| m.alpha_mode == AlphaMode::Blend),
        }
    }

    /// Tests the signs of three edge functions: all or none are negative [Kensler 2006]. Each edge enters as its sum
    /// and difference, for which a neighbour gets exactly the negative: a ray through a shared edge hits at least one
    /// triangle.
    #[inline(always)] // a call would cost a fifth of its time
    fn intersect(
        &self,
        corners: &Lanes,
        origin: Vec3,
        direction: Vec3,
        max_distance: f32,
        (may_pass, passes): (bool, impl Fn(&Hit) -> bool),
    ) -> Option<Hit> {
        let [x, y, z] = corners.axes;
        let (x, y, z) = (x - origin.x, y - origin.y, z - origin.z);
        // Lane 0 has the edge from corner 1 to 2, lane 1 from 2 to 0, lane 2 from 0 to 1.
        let edge = |v: Vec4| (v.yzxw() + v.zxyw(), v.zxyw() - v.yzxw());
        let across = |(sum_a, side_a): (Vec4, Vec4), (sum_b, side_b)| sum_a * side_b - side_a * sum_b;
        let (ex, ey, ez) = (edge(x), edge(y), edge(z));
        let w = across(ey, ez) * direction.x + across(ez, ex) * direction.y + across(ex, ey) * direction.z;
        let any = |lanes: BVec4A| lanes.bitmask() & 7 != 0;
        if any(w.cmplt(Vec4::ZERO)) && any(w.cmpgt(Vec4::ZERO)) {
            return None;
        }
        let (v0, v1, v2) = (Vec3::new(x.x, y.x, z.x), Vec3::new(x.y, y.y, z.y), Vec3::new(x.z, y.z, z.z));
        let normal = (v1 - v0).cross(v2 - v0);
        let distance = normal.dot(v0) / normal.dot(direction);
        let barycentric = Vec2::new(w.y, w.z) / (w.x + w.y + w.z);
        // NaN, from a ray within the triangle's plane, is no hit.
        let within = distance > 0.0 && distance < max_distance && barycentric.is_finite();
        let hit = Hit { triangle: corners.triangle, barycentric, distance };
        (within && !(may_pass && passes(&hit))).then_some(hit)
    }

    /// The mesh's triangles in leaf order, so that neighbours are close together.
    pub fn triangle_order(&self) -> impl Iterator<Item = u32> {
        self.binary_corners.iter().filter(|_| !self.is_empty).map(|corners| corners.triangle)
    }

    /// Distance from a surface at which a shadow ray ends, for a light `distance` away: above the rounding errors of
    /// both.
    pub fn shadow_offset(&self, distance: f32) -> f32 {
        // 2^-17: about 60 roundings of a coordinate as large as the scene. 2^-21: likewise for the light's distance.
        self.radius * f32::exp2(-17.0) + distance * f32::exp2(-21.0)
    }
}

impl Lanes {
    fn new(corners: &Corners) -> Self {
        let [a, b, c] = corners.v;
        let axis = |i: usize| Vec4::new(a[i], b[i], c[i], a[i]);
        Self { axes: [axis(0), axis(1), axis(2)], triangle: corners.triangle }
    }
}

pub(super) struct SingleRay<'a, P> {
    pub bvh: &'a Bvh,
    pub origin: Vec3,
    pub direction: Vec3,
    pub max_distance: f32,
    /// Whether the ray may pass any surface; otherwise `passes` is not called.
    pub may_pass: bool,
    /// Whether the ray passes a surface.
    pub passes: P,
}

impl<P: Fn(&Hit) -> bool> SingleRay<'_, P> {
    // Both are compiled for the machine's widest registers: a quarter faster. Products and sums are still rounded
    // separately.

    pub fn closest_hit(self) -> Option<Hit> {
        pulp::Arch::new().dispatch(ClosestHit(self))
    }

    pub fn occluded(self) -> bool {
        pulp::Arch::new().dispatch(Occluded(self))
    }
}

struct ClosestHit<'a, P>(SingleRay<'a, P>);

impl<P: Fn(&Hit) -> bool> WithSimd for ClosestHit<'_, P> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Option<Hit> {
        let SingleRay { bvh, origin, direction, max_distance, may_pass, passes } = self.0;
        let mut closest: Option<Hit> = None;
        bvh.wide.ray_traverse(wide_ray(origin, direction, max_distance), &mut RayHit::none(), |ray, primitive| {
            let max_distance = ray.tmax / WIDE_UNIT;
            let candidate =
                bvh.intersect(&bvh.wide_corners[primitive], origin, direction, max_distance, (may_pass, &passes));
            closest = candidate.or(closest);
            candidate.map_or(f32::INFINITY, |hit| hit.distance * WIDE_UNIT)
        });
        closest
    }
}

struct Occluded<'a, P>(SingleRay<'a, P>);

impl<P: Fn(&Hit) -> bool> WithSimd for Occluded<'_, P> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> bool {
        let SingleRay { bvh, origin, direction, max_distance, may_pass, passes } = self.0;
        !bvh.wide.ray_traverse_miss(wide_ray(origin, direction, max_distance), |_, primitive| {
            let hit = bvh.intersect(&bvh.wide_corners[primitive], origin, direction, max_distance, (may_pass, &passes));
            hit.map_or(f32::INFINITY, |hit| hit.distance * WIDE_UNIT)
        })
    }
}

/// Scale of distances in `wide`, a power of two. obvhs skips boxes that end within 1e-4 of the origin; at this scale
/// that is negligible, however small the scene.
const WIDE_UNIT: f32 = (1u64 << 40) as f32;

/// A ray in the form that `wide` traverses.
#[inline(always)]
fn wide_ray(origin: Vec3, direction: Vec3, max_distance: f32) -> Ray {
    // -0 becomes 0: obvhs selects the side of a box by `direction < 0`, but that of its inverse by the sign bit.
    let direction = direction + Vec3::ZERO;
    // Parallel to a slab: a huge number instead of infinity, so that 0 * inf does not occur.
    let inverse = (direction.recip() * WIDE_UNIT).clamp(Vec3::splat(-1e30), Vec3::splat(1e30));
    Ray {
        origin: origin.into(),
        direction: direction.into(),
        inv_direction: inverse.into(),
        tmin: 0.0,
        tmax: max_distance * WIDE_UNIT,
    }
}

/// The same boxes, slightly enlarged: obvhs tests them without tolerance, and rays from within the scene have an error
/// of about eight roundings of a coordinate as large as the scene [Ize 2013].
fn padded(bvh: &Bvh2, radius: f32) -> Bvh2 {
    let mut bvh = bvh.clone();
    let pad = Vec3A::splat(radius * f32::exp2(-20.0));
    for node in &mut bvh.nodes {
        let Aabb { min, max } = *node.aabb();
        node.set_aabb(Aabb::new(min - pad, max + pad));
    }
    bvh
}

/// Smaller shares of light count as zero: half a step of the 8-bit visibility.
pub(super) const MIN_TRANSMITTANCE: f32 = 0.5 / 255.0;

/// Coverage of a surface at a point, from the finest level of its texture.
pub fn coverage(scene: &Scene, triangle: u32, barycentric: Vec2) -> f32 {
    let material = &scene.materials[scene.mesh.triangle_materials[triangle as usize] as usize];
    if material.alpha_mode == AlphaMode::Opaque {
        return 1.0;
    }
    let (uvs, color) = interpolate_attributes(scene, triangle, barycentric);
    material.alpha_mode.coverage(material.alpha_at(&scene.textures, uvs, color))
}

/// [`coverage`], but zero on edges that are assigned to the neighbour, so that a shared edge blocks light only once.
pub(super) fn blocked_share(scene: &Scene, triangle: u32, barycentric: Vec2) -> f32 {
    let coverage = coverage(scene, triangle, barycentric);
    let weights = [1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y];
    if coverage == 1.0 || weights.iter().all(|weight| *weight > f32::EPSILON) {
        return coverage;
    }
    let corners = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.positions[v as usize].to_array());
    // The neighbour has the edge's corners in the other order.
    let is_neighbours = |i: usize| weights[i] <= f32::EPSILON && corners[(i + 1) % 3] > corners[(i + 2) % 3];
    if (0..3).any(is_neighbours) { 0.0 } else { coverage }
}

/// Whether a ray, given by origin and direction, passes a surface at this point; the probability is 1 - coverage.
pub fn passes_by_chance(scene: &Scene, triangle: u32, barycentric: Vec2, ray: [Vec3; 2]) -> bool {
    match coverage(scene, triangle, barycentric) {
        0.0 => true,
        1.0 => false,
        coverage => chance(ray, triangle) >= coverage,
    }
}

/// A deterministic number in [0, 1) for a ray and a triangle [MurmurHash3].
fn chance([origin, direction]: [Vec3; 2], triangle: u32) -> f32 {
    let [o, d] = [origin, direction].map(|v| v.to_array().map(f32::to_bits));
    let mut hash = 0u32;
    for word in [o[0], o[1], o[2], d[0], d[1], d[2], triangle] {
        hash ^= word.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
        hash = hash.rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64);
    }
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    ((hash ^ hash >> 16) >> 8) as f32 * f32::exp2(-24.0)
}

/// Texture coordinates and vertex colour at a point of a triangle; zeros and white if the mesh has none.
pub fn interpolate_attributes(scene: &Scene, triangle: u32, barycentric: Vec2) -> ([Vec2; 2], Vec4) {
    let mesh = &scene.mesh;
    let corners = mesh.triangles[triangle as usize].map(|v| v as usize);
    let weights = [1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y];
    let uv = |set: usize| match mesh.uvs[set].as_slice() {
        [] => Vec2::ZERO,
        uvs => corners.iter().zip(weights).map(|(&v, w)| uvs[v] * w).sum(),
    };
    let color = match mesh.colors.as_slice() {
        [] => Vec4::ONE,
        colors => corners.iter().zip(weights).map(|(&v, w)| colors[v] * w).sum(),
    };
    ([uv(0), uv(1)], color)
}
