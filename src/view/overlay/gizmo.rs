//! Handles in the picture: position, aim, cone, size, spread and barn doors of a light.

mod doors;

use std::f64::consts::FRAC_PI_2;

use egui::{Color32, Painter, Pos2, Rect, Stroke};
use glam::DVec3;

use crate::desk::{Desk, LEAST_SPREAD};
use crate::gpu::Placement;
use crate::scene::{Light, LightKind};
use crate::view::LoadedScene;
use crate::view::panel::lights_list::chip;

/// A part of a light that the mouse can drag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handle {
    Position,
    Aim,
    Cone,
    InnerCone,
    /// The edge or a corner of an area light.
    Size,
    /// Of a flat light.
    Spread,
    /// The free edge of a barn door, by its index in [`BarnDoors::angles`](crate::scene::light_filter::BarnDoors).
    Door(usize),
}

/// A handle that is being dragged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grab {
    pub light: usize,
    pub handle: Handle,
    /// From the mouse to the handle, physical pixels.
    offset: [f32; 2],
}

/// Largest distance at which the mouse grabs a handle, physical pixels.
const REACH: f32 = 9.0;
/// Number of vertices of a drawn circle.
const CORNERS: usize = 48;
/// Distance from a light to the drawn ring of its spread, physical pixels.
const SPREAD_SLANT: f32 = 60.0;
/// Number of steps in which an angle is searched.
const ANGLE_STEPS: u32 = 180;
const GOLD: Color32 = Color32::from_rgb(255, 190, 60);

/// The handles of the lights in the picture.
pub struct Gizmos<'a> {
    pub opened: &'a LoadedScene,
    pub desk: &'a Desk,
    pub placement: Placement,
}

