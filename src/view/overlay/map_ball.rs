//! A mirror ball in the corner of the picture: the map of the selected dome, as the camera sees it in a mirror.

use egui::{Color32, ColorImage, Rect, Sense, TextureHandle, TextureOptions, Ui};
use glam::{DMat3, Mat3, Vec3};
use rayon::prelude::*;

use crate::desk::Desk;
use crate::relight::ToneMap;
use crate::scene::{DomeMap, Light, LightKind, SkyMap};
use crate::view::view_state::ViewState;

/// Diameter, pixels of its image and points of the window.
const SIDE: usize = 96;
/// Distance from the edges of the picture, points.
const MARGIN: f32 = 8.0;

/// The ball's image, and what it shows.
#[derive(Default)]
pub struct MapBall {
    texture: Option<TextureHandle>,
    shown: Option<Shown>,
}

/// All that a ball's image depends on, besides the camera, which does not move.
#[derive(Clone, PartialEq)]
struct Shown {
    map: Option<DomeMap>,
    turns: f64,
    /// Factor on the map's radiance, with exposure.
    scale: Vec3,
    tone_map: ToneMap,
}

impl MapBall {
    /// Draws the ball at the lower right of `picture`, points, if a dome is selected. A horizontal drag on it turns the
    /// dome. `world_from_camera`: see [`Camera`](crate::scene::Camera).
    pub fn show(&mut self, ui: &Ui, desk: &mut Desk, view: &ViewState, world_from_camera: DMat3, picture: Rect) {
        let Some(light) = desk.selected_light().filter(|light| light.kind == LightKind::Dome).cloned() else { return };
        let group = light.group.map_or(Vec3::ONE, |group| desk.rig().groups[group].scale());
        let shown = Shown {
            map: light.map.clone(),
            turns: light.turns(),
            scale: light.scale() * group * view.exposure.exp2(),
            tone_map: view.curve(),
        };
        if self.shown.as_ref() != Some(&shown) {
            let image = ColorImage::new([SIDE; 2], pixels(&light, &shown, world_from_camera));
            match &mut self.texture {
                Some(texture) => texture.set(image, TextureOptions::LINEAR),
                None => self.texture = Some(ui.ctx().load_texture("map ball", image, TextureOptions::LINEAR)),
            }
            self.shown = Some(shown);
        }
        let Some(texture) = &self.texture else { return };
        let size = egui::Vec2::splat(SIDE as f32);
        let corner = picture.right_bottom() - size - egui::Vec2::splat(MARGIN);
        let area = egui::Area::new("map ball".into()).fixed_pos(corner).constrain(false);
        let dragged = area.show(ui.ctx(), |ui| {
            let image = egui::Image::new(texture).fit_to_exact_size(size).sense(Sense::drag());
            ui.add(image).on_hover_text("the map in a mirror ball; drag to turn the dome").drag_delta().x
        });
        if dragged.inner != 0.0 {
            // What the middle of the ball shows follows the mouse.
            let angle = f64::from(2.0 * dragged.inner / (SIDE as f32 / 2.0));
            desk.edit_primary_and_selection(Light { rotation: light.rotation + angle, ..light });
        }
    }
}

/// The ball's pixels row by row, transparent beside it.
fn pixels(light: &Light, shown: &Shown, world_from_camera: DMat3) -> Vec<Color32> {
    let map_from_camera = Mat3::from_quat(light.turn().inverse().as_quat()) * world_from_camera.as_mat3();
    let place = |i: usize| {
        let along = |i: usize| (i as f32 + 0.5) / SIDE as f32 * 2.0 - 1.0;
        (along(i % SIDE), -along(i / SIDE))
    };
    let sky = light.sky();
    let radiance = |i: usize| {
        let (x, y) = place(i);
        let radiance = sky.blurred_at(SkyMap::place(map_from_camera * reflected(x, y)));
        (radiance * shown.scale).to_array()
    };
    let colors = shown.tone_map.display8((0..SIDE * SIDE).into_par_iter().map(radiance).collect());
    let pixel = |(i, [r, g, b]): (usize, [u8; 3])| {
        let (x, y) = place(i);
        // One pixel wide: the edge is smooth.
        let cover = (0.5 + (1.0 - x.hypot(y)) * SIDE as f32 / 2.0).clamp(0.0, 1.0);
        Color32::from_rgba_unmultiplied(r, g, b, (255.0 * cover).round() as u8)
    };
    colors.into_iter().enumerate().map(pixel).collect()
}

