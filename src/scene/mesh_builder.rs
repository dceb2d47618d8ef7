//! Collects triangles in world space, in double precision, and builds one [`Mesh`] of unit size from them.

use glam::{DVec3, Vec2, Vec3, Vec4};

use super::tangents::{self, perpendicular};
use super::{Mesh, MeshSpace};

/// Triangles of one material in world space. Optional attributes are empty, or as long as `positions`.
#[derive(Default)]
pub struct Part {
    /// Finite.
    pub positions: Vec<DVec3>,
    /// Any length; empty for flat shading.
    pub normals: Vec<Vec3>,
    pub uvs: [Vec<Vec2>; 2],
    pub colors: Vec<Vec4>,
    pub tangents: Vec<Vec4>,
    /// Counter-clockwise from the front; indices in range.
    pub triangles: Vec<[u32; 3]>,
    pub material: u32,
    /// Texture coordinate set of the material's normal map, if it has one.
    pub tangents_from: Option<usize>,
}

/// Why no mesh was built.
pub enum Unbuilt {
    /// No triangles.
    Empty(String),
    /// Triangles that cannot be represented.
    Wrong(String),
}

impl Unbuilt {
    pub fn reason(self) -> String {
        let (Self::Empty(reason) | Self::Wrong(reason)) = self;
        reason
    }
}

/// Collects parts.
#[derive(Default)]
pub struct MeshBuilder {
    positions: Vec<DVec3>,
    /// Its positions stay empty until `finish`; the other attributes are final.
    mesh: Mesh,
    dropped: usize,
    mended_normals: usize,
}

/// Supported scene widths in metres: within them, the irradiance of one candela (one over the squared distance) is well
/// within single precision.
const WIDTHS: std::ops::RangeInclusive<f64> = 1e-15..=1e18;

impl MeshBuilder {
    /// Adds a part; completes its normals and tangents.
    pub fn add(&mut self, mut part: Part) {
        let given = part.triangles.len();
        part.triangles.retain(|t| !is_line(t.map(|i| part.positions[i as usize])));
        self.dropped += given - part.triangles.len();
        if part.normals.is_empty() {
            part.make_flat();
        } else {
            self.mended_normals += part.mend_normals();
        }
        match part.tangents_from {
            None => part.tangents.clear(),
            // Tangents from the file; zero ones are replaced.
            Some(_) if !part.tangents.is_empty() => {
                for (tangent, &normal) in part.tangents.iter_mut().zip(&part.normals) {
                    let sign = if tangent.w < 0.0 { -1.0 } else { 1.0 };
                    let axis = tangent.truncate().try_normalize().unwrap_or_else(|| perpendicular(normal));
                    *tangent = axis.extend(sign);
                }
            }
            Some(uv_set) => tangents::generate(&mut part, uv_set),
        }
        self.append(part);
    }

    fn append(&mut self, part: Part) {
        let first = self.positions.len();
        let count = part.positions.len();
        let mesh = &mut self.mesh;
        // Parts without an optional attribute that others have get its neutral value.
        append_optional(&mut mesh.uvs[0], &part.uvs[0], first, count, Vec2::ZERO);
        append_optional(&mut mesh.uvs[1], &part.uvs[1], first, count, Vec2::ZERO);
        append_optional(&mut mesh.colors, &part.colors, first, count, Vec4::ONE);
        append_optional(&mut mesh.tangents, &part.tangents, first, count, Vec4::new(1.0, 0.0, 0.0, 1.0));
        self.positions.extend(part.positions);
        mesh.normals.extend(part.normals.into_iter().map(without_rounding));
        mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + first as u32)));
        mesh.triangle_materials.resize(mesh.triangles.len(), part.material);
    }

    /// Returns the mesh and its space, or why there is none.
    pub fn finish(mut self) -> Result<(Mesh, MeshSpace), Unbuilt> {
        let mut used = self.mesh.triangles.iter().flatten().map(|&i| self.positions[i as usize]);
        let Some(first) = used.next() else {
            return Err(Unbuilt::Empty(match self.dropped {
                0 => "holds no triangles".into(),
                n => format!("holds no triangles except {n} of zero area"),
            }));
        };
        let (lo, hi) = used.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let width = (hi - lo).max_element();
        if !WIDTHS.contains(&width) {
            let how = if width < *WIDTHS.start() { "small" } else { "large" };
            return Err(Unbuilt::Wrong(format!("is {width:e} metres wide: too {how}")));
        }
        let space = MeshSpace::around(lo, hi);
        let positions: Vec<Vec3> = self.positions.iter().map(|&p| space.from_world(p).as_vec3()).collect();
        self.mesh.positions = positions;
        self.drop_degenerate();
        if self.mesh.triangles.is_empty() {
            let reason = format!("holds no triangles except {} of zero area in single precision", self.dropped);
            return Err(Unbuilt::Empty(reason));
        }
        if self.mesh.colors.iter().all(|&c| c == Vec4::ONE) {
            self.mesh.colors = Vec::new();
        }
        drop_unused_vertices(&mut self.mesh);
        if self.dropped > 0 {
            tracing::info!("dropped {} triangles of zero area", self.dropped);
        }
        if self.mended_normals > 0 {
            tracing::warn!("{} normals of zero length were replaced by their faces' normals", self.mended_normals);
        }
        Ok((self.mesh, space))
    }

    /// Removes triangles that have no area in single precision.
    fn drop_degenerate(&mut self) {
        let mesh = &mut self.mesh;
        let keep: Vec<bool> =
            (mesh.triangles.iter()).map(|t| !is_degenerate(t.map(|i| mesh.positions[i as usize].as_dvec3()))).collect();
        let given = mesh.triangles.len();
        let mut kept = keep.iter();
        mesh.triangles.retain(|_| *kept.next().expect("one flag per triangle"));
        let mut kept = keep.iter();
        mesh.triangle_materials.retain(|_| *kept.next().expect("one flag per triangle"));
        self.dropped += given - mesh.triangles.len();
    }
}

