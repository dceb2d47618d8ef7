//! `relume devices`

use relume::Result;
use relume::gpu::list_devices;

use super::stdout::out;

#[derive(clap::Args)]
pub struct Args {
    /// Prints JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<()> {
    let devices = list_devices()?;
    if args.json {
        out!("{}", serde_json::json!({ "schema": 1, "devices": devices }))?;
        return Ok(());
    }
    if devices.is_empty() {
        out!("no Vulkan device; tools/setup installs a driver that runs on the CPU")?;
    }
    for d in devices {
        let verdict = d.shortcoming().unwrap_or_else(|| "ready".into());
        let gib = d.memory_bytes as f64 / f64::from(1 << 30);
        out!("{}  {} ({}), {}, Vulkan {}, {gib:.1} GiB: {verdict}", d.index, d.name, d.kind, d.driver, d.api)?;
    }
    Ok(())
}
