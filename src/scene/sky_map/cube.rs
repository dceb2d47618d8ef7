//! Cube maps, resampled to equirectangular maps.

use std::f32::consts::{PI, TAU};

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::{MAX_WIDTH, SkyMap, Texels, reduced};

/// A face of a cube map. Its rows and columns lead as those of OpenGL do [OpenGL 4.6, Table 8.19].
pub struct CubeFace(Texels);

impl CubeFace {
    /// `values`: `side` * `side`, linear Rec. 709, finite and not negative, row by row.
    pub fn new(side: usize, values: Vec<Vec3>) -> Self {
        Self(reduced(Texels { width: side, height: side, values }, MAX_WIDTH / 4))
    }
}

impl SkyMap {
    /// The map whose radiance in a direction is that of a cube map in the direction `cube_from_map` * direction.
    ///
    /// `faces`: +x, -x, +y, -y, +z, -z of the cube; of equal size.
    ///
    /// # Panics
    /// If there are not six faces.
    pub fn of_cube(faces: &[CubeFace], cube_from_map: Mat3) -> Self {
        assert_eq!(faces.len(), 6, "faces of a cube");
        let side = faces[0].0.width;
        let (width, height) = (4 * side, 2 * side);
        // Sixteen readings a texel: near the corners of faces, their texels are much smaller than those of the map.
        let places = |i: usize, count: usize| (0..4).map(move |j| (i as f32 + (j as f32 + 0.5) / 4.0) / count as f32);
        let texel = |i: usize| {
            let mut sum = Vec3::ZERO;
            for v in places(i / width, height) {
                let (sine, cosine) = (PI * v).sin_cos();
                for u in places(i % width, width) {
                    let (sin, cos) = (TAU * u).sin_cos();
                    sum += read(faces, cube_from_map * Vec3::new(sine * sin, cosine, -sine * cos));
                }
            }
            sum / 16.0
        };
        Self::new(Texels { width, height, values: (0..width * height).into_par_iter().map(texel).collect() })
    }
}

/// The cube map in a direction of any length, interpolated within the face.
fn read(faces: &[CubeFace], direction: Vec3) -> Vec3 {
    let axis = direction.abs().max_position();
    let major = direction[axis];
    let (x, y) = match axis {
        0 => (-direction.z * major.signum(), -direction.y),
        1 => (direction.x, direction.z * major.signum()),
        _ => (direction.x * major.signum(), -direction.y),
    };
    let face = &faces[2 * axis + usize::from(major < 0.0)].0;
    let side = face.width as f32;
    // Not beyond the middles of the outer texels: there the other side of the face would be next.
    let [x, y] = [x, y].map(|at| ((at / major.abs() + 1.0) / 2.0 * side).clamp(0.5, side - 0.5));
    face.interpolated(x, y)
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;

    const SIDE: usize = 32;

    /// Red and green grow with column and row; blue is the number of the face.
    fn faces() -> Vec<CubeFace> {
        let middle = |i: usize| (i as f32 + 0.5) / SIDE as f32;
        let face = |face: u8| {
            let value = |i: usize| Vec3::new(middle(i % SIDE), middle(i / SIDE), face.into());
            CubeFace::new(SIDE, (0..SIDE * SIDE).map(value).collect())
        };
        (0..6).map(face).collect()
    }

    #[track_caller]
    fn assert_near(got: Vec3, want: [f32; 3]) {
        // A texel of the cube is 0.03 wide. At the poles, the map is read half a texel away.
        assert!(got.distance(want.into()) < 0.02, "{got}, want {want:?}");
    }

    /// OpenGL's definition, written out: direction, and face, column and row there.
    #[test]
    fn faces_lie_as_in_opengl() {
        let map = SkyMap::of_cube(&faces(), Mat3::IDENTITY);
        for (direction, [face, s, t]) in [
            ([1.0, 0.0, 0.0], [0.0, 0.5, 0.5]),
            ([-1.0, 0.0, 0.0], [1.0, 0.5, 0.5]),
            ([0.0, 1.0, 0.0], [2.0, 0.5, 0.5]),
            ([0.0, -1.0, 0.0], [3.0, 0.5, 0.5]),
            ([0.0, 0.0, 1.0], [4.0, 0.5, 0.5]),
            ([0.0, 0.0, -1.0], [5.0, 0.5, 0.5]),
            ([1.0, 0.5, 0.25], [0.0, 0.375, 0.25]),
            ([-1.0, 0.5, 0.25], [1.0, 0.625, 0.25]),
            ([0.5, 1.0, 0.25], [2.0, 0.75, 0.625]),
            ([0.5, -1.0, 0.25], [3.0, 0.75, 0.375]),
            ([0.5, 0.25, 1.0], [4.0, 0.75, 0.375]),
            ([0.5, 0.25, -1.0], [5.0, 0.25, 0.375]),
        ] {
            assert_near(map.radiance(Vec3::from(direction).normalize()), [s, t, face]);
        }
    }

    #[test]
    fn turned_cubes_show_other_faces() {
        let turn = Quat::from_rotation_z(PI / 2.0);
        let map = SkyMap::of_cube(&faces(), Mat3::from_quat(turn));
        // What is read at +x is the cube's +y, and so on.
        assert_near(map.radiance(Vec3::X), [0.5, 0.5, 2.0]);
        assert_near(map.radiance(Vec3::Y), [0.5, 0.5, 1.0]);
        assert_near(map.radiance(Vec3::Z), [0.5, 0.5, 4.0]);
    }

    /// In the corner of a face, at its edge, and in its middle.
    #[test]
    fn light_of_single_texels_is_kept() {
        const SIDE: usize = 8;
        for lit in [0, 1, 3, 27] {
            let face = |face: usize| {
                let value = |i: usize| if (face, i) == (4, lit) { Vec3::ONE } else { Vec3::ZERO };
                CubeFace::new(SIDE, (0..SIDE * SIDE).map(value).collect())
            };
            let faces: Vec<CubeFace> = (0..6).map(face).collect();
            let map = SkyMap::of_cube(&faces, Mat3::IDENTITY);
            let (mut got, mut want) = (0.0, 0.0);
            // Midpoint rule.
            for i in 0..1 << 18 {
                let [u, v] = [i % 512, i / 512].map(|i| (i as f32 + 0.5) / 512.0);
                let [(sin, cos), (sine, cosine)] = [TAU * u, PI * v].map(f32::sin_cos);
                let direction = Vec3::new(sine * sin, cosine, -sine * cos);
                got += f64::from(map.radiance(direction).x * sine);
                want += f64::from(read(&faces, direction).x * sine);
            }
            // The readings miss or double so much of a corner.
            assert!((got / want - 1.0).abs() < 0.06, "texel {lit}: {got}, want {want}");
        }
    }

    #[test]
    fn fine_faces_are_as_fine_as_the_finest_map() {
        let side = MAX_WIDTH / 2;
        let face = CubeFace::new(side, vec![Vec3::ONE; side * side]).0;
        assert_eq!([4 * face.width, 2 * face.height], [MAX_WIDTH, MAX_WIDTH / 2]);
        assert!(face.values.iter().all(|&value| value == Vec3::ONE));
    }
}
