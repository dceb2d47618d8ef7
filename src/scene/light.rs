//! Lights as artists edit them: world space, double precision, with colour and intensity separate from the pose.

use std::f64::consts::{FRAC_PI_4, PI, TAU};

use glam::{DQuat, DVec2, DVec3, Vec3};

use super::light_unit::LEAST_FALLOFF;
use super::{DomeMap, LightFilter, Links, MeshSpace, SkyMap, WideLight};
use crate::shared::{LIGHT_DIRECTIONAL, LIGHT_FACET, LIGHT_POINT, LIGHT_SPOT, LIGHT_TWO_SIDED_FACET, PackedLight};

/// The light types of `KHR_lights_punctual`, and flat lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LightKind {
    /// With a radius: a sphere.
    Point,
    /// With a radius: a disk whose points all shine like the spot.
    Spot,
    /// With an angle: the sun.
    Directional,
    Disk,
    Rect,
    /// Light from all directions: the sky, or an environment map.
    Dome,
    /// Emissive materials of one name.
    Emitter,
}

impl LightKind {
    /// Whether the light has a position: neither does it come from far away, nor do surfaces emit it.
    pub fn has_position(self) -> bool {
        !matches!(self, Self::Directional | Self::Dome | Self::Emitter)
    }

    /// Whether nodes of glTF have lights of this kind, or some that are nearly alike.
    pub fn is_in_gltf(self) -> bool {
        !matches!(self, Self::Dome | Self::Emitter)
    }

    /// Whether its light can pass a gobo or barn doors.
    pub fn is_aimed(self) -> bool {
        matches!(self, Self::Spot | Self::Disk | Self::Rect)
    }
}

/// One light. Its image is linear in `color * intensity * 2^stops`; any other change requires shading it again.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Unique in its rig; contains no dot, because image layers are called `light.NAME`.
    pub name: String,
    pub kind: LightKind,
    /// World space, metres; the middle of area lights; ignored for directional lights and domes.
    pub position: DVec3,
    /// Unit direction of emission; ignored for point lights and domes.
    pub direction: DVec3,
    /// Linear Rec. 709.
    pub color: Vec3,
    /// Candela, straight ahead for flat lights; lux for directional lights. Does not depend on the light's size. Of
    /// domes: cd/m², or what their map is multiplied by. Of emitters: what their material's emission is multiplied by.
    pub intensity: f64,
    /// Intensity is multiplied by 2^stops.
    pub stops: f64,
    /// Spot half-angles in radians, 0 <= inner <= outer <= pi/2.
    pub inner_angle: f64,
    pub outer_angle: f64,
    /// Metres, of point, spot and disk; 0: no size.
    pub radius: f64,
    /// Width and height of a rectangle in metres.
    pub size: [f64; 2],
    /// Environment map of a dome; `None`: all directions are alike.
    pub map: Option<DomeMap>,
    /// Radians by which a dome is turned, counter-clockwise as seen from above.
    pub rotation: f64,
    /// Name of the materials of an emitter.
    pub material: Option<String>,
    /// Axis of a rectangle's height, of any length; only its part perpendicular to `direction` counts.
    pub up: DVec3,
    /// Full angle in radians that a directional light fills, as seen from the scene, 0 <= angle <= pi.
    pub angle: f64,
    /// Full angle in radians into which a disk or rectangle shines, 0 < spread <= pi.
    pub spread: f64,
    /// Whether a disk or rectangle shines on both sides.
    pub two_sided: bool,
    /// Whether the camera sees an area light. Mirrors and gloss show it in any case.
    pub visible: bool,
    /// Metres; the light has no effect beyond it.
    pub range: Option<f64>,
    /// Metres; nearer than this, light does not increase any more. 0: inverse square everywhere.
    pub decay_start: f64,
    pub filter: LightFilter,
    /// Index into the rig's groups.
    pub group: Option<usize>,
    pub enabled: bool,
    /// If any light or group is solo, all lights are off that are not solo themselves or by their group.
    pub solo: bool,
    /// Index of the light in the same rig that this one follows: edits of the leader are applied to this light too, and
    /// their difference is preserved.
    pub follows: Option<usize>,
    /// Whether geometry blocks its light.
    pub shadows: bool,
    pub links: Links,
    /// Source glTF node.
    pub node: Option<usize>,
}

