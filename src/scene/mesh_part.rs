//! One part of a mesh before it is built: the triangles of one material and object.

use glam::{DVec3, Vec2, Vec3, Vec4};

/// Triangles of one material and object in world space. Optional attributes are empty, or as long as `positions`.
#[derive(Default)]
pub struct MeshPart {
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
    /// Index into [`Scene::objects`](super::Scene::objects).
    pub object: u32,
    /// Texture coordinate set of the material's normal map, if it has one.
    pub tangents_from: Option<usize>,
}

impl MeshPart {
    /// Gives every triangle its own vertices with the face normal. Discards tangents, because they require normals
    /// [glTF 2.0, 3.7.2.1].
    pub fn make_flat(&mut self) {
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
    pub fn repair_normals(&mut self) -> usize {
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
        let replaced = sums.len();
        for (i, sum) in sums {
            self.normals[i as usize] = sum.try_normalize().unwrap_or(Vec3::Y);
        }
        replaced
    }

    fn face_normal(&self, triangle: [u32; 3]) -> Vec3 {
        let [a, b, c] = triangle.map(|i| self.positions[i as usize]);
        // Edges are normalized, so that tiny triangles do not underflow.
        let normal = (b - a).normalize().cross((c - a).normalize());
        normal.try_normalize().map_or(Vec3::Y, |n| n.as_vec3())
    }
}

/// Replaces `values` by those at `indices`, unless they are empty.
pub fn gather<T: Copy>(values: &mut Vec<T>, indices: &[usize]) {
    if !values.is_empty() {
        *values = indices.iter().map(|&i| values[i]).collect();
    }
}
