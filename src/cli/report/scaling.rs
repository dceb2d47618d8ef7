//! What costs how much more where there is more of something.

use std::collections::HashMap;

use relume::Result;
use relume::relight::Picture;
use relume::report::Method;
use relume::report::growth::{Cost, Growth};
use relume::scene::{Mesh, Rig};
use relume::session::{BakeReport, Opened, Session};

use super::lab::{Lab, fit, session_settings};
use crate::cli::bench::{Timing, edits_of};
use crate::cli::bench_rig::light_like_scene;
use crate::cli::options::ViewOptions;
use crate::cli::progress::Terminal;

/// Edits whose times are told, without indirect light.
const EDITS: [(&str, &str); 3] = [("color", "recolour a light"), ("move_direct", MOVE), ("select", SELECT)];

const MOVE: &str = "move a light";
const SELECT: &str = "recolour another light each time";
/// Exponents that a logarithm is told as, over the numbers of triangles and of lights that are looked at.
const LOGARITHM: f64 = 0.2;
const LOGARITHM_OF_LIGHTS: f64 = 0.35;
const MOST_LAYERS: u32 = 6;
const WITHOUT: &str = "without indirect light";

impl Lab<'_> {
    /// Measured unless they were before; of the gather samples, what the curves have told.
    pub fn scaling(&mut self) -> Result<Vec<Growth>> {
        let what = format!(
            "scaling {} {:?} {:?}",
            self.identity,
            self.relight,
            (self.extent.lights, self.extent.sides, self.extent.triangles, self.extent.frames)
        );
        let measured: Vec<Growth> = match self.kept.get(&what) {
            Some(growths) => growths,
            None => {
                let growths = vec![self.against_lights()?, self.against_pixels()?, self.against_triangles()?];
                self.kept.keep(&what, &growths)?;
                growths
            }
        };
        Ok(measured.into_iter().chain([self.against_gather_samples()]).collect())
    }

    fn against_lights(&self) -> Result<Growth> {
        // A tree of partial sums.
        let mut costs = EDITS.map(|(_, name)| cost(name, if name == SELECT { LOGARITHM_OF_LIGHTS } else { 0.0 }));
        for &count in self.extent.lights {
            let rig = light_like_scene(&self.session, count, self.view.seed);
            self.time(&self.session, &rig, count as f64, &mut costs)?;
        }
        Ok(self.growth("lights", &self.as_seen(), costs.into()))
    }

    fn against_pixels(&self) -> Result<Growth> {
        let mut bake = cost("deep framebuffer, baked", 1.0);
        let mut costs = EDITS.map(|(_, name)| cost(name, 1.0));
        let own = self.session.scene.default_size(Some(&self.session.framebuffer.camera));
        let large = own.map(|side| side * 16);
        for &side in self.extent.sides {
            let view = ViewOptions { size: Some(fit(large, side)), ..self.view.clone() };
            let session = self.direct(&view)?;
            let pixels = (session.size().0 * session.size().1) as f64;
            let rig = light_like_scene(&session, 2, view.seed);
            bake.points.push([pixels, stage_ms(&session, "deep framebuffer")]);
            self.time(&session, &rig, pixels, &mut costs)?;
        }
        Ok(self.growth("pixels", WITHOUT, costs.into_iter().chain([bake]).collect()))
    }

    /// The scene itself, its triangles cut into four again and again, which changes hardly anything that is seen.
    fn against_triangles(&self) -> Result<Growth> {
        let mut bakes = [cost("BVH, built", 1.0), cost("deep framebuffer, baked", LOGARITHM)];
        let mut costs = EDITS.map(|(_, name)| cost(name, if name == MOVE { LOGARITHM } else { 0.0 }));
        for cuts in 0.. {
            let progress = Terminal::default();
            let mut opened = Opened::new(self.path, self.rig_path, &self.view.settings(), &progress)?;
            let triangles = opened.scene.mesh.triangles.len() << (2 * cuts);
            if triangles > self.extent.triangles && cuts > 0 {
                break;
            }
            (0..cuts).for_each(|_| cut_into_four(&mut opened.scene.mesh));
            let settings = session_settings(&self.view, None, self.target())?;
            let session = Session::of(opened, &settings, BakeReport::default(), &progress)?;
            let rig = light_like_scene(&session, 2, self.view.seed);
            bakes[0].points.push([triangles as f64, stage_ms(&session, "build BVH")]);
            bakes[1].points.push([triangles as f64, stage_ms(&session, "deep framebuffer")]);
            self.time(&session, &rig, triangles as f64, &mut costs)?;
        }
        Ok(self.growth("triangles", &self.as_seen(), bakes.into_iter().chain(costs).collect()))
    }

    /// Layers of the deep framebuffer, one behind the other in mirrors; absent where there are none. Measured unless
    /// they were before.
    pub fn against_layers(&mut self) -> Result<Option<Growth>> {
        if self.session.layers().iter().skip(1).all(|&samples| samples == 0) {
            return Ok(None);
        }
        let what =
            format!("scaling {} {:?} of {MOST_LAYERS} layers {}", self.identity, self.relight, self.extent.frames);
        if let Some(growth) = self.kept.get(&what) {
            return Ok(Some(growth));
        }
        let mut bake = cost("deep framebuffer, baked", 1.0);
        let mut costs = EDITS.map(|(_, name)| cost(name, 1.0));
        for layers in 1..=MOST_LAYERS {
            let view = ViewOptions { layers, ..self.view.clone() };
            let session = self.direct(&view)?;
            let rig = light_like_scene(&session, 2, view.seed);
            bake.points.push([f64::from(layers), stage_ms(&session, "deep framebuffer")]);
            self.time(&session, &rig, f64::from(layers), &mut costs)?;
        }
        let growth = self.growth("layers", &self.as_seen(), costs.into_iter().chain([bake]).collect());
        self.kept.keep(&what, &growth)?;
        Ok(Some(growth))
    }

    fn against_gather_samples(&self) -> Growth {
        let mut bake = cost("all before the first picture, CPU time", 1.0);
        let mut frame = cost("move a light, CPU time", 1.0);
        for point in self.points.iter().filter(|p| p.method == Method::GatherSamples) {
            let count = point.setting.split_whitespace().nth(1).and_then(|n| n.parse::<f64>().ok());
            for (cost, seconds) in [(&mut bake, point.precompute), (&mut frame, point.frame)] {
                cost.points.extend(count.map(|count| [count, 1e3 * seconds.cpu]));
            }
        }
        let (width, height) = self.session.size();
        self.growth("gather samples", &format!("{width}×{height}, with indirect light"), vec![bake, frame])
    }

    /// Times the edits that the costs are of, with `count` of what grows.
    fn time(&self, session: &Session, rig: &Rig, count: f64, costs: &mut [Cost; 3]) -> Result<()> {
        let mut relighter = session.relighter(&self.context, rig, &self.relight)?;
        relighter.display(Picture::Whole)?;
        let timing = Timing::new(session, self.extent.frames);
        for ((name, _), cost) in EDITS.iter().zip(costs) {
            let Some((edited, edit)) = edits_of(rig).into_iter().find(|(_, edit)| edit.1 == *name) else { continue };
            let record = timing.measure(&mut relighter, rig, edited, edit)?;
            cost.points.push([count, record.median_ms]);
        }
        Ok(())
    }

    /// `how`: what is the same for all of them.
    fn growth(&self, of: &str, how: &str, curves: Vec<Cost>) -> Growth {
        let told = curves.into_iter().filter(|cost| cost.points.len() > 1).collect();
        Growth { of: of.into(), scene: format!("{}, {how}", self.session.scene.name()), curves: told }
    }

    /// How the session's pictures are made.
    fn as_seen(&self) -> String {
        let (width, height) = self.session.size();
        format!("{width}×{height}, {WITHOUT}")
    }
}

