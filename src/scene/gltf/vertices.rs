//! The vertices of one primitive: from accessors to a part of the mesh in world space.

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3, Vec4};
use gltf::json;
use json::accessor::Type;
use json::mesh::{Mode, Semantic};

use super::accessor::{F32, I8, I8_NORM, I16, I16_NORM, U8, U8_NORM, U16, U16_NORM};
use super::ignored_counts::IgnoredCounts;
use super::materials::MaterialUse;
use super::morph::Morphed;
use super::node_primitive::NodePrimitive;
use crate::error::Result;
use crate::scene::mesh_part::MeshPart;

/// Transform of vertices from the mesh's local space to world space.
pub enum Pose {
    /// One transform for all vertices.
    Rigid(DAffine3),
    /// Scaled to zero along one local axis. Only meshes that are flat along this axis retain their area; `directions`
    /// transforms their directions.
    Flat { world_from_mesh: DAffine3, axis: usize, directions: DMat3 },
    /// One transform per vertex.
    Skinned(Vec<DAffine3>),
}

impl Pose {
    fn of_positions(&self, vertex: usize) -> &DAffine3 {
        match self {
            Self::Rigid(world_from_mesh) | Self::Flat { world_from_mesh, .. } => world_from_mesh,
            Self::Skinned(transforms) => &transforms[vertex],
        }
    }

    fn of_directions(&self, vertex: usize) -> &DMat3 {
        match self {
            Self::Flat { directions, .. } => directions,
            _ => &self.of_positions(vertex).matrix3,
        }
    }

    /// Normal matrix of each vertex; computed once if all are equal.
    fn normal_matrices(&self) -> impl Fn(usize) -> DMat3 {
        let shared = (!matches!(self, Self::Skinned(_))).then(|| normal_matrix(*self.of_directions(0)));
        move |vertex| shared.unwrap_or_else(|| normal_matrix(*self.of_directions(vertex)))
    }

    /// Whether the transform reverses the winding of a triangle.
    fn turns(&self, triangle: [u32; 3]) -> bool {
        match self {
            Self::Skinned(_) => triangle.iter().filter(|&&v| mirrors(*self.of_directions(v as usize))).count() > 1,
            _ => mirrors(*self.of_directions(0)),
        }
    }
}