impl Gizmos<'_> {
    /// Returns the handle under the mouse: any handle of the primary light, or the position handle of any light.
    pub fn grab(&self, at: [f32; 2]) -> Option<Grab> {
        let mut handles = Vec::new();
        if let (Some(index), Some(light)) = (self.desk.selected(), self.desk.selected_light()) {
            handles.extend(self.handles(light).into_iter().map(|(handle, point)| (index, handle, point)));
        }
        for (index, light) in self.desk.rig().lights.iter().enumerate() {
            if light.kind.has_position() {
                handles.push((index, Handle::Position, light.position));
            }
        }
        let grabs = handles.into_iter().filter_map(|(light, handle, point)| {
            let there = self.opened.project(self.placement, point)?;
            let offset = [there.x - at[0], there.y - at[1]];
            Some((offset[0].hypot(offset[1]), Grab { light, handle, offset }))
        });
        // At equal distances the first one, which is the primary light's.
        let nearest = grabs.filter(|(distance, _)| *distance <= REACH).min_by(|a, b| a.0.total_cmp(&b.0));
        nearest.map(|(_, grab)| grab)
    }

    /// Returns the grabbed light as changed by the mouse at `at`, physical pixels.
    pub fn dragged(&self, grab: Grab, at: [f32; 2]) -> Option<Light> {
        let light = self.desk.rig().lights.get(grab.light)?;
        let at = [at[0] + grab.offset[0], at[1] + grab.offset[1]];
        let mut light = light.clone();
        match grab.handle {
            Handle::Position => light.position = self.opened.on_parallel_plane(self.placement, at, light.position)?,
            Handle::Aim if light.kind == LightKind::Directional => {
                // The handle is the tail of the arrow; its tip is fixed.
                let tip = self.opened.pivot();
                let tail = self.opened.on_parallel_plane(self.placement, at, self.tail(&light))?;
                light.direction = (tip - tail).try_normalize()?;
            }
            Handle::Aim => {
                let surface = self.opened.pick(self.placement, at).map(|pick| pick.position);
                let there = surface.or_else(|| self.opened.on_parallel_plane(self.placement, at, self.aim(&light)))?;
                light.direction = (there - light.position).try_normalize()?;
            }
            Handle::Cone => {
                let outer = self.angle_to(&light, at)?.clamp(0.001, FRAC_PI_2);
                let share = if light.outer_angle > 0.0 { light.inner_angle / light.outer_angle } else { 0.0 };
                (light.outer_angle, light.inner_angle) = (outer, outer * share);
            }
            Handle::InnerCone => light.inner_angle = self.angle_to(&light, at)?.min(light.outer_angle),
            Handle::Spread => {
                let half = self.nearest_angle(at, [LEAST_SPREAD / 2.0, FRAC_PI_2], light.spread / 2.0, |half| {
                    self.spread_ring(&light, half).nth(CORNERS / 2)
                })?;
                light.spread = 2.0 * half;
            }
            Handle::Door(door) => {
                let now = light.filter.barn_doors?.angles[door];
                let edge = |angle| Some(self.door(&light, door, angle).handle());
                let angle = self.nearest_angle(at, [-FRAC_PI_2, FRAC_PI_2], now, edge)?;
                light.filter.barn_doors.as_mut()?.angles[door] = angle;
            }
            Handle::Size => {
                let there = self.opened.on_parallel_plane(self.placement, at, self.outline(&light).next()?)?;
                let off = there - light.position;
                match light.kind {
                    LightKind::Rect => light.size = light.axes().map(|axis| 2.0 * off.dot(axis).abs()),
                    _ => light.radius = off.length(),
                }
            }
        }
        Some(light)
    }

    /// Returns the handles of the primary light.
    fn handles(&self, light: &Light) -> Vec<(Handle, DVec3)> {
        let is_flat = matches!(light.kind, LightKind::Disk | LightKind::Rect);
        let aim = match light.kind {
            LightKind::Point | LightKind::Dome | LightKind::Emitter => None,
            LightKind::Directional => Some(self.tail(light)),
            _ => Some(self.aim(light)),
        };
        let position = (light.kind.has_position()).then_some(light.position);
        let is_spot = light.kind == LightKind::Spot;
        let cone = is_spot.then(|| self.ring(light, light.outer_angle).next()).flatten();
        // On the other side than the cone's, and off the aim.
        let inner = light.inner_angle.max(light.outer_angle / 16.0);
        let inner = is_spot.then(|| self.ring(light, inner).nth(CORNERS / 2)).flatten();
        let spread = is_flat.then(|| self.spread_ring(light, light.spread / 2.0).nth(CORNERS / 2)).flatten();
        let handles = [
            (Handle::Position, position),
            (Handle::Aim, aim),
            (Handle::Cone, cone),
            (Handle::InnerCone, inner),
            (Handle::Size, self.outline(light).next()),
            (Handle::Spread, spread),
        ];
        let handles = handles.into_iter().filter_map(|(handle, point)| Some((handle, point?)));
        let doors = self.doors(light).enumerate().map(|(door, flap)| (Handle::Door(door), flap.handle()));
        handles.chain(doors).collect()
    }

    /// Returns the outline of an area light; its first point is the handle.
    fn outline(&self, light: &Light) -> impl Iterator<Item = DVec3> {
        let points = match light.kind {
            _ if light.is_punctual() => Vec::new(),
            LightKind::Directional | LightKind::Dome | LightKind::Emitter => Vec::new(),
            LightKind::Rect => {
                let [u, v] = light.axes();
                let [u, v] = [u * light.size[0] / 2.0, v * light.size[1] / 2.0];
                [u + v, v - u, -u - v, u - v].map(|corner| light.position + corner).to_vec()
            }
            LightKind::Point => {
                let axes = self.opened.framebuffer.camera.world_from_camera;
                circle(light.position, axes.x_axis, axes.y_axis, light.radius).collect()
            }
            LightKind::Spot | LightKind::Disk => {
                let [x, y] = self.across(light);
                circle(light.position, x, y, light.radius).collect()
            }
        };
        points.into_iter()
    }

    /// Unit axes perpendicular to the light's direction, the first one towards the camera's right.
    fn across(&self, light: &Light) -> [DVec3; 2] {
        let right = self.opened.framebuffer.camera.world_from_camera.x_axis;
        let x = right - light.direction * right.dot(light.direction);
        let x = x.try_normalize().unwrap_or_else(|| light.direction.any_orthonormal_vector());
        [x, light.direction.cross(x)]
    }

    /// Returns the first surface point on a spot light's axis.
    fn aim(&self, light: &Light) -> DVec3 {
        light.position + light.direction * self.opened.distance_to_surface(light.position, light.direction)
    }

    /// Returns the tail of a directional light's arrow.
    fn tail(&self, light: &Light) -> DVec3 {
        self.opened.pivot() - light.direction * 0.5 * self.opened.scene.space.unit
    }

    /// Returns the circle of the cone around its aim point, starting at the camera's right; empty if the cone is too
    /// wide.
    fn ring(&self, light: &Light, angle: f64) -> impl Iterator<Item = DVec3> {
        let center = self.aim(light);
        let radius = (center - light.position).length() * angle.tan();
        let [x, y] = self.across(light);
        circle(center, x, y, radius).take(if angle < 1.5 { CORNERS } else { 0 })
    }

    /// Returns the angle between a light's axis and the point under `at` (physical pixels) at the depth of its aim.
    fn angle_to(&self, light: &Light, at: [f32; 2]) -> Option<f64> {
        let there = self.opened.on_parallel_plane(self.placement, at, self.aim(light))?;
        Some(light.direction.angle_between(there - light.position))
    }

    /// Returns the length (metres) that the picture shows as `pixels` at the depth of a light.
    fn length(&self, light: &Light, pixels: f32) -> f64 {
        let beside = self
            .opened
            .project_beyond(self.placement, light.position)
            .and_then(|at| self.opened.on_parallel_plane(self.placement, [at.x + pixels, at.y], light.position));
        beside.map_or(0.0, |beside| (beside - light.position).length())
    }

    /// Returns a circle at `half` from the direction of a flat light, starting at the camera's right.
    fn spread_ring(&self, light: &Light, half: f64) -> impl Iterator<Item = DVec3> {
        let (sin, cos) = half.sin_cos();
        let slant = self.length(light, SPREAD_SLANT);
        let [x, y] = self.across(light);
        circle(light.position + light.direction * slant * cos, x, y, slant * sin)
    }

    /// Returns the angle in a range whose point is nearest to `at` (physical pixels); if several are equally near, the
    /// one nearest to `now`.
    fn nearest_angle(
        &self,
        at: [f32; 2],
        [least, most]: [f64; 2],
        now: f64,
        point: impl Fn(f64) -> Option<DVec3>,
    ) -> Option<f64> {
        let distance = |angle: f64| {
            let there = self.opened.project_beyond(self.placement, point(angle)?)?;
            Some(f64::from((there.x - at[0]).hypot(there.y - at[1])))
        };
        let search = |least: f64, most: f64| {
            let angles = (0..=ANGLE_STEPS).map(|i| least + (most - least) * f64::from(i) / f64::from(ANGLE_STEPS));
            let costs = angles.filter_map(|angle| Some((distance(angle)? + 1e-3 * (angle - now).abs(), angle)));
            costs.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, angle)| angle)
        };
        let coarse = search(least, most)?;
        let step = (most - least) / f64::from(ANGLE_STEPS);
        search((coarse - step).max(least), (coarse + step).min(most))
    }

    /// Draws marks of all lights and handles of the selected ones; `scale` is physical pixels per point.
    pub fn draw(&self, painter: &Painter, scale: f32) {
        let Placement { left, top, width, height } = self.placement;
        let rect = Rect::from_min_size(
            Pos2::new(left as f32, top as f32) / scale,
            egui::vec2(width as f32, height as f32) / scale,
        );
        let drawing =
            Drawing { gizmos: self, painter: painter.with_clip_rect(rect.intersect(painter.clip_rect())), scale };
        for (index, light) in self.desk.rig().lights.iter().enumerate() {
            let is_selected = self.desk.selection().contains(index);
            if is_selected {
                drawing.gizmo(light);
            }
            if self.desk.selected() == Some(index) {
                drawing.handles(light);
            }
            if light.kind.has_position() {
                drawing.mark(light, is_selected);
            }
        }
    }
}

