//! `--stats` and `--trace`: figures of a run for other programs.

use std::collections::BTreeMap;

use relume::bake::transfer::Transfer;
use relume::gpu::{PassTime, Processor};
use relume::relight::Relighter;
use relume::session::{Session, Stage, peak_bytes};
use serde_json::{Value, json};

use super::unneeded::left_out;

/// Values in the pictures that should not be there.
pub struct Strange {
    /// By pass, how many were infinite or not a number.
    pub non_finite: Vec<(&'static str, u32)>,
    /// Below 0, of the beauty.
    pub negative: usize,
}

/// What `--stats` tells of a session and its first picture, all lights new, whose passes are `frame`. What is not
/// computed is null.
pub fn figures(session: &Session, relighter: &Relighter, frame: &[PassTime], strange: Option<&Strange>) -> Value {
    let context = relighter.context();
    let memory: Vec<Value> =
        context.memory_by_owner().into_iter().map(|(owner, bytes)| json!({ "owner": owner, "bytes": bytes })).collect();
    let mut figures = figures_of_bake(session, relighter.traces());
    figures["device"] = json!(context.info.name);
    figures["driver"] = json!(context.info.driver);
    let method = visibility_name(relighter.traces());
    figures["visibility"] = json!({ "method": method, "reason": relighter.visibility_reason() });
    figures["scene"]["lights"] = json!(relighter.rig().lights.len());
    figures["frame"] = figures_of_frame(frame);
    if let Some(Strange { non_finite, negative }) = strange {
        figures["non_finite"] = json!(non_finite.iter().map(|(_, count)| count).sum::<u32>());
        figures["non_finite_passes"] = json!(non_finite.iter().copied().collect::<BTreeMap<_, _>>());
        figures["negative"] = json!(negative);
    }
    figures["memory"] = json!(memory);
    figures
}

/// What is known without a device; all else is null. `traced`: shadow rays are traced, no maps are drawn.
pub fn figures_of_bake(session: &Session, traced: bool) -> Value {
    let framebuffer = &session.framebuffer;
    let transfer = session.transfer.as_deref();
    json!({
        "schema": 1,
        "relume": env!("CARGO_PKG_VERSION"),
        "device": null,
        "driver": null,
        "visibility": null,
        "scene": {
            "triangles": session.scene.mesh.triangles.len(),
            "lights": session.rig.lights.len(),
            "width": framebuffer.tiling.width,
            "height": framebuffer.tiling.height,
        },
        "bake": {
            "seconds": session.bake.seconds,
            "cpu_seconds": session.bake.cpu_seconds,
            "stages": session.bake.stages,
            "cached": session.bake.cached,
            "because": session.bake.because,
            "peak_bytes": peak_bytes(),
        },
        "samples": { "view": framebuffer.samples.len(), "gather": transfer.map_or(0, Transfer::sample_count), "layers": session.layers() },
        "transfer": figures_of_transfer(transfer, session.size()),
        "frame": null,
        "non_finite": null,
        "negative": null,
        "memory": null,
        "left_out": left_out(&session.counts(), &session.rig, traced, session.unneeded()),
    })
}

/// As `--visibility` calls the method.
pub fn visibility_name(traced: bool) -> &'static str {
    if traced { "traced" } else { "map" }
}

/// What is not computed is null.
fn figures_of_transfer(transfer: Option<&Transfer>, (width, height): (usize, usize)) -> Value {
    let Some(transfer) = transfer else {
        return json!({
            "method": null, "form": null, "bytes": 0, "bytes_per_pixel": 0.0, "macs_per_pixel": 0.0,
            "held_out": { "point": null, "spot": null, "worst_tile": null },
            "spectral_radius": null, "bounces": null, "residual": null, "capped": null, "sky": null,
        });
    };
    let pixels = (width * height) as f64;
    let (bytes, multiply_adds) = transfer.cost();
    let report = &transfer.report;
    json!({
        "method": report.method,
        "form": report.form,
        "bytes": bytes,
        "bytes_per_pixel": bytes as f64 / pixels,
        "macs_per_pixel": multiply_adds as f64 / pixels,
        "held_out": report.held_out.as_ref().map_or(
            json!({ "point": null, "spot": null, "worst_tile": null }),
            |r| json!({ "point": r.point, "spot": r.spot, "worst_tile": r.tiles.iter().copied().reduce(f64::max) }),
        ),
        "spectral_radius": report.spectral_radius,
        "bounces": report.bounces.map_or(json!("inf"), |bounces| json!(bounces)),
        "residual": report.residual,
        "capped": report.capped,
        "sky": transfer.sky.as_ref().map(|sky| {
            let (bytes, multiply_adds) = sky.cost();
            json!({
                "bytes": bytes,
                "bytes_per_pixel": bytes as f64 / pixels,
                "macs_per_pixel": multiply_adds as f64 / pixels,
                "held_out": { "broad": sky.held_out.point, "narrow": sky.held_out.spot },
            })
        }),
    })
}

