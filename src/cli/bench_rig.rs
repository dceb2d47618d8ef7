//! Lights for benchmarks: a scene's own, then more placed by a seed.

use glam::DVec3;
use relume::scene::{Light, LightKind, Rig};

use relume::Session;

/// `count` lights: the scene's own, then points and spots in turn, above and around what is seen.
pub fn light_like_scene(session: &Session, count: usize, seed: u64) -> Rig {
    let mut rig = session.rig.clone();
    rig.lights.truncate(count);
    let (lo, hi) = session.scene.mesh.bounds();
    let space = session.scene.space;
    let (center, half) = (space.to_world((lo + hi) / 2.0), space.unit * (hi - lo).as_dvec3() / 2.0);
    let mut random = Random(seed);
    for i in rig.lights.len()..count {
        let position = center + half * DVec3::new(random.signed(), random.signed().abs(), random.signed());
        let target = center + 0.5 * half * DVec3::new(random.signed(), -1.0, random.signed());
        rig.lights.push(Light {
            kind: if i % 2 == 0 { LightKind::Point } else { LightKind::Spot },
            direction: (target - position).try_normalize().unwrap_or(DVec3::NEG_Y),
            color: DVec3::new(random.signed(), random.signed(), random.signed()).as_vec3() * 0.5 + 0.5,
            intensity: half.length_squared(),
            inner_angle: 15f64.to_radians(),
            outer_angle: 30f64.to_radians(),
            ..Light::point(&format!("bench{i}"), position)
        });
    }
    rig
}

/// Moves `light` off `original` by some percent of the scene's size; turns a dome by as many degrees as `step` says.
pub fn nudge(light: &mut Light, original: &Light, session: &Session, step: f64) {
    light.rotation = original.rotation + step.to_radians();
    let offset = DVec3::new((step * 0.7).sin(), 0.5 * (step * 1.3).sin(), (step * 1.9).sin()) * 0.03;
    light.position = original.position + offset * session.scene.space.unit;
    light.direction = (original.direction + 0.3 * offset).normalize();
}

/// [Steele 2014]: SplitMix64.
struct Random(u64);

impl Random {
    /// Uniform in [-1, 1).
    fn signed(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 * f64::exp2(-52.0) - 1.0
    }
}
