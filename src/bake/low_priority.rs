//! Bakes that run in the background.

/// Runs `work` in a thread pool of its own, at low priority and with one thread fewer than there are cores, so that
/// lights can be edited meanwhile.
pub fn low_priority<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    give_way_with(rayon::current_num_threads().saturating_sub(1).max(1), work)
}

/// The same on all cores, for work that ends at the next edit.
pub fn at_rest<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    give_way_with(rayon::current_num_threads(), work)
}

fn give_way_with<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    match rayon::ThreadPoolBuilder::new().num_threads(threads).start_handler(|_| give_way()).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(), // no more threads are available
    }
}

/// Lowers the priority of this thread. Only Linux has a priority per thread; elsewhere it would apply to the whole
/// program.
fn give_way() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::setpriority_process(None, 10) {
        tracing::info!("the priority of the background bake cannot be lowered: {error}");
    }
}
