//! What costs how much more where there is more of something.

use relume::Result;
use relume::relight::Picture;
use relume::report::Method;
use relume::report::growth::{Cost, Growth};
use relume::scene::Rig;

use super::lab::{Lab, fit, scene_options};
use crate::cli::bench::{edits_of, measure};
use crate::cli::bench_rig::light_like_scene;
use crate::cli::options::{ViewOptions, Visibility};
use crate::cli::progress::Terminal;
use crate::cli::session::Session;

/// Edits whose times are told.
const EDITS: [(&str, &str); 3] =
    [("color", "recolour a light"), ("move_direct", "move a light"), ("select", "recolour another light each time")];

impl Lab<'_> {
    /// Measured unless they were before; of the gather samples, what the curves have told.
    pub fn scaling(&mut self) -> Result<Vec<Growth>> {
        let what = format!("scaling {} {:?}", self.identity, (self.extent.lights, self.extent.sides));
        let measured: Vec<Growth> = match self.kept.get(&what) {
            Some(growths) => growths,
            None => {
                let growths = vec![self.against_lights()?, self.against_pixels()?];
                self.kept.keep(&what, &growths)?;
                growths
            }
        };
        Ok(measured.into_iter().chain([self.against_gather_samples()]).collect())
    }

    fn against_lights(&self) -> Result<Growth> {
        let mut costs = EDITS.map(|(_, name)| cost(name, 0.0));
        for &count in self.extent.lights {
            let rig = light_like_scene(&self.session, count, self.view.seed);
            self.time(&self.session, &rig, count as f64, &mut costs)?;
        }
        Ok(self.growth("lights", costs.into()))
    }

    fn against_pixels(&self) -> Result<Growth> {
        let mut bake = cost("deep framebuffer, baked", 1.0);
        let mut costs = EDITS.map(|(_, name)| cost(name, 1.0));
        let own = self.session.scene.image_size.unwrap_or([720, 480]);
        let large = own.map(|side| side * 16);
        for &side in self.extent.sides {
            let view = ViewOptions { size: Some(fit(large, side)), ..self.view.clone() };
            let session = Session::open_direct(self.path, None, &scene_options(&view, None), &Terminal::default())?;
            let pixels = (session.size().0 * session.size().1) as f64;
            let rig = light_like_scene(&session, 2, view.seed);
            let baked = session.bake.stages.iter().filter(|stage| stage.name == "deep framebuffer");
            bake.points.push([pixels, 1e3 * baked.map(|stage| stage.seconds).sum::<f64>()]);
            self.time(&session, &rig, pixels, &mut costs)?;
        }
        Ok(self.growth("pixels", costs.into_iter().chain([bake]).collect()))
    }

    fn against_gather_samples(&self) -> Growth {
        let mut bake = cost("bake of indirect light, CPU time", 1.0);
        let mut frame = cost("move a light, with indirect light, CPU time", 1.0);
        for point in self.points.iter().filter(|p| p.method == Method::GatherSamples) {
            let count = point.setting.split_whitespace().nth(1).and_then(|n| n.parse::<f64>().ok());
            for (cost, seconds) in [(&mut bake, point.precompute), (&mut frame, point.frame)] {
                cost.points.extend(count.map(|count| [count, 1e3 * seconds.cpu]));
            }
        }
        self.growth("gather samples", vec![bake, frame])
    }

    /// Times the edits that the costs are of, with `count` of what grows.
    fn time(&self, session: &Session, rig: &Rig, count: f64, costs: &mut [Cost; 3]) -> Result<()> {
        let mut relighter = session.relighter(&self.context, rig, &self.light_options(Visibility::Auto))?;
        relighter.display(Picture::Whole, 0.0)?;
        for ((name, _), cost) in EDITS.iter().zip(costs) {
            let Some((edited, edit)) = edits_of(rig).into_iter().find(|(_, edit)| edit.1 == *name) else { continue };
            let record = measure(&mut relighter, session, rig, edited, edit, self.extent.frames)?;
            cost.points.push([count, record.median_ms]);
        }
        Ok(())
    }

    fn growth(&self, of: &str, curves: Vec<Cost>) -> Growth {
        let told = curves.into_iter().filter(|cost| cost.points.len() > 1).collect();
        Growth { of: of.into(), scene: self.session.scene.name(), curves: told }
    }
}

fn cost(name: &str, expected: f64) -> Cost {
    Cost { name: name.into(), expected, points: Vec::new() }
}
