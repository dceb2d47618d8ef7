//! A scene with its lights and its camera, before anything is computed.

use std::path::Path;

use super::progress::Progress;
use crate::error::{Error, Result};
use crate::scene::rig::without_dots;
use crate::scene::{Camera, Emitters, Links, MAX_IMAGE_SIDE, Rig, Scene};
use crate::trace::bvh::TracedScene;

/// How a scene is looked at.
#[derive(Clone, Debug, Default)]
pub struct OpenSettings {
    /// Pixels; by default the scene's own, else 480 rows of the camera's aspect ratio, else 720x480.
    pub size: Option<[u32; 2]>,
    /// Camera by name; by default the rig's, else the scene's first, else one that frames it.
    pub camera: Option<String>,
    /// Takes the diffuse lobe from every material [Yang 2007, Figure 5.4].
    pub strip_diffuse: bool,
}

/// A scene as it is lit and seen, before any of it is computed.
pub struct Opened {
    pub scene: Scene,
    /// The lights as the camera sees them.
    pub rig: Rig,
    /// The lights of all shots.
    pub base_rig: Rig,
    pub camera: Camera,
    pub size: [u32; 2],
}

impl Opened {
    /// Loads `path` with the lights of `rig_path`, or its own.
    pub fn new(path: &Path, rig_path: Option<&Path>, settings: &OpenSettings, progress: &dyn Progress) -> Result<Self> {
        progress.begin("loading", 0);
        let scene = Scene::load(path);
        progress.end();
        let mut scene = scene?;
        if settings.strip_diffuse {
            scene.materials.iter_mut().for_each(|m| m.strip_diffuse = true);
        }
        let emitters = Emitters::of(&scene);
        let rig = match rig_path {
            Some(path) => Rig::load(path)?,
            None => scene.rig.clone(),
        };
        let mut rig = emitters.complete(&rig).into_owned();
        if rig.lights.is_empty() {
            tracing::warn!("{}: no lights: the picture is black", rig_path.unwrap_or(path).display());
        }
        if let Err(reason) = emitters.check(&rig) {
            return Err(Error::import(rig_path.unwrap_or(path), reason));
        }
        if let Err(reason) = rig.check_links(&scene) {
            match rig_path {
                Some(rig_path) => return Err(Error::import(rig_path, reason)),
                // The scene was edited since relume wrote its lights into it.
                None => {
                    tracing::warn!("{}: links to objects are discarded: {reason}", path.display());
                    rig.lights.iter_mut().for_each(|light| light.links = Links::default());
                    rig.snapshots.clear();
                    rig.shots.clear();
                    rig.sets.clear();
                }
            }
        }
        for reason in rig.stale_links(&scene) {
            tracing::warn!("{}: {reason}", rig_path.unwrap_or(path).display());
        }
        let (camera, size) = choose_view(&scene, &rig, settings)?;
        let seen = rig.of_shot(&camera.name).map_err(|reason| Error::import(rig_path.unwrap_or(path), reason))?;
        Ok(Self { scene, rig: seen, base_rig: rig, camera, size })
    }
}

/// The camera, and the size of its picture.
pub(super) fn choose_view(scene: &Scene, rig: &Rig, settings: &OpenSettings) -> Result<(Camera, [u32; 2])> {
    let camera = choose_camera(scene, rig, settings)?;
    let size = settings.size.unwrap_or_else(|| scene.default_size(Some(&camera)));
    if let (None, None, Some(aspect)) = (settings.size, scene.image_size, camera.aspect) {
        let [width, height] = size;
        tracing::info!("{width}x{height}: camera \"{}\" has an aspect ratio of {aspect:.4}", camera.name);
    }
    check_size(size).map_err(|reason| Error::invalid(scene.path.display().to_string(), reason))?;
    Ok((camera, size))
}

/// Makes a scene ready for rays.
pub fn build_bvh(scene: Scene, progress: &dyn Progress) -> TracedScene {
    progress.begin("building the BVH", 0);
    let scene = TracedScene::new(scene);
    progress.end();
    scene
}

/// The rig's camera, the one asked for by name, the first, or one that frames the scene.
fn choose_camera(scene: &Scene, rig: &Rig, settings: &OpenSettings) -> Result<Camera> {
    if let Some(name) = &settings.camera {
        let found = scene.cameras.iter().find(|camera| camera.name == without_dots(name));
        return found.cloned().ok_or_else(|| {
            let names: Vec<_> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
            let reason = match names.is_empty() {
                true => format!("{} has no cameras", scene.path.display()),
                false => format!("{} has no such camera; its cameras are: {}", scene.path.display(), names.join(", ")),
            };
            Error::invalid(format!("--camera {name}"), reason)
        });
    }
    if let Some(camera) = rig.camera.as_ref().or(scene.cameras.first()) {
        // A rig says in other numbers what the scene says: what is baked for that camera is found again.
        let own = scene.cameras.iter().find(|own| own.sees_as(camera));
        return Ok(own.unwrap_or(camera).clone());
    }
    tracing::warn!("{}: no camera: the view shows the whole scene", scene.path.display());
    Ok(Camera::framing(&scene.mesh, scene.space))
}

/// Whether an image of this size can be made.
pub fn check_size(size: [u32; 2]) -> Result<(), String> {
    match size {
        [w, h] if w == 0 || h == 0 => Err(format!("{w}x{h} has no pixels")),
        [w, h] if w.max(h) > MAX_IMAGE_SIDE => Err(format!("{w}x{h} is larger than {MAX_IMAGE_SIDE}x{MAX_IMAGE_SIDE}")),
        _ => Ok(()),
    }
}