/// A group of lights with a common factor.
#[derive(Clone, Debug, PartialEq)]
pub struct LightGroup {
    pub name: String,
    pub stops: f64,
    /// Linear Rec. 709; multiplies the lights' colours.
    pub color: Vec3,
    pub enabled: bool,
    pub solo: bool,
}

impl Light {
    /// White point light of one candela at `position`.
    pub fn point(name: &str, position: DVec3) -> Self {
        Self {
            name: name.into(),
            kind: LightKind::Point,
            position,
            direction: DVec3::NEG_Z,
            color: Vec3::ONE,
            intensity: 1.0,
            stops: 0.0,
            inner_angle: 0.0,
            outer_angle: FRAC_PI_4,
            radius: 0.0,
            size: [1.0; 2],
            map: None,
            rotation: 0.0,
            material: None,
            up: DVec3::Y,
            angle: 0.0,
            spread: PI,
            two_sided: false,
            visible: false,
            range: None,
            decay_start: 0.0,
            filter: LightFilter::default(),
            group: None,
            enabled: true,
            solo: false,
            follows: None,
            shadows: true,
            links: Links::default(),
            node: None,
        }
    }

    /// Factor on this light's unit image, without its group's factor; zero if the light is off.
    pub fn scale(&self) -> Vec3 {
        if self.enabled { self.color * (self.intensity * self.stops.exp2()) as f32 } else { Vec3::ZERO }
    }
}

impl Light {
    /// Whether what reaches a surface has a factor besides visibility: by a filter, or by links that scale the light.
    pub fn has_factors(&self) -> bool {
        !self.filter.is_none() || self.links.scale_light()
    }

    /// Whether it matters where the light points.
    pub fn has_direction(&self) -> bool {
        match self.kind {
            LightKind::Point => self.filter.ies.is_some(),
            LightKind::Dome | LightKind::Emitter => false,
            _ => true,
        }
    }

    /// Whether the light has no size: all its light comes from one point or from one direction. Emitters count as such:
    /// no points are chosen on them.
    pub fn is_punctual(&self) -> bool {
        match self.kind {
            LightKind::Point | LightKind::Spot | LightKind::Disk => self.radius == 0.0,
            LightKind::Directional => self.angle == 0.0,
            LightKind::Rect => self.size == [0.0; 2],
            LightKind::Dome => false,
            LightKind::Emitter => true,
        }
    }

    /// The middle of this light in mesh space as a punctual light, white and at unit intensity. Panics for
    /// emitters.
    pub fn pack(&self, space: MeshSpace) -> PackedLight {
        let (inner, outer) = (self.inner_angle.cos(), self.outer_angle.cos());
        let mut packed = PackedLight {
            position: match self.kind {
                LightKind::Directional | LightKind::Dome => Vec3::ONE,
                _ => space.from_world(self.position).as_vec3(),
            },
            kind: match self.kind {
                LightKind::Point => LIGHT_POINT,
                LightKind::Spot => LIGHT_SPOT,
                LightKind::Directional | LightKind::Dome => LIGHT_DIRECTIONAL,
                LightKind::Disk | LightKind::Rect if self.two_sided => LIGHT_TWO_SIDED_FACET,
                LightKind::Disk | LightKind::Rect => LIGHT_FACET,
                LightKind::Emitter => unreachable!("{}: emitters are baked", self.name),
            },
            direction: self.direction.as_vec3(),
            inverse_range: self.range.map_or(0.0, |range| space.unit / range) as f32,
            cone_scale: (inner - outer).max(LEAST_FALLOFF).recip() as f32,
            // 1 - cos without cancellation.
            cone_versine: (2.0 * (self.outer_angle / 2.0).sin().powi(2)) as f32,
            narrowing: 0.0,
            squared_radius: (self.decay_start / space.unit).powi(2) as f32,
            strength: space.unit.powi(-2) as f32,
        };
        match self.kind {
            LightKind::Point | LightKind::Spot | LightKind::Emitter => {}
            LightKind::Directional | LightKind::Dome => packed.strength = 1.0,
            LightKind::Disk | LightKind::Rect => packed.narrowing = (self.spread / 2.0).tan().recip() as f32,
        }
        packed
    }

