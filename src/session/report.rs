//! What baking took.

use std::time::Instant;

use crate::error::Error;

/// What the bake took.
#[derive(Default)]
pub struct BakeReport {
    pub stages: Vec<Stage>,
    pub seconds: f64,
    /// User and system, all threads.
    pub cpu_seconds: f64,
    /// Whether all of the bake came from the cache.
    pub cached: bool,
    /// What changed since the most similar bake of the scene in the cache; `None` if it came from there, or there is
    /// none.
    pub because: Option<String>,
    /// Why what was baked could not be kept.
    pub not_stored: Option<Error>,
}

#[derive(serde::Serialize, Clone)]
/// One step of a bake, by its wall clock.
pub struct Stage {
    pub name: &'static str,
    pub seconds: f64,
}

impl BakeReport {
    /// Adds what `work` takes to the whole.
    pub(super) fn clocked<R>(&mut self, work: impl FnOnce(&mut Self) -> R) -> R {
        let (start, cpu_start) = (Instant::now(), cpu_seconds());
        let result = work(self);
        self.seconds += start.elapsed().as_secs_f64();
        self.cpu_seconds += cpu_seconds() - cpu_start;
        result
    }

    /// Does `work` as a stage of its own.
    pub fn stage<R>(&mut self, name: &'static str, work: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = work();
        let seconds = start.elapsed().as_secs_f64();
        tracing::info!("{name}: {:.0} ms", 1e3 * seconds);
        self.stages.push(Stage { name, seconds });
        result
    }
}

/// Processor time of this process, user and system, all threads; 0 on systems other than Linux.
pub fn cpu_seconds() -> f64 {
    #[cfg(target_os = "linux")]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    }
    #[cfg(not(target_os = "linux"))]
    0.0
}

/// Most memory that this process ever held, in bytes; 0 where /proc does not tell.
pub fn peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).unwrap_or(0) * 1024
}
