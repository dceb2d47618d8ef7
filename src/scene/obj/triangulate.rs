//! Polygons into triangles.
//!
//! [Sutherland 1974]: I. Sutherland, R. Sproull, R. Schumacker, A characterization of ten hidden-surface algorithms,
//! ACM Computing Surveys 6(1).

use glam::{DVec2, DVec3};

/// Triangles of a flat polygon as indices of its corners, wound as it is.
///
/// A fan where it is convex, else ears cut off one by one; where no ear is left (the outline crosses itself) a fan of
/// the rest.
pub fn polygon(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let fan = |rest: &[usize]| (1..rest.len() - 1).map(|i| [rest[0], rest[i], rest[i + 1]]).collect::<Vec<_>>();
    let mut rest: Vec<usize> = (0..corners.len()).collect();
    if corners.len() == 3 {
        return fan(&rest);
    }
    let flat = flattened(corners);
    let mut triangles = Vec::with_capacity(corners.len() - 2);
    // Outlines made to have few ears must not cost cubic time.
    let mut tries = 8 * corners.len();
    let mut from = 0;
    while rest.len() > 3 {
        let n = rest.len();
        let turn = |i: usize| turns(flat[rest[(i + n - 1) % n]], flat[rest[i]], flat[rest[(i + 1) % n]]);
        if (0..n).all(|i| turn(i) >= 0.0) {
            break;
        }
        let is_ear = |i: usize| {
            let [a, b, c] = [rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]];
            let holds = |p: DVec2| {
                turns(flat[a], flat[b], p) >= 0.0
                    && turns(flat[b], flat[c], p) >= 0.0
                    && turns(flat[c], flat[a], p) >= 0.0
            };
            turn(i) > 0.0 && rest.iter().all(|&p| [a, b, c].contains(&p) || !holds(flat[p]))
        };
        let found = (0..n.min(tries)).map(|k| (from + k) % n).inspect(|_| tries -= 1).find(|&i| is_ear(i));
        let Some(ear) = found else { break };
        from = ear;
        triangles.push([rest[(ear + n - 1) % n], rest[ear], rest[(ear + 1) % n]]);
        rest.remove(ear);
    }
    triangles.extend(fan(&rest));
    triangles
}

/// Corners in the polygon's own plane, counter-clockwise, by Newell's normal [Sutherland 1974].
fn flattened(corners: &[DVec3]) -> Vec<DVec2> {
    let next = corners.iter().cycle().skip(1);
    let first = corners[0];
    let normal: DVec3 = corners.iter().zip(next).map(|(&a, &b)| (a - first).cross(b - first)).sum();
    let Some(normal) = normal.try_normalize() else { return vec![DVec2::ZERO; corners.len()] };
    let (x, y) = normal.any_orthonormal_pair();
    // (x, y, normal) must be right-handed for counter-clockwise to stay so.
    let y = if x.cross(y).dot(normal) < 0.0 { -y } else { y };
    corners.iter().map(|&p| DVec2::new((p - first).dot(x), (p - first).dot(y))).collect()
}

/// Positive if a, b, c turns left.
fn turns(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> DVec3 {
        triangles.iter().map(|&[a, b, c]| (corners[b] - corners[a]).cross(corners[c] - corners[a]) / 2.0).sum()
    }

    #[test]
    fn concave_polygons_keep_their_area() {
        // An L, started at its inner corner's neighbour, so that a fan would leave it.
        let l = [(0., 0.), (2., 0.), (2., 1.), (1., 1.), (1., 2.), (0., 2.)].map(|(x, y)| DVec3::new(x, 0.5, -y));
        for first in 0..6 {
            let mut corners = l;
            corners.rotate_left(first);
            let triangles = polygon(&corners);
            assert_eq!(triangles.len(), 4);
            assert!((area(&corners, &triangles) - DVec3::new(0.0, 3.0, 0.0)).length() < 1e-12);
            for t in &triangles {
                assert!(area(&corners, &[*t]).y > 0.0, "{triangles:?} from {first}");
            }
        }
    }

    #[test]
    fn nonsense_still_ends() {
        let bow = [DVec3::ZERO, DVec3::new(1., 1., 0.), DVec3::X, DVec3::Y];
        assert_eq!(polygon(&bow).len(), 2);
        assert_eq!(polygon(&[DVec3::ONE; 7]).len(), 5);
    }
}
