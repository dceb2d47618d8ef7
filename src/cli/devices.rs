//! `relume devices`

use relume::Result;
use relume::gpu::{Measurements, list_devices};
use relume::relight::{DeviceSpeed, VisibilityTimes};
use relume::session::user_cache_dir;
use serde_json::{Value, json};

use super::stats::visibility_name;
use super::stdout::out;

#[derive(clap::Args)]
pub struct Args {
    /// Prints JSON.
    #[arg(long)]
    json: bool,
}

pub const AFTER_HELP: &str = "\
Without --device, other commands use the device with the shortest yardstick: a kernel that is timed once on each device, \
if several can be used. --visibility auto is measured once on each device. Results are kept in the cache folder of the \
user, and are printed here. Delete the measurements-*.json files there to measure again.";

pub fn run(args: &Args) -> Result<()> {
    let devices = list_devices()?;
    let cache_dir = user_cache_dir();
    let measured = devices.iter().map(|info| {
        let measurements = Measurements::of(info, cache_dir.as_deref());
        (DeviceSpeed::kept(&measurements), VisibilityTimes::kept(&measurements))
    });
    let measured: Vec<_> = measured.collect();
    if args.json {
        let with_measured = |(info, (speed, times)): (_, &(Option<DeviceSpeed>, Option<VisibilityTimes>))| {
            let mut device = json!(info);
            device["speed"] = json!(speed);
            device["visibility"] = times.map_or(Value::Null, |times| {
                json!({ "method": visibility_name(times.traced()), "map_ms": times.map_ms, "traced_ms": times.traced_ms })
            });
            device
        };
        let devices: Vec<Value> = devices.iter().zip(&measured).map(with_measured).collect();
        out!("{}", json!({ "schema": 1, "devices": devices }))?;
        return Ok(());
    }
    if devices.is_empty() {
        out!("no Vulkan device; tools/setup installs a driver that runs on the CPU")?;
    }
    for (d, (speed, times)) in devices.iter().zip(measured) {
        let verdict = d.shortcoming().unwrap_or_else(|| "ready".into());
        let gib = d.memory_bytes as f64 / f64::from(1 << 30);
        out!("{}  {} ({}), {}, Vulkan {}, {gib:.1} GiB: {verdict}", d.index, d.name, d.kind, d.driver, d.api)?;
        if let Some(speed) = speed {
            out!("   measured: {speed}")?;
        }
        if let Some(times) = times {
            out!("   --visibility auto is {}: {times}", visibility_name(times.traced()))?;
        }
    }
    Ok(())
}
