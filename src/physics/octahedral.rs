//! Unit vectors as two floats [Cigolle 2014]; GLSL decodes them in `lib/brdf.glsl`.

use glam::{Vec2, Vec3};

/// Octahedral map of `v`, which must not be zero but may have any length. Decodes to its direction within 4.5e-7.
pub fn encode(v: Vec3) -> Vec2 {
    let v = v / (v.x.abs() + v.y.abs() + v.z.abs());
    let p = Vec2::new(v.x, v.y);
    let sign = |x: f32| if x >= 0.0 { 1.0 } else { -1.0 };
    if v.z >= 0.0 { p } else { Vec2::new((1.0 - p.y.abs()) * sign(p.x), (1.0 - p.x.abs()) * sign(p.y)) }
}

/// Unit vector from its octahedral map.
pub fn decode(e: Vec2) -> Vec3 {
    let mut v = Vec3::new(e.x, e.y, 1.0 - e.x.abs() - e.y.abs());
    let fold = (-v.z).max(0.0);
    v.x += if v.x >= 0.0 { -fold } else { fold };
    v.y += if v.y >= 0.0 { -fold } else { fold };
    v.normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn decodes_what_it_encodes(x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0) {
            let v = Vec3::new(x, y, z);
            prop_assume!(v.length() > 1e-3);
            let v = v.normalize();
            // Half an ulp each from division, 1 - |y|, the sum, the fold and its subtraction, in components below 1:
            // 1.5e-7; times sqrt(3) for three components, and sqrt(3) again where the map's length is 1 / sqrt(3).
            prop_assert!(decode(encode(v)).distance(v) < 4.5e-7);
        }
    }
}
