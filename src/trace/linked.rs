//! A scene as one light meets it: surfaces that receive more or less of its light, and surfaces that cast no shadow.

use std::cell::Cell;
use std::ops::Deref;

use glam::Vec3;

use super::bvh::{Hit, MIN_TRANSMITTANCE, SingleRay, TracedScene, blocked_share, passes_by_chance};
use crate::scene::ResolvedLinks;

/// A scene with the links of one light.
#[derive(Clone, Copy)]
pub struct LinkedScene<'a> {
    scene: &'a TracedScene,
    links: Option<&'a ResolvedLinks>,
}

impl Deref for LinkedScene<'_> {
    type Target = TracedScene;

    fn deref(&self) -> &TracedScene {
        self.scene
    }
}

impl<'a> From<&'a TracedScene> for LinkedScene<'a> {
    fn from(scene: &'a TracedScene) -> Self {
        scene.linked(None)
    }
}

impl TracedScene {
    /// The scene as a light with these links meets it.
    pub fn linked<'a>(&'a self, links: Option<&'a ResolvedLinks>) -> LinkedScene<'a> {
        LinkedScene { scene: self, links }
    }
}

impl<'a> LinkedScene<'a> {
    /// Factor on the light that a triangle receives; 0 if it is not lit.
    pub fn factor(self, triangle: u32) -> f32 {
        self.links.map_or(1.0, |links| links.factor(&self.mesh, triangle))
    }

    /// Whether everything receives all of the light.
    pub fn is_lit_evenly(self) -> bool {
        self.links.is_none_or(ResolvedLinks::light_evenly)
    }

    /// Whether a triangle casts a shadow.
    #[inline(always)]
    pub fn casts_shadow(self, triangle: u32) -> bool {
        self.links.is_none_or(|links| links.casts_shadow(&self.mesh, triangle))
    }

    /// Whether everything casts a shadow.
    pub fn everything_casts_shadow(self) -> bool {
        self.links.is_none_or(ResolvedLinks::everything_casts_shadow)
    }

    /// Share of light that passes along the ray from its origin to `max_distance`, through all blending surfaces and
    /// all that cast no shadow.
    pub fn transmittance(self, origin: Vec3, direction: Vec3, max_distance: f32) -> f32 {
        let left = Cell::new(1.0f32);
        let passes = |hit: &Hit| {
            left.set(left.get() * (1.0 - self.blocked_share(hit)));
            left.get() >= MIN_TRANSMITTANCE
        };
        let (bvh, may_pass) = (&self.scene.bvh, self.may_pass());
        let is_blocked = SingleRay { bvh, origin, direction, max_distance, may_pass, passes }.occluded();
        if is_blocked { 0.0 } else { left.get() }
    }

    /// The surfaces that a ray of the light meets, up to the first that casts a shadow; blending surfaces are hit by
    /// chance, as in [`TracedScene::closest_hit`].
    pub fn surfaces_met(self, origin: Vec3, direction: Vec3) -> impl Iterator<Item = Hit> + use<'a> {
        let beyond = move |distance: f32| {
            let passes = |hit: &Hit| {
                let is_behind = hit.distance <= distance && !self.casts_shadow(hit.triangle);
                is_behind || passes_by_chance(&self, hit.triangle, hit.barycentric, [origin, direction])
            };
            let (bvh, may_pass, max_distance) = (&self.scene.bvh, self.may_pass(), f32::INFINITY);
            SingleRay { bvh, origin, direction, max_distance, may_pass, passes }.closest_hit()
        };
        let next = move |hit: &Hit| (!self.casts_shadow(hit.triangle)).then(|| beyond(hit.distance))?;
        std::iter::successors(beyond(0.0), next)
    }

    /// Share of light that a surface blocks at a point.
    #[inline(never)] // inlined, it would slow rays down that pass nothing
    fn blocked_share(self, hit: &Hit) -> f32 {
        if self.casts_shadow(hit.triangle) { blocked_share(&self, hit.triangle, hit.barycentric) } else { 0.0 }
    }

    fn may_pass(self) -> bool {
        self.bvh.has_masks || !self.everything_casts_shadow()
    }
}