fn cost(name: &str, expected: f64) -> Cost {
    Cost { name: name.into(), expected, points: Vec::new() }
}

fn stage_ms(session: &Session, name: &str) -> f64 {
    1e3 * session.bake.stages.iter().filter(|stage| stage.name == name).map(|stage| stage.seconds).sum::<f64>()
}

/// Cuts each triangle at the middles of its edges.
fn cut_into_four(mesh: &mut Mesh) {
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    let mut cut = Vec::with_capacity(4 * mesh.triangles.len());
    for [a, b, c] in std::mem::take(&mut mesh.triangles) {
        let mut middle =
            |i: u32, j: u32| *middles.entry([i.min(j), i.max(j)]).or_insert_with(|| add_middle(mesh, i, j));
        let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
        cut.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    mesh.triangles = cut;
    for values in [&mut mesh.triangle_materials, &mut mesh.triangle_objects] {
        *values = values.iter().flat_map(|&index| [index; 4]).collect();
    }
}

/// A new vertex between two.
fn add_middle(mesh: &mut Mesh, i: u32, j: u32) -> u32 {
    let [i, j] = [i, j].map(|v| v as usize);
    mesh.positions.push((mesh.positions[i] + mesh.positions[j]) / 2.0);
    mesh.normals.push((mesh.normals[i] + mesh.normals[j]).normalize_or(mesh.normals[i]));
    for uvs in mesh.uvs.iter_mut().filter(|uvs| !uvs.is_empty()) {
        uvs.push((uvs[i] + uvs[j]) / 2.0);
    }
    if !mesh.colors.is_empty() {
        mesh.colors.push((mesh.colors[i] + mesh.colors[j]) / 2.0);
    }
    if !mesh.tangents.is_empty() {
        let [s, t] = [i, j].map(|v| mesh.tangents[v]);
        let axis = (s + t).truncate().normalize_or(s.truncate());
        mesh.tangents.push(axis.extend(s.w));
    }
    mesh.positions.len() as u32 - 1
}
