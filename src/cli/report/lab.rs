//! One scene of a report: what is open, and what has been measured of it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use relume::gpu::Context;
use relume::image::compare;
use relume::relight::{RelightSettings, VisibilityMethod};
use relume::report::{Floors, Method, Picture, Point, SceneReport, Skipped, significant};
use relume::scene::Scene;
use relume::session::Target;
use relume::{Result, Session, SessionSettings};

use super::measurement_store::MeasurementStore;
use super::truth::{Truth, read};
use super::{Args, Extent};
use crate::cli::options::ViewOptions;
use crate::cli::progress::Terminal;
use crate::cli::transfer::{FormName, Gi, MethodName, TransferOptions};

/// A scene that is being measured.
pub struct Lab<'a> {
    pub dir: &'a Path,
    pub path: &'a Path,
    pub extent: &'a Extent,
    pub kept: &'a mut MeasurementStore,
    pub view: ViewOptions,
    /// Size that was asked for.
    pub asked: Option<[u32; 2]>,
    pub rig_path: Option<&'a Path>,
    /// How edits are relit.
    pub relight: RelightSettings,
    /// Keeps bakes that nobody times.
    pub cache_dir: Option<PathBuf>,
    pub context: Arc<Context>,
    /// Without indirect light; pictures of the size whose errors are told.
    pub session: Session,
    /// What all of it depends on.
    pub identity: String,
    /// A name for that.
    pub folder: String,
    pub points: Vec<Point>,
    pub skipped: Vec<Skipped>,
}

impl<'a> Lab<'a> {
    /// Seen as `view` says, which need not be the arguments'.
    pub fn open(
        path: &'a Path,
        view: &ViewOptions,
        args: &'a Args,
        extent: &'a Extent,
        kept: &'a mut MeasurementStore,
    ) -> Result<Self> {
        let scene = Scene::load(path)?;
        let own = scene.default_size(scene.cameras.first());
        let size = view.size.unwrap_or_else(|| fit(own, extent.side));
        let (asked, view) = (view.size, ViewOptions { size: Some(size), ..view.clone() });
        let rig_path = args.rig.as_deref();
        let settings = session_settings(&view, None, args.target()?)?;
        let session = Session::open_direct(path, rig_path, &settings, &Terminal::default())?;
        let context = session.context(args.device.device.as_deref())?;
        let identity = format!(
            "{:?} {:?} {:?} seed {} on {}",
            session.key,
            session.rig,
            session.scene.name(),
            view.seed,
            context.info.name
        );
        let hash = blake3::hash(identity.as_bytes()).to_hex();
        let folder = format!("{}-{}x{}-{}", session.scene.name(), size[0], size[1], &hash[..8]);
        Ok(Self {
            dir: &args.output,
            path,
            extent,
            kept,
            view,
            asked,
            rig_path,
            relight: args.relight_settings(),
            cache_dir: args.cache.dir(),
            context,
            session,
            identity,
            folder,
            points: Vec::new(),
            skipped: Vec::new(),
        })
    }

    /// Everything that the report tells of the scene.
    pub fn measure(&mut self) -> Result<SceneReport> {
        let name = self.session.scene.name();
        let truth = self.truth()?;
        if truth.has_indirect() {
            self.curves(&truth)?;
        } else {
            self.skipped.push(Skipped { what: "all curves".into(), why: "no indirect light is visible".into() });
        }
        let pictures = self.pictures(&truth)?;
        let edits = self.edits()?;
        let (width, height) = self.session.size();
        Ok(SceneReport {
            name,
            triangles: self.session.scene.mesh.triangles.len(),
            lights: self.session.rig.lights.len(),
            size: [width as u32, height as u32],
            truth_samples: self.extent.truth,
            floors: if self.points.is_empty() { Floors::default() } else { truth.floors() },
            points: self.points.clone(),
            skipped: std::mem::take(&mut self.skipped),
            pictures,
            edit_size: edits.size,
            edits: edits.times,
            left_out: edits.left_out,
            ablation: edits.ablation,
        })
    }

    /// The scene seen as `settings` say, without indirect light.
    pub fn direct(&self, view: &ViewOptions) -> Result<Session> {
        let settings = session_settings(view, None, self.target())?;
        Session::open_direct(self.path, self.rig_path, &settings, &Terminal::default())
    }