impl NodePrimitive<'_> {
    /// Upper bound of the vertices that are read for the primitive and that it produces, before anything is read; 0
    /// without positions.
    pub fn corner_count(&self, mode: Mode) -> Result<usize> {
        let Some(positions) = self.attribute(Semantic::Positions) else { return Ok(0) };
        let vertices = self.document.accessor_count(positions, &self.what)?;
        let indices = match self.primitive.indices {
            Some(indices) => self.document.accessor_count(indices.value(), &self.what)?,
            None => vertices,
        };
        let corners_per_index = if mode == Mode::Triangles { 1 } else { 3 };
        let read = vertices.saturating_mul(1 + self.active_target_count());
        Ok(read.saturating_add(indices.saturating_mul(corners_per_index)))
    }

    /// The primitive in world space; `None` if a flat pose leaves no area.
    pub fn part(
        &self,
        mode: Mode,
        positions: usize,
        pose: &Pose,
        material: &MaterialUse,
        ignored: &mut IgnoredCounts,
    ) -> Result<Option<MeshPart>> {
        let mut part = MeshPart { material: material.index as u32, ..MeshPart::default() };
        let local = self.positions(positions)?;
        if let Pose::Flat { axis, .. } = pose
            && local.iter().any(|p| p[*axis] != local[0][*axis])
        {
            return Ok(None);
        }
        part.positions = self.in_world(&local, pose)?;
        let count = part.positions.len();
        part.triangles = self.triangles(mode, count)?;
        part.triangles.iter_mut().filter(|t| pose.turns(**t)).for_each(|t| t.swap(1, 2));
        if let Some(index) = self.attribute(Semantic::Normals) {
            part.normals = self.normals(index, count, pose)?;
        }
        for (slot, set) in material.uv_sets.into_iter().enumerate() {
            let Some(set) = set else { continue };
            part.uvs[slot] = match self.attribute(Semantic::TexCoords(set)) {
                Some(index) => self.uvs(index, set, count, ignored)?,
                None => {
                    ignored.missing_uvs += 1;
                    vec![Vec2::ZERO; count]
                }
            };
        }
        if let Some(index) = self.attribute(Semantic::Colors(0)) {
            part.colors = self.colors(index, count)?;
            ignored.unlit_colors += usize::from(material.is_unlit);
        }
        part.tangents_from = material.tangents_from;
        if part.tangents_from.is_some()
            && let Some(index) = self.attribute(Semantic::Tangents)
        {
            part.tangents = self.tangents(index, count, pose)?;
        }
        Ok(Some(part))
    }

    /// In the mesh's local space, including morph targets.
    fn positions(&self, index: usize) -> Result<Vec<DVec3>> {
        let what = format!("{}: POSITION", self.what);
        let quantized = [I8, I8_NORM, U8, U8_NORM, I16, I16_NORM, U16, U16_NORM];
        let read = self.document.vectors::<3>(index, &what, &[F32], &quantized)?;
        let mut positions: Vec<DVec3> = read.into_iter().map(|p| Vec3::from_array(p).as_dvec3()).collect();
        self.morph(Morphed::Position, &mut positions)?;
        Ok(positions)
    }

    fn in_world(&self, positions: &[DVec3], pose: &Pose) -> Result<Vec<DVec3>> {
        let world = |(i, p): (usize, &DVec3)| {
            let world = pose.of_positions(i).transform_point3(*p);
            if world.is_finite() {
                return Ok(world);
            }
            Err(self.document.error(format!("{}: POSITION: vertex {i} is not finite", self.what)))
        };
        positions.iter().enumerate().map(world).collect()
    }

    fn normals(&self, index: usize, count: usize, pose: &Pose) -> Result<Vec<Vec3>> {
        let what = format!("{}: NORMAL", self.what);
        self.same_length(index, count, "NORMAL")?;
        let read = self.document.vectors::<3>(index, &what, &[F32], &[I8_NORM, I16_NORM])?;
        let mut normals: Vec<DVec3> = read.into_iter().map(|n| Vec3::from_array(n).as_dvec3()).collect();
        self.morph(Morphed::Normal, &mut normals)?;
        let matrix = pose.normal_matrices();
        Ok(normals.into_iter().enumerate().map(|(i, n)| direction(matrix(i), n)).collect())
    }

    fn uvs(&self, index: usize, set: u32, count: usize, ignored: &mut IgnoredCounts) -> Result<Vec<Vec2>> {
        let name = format!("TEXCOORD_{set}");
        let what = format!("{}: {name}", self.what);
        let quantized = [I8, I8_NORM, U8, I16, I16_NORM, U16];
        self.same_length(index, count, &name)?;
        let uvs = self.document.vectors::<2>(index, &what, &[F32, U8_NORM, U16_NORM], &quantized)?;
        ignored.bad_uvs += uvs.iter().filter(|uv| uv.iter().any(|t| !t.is_finite())).count();
        // Texture lookups read non-finite values as 0; tangent generation does not.
        Ok(uvs.into_iter().map(|uv| Vec2::from_array(uv.map(|t| if t.is_finite() { t } else { 0.0 }))).collect())
    }

    fn colors(&self, index: usize, count: usize) -> Result<Vec<Vec4>> {
        let document = self.document;
        let what = format!("{}: COLOR_0", self.what);
        let forms = [F32, U8_NORM, U16_NORM];
        self.same_length(index, count, "COLOR_0")?;
        let colors: Vec<Vec4> = match document.accessor_type(index, &what)? {
            Type::Vec3 => {
                let rgb = document.vectors::<3>(index, &what, &forms, &[])?;
                rgb.into_iter().map(|c| Vec3::from_array(c).extend(1.0)).collect()
            }
            _ => document.vectors::<4>(index, &what, &forms, &[])?.into_iter().map(Vec4::from_array).collect(),
        };
        if let Some(i) = colors.iter().position(|c| !c.is_finite()) {
            return Err(document.error(format!("{what}: vertex {i} is not finite")));
        }
        Ok(colors.into_iter().map(|c| c.clamp(Vec4::ZERO, Vec4::ONE)).collect())
    }

    fn tangents(&self, index: usize, count: usize, pose: &Pose) -> Result<Vec<Vec4>> {
        let what = format!("{}: TANGENT", self.what);
        self.same_length(index, count, "TANGENT")?;
        let read = self.document.vectors::<4>(index, &what, &[F32], &[I8_NORM, I16_NORM])?;
        let mut axes: Vec<DVec3> = read.iter().map(|t| Vec3::new(t[0], t[1], t[2]).as_dvec3()).collect();
        self.morph(Morphed::Tangent, &mut axes)?;
        let world = |(i, (axis, t)): (usize, (DVec3, [f32; 4]))| {
            let matrix = *pose.of_directions(i);
            // A mirrored node mirrors the bitangent too, which cross(normal, tangent) does not account for.
            direction(matrix, axis).extend(t[3] * if mirrors(matrix) { -1.0 } else { 1.0 })
        };
        Ok(axes.into_iter().zip(read).enumerate().map(world).collect())
    }

    fn triangles(&self, mode: Mode, vertex_count: usize) -> Result<Vec<[u32; 3]>> {
        let document = self.document;
        let indices = match self.primitive.indices {
            Some(indices) => document.indices(indices.value(), &format!("{}: indices", self.what))?,
            None => (0..vertex_count as u32).collect(),
        };
        if let Some(index) = indices.iter().find(|&&i| i as usize >= vertex_count) {
            let reason = format!("{}: index {index} is out of range, there are {vertex_count} vertices", self.what);
            return Err(document.error(reason));
        }
        let (i, n) = (&indices, indices.len());
        Ok(match mode {
            Mode::Triangles if !n.is_multiple_of(3) => {
                return Err(document.error(format!("{}: {n} indices are not a multiple of three", self.what)));
            }
            // Every second triangle of a strip is reversed, so that all have the same winding [glTF 2.0, 3.7.2.1].
            Mode::TriangleStrip => {
                (0..n.saturating_sub(2)).map(|k| [i[k], i[k + 1 + k % 2], i[k + 2 - k % 2]]).collect()
            }
            Mode::TriangleFan => (1..n.saturating_sub(1)).map(|k| [i[k], i[k + 1], i[0]]).collect(),
            _ => i.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        })
    }
}

/// `matrix` times a direction, normalized; zero if it vanishes, for the builder to replace.
fn direction(matrix: DMat3, v: DVec3) -> Vec3 {
    let turned = matrix * v;
    // Scaled before squaring, so that tiny and huge scales neither underflow nor overflow.
    let scaled = turned / turned.abs().max_element();
    scaled.try_normalize().map_or(Vec3::ZERO, |n| n.as_vec3())
}

/// The inverse transpose up to a positive factor, from cofactors, which exist for every scale.
fn normal_matrix(matrix: DMat3) -> DMat3 {
    let largest = matrix.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    let (x, y, z) = (matrix.x_axis / largest, matrix.y_axis / largest, matrix.z_axis / largest);
    let sign = if mirrors(matrix) { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign
}

/// Whether a matrix changes handedness. Columns are scaled first, so that nothing underflows.
fn mirrors(matrix: DMat3) -> bool {
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|c| c / c.abs().max_element());
    x.cross(y).dot(z) < 0.0
}