impl Part {
    /// Gives every triangle its own vertices with the face normal. Discards tangents, because they require normals
    /// [glTF 2.0, 3.7.2.1].
    fn make_flat(&mut self) {
        let corners: Vec<usize> = self.triangles.iter().flatten().map(|&i| i as usize).collect();
        self.positions = corners.iter().map(|&i| self.positions[i]).collect();
        gather(&mut self.uvs[0], &corners);
        gather(&mut self.uvs[1], &corners);
        gather(&mut self.colors, &corners);
        self.tangents = Vec::new();
        self.triangles = (0..self.triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let faces = self.triangles.iter().map(|t| self.face_normal(*t));
        self.normals = faces.flat_map(|n| [n; 3]).collect();
    }

    /// Normalizes normals; those of zero length become the mean of their faces' normals. Returns the number replaced.
    fn mend_normals(&mut self) -> usize {
        let mut sums = std::collections::HashMap::new();
        for (i, normal) in self.normals.iter_mut().enumerate() {
            match normal.try_normalize() {
                Some(unit) => *normal = unit,
                None => _ = sums.insert(i as u32, Vec3::ZERO),
            }
        }
        if sums.is_empty() {
            return 0;
        }
        for &triangle in &self.triangles {
            for i in triangle {
                if let Some(sum) = sums.get_mut(&i) {
                    *sum += self.face_normal(triangle);
                }
            }
        }
        let mended = sums.len();
        for (i, sum) in sums {
            self.normals[i as usize] = sum.try_normalize().unwrap_or(Vec3::Y);
        }
        mended
    }

    fn face_normal(&self, triangle: [u32; 3]) -> Vec3 {
        let [a, b, c] = triangle.map(|i| self.positions[i as usize]);
        // Edges are normalized, so that tiny triangles do not underflow.
        let normal = (b - a).normalize().cross((c - a).normalize());
        normal.try_normalize().map_or(Vec3::Y, |n| n.as_vec3())
    }
}

/// Whether a triangle in mesh space has no area in single precision.
fn is_degenerate(corners: [DVec3; 3]) -> bool {
    // Below f32's smallest normal number, the area would be zero when computed in single precision.
    let [a, b, c] = corners;
    is_line(corners) || (b - a).cross(c - a).length() <= f64::from(f32::MIN_POSITIVE)
}

/// Whether corners coincide or are collinear.
fn is_line([a, b, c]: [DVec3; 3]) -> bool {
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let longest = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
    // 1e-10: rounding of collinear corners leaves 1e-16 of the longest edge squared in double precision, and a sliver
    // narrower than 1e-10 of its length is below single precision.
    let doubled_area = ab.cross(ac).length();
    doubled_area.is_nan() || doubled_area <= 1e-10 * longest
}

/// Clears components of a unit vector that are only rounding errors: they would depend on the scene's size and
/// position.
fn without_rounding(unit: Vec3) -> Vec3 {
    Vec3::select(unit.abs().cmplt(Vec3::splat(1e-12)), Vec3::ZERO, unit)
}

fn gather<T: Copy>(values: &mut Vec<T>, indices: &[usize]) {
    if !values.is_empty() {
        *values = indices.iter().map(|&i| values[i]).collect();
    }
}

fn append_optional<T: Copy>(all: &mut Vec<T>, part: &[T], first: usize, count: usize, neutral: T) {
    if !part.is_empty() {
        all.resize(first, neutral);
        all.extend_from_slice(part);
    } else if !all.is_empty() {
        all.resize(first + count, neutral);
    }
}

fn drop_unused_vertices(mesh: &mut Mesh) {
    const UNUSED: u32 = u32::MAX;
    let mut new_index = vec![UNUSED; mesh.positions.len()];
    let mut kept = Vec::new();
    for i in mesh.triangles.iter().flatten() {
        new_index[*i as usize] = 0;
    }
    for (old, new) in new_index.iter_mut().enumerate().filter(|(_, new)| **new != UNUSED) {
        *new = kept.len() as u32;
        kept.push(old);
    }
    if kept.len() == mesh.positions.len() {
        return;
    }
    mesh.triangles.iter_mut().flatten().for_each(|i| *i = new_index[*i as usize]);
    gather(&mut mesh.positions, &kept);
    gather(&mut mesh.normals, &kept);
    gather(&mut mesh.uvs[0], &kept);
    gather(&mut mesh.uvs[1], &kept);
    gather(&mut mesh.colors, &kept);
    gather(&mut mesh.tangents, &kept);
}
