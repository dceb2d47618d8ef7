//! Chooses the fastest of several devices by measurement.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::roofline::Roofline;
use crate::error::Result;
use crate::gpu::{Context, DeviceInfo, Measurements, Validation, list_devices};

/// How fast a device is.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct DeviceSpeed {
    /// Milliseconds of the yardstick kernel for half a million samples, from submission to completion by the clock of
    /// the host: it is the same for all devices.
    pub yardstick_ms: f64,
    /// Arithmetic rate in GFLOP/s.
    pub fma_gflop_s: f64,
    /// Memory bandwidth in GB/s, the sum of bytes read and written.
    pub copy_gb_s: f64,
}

/// Samples of the yardstick: enough that a GPU does not spend most of the time on the submission.
const SAMPLES: usize = 1 << 19;
/// The best of some runs counts; the first one also warms up.
const RUNS: usize = 3;
const SPEED: &str = "speed";

/// What to pass to [`Context::new`]: `wanted`, else the index of the usable device with the shortest yardstick.
///
/// Each device is measured once, and the result kept in `cache_dir`. `None` if there are not several usable devices:
/// nothing is measured then. A device that fails counts as unusable.
pub fn choose_device(wanted: Option<&str>, cache_dir: Option<&Path>) -> Result<Option<String>> {
    if wanted.is_some() {
        return Ok(wanted.map(Into::into));
    }
    let usable: Vec<DeviceInfo> = list_devices()?.into_iter().filter(|info| info.lacks.is_empty()).collect();
    let speed = |info: &DeviceInfo| -> Result<DeviceSpeed> {
        let measure = || {
            let context = Context::new(Some(&info.index.to_string()), Validation::Off, cache_dir)?;
            DeviceSpeed::measure(&context)
        };
        Measurements::of(info, cache_dir)
            .get(SPEED, measure)
            .inspect(|speed| tracing::info!("{}: {speed}", info.name))
            .inspect_err(|error| tracing::warn!("{} is left out, because it cannot be measured: {error}", info.name))
    };
    Ok(fastest(&usable, speed).map(|info| info.index.to_string()))
}

/// `None` if there are not several devices, or none of them can be measured.
fn fastest<D>(usable: &[D], speed: impl Fn(&D) -> Result<DeviceSpeed>) -> Option<&D> {
    if usable.len() < 2 {
        return None;
    }
    let measured = usable.iter().filter_map(|device| Some((device, speed(device).ok()?.yardstick_ms)));
    measured.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(device, _)| device)
}

impl DeviceSpeed {
    /// That which is kept.
    pub fn kept(measurements: &Measurements) -> Option<Self> {
        measurements.kept(SPEED)
    }

    fn measure(context: &Arc<Context>) -> Result<Self> {
        let mut limits = Roofline::new(context, SAMPLES)?;
        let mut speed = Self { yardstick_ms: f64::INFINITY, fma_gflop_s: 0.0, copy_gb_s: 0.0 };
        for _ in 0..RUNS {
            let start = Instant::now();
            limits.yardstick_ms()?;
            speed.yardstick_ms = speed.yardstick_ms.min(1e3 * start.elapsed().as_secs_f64());
            speed.copy_gb_s = speed.copy_gb_s.max(limits.copy_gb_s()?);
        }
        // The same kernel with so much work that one run is enough, and on a CPU takes a second.
        speed.fma_gflop_s = limits.fma_gflop_s()?;
        Ok(speed)
    }
}

impl std::fmt::Display for DeviceSpeed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { yardstick_ms, fma_gflop_s, copy_gb_s } = self;
        write!(f, "yardstick {yardstick_ms:.2} ms, {fma_gflop_s:.0} GFLOP/s, {copy_gb_s:.1} GB/s")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    fn speed(yardstick_ms: f64) -> DeviceSpeed {
        DeviceSpeed { yardstick_ms, fma_gflop_s: 1.0, copy_gb_s: 1.0 }
    }

    #[test]
    fn the_fastest_device_that_works_is_chosen() {
        let by_index = |&index: &usize| Ok(speed([4.0, 2.0, 3.0][index]));
        assert_eq!(fastest(&[0, 1, 2], by_index), Some(&1));
        let lost = || Err(Error::invalid("this device", "was lost"));
        assert_eq!(fastest(&[0, 1, 2], |index| if *index == 1 { lost() } else { by_index(index) }), Some(&2));
        assert_eq!(fastest(&[0, 1, 2], |_| lost()), None);
    }

    #[test]
    fn a_single_device_is_not_measured() {
        assert_eq!(fastest(&[0], |_| unreachable!("there is no choice")), None);
    }
}