/// The direction, in the space of the camera, that a mirror ball shows at (x, y) of its unit disk, y up. The ball is
/// seen along -z from far away.
fn reflected(x: f32, y: f32) -> Vec3 {
    let z = (1.0 - x * x - y * y).max(0.0).sqrt();
    // d - 2 (d . n) n for d = -z; the normal n is (x, y, z).
    2.0 * z * Vec3::new(x, y, z) - Vec3::Z
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_1_SQRT_2;

    use glam::DVec3;

    use super::*;

    #[test]
    fn the_middle_shows_what_is_behind_the_camera() {
        for (at, want) in [
            ([0.0, 0.0], Vec3::Z),
            ([FRAC_1_SQRT_2, 0.0], Vec3::X),
            ([0.0, FRAC_1_SQRT_2], Vec3::Y),
            ([-FRAC_1_SQRT_2, 0.0], Vec3::NEG_X),
            ([1.0, 0.0], Vec3::NEG_Z),
        ] {
            let got = reflected(at[0], at[1]);
            assert!(got.distance(want) < 1e-6, "{at:?}: {got}, want {want}");
        }
    }

    /// A map that is red around +z, its middle, and black elsewhere.
    #[test]
    fn the_ball_turns_with_the_dome_and_with_the_camera() {
        let folder = tempfile::tempdir().expect("there is room");
        let path = folder.path().join("red.png");
        let red = |x: usize| if (28..36).contains(&x) { [255, 0, 0] } else { [0u8; 3] };
        let texels: Vec<_> = (0..64 * 32).map(|i| red(i % 64)).collect();
        crate::image::png::write(&path, 64, 32, &texels).expect("there is room");
        let map = crate::scene::light_filter::RigFiles::new(folder.path()).sky_map("red.png").expect("it is a map");
        let at = |degrees: f64, world_from_camera: DMat3, [x, y]: [f32; 2]| {
            let light = Light {
                kind: LightKind::Dome,
                map: Some(DomeMap::File(map.clone())),
                rotation: degrees.to_radians(),
                ..Light::point("dome", DVec3::ZERO)
            };
            let shown =
                Shown { map: light.map.clone(), turns: light.turns(), scale: Vec3::ONE, tone_map: ToneMap::None };
            let [column, row] = [x, -y].map(|at| ((at + 1.0) / 2.0 * SIDE as f32) as usize);
            pixels(&light, &shown, world_from_camera)[row * SIDE + column]
        };
        let (middle, right) = ([0.0, 0.0], [FRAC_1_SQRT_2, 0.0]);
        assert_eq!(at(0.0, DMat3::IDENTITY, middle), Color32::RED, "the camera looks along -z, the middle is +z");
        assert_eq!(at(0.0, DMat3::IDENTITY, right), Color32::BLACK);
        assert_eq!(at(90.0, DMat3::IDENTITY, right), Color32::RED, "counter-clockwise as seen from above: +z to +x");
        assert_eq!(at(90.0, DMat3::IDENTITY, middle), Color32::BLACK);
        let turned = DMat3::from_rotation_y(-std::f64::consts::FRAC_PI_2);
        assert_eq!(at(0.0, turned, right), Color32::RED, "the camera looks along +x, so that its right is +z");
        assert_eq!(at(0.0, turned, [1.0 - 1e-6, -1.0 + 1e-6]), Color32::TRANSPARENT, "the corner");
    }
}
