//! Where a report was made.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use relume::Result;
use relume::gpu::Context;
use relume::relight::roofline::Roofline;
use relume::report::significant;

use crate::cli::bench::{best_of, load_average};

/// Enough that a kernel outlasts its submission.
const SAMPLES: usize = 1 << 19;

/// Names and values, measured limits among them.
pub fn describe(context: &Arc<Context>, seed: u64) -> Result<Vec<[String; 2]>> {
    let mut limits = Roofline::new(context, SAMPLES)?;
    let copy = best_of(5, || limits.copy_gb_s())?;
    let fma = best_of(5, || limits.fma_gflop_s())?;
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let rows = [
        ("relume", env!("CARGO_PKG_VERSION").to_owned()),
        ("Vulkan device", context.info.name.clone()),
        ("driver", context.info.driver.clone()),
        ("processor", processor()),
        ("hardware threads", threads.to_string()),
        ("threads used", rayon::current_num_threads().to_string()),
        ("seed", seed.to_string()),
        ("measured limit: copy, GB/s read and written", significant(copy)),
        ("measured limit: multiply-adds, Gflop/s", significant(fma)),
        ("load average at the start", load()),
    ];
    Ok(rows.map(|(what, value)| [what.to_owned(), value]).into())
}

pub fn load() -> String {
    significant(load_average())
}

pub fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("model name"));
    line.map_or("unknown", |line| line.trim_start_matches([' ', '\t', ':'])).to_owned()
}

/// Day and minute, UTC.
pub fn now() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs() as i64);
    let [year, month, day] = civil(seconds.div_euclid(86_400));
    let minutes = seconds.rem_euclid(86_400) / 60;
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02} UTC", minutes / 60, minutes % 60)
}

/// Year, month and day of the Gregorian calendar, so many days after 1970-01-01.
fn civil(days: i64) -> [i64; 3] {
    let leap = |year: i64| year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let (mut year, mut day) = (1970, days);
    while day >= 365 + i64::from(leap(year)) {
        day -= 365 + i64::from(leap(year));
        year += 1;
    }
    let february = 28 + i64::from(leap(year));
    let lengths = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 0;
    while day >= lengths[month] {
        day -= lengths[month];
        month += 1;
    }
    [year, month as i64 + 1, day + 1]
}
