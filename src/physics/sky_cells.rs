//! Cells of equal solid angle that divide the sky: squares of the equal-area octahedral map [Clarberg 2008], in
//! Z-order, so that neighbours in the list are neighbours in the sky.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_4, PI};

use glam::{DVec3, Vec3};

/// Cells along a side of the map.
const SIDE: usize = 64;
/// Number of cells.
pub const COUNT: usize = SIDE * SIDE;
/// Of a cell, sr.
pub const SOLID_ANGLE: f64 = 4.0 * PI / COUNT as f64;

/// The cell that a unit direction lies in.
pub fn index(direction: Vec3) -> usize {
    let [x, y, z] = direction.as_dvec3().to_array();
    let r = (1.0 - y.abs()).max(0.0).sqrt();
    let v = r * FRAC_2_PI * z.abs().atan2(x.abs());
    let u = r - v;
    let (u, v) = if y < 0.0 { (1.0 - v, 1.0 - u) } else { (u, v) };
    let cell = |along: f64| ((0.5 + 0.5 * along) * SIDE as f64).clamp(0.0, SIDE as f64 - 1.0) as usize;
    spread(cell(u.copysign(x))) | spread(cell(v.copysign(z))) << 1
}

/// The unit direction at a place in a cell, which is a unit square.
pub fn direction(cell: usize, within: [f64; 2]) -> DVec3 {
    let along = |bit: usize| 2.0 * (gather(cell >> bit) as f64 + within[bit]) / SIDE as f64 - 1.0;
    let [u, v] = [along(0), along(1)];
    let [a, b] = [u.abs(), v.abs()];
    let above = 1.0 - a - b;
    let r = 1.0 - above.abs();
    let (sin, cos) = (if r > 0.0 { FRAC_PI_4 * ((b - a) / r + 1.0) } else { 0.0 }).sin_cos();
    let across = r * (2.0 - r * r).sqrt();
    DVec3::new((across * cos).copysign(u), (1.0 - r * r).copysign(above), (across * sin).copysign(v))
}

/// The bits of a number at even places.
fn spread(number: usize) -> usize {
    (0..SIDE.trailing_zeros()).map(|bit| (number >> bit & 1) << (2 * bit)).sum()
}

/// The bits at even places of a number.
fn gather(number: usize) -> usize {
    (0..SIDE.trailing_zeros()).map(|bit| (number >> (2 * bit) & 1) << bit).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::sequence::Points;

    #[test]
    fn directions_lie_in_their_cells() {
        for cell in 0..COUNT {
            for within in [[0.01, 0.01], [0.5, 0.5], [0.99, 0.3]] {
                let direction = direction(cell, within);
                assert!((direction.length() - 1.0).abs() < 1e-12);
                assert_eq!(index(direction.as_vec3()), cell, "{direction}");
            }
        }
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
            assert!(index(axis) < COUNT);
        }
    }

    #[test]
    fn all_cells_have_the_same_solid_angle() {
        let mut counts = vec![0u32; COUNT];
        let points = Points::new(1, 0);
        for i in 0..64 * COUNT as u32 {
            let [u, v, ..] = points.at(i, 0);
            let (sin, cos) = (2.0 * PI * v).sin_cos();
            let (y, r) = (1.0 - 2.0 * u, 2.0 * (u * (1.0 - u)).sqrt());
            counts[index(DVec3::new(r * cos, y, r * sin).as_vec3())] += 1;
        }
        assert!(counts.iter().all(|&count| count.abs_diff(64) <= 24), "{:?}", counts.iter().max());
    }

    #[test]
    fn cells_of_a_quarter_of_the_list_are_near_each_other() {
        for first in (0..COUNT).step_by(COUNT / 64) {
            let middle = direction(first, [0.5; 2]);
            for cell in first..first + COUNT / 64 {
                assert!(middle.angle_between(direction(cell, [0.5; 2])) < 1.0, "{first}, {cell}");
            }
        }
    }
}
