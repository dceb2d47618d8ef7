//! Gather samples that the camera sees, drawn over the picture.

use std::sync::Arc;

use egui::{Color32, Mesh, Pos2, Rect, Shape, Ui, Vec2};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::LoadedScene;
use crate::bake::transfer::Transfer;

/// The visible gather samples and their marks.
pub struct GatherMarks {
    transfer: Option<Arc<Transfer>>,
    /// Positions of the visible samples, world space.
    seen: Vec<DVec3>,
    /// Window positions of the first and last sample for which `mesh` was built.
    drawn_at: Option<[Pos2; 2]>,
    mesh: Arc<Mesh>,
}

/// Half the side (points) and colour of a mark's dark edge, and of its centre.
const SIZES: [(f32, Color32); 2] = [(1.75, Color32::from_black_alpha(170)), (1.0, Color32::from_rgb(120, 230, 255))];

impl GatherMarks {
    /// Returns `marks` if they belong to the current transfer, else new marks.
    pub fn get(marks: Option<Self>, opened: &LoadedScene) -> Self {
        marks.filter(|marks| opened.has(&marks.transfer)).unwrap_or_else(|| Self {
            transfer: opened.transfer.clone(),
            seen: seen(opened),
            drawn_at: None,
            mesh: Arc::default(),
        })
    }

    /// Draws the marks. `at` projects a world-space point to points of the window.
    pub fn draw(&mut self, ui: &Ui, at: impl Fn(DVec3) -> Option<Pos2>) {
        let ends = self.seen.first().zip(self.seen.last());
        let now = ends.and_then(|(first, last)| Some([at(*first)?, at(*last)?]));
        if now.is_none() || now != self.drawn_at {
            let mut mesh = Mesh::default();
            for (half, color) in SIZES {
                for at in self.seen.iter().filter_map(|&position| at(position)) {
                    mesh.add_colored_rect(Rect::from_center_size(at, Vec2::splat(2.0 * half)), color);
                }
            }
            (self.mesh, self.drawn_at) = (Arc::new(mesh), now);
        }
        ui.ctx().layer_painter(egui::LayerId::background()).add(Shape::Mesh(self.mesh.clone()));
    }
}

/// Returns the samples whose first point is visible from the camera.
fn seen(opened: &LoadedScene) -> Vec<DVec3> {
    let Some(transfer) = &opened.transfer else { return Vec::new() };
    let (scene, camera) = (&opened.scene, &opened.framebuffer.camera);
    let aspect = f64::from(opened.framebuffer.tiling.width) / f64::from(opened.framebuffer.tiling.height);
    let visible = |position: &Vec3| -> Option<DVec3> {
        let world = scene.space.to_world(*position);
        let [x, y] = camera.project(world, aspect)?;
        let (origin, direction) = camera.ray(x, y, aspect);
        let distance = (world - origin).dot(direction) / scene.space.unit;
        let from = scene.space.from_world(origin).as_vec3();
        let hit = scene.closest_solid_hit(from, direction.as_vec3())?;
        let inside = (0.0..1.0).contains(&x) && (0.0..1.0).contains(&y);
        (inside && f64::from(hit.distance) > distance * (1.0 - NEAR) - 1e-4).then_some(world)
    };
    let points = transfer.points.par_chunks(transfer.points_per_sample.max(1));
    points.filter_map(|points| visible(&points[0].position)).collect()
}

/// Relative tolerance of the visibility test: sample positions are rounded, so their own surface may lie before them.
const NEAR: f64 = 1e-3;