/// Passes in order of their first appearance, the times of equal names added.
pub fn sum_by_name(times: &[PassTime]) -> Vec<(&'static str, Processor, f64)> {
    let mut passes: Vec<(&'static str, Processor, f64)> = Vec::new();
    for time in times {
        match passes.iter_mut().find(|pass| pass.0 == time.name) {
            Some(pass) => pass.2 += time.ms,
            None => passes.push((time.name, time.processor, time.ms)),
        }
    }
    passes
}

fn figures_of_frame(times: &[PassTime]) -> Value {
    let passes = sum_by_name(times);
    let gpu_ms: f64 = passes.iter().filter(|p| p.1 == Processor::Gpu).map(|p| p.2).sum();
    let wall_ms = times.iter().map(|t| t.start_ms + t.ms).fold(0.0, f64::max);
    let passes: Vec<Value> =
        passes.into_iter().map(|(name, processor, ms)| json!({ "name": name, "ms": ms, "on": processor })).collect();
    json!({ "passes": passes, "gpu_ms": gpu_ms, "wall_ms": wall_ms })
}

const CPU_THREAD: u32 = 1;
const GPU_THREAD: u32 = 2;

/// Chrome's trace events, which Perfetto opens too; times in microseconds.
#[derive(Default)]
struct Events(Vec<Value>);

impl Events {
    /// One stage after the other; returns when the last one ended, too.
    fn stages(stages: &[Stage]) -> (Self, f64) {
        let (mut events, mut begin_us) = (Self::default(), 0.0);
        for stage in stages {
            events.add(stage.name, "bake", CPU_THREAD, begin_us, 1e6 * stage.seconds);
            begin_us += 1e6 * stage.seconds;
        }
        (events, begin_us)
    }

    fn add(&mut self, name: &str, category: &str, thread: u32, start_us: f64, us: f64) {
        self.0.push(json!({
            "name": name, "cat": category, "ph": "X", "pid": 1, "tid": thread, "ts": start_us, "dur": us,
        }));
    }

    /// The passes of a frame that began at `begin_us`; returns when the last one of them ended.
    fn frame(&mut self, begin_us: f64, times: &[PassTime]) -> f64 {
        let mut end_us = begin_us;
        for time in times {
            let thread = if time.processor == Processor::Gpu { GPU_THREAD } else { CPU_THREAD };
            let start_us = begin_us + 1e3 * time.start_ms;
            self.add(time.name, "frame", thread, start_us, 1e3 * time.ms);
            end_us = end_us.max(start_us + 1e3 * time.ms);
        }
        end_us
    }

    fn json(mut self) -> Value {
        for (thread, name) in [(CPU_THREAD, "CPU"), (GPU_THREAD, "GPU")] {
            self.0.push(json!({
                "name": "thread_name", "ph": "M", "pid": 1, "tid": thread, "args": { "name": name },
            }));
        }
        json!({ "schema": 1, "traceEvents": self.0 })
    }
}

/// Stages, then the passes of each frame, one after the other.
pub fn trace(stages: &[Stage], frames: &[Vec<PassTime>]) -> Value {
    let (mut events, mut begin_us) = Events::stages(stages);
    for frame in frames {
        begin_us = events.frame(begin_us, frame);
    }
    events.json()
}

/// The same, where each edit has several frames, and is an event around them.
pub fn trace_edits(stages: &[Stage], edits: &[(&'static str, Vec<Vec<PassTime>>)]) -> Value {
    let (mut events, mut begin_us) = Events::stages(stages);
    for (edit, frames) in edits {
        let end_us = frames.iter().fold(begin_us, |begin_us, frame| events.frame(begin_us, frame));
        events.add(edit, "edit", CPU_THREAD, begin_us, end_us - begin_us);
        begin_us = end_us;
    }
    events.json()
}

/// The passes of frames that began at these milliseconds.
pub fn trace_frames(frames: &[(f64, Vec<PassTime>)]) -> Value {
    let mut events = Events::default();
    for (begin_ms, times) in frames {
        events.frame(1e3 * begin_ms, times);
    }
    events.json()
}