/// Points of a circle, the first one along `x`.
fn circle(center: DVec3, x: DVec3, y: DVec3, radius: f64) -> impl Iterator<Item = DVec3> {
    (0..CORNERS).map(move |i| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / CORNERS as f64).sin_cos();
        center + radius * (cos * x + sin * y)
    })
}

struct Drawing<'a> {
    gizmos: &'a Gizmos<'a>,
    painter: Painter,
    scale: f32,
}

impl Drawing<'_> {
    fn at(&self, point: DVec3) -> Option<Pos2> {
        Some(self.gizmos.opened.project_beyond(self.gizmos.placement, point)? / self.scale)
    }

    fn gizmo(&self, light: &Light) {
        let gizmos = self.gizmos;
        let outline: Vec<DVec3> = gizmos.outline(light).collect();
        self.polygon(&outline, 1.5);
        match light.kind {
            LightKind::Point | LightKind::Dome | LightKind::Emitter => {}
            LightKind::Disk | LightKind::Rect => self.line(light.position, gizmos.aim(light), 1.0),
            LightKind::Directional => self.line(gizmos.tail(light), gizmos.opened.pivot(), 2.0),
            LightKind::Spot => {
                self.line(light.position, gizmos.aim(light), 1.0);
                for (angle, width) in [(light.outer_angle, 1.5), (light.inner_angle, 0.75)] {
                    let ring: Vec<DVec3> = gizmos.ring(light, angle).collect();
                    self.polygon(&ring, width);
                    if angle == light.outer_angle {
                        ring.iter().step_by(CORNERS / 4).for_each(|point| self.line(light.position, *point, 0.75));
                    }
                }
            }
        }
    }

    /// Draws what only the primary light has: spread, barn doors, and the squares that the mouse drags.
    fn handles(&self, light: &Light) {
        let gizmos = self.gizmos;
        if matches!(light.kind, LightKind::Disk | LightKind::Rect) {
            let ring: Vec<DVec3> = gizmos.spread_ring(light, light.spread / 2.0).collect();
            self.polygon(&ring, 0.75);
            ring.iter().step_by(CORNERS / 4).for_each(|point| self.line(light.position, *point, 0.75));
        }
        for flap in gizmos.doors(light) {
            self.polygon(&flap.corners(), 1.0);
        }
        for (handle, point) in gizmos.handles(light) {
            if handle != Handle::Position {
                self.square(point);
            }
        }
    }

    fn polygon(&self, corners: &[DVec3], width: f32) {
        let next = corners.iter().cycle().skip(1);
        corners.iter().zip(next).for_each(|(a, b)| self.line(*a, *b, width));
    }

    fn line(&self, a: DVec3, b: DVec3, width: f32) {
        if let (Some(a), Some(b)) = (self.at(a), self.at(b)) {
            self.painter.line_segment([a, b], Stroke::new(width + 1.5, Color32::from_black_alpha(120)));
            self.painter.line_segment([a, b], Stroke::new(width, GOLD));
        }
    }

    fn square(&self, point: DVec3) {
        let Some(at) = self.at(point) else { return };
        let rect = Rect::from_center_size(at, egui::Vec2::splat(8.0));
        self.painter.rect(rect, 1.0, GOLD, Stroke::new(1.5, Color32::BLACK), egui::StrokeKind::Middle);
    }

    fn mark(&self, light: &Light, is_selected: bool) {
        let Some(at) = self.at(light.position) else { return };
        let color = if light.enabled { chip(light.color) } else { Color32::DARK_GRAY };
        let radius = if is_selected { 6.0 } else { 4.0 };
        // egui draws discs from a texture; an outlined circle has a hundred triangles, times thousands of lights.
        self.painter.circle_filled(at, radius + 0.75, Color32::BLACK);
        self.painter.circle_filled(at, radius - 0.75, color);
        if is_selected {
            self.painter.circle_stroke(at, 8.5, Stroke::new(1.5, GOLD));
            let font = egui::FontId::proportional(13.0);
            for (offset, color) in [(egui::vec2(13.0, 1.0), Color32::BLACK), (egui::vec2(12.0, 0.0), Color32::WHITE)] {
                self.painter.text(at + offset, egui::Align2::LEFT_CENTER, &light.name, font.clone(), color);
            }
        }
    }
}