    /// The point of this light at `[u, v]` in the unit square, as a punctual light that stands for all of it: the
    /// mean over the square is the light. White and at unit intensity, in mesh space. Equals [`Self::pack`] for a light
    /// without size.
    ///
    /// If the point is one of `count`, its facet has the size of their share of the surface, which bounds its light
    /// nearby; with `None` the mean is unbiased.
    pub fn pack_point(&self, space: MeshSpace, [u, v]: [f64; 2], count: Option<u32>) -> PackedLight {
        let packed = self.pack(space);
        if self.is_punctual() {
            return packed;
        }
        let wide = WideLight::of(self, space);
        let (place, weight) = wide.map_or((DVec2::ZERO, 1.0), |wide| wide.point([u, v]));
        let area = self.surface().zip(count).map_or(0.0, |(surface, count)| weight * surface / f64::from(count));
        let squared_radius = packed.squared_radius.max((area / PI * space.unit.powi(-2)) as f32);
        let at = |offset: DVec3| space.from_world(self.position + offset).as_vec3();
        let (sin, cos) = (TAU * v).sin_cos();
        let across = |axis: DVec3, x: f64, y: f64| {
            let (s, t) = axis.any_orthonormal_pair();
            s * x + t * y
        };
        let along_axes = |place: DVec2| {
            let [along_width, along_height] = self.axes();
            along_width * place.x + along_height * place.y
        };
        // Of a wide one, points are drawn in the square around it.
        let (disk, of_disk) = match wide {
            Some(_) if place.length() > self.radius => (along_axes(place), 0.0),
            Some(_) => (along_axes(place), weight * 4.0 / PI),
            None => (across(self.direction, cos, sin) * (self.radius * u.sqrt()), 1.0),
        };
        let scaled = |weight: f64| (f64::from(packed.strength) * weight) as f32;
        match self.kind {
            LightKind::Point => {
                let (z, r) = (1.0 - 2.0 * u, 2.0 * (u * (1.0 - u)).sqrt());
                let normal = DVec3::new(r * cos, r * sin, z);
                PackedLight {
                    kind: LIGHT_FACET,
                    position: at(normal * self.radius),
                    direction: normal.as_vec3(),
                    squared_radius,
                    // A sphere's surface is four times its cross-section.
                    strength: 4.0 * packed.strength,
                    ..packed
                }
            }
            LightKind::Spot => PackedLight { position: at(disk), strength: scaled(of_disk), ..packed },
            LightKind::Disk => PackedLight { position: at(disk), strength: scaled(of_disk), squared_radius, ..packed },
            LightKind::Rect => {
                let [width, height] = self.size;
                let place = if wide.is_some() { place } else { DVec2::new((u - 0.5) * width, (v - 0.5) * height) };
                PackedLight { position: at(along_axes(place)), strength: scaled(weight), squared_radius, ..packed }
            }
            LightKind::Directional => {
                // Uniform over the solid angle; 1 - cos without cancellation.
                let quarter = self.angle / 4.0;
                let versine = 2.0 * u * quarter.sin().powi(2);
                let off = across(self.direction, cos, sin) * (versine * (2.0 - versine)).sqrt();
                PackedLight {
                    direction: (self.direction * (1.0 - versine) + off).as_vec3(),
                    // Directions off the axis contribute less than their radiance to its irradiance.
                    strength: quarter.cos().powi(-2) as f32,
                    ..packed
                }
            }
            LightKind::Dome => {
                let drawn = self.sky().draw([u, v]);
                let radiance = self.sky().radiance(drawn.direction.as_vec3());
                let brightness = radiance.max_element();
                PackedLight {
                    direction: (self.turn() * -drawn.direction).as_vec3(),
                    position: radiance / brightness.max(f32::MIN_POSITIVE),
                    strength: (f64::from(brightness) / drawn.density) as f32,
                    squared_radius: drawn.density.recip() as f32,
                    ..packed
                }
            }
            LightKind::Emitter => packed,
        }
    }

