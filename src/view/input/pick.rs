//! Position of the picture in the window, and the surface point under the mouse.

use egui::Pos2;
use glam::{DVec3, Vec3};

use crate::desk::{Pick, PickedObject};
use crate::gpu::Placement;
use crate::trace::surface::SurfacePoint;
use crate::view::LoadedScene;

/// Returns the placement of the picture in `area`, the physical pixels available from the window's top left.
///
/// A fitted picture is as large as possible. A 1:1 picture is centred and moved by `pan`, clamped to its edges.
pub fn placement(picture: [u32; 2], area: [u32; 2], one_to_one: bool, pan: [i32; 2]) -> Placement {
    if area[0] == 0 || area[1] == 0 {
        return Placement::default();
    }
    let size = match one_to_one {
        true => picture,
        false => {
            let scale = (f64::from(area[0]) / f64::from(picture[0])).min(f64::from(area[1]) / f64::from(picture[1]));
            picture.map(|side| ((f64::from(side) * scale).round() as u32).max(1))
        }
    };
    let start = |axis: usize| {
        let room = area[axis] as i32 - size[axis] as i32;
        let most = (-room / 2).max(0);
        room.div_euclid(2) + if one_to_one { pan[axis].clamp(-most, most) } else { 0 }
    };
    Placement { left: start(0), top: start(1), width: size[0], height: size[1] }
}

/// Converts a point of the window (physical pixels) to fractions of the picture's width and height.
fn shares(placement: Placement, at: [f32; 2]) -> [f64; 2] {
    let x = (f64::from(at[0]) - f64::from(placement.left)) / f64::from(placement.width);
    let y = (f64::from(at[1]) - f64::from(placement.top)) / f64::from(placement.height);
    [x, y]
}

/// The same; `None` outside the picture.
fn share(placement: Placement, at: [f32; 2]) -> Option<[f64; 2]> {
    let [x, y] = shares(placement, at);
    ((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y)).then_some([x, y])
}

/// Offset of ray origins, mesh space; nearer surfaces are those that contain the origin.
const OFF: f64 = 1e-4;

/// Returns the pixel of the picture at `at`, physical pixels of the window; `None` outside the picture.
pub fn pixel(placement: Placement, size: [u32; 2], at: [f32; 2]) -> Option<[u32; 2]> {
    let shares = share(placement, at)?;
    Some([0, 1].map(|axis| (shares[axis] * f64::from(size[axis])) as u32))
}

impl LoadedScene {
    fn aspect(&self) -> f64 {
        f64::from(self.framebuffer.tiling.width) / f64::from(self.framebuffer.tiling.height)
    }

    /// Returns the surface point that the picture shows at `at`, physical pixels of the window.
    pub fn pick(&self, placement: Placement, at: [f32; 2]) -> Option<Pick> {
        let [x, y] = share(placement, at)?;
        self.pick_share(x, y)
    }

