//! `--stats` and `--trace`: figures of a run for other programs.

use std::path::Path;

use relume::Result;
use relume::gpu::{PassTime, Site};
use relume::image::file::write_bytes;
use relume::relight::Relighter;
use serde_json::{Value, json};

use super::output::Written;
use super::plan::left_out;
use super::session::{BakeReport, Session, peak_bytes};

/// Writes the figures of INTERFACE's `--stats`; what this version does not compute is null.
pub fn write(path: &Path, session: &Session, relighter: &Relighter, written: &Written) -> Result<()> {
    let info = &relighter.context().info;
    let baked = &session.baked;
    let memory: Vec<Value> = relighter
        .context()
        .memory_by_owner()
        .into_iter()
        .map(|(owner, bytes)| json!({ "owner": owner, "bytes": bytes }))
        .collect();
    let stats = json!({
        "schema": 1,
        "relume": env!("CARGO_PKG_VERSION"),
        "device": info.name,
        "driver": info.driver,
        "scene": {
            "triangles": session.scene.mesh.triangles.len(),
            "lights": relighter.rig().lights.len(),
            "width": baked.tiling.width,
            "height": baked.tiling.height,
        },
        "bake": {
            "seconds": session.bake.seconds,
            "cpu_seconds": session.bake.cpu_seconds,
            "stages": session.bake.stages,
            "cached": session.bake.cached,
            "peak_bytes": peak_bytes(),
        },
        "samples": { "view": baked.samples.len(), "gather": 0, "layers": baked.layers },
        "transfer": null,
        "frame": frame(relighter.times()),
        "non_finite": written.non_finite,
        "negative": written.negative,
        "memory": memory,
        "left_out": left_out(session, relighter.traces()),
    });
    write_bytes(path, format!("{stats:#}\n").as_bytes())
}

/// Passes in order of their first appearance, the times of equal names added.
pub fn sum_by_name(times: &[PassTime]) -> Vec<(&'static str, Site, f64)> {
    let mut passes: Vec<(&'static str, Site, f64)> = Vec::new();
    for time in times {
        match passes.iter_mut().find(|pass| pass.0 == time.name) {
            Some(pass) => pass.2 += time.ms,
            None => passes.push((time.name, time.site, time.ms)),
        }
    }
    passes
}

fn frame(times: &[PassTime]) -> Value {
    let passes = sum_by_name(times);
    let gpu_ms: f64 = passes.iter().filter(|p| p.1 == Site::Gpu).map(|p| p.2).sum();
    let wall_ms = times.iter().map(|t| t.start_ms + t.ms).fold(0.0, f64::max);
    let passes: Vec<Value> =
        passes.into_iter().map(|(name, site, ms)| json!({ "name": name, "ms": ms, "on": site })).collect();
    json!({ "passes": passes, "gpu_ms": gpu_ms, "wall_ms": wall_ms })
}

/// Events in the format of Chrome's tracing, which Perfetto opens too.
#[derive(Default)]
pub struct Trace {
    events: Vec<Value>,
    /// Where the next frame begins, microseconds.
    end_us: f64,
}

const CPU_THREAD: u32 = 1;
const GPU_THREAD: u32 = 2;

impl Trace {
    /// Adds the passes of one picture, called `name`, after what is there.
    pub fn add(&mut self, name: &str, times: &[PassTime]) {
        let begin = self.end_us;
        for time in times {
            let thread = if time.site == Site::Gpu { GPU_THREAD } else { CPU_THREAD };
            let start = begin + 1e3 * time.start_ms;
            self.event(time.name, name, thread, start, 1e3 * time.ms);
        }
    }

    fn event(&mut self, name: &str, category: &str, thread: u32, start_us: f64, us: f64) {
        self.end_us = self.end_us.max(start_us + us);
        self.events.push(json!({
            "name": name, "cat": category, "ph": "X", "pid": 1, "tid": thread, "ts": start_us, "dur": us,
        }));
    }

    /// Writes all events, the bake's stages before them.
    pub fn write(self, path: &Path, bake: &BakeReport) -> Result<()> {
        let mut all = Self::default();
        for stage in &bake.stages {
            all.event(stage.name, "bake", CPU_THREAD, all.end_us, 1e6 * stage.seconds);
        }
        let offset = all.end_us;
        for mut event in self.events {
            event["ts"] = json!(event["ts"].as_f64().unwrap_or(0.0) + offset);
            all.events.push(event);
        }
        for (thread, name) in [(CPU_THREAD, "CPU"), (GPU_THREAD, "GPU")] {
            all.events.push(json!({
                "name": "thread_name", "ph": "M", "pid": 1, "tid": thread, "args": { "name": name },
            }));
        }
        write_bytes(path, json!({ "traceEvents": all.events }).to_string().as_bytes())
    }
}
