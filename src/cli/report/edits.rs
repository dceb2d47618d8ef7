//! What edits take, pass by pass, and what leaving things out saves.

use std::sync::Arc;

use relume::bake::DeepFramebuffer;
use relume::relight::roofline::Roofline;
use relume::relight::{Picture, Relighter, VisibilityMethod};
use relume::report::{Ablation, EditTime, LeftOut, PassMs, larger};
use relume::{Result, Session, SessionSettings};
use serde::{Deserialize, Serialize};

use super::lab::{Lab, ours, session_settings};
use crate::cli::bench::{Record, SEVERAL, Timing, best_of, edits_of};
use crate::cli::options::ViewOptions;
use crate::cli::percentile::percentile;
use crate::cli::progress::Terminal;
use crate::cli::transfer::FormName;
use crate::cli::unneeded::left_out;

/// What edits of a scene take, as relume plans it.
#[derive(Serialize, Deserialize)]
pub struct Edits {
    pub size: [u32; 2],
    pub times: Vec<EditTime>,
    pub left_out: Vec<LeftOut>,
    pub ablation: Option<Ablation>,
}

impl Lab<'_> {
    /// Measured unless they were before.
    pub fn edits(&mut self) -> Result<Edits> {
        let whole = self.extent.whole_edits;
        let what = format!("edits {} {whole} {} {:?}", self.identity, self.extent.frames, self.relight);
        if let Some(edits) = self.kept.get(&what) {
            return Ok(edits);
        }
        let edits = self.measure_edits(whole)?;
        self.kept.keep(&what, &edits)?;
        Ok(edits)
    }

    fn measure_edits(&self, whole: bool) -> Result<Edits> {
        let size = if whole { self.asked } else { self.view.size };
        let view = ViewOptions { size, ..self.view.clone() };
        let gather = (!whole).then(|| self.usual_gather_samples());
        let planned = ours(gather, 1024, 0.01, FormName::Auto);
        // Its bake takes minutes and is not timed: a report that was interrupted while it timed edits need not repeat
        // it.
        let cache_dir = self.cache_dir.clone();
        let settings = SessionSettings { cache_dir, ..session_settings(&view, Some(&planned), self.target())? };
        let session = Session::open(self.path, self.rig_path, &settings, &Terminal::default())?;
        let limits = Measured::new(self, &session)?;
        let mut relighter = session.relighter(&self.context, &session.rig, &self.relight)?;
        relighter.display(Picture::Whole)?;
        let timing = Timing::new(&session, self.extent.frames);
        let mut times = Vec::new();
        for (edited, edit) in edits_of(&session.rig) {
            let record = timing.measure(&mut relighter, &session.rig, edited, edit)?;
            times.push(limits.told(&record));
        }
        let items = left_out(&session.counts(), relighter.rig(), relighter.traces(), session.unneeded());
        let left_out = items.into_iter().map(|i| LeftOut { what: i.what.into(), why: i.why, saves: i.saves }).collect();
        // The other way to shadows, beside the one that was chosen.
        let other = if relighter.traces() { VisibilityMethod::Map } else { VisibilityMethod::Traced };
        drop(relighter);
        let mut relighter = session.relighter(&self.context, &session.rig, &self.relight_with(other))?;
        for (edited, edit) in edits_of(&session.rig).into_iter().filter(|(_, edit)| edit.1 == "move_direct") {
            let record = timing.measure(&mut relighter, &session.rig, edited, edit)?;
            times.push(limits.told(&record));
        }
        let (width, height) = session.size();
        let ablation = self.ablation(&session)?;
        Ok(Edits { size: [width as u32, height as u32], times, left_out, ablation })
    }

    /// The picture with nothing left out, and what it takes; none without lights.
    fn ablation(&self, session: &Session) -> Result<Option<Ablation>> {
        let moved = edits_of(&session.rig).into_iter().find(|(_, edit)| edit.1 == "move_direct");
        let Some((edited, edit)) = moved else { return Ok(None) };
        let settings = self.relight_with(VisibilityMethod::Traced);
        let held = || self.context.memory_by_owner().iter().map(|(_, bytes)| bytes).sum::<u64>();
        let measured = |framebuffer: &Arc<DeepFramebuffer>| -> Result<(Vec<[f32; 3]>, Record, u64)> {
            let before = held();
            let mut relighter = Relighter::new(
                &self.context,
                &session.scene,
                framebuffer,
                session.transfer.as_ref(),
                &session.rig,
                &settings,
            )?;
            let picture = relighter.linear(Picture::Whole)?.to_vec();
            let record =
                Timing::new(session, self.extent.frames).measure(&mut relighter, &session.rig, edited, edit)?;
            Ok((picture, record, held() - before))
        };
        let of_all = Arc::new(DeepFramebuffer::clone(&session.framebuffer).into_worst_case());
        let [(picture, record, bytes), (all, all_record, all_bytes)] =
            [measured(&session.framebuffer)?, measured(&of_all)?];
        let values = || picture.iter().flatten().zip(all.iter().flatten());
        let largest = values().map(|(a, b)| f64::from((a - b).abs())).fold(0.0, larger);
        let mean = values().map(|(a, _)| f64::from(*a)).sum::<f64>() / (3 * picture.len()) as f64;
        let shading = |record: &Record| -> f64 {
            record.passes.iter().filter(|pass| pass.name == SHADING).map(|pass| pass.best_ms).sum()
        };
        Ok(Some(Ablation {
            difference: if mean > 0.0 { largest / mean } else { largest },
            edit_ms: [record.best_ms, all_record.best_ms],
            shading_ms: [shading(&record), shading(&all_record)],
            bytes: [bytes, all_bytes],
        }))
    }
}

