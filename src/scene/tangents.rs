//! Tangents for normal maps if a file has none.
//!
//! glTF requires MikkTSpace [glTF 2.0, 3.7.2.1]. One of its two Rust ports is unsafe and unmaintained. The other
//! recurses once per triangle around a vertex, so a fan of a million triangles overflows the stack, which no `Result`
//! can report. This is the same construction without its search for neighbours: per welded vertex (equal position,
//! normal and texture coordinate) and handedness, the mean of the triangles' tangents in the vertex's plane, weighted
//! by angle. It differs from MikkTSpace only if equal vertices belong to parts without a common edge.

use std::collections::HashMap;

use glam::{DVec2, DVec3, Vec3};

use super::mesh_part::MeshPart;

/// Fills `part.tangents` from texture coordinates `uv_set`. Duplicates vertices that are shared by triangles with
/// mirrored and unmirrored texture mapping.
pub fn generate(part: &mut MeshPart, uv_set: usize) {
    let welded = weld(part, uv_set);
    // Sums of triangle tangents per welded vertex: unmirrored, mirrored.
    let mut sums = vec![[DVec3::ZERO; 2]; welded.iter().map(|&w| w as usize + 1).max().unwrap_or(0)];
    let frames: Vec<Option<Frame>> = part.triangles.iter().map(|&t| Frame::of(part, uv_set, t)).collect();
    for (&triangle, frame) in part.triangles.iter().zip(&frames) {
        let Some(frame) = frame else { continue };
        for corner in 0..3 {
            let i = triangle[corner] as usize;
            let normal = part.normals[i].as_dvec3();
            let flat = |v: DVec3| (v - normal * normal.dot(v)).try_normalize();
            let [here, next, previous] = [0, 1, 2].map(|k| part.positions[triangle[(corner + k) % 3] as usize]);
            let (Some(tangent), Some(a), Some(b)) = (flat(frame.tangent), flat(next - here), flat(previous - here))
            else {
                continue;
            };
            sums[welded[i] as usize][frame.mirrored as usize] += tangent * a.dot(b).clamp(-1.0, 1.0).acos();
        }
    }
    assign(part, &welded, &sums, &frames);
}

/// Orientation of texture space on one triangle.
struct Frame {
    /// Direction of increasing u.
    tangent: DVec3,
    /// Whether the texture is mirrored. v points down, so it is unmirrored if (u, v) turns clockwise.
    mirrored: bool,
}

impl Frame {
    /// `None` if the triangle has no area in texture space.
    fn of(part: &MeshPart, uv_set: usize, triangle: [u32; 3]) -> Option<Self> {
        let [a, b, c] = triangle.map(|i| part.positions[i as usize]);
        let [s, t, u] = triangle.map(|i| part.uvs[uv_set][i as usize].as_dvec2());
        let (du, dv): (DVec2, DVec2) = (t - s, u - s);
        let determinant = du.perp_dot(dv);
        if determinant.abs() <= f64::MIN_POSITIVE {
            return None;
        }
        let tangent = ((b - a) * dv.y - (c - a) * du.y) * determinant.signum();
        Some(Self { tangent: tangent.try_normalize()?, mirrored: determinant > 0.0 })
    }
}

/// A number per vertex; vertices of equal position, normal and texture coordinate share it.
fn weld(part: &MeshPart, uv_set: usize) -> Vec<u32> {
    let mut numbers = HashMap::with_capacity(part.positions.len());
    (0..part.positions.len())
        .map(|i| {
            let position = part.positions[i].to_array().map(f64::to_bits);
            let normal = part.normals[i].to_array().map(f32::to_bits);
            let uv = part.uvs[uv_set][i].to_array().map(f32::to_bits);
            let next = numbers.len() as u32;
            *numbers.entry((position, normal, uv)).or_insert(next)
        })
        .collect()
}

fn assign(part: &mut MeshPart, welded: &[u32], sums: &[[DVec3; 2]], frames: &[Option<Frame>]) {
    const NONE: u32 = u32::MAX;
    let tangent = |normal: Vec3, sum: DVec3, mirrored: bool| {
        let axis = sum.as_vec3().try_normalize().unwrap_or_else(|| perpendicular(normal));
        axis.extend(if mirrored { -1.0 } else { 1.0 })
    };
    let given = part.positions.len();
    part.tangents = (0..given).map(|i| tangent(part.normals[i], sums[welded[i] as usize][0], false)).collect();
    // Duplicate of each vertex with the other handedness; the handedness of its first triangle uses the original
    // vertex.
    let mut taken = vec![None; given];
    let mut twin = vec![NONE; given];
    for (t, frame) in frames.iter().enumerate() {
        let Some(Frame { mirrored, .. }) = *frame else { continue };
        for corner in 0..3 {
            let i = part.triangles[t][corner] as usize;
            match taken[i] {
                None => {
                    taken[i] = Some(mirrored);
                    let sum = sums[welded[i] as usize][mirrored as usize];
                    part.tangents[i] = tangent(part.normals[i], sum, mirrored);
                }
                Some(same) if same == mirrored => {}
                Some(_) => {
                    if twin[i] == NONE {
                        twin[i] = part.positions.len() as u32;
                        part.positions.push(part.positions[i]);
                        part.normals.push(part.normals[i]);
                        for values in part.uvs.iter_mut().filter(|values| !values.is_empty()) {
                            values.push(values[i]);
                        }
                        if !part.colors.is_empty() {
                            part.colors.push(part.colors[i]);
                        }
                        let sum = sums[welded[i] as usize][mirrored as usize];
                        part.tangents.push(tangent(part.normals[i], sum, mirrored));
                    }
                    part.triangles[t][corner] = twin[i];
                }
            }
        }
    }
}

/// A unit vector perpendicular to `normal`.
pub fn perpendicular(normal: Vec3) -> Vec3 {
    normal.any_orthonormal_vector()
}