    /// Returns the object that the picture shows at `at`, physical pixels of the window. Its name is that of its node
    /// or, if no node above it has a name, of its material.
    pub fn object_at(&self, placement: Placement, at: [f32; 2]) -> Option<PickedObject<'_>> {
        let [x, y] = share(placement, at)?;
        let (origin, direction) = self.framebuffer.camera.ray(x, y, self.aspect());
        let scene = &self.scene;
        let hit = scene.closest_solid_hit(scene.space.from_world(origin).as_vec3(), direction.as_vec3())?;
        let node = scene.objects.get(scene.mesh.object(hit.triangle)).map_or("", |object| &object.name);
        let material = &scene.materials[scene.mesh.triangle_materials[hit.triangle as usize] as usize].name;
        let name = [node, material].into_iter().find(|name| !name.is_empty())?;
        Some(PickedObject { scene, name, triangle: hit.triangle })
    }

    /// Returns the surface point at fractions of the picture's width and height, y down.
    pub fn pick_share(&self, x: f64, y: f64) -> Option<Pick> {
        let (origin, direction) = self.framebuffer.camera.ray(x, y, self.aspect());
        let space = self.scene.space;
        let from = space.from_world(origin).as_vec3();
        let hit = self.scene.closest_solid_hit(from, direction.as_vec3())?;
        let seen = SurfacePoint::new(&self.scene, &hit, direction.as_vec3(), 0.0);
        let facing = |normal: Vec3| {
            let normal = normal.as_dvec3().try_normalize().unwrap_or(-direction);
            if normal.dot(direction) > 0.0 { -normal } else { normal }
        };
        Some(Pick {
            position: origin + direction * f64::from(hit.distance) * space.unit,
            normal: facing(seen.geometric_normal),
            shading_normal: facing(seen.normal),
            to_eye: -direction,
        })
    }

    /// Returns the distance (metres) from a world-space point to the next surface along a unit direction, or to the far
    /// side of the scene if there is none. A surface at the point itself is ignored.
    pub fn distance_to_surface(&self, from: DVec3, direction: DVec3) -> f64 {
        let space = self.scene.space;
        let from = space.from_world(from);
        let start = (from + direction * OFF).as_vec3();
        let hit = self.scene.closest_solid_hit(start, direction.as_vec3());
        space.unit * hit.map_or(from.length() + 1.0, |hit| f64::from(hit.distance) + OFF)
    }

    /// Returns the point under `at` (physical pixels) on the plane through `point` that is parallel to the image plane.
    pub fn on_parallel_plane(&self, placement: Placement, at: [f32; 2], point: DVec3) -> Option<DVec3> {
        let [x, y] = shares(placement, at);
        let (origin, direction) = self.framebuffer.camera.ray(x, y, self.aspect());
        let back = self.framebuffer.camera.world_from_camera.z_axis;
        let distance = back.dot(point - origin) / back.dot(direction);
        (distance.is_finite() && distance > 0.0).then(|| origin + direction * distance)
    }

    /// Returns the centre of rotation of directional lights: the surface in the middle of the picture, else the middle
    /// of the scene.
    pub fn pivot(&self) -> DVec3 {
        self.pick_share(0.5, 0.5).map_or(self.scene.space.origin, |pick| pick.position)
    }

    /// Projects a world-space point to physical pixels of the window; `None` outside the picture.
    pub fn project(&self, placement: Placement, point: DVec3) -> Option<Pos2> {
        self.project_beyond(placement, point).filter(|at| share(placement, [at.x, at.y]).is_some())
    }

    /// Projects without clipping to the picture; `None` behind the camera.
    pub fn project_beyond(&self, placement: Placement, point: DVec3) -> Option<Pos2> {
        let [x, y] = self.framebuffer.camera.project(point, self.aspect())?;
        Some(Pos2::new(
            (f64::from(placement.left) + x * f64::from(placement.width)) as f32,
            (f64::from(placement.top) + y * f64::from(placement.height)) as f32,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_fitted_centred_and_panned_within_bounds() {
        let fitted = placement([720, 480], [1000, 480], false, [9, 9]);
        assert_eq!(fitted, Placement { left: 140, top: 0, width: 720, height: 480 });
        assert_eq!(placement([720, 480], [360, 480], false, [0; 2]).height, 240);
        let exact = placement([720, 480], [800, 500], true, [50, 50]);
        assert_eq!(exact, Placement { left: 40, top: 10, width: 720, height: 480 });
        let panned = placement([720, 480], [700, 480], true, [-50, 0]);
        assert_eq!(panned, Placement { left: -20, top: 0, width: 720, height: 480 });
        assert_eq!(placement([720, 480], [0, 480], false, [0; 2]), Placement::default());
        assert_eq!(share(exact, [40.0, 10.0]), Some([0.0, 0.0]));
        assert_eq!(share(exact, [39.9, 10.0]), None);
    }
}
