//! Collects triangles in world space, in double precision, and builds one [`Mesh`] of unit size from them.

use glam::{DVec3, Vec2, Vec3, Vec4};

use super::mesh_part::{MeshPart, gather};
use super::tangents::{self, perpendicular};
use super::{Mesh, MeshSpace};

/// Why no mesh was built.
pub enum MeshBuildError {
    /// No triangles.
    Empty(String),
    /// Triangles that cannot be represented.
    Wrong(String),
}

impl MeshBuildError {
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
    replaced_normals: usize,
}

/// Supported scene widths in metres: within them, the irradiance of one candela (one over the squared distance) is well
/// within single precision.
const WIDTHS: std::ops::RangeInclusive<f64> = 1e-15..=1e18;

impl MeshBuilder {
    /// Adds a part; completes its normals and tangents.
    pub fn add(&mut self, mut part: MeshPart) {
        let given = part.triangles.len();
        part.triangles.retain(|t| !is_collinear(t.map(|i| part.positions[i as usize])));
        self.dropped += given - part.triangles.len();
        if part.normals.is_empty() {
            part.make_flat();
        } else {
            self.replaced_normals += part.repair_normals();
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

    fn append(&mut self, part: MeshPart) {
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
        mesh.triangle_objects.resize(mesh.triangles.len(), part.object);
    }

    /// Returns the mesh and its space, or why there is none.
    pub fn finish(mut self) -> Result<(Mesh, MeshSpace), MeshBuildError> {
        let mut used = self.mesh.triangles.iter().flatten().map(|&i| self.positions[i as usize]);
        let Some(first) = used.next() else {
            return Err(MeshBuildError::Empty(match self.dropped {
                0 => "holds no triangles".into(),
                n => format!("holds no triangles except {n} of zero area"),
            }));
        };
        let (lo, hi) = used.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let width = (hi - lo).max_element();
        if !WIDTHS.contains(&width) {
            let how = if width < *WIDTHS.start() { "small" } else { "large" };
            return Err(MeshBuildError::Wrong(format!("is {width:e} metres wide: too {how}")));
        }
        let space = MeshSpace::around(lo, hi);
        let positions: Vec<Vec3> = self.positions.iter().map(|&p| space.from_world(p).as_vec3()).collect();
        self.mesh.positions = positions;
        self.drop_degenerate();
        if self.mesh.triangles.is_empty() {
            let reason = format!("holds no triangles except {} of zero area in single precision", self.dropped);
            return Err(MeshBuildError::Empty(reason));
        }
        if self.mesh.colors.iter().all(|&c| c == Vec4::ONE) {
            self.mesh.colors = Vec::new();
        }
        if self.mesh.triangle_objects.iter().all(|&object| object == 0) {
            self.mesh.triangle_objects = Vec::new();
        }
        drop_unused_vertices(&mut self.mesh);
        if self.dropped > 0 {
            tracing::info!("dropped {} triangles of zero area", self.dropped);
        }
        if self.replaced_normals > 0 {
            let count = self.replaced_normals;
            tracing::warn!("{count} normals of zero length or with NaN were replaced by their faces' normals");
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
        for values in [&mut mesh.triangle_materials, &mut mesh.triangle_objects] {
            let mut kept = keep.iter();
            values.retain(|_| *kept.next().expect("one flag per triangle"));
        }
        self.dropped += given - mesh.triangles.len();
    }
}

/// Whether a triangle in mesh space has no area in single precision.
fn is_degenerate(corners: [DVec3; 3]) -> bool {
    // Below f32's smallest normal number, the area would be zero when computed in single precision.
    let [a, b, c] = corners;
    is_collinear(corners) || (b - a).cross(c - a).length() <= f64::from(f32::MIN_POSITIVE)
}

/// Whether corners coincide or are collinear.
fn is_collinear([a, b, c]: [DVec3; 3]) -> bool {
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
