//! Barn doors as flaps at the light.

use glam::DVec3;

use super::Gizmos;
use crate::scene::{Light, LightKind};

/// Length of a flap, physical pixels if seen from its side.
const LENGTH: f32 = 45.0;

/// A barn door: a flap from its hinge at the edge of the light to its free edge.
pub struct Flap {
    /// Middle of the hinge.
    hinge: DVec3,
    /// From the hinge to the free edge.
    to_edge: DVec3,
    /// Half of the hinge, along it.
    half: DVec3,
}

impl Flap {
    /// The middle of the free edge, where the mouse drags.
    pub fn handle(&self) -> DVec3 {
        self.hinge + self.to_edge
    }

    pub fn corners(&self) -> [DVec3; 4] {
        let (near, far) = (self.hinge, self.handle());
        [near - self.half, near + self.half, far + self.half, far - self.half]
    }
}

impl Gizmos<'_> {
    /// Returns the barn doors that a light has, in the order of their angles.
    pub fn doors(&self, light: &Light) -> impl Iterator<Item = Flap> {
        let has_doors = light.kind.is_aimed();
        let doors = light.filter.barn_doors.filter(|_| has_doors);
        let angles = doors.into_iter().flat_map(|doors| doors.angles.into_iter().enumerate());
        angles.map(|(door, angle)| self.door(light, door, angle))
    }

    /// Returns a door of `light` as it is at `angle`, radians from the light's direction.
    pub fn door(&self, light: &Light, door: usize, angle: f64) -> Flap {
        let length = self.length(light, LENGTH);
        let [width, height] = light.axes();
        let (across, along, side) = match door {
            0 => (-width, height, 0),
            1 => (width, height, 0),
            2 => (height, width, 1),
            _ => (-height, width, 1),
        };
        let half = match light.kind {
            LightKind::Rect => light.size.map(|side| side / 2.0),
            _ => [light.radius; 2],
        };
        // A punctual light gets a small frame.
        let half = half.map(|half| half.max(length / 3.0));
        let (sin, cos) = angle.sin_cos();
        Flap {
            hinge: light.position + across * half[side],
            to_edge: (light.direction * cos + across * sin) * length,
            half: along * half[1 - side],
        }
    }
}
