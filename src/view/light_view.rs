//! The view through a light: surfaces ray cast from its position, coarse while it moves and finer at rest.

use egui::{Color32, ColorImage, TextureHandle, TextureOptions, Ui};
use glam::{DVec2, DVec3, Vec3};

use super::LoadedScene;
use crate::desk::Desk;
use crate::scene::light_filter::PosedFilter;
use crate::scene::{Camera, Light, LightKind, MeshSpace, Projection};
use crate::trace::surface::SurfacePoint;

/// Image size while something moves, pixels.
const COARSE: [usize; 2] = [60, 40];
/// Image size at rest, pixels.
const FINE: [usize; 2] = [240, 160];
/// Displayed size, points.
const SHOWN: [f32; 2] = [240.0, 160.0];

/// The view through a light.
#[derive(Default)]
pub struct LightView {
    texture: Option<TextureHandle>,
    image: Option<ColorImage>,
    /// The light and the image size of the current image.
    made_for: Option<(Light, [usize; 2])>,
}

impl LightView {
    /// Updates the image if the light has changed, or if it `rests` and the image is coarse. Returns whether it did.
    pub fn make(&mut self, opened: &LoadedScene, light: &Light, rests: bool) -> bool {
        if !is_looked_through(light) {
            return false; // it is everywhere
        }
        let is_same = self.made_for.as_ref().is_some_and(|(made_for, _)| made_for == light);
        let is_fine = self.made_for.as_ref().is_some_and(|(_, size)| *size == FINE);
        if is_same && (is_fine || !rests) {
            return false;
        }
        let size = if rests { FINE } else { COARSE };
        self.image = Some(ColorImage::new(size, cast(opened, light, size)));
        self.made_for = Some((light.clone(), size));
        true
    }

    /// Draws the window with the image; a drag in it turns the light.
    pub fn show(&mut self, ui: &mut Ui, opened: &LoadedScene, desk: &mut Desk) {
        let Some(light) = desk.selected_light().filter(|light| is_looked_through(light)).cloned() else { return };
        if !light.has_direction() {
            self.made_for = None;
        }
        self.make(opened, &light, false);
        if let Some(image) = self.image.take() {
            match &mut self.texture {
                Some(texture) => texture.set(image, TextureOptions::LINEAR),
                None => self.texture = Some(ui.ctx().load_texture("light view", image, TextureOptions::LINEAR)),
            }
        }
        let Some(texture) = &self.texture else { return };
        let title = format!("View through {}", light.name);
        let window = egui::Window::new(title).id("light view".into()).collapsible(false).resizable(false);
        window.default_pos([8.0, 8.0]).show(ui.ctx(), |ui| {
            let image = egui::Image::new(texture).fit_to_exact_size(SHOWN.into()).sense(egui::Sense::drag());
            let response = ui.add(image).on_hover_text("drag to turn the light");
            if light.kind == LightKind::Spot {
                let view = view(opened, &light);
                let Projection::Perspective { yfov } = view.projection else { return };
                let radius = (light.outer_angle.tan() / (yfov / 2.0).tan()) as f32 * SHOWN[1] / 2.0;
                let stroke = egui::Stroke::new(1.5, Color32::from_rgb(255, 190, 60));
                ui.painter().with_clip_rect(response.rect).circle_stroke(response.rect.center(), radius, stroke);
            }
            let by = response.drag_delta();
            if by != egui::Vec2::ZERO && light.has_direction() {
                let center = DVec2::splat(0.5) - DVec2::new((by.x / SHOWN[0]).into(), (by.y / SHOWN[1]).into());
                // The point under the mouse follows the mouse.
                let view = view(opened, &light);
                let direction = match light.kind {
                    LightKind::Directional => {
                        let turn = 0.5 * (DVec2::splat(0.5) - center);
                        let axes = view.world_from_camera;
                        light.direction - axes.x_axis * turn.x + axes.y_axis * turn.y
                    }
                    _ => view.ray(center.x, center.y, aspect()).1,
                };
                desk.edit_primary_and_selection(Light { direction: direction.normalize(), ..light.clone() });
            }
        });
    }
}

fn aspect() -> f64 {
    f64::from(SHOWN[0]) / f64::from(SHOWN[1])
}

/// Whether the light is at a place, or in one direction.
fn is_looked_through(light: &Light) -> bool {
    light.kind.has_position() || light.kind == LightKind::Directional
}

/// Returns a camera at the light. It shows the whole cone of a spot light, the whole scene for a directional light, and
/// a wide view towards the middle of the scene for a point light.
fn view(opened: &LoadedScene, light: &Light) -> Camera {
    let MeshSpace { origin: middle, unit: radius } = opened.scene.space;
    let (position, direction, projection) = match light.kind {
        LightKind::Directional => {
            (middle - light.direction * 2.0 * radius, light.direction, Projection::Orthographic { ymag: radius })
        }
        LightKind::Spot => {
            let yfov = (2.2 * light.outer_angle).clamp(0.05, 2.6);
            (light.position, light.direction, Projection::Perspective { yfov })
        }
        LightKind::Disk | LightKind::Rect => {
            (light.position, light.direction, Projection::Perspective { yfov: light.spread.clamp(0.05, 1.6) })
        }
        LightKind::Point if light.has_direction() => {
            (light.position, light.direction, Projection::Perspective { yfov: 1.6 })
        }
        LightKind::Dome | LightKind::Emitter => unreachable!("there is no view through them"),
        LightKind::Point => {
            let towards = (middle - light.position).try_normalize().unwrap_or(DVec3::NEG_Y);
            (light.position, towards, Projection::Perspective { yfov: 1.6 })
        }
    };
    let up = if direction.y.abs() > 0.999 { DVec3::NEG_Z } else { DVec3::Y };
    let camera = Camera::look_at(position, position + direction * radius.max(1e-6 * position.length()), up, projection);
    camera.expect("up is not along the direction")
}

fn cast(opened: &LoadedScene, light: &Light, [width, height]: [usize; 2]) -> Vec<Color32> {
    let view = view(opened, light);
    let scene = &*opened.scene;
    let filter = PosedFilter::new(light);
    let pixel = |i: usize| {
        let share = |at: usize, of: usize| (at as f64 + 0.5) / of as f64;
        let (origin, direction) = view.ray(share(i % width, width), share(i / width, height), aspect());
        let (from, along) = (scene.space.from_world(origin).as_vec3(), direction.as_vec3());
        let Some(hit) = scene.closest_solid_hit(from, along) else { return Color32::BLACK };
        let point = SurfacePoint::new(scene, &hit, along, 0.0);
        let base = scene.materials[point.material as usize].base_color.truncate();
        let passed = filter.as_ref().map_or(Vec3::ONE, |filter| filter.factor(along));
        let lit = base * (0.15 + 0.85 * passed * point.normal.dot(-along).max(0.0));
        let [r, g, b] = lit.max(Vec3::ZERO).powf(1.0 / 2.2).to_array().map(|c| (255.0 * c.min(1.0)).round() as u8);
        Color32::from_rgb(r, g, b)
    };
    (0..width * height).map(pixel).collect()
}