    /// Where its edits are relit.
    pub fn target(&self) -> Target {
        Target { device: self.context.info.clone(), relight: self.relight.clone() }
    }

    /// As edits are relit, but with these shadows.
    pub fn relight_with(&self, visibility: VisibilityMethod) -> RelightSettings {
        RelightSettings { visibility, ..self.relight.clone() }
    }

    pub fn truth(&self) -> Result<Truth> {
        let name = format!("{}-{}-{}", self.folder, self.extent.truth, self.kept.program());
        let file = self.dir.join("truth").join(name);
        Truth::get(&file, &self.session, &self.view, self.extent.truth)
    }

    /// Direct light, truth, ours, path tracing in the nearest time, the thesis's, and where these differ from the
    /// truth: Figures 5.3 and 5.5 of the thesis.
    fn pictures(&self, truth: &Truth) -> Result<Vec<Picture>> {
        let (width, height) = self.session.size();
        let Some(exposure) = truth.exposure() else { return Ok(Vec::new()) };
        let picture = |caption: String, pixels| Picture { caption, width, height, pixels };
        let whole = truth.mean();
        let first_hand: Vec<[f32; 3]> =
            whole.iter().zip(truth.indirect()).map(|(all, late)| [0, 1, 2].map(|c| all[c] - late[c])).collect();
        let mut pictures = vec![
            picture("Direct light and reflections alone".into(), compare::displayed(&first_hand, exposure)),
            picture("The truth".into(), compare::displayed(&whole, exposure)),
        ];
        let ours = self.points.iter().rev().find(|p| p.method == Method::GatherSamples);
        let rival = ours.and_then(|ours| {
            let traced = self.points.iter().filter(|p| p.method == Method::PathTracing);
            let apart = |p: &Point| (p.frame.cpu / ours.total_cpu()).ln().abs();
            traced.min_by(|p, q| apart(p).total_cmp(&apart(q)))
        });
        let last = |method: Method| self.points.iter().rfind(|p| p.method == method);
        let shown = [
            ("Ours", ours),
            ("Path tracing, nearest to that in time", rival),
            ("The thesis's diffuse transfer", last(Method::ThesisDiffuse)),
            ("The thesis's glossy transfer", last(Method::ThesisGlossy)),
        ];
        for (who, point) in shown {
            let Some(point) = point else { continue };
            let image = read(&self.dir.join(&point.file), self.session.size())?;
            let Some(whole) = image.layer("") else { continue };
            let caption = format!("{who}, `{}`, {} CPU seconds", point.setting, significant(point.total_cpu()));
            pictures.push(picture(caption.clone(), compare::displayed(&whole.pixels, exposure)));
            let scale = (2.0 * exposure) as f32;
            pictures
                .push(picture(format!("{who}: difference from the truth, times 2"), truth.difference(&image, scale)));
        }
        Ok(pictures)
    }
}

/// A scene seen as `view` says, with indirect light as `transfer` says, else none, for pictures on `target`; nothing is
/// read from a cache.
pub fn session_settings(
    view: &ViewOptions,
    transfer: Option<&TransferOptions>,
    target: Target,
) -> Result<SessionSettings> {
    Ok(SessionSettings {
        open: view.settings(),
        layers: view.layers,
        seed: view.seed,
        cache_dir: None,
        indirect: transfer.map(TransferOptions::settings).transpose()?.flatten(),
        target: Some(target),
        ..Default::default()
    })
}

/// Our indirect light.
pub fn ours(gather: Option<u32>, rays: u32, error: f64, form: FormName) -> TransferOptions {
    let (gi, method) = (Gi::Glossy, MethodName::Robust);
    TransferOptions { gi, method, gather, rays: Some(rays), basis: None, transfer: form, error, bounces: None }
}

/// A size of the same shape whose longest side is at most `side`.
pub fn fit(size: [u32; 2], side: u32) -> [u32; 2] {
    let longest = size[0].max(size[1]);
    if longest <= side {
        return size;
    }
    size.map(|s| (f64::from(s) * f64::from(side) / f64::from(longest)).round().max(1.0) as u32)
}

/// Where a picture goes, under the report's folder.
pub fn picture_file(folder: &str, setting: &str) -> PathBuf {
    let name = setting.trim_start_matches('-').replace(" --", "-").replace(' ', "-");
    Path::new("pictures").join(folder).join(format!("{name}.exr"))
}