const SHADING: &str = "shade light";

/// What this machine takes for work that is known.
struct Measured {
    yardstick_ms: f64,
    /// As many bytes as the factors of indirect light have, at the rate at which a copy reads and writes.
    copy_ms: f64,
    /// lavapipe tells the times of passes too early once a shadow map was drawn.
    times_maps: bool,
}

impl Measured {
    fn new(lab: &Lab, session: &Session) -> Result<Self> {
        let mut limits = Roofline::new(&lab.context, session.framebuffer.samples.len())?;
        let mut yardstick = (0..9).map(|_| limits.yardstick_ms()).collect::<Result<Vec<_>>>()?;
        let yardstick_ms = percentile(&mut yardstick, 0.0);
        let bytes = session.transfer.as_ref().map_or(0, |transfer| transfer.cost().0);
        let times_maps = !lab.context.is_cpu();
        Ok(Self { yardstick_ms, times_maps, copy_ms: bytes as f64 * 1e-6 / best_of(5, || limits.copy_gb_s())? })
    }

    /// A record for the page; all passes from coefficients to pixels are one there.
    fn told(&self, record: &Record) -> EditTime {
        let mut passes: Vec<PassMs> = Vec::new();
        let timed = record.visibility == "traced" || self.times_maps;
        let edited = if record.edit == "multi" { SEVERAL as f64 } else { 1.0 };
        for pass in record.passes.iter().filter(|_| timed) {
            let transfer = pass.name == "Haar transform" || pass.name.starts_with("transfer");
            let name = if transfer { "transfer" } else { pass.name };
            let yardstick_ms = match name {
                "transfer" => Some(self.copy_ms),
                SHADING => Some(edited * self.yardstick_ms),
                _ => None,
            };
            match passes.iter_mut().find(|p| p.name == name) {
                Some(known) => known.median_ms += pass.median_ms,
                None => passes.push(PassMs {
                    name: name.into(),
                    on: format!("{:?}", pass.on).to_uppercase(),
                    median_ms: pass.median_ms,
                    yardstick_ms,
                }),
            }
        }
        EditTime {
            edit: record.edit.into(),
            light: format!("{:?}", record.edited_kind).to_lowercase(),
            lights: record.lights,
            shadows: record.visibility.into(),
            median_ms: record.median_ms,
            p95_ms: record.p95_ms,
            best_ms: record.best_ms,
            passes,
        }
    }
}