    /// A point inside of a sphere light as a point light that stands for all of it, in mesh space. Such points, seen
    /// from anywhere, are spread evenly over the disk that the sphere looks like: the density in the ball falls with
    /// the radius r as 1/sqrt(R² - r²). `[u, v, w]`: in the unit cube.
    pub fn pack_in_ball(&self, space: MeshSpace, [u, v, w]: [f64; 3]) -> PackedLight {
        let (sin, cos) = (TAU * v).sin_cos();
        let along = (1.0 - u).sqrt() * (PI * (w - 0.5)).sin();
        let offset = DVec3::new(u.sqrt() * cos, u.sqrt() * sin, along) * self.radius;
        PackedLight { position: space.from_world(self.position + offset).as_vec3(), ..self.pack(space) }
    }

    /// Area in m² by which radiance is multiplied to give candela straight ahead, or solid angle that gives lux; `None`
    /// for spots, whose points have no radiance, and for punctual lights.
    pub fn projected_area(&self) -> Option<f64> {
        let area = match self.kind {
            LightKind::Point | LightKind::Disk => PI * self.radius * self.radius,
            LightKind::Rect => self.size[0] * self.size[1],
            // Its strength is its radiance.
            LightKind::Dome => 1.0,
            LightKind::Directional => PI * (self.angle / 2.0).sin().powi(2),
            LightKind::Spot | LightKind::Emitter => 0.0,
        };
        (area > 0.0 && area.is_finite()).then_some(area)
    }

    /// The map of a dome.
    pub fn sky(&self) -> &SkyMap {
        self.map.as_deref().unwrap_or(SkyMap::white())
    }

    /// Turns the map of a dome into world space.
    pub fn turn(&self) -> DQuat {
        DQuat::from_rotation_y(self.turns() * TAU)
    }

    /// By how much of a whole turn a dome is turned, counter-clockwise as seen from above.
    pub fn turns(&self) -> f64 {
        // Whole turns are none; a billionth of one is too small to see.
        ((self.rotation / TAU).fract() * 1e9).round() * 1e-9 % 1.0
    }

    /// Area in m² of the surface on which facets lie.
    fn surface(&self) -> Option<f64> {
        match self.kind {
            LightKind::Point => Some(4.0 * PI * self.radius * self.radius),
            LightKind::Disk => Some(PI * self.radius * self.radius),
            LightKind::Rect => Some(self.size[0] * self.size[1]),
            LightKind::Spot | LightKind::Directional | LightKind::Dome | LightKind::Emitter => None,
        }
    }

    /// Unit axes of width and height: of rectangles and filters. If `up` is along the direction, -z is up.
    pub fn axes(&self) -> [DVec3; 2] {
        let width = self.direction.cross(self.up).try_normalize();
        let to_back = || self.direction.cross(DVec3::NEG_Z).try_normalize();
        let width = width.or_else(to_back).unwrap_or_else(|| self.direction.any_orthonormal_vector());
        [width, width.cross(self.direction)]
    }
}

impl LightGroup {
    /// A group whose factor is one.
    pub fn new(name: &str) -> Self {
        Self { name: name.into(), stops: 0.0, color: Vec3::ONE, enabled: true, solo: false }
    }

    /// Factor on the sum of this group's lights; zero if the group is off.
    pub fn scale(&self) -> Vec3 {
        if self.enabled { self.color * self.stops.exp2() as f32 } else { Vec3::ZERO }
    }
}
