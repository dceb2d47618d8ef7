//! The extensions of glTF for lights, and which of them holds a light.

use std::f64::consts::FRAC_PI_2;

use crate::scene::light_filter::ies::PhotometricType;
use crate::scene::{Light, LightKind, LightUnit};

/// An extension with a list of lights to which nodes refer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightExtension {
    /// `KHR_lights_punctual`: points, spots and directional lights, all punctual.
    Punctual,
    /// `EXT_lights_area`: rectangles and disks.
    Area,
    /// `EXT_lights_ies`: points with an IES profile.
    Profile,
}

/// Nits of a candela that `EXT_lights_area` holds. Beyond, products with a node's scale might not be finite.
const NITS: std::ops::RangeInclusive<f64> = 1e-30..=1e30;
/// Ratios of width and height that `EXT_lights_area` holds.
const ASPECTS: std::ops::RangeInclusive<f64> = 1e-15..=1e15;

impl LightExtension {
    pub const ALL: [Self; 3] = [Self::Punctual, Self::Area, Self::Profile];

    pub fn name(self) -> &'static str {
        match self {
            Self::Punctual => "KHR_lights_punctual",
            Self::Area => "EXT_lights_area",
            Self::Profile => "EXT_lights_ies",
        }
    }

    /// The extension that holds most of `light`.
    pub fn of(light: &Light) -> Self {
        let has_area = || light.per_intensity(LightUnit::Nit).is_some_and(|nits| NITS.contains(&nits));
        match light.kind {
            LightKind::Disk if has_area() => Self::Area,
            LightKind::Rect if has_area() && ASPECTS.contains(&(light.size[0] / light.size[1])) => Self::Area,
            LightKind::Point if light.filter.ies.is_some() => Self::Profile,
            _ => Self::Punctual,
        }
    }
}

impl Light {
    /// The nearest light that [`LightExtension::of`] holds: flat lights without an area become spots of 180 degrees.
    pub fn nearest_in_gltf(&self) -> Self {
        let is_flat = matches!(self.kind, LightKind::Disk | LightKind::Rect);
        if is_flat && LightExtension::of(self) == LightExtension::Punctual {
            return Self { kind: LightKind::Spot, inner_angle: 0.0, outer_angle: FRAC_PI_2, ..self.clone() };
        }
        self.clone()
    }

    /// Which axis of a node with this light is the light's upward axis, if it matters how the light is turned about its
    /// direction. `EXT_lights_ies` maps x of a profile to x of the node, and x is up for types A and B.
    pub fn up_axis_in_gltf(&self) -> Option<usize> {
        match (self.kind, &self.filter.ies) {
            (LightKind::Rect, _) => Some(1),
            (LightKind::Point, Some(ies)) if ies.photometric_type == PhotometricType::C => Some(1),
            (LightKind::Point, Some(_)) => Some(0),
            _ => None,
        }
    }
}
